"""Layouts that are searched: which axes are merged into modes, and the grid that cuts the array into blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from math import prod
from typing import Any, TypeAlias

#: Axes of at most this many indices are not cut by the first grids, but wholly or not at all (RGB, few views).
SHORT_AXIS = 9
#: Edges of the first grids; the whole axis is one more.
FIRST_EDGES = (4, 8, 16, 32, 64)
#: A block has at least this many elements, as its columns and ranks take some bytes whatever it holds.
SMALLEST_BLOCK = 32
#: Arrays of more axes have too many organisations (52 for five, 4140 for eight): only those one step away are tried.
ALL_ORGANISATIONS = 5

Modes = tuple[tuple[int, ...], ...]
Span: TypeAlias = "slice[int, int, None]"


@dataclass(frozen=True, order=True)
class Layout:
    """One way to cut an array into blocks and to order their axes.

    Attributes:
        modes: the numbers of the axes that each mode merges, in C order.
        edges: the most indices of a block along each axis; blocks of an axis differ by one at most.
        ends: where the blocks of each axis begin and end, from 0 to its size; none of an axis that is cut by its edge.

    >>> layout = Layout(((0, 2), (1,)), (4, 8, 3))
    >>> layout.blocks((8, 8, 3)), layout.sizes((4, 8, 3))
    ((2, 1, 1), (12, 8))
    """

    modes: Modes
    edges: tuple[int, ...]
    ends: tuple[tuple[int, ...], ...] = ()

    def span(self, size: int, axis: int, place: int) -> Span:
        """One block along an axis of this size: p of g goes from floor(size p / g) on (docs/format.md)."""
        if self.ends and self.ends[axis]:
            return slice(*self.ends[axis][place : place + 2])
        count = -(-size // self.edges[axis])
        return slice(size * place // count, size * (place + 1) // count)

    def spans(self, shape: Sequence[int], axis: int) -> list[Span]:
        """The blocks along an axis of an array of this shape.

        >>> Layout(((0,),), (4,)).spans((10,), 0)
        [slice(0, 3, None), slice(3, 6, None), slice(6, 10, None)]
        """
        return [self.span(shape[axis], axis, place) for place in range(self.blocks(shape)[axis])]

    def blocks(self, shape: Sequence[int]) -> tuple[int, ...]:
        """Number of blocks along each axis of an array of this shape."""
        ends = self.ends or [()] * len(shape)
        return tuple(len(own) - 1 if own else -(-size // edge)
                     for size, edge, own in zip(shape, self.edges, ends, strict=True))

    def block(self, shape: Sequence[int]) -> tuple[int, ...]:
        """Shape of the largest block of an array of this shape."""
        ends = self.ends or [()] * len(shape)
        return tuple(max(last - first for first, last in pairwise(own)) if own else -(-size // count)
                     for size, count, own in zip(shape, self.blocks(shape), ends, strict=True))

    def sizes(self, block: Sequence[int]) -> tuple[int, ...]:
        """Mode sizes of a block whose axes have these lengths."""
        return tuple(prod(block[axis] for axis in mode) for mode in self.modes)


def read_layout(shape: Sequence[int], modes: Sequence[Sequence[Any]], edges: Sequence[Any]) -> Layout:
    """The layout of an array of this shape that lists describe, as JSON has them.

    Raises:
        TypeError, ValueError: they describe none.

    >>> read_layout((8, 8, 3), [[0, 2], [1]], [4, 8, 3])
    Layout(modes=((0, 2), (1,)), edges=(4, 8, 3), ends=())
    """
    found = Layout(tuple(tuple(mode) for mode in modes), tuple(edges))
    if sorted(axis for mode in found.modes for axis in mode) != list(range(len(shape))):
        raise ValueError("modes that are none")
    if not all(isinstance(edge, int) and 1 <= edge <= size for edge, size in zip(edges, shape, strict=True)):
        raise ValueError("edges that are none")
    return found


def canonical(modes: Modes, sizes: Sequence[int]) -> Modes:
    """The organisation with axes of one index in its first mode: wherever they are they change nothing.

    >>> canonical(((0,), (1, 3), (2,)), (8, 9, 1, 1))
    ((0, 2, 3), (1,))
    """
    rest = [tuple(axis for axis in mode if sizes[axis] > 1) for mode in modes]
    long = [mode for mode in rest if mode] or [()]
    return tuple(sorted((*long[0], *(axis for axis, size in enumerate(sizes) if size == 1)))), *long[1:]


def organisations(order: int) -> list[Modes]:
    """Every way to merge axes into two modes or more (one axis: one mode).

    >>> organisations(3)
    [((0, 2), (1,)), ((0,), (1, 2)), ((0, 1), (2,)), ((0,), (1,), (2,))]
    """
    found: list[list[list[int]]] = [[]]
    for axis in range(order):
        merged = [[*g[:k], [*g[k], axis], *g[k + 1 :]] for g in found for k in range(len(g))]
        found = merged + [[*g, [axis]] for g in found]
    parted = [tuple(map(tuple, g)) for g in found if len(g) > 1 or order == 1]
    return sorted(set(parted), key=lambda modes: (len(modes), _inversions(modes)))


def _inversions(modes: Modes) -> tuple[int, ...]:
    return tuple(-axis for mode in modes for axis in mode)


def moves(modes: Modes) -> Iterator[Modes]:
    """Organisations one step away: two modes merged, or an axis put into a mode of its own or another one.

    >>> sorted(moves(((0, 1), (2,))))
    [((0,), (1,), (2,)), ((0,), (1, 2)), ((0, 2), (1,))]
    """
    seen = {modes}
    for n, mode in enumerate(modes):
        for axis in mode:
            rest = [tuple(a for a in other if a != axis) for other in modes]
            places = [(*rest[m], axis) for m in range(len(modes)) if m != n]
            others = [m for m in range(len(modes)) if m != n]
            choices = [*zip(others, places, strict=True), (len(modes), (axis,))]
            for m, place in choices:
                changed = [*rest, ()]
                changed[m] = tuple(sorted(place))
                found = tuple(sorted(group for group in changed if group))
                if found not in seen and len(found) > 1:
                    seen.add(found)
                    yield found


def first_layouts(shape: Sequence[int], modes: Modes | None = None) -> list[Layout]:
    """What a search begins with: unmerged axes on some twenty grids, and all matrices of the whole array.

    With `modes` given these alone, on the same grids.

    >>> len(first_layouts((9, 9, 128, 192, 3))) < 80
    True
    """
    order = len(shape)
    single = tuple((axis,) for axis in range(order))
    grids: set[tuple[int, ...]] = {tuple(shape)}
    for edge, uncut in product(FIRST_EDGES, (True, False)):
        grids.add(tuple((size if uncut else 1) if size <= SHORT_AXIS else min(size, edge) for size in shape))
    for axis, edge, own in product(range(order), (8, 16, 32), (1, 4, 1 << 60)):
        grid = [size if size <= SHORT_AXIS else min(size, edge) for size in shape]
        grid[axis] = min(shape[axis], own)
        grids.add(tuple(grid))
    if modes is not None:
        return [Layout(modes, grid) for grid in sorted(grids) if large_enough(grid, shape)]
    matrices = [Layout(canonical(two, shape), tuple(shape)) for two in organisations(order) if len(two) <= 2]
    single = canonical(single, shape)
    return [*dict.fromkeys(matrices), *(Layout(single, grid) for grid in sorted(grids) if large_enough(grid, shape))]


def large_enough(edges: Sequence[int], shape: Sequence[int]) -> bool:
    """Whether blocks of these edges have elements enough, or are the whole array."""
    return prod(edges) >= min(SMALLEST_BLOCK, prod(shape))


def neighbours(layout: Layout, shape: Sequence[int], *, organise: bool) -> Iterator[Layout]:
    """Grids of more or fewer blocks along one axis; with `organise` also other organisations on the same grid."""
    order = len(shape)
    others = organisations(order) if order <= ALL_ORGANISATIONS else moves(layout.modes)
    others = others if organise else ()
    for modes in dict.fromkeys(canonical(modes, shape) for modes in others):
        if modes != layout.modes:
            yield Layout(modes, layout.edges)
    for axis, count in enumerate(layout.blocks(shape)):
        for changed in {2 * count, (count + 1) // 2, (3 * count + 1) // 2, shape[axis]}:
            # Single indices are only a step away from short blocks.
            near = changed != shape[axis] or layout.edges[axis] <= SHORT_AXIS
            if changed != count and changed <= shape[axis] and near:
                edges = (*layout.edges[:axis], -(-shape[axis] // changed), *layout.edges[axis + 1 :])
                if large_enough(edges, shape):
                    yield Layout(layout.modes, edges)
