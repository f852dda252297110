"""Work through an array piece by piece, in the order in which its elements lie in memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .memory import drop_pages

#: Elements that mean and deviation are told from.
SAMPLE = 1 << 20
#: Parts of a mapped file that are looked at one after another, as even a sample touches most of its pages.
PARTS = 64


def thinning(shape: Sequence[int], limit: int) -> list[int]:
    """Steps along each axis that leave up to `limit` elements, the longest axes thinned first.

    >>> thinning((100, 10), 300)
    [4, 1]
    """
    steps = [1] * len(shape)
    while prod(-(-size // step) for size, step in zip(shape, steps, strict=True)) > limit:
        steps[max(range(len(shape)), key=lambda n: shape[n] / steps[n])] += 1
    return steps


def slabs(shape: Sequence[int], limit: int) -> Iterator[tuple[slice, ...]]:
    """Cut an array into slabs of up to `limit` elements along the first axis, along the next where one is too large.

    Each slab is one run of elements in C order, and the runs follow one another.

    >>> list(slabs((2, 3), 3))
    [(slice(0, 1, None),), (slice(1, 2, None),)]
    """
    if not shape:  # a single element
        yield ()
        return
    axis = 0
    while axis < len(shape) - 1 and prod(shape[axis + 1 :]) > limit:
        axis += 1
    length = max(1, limit // max(1, prod(shape[axis + 1 :])))
    for lead in np.ndindex(*shape[:axis]):
        for start in range(0, shape[axis], length):
            yield (*(slice(i, i + 1) for i in lead), slice(start, min(start + length, shape[axis])))


def moments(array: NDArray[Any]) -> tuple[float, float]:
    """Mean and standard deviation of the finite numbers of a sample; zeros if there is none.

    >>> moments(np.array([[1, 3], [np.nan, 5]]))[0]
    3.0
    """
    steps = thinning(array.shape, SAMPLE)
    parts: list[NDArray[np.float64]] = []
    length = steps[0] * -(-array.shape[0] // (steps[0] * PARTS))
    for start in range(0, array.shape[0], length):
        spans = (slice(start, start + length, steps[0]), *(slice(None, None, step) for step in steps[1:]))
        sample = np.asarray(array[spans], np.float64)
        parts.append(sample[np.isfinite(sample)])
        drop_pages(array)
    finite = np.concatenate(parts)
    return (float(finite.mean()), float(finite.std())) if finite.size else (0.0, 0.0)
