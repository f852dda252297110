"""Numbers of a packed level: how many bits each column of a basis is worth, and the step between core numbers.

What rounding leaves is least, for the bits that are spent, where every number leaves as much (reverse water-filling):
then a column whose numbers count for twice as much has one bit more. How much they count for is told by the core, and
how much all of them together may leave is a share of what the ranks leave (`LevelSpec.own_bits`).
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from math import frexp, ldexp, sqrt

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32, F64
from ..bitstream import U8
from ..cells import Cells, by_cells, column_peaks, column_squares, scaled_columns
from ..widths import MOST_OF_BASIS, MOST_OF_CORE

#: Fewest bits of a column.
FEWEST = 2
#: Share of the energy below which float32 does not tell what is left.
FINEST = 1e-13
#: What numbers differ by at most, as a share of the largest, that are alike.
FLAT = 1e-5
#: Bits of the step between core numbers: float32 holds these and the eleven of float16.
_STEP_BITS = 13
#: Of the least float32 number.
_FINEST_EXPONENT = -149
#: In place of a step or a length of 0: quotients and logarithms of what float32 holds stay finite.
_LEAST = 1e-250


def left_of(cells: Cells, energy: float) -> float:
    """Squared error that the cells leave of a tensor of this squared norm, as far as float32 tells."""
    return max(energy - float(_held(cells, _squares(cells)).sum()), FINEST * energy)


def rounded_by_columns(cells: Cells, left: float) -> Cells:
    """The cells as a packed level stores them, if so much error is `left` by their ranks (K = 1).

    Columns are taken to be orthogonal, as after a sweep over cells that share no element.
    """
    squares = _squares(cells)
    held = _held(cells, squares)
    step = _step(cells, max(left, FINEST * float(held.sum())))
    bits = _column_bits(cells, squares, held, step)
    bases, cores = scaled_columns(cells, bits)
    bases = [basis if own is None else _nearest(basis, own) for basis, own in zip(bases, bits, strict=True)]
    scaled = Cells(cells.sizes, cells.spec, cells.members, bases, cores)
    # A number of a core counts for as much as the columns that it stands for are long.
    lengths: list[F64] = [np.ones(1) if own is None else own.mean(axis=1) for own in _squares(scaled)]
    all_lengths: F64 = reduce(np.multiply, lengths)
    of_core = step / sqrt(max(float(all_lengths.mean()), _LEAST))
    scaled.cores = whole_steps(cores, of_core)
    return scaled


def _step(cells: Cells, left: float) -> float:
    """The step between stored numbers, in what they count for, whose rounding leaves a share of what is `left`."""
    numbers = cells.cores.size + sum(basis.size for basis in cells.bases)
    return sqrt(12 * cells.spec.own_bits * left / numbers)


def _column_bits(cells: Cells, squares: Sequence[F64 | None], held: F64, step: float) -> list[U8 | None]:
    """Bits of a number of each column `[R_n]` of every mode, for steps of about `step`; None: undecomposed."""
    bits = list[U8 | None]()
    for n, own in enumerate(squares):
        if own is None:
            bits.append(None)
            continue
        others = tuple(m + 1 for m in range(cells.order) if m != n)
        share = held.sum(axis=others) / np.maximum(own, _LEAST)  # of a column of length 1, `[PC, R_n]`
        rows, peaks = by_cells(cells, n, _rows(cells, n)), column_peaks(cells, n)
        largest = by_cells(cells, n, peaks).astype(np.float64)
        numbers = cells.bases[n].size // cells.ranks[n]
        worth = np.sqrt((rows * share * np.square(largest)).sum(axis=0) / max(numbers, 1))
        bits.append(np.where(_is_flat(cells, n, peaks), FEWEST, _bits(worth, step)).astype(np.uint8))
    return bits


def _is_flat(cells: Cells, n: int, peaks: F32) -> NDArray[np.bool_]:
    """Whether the numbers of each column `[R_n]` are all 0 or as large as its largest, which few bits hold exactly."""
    sizes, largest = np.abs(cells.bases[n][:, 0]), peaks[cells.members[n][:, 0]]
    return np.all((sizes < FLAT * largest) | (sizes > (1 - FLAT) * largest), axis=(0, 1))


def _nearest(basis: F32, bits: U8) -> F32:
    """The nearest numbers of each column's bits."""
    ones = np.exp2(bits.astype(np.float32) - 1)
    return (np.rint(basis * ones) / ones).astype(np.float32)


def whole_steps(cores: F32, step: float) -> F32:
    """The nearest multiples of about the step, of which float16 holds how many steps they are.

    The largest number is as many steps as are nearest. Float32 holds any number of them, so that a fit can be brought
    as near to an SNR as it is asked for, and a node's only core number, or one like all others, is as it was.
    """
    peak = float(np.abs(cores).max(initial=0.0))
    steps = min(round(peak / max(step, _LEAST)), 2 ** (MOST_OF_CORE - 1) - 1)
    if not steps:
        return np.zeros_like(cores)
    exponent = max(frexp(peak / steps)[1] - _STEP_BITS, _FINEST_EXPONENT)
    stored = max(round(ldexp(peak / steps, -exponent)), 1)
    whole = np.rint(np.ldexp(cores / np.float64(stored), -exponent)).astype(np.float16)
    return np.ldexp(whole.astype(np.float64) * stored, exponent).astype(np.float32)


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
    steps = worth / max(step, _LEAST)
    return np.clip(np.rint(1 + np.log2(steps + 1)), FEWEST, MOST_OF_BASIS).astype(np.uint8)


def _rows(cells: Cells, n: int) -> F64:
    """How many rows of mode n each of its clusters has, `[C_n, PC_-n, R_n]`."""
    counts = np.bincount(cells.members[n][:, 0], minlength=cells.spec.clusters[n]).astype(np.float64)
    return np.broadcast_to(counts[:, None, None], (cells.spec.clusters[n], *cells.bases[n].shape[2:]))
