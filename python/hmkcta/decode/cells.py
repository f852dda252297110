"""The dense block of one clustered node: cluster by cluster over the rows that are members of it.

A basis row depends on the clusters of all modes, so the sum over clusters c = (c_1..c_N) cannot be taken mode by mode.
It is nested instead: fix c_1 and multiply its member rows into the cores of all (c_2..c_N), fix c_2, and so on; the
last mode's clusters are summed in one matrix product, with zeros for the rows that are not members.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from math import prod
from typing import Any

import numpy as np

from ..packed import PackedLevel
from ..support.grouping import rows_of_parts
from .scattered import Index, Real, count

Rows = dict[int, tuple[Index, Index]]
Member = tuple[Index, Index]

#: Elements a step of the nested loop should add, to outweigh its cost in Python.
STEP = 1 << 14
LARGEST_TILE = 1 << 24
#: Up to so many numbers C_n R_n of the last mode, multiplying with zeros is cheaper than adding row by row.
DENSE = 96


def tiles(lengths: Sequence[int], limit: int) -> Iterator[tuple[slice, ...]]:
    """Cut an outer product into tiles of about `limit` elements, the longest modes first.

    >>> list(tiles((4, 2), 4))
    [(slice(0, 2, None), slice(0, 2, None)), (slice(2, 4, None), slice(0, 2, None))]
    """
    sizes = [max(1, length) for length in lengths]
    while prod(sizes) > limit and max(sizes) > 1:
        longest = sizes.index(max(sizes))
        sizes[longest] = -(-sizes[longest] // 2)
    cuts = [[slice(i, min(i + size, length)) for i in range(0, length, size)]
            for length, size in zip(lengths, sizes, strict=True)]
    yield from product(*cuts)


def add_clustered_node(
    level: PackedLevel, s: int, requested: Rows, block: Real, tile_size: int
) -> None:
    """Add node `s` to the block.

    Args:
        level: the level.
        s: the node.
        requested: of each mode, row positions in the node and their places in the block.
        block: what to add to, [m_1, .., m_N].
        tile_size: elements to work on at a time, at the least.
    """
    clusters, mixture = level.shape[s, 0].tolist(), level.shape[s, 1].tolist()
    rows = {n: requested[n] for n in sorted(requested) if mixture[n]}
    fixed = [n for n in sorted(requested) if not mixture[n]]
    modes = [*fixed, *rows]  # undecomposed modes first: they only ever lengthen the product
    lengths = [len(requested[n][0]) for n in modes]
    sparsity = prod(clusters[n] / mixture[n] for n in list(rows)[:-1])
    view = block.transpose(modes)
    for tile in tiles(lengths, int(max(tile_size, min(STEP * sparsity, LARGEST_TILE)))):
        spans = dict(zip(modes, tile, strict=True))
        part = {n: rows[n][0][spans[n]] for n in rows}
        node = _load(level, s, part, {n: requested[n][0][spans[n]] for n in fixed}, block.dtype)
        places = [requested[n][1][spans[n]] for n in modes]
        add_outer(view, places, node.values().reshape([len(place) for place in places]))


def add_outer(block: Real, places: Sequence[Index], values: Real) -> None:
    """Add `values` to the block at the outer product of `places`; runs of neighbours are added as slices."""
    if all((np.diff(place) == 1).all() for place in places):
        block[tuple(slice(int(place[0]), int(place[-1]) + 1) for place in places)] += values
    else:
        block[np.ix_(*places)] += values


def _load(level: PackedLevel, s: int, rows: dict[int, Index], fixed: dict[int, Index], dtype: np.dtype[Any]) -> _Node:
    """Fetch what the rows of node `s` need: clusters without a member among them are left out."""
    clusters, mixture, ranks = level.shape[s].astype(np.intp).tolist()
    order = level.order
    used: dict[int, Index] = {}
    ids: list[Index] = []
    for n, pos in rows.items():
        table, offset = level.cluster[n], level.cluster_offset[n]
        subsets = table[offset[s] : offset[s + 1]].reshape(-1, mixture[n])[pos].astype(np.intp)  # [m, K_n]
        used[n], inverse = np.unique(subsets, return_inverse=True)
        ids.append(inverse.reshape(subsets.shape))
    picked = [used[n] if n in used else np.zeros(1, np.intp) for n in range(order)]
    cells = level.core_scale[level.cell_offset[s] : level.cell_offset[s + 1]].reshape(clusters)[np.ix_(*picked)]
    core = level.core[level.core_offset[s] : level.core_offset[s + 1]].reshape(*clusters, *ranks)
    wanted = [fixed[n] if n in fixed else count(ranks[n]) for n in range(order)]
    core = core[np.ix_(*picked, *wanted)].astype(dtype)
    core *= cells.reshape(*cells.shape, *[1] * order)
    axes = [*fixed, *rows, *(order + n for n in rows), *(order + n for n in fixed)]
    kept = [len(used[n]) for n in rows]
    shape = [*kept, *(ranks[n] for n in rows), prod(map(len, fixed.values()))]
    bases = [_load_bases(level, s, n, pos, picked, dtype) for n, pos in rows.items()]
    return _Node(kept, [ranks[n] for n in rows], core.transpose(axes).reshape(shape), ids, bases)


def _load_bases(
    level: PackedLevel, s: int, n: int, pos: Index, picked: list[Index], dtype: np.dtype[Any]
) -> Real:
    """Basis rows of mode n for the picked clusters of the other modes, [m, K_n, C_1..C_n-1, C_n+1..C_N, R_n]."""
    clusters, mixture, ranks = level.shape[s].astype(np.intp).tolist()
    basis, offset = level.basis[n], level.basis_offset[n]
    others = [c for m, c in enumerate(clusters) if m != n]
    table = basis[offset[s] : offset[s + 1]].reshape(-1, mixture[n], *others, ranks[n])
    wanted = [picked[m] for m in range(level.order) if m != n]
    rows = table[np.ix_(pos, count(mixture[n]), *wanted)].astype(dtype)
    before = prod(len(picked[m]) for m in range(n))
    return rows.reshape(len(pos), mixture[n], before, -1, ranks[n])


@dataclass(frozen=True, eq=False)
class _Node:
    """A node over D decomposed modes, restricted to the requested rows and to the clusters these belong to."""

    clusters: list[int]  # C_n, D of them
    ranks: list[int]  # R_n
    core: Real  # [C_1, .., C_D, R_1, .., R_D, elements of the undecomposed modes]
    ids: list[Index]  # D x [m_n, K_n]: cluster subsets of each row
    bases: list[Real]  # D x [m_n, K_n, PC before n, PC after n, R_n]

    @cached_property
    def members(self) -> list[list[Member]]:
        """D x C_n: rows that belong to each cluster, and at which place of their subset it stands."""
        found = [rows_of_parts(ids.reshape(-1), count) for ids, count in zip(self.ids, self.clusters, strict=True)]
        return [[np.divmod(at, ids.shape[1]) for at in of_mode] for of_mode, ids in zip(found, self.ids, strict=True)]

    def values(self) -> Real:
        """The node's block, [elements of the undecomposed modes * m_1 * .. * m_(D-1), m_D]."""
        extra = self.core.shape[-1]
        lengths = [len(ids) for ids in self.ids]
        out = np.zeros((extra * prod(lengths[:-1]), lengths[-1]), self.core.dtype)
        self._expand(0, 0, self.core, count(extra), out)
        return out

    def _expand(self, n: int, fixed: int, core: Real, lines: Index, out: Real) -> None:
        """Multiply the basis matrices of mode n into the cores, for each of its clusters over the member rows.

        Args:
            n: number among the decomposed modes.
            fixed: flat(c_1..c_n-1), the clusters fixed so far.
            core: [C_n, .., C_D, R_n, .., R_D, lines].
            lines: lines of `out` that the rows fixed so far lead to, [lines].
            out: the block.
        """
        if n == len(self.ids) - 1:
            self._finish(fixed, core.reshape(self.clusters[n], self.ranks[n], -1), lines, out)
            return
        after, length = prod(self.clusters[n + 1 :]), len(self.ids[n])
        for c in range(self.clusters[n]):
            members, k = self.members[n][c]
            bases = self.bases[n][members, k, fixed].transpose(1, 0, 2)  # [PC after n, members, R_n]
            product = bases @ core[c].reshape(after, self.ranks[n], -1)  # [PC after n, members, R after n * lines]
            product = product.reshape(after, len(members), prod(self.ranks[n + 1 :]), len(lines))
            expanded = product.transpose(0, 2, 3, 1).reshape(
                *self.clusters[n + 1 :], *self.ranks[n + 1 :], len(lines) * len(members))
            deeper = (lines[:, None] * length + members).reshape(-1)
            self._expand(n + 1, fixed * self.clusters[n] + c, expanded, deeper, out)

    def _finish(self, fixed: int, core: Real, lines: Index, out: Real) -> None:
        """Multiply the last mode's basis matrices into `core` [C_D, R_D, lines], and add the lines to the block."""
        clusters, rank, _ = core.shape
        ids, bases = self.ids[-1], self.bases[-1][:, :, fixed, 0]  # [m, K_D], [m, K_D, R_D]
        if clusters * rank <= DENSE or clusters == ids.shape[1]:
            matrix = np.zeros((clusters, rank, len(ids)), core.dtype)
            matrix[ids, :, np.arange(len(ids))[:, None]] = bases
            out[lines] += core.reshape(clusters * rank, -1).T @ matrix.reshape(clusters * rank, -1)
            return
        for c in range(clusters):
            members, k = self.members[-1][c]
            out[lines[:, None], members] += core[c].T @ bases[members, k].T
