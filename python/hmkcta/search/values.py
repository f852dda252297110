"""The values that a search reads: whole in memory, or part by part from a source that memory does not hold."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import prod
from threading import Lock

import numpy as np

from ..arrays import F32, F64
from .blocks import DETAIL_CELL, Slices, axis_order, cut
from .layout import Layout

#: Values of a part of the array given by slices, float32, in the array's axes.
ReadPart = Callable[[Slices], F32]

#: Elements that are looked at together when all are scanned, about.
SCANNED = 1 << 22


@dataclass(eq=False)
class Values:
    """An array to search, with what one pass over it tells.

    Args:
        shape: of the array.
        read: gives parts of it.
        room: bytes of parts that are kept because they are read again; None: the array is in memory, nothing is kept.

    Attributes:
        energy: sum of squares, in float64.
        detail: sums of squared differences of neighbours, in cells of a few indices an axis.
    """

    shape: tuple[int, ...]
    read: ReadPart
    room: int | None = None
    energy: float = field(init=False)
    detail: F64 = field(init=False)
    _kept: OrderedDict[tuple[tuple[int, int], ...], F32] = field(init=False, default_factory=OrderedDict)
    _lock: Lock = field(init=False, default_factory=Lock)

    def __post_init__(self) -> None:
        self.energy, self.detail = _scanned(self.shape, self.read)

    @classmethod
    def of_array(cls, values: F32) -> Values:
        """The values of an array in memory.

        >>> Values.of_array(np.ones((4, 6), np.float32)).energy
        24.0
        """
        return cls(values.shape, lambda part: values[part])

    @property
    def size(self) -> int:
        """Number of elements."""
        return prod(self.shape)

    def __getitem__(self, part: Slices) -> F32:
        """A part of the array; samples of a source are read once, as long as there is room."""
        if self.room is None:
            return self.read(part)
        key = tuple((own.start, own.stop) for own in part)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        found = self.read(part)
        with self._lock:
            self._kept[key] = found
            self.room -= found.nbytes
            while self.room < 0 and len(self._kept) > 1:
                self.room += self._kept.popitem(last=False)[1].nbytes
        return found

    def detail_of(self, layout: Layout) -> F64:
        """Detail of every block of a grid, in the order of `grid_blocks`; blocks may share cells of the map."""
        sums = self.detail
        for axis, (size, edge) in enumerate(zip(self.shape, layout.edges, strict=True)):
            starts = np.array([part.start // _cell(size) for part in cut(size, edge)])
            sums = np.add.reduceat(sums, starts, axis=axis)
        return sums.transpose(axis_order(layout.modes)).reshape(-1)


def _cell(size: int) -> int:
    return DETAIL_CELL if size > 2 * DETAIL_CELL else 1


def _scanned(shape: Sequence[int], read: ReadPart) -> tuple[float, F64]:
    """Energy and detail, slab by slab along the first axis; slabs of one array are the same wherever it lies."""
    steps = [_cell(size) for size in shape]
    rows = max(1, SCANNED // prod(shape[1:]) // steps[0]) * steps[0]
    energy, cells = 0.0, list[F64]()
    for start in range(0, shape[0], rows):
        before = max(start - 1, 0)  # the difference to the slab before counts, too
        slab = read((slice(before, min(start + rows, shape[0])), *(slice(0, size) for size in shape[1:])))
        own = slab[start - before :]
        energy += float(np.square(own, dtype=np.float64).sum())
        cells.append(_changes(slab, start - before, steps))
    return energy, np.concatenate(cells)


def _changes(slab: F32, skipped: int, steps: Sequence[int]) -> F64:
    """Sums of squared differences in cells of these edges, of all rows but the first `skipped`."""
    total = np.zeros(slab.shape, np.float32)
    for axis in range(slab.ndim):
        change = np.diff(slab, axis=axis)
        total[(*(slice(None),) * axis, slice(1, None))] += change * change
    sums = total[skipped:].astype(np.float64)
    for axis, step in enumerate(steps):
        sums = np.add.reduceat(sums, np.arange(0, sums.shape[axis], step), axis=axis)
    return sums


def read_blocks(values: Values, blocks: Sequence[Slices]) -> F32:
    """Blocks of one shape, `[blocks, *axes]`; of a source all that they span along its first axis is read at once."""
    if values.room is None:
        return np.stack([values.read(block) for block in blocks])
    ends = [(min(b[n].start for b in blocks), max(b[n].stop for b in blocks)) for n in range(len(values.shape))]
    spanned = prod(stop - start for start, stop in ends)
    if spanned > 4 * len(blocks) * prod(part.stop - part.start for part in blocks[0]):
        return np.stack([values.read(block) for block in blocks])
    part = values.read(tuple(slice(*pair) for pair in ends))
    first = [start for start, _ in ends]
    inside = [tuple(slice(own.start - at, own.stop - at) for own, at in zip(b, first, strict=True)) for b in blocks]
    return np.stack([part[block] for block in inside])
