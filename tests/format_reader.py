"""A reader of `.hmk` files by `docs/format.md` alone: nothing of ours but the code in it, one element at a time."""

from __future__ import annotations

import json
import re
import struct
import zlib
from math import prod
from pathlib import Path
from typing import Any, cast

import numpy as np

TEXT = (Path(__file__).parent.parent / "docs" / "format.md").read_text(encoding="utf-8")


def code_of_the_text() -> dict[str, Any]:
    """What the Python in the text defines."""
    names: dict[str, Any] = {}
    for block in re.findall(r"^```python\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE):
        exec(block, names)
    return names


CODE = code_of_the_text()


def unit(k: int) -> np.float32:
    """Section 6: what a unit of a basis column stands for."""
    root = np.uint32(0x3F3504F3).view(np.float32)
    return np.float32(2.0) ** -(k // 2) * (root if k % 2 else np.float32(1))


def half(number: np.float32) -> float:
    """The nearest float16 number."""
    return float(np.float16(number))


def widen(node: Any, step: float) -> None:
    """Section 6: whole numbers of a node as core, scale and bases."""
    largest = max((abs(q) for core in node.core for q in core), default=0)
    e = next(e for e in range(15) if largest / 2**e <= 2047)
    node.scale = [float(np.float32(step) * np.float32(2**e))] * len(node.core)
    node.core = np.array([[half(np.float32(q) * np.float32(2.0**-e)) for q in core] for core in node.core])
    node.core = node.core.reshape(-1, *node.R)
    for n, mixture in enumerate(node.K):
        others = prod(node.C) // node.C[n]
        basis = np.zeros((node.rows[n], mixture, others, node.R[n]))
        for (i, j, other, r), q in node.basis[n].items():
            rest, cell = other, [0] * len(node.C)
            cell[n] = node.cluster[n][i][j]
            for m in reversed([m for m in range(len(node.C)) if m != n]):
                rest, cell[m] = divmod(rest, node.C[m])
            k = node.k[n][CODE["flat"](cell, node.C)][r]
            basis[i, j, other, r] = half(np.float32(q) * unit(k))
        node.basis[n] = basis


def stored(nodes: list[Any], data: bytes) -> None:
    """Section 5, at its end: float16 numbers behind the code of a run."""
    at = 0

    def take(letter: str, shape: tuple[int, ...]) -> Any:
        nonlocal at
        size = struct.calcsize(f"<{prod(shape)}{letter}")
        at += size
        return np.array(struct.unpack(f"<{prod(shape)}{letter}", data[at - size : at]), np.float64).reshape(shape)

    cells = [node for node in nodes if node.kind == CODE["CELLS"]]
    for node in cells:
        node.core = take("e", (prod(node.C), *node.R))
    for n in range(len(nodes[0].C)):
        for node in cells:
            node.basis[n] = take("e", (node.rows[n], node.K[n], prod(node.C) // node.C[n], node.R[n]))
    for node in cells:
        node.scale = take("f", (prod(node.C),))
    assert at == len(data)


class Reader:
    """A file, read whole."""

    def __init__(self, path: Path) -> None:
        self.data = path.read_bytes()
        magic, version, length, crc = struct.unpack("<8sIII", self.data[:20])
        assert (magic, version) == (bytes.fromhex("89484D4B0D0A1A0A"), 1)
        text = self.data[20 : 20 + length]
        assert zlib.crc32(text) == crc
        self.header: dict[str, Any] = json.loads(text)
        self.at = 20 + length
        self.axes = self.header["axes"]
        self.coordinates = [self._coordinates(axis) for axis in self.axes]
        self.modes: list[list[int]] = [
            [self.axes[axis]["size"] for axis in mode] for mode in self.header["organisation"]
        ]
        self.stages = self._stages()
        assert self.at == len(self.data)

    def _section(self, length: int) -> bytes:
        payload = self.data[self.at : self.at + length]
        self.at += length + 4
        assert struct.unpack("<I", self.data[self.at - 4 : self.at])[0] == zlib.crc32(payload)
        return payload

    def _coordinates(self, axis: dict[str, Any]) -> Any:
        given: Any = axis.get("coordinates")
        if not isinstance(given, dict):
            return given
        width = int(cast("dict[str, Any]", given)["width"])
        count, letter = axis["size"] * max(1, width), {"F32": "f", "F64": "d"}[given["dtype"]]
        numbers = struct.unpack(f"<{count}{letter}", self._section(struct.calcsize(f"<{count}{letter}")))
        return np.array(numbers).reshape([axis["size"], width][: 2 if width else 1]).tolist()

    def _stages(self) -> list[list[Any]]:
        places: list[Any] = [self.modes]
        stages: list[list[Any]] = []
        for number, head in enumerate(self.header["stages"], 1):
            nodes: list[Any] = []
            for count, coded, cells, core, *basis in head["runs"]:
                raw = 4 * cells + 2 * (core + sum(basis)) if "bits" in head else 0
                payload = self._section(coded + raw)
                run = CODE["Run"](
                    payload[:coded], len(self.modes), number == len(self.header["stages"]), "step" in head
                )
                own = [run.node(extents) for extents in places[len(nodes) : len(nodes) + count]]
                run.end()
                for node in own if "step" in head else []:
                    if node.kind == CODE["CELLS"]:
                        widen(node, head["step"])
                if "bits" in head:
                    stored(own, payload[coded:])
                nodes += own
            stages.append(nodes)
            if number > 1:
                self._adopt(stages[-2], nodes)
            places = []
            for node in nodes:
                node.below = CODE["children"](node)
                node.children = []
                places += node.below
                node.cluster = [
                    np.array(own, int).reshape(len(own), k) for own, k in zip(node.cluster, node.K, strict=True)
                ]
                node.part = [np.array(own, int) for own in node.part]
        return stages

    def _adopt(self, parents: list[Any], nodes: list[Any]) -> None:
        rest = iter(nodes)
        for parent in parents:
            parent.children = [next(rest) for _ in parent.below]
        assert next(rest, None) is None

    def element(self, rows: list[int], stages: int) -> float:
        """The value at a row of each mode up to a stage, before the inverse of the value transform."""
        return CODE["element"](self.stages[0][0], rows, stages)

    def value(self, index: list[int], level: int) -> float:
        """The value of the source at an index of each axis, up to a level."""
        ends = [n for n, head in enumerate(self.header["stages"], 1) if "step" in head or "bits" in head]
        rows = [
            CODE["flat"]([index[axis] for axis in mode], [self.axes[axis]["size"] for axis in mode])
            for mode in self.header["organisation"]
        ]
        y, transform = self.element(rows, ends[level - 1]), self.header.get("transform", {"name": "identity"})
        scale = transform.get("scale", 1.0)
        return {
            "identity": lambda: y,
            "log1p": lambda: scale * float(np.expm1(y)),
            "asinh": lambda: scale * float(np.sinh(y)),
            "sqrt": lambda: max(y, 0.0) ** 2,
        }[transform["name"]]()
