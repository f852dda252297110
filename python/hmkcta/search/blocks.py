"""Blocks of a grid: where they lie, which of them stand for all, and their values as tensors of the layout's modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import ceil, prod
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32
from .layout import Layout, Modes, Span

Slices: TypeAlias = "tuple[Span, ...]"

#: Fewest blocks of a sample: six mislead, twelve do (measured on six sets).
SAMPLE_BLOCKS = 12
#: Indices of an axis that a cell of the map of detail spans.
DETAIL_CELL = 4


def grid_block(shape: Sequence[int], layout: Layout, number: int) -> Slices:
    """One block of a layout's grid, by its number in the order of the nodes: C order of the merged modes."""
    order = axis_order(layout.modes)
    counts = layout.blocks(shape)
    places = np.unravel_index(number, [counts[axis] for axis in order])
    found: dict[int, Span] = {}
    for axis, place in zip(order, places, strict=True):
        found[axis] = layout.span(shape[axis], axis, int(place))
    return tuple(found[axis] for axis in range(len(shape)))


def axis_order(modes: Modes) -> list[int]:
    """Numbers of the axes as they stand in the modes."""
    return [axis for mode in modes for axis in mode]


def as_tensor(values: F32, modes: Modes) -> F32:
    """Blocks `[blocks, *axes]` with the axes of each mode merged, `[blocks, *modes]`, C order."""
    order = [0, *(1 + axis for axis in axis_order(modes))]
    sizes = [prod(values.shape[1 + axis] for axis in mode) for mode in modes]
    return np.ascontiguousarray(values.transpose(order)).reshape(len(values), *sizes)


def by_shape(blocks: Sequence[Slices]) -> dict[tuple[int, ...], NDArray[np.intp]]:
    """Numbers of the blocks of each shape."""
    found: dict[tuple[int, ...], list[int]] = {}
    for number, block in enumerate(blocks):
        found.setdefault(tuple(part.stop - part.start for part in block), []).append(number)
    return {shape: np.array(numbers, np.intp) for shape, numbers in found.items()}


@dataclass(frozen=True, eq=False)
class Region:
    """Neighbouring blocks, which are read at once.

    Attributes:
        parts: the blocks along each axis.
        first: number of the first one along each axis.
        counts: how many blocks the whole array has along each axis.
        order: the axes as they stand in the modes.
    """

    parts: list[list[Span]]
    first: tuple[int, ...]
    counts: tuple[int, ...]
    order: list[int]

    @property
    def part(self) -> Slices:
        """The part of the array that the blocks fill."""
        return tuple(slice(own[0].start, own[-1].stop) for own in self.parts)

    @property
    def numbers(self) -> NDArray[np.intp]:
        """Numbers of the blocks in the order of the nodes."""
        places = np.indices([len(own) for own in self.parts]).reshape(len(self.parts), -1)
        at = [places[axis] + self.first[axis] for axis in self.order]
        return np.asarray(np.ravel_multi_index(at, [self.counts[axis] for axis in self.order]), np.intp)

    @property
    def blocks(self) -> list[Slices]:
        """Where each block lies in the part."""
        inside = [[slice(block.start - own[0].start, block.stop - own[0].start) for block in own] for own in self.parts]
        return list(product(*inside))


def regions(shape: Sequence[int], layout: Layout, elements: int) -> list[Region]:
    """The whole grid as regions of at most so many elements, or of one block, in the order of the array.

    >>> layout = Layout(((0, 1),), (4, 2))
    >>> [(region.part[0], region.numbers.tolist()) for region in regions((5, 4), layout, 12)]
    [(slice(0, 2, None), [0, 1]), (slice(2, 5, None), [2, 3])]
    """
    parts = [layout.spans(shape, axis) for axis in range(len(shape))]
    counts, order = layout.blocks(shape), axis_order(layout.modes)
    together, room = [1] * len(parts), elements // prod(map(_longest, parts))
    for axis in reversed(range(len(parts))):  # what lies together in memory first
        together[axis] = max(1, min(counts[axis], room))
        room //= together[axis]
    return [Region([own[at : at + step] for own, at, step in zip(parts, first, together, strict=True)], first, counts,
                   order)
            for first in product(*(range(0, count, step) for count, step in zip(counts, together, strict=True)))]


def _longest(blocks: Sequence[Span]) -> int:
    return max(block.stop - block.start for block in blocks)


def sample(blocks: int, elements: int, wanted: int, detail: NDArray[np.float64]) -> NDArray[np.intp]:
    """Numbers of blocks that stand for all: evenly spaced when ordered by detail, never fewer than `SAMPLE_BLOCKS`.

    Args:
        blocks: how many there are.
        elements: of one of them.
        wanted: elements of the sample.
        detail: of every block.
    """
    count = max(SAMPLE_BLOCKS, ceil(wanted / elements))
    if count >= blocks:
        return np.arange(blocks)
    order = np.argsort(detail, kind="stable")
    places = ((np.arange(count) + 0.5) * (blocks / count)).astype(np.intp)
    return np.sort(order[places])
