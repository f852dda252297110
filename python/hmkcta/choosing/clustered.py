"""Clusters of the data as cells: matrices whose long mode is parted by k-means or K-subspaces, judged on some.

Rows that are alike, as pixels of one material are, share a few columns of a basis that others have no use for: local
PCA. Blocks say little about them where they are scattered over all of the array.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from math import log2, prod

import numpy as np
from numpy.typing import NDArray

from ..axes import Organisation, mode_sizes
from ..fitting.memberships import CANDIDATES, FEW_COLUMNS, balanced_clusters, normalised, row_features, some_dimensions
from ..fitting.subspaces import subspace_clusters
from ..plan import MOST_RANKS
from ..ranks.allocation import best_of_one, choices_of, pareto
from ..support.executors import in_order
from ..support.slabs import thinning
from .blocks import organised
from .candidates import Candidate, Scored
from .judging import Ranked, Search, worth_of
from .trial import OUT_OF_REACH, Trial

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

#: Numbers of clusters that may be looked at.
COUNTS = (4, 8, 16, 32, 64)
#: The one that is looked at first.
FIRST = 16
#: Matrices of rows with more columns are not looked at.
MOST_COLUMNS = 512
#: Most rows of the sample.
MOST_ROWS = 1 << 13
#: Elements of the array of which these are drawn.
DRAWN_FROM = 1 << 22
#: Elements of the sample for a size and for an SNR, which takes higher ranks: of few rows a cluster only low ranks are
#: told.
SAMPLE = (1 << 20, 1 << 21)
#: How many times fewer rows are looked at to tell which matrices to look at further.
FEW = 8
# The following are in dB, or octaves of bytes (`trial.Trial`).
#: Clusters are taken if they bring so much more than the best without them: less may be chance, as a sample tells it.
SURELY = 0.1
#: Matrices that are worth so much less than the best, without clusters, are not looked at with them.
SURPASSED = 6.0
#: What lies no further apart is not told apart here: of the best with clusters and the best without fits tell.
CLOSE = 1.5
#: Further numbers of clusters are not looked at where all so far, and none, are worth so much less than the best.
LACKING = 8.0
#: Rows of the sample that a cluster has at the least, on average.
FEWEST_ROWS = 24
#: How rows are normalised before k-means.
LIKELIEST = CANDIDATES[0]


def with_clusters(search: Search, found: Scored) -> Scored:
    """The better of what was found and the best matrix with clusters of the data along its long mode.

    The next best is a rival where it is near. Of all matrices the best are looked at, and those that a few rows say to
    be the best with clusters, if not too long for it: what parts their clusters, no axis brings together.
    """
    source, worth = search.goal.source, dict[Organisation, float]()
    for key, ranked in search.seen.items():
        modes = key.organisation
        if len(modes) == 2 and min(mode_sizes(source.axes, modes)) <= MOST_COLUMNS:
            same = map(worth_of, ranked) if key.size == search.goal.size else ()
            worth[modes] = max([worth.get(modes, 0.0), *same])
    least = found.worth - search.care.patience * SURPASSED
    best = sorted((modes for modes in worth if worth[modes] > least), key=lambda modes: -worth[modes])
    judged: Ranked = []
    likely = _likely(search, list(worth), found.worth - search.care.patience * LACKING)
    for modes in dict.fromkeys([*best[: search.clustered], *likely]):
        for item in clustered(search.goal, modes, threads=search.threads):
            judged.append(item)
            if modes not in likely and max(worth[modes], *map(worth_of, judged)) < found.worth - LACKING:
                break
    first = max(judged, key=worth_of, default=None)
    if first is None or first.worth < found.worth - CLOSE:
        return found
    winner = first if first.worth > found.worth + SURELY else found
    # For an SNR a rank is a step, which some other number of clusters may have smaller.
    compared = [found, *(judged if search.goal.ceiling is not None else [first])]
    other = max((item for item in compared if item is not winner), key=worth_of)
    search.rivals = [other.candidate] if other.worth > winner.worth - CLOSE else []
    return winner


def _likely(search: Search, matrices: Sequence[Organisation], least: float) -> list[Organisation]:
    """Matrices that are worth most with clusters, told from a few rows: as many as are to be looked at further, and as
    many again where these rows hardly tell them apart.

    What they are worth without says little of it: the best with clusters may then be 10 dB behind. As little say a few
    clusters of many, where each is a line.
    """
    if not matrices or not search.clustered:
        return []

    def worth_with(modes: Organisation) -> float:
        return max(map(worth_of, clustered(search.goal, modes, few=True)), default=-OUT_OF_REACH)

    worth = dict(zip(matrices, in_order(worth_with, matrices, search.threads), strict=True))
    least = max(least, sorted(worth.values())[-search.clustered :][0] - CLOSE)
    likely = sorted((modes for modes in worth if worth[modes] > least), key=lambda modes: -worth[modes])
    return likely[: 2 * search.clustered]


def clustered(
    trial: Trial, organisation: Organisation, *, few: bool = False, threads: int = 1
) -> Iterator[Scored]:
    """What the matrices of two modes are worth with so many clusters of the rows of the longer one, at the best ranks.

    The shorter mode is left undecomposed: each cell has columns of its own. From the first number of clusters on, twice
    and half as many are looked at while that helps; of few columns, where a rank is a large step, all. `few` rows tell
    less, and are looked at with the first and with most.
    """
    sizes = mode_sizes(trial.source.axes, organisation)
    if len(sizes) != 2 or min(sizes) > MOST_COLUMNS or min(sizes) < 2:
        return
    long = int(sizes[1] > sizes[0])
    rows = _sampled_rows(trial, organisation, long, FEW if few else 1)
    possible = [count for count in COUNTS if len(rows) >= FEWEST_ROWS * count]
    if not possible or not rows.any():
        return
    first, columns = min(len(possible) - 1, COUNTS.index(FIRST)), rows.shape[1]
    features = normalised(row_features(rows, 0), LIKELIEST[0])
    judged = partial(_judged, trial, organisation, rows, features, long=long, few=few, threads=threads)
    begun = judged(possible[first])
    yield begun
    if few:
        yield from map(judged, possible[first + 1 :][-1:])
        return
    for way in (possible[first + 1 :], possible[:first][::-1]):
        reached = begun.worth
        for count in way:
            item = judged(count)
            yield item
            if item.worth <= reached and columns > FEW_COLUMNS:
                break
            reached = item.worth


def _judged(
    trial: Trial, organisation: Organisation, rows: F32, features: F64, count: int,
    *, long: int, few: bool, threads: int,
) -> Scored:
    """What so many clusters of the long mode are worth, told from some of its rows: by k-means and by subspaces, as the
    fit has both; if `few`, by lines alone."""
    sizes, flags = mode_sizes(trial.source.axes, organisation), (long == 1, long == 0)
    clusters = (1, count) if long else (count, 1)
    ones = (1,) * len(trial.source.shape)
    each = Candidate(organisation, ones, (1 - long,), carried=False, clusters=clusters, bits=trial.bits)
    limit = min(MOST_RANKS, trial.decode_cost, len(rows) // (2 * count), rows.shape[1])
    steps = tuple((1,) if flag else tuple(range(1, limit + 1)) for flag in flags)
    choices = choices_of(steps, sizes, flags, trial.decode_cost, clusters, trial.stored_bits)
    least = float(choices.nbytes[1])
    if (needed := trial.beside(each) + least) > trial.size:
        return Scored(-OUT_OF_REACH - log2(needed), each)
    energy = float(np.square(rows, dtype=np.float64).sum())

    def left_by(dimension: int) -> F64:
        rng = np.random.default_rng(trial.seed)
        labels = (subspace_clusters(rows, count, dimension, rng, restarts=1) if dimension
                  else balanced_clusters(features, count, LIKELIEST[1], rng))  # fmt: skip
        return _left(rows, labels, limit, trial.seed)

    more = () if few else some_dimensions(rows.shape[1])
    dimensions = tuple(dict.fromkeys((0, 1, *more)))

    def reached_by() -> F64:
        return np.minimum.reduce(list(in_order(left_by, dimensions, threads)))

    reached = trial.samples.once((organisation, few, len(rows), count, limit, dimensions), reached_by)
    left = np.concatenate([[energy], reached[choices.entry]])
    kept = pareto(choices.nbytes, left)
    spend = partial(best_of_one, choices.nbytes[kept], left[kept])
    return Scored(trial.worth_and_bytes(spend, energy, 1.0, each, least)[0], each)


def _sampled_rows(trial: Trial, organisation: Organisation, long: int, fewer: int) -> F32:
    """Some rows of the long mode, all columns; so many times fewer than are usual.

    They are drawn: what moves by so many rows a frame is the same in all rows of a grid.
    """
    source = trial.source
    along = [n for n, axis in enumerate(source.axes) if axis.name in organisation[long]]
    columns = prod(source.shape) // prod(source.shape[n] for n in along)
    thinned = thinning([source.shape[n] for n in along], max(1, DRAWN_FROM // (fewer * columns)))
    steps = dict(zip(along, thinned, strict=True))
    part = tuple(slice(None, None, steps.get(n, 1)) for n in range(len(source.shape)))
    values = source.values(part) if (held := trial.samples.values) is None else held[part]
    matrix = organised(values[None], source.axes, organisation)[0]
    rows = matrix.T if long else matrix
    most = max(1, min(MOST_ROWS, SAMPLE[trial.ceiling is not None] // (fewer * columns)))
    if len(rows) > most:
        rows = rows[np.sort(np.random.default_rng(trial.seed).permutation(len(rows))[:most])]
    return np.ascontiguousarray(rows)


def _left(rows: F32, labels: NDArray[np.intp], limit: int, seed: int) -> F64:
    """Squared error at each rank: what leading columns found in most rows of each cluster leave of the others.

    Of the rows that they were found in they would leave too little, as clusters of a sample have few.
    """
    held = np.random.default_rng(seed).permutation(len(rows)) < len(rows) // 4
    parts = [labels == c for c in range(int(labels.max()) + 1)]
    left = np.sum([_left_of(rows[part & ~held], rows[part & held], limit) for part in parts], axis=0)
    return left * len(rows) / max(1, int(held.sum()))


def _left_of(seen: F32, others: F32, limit: int) -> F64:
    """What the leading right singular vectors of the rows `seen` leave of the others, at each rank."""
    total = float(np.square(others, dtype=np.float64).sum())
    basis = _leading(seen.astype(np.float64), limit)
    kept = np.cumsum(np.square(others @ basis).sum(axis=0))
    kept = np.concatenate([kept, np.full(limit - len(kept), kept[-1] if len(kept) else 0.0)])
    return np.maximum(total - kept, 0.0)


def _leading(rows: F64, limit: int) -> F64:
    """Leading right singular vectors as columns, up to the rank; of Gram matrices, as that is fast."""
    if len(rows) > rows.shape[1]:
        return np.linalg.eigh(rows.T @ rows)[1][:, : -limit - 1 : -1]
    squares, vectors = np.linalg.eigh(rows @ rows.T)
    told = squares > 1e-12 * max(squares[-1], 0.0) if len(rows) else squares > 0
    return (rows.T @ vectors[:, told] / np.sqrt(squares[told]))[:, : -limit - 1 : -1]
