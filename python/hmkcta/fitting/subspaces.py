"""K-subspaces: rows parted by the linear subspaces that they lie near, whatever their sign and place therein.

K-means parts rows by their distance; rows of one subspace may lie on either side of the origin, and far apart. The
first subspaces are those of a row that is not explained yet and the rows that it makes the smallest angles with.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32
from .tucker import leading_eigen

Labels = NDArray[np.intp]

#: Coordinates of the rows at the least.
COORDINATES = 32
#: How many more they are at the least than a subspace has dimensions.
MORE = 16
#: Dimensions of a subspace, at the most: rows are told apart by the leading ones.
DIMENSIONS = 16
#: Rows that subspaces are found with, and how many are assigned at once.
ROWS = 1 << 12
#: How often subspaces are begun anew.
RESTARTS = 4
#: Rounds of each beginning.
ROUNDS = 12
#: Rows for each dimension, beside the first, of which a subspace begins.
NEAREST = 3
#: Beyond so many subspaces beginnings make less difference ..
MANY = 48
#: .. and are only so many.
FEWER = 2


def subspace_clusters(
    rows: F32, clusters: int, dimension: int, rng: np.random.Generator, restarts: int = RESTARTS
) -> Labels:
    """Labels of the rows `[I, J]` by the nearest of so many subspaces of that dimension; none is left without a row.

    >>> lines = np.array([[1, 0, 0], [0, 1, 0], [-2, 0, 0], [0, -3, 0]], np.float32)
    >>> found = subspace_clusters(lines, 2, 1, np.random.default_rng(0))
    >>> bool(found[0] == found[2] != found[1] == found[3])
    True
    """
    dimension = min(dimension, DIMENSIONS)
    points = _coordinates(rows, max(COORDINATES, dimension + MORE), rng)
    dimension = min(dimension, points.shape[1])  # few rows span no more
    some = points if len(points) <= ROWS else points[np.sort(rng.permutation(len(points))[:ROWS])]
    best, most = np.zeros((clusters, points.shape[1], dimension), np.float32), -1.0
    for _ in range(restarts if clusters <= MANY else min(restarts, FEWER)):
        bases = _settled(some, _seeds(some, clusters, dimension, rng))
        kept = sum(float(part.max(axis=1).sum(dtype=np.float64)) for part in _explained(some, bases))
        if kept > most:
            best, most = bases, kept
    return _with_all(np.concatenate([part.argmax(axis=1) for part in _explained(points, best)]), clusters)


def _coordinates(rows: F32, count: int, rng: np.random.Generator) -> F32:
    """So many coordinates of the rows, in about the subspace that holds most of them; of fewer rows those they have."""
    rows = rows / np.float32(max(np.abs(rows).max(initial=0.0), 1e-30))
    if rows.shape[1] <= count:
        return rows
    if len(rows) <= count:
        values, vectors = leading_eigen((rows @ rows.T).astype(np.float64), len(rows))
        return (vectors * np.sqrt(np.maximum(values, 0))).astype(np.float32)
    likely = rows.T @ (rows @ rng.standard_normal((rows.shape[1], count), np.float32))
    return rows @ np.linalg.qr(likely)[0]


def _seeds(points: F32, clusters: int, dimension: int, rng: np.random.Generator) -> F32:
    """Bases `[C, D, d]`, each of a row drawn by what those before leave of it, and of the rows in its direction."""
    errors = np.square(points).sum(axis=1)
    unit = points / np.sqrt(np.maximum(errors, 1e-30))[:, None]
    energy, near = errors.copy(), min(len(points), 1 + NEAREST * dimension)
    bases = np.zeros((clusters, points.shape[1], dimension), np.float32)
    for basis in bases:
        chances = errors.astype(np.float64) / max(errors.sum(dtype=np.float64), 1e-300)
        drawn = int(rng.choice(len(errors), p=chances / chances.sum() if chances.any() else None))
        around = np.argpartition(-np.abs(unit @ unit[drawn]), near - 1)[:near]
        basis[:] = _leading(unit[around], dimension)
        errors = np.minimum(errors, np.maximum(energy - np.square(points @ basis).sum(axis=1), 0))
    return bases


def _settled(points: F32, bases: F32) -> F32:
    """The bases after rounds in which each row goes to the subspace that leaves least of it, and these follow."""
    labels = np.full(len(points), -1)
    for _ in range(ROUNDS):
        before, labels = labels, np.concatenate([part.argmax(axis=1) for part in _explained(points, bases)])
        if np.array_equal(before, labels):
            break
        bases, moved = bases.copy(), labels != before
        for c in np.intersect1d(labels, [labels[moved], before[moved]]):  # which gained or lost rows
            bases[c] = _leading(points[labels == c], bases.shape[2])
    return bases


def _explained(points: F32, bases: F32) -> Iterator[F32]:
    """Squared norm of the rows' projections on every subspace, `[.., C]`, some rows after others."""
    clusters, width, dimension = bases.shape
    columns = np.ascontiguousarray(bases.transpose(1, 2, 0)).reshape(width, -1)
    for start in range(0, max(1, len(points)), ROWS):
        projected = np.square(points[start : start + ROWS] @ columns)
        yield projected.reshape(-1, dimension, clusters).sum(axis=1)


def _leading(rows: F32, dimension: int) -> F32:
    """Leading right singular vectors of the rows as columns `[D, d]`."""
    return leading_eigen((rows.T @ rows).astype(np.float64), dimension)[1].astype(np.float32)


def _with_all(labels: Labels, clusters: int) -> Labels:
    """The labels with a row for every cluster, taken from the largest."""
    count = np.bincount(labels, minlength=clusters)
    for c in np.flatnonzero(count == 0):
        row = int(np.argmax(labels == count.argmax()))
        count[labels[row]] -= 1
        count[c], labels[row] = 1, c
    return labels
