"""Stages as runs of code, and back: what stands between the arrays in memory and the sections of a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from itertools import accumulate
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis, Organisation
from ..packed import F16, U32, PackedLevel
from ..support.extension import native
from .reasons import fault
from .stages import Run, Stage

#: Rows of all nodes in each mode, and the extents that these are made of: `rows` [S N], `extents`, `ends` [S N + 1].
Places = dict[str, Any]


def root_places(axes: Sequence[Axis], organisation: Organisation) -> Places:
    """Where the root lies, whose extents are the sizes of each mode's axes."""
    sizes = {axis.name: axis.size for axis in axes}
    extents = [[sizes[name] for name in mode] for mode in organisation]
    flat = np.array([size for own in extents for size in own], np.uint32)
    ends = np.array([0, *accumulate(map(len, extents))], np.uint32)
    return {
        "rows": np.array([np.prod(own, dtype=np.int64) for own in extents], np.uint32),
        "extents": flat,
        "ends": ends,
    }


def following(level: PackedLevel, places: Places, name: str) -> Places:
    """Where the nodes of the next stage lie."""
    part = [array for array in level.part if array is not None]
    try:
        return native.next_stage(_flat(level.shape), _children(level), part, places)
    except ValueError as error:
        raise _as_fault(error, name) from error


def encode_stage(level: PackedLevel, places: Places, name: str) -> list[tuple[list[bytes], Run]]:
    """The runs of a stage: the pieces of each one's payload, and what the header says of it."""
    half = level.step is None and not level.is_cut
    arrays = _arrays(level, places, name)
    try:
        coded = native.encode_stage(arrays, places)
    except ValueError as error:
        raise _as_fault(error, name) from error
    runs: list[tuple[list[bytes], Run]] = []
    at = Run(0, 0, 0, 0, (0,) * level.order)
    for data, (nodes, length, cells, core, *basis) in coded:
        run = Run(nodes, length, cells, core, tuple(basis))
        runs.append(([data, *(_raw(level, at, run) if half else [])], run))
        at = Run(0, 0, at.cells + cells, at.core + core, tuple(map(sum, zip(at.basis, basis, strict=True))))
    held = (level.core_scale.size, level.core.size, *(array.size for array in level.basis))
    if held != (at.cells, at.core, *at.basis):
        raise fault("array-shape", name, f"{held} cells, core and basis numbers", (at.cells, at.core, *at.basis))
    return runs


def _arrays(level: PackedLevel, places: Places, name: str) -> dict[str, Any]:
    """What the native coder takes."""
    core, basis = np.zeros(0, np.int32), [np.zeros(0, np.int32)] * level.order
    if level.step is not None:
        try:
            core, basis = native.whole_stage(
                {
                    "step": level.step,
                    "shape": _flat(level.shape),
                    "cluster": list(level.cluster),
                    "column": list(level.column),
                    "core": level.core.view(np.uint16),
                    "core_scale": level.core_scale,
                    "basis": [array.view(np.uint16) for array in level.basis],
                },
                places,
            )
        except ValueError as error:
            raise fault("not-whole", name, str(error), "whole numbers times what a step of each stands for") from error
    return {
        "last": level.child is None,
        "coded": level.step is not None,
        "shape": _flat(level.shape),
        "children": _children(level),
        "cluster": list(level.cluster),
        "part": [array for array in level.part if array is not None],
        "column": list(level.column) or [np.zeros(0, np.uint8)] * level.order,
        "core": core,
        "basis": list(basis),
    }


def _raw(level: PackedLevel, at: Run, run: Run) -> list[bytes]:
    """Float16 numbers of a run that begins at `at`."""
    pieces: list[NDArray[Any]] = [level.core[at.core : at.core + run.core].astype("<f2")]
    pieces += [
        array[start : start + count].astype("<f2")
        for array, start, count in zip(level.basis, at.basis, run.basis, strict=True)
    ]
    return [piece.tobytes() for piece in (*pieces, level.core_scale[at.cells : at.cells + run.cells].astype("<f4"))]


def decode_stage(
    stage: Stage, places: Places, after: Stage | None, payloads: Sequence[memoryview], name: str
) -> tuple[PackedLevel, Places]:
    """The arrays of a stage of these payloads, and where the nodes of the stage `after` it lie."""
    header = {
        "last": after is None,
        "step": stage.step,
        "raw": stage.half,
        "largest": np.array(stage.largest, np.uint32).reshape(-1),
        "next": (0, [0] * len(stage.rows)) if after is None else (after.nodes, list(after.rows)),
    }
    runs = [(np.frombuffer(data, np.uint8), run.counts) for data, run in zip(payloads, stage.runs, strict=True)]
    try:
        out = native.decode_stage(header, places, runs)
    except ValueError as error:
        raise _as_fault(error, name) from error
    return stage_arrays(out, places, stage.step, last=after is None), out["next"]


def stage_arrays(out: dict[str, Any], places: Places, step: float | None, *, last: bool) -> PackedLevel:
    """The arrays of a stage that the native decoder gave, with the offsets that follow from them."""
    order = len(out["basis"])
    shape = out["shape"].reshape(-1, 3, order)
    rows = places["rows"].reshape(-1, order).astype(np.int64)
    clusters, mixture, ranks = (shape[:, i].astype(np.int64) for i in range(3))
    cells = np.where(ranks.any(axis=1), clusters.prod(axis=1), 0)
    members = rows * mixture
    others = [np.delete(clusters, n, axis=1).prod(axis=1) for n in range(order)]
    none = (None,) * order
    return _read_only(
        PackedLevel(
            shape=shape,
            child=None if last else _offsets(out["children"]),
            row_offset=tuple(_offsets(rows[:, n]) for n in range(order)),
            core=out["core"].view(np.float16),
            core_offset=_offsets(cells * ranks.prod(axis=1)),
            core_scale=out["core_scale"],
            cell_offset=_offsets(cells),
            cluster=tuple(out["cluster"]),
            cluster_offset=tuple(_offsets(members[:, n]) for n in range(order)),
            basis=tuple(_halves(array) for array in out["basis"]),
            basis_offset=tuple(_offsets(members[:, n] * others[n] * ranks[:, n]) for n in range(order)),
            part=none if last else tuple(out["part"]),
            local=none if last else tuple(out["next"]["local"]),
            step=step,
            column=tuple(out["column"]) if step is not None else (),
        )
    )


def arrays_of(level: PackedLevel, name: str) -> list[NDArray[Any] | None]:
    """The arrays of a field, one for each mode where it has some for each; none of a field that holds no array."""
    value: Any = getattr(level, name)
    if isinstance(value, tuple):
        return list(cast("tuple[NDArray[Any] | None, ...]", value))
    return [cast("NDArray[Any]", value)] if isinstance(value, np.ndarray) else [None]


def _read_only(level: PackedLevel) -> PackedLevel:
    """The same, safe from being changed: models share arrays."""
    for field in fields(level):
        for array in arrays_of(level, field.name):
            if array is not None:
                array.flags.writeable = False
    return level


def _halves(bits: NDArray[np.uint16]) -> F16:
    return bits.view(np.float16)


def _offsets(lengths: NDArray[Any]) -> U32:
    return np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)]).astype(np.uint32)


def _flat(shape: U32) -> U32:
    return np.ascontiguousarray(shape).reshape(-1)


def _children(level: PackedLevel) -> U32:
    """How many children each node has."""
    return np.zeros(level.nodes, np.uint32) if level.child is None else np.diff(level.child)


def _as_fault(error: ValueError, name: str) -> Exception:
    """The refusal that the native coder's reason stands for, in a run if it says in which."""
    reason, run, *_ = (*error.args, None)
    if reason == "part-range":
        return fault(
            "cluster-range", name, "a part that its node does not have", "less than C"
        )
    name = name if run is None else f"{name}.runs[{run}]"
    found, allowed = _TOLD.get(reason, (reason, "sound arrays"))
    return fault(reason if reason in _TOLD else "array-shape", name, found, allowed)


_TOLD = {
    "code-end": ("a code that does not end with its nodes", "a code of exactly its nodes"),
    "code-range": ("a whole number that is too large", "magnitudes up to 2^24 - 1, k up to 63"),
    "cluster-range": ("a cluster or part that its node does not have", "less than C"),
    "cluster-order": ("clusters of a row in disorder", "distinct clusters, ascending"),
    "node-shape": ("a node of impossible C, K and R", "all zero; a cut into two and more; or 1 <= K <= C, R >= 1"),
    "level-bounds": ("a node beyond the largest C, K and R that the header says", "no more than these"),
    "run-count": ("more or fewer cells, numbers or children than the header says of a run", "as many"),
    "child-count": ("children that the next stage has not as many nodes for", "a node for each child"),
    "row-count": ("children whose rows are not as many as the next stage has", "as many"),
}
