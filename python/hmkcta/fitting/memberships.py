"""Disjoint starts for the clusters of a mode: features of its rows, balanced k-means, K-subspaces, uniform blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import backends as kernels
from ..arrays import F32, F64
from ..plan import LevelSpec
from .subspaces import subspace_clusters
from .tucker import leading_eigen, leading_subspace, mode_product

#: Columns of the row features; more changed nothing.
FEATURES = 12
#: Directions of every other mode that slices are compared in.
SPANNED = 32
#: Elements looked at to find them; more changed nothing.
SAMPLE = 500_000
#: Side of Gram matrices up to which they are decomposed exactly.
EXACT_SIDE = 512
#: Subspace iterations that find the leading vectors of larger ones.
ITERATIONS = 8
#: How often k-means starts anew.
RESTARTS = 4
#: Rounds of each start; it ends sooner where labels stay as they are.
ROUNDS = 8
#: Rows that k-means takes its rounds for, if there are more: with more, errors fall by some hundredths, unless a few
#: rows are unlike all others.
ROWS = 1 << 15
#: Rows for each cluster that it takes at the least, if that is more.
ROWS_EACH = 256
#: Row normalisations f <- f |f|^(p-1) with size caps (times I/C), in the order of how often they were best.
CANDIDATES: tuple[tuple[float, float | None], ...] = (
    (0.2, 1.2),
    (0.5, 1.5),
    (1.0, None),
    (0.2, 1.05),
    (0.5, 1.2),
    (0.2, 1.5),
    (1.0, 1.5),
    (0.5, 1.05),
    (1.0, 1.2),
    (0.5, None),
    (0.2, None),
    (1.0, 1.05),
)

def block_sizes(size: int, blocks: int) -> list[int]:
    """Rows of each of so many equal blocks.

    >>> block_sizes(8, 3)
    [3, 3, 2]
    """
    short, longer = divmod(size, blocks)
    return [short + 1] * longer + [short] * (blocks - longer)


def uniform_blocks(size: int, clusters: int) -> NDArray[np.intp]:
    """Block number of each row, the first blocks longer by one (paper, footnote 1).

    The last C - mod(I, C) blocks are shorter by one. The footnote says mod(I, C), by which 8 rows in 3 blocks would be
    3 + 2 + 2, one too few.

    >>> np.bincount(uniform_blocks(8, 3)).tolist()
    [3, 3, 2]
    """
    return np.repeat(np.arange(clusters), block_sizes(size, clusters))


def grid_blocks(rows: NDArray[np.intp], axes: Sequence[tuple[int, int]]) -> NDArray[np.intp]:
    """Flattened block number of each row of a (merged) mode whose axes have the given sizes and block counts.

    Of fewer rows than blocks some blocks have none: then those that have are numbered. A node may have no rows.

    >>> grid_blocks(np.arange(8), [(2, 2), (4, 2)]).tolist()
    [0, 0, 1, 1, 2, 2, 3, 3]
    """
    number = np.zeros(len(rows), np.intp)
    for index, (_, count) in zip(np.unravel_index(rows, [size for size, _ in axes]), axes, strict=True):
        distinct, position = np.unique(index, return_inverse=True)
        number = number * count + uniform_blocks(len(distinct), min(count, max(1, len(distinct))))[position]
    return number if len(rows) >= prod(count for _, count in axes) else np.unique(number, return_inverse=True)[1]


def sampled_rows(tensor: NDArray[Any], n: int) -> NDArray[Any]:
    """The rows of mode n, `[I_n, ..]`, from a strided sample of the other modes."""
    rows = np.moveaxis(tensor, n, 0)
    step = max(1, round((tensor.size / SAMPLE) ** (1 / max(1, tensor.ndim - 1))))
    return rows[(slice(None), *[slice(None, None, min(step, max(1, i // 2))) for i in rows.shape[1:]])]


def slice_features(tensor: NDArray[Any], n: int) -> F64:
    """Principal coordinates `[I_n, <= 12]` of which subspaces the slices of mode n lie in, whatever their place there.

    Along another mode a slice has a Gram matrix, and rows whose cells share bases of that mode have matrices alike,
    though the rows themselves are not. Random clusters of 40 x 36 x 32, R = 3 and C = 3 throughout, are found by these
    alone, where rows tell nothing.
    """
    rows = sampled_rows(tensor, n).astype(np.float32)
    grams: list[F32] = []
    for m in range(1, rows.ndim):
        directions = leading_subspace(rows, m, SPANNED, np.random.default_rng(0))
        slices = np.moveaxis(mode_product(rows, directions.T, m), m, 1).reshape(len(rows), directions.shape[1], -1)
        gram = (slices @ slices.transpose(0, 2, 1)).reshape(len(rows), -1)
        length = np.sqrt(np.square(gram, dtype=np.float64).sum(axis=1, keepdims=True))
        grams.append((gram / np.maximum(length, np.finfo(np.float32).tiny)).astype(np.float32))
    return _principal(np.concatenate(grams, axis=1).astype(np.float64)) if grams else np.zeros((len(rows), 1))


def row_features(tensor: NDArray[Any], n: int) -> F64:
    """Principal coordinates of the rows of mode n, `[I_n, <= 12]`, from a strided sample of the other modes."""
    rows = sampled_rows(tensor, n)
    return _principal(rows.astype(np.float64, order="C").reshape(len(rows), -1))


def _principal(rows: F64) -> F64:
    """Leading principal coordinates of the rows, about the origin."""
    if len(rows) <= rows.shape[1]:
        values, vectors = _leading(rows @ rows.T)
        return vectors * np.sqrt(np.maximum(values, 0))
    return rows @ _leading(rows.T @ rows)[1]


def _leading(gram: F64) -> tuple[F64, F64]:
    """Eigenvalues and -vectors of as many features, the largest first; of large matrices by subspace iteration."""
    if len(gram) <= EXACT_SIDE:
        return leading_eigen(gram, FEATURES)
    basis = np.random.default_rng(0).standard_normal((len(gram), 2 * FEATURES))
    for _ in range(ITERATIONS):
        basis = np.linalg.qr(gram @ basis)[0]
    values, vectors = leading_eigen(basis.T @ gram @ basis, FEATURES)
    return values, basis @ vectors


def normalised(features: F64, power: float) -> F64:
    """Rows f as f |f|^(p-1): without their norms at power 0, as they are at 1."""
    norm = np.sqrt(np.square(features).sum(axis=1, keepdims=True))
    return features * np.where(norm > 0, norm, 1.0) ** (power - 1)


def balanced_clusters(
    features: F64, clusters: int, cap: float | None, rng: np.random.Generator
) -> NDArray[np.intp]:
    """K-means++ labels of the rows, no cluster larger than cap I/C (None: any size); best of several restarts.

    Of very many rows some are parted, a quarter of which are enough to draw first centres from, and the others go to
    the nearest of their means.
    """
    most = max(ROWS, ROWS_EACH * clusters)
    some = features if len(features) <= most else features[np.sort(rng.permutation(len(features))[:most])]
    first = some if some is features else some[::4]
    best, best_cost = None, np.inf
    for _ in range(RESTARTS):
        labels, cost = kernels.cluster_rows(some, _spread_centres(first, clusters, rng), cap, ROUNDS)
        if cost < best_cost and np.bincount(labels, minlength=clusters).all():
            best, best_cost = labels, cost
    if best is not None and some is not features:
        best, _ = kernels.cluster_rows(features, _means(some, best), cap, 1)
    if best is None or not np.bincount(best, minlength=clusters).all():
        return uniform_blocks(len(features), clusters)
    return best


def _means(rows: F64, labels: NDArray[np.intp]) -> F64:
    """Means of the rows of each cluster, `[C, F]`, none of which is empty."""
    sums = np.stack([np.bincount(labels, column) for column in rows.T], axis=1)
    return sums / np.bincount(labels)[:, None]


def _spread_centres(features: F64, clusters: int, rng: np.random.Generator) -> F64:
    """K-means++: rows drawn by their squared distance to the nearest that has been drawn, `[C, F]`."""
    squares = np.square(features).sum(axis=1)
    nearest = np.full(len(features), np.inf)
    chosen = [int(rng.integers(len(features)))]
    while len(chosen) < clusters:
        last = chosen[-1]
        distance = squares - 2 * (features @ features[last]) + squares[last]
        nearest = np.minimum(nearest, np.maximum(distance, 0.0))
        nearest[last] = 0.0
        share: F64 = np.cumsum(nearest)
        drawn = int(share.searchsorted(rng.random() * float(share[-1]), side="right"))
        chosen.append(drawn if drawn < len(features) else int(rng.integers(len(features))))  # all are where one is
    return features[chosen]


@dataclass(frozen=True, eq=False)
class Sample:
    """Every step-th row of each mode of a tensor, copied into one piece."""

    tensor: F32
    steps: tuple[int, ...]

    def labels(self, labels: Sequence[NDArray[np.intp]]) -> list[NDArray[np.intp]]:
        """Disjoint memberships of the sampled rows."""
        return [part[::step] for part, step in zip(labels, self.steps, strict=True)]


def strided_sample(tensor: NDArray[Any], clusters: Sequence[int], most: int) -> Sample:
    """Up to so many elements, unless a mode were thinned below 8 rows a cluster."""
    steps = [1] * tensor.ndim
    elements = tensor.size
    while elements > most:
        room = [i / (step * c) for i, step, c in zip(tensor.shape, steps, clusters, strict=True)]
        n = int(np.argmax(room))
        if room[n] < 16:
            break
        steps[n] *= 2
        elements //= 2
    view = tensor[tuple(slice(None, None, step) for step in steps)]
    return Sample(np.ascontiguousarray(view, np.float32), tuple(steps))


def start_candidates(
    tensor: NDArray[Any], spec: LevelSpec, count: int, rng: np.random.Generator, *, overlap: bool = False
) -> Iterator[list[NDArray[np.intp]]]:
    """Disjoint memberships to choose among: uniform blocks, slices, normalised rows under size caps, then K-subspaces.

    Where they are to overlap later (K > 1), clusters of nearly equal size come first: up to 5 dB better than others. A
    single one is of them, as uniform blocks know nothing of rows without order.
    """
    clusters = spec.clusters
    if count > 1:
        yield [uniform_blocks(i, c) for i, c in zip(tensor.shape, clusters, strict=True)]
    if count > 1 and not overlap:
        slices = [slice_features(tensor, n) if c > 1 else None for n, c in enumerate(clusters)]
        yield _parted(slices, tensor, spec, None, rng)
        count -= 1
    features = [row_features(tensor, n) if c > 1 else None for n, c in enumerate(clusters)]
    order = sorted(CANDIDATES, key=lambda each: each[1] or np.inf) if overlap else CANDIDATES
    for power, cap in order[: max(1, count - 1)]:
        yield _parted([None if f is None else normalised(f, power) for f in features], tensor, spec, cap, rng)
    if count > 1:
        yield from by_subspaces(tensor, spec, rng)


def _parted(
    features: Sequence[F64 | None], tensor: NDArray[Any], spec: LevelSpec, cap: float | None, rng: np.random.Generator
) -> list[NDArray[np.intp]]:
    """Labels of the rows of every mode by their features `[I_n, F]`; of a mode without clusters there are none."""
    return [np.zeros(size, np.intp) if f is None else balanced_clusters(f, c, cap, rng)
            for f, size, c in zip(features, tensor.shape, spec.clusters, strict=True)]


def by_subspaces(
    tensor: NDArray[Any], spec: LevelSpec, rng: np.random.Generator
) -> Iterator[list[NDArray[np.intp]]]:
    """Rows of the one mode that has clusters, by the subspaces that the ranks leave each of them; else nothing."""
    parted = [n for n, c in enumerate(spec.clusters) if c > 1]
    if len(parted) != 1:
        return
    n, ranks = parted[0], [rank or size for rank, size in zip(spec.ranks, tensor.shape, strict=True)]
    most = prod(rank for m, rank in enumerate(ranks) if m != n)
    rows = sampled_rows(tensor, n).astype(np.float32, order="C").reshape(tensor.shape[n], -1)
    dimension = min(ranks[n], most)
    if dimension < rows.shape[1] and len(rows) >= 2 * spec.clusters[n]:
        labels = [np.zeros(size, np.intp) for size in tensor.shape]
        labels[n] = subspace_clusters(rows, spec.clusters[n], dimension, rng)
        yield labels
