"""A sample of the blocks of a grid, all of one shape, for candidates to be judged on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod

import numpy as np
from numpy.typing import NDArray

from .axes import Axis, Organisation, axis_order
from .slabs import thinning
from .source import Source

F32 = NDArray[np.float32]

#: Fewer blocks than these would be chance, and are thinned where they hold more elements than asked for; more tell no
#: more.
FEWEST, MOST = 4, 256


@dataclass(frozen=True, eq=False)
class Blocks:
    """Some blocks of a grid, `[B, rows along each axis]`.

    Blocks of a grid differ by a row at most; here all have the rows of the largest, and short ones share some with the
    next.

    Attributes:
        values: every steps-th row of the blocks.
        edges: rows of a block along each axis, before any were left out.
        share: how many of the grid's blocks they are.
        elements: how many of all elements, which is more as they overlap.
        steps: of the rows along each axis one of so many was taken.
    """

    values: F32
    edges: tuple[int, ...]
    share: float
    elements: float
    steps: tuple[int, ...]

    @property
    def thinned(self) -> bool:
        """Whether rows were left out."""
        return max(self.steps) > 1


def sampled_blocks(source: Source, values: F32 | None, grid: Sequence[int], sample: int, seed: int) -> Blocks:
    """Blocks that hold about `sample` elements, evenly spread; `values` are those of the source where they are held."""
    number, shape = prod(grid), source.shape
    wanted = int(min(number, MOST, max(FEWEST, round(sample * number / prod(shape)))))
    edges = tuple(-(-length // count) for length, count in zip(shape, grid, strict=True))
    steps = thinning(edges, 2 * sample // wanted)
    chosen: list[F32] = []
    for place in spread(grid, wanted, seed):
        starts = map(_start, place, grid, shape)
        part = tuple(slice(start, start + edge, step) for start, edge, step in zip(starts, edges, steps, strict=True))
        chosen.append(source.values(part) if values is None else values[part])
    elements = wanted * prod(edges) / prod(shape)
    return Blocks(np.stack(chosen), edges, wanted / number, elements, tuple(steps))


def split(values: F32, counts: Sequence[int]) -> F32:
    """Blocks `[B, rows along each axis]` cut into so many along each axis, those of one block one after another.

    >>> split(np.arange(10, dtype=np.float32).reshape(2, 5), (2,)).tolist()
    [[0.0, 1.0, 2.0], [2.0, 3.0, 4.0], [5.0, 6.0, 7.0], [7.0, 8.0, 9.0]]
    """
    sizes = values.shape[1:]
    edges = [-(-size // count) for size, count in zip(sizes, counts, strict=True)]
    parts: list[F32] = []
    for place in np.ndindex(*counts):
        starts = map(_start, place, counts, sizes)
        part = tuple(slice(start, start + edge) for start, edge in zip(starts, edges, strict=True))
        parts.append(values[(slice(None), *part)])
    return np.stack(parts, axis=1).reshape(-1, *edges)


def halved(blocks: Blocks) -> F32:
    """The blocks with every second of the rows along the axes that were thinned."""
    return blocks.values[(slice(None), *(slice(None, None, 2 if step > 1 else 1) for step in blocks.steps))]


def finer(blocks: Blocks, around: Sequence[int], grid: Sequence[int]) -> Blocks:
    """Blocks of the grid `around` as those of a `grid` of multiples of its counts."""
    counts = [own // before for own, before in zip(grid, around, strict=True)]
    if prod(counts) == 1:
        return blocks
    edges = tuple(-(-edge // count) for edge, count in zip(blocks.edges, counts, strict=True))
    more = prod(counts) * prod(edges) / prod(blocks.edges)
    return Blocks(split(blocks.values, counts), edges, blocks.share, blocks.elements * more, blocks.steps)


def organised(blocks: F32, axes: Sequence[Axis], organisation: Organisation) -> F32:
    """Blocks `[B, axes]` as tensors of the organisation's modes."""
    order = axis_order(axes, organisation)
    sizes = iter(blocks.shape[1 + n] for n in order)
    modes = [prod(next(sizes) for _ in mode) for mode in organisation]
    return blocks.transpose(0, *(1 + n for n in order)).reshape(len(blocks), *modes)


def _start(index: int, count: int, length: int) -> int:
    """First row of one of so many blocks of equal length."""
    short, longer = divmod(length, count)
    return min(index * short + min(index, longer), length - -(-length // count))


def spread(grid: Sequence[int], wanted: int, seed: int) -> list[tuple[int, ...]]:
    """Places of so many blocks that lie evenly: where points of an additive recurrence fall (Roberts, 2018).

    All grids are looked at around the same points, so that what chance makes of the sample they share.

    >>> spread((2, 2), 4, 0)
    [(0, 0), (0, 1), (1, 0), (1, 1)]
    """
    if wanted == prod(grid):
        return [tuple(int(i) for i in place) for place in np.ndindex(*grid)]
    found = dict[tuple[int, ...], None]()
    for point in _points(len(grid), seed):
        found[tuple(min(int(x * count), count - 1) for x, count in zip(point, grid, strict=True))] = None
        if len(found) == wanted:
            return sorted(found)
    raise AssertionError


def _points(order: int, seed: int) -> Iterator[list[float]]:
    root = 2.0
    for _ in range(64):
        root = (1 + root) ** (1 / (order + 1))
    start = np.random.default_rng(seed).random(order)
    number = 0
    while True:
        number += 1
        yield [float((start[n] + number * root ** -(n + 1)) % 1) for n in range(order)]
