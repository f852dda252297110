"""How much happens where in an array: squared differences of neighbours, summed over small boxes.

What a block leaves to be coded goes with it, so blocks that are to stand for all others are picked by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..grids import SMALLEST_EDGE
from ..streaming.source import Source
from ..support.slabs import thinning

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

#: Most elements looked at.
ELEMENTS = 1 << 21


@dataclass(frozen=True, eq=False)
class Detail:
    """Sums over all boxes from the first row of every axis to each cell's border, `[cells + 1 along each axis]`."""

    sums: F64

    def of(self, grid: Sequence[int]) -> F64:
        """The detail of every block of a grid, `grid`."""
        found: F64 = self.sums
        for n, count in enumerate(grid):
            cells: int = found.shape[n] - 1
            place: F64 = np.linspace(0.0, cells, count + 1)
            low = np.minimum(place.astype(np.intp), cells - 1)
            part = (place - low).reshape(-1, *(1,) * (len(grid) - n - 1))
            found = np.diff((1 - part) * found.take(low, n) + part * found.take(low + 1, n), axis=n)
        return np.maximum(found, 0.0)


def detail_of(source: Source, values: F32 | None) -> Detail:
    """The detail of an array, of rows taken evenly where there are many; `values` are the source's, if held.

    Neighbours are those along axes that may be cut.
    """
    steps = thinning(source.shape, ELEMENTS)
    part = tuple(slice(None, None, step) for step in steps)
    seen = source.values(part) if values is None else values[part]
    squares = np.zeros(seen.shape, np.float32)
    for n, size in enumerate(source.shape):
        if size >= 2 * SMALLEST_EDGE:
            ahead = (slice(None),) * n + (slice(-1),)
            squares[ahead] += np.square(np.diff(seen, axis=n))
    sums: F64 = squares.astype(np.float64)
    for n, step in enumerate(steps):
        starts = np.arange(0, int(seen.shape[n]), max(1, SMALLEST_EDGE // step))
        sums = np.add.reduceat(sums, starts, axis=n)
    for n in range(sums.ndim):
        sums = np.concatenate([np.zeros_like(sums.take([0], n)), np.cumsum(sums, axis=n)], axis=n)
    return Detail(sums)
