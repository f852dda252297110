"""Rows of every mode out of an array in any layout; of a mapped file without bringing much of it into memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import backends as kernels
from ..support.memory import LOOKED_AT, drop_pages, mapped, touched

Rows = Sequence[NDArray[np.intp]]


def collected(
    array: NDArray[Any], modes: Sequence[Sequence[int]], rows: Rows, factor: float | None = None, most: int = LOOKED_AT
) -> NDArray[Any]:
    """The sub-tensor of some rows of each mode, which merges the axes it lists, in one piece, and of the array's type.

    Float32 numbers may be multiplied by a factor.

    Rows that lie across a mapped file touch most of its pages: they are collected in parts, and pages dropped between,
    so that about `most` bytes of it are in memory.

    >>> collected(np.arange(12).reshape(2, 3, 2), [[0, 2], [1]], [np.array([0, 3]), np.array([0, 2])])
    array([[ 0,  4],
           [ 7, 11]])
    """
    found = np.empty([len(chosen) for chosen in rows], array.dtype)
    if found.size == 0 or mapped(array) is None:
        kernels.collect(array, modes, rows, found, factor)
        return found
    for n, where in _parts(array, modes, rows, most):
        own = [chosen[where] if m == n else chosen for m, chosen in enumerate(rows)]
        together = n == 0 and len(where) == where[-1] - where[0] + 1
        part = found[where[0] : where[-1] + 1] if together else np.empty([len(chosen) for chosen in own], array.dtype)
        kernels.collect(array, modes, own, part, factor)
        if not together:
            found[(*[slice(None)] * n, where)] = part
        drop_pages(array)
    return found


def _parts(
    array: NDArray[Any], modes: Sequence[Sequence[int]], rows: Rows, most: int
) -> Iterator[tuple[int, NDArray[np.intp]]]:
    """A mode, and which of its rows to collect next, for about so many bytes of the file to be looked at at a time."""
    indices = {
        axis: (n, at)
        for n, (mode, chosen) in enumerate(zip(modes, rows, strict=True))
        for axis, at in zip(mode, np.unravel_index(chosen, [array.shape[axis] for axis in mode]), strict=True)
    }
    seen = {axis: np.unique(at) for axis, (_, at) in indices.items()}
    steps = {axis: abs(array.strides[axis]) * _step(own) for axis, own in seen.items()}
    count = -(-touched([(steps[axis], len(own)) for axis, own in seen.items()], array.itemsize) // most)
    outer = max(seen, key=lambda axis: (len(seen[axis]) > 1, steps[axis]))
    n, at = indices[outer]
    for some in np.array_split(seen[outer], min(count, len(seen[outer]))):
        yield n, np.flatnonzero((some[0] <= at) & (at <= some[-1]))


def _step(seen: NDArray[np.intp]) -> float:
    """How far apart ascending numbers are on average."""
    return (int(seen[-1]) - int(seen[0])) / max(1, len(seen) - 1)
