"""K-means of rows under a cap on cluster size.

Fits use the native twin of this (`kmeans.rs`). Both add numbers up one after another, so that labels agree bit by bit.
"""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

from ..arrays import F64

Labels = NDArray[np.intp]


def most_rows(rows: int, clusters: int, cap: float | None) -> int:
    """How many of I rows one of C clusters takes: cap I/C, or all of them (None).

    >>> most_rows(10, 4, 1.2), most_rows(10, 4, None)
    (3, 10)
    """
    return rows if cap is None else ceil(cap * rows / clusters)


def nearest_with_room(distance: F64, cap: float | None) -> Labels:
    """The nearest of C centres for I rows, none for more than cap I/C (None: any); widest margins first.

    Args:
        distance: `[I, C]`; infinite where a centre is the last resort, but not for all but one.
        cap: at least 1.

    >>> nearest_with_room(np.array([[0.0, 9.0], [1.0, 3.0], [2.0, 3.0]]), 1.1).tolist()
    [0, 0, 1]
    """
    rows, clusters = distance.shape
    most = most_rows(rows, clusters, cap)
    if most >= rows:
        return distance.argmin(axis=1)
    ordered = np.sort(distance, axis=1)
    nearest: list[list[int]] = distance.argsort(axis=1, kind="stable").tolist()
    room = [most] * clusters
    labels = np.zeros(rows, np.intp)
    order: list[int] = np.argsort(ordered[:, 0] - ordered[:, 1], kind="stable").tolist()
    for i in order:
        labels[i] = k = next(k for k in nearest[i] if room[k])
        room[k] -= 1
    return labels


def cluster_rows(features: F64, centres: F64, cap: float | None, rounds: int) -> tuple[Labels, float]:
    """Rows go to the nearest centres with room, centres to the means of their rows, and again.

    Args:
        features: of the rows, `[I, F]`.
        centres: to begin with, `[C, F]`; one that gets no row stays where it is.
        cap: no cluster has more than cap I/C rows (at least 1; None: any size).
        rounds: of both, at least 1.

    Returns:
        The rows' labels `[I]`, and what squares of distances to the clusters' means sum up to.
    """
    centres = centres.copy()
    labels = np.full(len(features), -1)
    for _ in range(rounds):
        before, labels = labels, nearest_with_room(_distances(features, centres), cap)
        if np.array_equal(before, labels):
            break
        sums, count = np.zeros_like(centres), np.bincount(labels, minlength=len(centres))[:, None]
        np.add.at(sums, labels, features)
        np.divide(sums, count, out=centres, where=count > 0)
    return labels, float(np.cumsum(np.square(features - centres[labels]))[-1])


def _distances(features: F64, centres: F64) -> F64:
    """Squared distance of every row to every centre, `[I, C]`."""
    distance = np.zeros((len(features), len(centres)))
    for feature, centre in zip(features.T, centres.T, strict=True):
        distance += np.square(feature[:, None] - centre)
    return distance
