"""Soft cluster memberships of a mode: features of its rows, balanced k-means, uniform blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

#: Columns of the row features, and elements looked at to find them; more of either changed nothing (algorithm notes).
FEATURES, SAMPLE = 12, 2_000_000
#: Differences of features that are held at once.
PAIRS = 1 << 20
#: Row normalisations f <- f |f|^(p-1) with size caps (times I/C), the most often best ones first.
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


def uniform_blocks(size: int, clusters: int) -> NDArray[np.intp]:
    """Block number of each row, the first blocks longer by one (paper, footnote 1).

    >>> np.bincount(uniform_blocks(10, 4)).tolist()
    [3, 3, 2, 2]
    """
    short, longer = divmod(size, clusters)
    return np.repeat(np.arange(clusters), [short + (c < longer) for c in range(clusters)])


def row_features(tensor: NDArray[Any], n: int) -> F64:
    """Principal coordinates of the rows of mode n, `[I_n, <= 12]`, from a strided sample of the other modes."""
    rows = np.moveaxis(tensor, n, 0)
    step = max(1, round((tensor.size / SAMPLE) ** (1 / max(1, tensor.ndim - 1))))
    rows = rows[(slice(None), *[slice(None, None, min(step, max(1, i // 2))) for i in rows.shape[1:]])]
    unfolded = rows.reshape(len(rows), -1).astype(np.float64)
    if len(rows) <= unfolded.shape[1]:
        values, vectors = np.linalg.eigh(unfolded @ unfolded.T)
        return vectors[:, : -FEATURES - 1 : -1] * np.sqrt(np.maximum(values[: -FEATURES - 1 : -1], 0))
    values, vectors = np.linalg.eigh(unfolded.T @ unfolded)
    return unfolded @ vectors[:, : -FEATURES - 1 : -1]


def balanced_clusters(
    features: F64, clusters: int, cap: float | None, rng: np.random.Generator, restarts: int = 2
) -> NDArray[np.intp]:
    """K-means++ labels of the rows, no cluster larger than cap I/C (None: any size); best of several restarts."""
    best, best_cost = uniform_blocks(len(features), clusters), np.inf
    labels = best
    for _ in range(restarts):
        centres = _spread_centres(features, clusters, rng)
        for _ in range(8):
            distance = _distances(features, centres)
            labels = nearest_with_room(distance, cap)
            for c in range(clusters):
                if (labels == c).any():
                    centres[c] = features[labels == c].mean(0)
        cost = float(((features - centres[labels]) ** 2).sum())
        if cost < best_cost and len(np.unique(labels)) == clusters:
            best, best_cost = labels, cost
    return best


def _distances(features: F64, centres: F64) -> F64:
    """Squared distance of every row to every centre, `[I, C]`; so many rows at a time that differences stay small."""
    some = max(1, PAIRS // centres.size)
    parts = (features[at : at + some, None] - centres[None] for at in range(0, len(features), some))
    return np.concatenate([np.square(part, out=part).sum(-1) for part in parts])


def _spread_centres(features: F64, clusters: int, rng: np.random.Generator) -> F64:
    centres = [features[rng.integers(len(features))]]
    for _ in range(clusters - 1):
        distance = np.min([((features - c) ** 2).sum(1) for c in centres], axis=0)
        total = distance.sum()
        weights = distance / total if total > 0 else None
        centres.append(features[rng.choice(len(features), p=weights)])
    return np.array(centres)


def nearest_with_room(distance: F64, cap: float | None) -> NDArray[np.intp]:
    """The nearest of C centres for I rows `[I, C]`, none for more than cap I/C (None: any); widest margins first.

    >>> nearest_with_room(np.array([[0.0, 9.0], [1.0, 3.0], [2.0, 3.0]]), 1.1).tolist()
    [0, 0, 1]
    """
    most = len(distance) if cap is None else ceil(cap * len(distance) / distance.shape[1])
    if most >= len(distance):
        return distance.argmin(1)
    ordered = np.sort(distance, axis=1)
    margin = ordered[:, 1] - ordered[:, 0] if distance.shape[1] > 1 else ordered[:, 0]
    nearest: list[list[int]] = distance.argsort(axis=1, kind="stable").tolist()
    room = [most] * distance.shape[1]
    labels = np.zeros(len(distance), np.intp)
    order: list[int] = np.argsort(-margin, kind="stable").tolist()
    for i in order:
        labels[i] = k = next(k for k in nearest[i] if room[k])
        room[k] -= 1
    return labels


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
    tensor: NDArray[Any], clusters: tuple[int, ...], count: int, rng: np.random.Generator, *, overlap: bool = False
) -> Iterator[list[NDArray[np.intp]]]:
    """Disjoint memberships to choose among: uniform blocks, then normalised rows under size caps.

    Where they are to overlap later (K > 1), clusters of nearly equal size come first: up to 5 dB better than others. A
    single one is of them, as uniform blocks know nothing of rows without order.
    """
    if count > 1:
        yield [uniform_blocks(i, c) for i, c in zip(tensor.shape, clusters, strict=True)]
    features = [row_features(tensor, n) if c > 1 else None for n, c in enumerate(clusters)]
    order = sorted(CANDIDATES, key=lambda each: each[1] or np.inf) if overlap else CANDIDATES
    for power, cap in order[: max(1, count - 1)]:
        labels: list[NDArray[np.intp]] = []
        for n, (f, c) in enumerate(zip(features, clusters, strict=True)):
            if f is None:
                labels.append(np.zeros(int(tensor.shape[n]), np.intp))
                continue
            norm = np.sqrt(np.square(f).sum(axis=1, keepdims=True))
            scaled: F64 = f * np.where(norm > 0, norm, 1.0) ** (power - 1)
            labels.append(balanced_clusters(scaled, c, cap, rng))
        yield labels
