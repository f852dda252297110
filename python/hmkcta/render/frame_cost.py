"""What decoding costs, counted and not timed: the same on every machine.

`picked_cost` walks the tree as `shaders/weighted.wgsl` does and counts instead of computing. An element decoded on its
own is the case of one row a mode.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import product
from math import prod

import numpy as np
from numpy.typing import NDArray

from ..model import Model
from ..packed import PackedLevel
from .cell_loops import registered_stages
from .prelude import Options, axis_places, colour_mode
from .single_cell import is_single
from .tree import tree_of

#: Bytes of a float16 number and of a word of the tables.
_HALF, _WORD = 2, 4


@dataclass(frozen=True)
class Cost:
    """Counts for one value, or sums of them over several.

    Attributes:
        nodes: nodes visited.
        cells: cores contracted.
        multiply_adds: of the cores, and of the weighted basis rows; three each where there are colours.
        coefficients: float16 numbers read, from the caches or not.
        words: words of tables read.
    """

    nodes: float = 0
    cells: float = 0
    multiply_adds: float = 0
    coefficients: float = 0
    words: float = 0

    @property
    def flops(self) -> float:
        """Floating point operations: two for each multiply-add."""
        return 2 * self.multiply_adds

    @property
    def nbytes(self) -> float:
        """Bytes read, caches not considered."""
        return _HALF * self.coefficients + _WORD * self.words

    def __add__(self, other: Cost) -> Cost:
        return Cost(*(getattr(self, field.name) + getattr(other, field.name) for field in fields(Cost)))

    def times(self, factor: float) -> Cost:
        """So many of it."""
        return Cost(*(factor * getattr(self, field.name) for field in fields(Cost)))


def picked_cost(model: Model, picks: Mapping[int, Sequence[int]], channels: int = 1,
                contracted: Sequence[int] = ()) -> Cost:
    """The cost of one weighted sum of elements.

    Args:
        model: what is decoded.
        picks: for each source axis its indices; an axis left out stands at 0.
        channels: 3 if red, green and blue are decoded in one walk.
        contracted: modes that are contracted once a frame.

    >>> from hmkcta._example import example_level, example_metadata
    >>> picked_cost(Model(example_metadata(), [example_level()]), {0: [1], 1: [2]}).multiply_adds
    4
    """
    modes, strides = axis_places(model.metadata)
    rows = [np.zeros(1, np.int64) for _ in model.metadata.organisation]
    for axis, (mode, stride) in enumerate(zip(modes, strides, strict=True)):
        index = np.asarray(picks.get(axis, [0]), np.int64)
        rows[mode] = (rows[mode][:, None] + index * stride).reshape(-1)
    colour, tinted = colour_mode(model.metadata, Options(channels=channels, contracted=tuple(contracted)))
    tree = tree_of(model.metadata, model.stages)
    registered = registered_stages(tree, [len(each) for each in rows], colour, contracted)
    single = is_single(tree)
    counter = _Counter(model, colour, tinted, single, tuple(contracted), tuple(registered))
    return counter.node(0, 0, rows)


def mean_cost(model: Model, samples: Sequence[Mapping[int, Sequence[int]]], channels: int = 1,
              contracted: Sequence[int] = ()) -> Cost:
    """The mean cost of several weighted sums."""
    total = sum((picked_cost(model, picks, channels, contracted=contracted) for picks in samples), Cost())
    return total.times(1 / len(samples))


@dataclass(frozen=True)
class _Counter:
    """The walk: `colour` is the mode whose weights are colours, if any; `tinted` says that core numbers are instead. A
    `single` cell has no walk, and each row of `colour` counts in its channel. `registered` levels read the subsets of
    a row once.
    """

    model: Model
    colour: int | None
    tinted: bool
    single: bool
    contracted: tuple[int, ...]
    registered: tuple[int, ...]

    def node(self, depth: int, s: int, rows: Sequence[NDArray[np.int64]]) -> Cost:
        """Cost of node s of a level and of all below it, for rows by their places in its lists."""
        level = self.model.stages[depth]
        order = len(rows)
        own = Cost(nodes=1, words=2 + order if self.single else 3 + 5 * order)
        if not level.shape[s].any():
            return own
        subsets = [_subsets(level, s, n, rows[n]) for n in range(order)] if level.has_cells[s] else []
        distinct = [np.unique(subset).tolist() for subset in subsets]
        once = sum(subset.size for subset in subsets)
        searched = 0 if self.single else once
        if not self.single and depth not in self.registered:
            searched = _searches(subsets, [len(each) for each in distinct])
        own += Cost(words=searched)
        for cell in product(*distinct) if subsets else ():
            own += self._cell(level, s, [subset == c for subset, c in zip(subsets, cell, strict=True)])
        child = level.child
        if child is None or child[s] == child[s + 1]:
            return own
        groups = [_groups(level, s, n, rows[n]) for n in range(order)]
        clusters = level.shape[s, 0].tolist()
        for chosen in product(*groups):
            number = 0
            for (part, _), c in zip(chosen, clusters, strict=True):
                number = number * c + part
            own += Cost(words=2 * sum(len(each) for each, c in zip(rows, clusters, strict=True) if c > 1))
            own += self.node(depth + 1, int(child[s]) + number, [places for _, places in chosen])
        return own

    def _cell(self, level: PackedLevel, s: int, members: Sequence[NDArray[np.bool_]]) -> Cost:
        """Cost of a cell; members [rows, K] of each mode tell which rows' subsets are the cell's."""
        ranks = level.shape[s, 2].tolist()
        undecomposed = np.flatnonzero(level.undecomposed[s]).tolist()
        kept = [n for n in range(len(members)) if n not in self.contracted]
        nest = sorted(kept, key=lambda n: n != self.colour)
        counts = [len(members[n]) if n in undecomposed else ranks[n] for n in nest]
        contraction = sum((3 if self.tinted or n == self.colour else 1) * prod(counts[: k + 1])
                          for k, n in enumerate(nest))
        basis = [(int(members[n].sum()) * ranks[n], 3 if n == self.colour and not self.single else 1)
                 for n in nest if n not in undecomposed]
        read = prod(counts) * (6 if self.tinted else 2 if self.contracted else 1)  # contracted cores are float32
        return Cost(
            cells=1,
            multiply_adds=contraction + sum(count * lane for count, lane in basis),
            coefficients=read + sum(count for count, _ in basis),
            words=3,
        )


def _searches(subsets: Sequence[NDArray[np.int64]], distinct: Sequence[int]) -> int:
    """Words read to go from cluster to cluster: the subsets of a mode's rows, whenever it moves on or restarts."""
    moves = [prod(distinct[:n]) * (distinct[n] + 1) for n in range(len(distinct))]
    return sum(move * subset.size for move, subset in zip(moves, subsets, strict=True))


def _subsets(level: PackedLevel, s: int, n: int, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cluster subsets [rows, K] of rows in a node; one subset 0 in an undecomposed mode."""
    cluster, offset, mixture = level.cluster[n], level.cluster_offset[n], int(level.shape[s, 1, n])
    if not mixture:
        return np.zeros((len(rows), 1), np.int64)
    return cluster[int(offset[s]) : int(offset[s + 1])].reshape(-1, mixture)[rows].astype(np.int64)


def _groups(level: PackedLevel, s: int, n: int, rows: NDArray[np.int64]) -> list[tuple[int, NDArray[np.int64]]]:
    """The parts that rows of a node go to, with the rows' places there."""
    part, local = level.part[n], level.local[n]
    assert part is not None and local is not None, "stages with children say where rows go"  # noqa: PT018
    if level.shape[s, 0, n] == 1:
        return [(0, rows)]
    at = int(level.row_offset[n][s]) + rows
    parts, places = part[at].astype(np.int64), local[at].astype(np.int64)
    return [(int(p), places[parts == p]) for p in np.unique(parts)]
