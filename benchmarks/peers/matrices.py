"""Matrix PCA of the best two-way split of the axes, and clustered PCA of the rows of such a split."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain, product
from math import log2

import numpy as np
from numpy.typing import NDArray

from .layouts import F64, Floats, Layout, partitions, spectrum, unite, united
from .rates import (
    HEADER_BITS,
    RANK_BITS,
    SCALE_BITS,
    STEP_BITS,
    TRADE,
    adaptive_bits,
    column_bits,
    on_grid,
    price,
    quantise,
)
from .search import Coded, Found, Search

#: Longest shorter side of a matrix whose singular vectors are found.
LONGEST_SIDE = 2600
#: Splits of which rows are clustered, numbers of clusters, and dimensions of a cluster's subspace while rows move.
CLUSTERED_SPLITS, CLUSTERS, SUBSPACE = 5, (16, 64), 8
#: Turns of k-means, and in all: rows then move to the subspace that is nearest.
MEANS_TURNS, TURNS = 10, 16

#: A matrix, shorter side first, its singular values and left singular vectors.
Part = tuple[Floats, F64, F64]


def pca(values: NDArray[np.float32], search: Search) -> list[Found | None]:
    """Matrix PCA of the best split; its decode cost is the rank."""
    parts = _splits(values, search)
    return search.finish(lambda layout: lambda step: _code(parts[layout], step, search.decode_cost))


def clustered_pca(values: NDArray[np.float32], search: Search) -> list[Found | None]:
    """A PCA of each cluster of rows, of the splits that are best for PCA; the decode cost is the largest rank."""
    plain = Search(search.budgets, search.steps, search.decode_cost)
    _splits(values, plain)
    splits = list(dict.fromkeys(chain(*zip(*plain.best(CLUSTERED_SPLITS), strict=True))))[:CLUSTERED_SPLITS]
    parts: dict[Layout, list[Part]] = {}
    label_bits: dict[Layout, float] = {}
    for split, clusters in product(splits, CLUSTERS):
        rows = _wide(unite(values[None], split.groups)[0]).T
        if len(rows) < 4 * clusters:
            continue
        layout = Layout(split.groups, clusters=clusters)
        labels = cluster_rows(rows, clusters, max(1, min(SUBSPACE, rows.shape[1] // 4)))
        matrices = [_wide(rows[labels == cluster]) for cluster in np.unique(labels)]
        parts[layout] = [(matrix, *spectrum(matrix)) for matrix in matrices]
        label_bits[layout] = _label_bits(labels, clusters)
        curve = np.sum([_curve(matrix.shape, singular, search.steps) for matrix, singular, _ in parts[layout]], axis=0)
        search.curves[layout] = curve + TRADE * search.steps**2 * label_bits[layout]
    return search.finish(lambda layout: lambda step: _code(parts[layout], step, search.decode_cost,
                                                           label_bits[layout]))


def _splits(values: NDArray[np.float32], search: Search) -> dict[Layout, list[Part]]:
    """Predict all two-way splits whose shorter side is not too long."""
    parts: dict[Layout, list[Part]] = {}
    for groups in partitions(values.ndim):
        if len(groups) == 2 and min(united(values.shape, groups)) <= LONGEST_SIDE:
            matrix, layout = _wide(unite(values[None], groups)[0]), Layout(groups)
            parts[layout] = [(matrix, *spectrum(matrix))]
            search.curves[layout] = _curve(matrix.shape, parts[layout][0][1], search.steps)
    return parts


def _wide(matrix: Floats) -> Floats:
    """The matrix with the shorter side first."""
    return matrix if matrix.shape[0] <= matrix.shape[1] else np.ascontiguousarray(matrix.T)


def _gains(shape: Sequence[int], singular: F64, step: float) -> tuple[F64, F64]:
    """Energy of each column in units of D^2, and the predicted price of its numbers in both factors."""
    c2: F64 = (singular / step) ** 2
    return c2, price(c2, shape[0]) + price(c2, shape[1], STEP_BITS + 2 * SCALE_BITS)


def _curve(shape: Sequence[int], singular: F64, steps: F64) -> F64:
    """Predicted Lagrangians by step."""
    return np.array([step**2 * np.minimum(*_gains(shape, singular, step)).sum() for step in steps.tolist()])


def _code(parts: Sequence[Part], step: float, decode_cost: int, extra_bits: float = 0.0) -> Coded:
    """A PCA of each part coded with one step; the longer factor is fitted to the shorter one as decoded."""
    bits, error, ranks = HEADER_BITS + extra_bits + RANK_BITS * len(parts), 0.0, list[int]()
    for matrix, singular, left in parts:
        rank = min(int(np.greater(*_gains(matrix.shape, singular, step)).sum()), decode_cost)
        rest = matrix
        if rank:
            weight = on_grid(singular[:rank] / step)
            q = quantise(left[:, :rank] * weight)
            short = q / weight
            bits += column_bits(q) + STEP_BITS * rank
            solver = np.linalg.solve(short.T @ short + 1e-12 * np.eye(rank), short.T)
            q = quantise(solver.astype(matrix.dtype) @ matrix / step)
            bits += column_bits(q.T)
            rest = matrix - short.astype(matrix.dtype) @ (q * step).astype(matrix.dtype)
        error += float(np.sum(np.square(rest, dtype=np.float64)))
        ranks.append(rank)
    return Coded(bits, error, max(ranks), "rank " + "..".join(map(str, sorted({min(ranks), max(ranks)}))))


def _label_bits(labels: NDArray[np.intp], clusters: int) -> float:
    """Bits of the labels, adaptively or by runs, whichever is shorter."""
    same = np.bincount(labels[1:] == labels[:-1], minlength=2)
    by_runs = adaptive_bits(same) + (1 + int(same[0])) * log2(clusters)
    return min(adaptive_bits(np.bincount(labels, minlength=clusters)), by_runs)


def cluster_rows(matrix: Floats, clusters: int, rank: int) -> NDArray[np.intp]:
    """Labels of rows by k-means, and then by moves of rows to the subspace of a cluster that is nearest.

    Distances are measured in a random sketch of the leading row space: the rest is the same to all.
    """
    rng = np.random.default_rng(0)
    sketch = rng.standard_normal((matrix.shape[1], min(matrix.shape[1], 64 + rank)))
    for _ in range(2):
        sketch = np.linalg.qr(matrix.T @ (matrix @ sketch))[0]
    points = np.asarray(matrix @ sketch, np.float64)
    centres = points[_starts(points, clusters, rng)]
    labels = np.zeros(len(points), np.intp)
    bases = [np.zeros((points.shape[1], 0))] * clusters
    for turn in range(TURNS):
        far = [c @ c - 2.0 * (points @ c) - np.square((points - c) @ basis).sum(axis=1)
               for c, basis in zip(centres, bases, strict=True)]
        labels = np.argmin(far, axis=0)
        members = [points[labels == cluster] for cluster in range(clusters)]
        if turn < MEANS_TURNS:
            centres = np.array([part.mean(axis=0) if len(part) else np.zeros(points.shape[1]) for part in members])
        else:
            centres = np.zeros((clusters, points.shape[1]))
            bases = [np.linalg.eigh(part.T @ part)[1][:, ::-1][:, : min(rank, len(part))] for part in members]
    return labels


def _starts(points: F64, clusters: int, rng: np.random.Generator) -> list[int]:
    """Rows to begin with, by k-means++."""
    starts = [int(rng.integers(len(points)))]
    nearest = np.full(len(points), np.inf)
    while len(starts) < clusters:
        nearest = np.minimum(nearest, np.sum((points - points[starts[-1]]) ** 2, axis=1) + 1e-300)
        starts.append(int(rng.choice(len(points), p=nearest / nearest.sum())))
    return starts
