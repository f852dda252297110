"""A sample of the blocks of a grid, all of one shape, for candidates to be judged on."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from math import inf, prod
from threading import Lock
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis, Organisation, axis_order
from ..streaming.source import Source
from ..support.slabs import thinning
from .detail import Detail, detail_of

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
T = TypeVar("T")

#: Most elements of a source whose values are held in memory.
HELD = 1 << 24
#: Most elements of a source whose samples are kept from one goal's choice to the next.
SHARED = 1 << 22
#: Blocks of a sample at the least: what fewer tell is chance. They are thinned to hold the elements asked for.
FEWEST = 8
#: Blocks of a sample at the most: further ones tell no more.
MOST = 96
#: Where more than this share of the blocks is asked for, all are looked at.
NEARLY_ALL = 0.7
#: How often blocks of some detail are drawn goes with this power of it, in multiples of the mean ..
POWER = 0.5
#: .. plus this constant.
FLOOR = 0.25
#: Blocks are thinned where they hold so many times the elements asked for.
UNTHINNED = 4


@dataclass(frozen=True, eq=False)
class Blocks:
    """Some blocks of a grid, `[B, rows along each axis]`.

    Blocks of a grid differ by a row at most; here all have the rows of the largest, and short ones share some with the
    next.

    Attributes:
        values: every steps-th row of the blocks.
        edges: rows of a block along each axis, before any were left out.
        weights: for how many of the grid's blocks each stands.
        overlap: elements of all blocks of the grid, over those of the array.
        steps: of the rows along each axis one of so many was taken.
        seen: the detail that they stand for, over that of all blocks: as energies do, errors go with it.
    """

    values: F32
    edges: tuple[int, ...]
    weights: F64
    overlap: float
    steps: tuple[int, ...]
    seen: float

    @property
    def thinned(self) -> bool:
        """Whether rows were left out."""
        return max(self.steps) > 1


class Samples:
    """What is looked at of a source, whatever the goal: its values, where they are held, and samples of blocks.

    Samples are by grid, size and room; the last are kept, as candidates of one grid follow one another.
    """

    def __init__(self, source: Source, values: F32 | None, detail: Detail) -> None:
        self.values = values
        self._data = (source, values, detail)
        self._last = OrderedDict[tuple[tuple[int, ...], int, int], Blocks]()
        self._known = dict[Any, Any]()
        self._lock = Lock()

    def once(self, key: Hashable, find: Callable[[], T]) -> T:
        """The value under a key, found once for all goals of the source; twice, and alike, if two threads ask at once.

        The key names all that it depends on besides the source and the seed. It is kept as long as the samples are, and
        so has to be small.
        """
        if key not in self._known:
            self._known[key] = find()
        return cast("T", self._known[key])

    def of(self, grid: tuple[int, ...], sample: int, room: float, kept: float) -> Blocks:
        """As `sampled_blocks`; of those before it `kept` elements stay."""
        key = grid, sample, int(min(UNTHINNED * sample, room))
        with self._lock:
            if (found := self._last.get(key)) is not None:
                self._last.move_to_end(key)
                return found
        found = sampled_blocks(*self._data, grid, sample, room)
        with self._lock:
            self._last[key] = found
            while sum(blocks.values.size for blocks in self._last.values()) > kept:
                self._last.popitem(last=False)
        return found


def samples_of(source: Source) -> Samples:
    """Samples of a source, whose values are held if they are not too many."""
    held = source.values() if prod(source.shape) <= HELD else None
    return Samples(source, held, detail_of(source, held))


def sampled_blocks(
    source: Source, values: F32 | None, detail: Detail, grid: Sequence[int], sample: int, room: float = inf
) -> Blocks:
    """Blocks that hold about `sample` elements and stand for all; `values` are the source's where they are held.

    Few large ones hold more elements, up to so many as there is `room` for.
    """
    number, shape = prod(grid), source.shape
    wanted = int(min(MOST, max(FEWEST, round(sample * number / prod(shape)))))
    wanted = number if wanted > NEARLY_ALL * number else wanted
    edges = tuple(-(-length // count) for length, count in zip(shape, grid, strict=True))
    steps = thinning(edges, int(min(UNTHINNED * sample, room) // wanted))
    own = detail.of(grid).reshape(-1)
    places, weights = representatives(own, wanted)
    chosen: list[F32] = []
    for place in np.stack(np.unravel_index(places, grid), axis=1).tolist():
        starts = map(_start, place, grid, shape)
        part = tuple(slice(start, start + edge, step) for start, edge, step in zip(starts, edges, steps, strict=True))
        chosen.append(source.values(part) if values is None else values[part])
    seen = float(weights @ own[places]) / total if (total := float(own.sum())) else 1.0
    return Blocks(np.stack(chosen), edges, weights, prod(edges) * number / prod(shape), tuple(steps), seen)


def representatives(detail: F64, wanted: int) -> tuple[NDArray[np.intp], F64]:
    """Up to so many blocks that stand for all, and for how many each.

    Sorted by their detail, blocks are parted into runs, shorter ones where there is more, and the middle one stands for
    its run: what few busy blocks leave is most of the error, and the many quiet ones are alike.

    >>> places, weights = representatives(np.array([0.0, 9.0, 0.0, 0.0]), 2)
    >>> places.tolist(), weights.tolist()
    ([2, 1], [3.0, 1.0])
    """
    number = len(detail)
    if wanted == number:
        return np.arange(number), np.ones(number)
    order = np.argsort(detail, kind="stable")
    mean = float(detail.mean())
    share = (detail[order] / mean if mean else np.ones(number)) ** POWER + FLOOR
    runs = np.minimum((np.cumsum(share) - share / 2) / share.sum() * wanted, wanted - 1e-9).astype(np.intp)
    _, starts, lengths = np.unique(runs, return_index=True, return_counts=True)
    return order[starts + lengths // 2], lengths.astype(np.float64)


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


def parts_of(blocks: Blocks, around: Sequence[int], grid: Sequence[int]) -> Blocks:
    """Blocks of the grid `around` as those of a `grid` of multiples of its counts."""
    counts = [own // before for own, before in zip(grid, around, strict=True)]
    if prod(counts) == 1:
        return blocks
    edges = tuple(-(-edge // count) for edge, count in zip(blocks.edges, counts, strict=True))
    more = prod(counts) * prod(edges) / prod(blocks.edges)
    weights = np.repeat(blocks.weights, prod(counts))
    return Blocks(split(blocks.values, counts), edges, weights, blocks.overlap * more, blocks.steps, blocks.seen)


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
