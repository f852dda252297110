"""HOSVD cores of many blocks of one shape at once, and the energy that they capture at a choice of ranks.

It is what `tucker.full_core` finds of one tensor exactly, found faster where only comparisons hang on it: columns are
thinned where there are far more than rows, and high ranks are looked at in steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import gcd, prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Values = NDArray[np.floating]
Ladder = tuple[int, ...]

#: Most choices of ranks that are looked at of a block, for many blocks and for up to eight.
FEW_CHOICES = 2_500
CHOICES = 10_000
#: Factors by which a rank may grow from one that is looked at to the next: the first that makes few enough choices is
#: taken.
GROWTH = (1.0, 1.08, 1.12, 1.16, 1.2, 1.25, 1.3, 1.35, 1.42, 1.5, 1.6, 1.8, 2.2)
#: Squares summed at once.
TERMS = 1024
#: Side of Gram matrices up to which they are decomposed; of larger ones a subspace is iterated.
SIDE = 160
#: How many dimensions it has beyond the rank that is wanted.
BESIDE = 16
#: How often it is iterated.
ITERATIONS = 1
#: Rank of the first such subspace where fewer ranks may be enough.
FIRST = 48
#: How many times as large each further one is.
WIDER = 4
#: Rows that are transposed at once: float32 numbers of a cache line.
LINE = 16
#: Columns that are looked at to find singular vectors, for each row of an unfolding.
COLUMNS = 64
#: Columns that are looked at at the least.
LEAST_COLUMNS = 16384


def ladders(limits: Sequence[int], blocks: int = 1) -> list[Ladder]:
    """Ranks to look at of each mode up to its limit: all, or with growing steps where there would be too many choices.

    >>> ladders([3, 4])
    [(1, 2, 3), (1, 2, 3, 4)]
    """
    most = max(FEW_CHOICES, min(CHOICES, 8 * CHOICES // blocks))
    tried = ([_ladder(limit, growth) for limit in limits] for growth in GROWTH)
    return next((found for found in tried if prod(map(len, found)) <= most), [_ladder(limit, 3.0) for limit in limits])


def _ladder(limit: int, growth: float) -> Ladder:
    ranks = [1]
    while ranks[-1] < limit:
        ranks.append(min(limit, max(ranks[-1] + 1, int(ranks[-1] * growth))))
    return tuple(ranks)


def cores(batch: F32, limits: Sequence[int | None], dtype: Any = np.float32, enough: float = 0.0) -> Values:
    """Blocks `[B, I_1, .., I_N]` rotated into their leading singular vectors: `[B, R_1, .., R_N]`; None: not rotated.

    They are rotated in `dtype`: beyond some 60 dB the rounding of the largest elements to float32 is more than what
    ranks leave. Ranks of a single block may end where they leave a share of its energy that is small `enough`.
    """
    order = batch.ndim - 1
    sizes = batch.shape[1:]
    first = min(range(order), key=lambda n: (limits[n] or sizes[n]) / sizes[n])
    turn = [(first + k) % order for k in range(order)]
    core: Values = _turned(batch, first)
    beyond = enough * float(energies(batch, dtype).sum()) if len(batch) == 1 else 0.0
    for at, n in enumerate(turn):
        limit, rest = limits[n], core.shape[2:]
        unfolded = core.reshape(len(core), core.shape[1], -1)  # the turn brings each mode to the front
        still = prod(rest[: order - 1 - at])  # columns as they come; those of rotated modes are no sample
        rotated = unfolded.swapaxes(1, 2) if limit is None else _rotated(unfolded, limit, still, dtype, beyond)
        core = np.ascontiguousarray(rotated).reshape(len(core), *rest, rotated.shape[2])
    return core.transpose(0, *(1 + turn.index(n) for n in range(order)))


def _turned(batch: F32, first: int) -> F32:
    """The blocks with the modes before the `first` behind all others, in one piece."""
    order = batch.ndim - 1
    matrices = batch.reshape(len(batch), prod(batch.shape[1 : 1 + first]), -1)
    turned = np.empty(matrices.swapaxes(1, 2).shape, batch.dtype)
    for start in range(0, matrices.shape[1], LINE):  # what is read and written stays in the cache
        turned[:, :, start : start + LINE] = matrices[:, start : start + LINE].swapaxes(1, 2)
    return turned.reshape(len(batch), *(batch.shape[1 + (first + k) % order] for k in range(order)))


def _rotated(unfolded: Values, limit: int, still: int, dtype: Any, beyond: float) -> Values:
    """``A^T U`` of every unfolding `[rows, columns]`, U being its leading left singular vectors.

    Of the columns, in so many groups of which each `still` is like the others, some groups are enough to find U. Fewer
    vectors than the limit may do where they are iterated, and leave no more than what is `beyond` notice.
    """
    rows, columns = unfolded.shape[1:]
    unfolded = unfolded.astype(dtype, copy=False)
    if min(rows, columns) > SIDE and limit + BESIDE < min(rows, columns) // 2:
        return _wide_enough(unfolded, limit, beyond)
    if rows <= columns:
        step = _coprime_step(min(still // 64, columns // max(COLUMNS * rows, LEAST_COLUMNS)), still)
        thin = unfolded.reshape(*unfolded.shape[:2], still, -1)[:, :, ::step].reshape(*unfolded.shape[:2], -1)
        vectors = np.linalg.eigh(thin @ thin.swapaxes(1, 2))[1]
        return unfolded.swapaxes(1, 2) @ vectors[:, :, : -limit - 1 : -1]
    squares, vectors = np.linalg.eigh(unfolded.swapaxes(1, 2) @ unfolded)
    return (vectors * np.sqrt(np.maximum(squares, 0))[:, None])[:, :, : -limit - 1 : -1]


def _coprime_step(step: int, length: int) -> int:
    """A step of about so many columns that does not beat with the lengths of merged modes."""
    while step > 1 and gcd(step, length) > 1:
        step -= 1
    return max(1, step)


def _wide_enough(unfolded: Values, limit: int, beyond: float) -> Values:
    """As `_iterated`, of the first of some growing ranks that leaves little; of the limit where none does."""
    rank, energy = FIRST, float(energies(unfolded, unfolded.dtype).sum())
    while beyond > 0 and rank * WIDER <= limit:
        found = _iterated(unfolded, rank)
        if energy - float(energies(found, found.dtype).sum()) <= beyond:
            return found
        rank *= WIDER
    return _iterated(unfolded, limit)


def _iterated(unfolded: Values, limit: int) -> Values:
    """As `_rotated`, by subspace iteration from random mixtures of all columns."""
    flipped = unfolded.swapaxes(1, 2)
    mixed = unfolded @ _signs(unfolded.shape[2], limit + BESIDE).astype(unfolded.dtype)
    for _ in range(ITERATIONS):
        mixed = unfolded @ (flipped @ _orthonormal(mixed))
    seen = flipped @ _orthonormal(mixed)
    vectors = np.linalg.eigh((seen.swapaxes(1, 2) @ seen).astype(np.float64))[1]
    return np.asarray(seen @ vectors[:, :, : -limit - 1 : -1], unfolded.dtype)


def _orthonormal(matrix: Values) -> Values:
    """An orthonormal basis; of float32 by Cholesky, which is faster, and has short vectors where columns depend on each
    other: what is 60 dB below others is lost."""
    if matrix.dtype == np.float64:
        return np.linalg.qr(matrix)[0]
    wide: F64 = matrix.astype(np.float64)
    gram: F64 = wide.swapaxes(1, 2) @ wide
    least: F64 = 1e-12 * np.einsum("bii->b", gram) + 1e-300
    factor = np.linalg.cholesky(gram + least[:, None, None] * np.eye(gram.shape[1]))
    inverse = np.linalg.inv(np.asarray(factor, np.float64))
    return (wide @ inverse.swapaxes(1, 2)).astype(matrix.dtype)


def _signs(rows: int, columns: int) -> F32:
    return np.random.default_rng(0).choice(np.array([-1, 1], np.float32), (rows, columns))


def captured(core: Values, steps: Sequence[Ladder | None]) -> F64:
    """Energy that HOSVD captures at each choice of ranks: `[B, entries of each ladder]`; None: all rows of the mode."""
    table: Any = np.square(core)
    lengths = [1 if own is None else len(own) for own in steps]
    for n in sorted(range(len(steps)), key=lambda n: lengths[n] / core.shape[1 + n]):
        # Sums of few squares may be of float32, sums of these may not.
        sums = _sums(table.shape[1 + n], steps[n]).astype(table.dtype)
        shape = table.shape
        table = sums @ table.reshape(prod(shape[: 1 + n]), shape[1 + n], -1)
        table = table.reshape(*shape[: 1 + n], lengths[n], *shape[2 + n :]).astype(np.float64, copy=False)
    for n in range(len(steps)):
        np.cumsum(table, axis=1 + n, out=table)
    return table


def _sums(rows: int, ranks: Ladder | None) -> F64:
    """Matrix `[entries, rows]` that adds up the rows between one rank and the next; None: all."""
    ends = np.array([rows] if ranks is None else ranks)
    starts = np.concatenate([[0], ends[:-1]])
    row = np.arange(rows)
    return ((row >= starts[:, None]) & (row < ends[:, None])).astype(np.float64)


def energies(batch: Values, dtype: Any = np.float32) -> F64:
    """Squared norm of every block, of sums in `dtype` of some terms each."""
    flat = batch.reshape(len(batch), -1)
    whole = flat.shape[1] // TERMS * TERMS
    first = flat[:, :whole].reshape(len(flat), -1, TERMS)
    rest = np.square(flat[:, whole:], dtype=np.float64).sum(axis=1)
    return np.einsum("bci,bci->bc", first, first, dtype=dtype).sum(axis=1, dtype=np.float64) + rest
