"""What a layout is worth: J of a sample of its blocks, each with its best undecomposed modes and ranks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import inf, prod

import numpy as np
from numpy.typing import NDArray

from ..arrays import F64
from .blocks import Slices, as_tensor, by_shape, grid_block, sample
from .hosvd import BlockBatch, Undecomposed
from .kernels import U32, best_boxes
from .layout import Layout
from .values import Values

#: Blocks of which all sets of undecomposed modes are tried, about; the others try the best of these.
SCOUTS = 3
#: Layouts this many times behind by their scouts are not among the best.
HOPELESS = 1.3
#: Sets of undecomposed modes that the other blocks of a layout may use.
MOST_SETS = 3


@dataclass(frozen=True, eq=False)
class Choice:
    """What is best for each block of a batch: J in units of D^2, the set it leaves undecomposed (by number), ranks."""

    costs: F64
    chosen: NDArray[np.intp]
    ranks: U32
    sets: tuple[Undecomposed, ...]


def choose(batch: BlockBatch, sets: Sequence[Undecomposed], step: float, decode_cost: float) -> Choice:
    """Ranks and undecomposed modes of every block of a batch; of equals the earlier set."""
    costs = np.full(len(batch), np.inf)
    chosen = np.zeros(len(batch), np.intp)
    ranks = np.zeros((len(batch), len(batch.sizes)), np.uint32)
    for number, undecomposed in enumerate(sets):
        decomposed = [n not in undecomposed for n in range(len(batch.sizes))]
        found, own = best_boxes(batch.cores(undecomposed), decomposed, step, decode_cost)
        better = found < costs
        costs, chosen = np.where(better, found, costs), np.where(better, number, chosen)
        ranks[better] = own[better]
    return Choice(costs, chosen, ranks, tuple(sets))


@dataclass(frozen=True)
class Verdict:
    """J of the whole array by a sample, in units of D^2, and the sets of undecomposed modes that its blocks use."""

    cost: float
    sets: tuple[Undecomposed, ...]


class Judge:
    """J of layouts of an array, some of them judged at a time."""

    def __init__(self, values: Values, decode_cost: float, *, threads: int = 1) -> None:
        self.values, self.decode_cost, self.threads = values, decode_cost, threads

    def verdict(self, layout: Layout, step: float, elements: int, bar: float = inf) -> Verdict:
        """J by a sample of about so many elements; see `Sample.verdict`."""
        return Sample(self, layout, elements, step).verdict(step, bar)

    def kept(self, layout: Layout, elements: int, step: float) -> Sample:
        """A sample to judge at several steps about a given one."""
        return Sample(self, layout, elements, step, keeps=True)


class Sample:
    """Blocks that stand for all blocks of a layout, at least twelve: a few scouts, and others."""

    def __init__(self, judge: Judge, layout: Layout, elements: int, step: float, *, keeps: bool = False) -> None:
        """Pick blocks by their detail at a step D; `keeps`: their HOSVDs are held, where there is memory for them."""
        self.judge, shape = judge, judge.values.shape
        self.precise = judge.values.precise(step)
        # The longest mode last, where sums along it are fastest; J is the same in any order.
        self.order = sorted(range(len(layout.modes)), key=layout.sizes(layout.block(shape)).__getitem__)
        self.layout = Layout(tuple(layout.modes[n] for n in self.order), layout.edges, layout.ends)
        self.largest, count = prod(layout.block(shape)), prod(layout.blocks(shape))
        size = max(1, judge.values.size // count)
        picked = sample(count, size, elements, judge.values.detail_of(self.layout, step))
        blocks = [grid_block(shape, self.layout, number) for number in picked.tolist()]
        every = max(1, len(blocks) // SCOUTS)
        self.scouts, self.others = blocks[::every], [block for n, block in enumerate(blocks) if n % every]
        self.keeps = keeps and (judge.values.in_memory or len(blocks) * size <= judge.values.together // SCOUTS)
        self._kept: dict[bool, list[BlockBatch]] = {}

    def verdict(self, step: float, bar: float = inf) -> Verdict:
        """J of the whole array at a step D.

        Scouts try all sets of undecomposed modes, the others those that are best for the scouts. A layout whose scouts
        promise a J of more than `HOPELESS` times `bar` is looked at no further.
        """
        seen = _Seen(self.judge.values.size)
        for batch in self._batches(scouts=True):
            sets = tuple(batch.undecomposed_sets())
            seen.add(batch, choose(batch, sets, step, self.judge.decode_cost))
        if seen.cost <= HOPELESS * bar:
            for batch in self._batches(scouts=False):
                sets = seen.best(MOST_SETS, tuple(batch.undecomposed_sets()))
                seen.add(batch, choose(batch, sets, step, self.judge.decode_cost))
        best = [tuple(sorted(self.order[n] for n in undecomposed)) for undecomposed in seen.best(MOST_SETS)]
        return Verdict(seen.cost, tuple(sorted(best)))

    def _batches(self, *, scouts: bool) -> Iterable[BlockBatch]:
        blocks = self.scouts if scouts else self.others
        if not self.keeps:
            return self._decomposed(blocks)
        if scouts not in self._kept:
            self._kept[scouts] = list(self._decomposed(blocks))
        return self._kept[scouts]

    def _decomposed(self, blocks: Sequence[Slices]) -> Iterator[BlockBatch]:
        """Blocks of one shape with their HOSVDs, as many at a time as memory is shared out for."""
        together = max(1, self.judge.values.together // self.judge.threads // self.largest)
        for numbers in by_shape(blocks).values():
            for first in range(0, len(numbers), together):
                own = [self.judge.values[blocks[b]] for b in numbers[first : first + together]]
                tensors = as_tensor(np.stack(own), self.layout.modes)
                yield BlockBatch(tensors, precise=self.precise, keeps=self.keeps)


class _Seen:
    """What the blocks looked at so far come to, scaled to the whole array."""

    def __init__(self, elements: int) -> None:
        self.elements, self.seen, self.sum = elements, 0, 0.0
        self.gains = Counter[Undecomposed]()

    @property
    def cost(self) -> float:
        """J of the whole array."""
        return self.sum * self.elements / max(self.seen, 1)

    def add(self, batch: BlockBatch, choice: Choice) -> None:
        """Count the blocks of a batch."""
        self.sum += float(choice.costs.sum())
        self.seen += batch.values.size
        for number, undecomposed in enumerate(choice.sets):
            self.gains[undecomposed] += int((choice.chosen == number).sum()) * prod(batch.sizes)

    def best(self, most: int, among: Sequence[Undecomposed] | None = None) -> tuple[Undecomposed, ...]:
        """The sets that the most elements use, among some or all; at least one."""
        allowed = list(self.gains) if among is None else list(among)
        ordered = sorted(allowed, key=lambda found: (-self.gains[found], len(found), found))
        used = [found for found in ordered[:most] if self.gains[found]]
        return tuple(sorted(used or ordered[:1]))
