"""Dense blocks: the elements of an outer product of index lists, far cheaper each than scattered ones.

The walk goes down the tree level by level with a *front*: the nodes that own requested elements, and for each of them
its requested rows in every mode. A level adds its nodes to the block in whichever way costs least:

1. plain nodes (all C_n = 1): core tensor times basis matrices, mode by mode, batched over nodes of equal shape;
2. clustered nodes: `cells`, cluster by cluster over its member rows;
3. nodes too small for either: element by element, all together, `scattered`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np

from ..packed import PackedLevel
from ..support.grouping import rows_of_parts, sorted_by
from .cells import add_clustered_node, add_outer, tiles
from .scattered import BATCH, NO_TABLE, Index, Real, count, level_values

#: Elements of the block worked on at a time: the working set stays near the cache, whatever the block's size.
TILE = 1 << 19
# What the three ways cost, in nanoseconds, measured on one core of a 2023 server with random models: to gather a number
# of a core, the address arithmetic of one mixture choice, a Python step of a plain and of a clustered node.
_GATHER_NS, _CHOICE_NS, _PLAIN_NS, _CELL_NS = 1.2, 120.0, 60_000.0, 50_000.0


@dataclass(frozen=True, eq=False)
class _Front:
    """T nodes of a stage and the rows requested of each.

    Node number t's rows of mode n are ``pos[n][start[n][t] : start[n][t + 1]]``, to go to `out` in the block.
    """

    node: Index  # [T]
    start: list[Index]  # [T + 1]
    pos: list[Index]
    out: list[Index]

    def lengths(self) -> Index:
        """Requested rows of each node, [T, N]."""
        return np.stack([np.diff(start) for start in self.start], axis=1)

    def only(self, kept: Index) -> _Front:
        """The front of some of its nodes."""
        start: list[Index] = []
        chosen: list[Index] = []
        for edges in self.start:
            counts = np.diff(edges)[kept]
            start.append(np.concatenate([[0], np.cumsum(counts)]))
            chosen.append(np.repeat(edges[kept], counts) + _ranges(counts))
        return _Front(self.node[kept], start, [pos[rows] for pos, rows in zip(self.pos, chosen, strict=True)],
                      [out[rows] for out, rows in zip(self.out, chosen, strict=True)])

    def rows(self, t: int) -> dict[int, tuple[Index, Index]]:
        """Positions and places in the block of node number t, a mode."""
        spans = {n: slice(start[t], start[t + 1]) for n, start in enumerate(self.start)}
        return {n: (self.pos[n][span], self.out[n][span]) for n, span in spans.items()}


def add_block(levels: Sequence[PackedLevel], rows: Sequence[Index], block: Real, first: int = 0) -> None:
    """Add the elements of the outer product of `rows` (N index lists) to the C-contiguous `block`.

    The stages before number `first`, from 0, only lead the way.
    """
    front = _Front(np.zeros(1, np.intp), [np.array([0, len(index)]) for index in rows], list(rows),
                   [count(len(index)) for index in rows])
    for depth, level in enumerate(levels, start=1):
        alive = np.flatnonzero(level.has_cells[front.node])
        if depth > first and len(alive):
            _add_level(level, front, alive, block)
        if depth < len(levels):
            front = _descend(level, front)
        if not len(front.node):
            break


def _add_level(level: PackedLevel, front: _Front, alive: Index, block: Real) -> None:
    """Add the nodes `alive` of the front, each in the way that costs least."""
    plain, clustered, small = _by_cost(level, front, alive)
    for batch in plain:
        _add_plain_nodes(level, front, batch, block)
    for t in clustered:
        add_clustered_node(level, int(front.node[t]), front.rows(t), block, TILE)
    for batch in _batches(small, front.lengths().prod(axis=1)):
        _add_small_nodes(level, front, batch, block)


def _by_cost(level: PackedLevel, front: _Front, alive: Index) -> tuple[list[Index], list[int], Index]:
    """Batches of plain nodes of equal shape and rows; clustered nodes; nodes to decode element by element."""
    shape = level.shape[front.node[alive]].astype(np.int64)  # [T, 3, N]
    lengths = front.lengths()[alive]
    elements = lengths.prod(axis=1)
    decomposed = shape[:, 1] > 0
    choices, numbers = (np.where(decomposed, shape[:, i], 1) for i in (1, 2))
    scattered = elements * choices.prod(axis=1) * (numbers.prod(axis=1) * _GATHER_NS + _CHOICE_NS)
    reached = np.minimum(shape[:, 0], choices * lengths)  # clusters the rows can belong to
    last = decomposed.shape[1] - 1 - np.argmax(decomposed[:, ::-1], axis=1)  # whose clusters are summed at once
    steps = reached.prod(axis=1) / reached[count(len(alive)), last]
    is_plain = shape[:, 0].prod(axis=1) == 1
    large = ~is_plain & (scattered > steps * _CELL_NS)
    plain: list[Index] = []
    small = [np.flatnonzero(~is_plain & ~large)]
    candidates = np.flatnonzero(is_plain)
    if len(candidates):
        kinds = np.concatenate([shape[candidates, 1], shape[candidates, 2], lengths[candidates]], axis=1)
        _, inverse = np.unique(kinds, axis=0, return_inverse=True)
        for group in (candidates[at] for at in rows_of_parts(inverse.reshape(-1))):
            (plain if scattered[group].sum() > _PLAIN_NS else small).append(group)
    batches = [alive[part] for group in plain for part in _batches(group, elements)]
    return batches, alive[np.flatnonzero(large)].tolist(), alive[np.sort(np.concatenate(small))]


def _batches(group: Index, elements: Index) -> Iterator[Index]:
    """Parts of a group of nodes with at most `BATCH` elements together (or one node); `elements` is of all nodes."""
    bounds = np.cumsum(elements[group]) // BATCH
    yield from (part for part in np.split(group, np.flatnonzero(np.diff(bounds)) + 1) if len(part))


def _add_plain_nodes(level: PackedLevel, front: _Front, batch: Index, block: Real) -> None:
    """Add T nodes of equal ranks and row counts with one cluster each: core tensor times basis matrices."""
    node, order = front.node[batch], level.order
    _, mixture, ranks = level.shape[node[0]].astype(np.intp).tolist()
    lengths = [int(start[batch[0] + 1] - start[batch[0]]) for start in front.start]
    entries = [front.start[n][batch][:, None] + count(lengths[n]) for n in range(order)]  # [T, m_n]
    scale = level.core_scale[level.cell_offset[node]]
    for tile in tiles(lengths, max(1, TILE // len(batch))):
        entry = [entries[n][:, tile[n]] for n in range(order)]
        kept = {n: front.pos[n][entry[n]] for n in range(order) if not mixture[n]}
        values = scale.reshape(-1, *[1] * order) * _cores(level, node, ranks, kept, block.dtype)
        for n in reversed(range(order)):  # the last mode first: one large matrix product at the end
            if mixture[n]:
                bases = _bases(level, n, node, front.pos[n][entry[n]], ranks[n], block.dtype)  # [T, m_n, R_n]
                values = _mode_product(values, bases, n)
        _add_at(block, [front.out[n][entry[n]] for n in range(order)], values)


def _cores(level: PackedLevel, node: Index, ranks: list[int], kept: dict[int, Index], dtype: np.dtype[Any]) -> Real:
    """Core tensors of T plain nodes at the positions `kept` [T, m_n] of undecomposed modes, [T, R_1, .., R_N]."""
    address = level.core_offset[node].astype(np.intp)
    for n, rank in enumerate(ranks):
        steps = kept.get(n, count(rank)[None]) * prod(ranks[n + 1 :])
        address = address[..., None] + steps.reshape(len(steps), *[1] * n, -1)
    return level.core.take(address).astype(dtype)


def _bases(
    level: PackedLevel, n: int, node: Index, pos: Index, rank: int, dtype: np.dtype[Any]
) -> Real:
    """Rows `pos` [T, m_n] of the basis matrices of T plain nodes, [T, m_n, R_n]."""
    first = level.basis_offset[n][node].astype(np.intp)[:, None] + pos * rank
    return level.basis[n].take(first[..., None] + count(rank)).astype(dtype)


def _mode_product(values: Real, bases: Real, n: int) -> Real:
    """Batched product along mode n: values [T, .., R_n, ..] and bases [T, m_n, R_n] to [T, .., m_n, ..]."""
    count, rows, rank = bases.shape
    lead, trail = values.shape[1 : n + 1], values.shape[n + 2 :]
    if prod(trail) == 1:  # one matrix product instead of many matrix-vector products
        product = values.reshape(count, -1, rank) @ bases.transpose(0, 2, 1)
    else:
        product = bases[:, None] @ values.reshape(count, -1, rank, prod(trail))
    return product.reshape(count, *lead, rows, *trail)


def _add_at(block: Real, places: list[Index], values: Real) -> None:
    """Add values [T, m_1, .., m_N] to the block; `places` are [T or 1, m_n], no two elements in one place."""
    if len(values) == 1:
        add_outer(block, [place[0] for place in places], values[0])
        return
    address: Index = np.zeros(len(values), np.intp)
    for n, place in enumerate(places):
        stride = prod(block.shape[n + 1 :])
        address = address[..., None] + (place * stride).reshape(len(place), *[1] * n, -1)
    flat = block.reshape(-1)
    flat[address] += values


def _add_small_nodes(level: PackedLevel, front: _Front, batch: Index, block: Real) -> None:
    """Add nodes element by element: list the elements of all their blocks, then decode them as scattered ones."""
    lengths = front.lengths()[batch]
    counts = lengths.prod(axis=1)
    owner = np.repeat(count(len(batch)), counts)
    rest = _ranges(counts)  # C-order number of each element within its node's block
    pos, address = np.empty((level.order, len(owner)), np.intp), np.zeros(len(owner), np.intp)
    for n in reversed(range(level.order)):
        rest, i = np.divmod(rest, lengths[owner, n])
        entry = front.start[n][batch][owner] + i
        pos[n] = front.pos[n][entry]
        address += front.out[n][entry] * prod(block.shape[n + 1 :])
    flat = block.reshape(-1)
    flat[address] += level_values(level, front.node[batch][owner], pos, block.dtype)


def _ranges(counts: Index) -> Index:
    """0..counts[0]-1, 0..counts[1]-1, ..

    >>> _ranges(np.array([2, 0, 3])).tolist()
    [0, 1, 0, 1, 2]
    """
    return count(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)


def _descend(level: PackedLevel, front: _Front) -> _Front:
    """The children that own requested elements: those with requested rows in every mode."""
    assert level.child is not None, NO_TABLE
    front = front.only(np.flatnonzero(level.child[front.node + 1] > level.child[front.node]))  # leaves stop
    first = level.child[front.node].astype(np.intp)
    clusters = level.shape[front.node, 0].astype(np.intp)  # [T, N]
    children = clusters.prod(axis=1)
    owner = np.repeat(count(len(first)), children)
    rest, alive = _ranges(children), np.ones(len(owner), np.bool_)
    node = first[owner] + rest
    order = range(level.order)
    sorted_rows, slots, edges = [[np.zeros(0, np.intp) for _ in order] for _ in range(3)]
    for n in reversed(order):
        # Sort the requested rows of the mode by (node, part): a slot for each; a child takes one slot of every mode.
        base, every = np.cumsum(clusters[:, n]) - clusters[:, n], int(clusters[:, n].sum())
        key, sorted_rows[n] = _slots_of_rows(level, front, n, base, every)
        edges[n] = np.concatenate([[0], np.cumsum(np.bincount(key, minlength=every))])
        rest, part = np.divmod(rest, clusters[owner, n])
        slots[n] = base[owner] + part
        alive &= edges[n][slots[n] + 1] > edges[n][slots[n]]
    start: list[Index] = []
    pos: list[Index] = []
    out: list[Index] = []
    for n in order:
        local = level.local[n]
        assert local is not None, NO_TABLE
        slot = slots[n][alive]
        counts = edges[n][slot + 1] - edges[n][slot]
        start.append(np.concatenate([[0], np.cumsum(counts)]))
        chosen = sorted_rows[n][np.repeat(edges[n][slot], counts) + _ranges(counts)]
        out.append(front.out[n][chosen])
        pos.append(local[_rows_of(level, front, n)[chosen]].astype(np.intp))
    return _Front(node[alive], start, pos, out)


def _rows_of(level: PackedLevel, front: _Front, n: int) -> Index:
    """Number in the level's tables of each requested row of mode n."""
    owner = np.repeat(count(len(front.node)), np.diff(front.start[n]))
    return level.row_offset[n][front.node[owner]] + front.pos[n]


def _slots_of_rows(level: PackedLevel, front: _Front, n: int, base: Index, slots: int) -> tuple[Index, Index]:
    """Slot `base[t] + part`, of `slots`, of each requested row of mode n, and the rows sorted by it."""
    parts = level.part[n]
    assert parts is not None, NO_TABLE
    owner = np.repeat(count(len(front.node)), np.diff(front.start[n]))
    key = base[owner] + parts[_rows_of(level, front, n)]
    return key, sorted_by(key, slots)
