"""The small tables of a level, checked and unpacked: C, K, R and row counts of each node.

Products of sizes are taken in float64: they cannot wrap, and are exact wherever they can equal a 32-bit offset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..narrow import U8
from ..packed import U32, PackedLevel
from .reasons import fault
from .schema import prefix

Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Geometry:
    """A level with S nodes, its tables as signed numbers that sums and products do not wrap."""

    level: int  # from 1
    packed: PackedLevel
    decomposed: tuple[int, ...]  # mode numbers
    clusters: Ints  # [S, N]
    mixture: Ints  # [S, N]
    ranks: Ints  # [S, N]
    rows: Ints  # [S, N]
    cells: NDArray[np.float64]  # [S], PC

    def name(self, array: str) -> str:
        """Full name of an array of the level."""
        return prefix(self.level) + array


def first(mask: NDArray[np.bool_]) -> tuple[int, ...] | None:
    """Index of the first true element, None if there is none.

    >>> first(np.array([[False, False], [True, True]]))
    (1, 0)
    """
    if not mask.any():
        return None
    return tuple(int(i) for i in np.unravel_index(int(mask.argmax()), mask.shape))


def read_geometry(packed: PackedLevel, level: int, undecomposed: Sequence[int]) -> Geometry:
    """Check the shape table and the row offsets of a level and unpack them."""
    shape = packed.shape.astype(np.int64)
    rows = np.stack([offset_steps(offsets, f"{prefix(level)}row_offset/{n}")
                     for n, offsets in enumerate(packed.row_offset)], axis=1)
    check_shapes(shape, rows, undecomposed, prefix(level) + "shape")
    clusters = shape[:, 0]
    decomposed = tuple(n for n in range(packed.order) if n not in undecomposed)
    return Geometry(level, packed, decomposed, clusters, shape[:, 1], shape[:, 2], rows, clusters.prod(1, np.float64))


def offset_steps(offsets: U32, name: str) -> Ints:
    """What each node owns according to an offset array, which must start at 0 and ascend."""
    signed = offsets.astype(np.int64)
    if signed[0] != 0:
        raise fault("offset-order", name, f"first offset {signed[0]}", "0")
    steps = np.diff(signed)
    if (bad := first(steps < 0)) is not None:
        raise fault("offset-order", name, f"{signed[bad[0] + 1]} after {signed[bad[0]]} at node {bad[0]}",
                    "ascending offsets")
    return steps


def check_end(offsets: U32, array: NDArray[Any], name: str) -> None:
    """The last offset must be the length of the ragged array that the offsets part."""
    if int(offsets[-1]) != array.size:
        raise fault("offset-end", name, f"last offset {offsets[-1]}", f"{array.size}, the length of the array")


def check_shapes(shape: Ints, rows: Ints, undecomposed: Sequence[int], name: str) -> None:
    """Each node's C, K and R: all zero, or K <= C and all positive, and fixed for an undecomposed mode."""
    clusters, mixture, ranks = shape[:, 0], shape[:, 1], shape[:, 2]
    zero = (shape == 0).all(axis=(1, 2))
    wrong = (clusters < 1) | (mixture < 1) | (ranks < 1) | (mixture > clusters)
    allowed = "all zero, or 1 <= K <= C and R >= 1 in every mode; C = K = 1 and R = rows if undecomposed"
    for n in undecomposed:
        wrong[:, n] |= (clusters[:, n] != 1) | (ranks[:, n] != rows[:, n])
    if (bad := first(wrong & ~zero[:, None])) is not None:
        s, n = bad
        raise fault("node-shape", name, f"C={clusters[s, n]} K={mixture[s, n]} R={ranks[s, n]} in mode {n} of node {s}",
                    allowed)
    if (bad := first((rows == 0) & ~zero[:, None])) is not None:
        raise fault("node-empty", name, f"node {bad[0]} without rows in mode {bad[1]} has a shape", "a shape of zeros")


def check_entries(name: str, entries: U8, ranks: NDArray[np.integer[Any]]) -> None:
    """Of the columns of a mode's bases there are as many as the nodes have ranks."""
    columns = int(ranks.sum(dtype=np.int64))
    if entries.shape != (columns,):
        raise fault("array-shape", name, list(entries.shape), [columns])
