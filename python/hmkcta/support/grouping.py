"""Rows of each part, found at once: looking for every part among all rows takes the product of both."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.intp]


def rows_of_parts(part: NDArray[np.integer], count: int = 0) -> list[Rows]:
    """For each of `count` parts, or of all up to the last that occurs, the rows that belong to it, ascending.

    >>> [rows.tolist() for rows in rows_of_parts(np.array([1, 0, 1, 3]), 4)]
    [[1], [0, 2], [], [3]]
    """
    sizes = np.bincount(part, minlength=count)
    return np.split(sorted_by(part, len(sizes)), np.cumsum(sizes)[:-1])


def sorted_by(part: NDArray[np.integer], count: int) -> Rows:
    """All rows, those of one of `count` parts after those of another; NumPy sorts short numbers by radix.

    >>> sorted_by(np.array([1, 0, 1, 3]), 4).tolist()
    [1, 0, 2, 3]
    """
    return np.argsort(part.astype(np.uint16) if count <= 1 << 16 else part, kind="stable")
