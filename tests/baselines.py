"""The compressors to beat, at a byte budget and a bound on decode cost.

Matrix PCA, clustered PCA, whole-array HOSVD and uniform HOSVD bricks, written for strength: every
discrete choice (split, organisation, brick shape, ranks) is searched; headers, tables and scales
are free. Coefficients are float16. Decode cost is in multiply-adds for one scattered element:
`prod R_n`, for PCA the rank. SNRs, `10 log10(sum a^2 / sum (a-b)^2)`, are those of rounded factors.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Shape = tuple[int, ...]
Groups = tuple[Shape, ...]
BrickFit = tuple[list[FloatArray], list[IntArray], float, int]

COEFFICIENT_BYTES = 2
LABEL_BYTES = 2
CHANNELS = 3
SHORT_AXIS = 9
BRICK_EDGES = (8, 16, 32)


class Baseline(NamedTuple):
    """What a method reached: dB, bytes, multiply-adds an element, and the choice that won."""

    snr_db: float
    nbytes: int
    cost: int
    detail: str


class RateTable(NamedTuple):
    """Truncations open to a batch: errors (bricks, m), nbytes (m,), ranks (m, modes)."""

    errors: FloatArray
    nbytes: IntArray
    ranks: IntArray


NOTHING = Baseline(0.0, 0, 0, "nothing fits")


def snr_db(signal: float, error: float) -> float:
    """Signal-to-noise ratio in dB from two sums of squares; infinite without error."""
    return 10.0 * math.log10(signal / error) if signal > 0.0 and error > 0.0 else math.inf


def rounded(values: FloatArray) -> FloatArray:
    """Values as float16 keeps them; one scale holds them clear of its overflow and subnormals."""
    scale = 2.0**14 / float(np.max(np.abs(values), initial=1e-300))
    return (values * scale).astype(np.float16).astype(np.float64) / scale


def two_way_splits(order: int) -> Iterator[Groups]:
    """Each partition of axes 0..order-1 into two groups; axis 0 in the first, so none comes twice."""
    for size in range(order - 1):
        for others in itertools.combinations(range(1, order), size):
            first = (0, *others)
            yield first, tuple(axis for axis in range(order) if axis not in first)


def organisations(shape: Sequence[int]) -> list[Groups]:
    """Axes as they are, and with each axis of size 3 (a channel) merged into each other one."""
    singles: Groups = tuple((axis,) for axis in range(len(shape)))
    found: list[Groups] = [singles]
    for channel, other in itertools.permutations(range(len(shape)), 2):
        # Of two axes merging would leave one mode, which no decomposition compresses.
        if shape[channel] == CHANNELS and len(shape) > 2:
            merged = (((other, channel) if group == (other,) else group) for group in singles)
            found.append(tuple(group for group in merged if group != (channel,)))
    return found


def unite(batch: FloatArray, groups: Groups) -> FloatArray:
    """Merge the axes of each group into one mode: (bricks, *axes) -> (bricks, *modes)."""
    order = [1 + axis for group in groups for axis in group]
    modes = [math.prod(batch.shape[1 + axis] for axis in group) for group in groups]
    return batch.transpose(0, *order).reshape(len(batch), *modes)


def low_rank_factors(matrix: FloatArray, rank: int) -> tuple[FloatArray, FloatArray]:
    """Best factors (rows, rank), (cols, rank) of a matrix; that of the shorter side orthonormal."""
    if matrix.shape[0] < matrix.shape[1]:
        right, left = low_rank_factors(matrix.T, rank)
        return left, right
    right = np.linalg.eigh(matrix.T @ matrix)[1][:, ::-1][:, :rank]
    return matrix @ right, right


def pca_error(matrix: FloatArray, rank: int) -> float:
    """Sum of squared errors of a matrix rebuilt from its float16 PCA factors."""
    left, right = low_rank_factors(matrix, rank)
    return float(np.sum((matrix - rounded(left) @ rounded(right).T) ** 2))


def pca_splits(array: ArrayLike, budget: int, decode_cost: int) -> Baseline:
    """PCA of the best 2-way split of the axes, at the largest rank within budget (bytes) and cost."""
    values = np.asarray(array, np.float64)
    signal, best = float(np.sum(values**2)), NOTHING
    for groups in two_way_splits(values.ndim):
        matrix = unite(values[None], groups)[0]
        slope = COEFFICIENT_BYTES * sum(matrix.shape)
        rank = min(budget // slope, decode_cost, *matrix.shape)
        if rank > 0:
            result = Baseline(snr_db(signal, pca_error(matrix, rank)), slope * rank, rank, f"{groups[0]} x {groups[1]}")
            best = max(best, result)
    return best


def clustered_pca(array: ArrayLike, budget: int, decode_cost: int, clusters: int = 16, seed: int = 0) -> Baseline:
    """PCA per cluster of rows, the longer side of a 2-way split; with and without cluster means."""
    values = np.asarray(array, np.float64)
    signal, best = float(np.sum(values**2)), NOTHING
    for groups, mean in itertools.product(two_way_splits(values.ndim), (False, True)):
        matrix = unite(values[None], groups)[0]
        if matrix.shape[0] < matrix.shape[1]:
            groups, matrix = groups[::-1], matrix.T
        rows, cols = matrix.shape
        basis = COEFFICIENT_BYTES * clusters * cols
        fixed, slope = LABEL_BYTES * rows + mean * basis, COEFFICIENT_BYTES * rows + basis
        rank = min((budget - fixed) // slope, decode_cost, cols)
        # With means rank 0 is vector quantisation, without them it is nothing.
        if rank < 1 - mean or rows < clusters:
            continue
        labels = cluster_rows(matrix, clusters, rank, mean, np.random.default_rng(seed))
        parts = [matrix[labels == cluster] for cluster in np.unique(labels)]
        # The means are rounded first, so that their error is left to the PCA to mend.
        residuals = [part - rounded(part.mean(axis=0)) if mean else part for part in parts]
        snr = snr_db(signal, sum(pca_error(residual, rank) for residual in residuals))
        detail = f"clusters of {groups[0]} x {groups[1]}{', means' if mean else ''}"
        best = max(best, Baseline(snr, fixed + slope * rank, rank, detail))
    return best


def cluster_rows(matrix: FloatArray, clusters: int, rank: int, mean: bool, rng: np.random.Generator) -> IntArray:
    """Labels (rows,) by k-means, then by PCA per cluster and moves of rows to the best subspace."""
    # Distances are measured in a random sketch of the leading row space: the rest is the same to all.
    sketch = rng.standard_normal((matrix.shape[1], min(matrix.shape[1], 64 + rank)))
    for _ in range(2):
        sketch = np.linalg.qr(matrix.T @ (matrix @ sketch))[0]
    points = matrix @ sketch
    starts, nearest = [int(rng.integers(len(points)))], np.full(len(points), np.inf)
    while len(starts) < clusters:  # k-means++; the small odds are for rows that are all the same
        nearest = np.minimum(nearest, np.sum((points - points[starts[-1]]) ** 2, axis=1) + 1e-300)
        starts.append(int(rng.choice(len(points), p=nearest / nearest.sum())))
    spaces = [affine_space(points[[start]], 0, mean=True) for start in starts]
    for rank_now, mean_now in [(0, True)] * 10 + [(rank, mean)] * 5:
        labels = np.argmin([affine_distance(points, *space) for space in spaces], axis=0)
        parts = [points[labels == cluster] for cluster in range(clusters)]
        spaces = [affine_space(part, rank_now, mean_now) for part in parts]
    return np.argmin([affine_distance(points, *space) for space in spaces], axis=0)


def affine_space(points: FloatArray, rank: int, mean: bool) -> tuple[FloatArray, FloatArray]:
    """Center (d,), 0 unless `mean`, and orthonormal basis (d, <= rank) of points (n, d)."""
    center = points.mean(axis=0) if mean and len(points) else np.zeros(points.shape[1])
    if rank == 0 or len(points) == 0:
        return center, np.zeros((len(center), 0))
    return center, np.linalg.qr(low_rank_factors(points - center, rank)[1])[0]


def affine_distance(points: FloatArray, center: FloatArray, basis: FloatArray) -> FloatArray:
    """Squared distances (n,) of points (n, d) from center + span(basis), less their own norms."""
    inside = points @ basis - center @ basis
    return center @ center - 2.0 * (points @ center) - np.einsum("nr,nr->n", inside, inside)


def mode_product(batch: FloatArray, matrices: FloatArray, mode: int) -> FloatArray:
    """Multiply `mode` of every brick (bricks, *modes) by its matrix (bricks, out, in)."""
    moved = np.moveaxis(batch, mode + 1, 1)
    product = matrices @ moved.reshape(len(batch), moved.shape[1], -1)
    shape = (len(batch), matrices.shape[1], *moved.shape[2:])
    return np.moveaxis(product.reshape(shape), 1, mode + 1)


def leading_basis(batch: FloatArray, mode: int, rank: int) -> FloatArray:
    """Leading left singular vectors (bricks, I_mode, rank) of the mode's unfoldings."""
    moved = np.moveaxis(batch, mode + 1, 1)
    unfolded = moved.reshape(len(batch), moved.shape[1], -1)
    return np.linalg.eigh(unfolded @ unfolded.swapaxes(1, 2))[1][:, :, ::-1][:, :, :rank]


def project(batch: FloatArray, bases: Sequence[FloatArray], skip: int = -1) -> FloatArray:
    """Cores of the batch in orthonormal bases [(bricks, I_n, R_n)], mode `skip` left as it is."""
    for mode, basis in enumerate(bases):
        if mode != skip:
            batch = mode_product(batch, basis.swapaxes(1, 2), mode)
    return batch


def rate_table(batch: FloatArray, budget: int, decode_cost: int) -> RateTable:
    """All truncations of the bricks' HOSVDs (bricks, *modes) in bounds; ranks 0 drop the brick.

    Bases are orthonormal, so the error of a truncation is the energy it drops from the full core.
    """
    sizes = batch.shape[1:]
    energies = project(batch, [leading_basis(batch, mode, size) for mode, size in enumerate(sizes)]) ** 2
    totals = energies.reshape(len(batch), -1).sum(axis=1, keepdims=True)
    for axis in range(1, batch.ndim):
        np.cumsum(energies, axis=axis, out=energies)
    ranks = np.indices(sizes).reshape(len(sizes), -1).T + 1
    costs = np.prod(ranks, axis=1)
    nbytes = COEFFICIENT_BYTES * (costs + ranks @ np.asarray(sizes))
    kept = np.flatnonzero((nbytes <= budget) & (costs <= decode_cost))
    # Errors below float16's own are not worth a byte: all the same, so that the fewest bytes win.
    errors = np.maximum(totals - energies.reshape(len(batch), -1)[:, kept], 1e-8 * totals)
    none = np.zeros((1, len(sizes)), np.int64)
    return RateTable(np.hstack([totals, errors]), np.append(0, nbytes[kept]), np.vstack([none, ranks[kept]]))


def tucker_error(batch: FloatArray, bases: Sequence[FloatArray], ranks: IntArray) -> float:
    """Sum of squared errors of bricks cut to ranks (bricks, modes) with float16 cores and bases."""
    core = project(batch, bases)
    for mode, size in enumerate(core.shape[1:]):
        # Zeros past a brick's rank do what slicing would, and all bricks stay one batch.
        within = ranks[:, mode, None] > np.arange(size, dtype=np.int64)
        core = core * np.expand_dims(within, [1 + m for m in range(len(bases)) if m != mode])
    core = rounded(core)
    for mode, basis in enumerate(bases):
        core = mode_product(core, rounded(basis), mode)
    return float(np.sum((batch - core) ** 2))


def hosvd_greedy(array: ArrayLike, budget: int, decode_cost: int, hooi_rounds: int = 2) -> Baseline:
    """Whole-array HOSVD with the ranks of least error, then HOOI; best of all organisations."""
    values = np.asarray(array, np.float64)
    signal, best = float(np.sum(values**2)), NOTHING
    for groups in organisations(values.shape):
        batch = unite(values[None], groups)
        table = rate_table(batch, budget, decode_cost)
        # The whole table is searched: a greedy ascent stalls where no single mode gains (a matrix).
        choice = int(np.lexsort((table.nbytes, table.errors[0]))[0])
        if choice == 0:
            continue
        ranks = table.ranks[choice].tolist()
        bases = [leading_basis(batch, mode, rank) for mode, rank in enumerate(ranks)]
        for _, mode in itertools.product(range(hooi_rounds), range(len(ranks))):
            bases[mode] = leading_basis(project(batch, bases, skip=mode), mode, ranks[mode])
        snr, nbytes = snr_db(signal, tucker_error(batch, bases, table.ranks[[choice]])), int(table.nbytes[choice])
        best = max(best, Baseline(snr, nbytes, math.prod(ranks), f"modes {groups} ranks {ranks}"))
    return best


def brick_shapes(shape: Sequence[int]) -> list[Shape]:
    """Bricks to try: short axes whole, the leading one (time, light) whole or cut, the rest alike."""
    wanted = [[first] + [rest] * (len(shape) - 1) for first in (*BRICK_EDGES, max(shape)) for rest in BRICK_EDGES]
    wanted.append(list(shape))
    return sorted({tuple(s if s <= SHORT_AXIS else min(s, e) for s, e in zip(shape, w, strict=True)) for w in wanted})


def cut(values: FloatArray, edges: Sequence[int]) -> list[FloatArray]:
    """Near-equal bricks no longer than `edges`, a batch (bricks, *axes) for each shape that occurs."""
    segments: list[list[slice]] = []
    for size, edge in zip(values.shape, edges, strict=True):
        parts = -(-size // edge)
        bounds = [size * part // parts for part in range(parts + 1)]
        segments.append([slice(*pair) for pair in itertools.pairwise(bounds)])
    batches: dict[Shape, list[FloatArray]] = {}
    for where in itertools.product(*segments):
        batches.setdefault(values[where].shape, []).append(values[where])
    return [np.stack(bricks) for bricks in batches.values()]


def allocate(tables: Sequence[RateTable], budget: int) -> list[IntArray]:
    """A truncation for every brick, one array a table: least total error in `budget` bytes."""

    def choose(multiplier: float) -> tuple[int, list[IntArray]]:
        choices = [np.argmin(t.errors + multiplier * t.nbytes, axis=1) for t in tables]
        return sum(int(t.nbytes[c].sum()) for t, c in zip(tables, choices, strict=True)), choices

    high = max(float(table.errors[:, 0].max()) for table in tables) + 1e-300
    low = 1e-14 * high
    (spent, choices), (lavish_spent, lavish) = choose(high), choose(low)
    for _ in range(40):
        if lavish_spent <= max(budget, spent + budget // 200):
            break
        tried = choose(middle := math.sqrt(low * high))
        if tried[0] <= budget:
            high, (spent, choices) = middle, tried
        else:
            low, (lavish_spent, lavish) = middle, tried
    # At nearly the same multiplier every upgrade gains the same a byte: the rest goes in any order.
    for table, old, new in zip(tables, choices, lavish, strict=True):
        for brick, price in enumerate((table.nbytes[new] - table.nbytes[old]).tolist()):
            if 0 < price <= budget - spent:
                old[brick], spent = new[brick], spent + price
    return choices


def fit_bricks(values: FloatArray, edges: Shape, groups: Groups, budget: int, decode_cost: int) -> BrickFit:
    """Batches (bricks, *modes), their ranks (bricks, modes), predicted squared error and bytes."""
    batches = [unite(batch, groups) for batch in cut(values, edges)]
    tables = [rate_table(batch, budget, decode_cost) for batch in batches]
    chosen = list(zip(tables, allocate(tables, budget), strict=True))
    error = sum(float(np.take_along_axis(t.errors, c[:, None], 1).sum()) for t, c in chosen)
    return batches, [t.ranks[c] for t, c in chosen], error, sum(int(t.nbytes[c].sum()) for t, c in chosen)


def hosvd_bricks(array: ArrayLike, budget: int, decode_cost: int) -> Baseline:
    """Uniform bricks, each an HOSVD with ranks of its own by one Lagrange multiplier.

    From the best of `brick_shapes`, edges are halved or doubled and channels merged while it helps.
    """
    values = np.asarray(array, np.float64)
    tried: dict[tuple[Shape, Groups], float] = {}
    merges = organisations(values.shape)
    plans = [(edges, merges[0]) for edges in brick_shapes(values.shape)]
    best = plans[0]
    while plans:
        for edges, groups in plans:
            tried[edges, groups] = fit_bricks(values, edges, groups, budget, decode_cost)[2]
        best = min(tried, key=lambda plan: tried[plan])
        near = {(edges, best[1]) for edges in neighbours(best[0], values.shape)}
        plans = sorted(near.union((best[0], groups) for groups in merges) - tried.keys())
    batches, ranks, _, nbytes = fit_bricks(values, *best, budget, decode_cost)
    if nbytes == 0:
        return NOTHING
    bases = [[leading_basis(b, mode, size) for mode, size in enumerate(b.shape[1:])] for b in batches]
    error = sum(map(tucker_error, batches, bases, ranks))
    costs = np.concatenate([np.prod(rows, axis=1) for rows in ranks])
    detail = f"{np.count_nonzero(costs)}/{len(costs)} bricks {best[0]} modes {best[1]}, mean cost {costs.mean():.0f}"
    return Baseline(snr_db(float(np.sum(values**2)), error), nbytes, int(costs.max()), detail)


def neighbours(edges: Shape, shape: Sequence[int]) -> Iterator[Shape]:
    """Brick shapes with one long axis' edge halved or doubled."""
    for axis, size in enumerate(shape):
        for edge in (-(-edges[axis] // 2), min(size, 2 * edges[axis])):
            if size > CHANNELS:
                yield (*edges[:axis], edge, *edges[axis + 1 :])


METHODS: dict[str, Callable[[ArrayLike, int, int], Baseline]] = {
    "pca": pca_splits,
    "clustered_pca": clustered_pca,
    "hosvd": hosvd_greedy,
    "hosvd_bricks": hosvd_bricks,
}


def best_baseline(array: ArrayLike, budget: int, decode_cost: int) -> dict[str, tuple[float, int, int]]:
    """(SNR in dB, bytes, multiply-adds an element) that each method reaches, by name."""
    return {name: method(array, budget, decode_cost)[:3] for name, method in METHODS.items()}
