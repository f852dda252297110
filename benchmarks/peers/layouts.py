"""Layouts that peers search among: axes merged into modes, edges of a grid, numbers of clusters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
Floats = NDArray[np.floating[Any]]
Groups = tuple[tuple[int, ...], ...]


@dataclass(frozen=True)
class Layout:
    """One way to store an array.

    Attributes:
        groups: numbers of the axes that each mode merges; of a tensor train: in the order of its cores.
        edges: most indices of a brick along each axis; empty: the array is one brick.
        clusters: of rows; 0: none.
    """

    groups: Groups
    edges: tuple[int, ...] = ()
    clusters: int = 0


def partitions(order: int) -> list[Groups]:
    """All ways to merge axes into two modes or more.

    >>> [len(partitions(order)) for order in (2, 3, 4, 5)]
    [1, 4, 14, 51]
    """
    found: list[list[tuple[int, ...]]] = [[]]
    for axis in range(order):
        merged = [[*groups[:k], (*groups[k], axis), *groups[k + 1 :]] for groups in found for k in range(len(groups))]
        found = merged + [[*groups, (axis,)] for groups in found]
    return [tuple(groups) for groups in found if len(groups) > 1]


def united(shape: Sequence[int], groups: Groups) -> list[int]:
    """The sizes of modes."""
    return [prod(shape[axis] for axis in group) for group in groups]


def unite(batch: Floats, groups: Groups) -> Floats:
    """Merge the axes of each group into a mode, `[bricks, *axes]` to `[bricks, *modes]`."""
    moved = batch.transpose(0, *[1 + axis for group in groups for axis in group])
    return np.ascontiguousarray(moved.reshape(len(batch), *united(batch.shape[1:], groups)))


def describe(layout: Layout, names: Sequence[str]) -> str:
    """A layout in words.

    >>> describe(Layout(((0,), (1, 2)), (4, 8, 8)), ("time", "y", "x"))
    'grid time 4,y 8,x 8; modes time, y+x'
    """
    parts = [f"modes {', '.join('+'.join(names[axis] for axis in group) for group in layout.groups)}"]
    if layout.edges:
        parts.insert(0, "grid " + ",".join(f"{name} {edge}" for name, edge in zip(names, layout.edges, strict=True)))
    if layout.clusters:
        parts.append(f"{layout.clusters} clusters")
    return "; ".join(parts)


def spectrum(matrix: Floats) -> tuple[F64, F64]:
    """Singular values, largest first, and singular vectors of the shorter side (of a square matrix: the left ones)."""
    short = matrix if matrix.shape[0] <= matrix.shape[1] else matrix.T
    squares, vectors = np.linalg.eigh((short @ short.T).astype(np.float64))
    return np.sqrt(np.maximum(squares[::-1], 0.0)), np.ascontiguousarray(vectors[:, ::-1])
