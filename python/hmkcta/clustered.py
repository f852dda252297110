"""Clusters of the data as cells: matrices whose long mode is parted by k-means, judged on a sample of its rows.

Rows that are alike, as pixels of one material are, share a few columns of a basis that others have no use for: local
PCA. Blocks say little about them where they are scattered over all of the array.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from math import prod

import numpy as np
from numpy.typing import NDArray

from .allocation import best_of_one, choices_of, pareto
from .axes import Organisation, mode_sizes
from .blocks import organised
from .candidates import Candidate
from .memberships import start_candidates
from .plan import MOST_RANKS
from .slabs import thinning
from .trial import Trial

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

#: Numbers of clusters to look at, the likeliest first, most columns of the rows, and elements of the sample.
COUNTS, MOST_COLUMNS, SAMPLE = (16, 32, 64, 8, 4), 512, 1 << 19
#: Rows of the sample that a cluster has at the least, on average.
FEWEST_ROWS = 24
#: Ways to scale rows before k-means, of `memberships.CANDIDATES`.
SCALED = 1


def clustered(trial: Trial, organisation: Organisation) -> Iterator[tuple[float, Candidate]]:
    """What the matrices of two modes are worth with so many clusters of the rows of the longer one, at the best ranks.

    The shorter mode is left undecomposed: each cell has columns of its own.
    """
    sizes = mode_sizes(trial.source.axes, organisation)
    if len(sizes) != 2 or min(sizes) > MOST_COLUMNS or min(sizes) < 2:
        return
    long = int(sizes[1] > sizes[0])
    rows = _sampled_rows(trial, organisation, long)
    energy = float(np.square(rows, dtype=np.float64).sum())
    flags = (long == 1, long == 0)
    plain = Candidate(organisation, (1,) * len(trial.source.shape), (1 - long,), carried=False)
    for count in (count for count in COUNTS if len(rows) >= FEWEST_ROWS * count and energy > 0):
        clusters = (1, count) if long else (count, 1)
        limit = min(MOST_RANKS, trial.decode_cost, len(rows) // (2 * count), rows.shape[1])
        steps = tuple((1,) if flag else tuple(range(1, limit + 1)) for flag in flags)
        choices = choices_of(steps, sizes, flags, trial.decode_cost, clusters)
        left = np.concatenate([[energy], _left(rows, count, limit, trial.seed)[choices.entry]])
        kept = pareto(choices.nbytes, left)
        spend = partial(best_of_one, choices.nbytes[kept], left[kept])
        each = replace(plain, clusters=clusters)
        yield trial.worth_of(spend, energy, 1.0, trial.beside(each), float(choices.nbytes[1]))[0], each


def _sampled_rows(trial: Trial, organisation: Organisation, long: int) -> F32:
    """Every few rows of the long mode, all columns."""
    source = trial.source
    along = [n for n, axis in enumerate(source.axes) if axis.name in organisation[long]]
    columns = prod(source.shape) // prod(source.shape[n] for n in along)
    steps = dict(zip(along, thinning([source.shape[n] for n in along], max(1, SAMPLE // columns)), strict=True))
    part = tuple(slice(None, None, steps.get(n, 1)) for n in range(len(source.shape)))
    values = source.values(part) if trial.values is None else trial.values[part]
    matrix = organised(values[None], source.axes, organisation)[0]
    return np.ascontiguousarray(matrix.T if long else matrix)


def _left(rows: F32, count: int, limit: int, seed: int) -> F64:
    """Squared error at each rank: what leading columns found in most rows of each cluster leave of the others.

    Of the rows that they were found in they would leave too little, as clusters of a sample have few.
    """
    rng = np.random.default_rng(seed)
    held = rng.permutation(len(rows)) < len(rows) // 4
    found: list[F64] = []
    starts = start_candidates(rows, (count, 1), 1 + SCALED, rng)
    for labels, _ in list(starts)[1:]:
        left = np.zeros(limit)
        for c in range(count):
            left += _left_of(rows[(labels == c) & ~held], rows[(labels == c) & held], limit)
        found.append(left * len(rows) / max(1, int(held.sum())))
    return min(found, key=lambda left: float(left[len(left) // 4]))


def _left_of(seen: F32, others: F32, limit: int) -> F64:
    """What the leading right singular vectors of the rows `seen` leave of the others, at each rank."""
    total = float(np.square(others, dtype=np.float64).sum())
    basis = np.linalg.svd(seen.astype(np.float64), full_matrices=False)[2][:limit] if len(seen) else seen[:0]
    kept = np.cumsum(np.square(others @ basis.T).sum(axis=0))
    kept = np.concatenate([kept, np.full(limit - len(kept), kept[-1] if len(kept) else 0.0)])
    return np.maximum(total - kept, 0.0)
