"""Which cells may be fitted at once, and where their rows lie: tables for kernels that work on many cells together.

Cells that share an element must come one after another, so that each sees what the ones before it left
(`reference.fit_cells`). All else may go together. So every cell waits for the cells before it that it shares elements
with, and for no others: where K = 1 in every mode none waits, where K > 1 in one of two modes those of the other go
together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cells import Cells

Index = NDArray[np.integer[Any]]

#: Padding may take as many elements as the cells themselves.
MOST_PADDED = 2.0
#: Numbers below this fit into int32, which takes half the memory.
NARROW = 1 << 31


@dataclass(frozen=True)
class Batch:
    """Cells with their rows, all padded to the longest: B cells of m_1 x .. x m_N elements.

    Attributes:
        numbers: flat(c) `[B]`; of a batch of projections `[B, L]`, cells that differ in modes taken whole only.
        shape: m_n of every mode.
        rows: for each mode `[B, m_n]`, the row times the mode's stride in the tensor; sums with padding are `end` or
            more.
        places: for each mode where the basis rows lie among the `I_n K_n PC_-n` of the mode, `[B, m_n]` or
            `[B, L, m_n]`; padding: behind the last. None for an undecomposed mode, and for one taken whole.
        end: the elements of the tensor.
        padded: whether there is padding.
        whole: it is one cell that owns all elements.
    """

    numbers: Index
    shape: tuple[int, ...]
    rows: list[Index]
    places: list[Index | None]
    end: int
    padded: bool
    whole: bool


def sweep_batches(cells: Cells, budget: int) -> list[Batch]:
    """All cells that own elements, in batches of up to `budget` elements whose cells share none.

    Two cells that share elements are in different batches, the one with the smaller number first.
    """
    tables = Tables(cells)
    owners = tables.owners()
    ranks = _waits(cells, owners)
    batches: list[Batch] = []
    for rank in range(1, int(ranks.max(initial=0)) + 1):
        together = np.argwhere(ranks == rank)
        batches += [tables.batch(part) for part in _parts(tables.extents(together), together, budget)]
    return batches


def projection_batches(cells: Cells, whole: Sequence[int], budget: int) -> list[Batch]:
    """Cells that own elements if some modes are taken whole; those that differ in these modes only go together."""
    tables = Tables(cells, whole)
    owners = tables.owners()
    for n in whole:
        owners = np.take(owners, [0], axis=n)
    together = np.argwhere(owners)
    return [tables.batch(part) for part in _parts(tables.extents(together), together, budget)]


class Tables:
    """For each mode and cluster subset its rows, padded to the longest; of the modes `whole` every row.

    Args:
        cells: the node's.
        whole: None for a sweep.
    """

    def __init__(self, cells: Cells, whole: Sequence[int] | None = None) -> None:
        self.cells, self.whole = cells, whole
        self.end = prod(cells.sizes)
        # Sums with padding, and places behind the last, are larger than what they point to.
        largest = max((cells.order + 1) * self.end, 2 * max(basis.size for basis in cells.bases))
        self.dtype = np.int32 if largest < NARROW else np.int64
        self.counts: list[Index] = []
        self.rows: list[Index] = []
        self.places: list[Index] = []
        for n, members in enumerate(cells.members):
            stride, others = prod(cells.sizes[n + 1 :]), cells.spec.cells // cells.spec.clusters[n]
            subsets = range(cells.spec.clusters[n])
            found = [np.nonzero(members == k) for k in subsets]
            if n in (whole or ()):
                found = [(np.arange(cells.sizes[n]), np.zeros(cells.sizes[n], np.intp))] * len(subsets)
            self.counts.append(np.array([len(rows) for rows, _ in found]))
            self.rows.append(_padded([rows * stride for rows, _ in found], self.end, self.dtype))
            places = [(rows * members.shape[1] + slots) * others for rows, slots in found]
            self.places.append(_padded(places, members.size * others, self.dtype))

    def owners(self) -> NDArray[np.bool_]:
        """Which cells own elements: `[C_1, .., C_N]`."""
        owning = np.ones((), np.bool_)
        for counts in self.counts:
            owning = np.logical_and.outer(owning, counts > 0)
        return owning

    def extents(self, chosen: Index) -> Index:
        """Rows of every mode of the cells `[B, N]`."""
        return np.stack([counts[chosen[:, n]] for n, counts in enumerate(self.counts)], axis=1)

    def batch(self, chosen: Index) -> Batch:
        """The batch of the cells `[B, N]`."""
        cells, extents = self.cells, self.extents(chosen)
        shape = tuple(int(longest) for longest in extents.max(axis=0))
        rows = [np.ascontiguousarray(own[chosen[:, n], : shape[n]]) for n, own in enumerate(self.rows)]
        numbers, along = np.asarray(np.ravel_multi_index(tuple(chosen.T), cells.spec.clusters)), chosen
        if self.whole is not None:
            clusters = [cells.spec.clusters[n] for n in self.whole]
            bundle = np.indices(clusters).reshape(len(clusters), prod(clusters))
            along = np.repeat(chosen[:, None], bundle.shape[1], axis=1)
            along[:, :, self.whole] = bundle.T
            numbers = np.asarray(np.ravel_multi_index(tuple(np.moveaxis(along, -1, 0)), cells.spec.clusters))
        places = [
            None if skip or n in (self.whole or ()) else self._places(n, chosen, along, shape[n])
            for n, skip in enumerate(cells.undecomposed)
        ]
        padded = bool((extents != extents[0]).any())
        return Batch(numbers, shape, rows, places, self.end, padded, len(chosen) == 1 and shape == cells.sizes)

    def _places(self, n: int, chosen: Index, along: Index, longest: int) -> Index:
        """Basis rows are stored by row, slot, flat(c_-n), the last of which `along` (`[.., N]`) says."""
        own = self.places[n][chosen[:, n], :longest]
        modes = [m for m in range(self.cells.order) if m != n]
        clusters = tuple(self.cells.spec.clusters[m] for m in modes)
        other = np.zeros(along.shape[:-1], self.dtype)
        if modes:
            other += np.ravel_multi_index(tuple(along[..., m] for m in modes), clusters)
        own = own.reshape(len(own), *[1] * (other.ndim - 1), longest)
        behind = self.cells.members[n].size * (self.cells.spec.cells // self.cells.spec.clusters[n])
        return np.minimum(own + other[..., None], behind).astype(self.dtype)


def _padded(lists: Sequence[Index], filling: int, dtype: type[np.integer[Any]]) -> Index:
    """Lists of numbers as one table, `[lists, longest]`."""
    table = np.full((len(lists), max(map(len, lists), default=0)), filling, dtype)
    for row, numbers in zip(table, lists, strict=True):
        row[: len(numbers)] = numbers
    return table


def _waits(cells: Cells, owners: NDArray[np.bool_]) -> Index:
    """When each cell's turn comes, `[C_1, .., C_N]`, from 1: after those before it that it shares elements with.

    0 for cells without elements.
    """
    if all(members.shape[1] == 1 for members in cells.members):
        return owners.astype(np.intp)
    turns = np.zeros(cells.spec.clusters, np.intp)
    sharing: list[list[Index] | None] = []
    for members, count in zip(cells.members, cells.spec.clusters, strict=True):
        meets, used = _meeting(members, count), np.unique(members)
        # Where all subsets meet only the last turn counts, whichever subset it was of.
        sharing.append(None if meets[np.ix_(used, used)].all() else [np.flatnonzero(row) for row in meets])
    latest = np.zeros([1 if met is None else len(met) for met in sharing], np.intp)
    owning: list[list[int]] = np.argwhere(owners).tolist()
    for c in owning:
        own = tuple(0 if met is None else k for met, k in zip(sharing, c, strict=True))
        before = (np.zeros(1, np.intp) if met is None else met[k] for met, k in zip(sharing, c, strict=True))
        turns[tuple(c)] = latest[own] = 1 + latest[np.ix_(*before)].max()
    return turns


def _meeting(members: NDArray[np.uint16], count: int) -> NDArray[np.bool_]:
    """Whether two subsets of a mode have rows in common: `[C_n, C_n]`."""
    meets = np.zeros((count, count), np.bool_)
    for slot in range(members.shape[1]):
        for other in range(members.shape[1]):
            meets[members[:, slot], members[:, other]] = True
    return meets


def _parts(extents: Index, chosen: Index, budget: int) -> Iterator[Index]:
    """Cut cells into batches within the budget, of cells that are about as large; never less than one cell."""
    order = np.argsort(-extents.prod(axis=1, dtype=np.int64), kind="stable")
    first = 0
    while first < len(order):
        last, longest, owned = first, np.zeros(extents.shape[1], np.int64), 0
        while last < len(order):
            longer = np.maximum(longest, extents[order[last]])
            more = owned + int(extents[order[last]].prod(dtype=np.int64))
            padded = (last + 1 - first) * int(longer.prod())
            if last > first and (padded > budget or padded > MOST_PADDED * more):
                break
            last, longest, owned = last + 1, longer, more
        yield chosen[order[first:last]]
        first = last
