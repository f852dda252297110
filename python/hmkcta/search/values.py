"""The values that a search reads: whole in memory, or part by part from a source that memory does not hold."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import prod, sqrt
from threading import Lock
from typing import TypeAlias

import numpy as np

from ..arrays import F32, F64
from .blocks import DETAIL_CELL, Slices, axis_order
from .layout import Layout

#: Values of a part of the array given by slices, float32, in the array's axes.
ReadPart = Callable[[Slices], F32]

#: Where a part starts and stops along each axis.
Ends: TypeAlias = "tuple[tuple[int, int], ...]"
#: Elements that are looked at together when all are scanned, and that are decomposed and coded together, at most.
SCANNED, TOGETHER = 1 << 20, 1 << 22
#: Of the bytes allowed, the share of parts that are kept because samples are read again.
KEPT = 0.25
#: Bytes for each element of blocks that are worked on: values, Gram matrices, cores of a few sets and what is made of
#: them (measured on the process: 30 to 40).
WORKING = 40
#: Squared differences are counted this many times, as a log2 of 1 and them (1 and 4 were compared).
DETAIL_SCALE = 4.0
#: Most elements of a block of an array that is read part by part, as samples have twelve of them.
LARGEST_READ = 1 << 20


#: From steps below this share of the root mean square on, which leave about 50 dB, Gram matrices are float64: those of
#: float32 end at some 65 dB.
PRECISE_STEP = 0.01


@dataclass(eq=False)
class Values:
    """An array to search, with what one pass over it tells.

    Args:
        shape: of the array.
        read: gives parts of it.
        memory: bytes to work in; None: the array is in memory, with room for as much again several times.
        known: sum of squares of an array of which no more is asked: it is not looked at, and has no detail.

    Attributes:
        energy: sum of squares, in float64.
        detail: sums of squared differences of neighbours, in cells of a few indices an axis.
        together: most elements that are worked on at once.
    """

    shape: tuple[int, ...]
    read: ReadPart
    memory: int | None = None
    known: float | None = None
    energy: float = field(init=False)
    detail: F64 = field(init=False)
    together: int = field(init=False)
    _room: float = field(init=False, default=0.0)
    _kept: OrderedDict[Ends, F32] = field(init=False, default_factory=lambda: OrderedDict[Ends, F32]())
    _lock: Lock = field(init=False, default_factory=Lock)

    def __post_init__(self) -> None:
        if self.known is None:
            self.energy, self.detail = _scanned(self.shape, self.read)
        else:
            self.energy, self.detail = self.known, np.zeros([-(-size // _cell(size)) for size in self.shape])
        self.together = TOGETHER if self.memory is None else min(TOGETHER, self.memory // (2 * WORKING))
        self._room = KEPT * (self.memory or 0)

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

    @property
    def rms(self) -> float:
        """Root mean square; 1 of zeros."""
        return sqrt(self.energy / self.size) or 1.0

    def precise(self, step: float) -> bool:
        """Whether HOSVDs for a step D have to be found in float64."""
        return step < PRECISE_STEP * self.rms

    @property
    def in_memory(self) -> bool:
        """Whether parts need not be read from a source."""
        return self.memory is None

    def holds(self, block: Sequence[int]) -> bool:
        """Whether memory suffices to work on a block of this shape."""
        return self.in_memory or prod(block) <= min(self.together, LARGEST_READ)

    def __getitem__(self, part: Slices) -> F32:
        """A part of the array; samples of a source are read once, as long as there is room."""
        if self.in_memory:
            return self.read(part)
        key = tuple((own.start, own.stop) for own in part)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        found = self.read(part)
        with self._lock:
            self._kept[key] = found
            self._room -= found.nbytes
            while self._room < 0 and self._kept:
                self._room += self._kept.popitem(last=False)[1].nbytes
        return found

    def detail_of(self, layout: Layout, step: float) -> F64:
        """Detail of every block of a grid at a step D, in the order of the nodes; blocks may share cells of the map.

        What a cell takes is about the logarithm of its differences in units of D: J of blocks correlates with the sum
        of these by 0.6 to 0.9, with that of the differences by 0.4 to 0.8 (fMRI, multi-light; samples are 3 % off in
        place of 6).
        """
        elements: F64 = np.ones(self.detail.shape)
        for axis, size in enumerate(self.shape):
            starts = list(range(0, size, _cell(size)))
            lengths = [end - start for start, end in zip(starts, [*starts[1:], size], strict=True)]
            along = [1] * len(self.shape)
            along[axis] = len(lengths)
            elements = elements * np.array(lengths, np.float64).reshape(along)
        sums = elements * np.log2(1 + DETAIL_SCALE * self.detail / (elements * step * step))
        for axis, size in enumerate(self.shape):
            starts = np.array([part.start // _cell(size) for part in layout.spans(self.shape, axis)])
            sums = np.add.reduceat(sums, starts, axis=axis)
        return sums.transpose(axis_order(layout.modes)).reshape(-1)


def _cell(size: int) -> int:
    return DETAIL_CELL if size > 2 * DETAIL_CELL else 1


def _scanned(shape: Sequence[int], read: ReadPart) -> tuple[float, F64]:
    """Energy and detail, part by part; parts of one array are the same wherever it lies."""
    steps = [_cell(size) for size in shape]
    lengths, room = list(steps), SCANNED // prod(steps)
    for axis in reversed(range(len(shape))):
        cells = max(1, min(-(-shape[axis] // steps[axis]), room))
        lengths[axis], room = cells * steps[axis], room // cells
    energy, detail = 0.0, np.zeros([-(-size // step) for size, step in zip(shape, steps, strict=True)])
    for starts in product(*(range(0, size, length) for size, length in zip(shape, lengths, strict=True))):
        ends = [min(at + length, size) for at, length, size in zip(starts, lengths, shape, strict=True)]
        before = [max(at - 1, 0) for at in starts]  # the differences to the part before count, too
        part = read(tuple(map(slice, before, ends)))
        skipped = [at - first for at, first in zip(starts, before, strict=True)]
        own = part[tuple(slice(skip, None) for skip in skipped)]
        energy += float(np.square(own, dtype=np.float64).sum())
        cells_of = tuple(slice(at // step, -(-end // step)) for at, end, step in zip(starts, ends, steps, strict=True))
        detail[cells_of] = _changes(part, skipped, steps)
    return energy, detail


def _changes(part: F32, skipped: Sequence[int], steps: Sequence[int]) -> F64:
    """Sums of squared differences in cells of these edges, of all elements but the first `skipped` along each axis."""
    own = tuple(slice(skip, None) for skip in skipped)
    sums = np.zeros(part[own].shape, np.float64)
    for axis, skip in enumerate(skipped):
        change: F64 = np.diff(part, axis=axis).astype(np.float64)[(*own[:axis], slice(None), *own[axis + 1 :])]
        sums[(*(slice(None),) * axis, slice(1 - skip, None))] += np.square(change)
    for axis, step in enumerate(steps):
        sums = np.add.reduceat(sums, np.array(range(0, sums.shape[axis], step)), axis=axis)
    return sums
