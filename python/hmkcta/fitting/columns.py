"""How many bits each column of a basis is stored with: as many as its share of the tensor is worth.

What rounding leaves is least, for the bits that are spent, where every number leaves as much: then a column whose
numbers count for twice as much has one bit more. How much they count for is told by the core, and how much all of them
together may leave is a share of what the ranks leave (`LevelSpec.own_bits`).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32, F64
from ..cells import Cells, by_cells, column_peaks, column_squares

U8 = NDArray[np.uint8]

#: Fewest and most bits of a column.
FEWEST, MOST = 2, 8


def left_of(cells: Cells, energy: float) -> float:
    """Squared error that the cells leave of a tensor of this squared norm."""
    return max(energy - float(_held(cells, _squares(cells)).sum()), 0.0)


def column_bits(cells: Cells, left: float) -> list[U8 | None]:
    """Bits of a number of each column `[R_n]` of every mode, None where it is undecomposed, if so much error is `left`.

    Columns are taken to be orthogonal, as after a sweep over cells that share no element.
    """
    squares, worth, count = _squares(cells), dict[int, F64](), 0
    held = _held(cells, squares)
    for n, own in enumerate(squares):
        if own is None:
            continue
        others = tuple(m + 1 for m in range(cells.order) if m != n)
        share = held.sum(axis=others) / np.maximum(own, 1e-300)  # of a column of length 1, `[PC, R_n]`
        rows = by_cells(cells, n, _rows(cells, n))
        peaks = by_cells(cells, n, column_peaks(cells, n)).astype(np.float64)
        numbers = cells.bases[n].size // cells.ranks[n]
        worth[n] = np.sqrt((rows * share * np.square(peaks)).sum(axis=0) / max(numbers, 1))
        count += cells.bases[n].size
    step = sqrt(12 * cells.spec.own_bits * left / max(count, 1))
    return [None if skip else _bits(worth[n], step) for n, skip in enumerate(cells.undecomposed)]


def _squares(cells: Cells) -> list[F64 | None]:
    """Squared lengths of the columns of each cell, `[PC, R_n]` of every mode; None where it is undecomposed."""
    return [None if skip else by_cells(cells, n, column_squares(cells, n)) for n, skip in enumerate(cells.undecomposed)]


def _held(cells: Cells, squares: Sequence[F64 | None]) -> F64:
    """What each core number holds of the tensor's energy, `[PC, R_1, .., R_N]`."""
    held = np.square(cells.cores, dtype=np.float64)
    for n, own in enumerate(squares):
        if own is not None:
            shape = [1] * held.ndim
            shape[0], shape[n + 1] = own.shape
            held *= own.reshape(shape)
    return held


def _bits(worth: F64, step: float) -> U8:
    """So many that the steps between a column's numbers, from -m to m of 2 m + 1 = 2^bits - 1, are about `step`."""
    if step <= 0:
        return np.full(worth.shape, MOST, np.uint8)
    return np.clip(np.rint(1 + np.log2(worth / step + 1)), FEWEST, MOST).astype(np.uint8)


def _rows(cells: Cells, n: int) -> F64:
    """How many rows of mode n each of its clusters has, `[C_n, PC_-n, R_n]`."""
    counts = np.bincount(cells.members[n][:, 0], minlength=cells.spec.clusters[n]).astype(np.float64)
    return np.broadcast_to(counts[:, None, None], (cells.spec.clusters[n], *cells.bases[n].shape[2:]))
