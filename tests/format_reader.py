"""A reader of `.hmk` files by `docs/format.md` alone: standard library, nothing of ours, one element at a time.

Written from the text, so that what the text leaves open would show. Unlike `literal_decode` it begins with the bytes.
"""

from __future__ import annotations

import hashlib
import json
import math
import struct
import zlib
from collections.abc import Sequence
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

#: struct's letter and bytes of one number.
TYPES = {
    "I8": ("b", 1), "U8": ("B", 1), "F16": ("e", 2), "F32": ("f", 4), "F64": ("d", 8), "U16": ("H", 2), "U32": ("I", 4),
}  # fmt: skip


def flat(index: Sequence[int], sizes: Sequence[int]) -> int:
    """C order, the last fastest."""
    number = 0
    for i, size in zip(index, sizes, strict=True):
        number = number * size + i
    return number


def of_bytes(name: str, stored: Sequence[int]) -> tuple[float, ...]:
    """Section 3, bytes: the numbers that those of a core or a basis stand for."""
    if "/basis/" in name:
        return tuple(q / 128 for q in stored)
    assert name.endswith("/core")
    return tuple(struct.unpack("<e", struct.pack("<e", q * abs(q) / 16129))[0] for q in stored)


def bits_of(stored: Sequence[int]) -> list[int]:
    """The bits of bytes, the lowest of each first."""
    return [byte // 2**place % 2 for byte in stored for place in range(8)]


def of_codes(stored: Sequence[int], parameters: Sequence[int]) -> tuple[int, ...]:
    """Section 3, packed levels: whole numbers of these parameters, whose codes take up all the bytes."""
    bits, at, zeros = bits_of(stored), 0, list[int]()
    for _ in parameters:
        u = 0
        while bits[at] == 0:
            at, u = at + 1, u + 1
        assert u <= 12
        zeros.append(u)
        at += 1
    at += -at % 8
    numbers = list[int]()
    for u, k in zip(zeros, parameters, strict=True):
        own = bits[at : at + (16 if u == 12 else k)]
        assert len(own) == (16 if u == 12 else k)
        at += len(own)
        z = sum(bit * 2**place for place, bit in enumerate(own)) + (0 if u == 12 else 2**k * u)
        numbers.append(z // 2 if z % 2 == 0 else -(z + 1) // 2)
    assert len(stored) == math.ceil(at / 8)
    return tuple(numbers)


def nearest_half(whole: int, k: int) -> float:
    """Section 3, packed levels: the float16 number, of 11 binary digits, nearest to whole / 2^(k+2)."""
    low = max(abs(whole).bit_length() - 11, 0)  # digits that float16 has no room for
    kept, rest = divmod(abs(whole), 2**low)
    kept += 2 * rest > 2**low or (2 * rest == 2**low and kept % 2 == 1)
    return math.copysign(kept * 2**low, whole) / 2 ** (k + 2)


class Reader:
    """Sections 1, 5 and 6: the header, its metadata, the arrays."""

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        start = 8 + struct.unpack("<Q", data[:8])[0]
        header: dict[str, Any] = json.loads(data[8:start])
        texts = header.pop("__metadata__")
        assert hashlib.sha256(texts["hmkcta"].encode()).hexdigest() == texts["hmkcta_sha256"]
        self.metadata: dict[str, Any] = json.loads(texts["hmkcta"])
        self.arrays: dict[str, tuple[Any, ...]] = {}
        end = 0
        for name, entry in sorted(header.items(), key=lambda item: item[1]["data_offsets"]):
            letter, size = TYPES[entry["dtype"]]
            begin, last = entry["data_offsets"]
            raw, count = data[start + begin : start + last], prod(entry["shape"])
            assert (begin, last - begin, (start + begin) % size) == (end, count * size, 0)
            record = {"dtype": entry["dtype"], "shape": entry["shape"], "crc32": zlib.crc32(raw)}
            assert self.metadata["arrays"].pop(name) == (record["crc32"] if self._is_short else record)
            numbers, end = struct.unpack(f"<{count}{letter}", raw), last
            self.arrays[name] = of_bytes(name, numbers) if entry["dtype"] == "I8" else numbers
        assert not self.metadata["arrays"]
        self._check_types(header)
        assert start + end == len(data)
        self.sizes = {axis["name"]: axis["size"] for axis in self.metadata["axes"]}
        self.modes: list[list[str]] = self.metadata["organisation"]
        self.undecomposed: list[int] = self.metadata["undecomposed"]
        if self._is_short:
            self._complete([prod(self.sizes[a] for a in mode) for mode in self.modes])

    @property
    def _is_short(self) -> bool:
        return self.metadata["version"] in ("1.2", "1.4")

    def _check_types(self, header: dict[str, Any]) -> None:
        """Section 3, types: one for the numbers of a level, no F16 after another, parameters beside U8 alone."""
        types = {"1.0": ["F16"], "1.1": ["F16", "I8"], "1.2": ["F16", "I8"], "1.4": ["F16", "I8", "U8"]}
        allowed = types[self.metadata["version"]]
        decomposed = {n for n, _ in enumerate(self.metadata["organisation"])} - {*self.metadata["undecomposed"]}
        before = "F16"
        for level, _ in enumerate(self.metadata["levels"], 1):
            core = header[f"level/{level}/core"]["dtype"]
            assert core in allowed
            assert core != "F16" or before == "F16"
            assert core != "U8" or decomposed
            for name, entry in header.items():
                assert not name.startswith(f"level/{level}/basis/") or entry["dtype"] == core
            rice = {name for name in header if name.startswith(f"level/{level}/rice")}
            assert rice == {f"level/{level}/rice/{n}" for n in decomposed if core == "U8"}
            assert all(header[name]["dtype"] == "U8" for name in rice)
            before = core

    def _complete(self, sizes: Sequence[int]) -> None:
        """Section 3, short tables: level by level what is not stored."""
        owned = [[size] for size in sizes]  # rows of each node, mode by mode
        for level, _ in enumerate(self.metadata["levels"], 1):
            nodes = [Node(self, level, s) for s in range(len(owned[0]))]
            for node in nodes:
                node.rows = [counts[node.s] for counts in owned]
            owned = [self._complete_mode(level, nodes, n) for n in range(len(sizes))]
            self._sums(level, "core", [prod(node.clusters) * prod(node.ranks) for node in nodes])
            self._unpack_core(level, nodes)
            self._sums(level, "cell", [prod(node.clusters) for node in nodes])

    def _sums(self, level: int, name: str, counts: Sequence[int], mode: str = "") -> None:
        sums = tuple(sum(counts[:s]) for s in range(len(counts) + 1))
        self.arrays[f"level/{level}/{name}_offset{mode}"] = sums

    def _complete_mode(self, level: int, nodes: Sequence[Node], n: int) -> list[int]:
        """The arrays of a mode; how many rows the nodes of the next level own."""
        self._sums(level, "row", [node.rows[n] for node in nodes], f"/{n}")
        child = self.arrays.get(f"level/{level}/child", (0,) * (len(nodes) + 1))
        inner = [node for node in nodes if child[node.s] < child[node.s + 1]]
        if n in self.undecomposed:
            return [node.rows[n] for node in inner for _ in range(prod(node.clusters))]
        others = [prod(node.clusters[:n] + node.clusters[n + 1 :]) for node in nodes]
        entries = [node.rows[n] * node.mixture[n] for node in nodes]
        self._sums(level, "cluster", entries, f"/{n}")
        bases = [e * o * node.ranks[n] for e, o, node in zip(entries, others, nodes, strict=True)]
        self._sums(level, "basis", bases, f"/{n}")
        self._unpack(level, n, nodes, bases)
        cluster, part, local = (f"level/{level}/{name}/{n}" for name in ("cluster", "part", "local"))
        self.arrays.setdefault(cluster, (0,) * sum(entries))
        if level == len(self.metadata["levels"]):
            return []
        if part not in self.arrays:
            whole, first = list[int](), self.arrays[f"level/{level}/cluster_offset/{n}"]
            for node in nodes:
                own = self.arrays[cluster][first[node.s] : first[node.s + 1]]
                whole += own if node in inner else (0,) * node.rows[n]
            self.arrays[part] = tuple(whole)
        first = self.arrays[f"level/{level}/row_offset/{n}"]
        if local not in self.arrays:
            places = list[int]()
            for node in nodes:
                own = self.arrays[part][first[node.s] : first[node.s + 1]]
                places += [own[:i].count(p) if node in inner else 0 for i, p in enumerate(own)]
            self.arrays[local] = tuple(places)
        return [
            self.arrays[part][first[node.s] : first[node.s + 1]].count(choice[n])
            for node in inner
            for choice in product(*map(range, node.clusters))
        ]

    def _rice(self, level: int, n: int, nodes: Sequence[Node]) -> list[list[tuple[int, int]]]:
        """Section 3, packed levels: of each node's columns the parameters of basis and, at most, of core numbers."""
        columns = [(entry % 16, entry // 16) for entry in self.arrays[f"level/{level}/rice/{n}"]]
        own = [[columns.pop(0) for _ in range(node.ranks[n])] for node in nodes]
        assert not columns
        return own

    def _unpack(self, level: int, n: int, nodes: Sequence[Node], counts: Sequence[int]) -> None:
        """Section 3, packed levels: the numbers of a mode's bases, of which each node has so many."""
        if f"level/{level}/rice/{n}" not in self.arrays:
            return
        parameters = list[int]()
        for columns, count in zip(self._rice(level, n, nodes), counts, strict=True):
            parameters += [columns[i % len(columns)][0] for i in range(count)]
        basis = f"level/{level}/basis/{n}"
        whole = of_codes(self.arrays[basis], parameters)
        self.arrays[basis] = tuple(nearest_half(q, k) for q, k in zip(whole, parameters, strict=True))

    def _unpack_core(self, level: int, nodes: Sequence[Node]) -> None:
        """Section 3, packed levels: core numbers, for which the columns of all decomposed modes count."""
        modes = [n for n, _ in enumerate(self.modes) if f"level/{level}/rice/{n}" in self.arrays]
        if not modes:
            return
        parameters, steps, rice = list[int](), list[int](), {n: self._rice(level, n, nodes) for n in modes}
        for node in nodes:
            if not any(node.clusters):
                continue
            own = [min(rice[n][node.s][r[n]][1] for n in modes) for r in product(*map(range, node.ranks))]
            parameters += own * prod(node.clusters)
            most = min(max(core for _, core in rice[n][node.s]) for n in modes)
            assert most == max(own)
            steps += [most] * (len(own) * prod(node.clusters))
        whole = of_codes(self.arrays[f"level/{level}/core"], parameters)
        self.arrays[f"level/{level}/core"] = tuple(nearest_half(q, k) for q, k in zip(whole, steps, strict=True))

    def value(self, index: Sequence[int], levels: int) -> float:
        """Section 4: one element, by its index in the source array, up to a level."""
        place = dict(zip(self.sizes, index, strict=True))
        position = [flat([place[a] for a in mode], [self.sizes[a] for a in mode]) for mode in self.modes]
        s, value = 0, 0.0
        for level in range(1, levels + 1):
            node = Node(self, level, s)
            if not any(node.clusters):
                break
            value += sum(node.term(position, choice) for choice in product(*map(range, node.mixture)))
            if level < levels:
                child = node.array("child")
                if child[s] == child[s + 1]:
                    break
                rows = [node.array(f"row_offset/{n}")[s] + position[n] for n in range(len(position))]
                parts = [0 if n in self.undecomposed else node.array(f"part/{n}")[row] for n, row in enumerate(rows)]
                position = [
                    position[n] if n in self.undecomposed else node.array(f"local/{n}")[row]
                    for n, row in enumerate(rows)
                ]
                s = child[s] + flat(parts, node.clusters)
        return self._inverse(value)

    def _inverse(self, value: float) -> float:
        """Section 5, value transforms."""
        transform = self.metadata["transform"]
        return {
            "identity": lambda: value,
            "log1p": lambda: transform["scale"] * math.expm1(value),
            "asinh": lambda: transform["scale"] * math.sinh(value),
            "sqrt": lambda: max(value, 0.0) ** 2,
        }[transform["name"]]()


class Node:
    """Section 3: the arrays of a node."""

    def __init__(self, file: Reader, level: int, s: int) -> None:
        self.file, self.level, self.s, order = file, level, s, len(file.modes)
        shape = self.array("shape")[3 * order * s : 3 * order * (s + 1)]
        self.rows: list[int] = []  # of short tables, where no offsets tell
        self.clusters, self.mixture, self.ranks = (shape[order * i : order * (i + 1)] for i in range(3))

    def array(self, name: str) -> tuple[Any, ...]:
        """An array of the node's level."""
        return self.file.arrays[f"level/{self.level}/{name}"]

    def term(self, position: Sequence[int], choice: Sequence[int]) -> float:
        """What one choice of a cluster subset for each mode adds."""
        s, modes, skipped = self.s, range(len(position)), self.file.undecomposed
        members = [
            0 if n in skipped else self.array(f"cluster/{n}")[
                self.array(f"cluster_offset/{n}")[s] + position[n] * self.mixture[n] + choice[n]
            ]
            for n in modes
        ]  # fmt: skip
        cell = flat(members, self.clusters)
        first = self.array("core_offset")[s] + cell * prod(self.ranks)
        rows = {n: self._row(n, position[n], choice[n], members) for n in modes if n not in skipped}
        spans = [[position[n]] if n in skipped else range(self.ranks[n]) for n in modes]
        total = 0.0
        for r in product(*spans):
            weights = (row[r[n]] for n, row in rows.items())
            total += prod(weights, start=self.array("core")[first + flat(r, self.ranks)])
        return self.array("core_scale")[self.array("cell_offset")[s] + cell] * total

    def _row(self, n: int, position: int, k: int, members: Sequence[int]) -> Sequence[float]:
        others = [m for m in range(len(members)) if m != n]
        sizes = [self.clusters[m] for m in others]
        at = (position * self.mixture[n] + k) * prod(sizes) + flat([members[m] for m in others], sizes)
        begin = self.array(f"basis_offset/{n}")[self.s] + at * self.ranks[n]
        return self.array(f"basis/{n}")[begin : begin + self.ranks[n]]
