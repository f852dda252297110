"""Numbers of a packed level: how fine the steps of each column of a basis are worth to be, and those of core numbers.

What rounding leaves is least, for the bits that are spent, where every number leaves as much (reverse water-filling):
then a column whose numbers count for twice as much has steps half as large. How much they count for is told by the
core, and how much all of them together may leave is a share of what the ranks leave (`LevelSpec.own_bits`).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32, F64
from ..cells import Cells, by_cells, by_columns, column_peaks, column_squares
from ..parameters import BELOW_ONE
from ..rice import MOST, PARAMETERS, code_bits, folded

#: Steps of a column's largest number, at the least and at the most.
FEWEST, FINEST_STEPS = 1.0, 2048.0
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
    bases, cores, lengths = list(cells.bases), cells.cores.astype(np.float64), np.ones(())
    for n, own in enumerate(squares):
        if own is not None:
            steps = _column_steps(cells, n, own, held, step)
            bases[n], factor = _in_steps(cells, n, steps)
            each = by_cells(cells, n, factor)
            cores *= _along(each, n, cores.ndim)
            # A number of a core counts for as much as the columns that it stands for are long.
            lengths = lengths * (own / np.maximum(np.square(each), _LEAST)).mean(axis=1)
    of_core = step / np.sqrt(np.maximum(np.broadcast_to(lengths, len(cores)), _LEAST))
    return Cells(cells.sizes, cells.spec, cells.members, bases, whole_steps(cores, of_core))


def _step(cells: Cells, left: float) -> float:
    """The step between stored numbers, in what they count for, whose rounding leaves a share of what is `left`."""
    numbers = cells.cores.size + sum(basis.size for basis in cells.bases)
    return sqrt(12 * cells.spec.own_bits * left / numbers)


def _column_steps(cells: Cells, n: int, squares: F64, held: F64, step: float) -> F64:
    """Steps of the columns of mode n, `[C_n, PC_-n, R_n]`, each number of which counts for about `step`."""
    others = tuple(m + 1 for m in range(cells.order) if m != n)
    counts = np.sqrt(held.sum(axis=others) / np.maximum(squares, _LEAST))  # of a column of length 1, `[PC, R_n]`
    peaks = column_peaks(cells, n).astype(np.float64)
    steps = step / np.maximum(by_columns(cells, n, counts), _LEAST)
    steps = np.clip(steps, peaks / FINEST_STEPS, peaks / FEWEST)
    return np.where(_is_flat(cells, n, peaks), peaks, steps)


def _is_flat(cells: Cells, n: int, peaks: F64) -> NDArray[np.bool_]:
    """Whether the numbers of each column `[R_n]` are all 0 or as large as its largest, which few bits hold exactly."""
    sizes, largest = np.abs(cells.bases[n][:, 0]), peaks[cells.members[n][:, 0]]
    return np.all((sizes < FLAT * largest) | (sizes > (1 - FLAT) * largest), axis=(0, 1))


def _in_steps(cells: Cells, n: int, steps: F64) -> tuple[F32, F64]:
    """Bases in whole steps, q / 2^(k+2) where codes of parameter k are shortest; what columns are to be multiplied by.

    The parameter is that of a column in all cells.
    """
    each = np.where(steps > 0, steps, 1.0)[cells.members[n]]
    whole = np.rint(cells.bases[n] / each).astype(np.float16)
    k = _parameters(whole.reshape(-1, whole.shape[-1]))
    unit = np.ldexp(1.0, k + BELOW_ONE)
    return (whole / unit).astype(np.float32), np.where(steps > 0, steps, 1.0) * unit


def _parameters(whole: NDArray[np.float16]) -> NDArray[np.int64]:
    """The parameter of each column `[.., R]` of whole numbers for which its codes are shortest."""
    z = folded(whole)
    about = np.rint(np.log2(np.maximum(z.mean(axis=0, dtype=np.float64), 0.5))).astype(np.int64)
    tried = np.clip(about + np.array([[-1], [0], [1]]), 0, PARAMETERS - 1)
    taken = [code_bits(z, each.astype(np.uint8)).sum(axis=0, dtype=np.int64) for each in tried]
    return tried[np.argmin(taken, axis=0), np.arange(about.size)]


def whole_steps(cores: F64 | F32, steps: F64) -> F32:
    """Cores `[PC, ..]`, each cell in nearest multiples of about its step: numbers of steps that float16 holds.

    The largest number of a cell is as many steps as are nearest. Float32 holds any number of them, so that a fit can be
    brought as near to an SNR as it is asked for, and a cell's only core number, or one like all others, is as it was.
    """
    each = cores.reshape(len(cores), -1).astype(np.float64)
    peak = np.abs(each).max(axis=1, initial=0.0)
    most = np.minimum(np.rint(peak / np.maximum(steps, _LEAST)), MOST - 1)
    about = np.where(most > 0, peak, 1.0) / np.maximum(most, 1)
    exponent = np.maximum(np.frexp(about)[1] - _STEP_BITS, _FINEST_EXPONENT)
    stored = np.ldexp(np.maximum(np.rint(np.ldexp(about, -exponent)), 1), exponent)
    whole = np.rint(np.where(most > 0, 1.0, 0.0)[:, None] * each / stored[:, None]).astype(np.float16)
    return (whole.astype(np.float64) * stored[:, None]).astype(np.float32).reshape(cores.shape)


def _along(each: F64, n: int, dimensions: int) -> F64:
    """Numbers `[PC, R_n]` in the shape of cores."""
    shape = [len(each), *[1] * (dimensions - 1)]
    shape[n + 1] = each.shape[1]
    return each.reshape(shape)


def _squares(cells: Cells) -> list[F64 | None]:
    """Squared lengths of the columns of each cell, `[PC, R_n]` of every mode; None where it is undecomposed."""
    return [None if skip else by_cells(cells, n, column_squares(cells, n)) for n, skip in enumerate(cells.undecomposed)]


def _held(cells: Cells, squares: Sequence[F64 | None]) -> F64:
    """What each core number holds of the tensor's energy, `[PC, R_1, .., R_N]`."""
    held = np.square(cells.cores, dtype=np.float64)
    for n, own in enumerate(squares):
        if own is not None:
            held *= _along(own, n, held.ndim)
    return held
