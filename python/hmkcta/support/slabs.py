"""Work through an array piece by piece, in the order in which its elements lie in memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import prod

import numpy as np


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
