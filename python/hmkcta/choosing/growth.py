"""Ranks that whole blocks will want, told from blocks of which rows were left out.

What half the rows need of a rank tells what twice the rows will: no more where they are smooth, twice as much where
they are noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log, prod

import numpy as np
from numpy.typing import NDArray

from .spectra import Ladder, Values, cores, energies

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

#: Errors below this share of the energy are not told apart.
LEAST = 1e-12


@dataclass(frozen=True, eq=False)
class Growth:
    """How the rank for a given share of error grows with the rows of a block, told by halving the rows of thinned ones.

    Attributes:
        left: for each mode the logarithm of the share of error that each rank leaves of the thinned blocks.
        halved: the same of every second of their rows.
        edges: rows of each mode of whole blocks.
        turns: how often rows were halved from whole blocks to thinned ones, a real number.
    """

    left: tuple[F64, ...]
    halved: tuple[F64, ...]
    edges: tuple[int, ...]
    turns: float

    def unthinned(self, ladders: Sequence[Ladder]) -> tuple[Ladder, ...]:
        """For the ranks of each mode those at which whole blocks are left with the same share of error."""
        return tuple(map(self._unthinned, ladders, self.left, self.halved, self.edges))

    def _unthinned(self, ladder: Ladder, left: F64, halved: F64, edge: int) -> Ladder:
        ranks = np.array(ladder, np.float64)
        # The rank of half the rows that leaves as much, between two of them on a line of logarithms.
        same = np.interp(-left[np.minimum(ladder, len(left)) - 1], -halved, np.arange(1.0, len(halved) + 1))
        grown = np.maximum.accumulate(ranks * np.maximum(ranks / same, 1.0) ** self.turns)
        return tuple(int(rank) for rank in np.minimum(np.round(grown), edge))


def growth_of(batch: F32, core: Values, halved: F32, edges: Sequence[int]) -> Growth:
    """How ranks grow with the rows of blocks.

    Args:
        batch: thinned blocks, `[B, modes]`.
        core: their HOSVD cores, `[B, R_1, .., R_N]`.
        halved: the blocks with every second row along the axes that were thinned.
        edges: rows of each mode of whole blocks.

    >>> rows = np.random.default_rng(0).random((1, 40, 60), np.float32)
    >>> noise = growth_of(rows, cores(rows, (40, 40)), rows[:, ::2, ::2], (80, 120))
    >>> noise.unthinned([(1, 10, 20), (1,)])[0]
    (1, 18, 39)
    """
    have, fewer = batch.shape[1:], halved.shape[1:]
    smaller = cores(halved, [min(rank, size) for rank, size in zip(core.shape[1:], fewer, strict=True)], core.dtype)
    turns = log(prod(edges) / prod(have)) / log(prod(have) / prod(fewer))
    return Growth(_left(batch, core), _left(halved, smaller), tuple(edges), turns)


def _left(batch: F32, core: Values) -> tuple[F64, ...]:
    """Of each mode the logarithm of the share of error that each rank leaves."""
    energy, kept = float(energies(batch, core.dtype).sum()), np.zeros(core.shape[1:])
    for block in core:
        kept += np.square(block, dtype=np.float64)
    found = list[F64]()
    for n in range(kept.ndim):
        own: F64 = kept.sum(axis=tuple(m for m in range(kept.ndim) if m != n))
        # Of a mode with all ranks the core holds everything but what other modes leave.
        total = float(own.sum()) if kept.shape[n] == batch.shape[1 + n] else energy
        found.append(np.log(np.maximum((total - np.cumsum(own)) / max(energy, 1e-300), LEAST)))
    return tuple(found)
