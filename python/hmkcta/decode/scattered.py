"""Scattered elements: `docs/format.md`, section 7, for many elements at once; the twin of the WGSL decoder.

A shader runs one invocation an element; here a NumPy vector holds one number an element, and each function below
has a WGSL function of the same name: `cluster_ids`, `flatten_clusters`, `basis_row`, `core_value`, `descend`.
Elements are sorted by node before each level (neighbours then share cores and bases in the cache) and grouped by
mixture K and reduced ranks R, so that Python loops only over distinct (K, R), over the mixture choices and over
the numbers of a core. Arithmetic and accumulation are in the type of the result (float32, as in the shader).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..packed import PackedLevel
from ..support.grouping import rows_of_parts

Index = NDArray[np.intp]
Real = NDArray[np.floating[Any]]

NO_TABLE = "all stages but the last say where rows go (the reader checked it)"

#: Elements walked together: bounds memory (about 100 bytes each), and still gives a node many neighbours.
BATCH = 1 << 18
#: Numbers of one chunk's working set, about what half a megabyte of second-level cache holds as float32.
CHUNK_NUMBERS = 1 << 18
#: One matrix product costs about as much, beside loading the core, as this many numbers gathered element by element.
PRODUCT_COST = 1 << 14
#: Cores of at least so many numbers are worth sorting the elements by core, to share each in one matrix product.
SORT_WORTH = 128
#: Up to so many elements, Python's cost a call outweighs that of fetching a core by one large index.
FEW = 256


def count(length: int) -> Index:
    """0, 1, .., length - 1."""
    return np.arange(length, dtype=np.intp)


def decode_batches(levels: Sequence[PackedLevel], coords: Index, out: Real) -> None:
    """Add the values of the elements at `coords` [B, N] to `out` [B], in batches of bounded memory."""
    for start in range(0, len(coords), BATCH):
        batch = slice(start, start + BATCH)
        _decode_batch(levels, np.ascontiguousarray(coords[batch].T), out[batch])


def _decode_batch(levels: Sequence[PackedLevel], pos: Index, out: Real) -> None:
    """Walk all elements `pos` [N, B] down the tree together, level by level; one leaves where its branch ends."""
    where = count(pos.shape[1])  # which element of `out` it is
    node = np.zeros(pos.shape[1], np.intp)
    for depth, level in enumerate(levels, start=1):
        by_node = np.argsort(node, kind="stable")
        where, node, pos = where[by_node], node[by_node], pos[:, by_node]
        out[where] += level_values(level, node, pos, out.dtype)
        if depth < len(levels):
            alive, node, pos = descend(level, node, pos)
            where = where[alive]


def level_values(level: PackedLevel, node: Index, pos: Index, dtype: np.dtype[Any]) -> Real:
    """What the level adds to each element, [B]; elements are sorted by `node` [B], at rows `pos` [N, B] of it."""
    floats = _level_as_floats(level, len(node), dtype)
    values = np.zeros(len(node), dtype)
    for (mixture, ranks), members in _same_contraction(level, node):
        for chunk in _chunks(members, mixture, ranks):
            values[chunk] = node_values(floats, mixture, ranks, node[chunk], pos[:, chunk])
    return values


@dataclass(frozen=True, eq=False)
class _Floats:
    """A level with its cores and bases as floats where that is cheaper than converting what is gathered."""

    level: PackedLevel
    core: NDArray[Any]
    basis: tuple[NDArray[Any], ...]
    dtype: np.dtype[Any]


def _level_as_floats(level: PackedLevel, elements: int, dtype: np.dtype[Any]) -> _Floats:
    """Convert each float16 array of at most as many numbers as the elements gather from it at the least."""
    def convert(array: NDArray[np.float16]) -> NDArray[Any]:
        return array if array.size > 4 * elements else array.astype(dtype)

    return _Floats(level, convert(level.core), tuple(map(convert, level.basis)), dtype)


Contraction = tuple[tuple[int, ...], tuple[int, ...]]


def _same_contraction(level: PackedLevel, node: Index) -> Iterator[tuple[Contraction, Index]]:
    """Group the elements by the (K, R) of their `node` [B] (sorted); empty and cut nodes add nothing, and get none."""
    if not len(node):
        return
    order = level.order
    first = np.flatnonzero(np.diff(node, prepend=-1))
    shapes = level.shape[node[first], 1:].reshape(len(first), 2 * order)
    if (shapes == shapes[:1]).all():
        kinds, kind = shapes[:1], np.zeros(len(node), np.intp)
    else:
        kinds, inverse = np.unique(shapes, axis=0, return_inverse=True)
        kind = np.repeat(inverse.reshape(-1), np.diff(first, append=len(node)))
    for row, group in zip(kinds.tolist(), rows_of_parts(kind, len(kinds)), strict=True):
        if any(row) and len(group):
            yield (tuple(row[:order]), tuple(row[order:])), group


def _chunks(members: Index, mixture: tuple[int, ...], ranks: tuple[int, ...]) -> Iterator[Index]:
    """Parts of `members` whose working set fits the cache."""
    decomposed = [r for k, r in zip(mixture, ranks, strict=True) if k]
    at = _split(decomposed)
    numbers = prod(decomposed[:at]) + prod(decomposed[at:]) + sum(decomposed) + 16
    size = max(16, min(1 << 13, CHUNK_NUMBERS // numbers))
    for start in range(0, len(members), size):
        yield members[start : start + size]


def node_values(
    floats: _Floats, mixture: tuple[int, ...], ranks: tuple[int, ...], node: Index, pos: Index
) -> Real:
    """What the nodes add to their elements: the sum over all mixture choices, [b].

    Args:
        floats: the level.
        mixture: K_n of all nodes at hand; 0 where the mode is undecomposed in them.
        ranks: R_n of all nodes at hand.
        node: the node of each element, [b].
        pos: its row position in each mode, [N, b].
    """
    level = floats.level
    clusters = level.shape[node, 0].T.astype(np.intp)  # [N, b]: C_n of each element's node
    others = clusters.prod(axis=0) // clusters  # [N, b]: PC_-n
    decomposed = [n for n, k in enumerate(mixture) if k]
    ids = {n: cluster_ids(level, n, mixture[n], node, pos[n]) for n in decomposed}
    rows = {n: level.basis_offset[n][node].astype(np.intp) + pos[n] * mixture[n] * others[n] * ranks[n]
            for n in decomposed}
    cores, cells = level.core_offset[node].astype(np.intp), level.cell_offset[node].astype(np.intp)
    address = _core_addresses(ranks, decomposed)
    for n, k in enumerate(mixture):
        if not k:  # undecomposed: the row position indexes the core directly
            cores += pos[n] * prod(ranks[n + 1 :])
    value = np.zeros(len(node), floats.dtype)
    for choice in product(*(range(mixture[n]) for n in decomposed)):
        picked = dict(zip(decomposed, choice, strict=True))
        cell, cell_others = flatten_clusters({n: ids[n][k] for n, k in picked.items()}, clusters)
        bases = [basis_row(floats, n, rows[n] + (k * others[n] + cell_others[n]) * ranks[n], ranks[n])
                 for n, k in picked.items()]
        scale = level.core_scale.take(cells + cell)
        value += scale * core_value(floats, cores + cell * prod(ranks), address, bases)
    return value


def cluster_ids(level: PackedLevel, n: int, mixture: int, node: Index, pos: Index) -> list[Index]:
    """Cluster c_n of each element for k = 0..K_n-1: the row's distinct cluster subsets; K_n x [b]."""
    table = level.cluster[n]
    first = level.cluster_offset[n][node].astype(np.intp) + pos * mixture
    return [table.take(first + k).astype(np.intp) for k in range(mixture)]


def flatten_clusters(ids: dict[int, Index], clusters: Index) -> tuple[Index, dict[int, Index]]:
    """flat(c) [b], the cluster, and flat(c_-n) [b] for each mode, which of the mode's basis matrices it takes."""
    before: dict[int, Index] = {}
    flat = np.zeros(clusters.shape[1], np.intp)
    for n, c in ids.items():
        before[n] = flat
        flat = flat * clusters[n] + c
    others: dict[int, Index] = {}
    after, stride = np.zeros_like(flat), np.ones_like(flat)
    for n, c in reversed(ids.items()):
        others[n] = before[n] * stride + after
        after = after + c * stride
        stride = stride * clusters[n]
    return flat, others


def basis_row(floats: _Floats, n: int, address: Index, rank: int) -> Real:
    """The row u_n of the chosen cluster's basis matrix, [R_n, b]; `address` [b] is its first number's."""
    basis = floats.basis[n]
    row = np.empty((rank, len(address)), floats.dtype)
    for r in range(rank):
        row[r] = basis[r:].take(address)
    return row


def _split(ranks: Sequence[int]) -> int:
    """How many leading modes form the lines of the matrix as which a core is contracted; the others form its columns.

    >>> _split([4, 4, 6, 6]), _split([2, 2, 90])
    (2, 2)
    """
    return min(range(len(ranks) + 1), key=lambda at: prod(ranks[:at]) + prod(ranks[at:]))


def _core_addresses(ranks: tuple[int, ...], decomposed: Sequence[int]) -> Index:
    """Where the core number (r_1..r_N) lies behind the cluster's first, as a matrix [leading, trailing modes]."""
    def addresses(modes: Sequence[int]) -> Index:
        flat = np.zeros(1, np.intp)
        for n in modes:
            flat = np.add.outer(flat, count(ranks[n]) * prod(ranks[n + 1 :])).reshape(-1)
        return flat

    at = _split([ranks[n] for n in decomposed])
    return np.add.outer(addresses(decomposed[:at]), addresses(decomposed[at:]))


def core_value(floats: _Floats, base: Index, address: Index, bases: list[Real]) -> Real:
    """Sum over r of core[r_1..r_N] * prod u_n[r_n], [b]: core tensor times the basis rows.

    Args:
        floats: the level.
        base: where each element's core begins, [b].
        address: the core's numbers behind that, [left, right].
        bases: u_n of each decomposed mode, each [R_n, b].
    """
    at = _split([len(basis) for basis in bases])
    left, right = (_khatri_rao(half, len(base), floats.dtype) for half in (bases[:at], bases[at:]))
    by_core = np.argsort(base, kind="stable") if address.size >= SORT_WORTH else slice(None)
    changes = int(np.count_nonzero(np.diff(base[by_core])))
    if (changes + 1) * (PRODUCT_COST + 4 * address.size) < len(base) * address.size:
        shared = np.empty(len(base), floats.dtype)
        shared[by_core] = _shared_core_value(floats, base[by_core], address, left[:, by_core], right[:, by_core])
        return shared
    if len(base) <= FEW:
        return _few_core_values(floats, base, address, left, right)
    value = np.zeros(len(base), floats.dtype)
    for i, row in enumerate(address.tolist()):
        inner = floats.core[row[0]:].take(base) * right[0]
        for j in range(1, len(row)):
            inner += floats.core[row[j]:].take(base) * right[j]
        inner *= left[i]
        value += inner
    return value


def _shared_core_value(floats: _Floats, base: Index, address: Index, left: Real, right: Real) -> Real:
    """`core_value` by one matrix product for each run of elements with the same core."""
    value = np.empty(len(base), floats.dtype)
    starts = np.flatnonzero(np.diff(base, prepend=-1))
    for start, stop in zip(starts.tolist(), [*starts[1:].tolist(), len(base)], strict=True):
        run = slice(start, stop)
        core = floats.core[base[start] + address].astype(floats.dtype, copy=False)
        value[run] = np.einsum("ib,ib->b", left[:, run], core @ right[:, run])
    return value


def _few_core_values(floats: _Floats, base: Index, address: Index, left: Real, right: Real) -> Real:
    """`core_value` with few steps in Python: whole rows of the core as a matrix at once, within the working set."""
    value = np.zeros(len(base), floats.dtype)
    step = max(1, CHUNK_NUMBERS // right.size)
    for i in range(0, len(address), step):
        core = floats.core[base + address[i : i + step, :, None]].astype(floats.dtype, copy=False)  # [step, right, b]
        value += np.einsum("ib,ib->b", left[i : i + step], np.einsum("ijb,jb->ib", core, right))
    return value


def _khatri_rao(bases: Sequence[Real], elements: int, dtype: np.dtype[Any]) -> Real:
    """Products u_1[r_1] * u_2[r_2] * .. for all (r_1, r_2, ..), [prod R_n, b]; ones for no mode."""
    rows = np.ones((1, elements), dtype)
    for basis in bases:
        rows = (rows[:, None] * basis).reshape(-1, elements)
    return rows


def descend(level: PackedLevel, node: Index, pos: Index) -> tuple[Index, Index, Index]:
    """Child node and position in it of each element; elements of leaves stop.

    Args:
        level: a stage that is not the last.
        node: the node of each element, [b].
        pos: its row position in each mode, [N, b].

    Returns:
        Which elements go on, [a]; their node, [a]; their position, [N, a].
    """
    assert level.child is not None, NO_TABLE
    child = level.child[node].astype(np.intp)
    alive = np.flatnonzero(level.child[node + 1] > child)
    node, pos, child = node[alive], pos[:, alive], child[alive]
    clusters = level.shape[node, 0].T.astype(np.intp)  # [N, a]
    flat = np.zeros(len(node), np.intp)
    for n in range(level.order):
        part, local = level.part[n], level.local[n]
        assert part is not None and local is not None, NO_TABLE  # noqa: PT018
        row: Index = level.row_offset[n][node] + pos[n]
        flat = flat * clusters[n] + part.take(row).astype(np.intp)
        pos[n] = local.take(row)
    return alive, child + flat, pos
