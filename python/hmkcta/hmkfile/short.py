"""Short tables (`docs/format.md`, section 3): from version 1.2 on, what follows from other arrays is left out.

The writer leaves it out by the same rules by which the reader makes it again, so that decoders know one layout.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..bitstream import U8, from_unary
from ..packed import U16, U32, PackedLevel
from ..parameters import from_whole, most_of_core, of_basis_numbers, of_core_numbers
from ..rice import decoded, fault_in
from .check_tree import check_children, check_part_range, slot_of_child, slots_of
from .reasons import fault
from .schema import LEVEL_TYPES, NUMPY_TYPES, prefix
from .tables import Ints, check_entries, check_shapes

Arrays = Mapping[str, NDArray[Any]]
_MAX_U32 = 2**32 - 1


def narrowest(largest: int) -> str:
    """The type of a table whose numbers are at most so large.

    >>> narrowest(255), narrowest(256), narrowest(65536)
    ('U8', 'U16', 'U32')
    """
    return "U8" if largest < 2**8 else "U16" if largest < 2**16 else "U32"


def shortened(packed: PackedLevel) -> Iterator[tuple[str, NDArray[Any]]]:
    """Names (without ``level/<l>/``) and arrays of a sound level's tables, in the order of `PackedLevel.tables`."""
    largest, rows = packed.shape.max(axis=0, initial=0), _rows_of(packed)
    yield "shape", _narrow(packed.shape, int(largest.max(initial=0)))
    if packed.child is not None:
        yield "child", _narrow(packed.child, int(packed.child[-1]))
    yield "core_scale", packed.core_scale
    yield from ((f"rice/{n}", entries) for n, entries in enumerate(packed.rice) if entries is not None)
    for n, cluster in enumerate(packed.cluster):
        if cluster is None:
            continue
        c, k = int(largest[0, n]), int(largest[1, n])
        if c > 1:
            yield f"cluster/{n}", _narrow(cluster, c - 1)
        part, local = packed.part[n], packed.local[n]
        if packed.child is None or part is None or local is None:
            continue
        mode = _Rows(packed.shape[:, :, n].astype(np.int64), rows[:, n], np.diff(packed.child.astype(np.int64)))
        if k != 1 or not np.array_equal(part, mode.parts(cluster)):
            yield f"part/{n}", _narrow(part, max(c, 1) - 1)
        if not np.array_equal(local, mode.places(part)):
            yield f"local/{n}", _narrow(local, int(local.max(initial=0)))


def _rows_of(packed: PackedLevel) -> Ints:
    return np.stack([np.diff(offsets.astype(np.int64)) for offsets in packed.row_offset], axis=1)


def _narrow(array: NDArray[Any], largest: int) -> NDArray[Any]:
    return array.astype(NUMPY_TYPES[narrowest(largest)])


def completed(
    arrays: Arrays, sizes: Sequence[int], levels: int, undecomposed: Sequence[int]
) -> dict[str, NDArray[Any]]:
    """The arrays, which `check_schema` has let through, and all that is left out, in the types of memory.

    `sizes` are those of the modes. Nothing is made that is larger than what the file holds allows.
    """
    whole = {name: _wide(name, array) for name, array in arrays.items()}
    rows: Ints = np.array([sizes], np.int64)
    if len(shape := whole[prefix(1) + "shape"]) != 1:
        raise fault("array-shape", prefix(1) + "shape", list(shape.shape), "one node at level 1")
    for level in range(1, levels + 1):
        below = whole.get(prefix(level + 1) + "shape")
        made = _Level(whole, prefix(level), rows, undecomposed)
        made.complete_ragged()
        rows = rows if below is None else made.complete_tree(len(below))
    for array in whole.values():
        array.setflags(write=False)  # as views of the file are
    return whole


def _wide(name: str, array: NDArray[Any]) -> NDArray[Any]:
    """A level's table in the type that it has in memory; numbers and coordinates as they are."""
    kind = LEVEL_TYPES.get(name.split("/")[2]) if name.startswith("level/") else None
    return array if kind not in ("U16", "U32") else array.astype(NUMPY_TYPES[kind], copy=False)


class _Level:
    """A level whose missing arrays are made; `rows` `[S, N]` are those that each node owns."""

    def __init__(self, whole: dict[str, NDArray[Any]], name: str, rows: Ints, undecomposed: Sequence[int]) -> None:
        self.whole, self.name, self.rows = whole, name, rows
        self.shape: Ints = whole[name + "shape"].astype(np.int64)
        check_shapes(self.shape, rows, undecomposed, name + "shape")
        self.clusters, self.mixture, self.ranks = self.shape[:, 0], self.shape[:, 1], self.shape[:, 2]
        self.cells = self.clusters.prod(1, np.float64)
        self.decomposed = [n for n in range(rows.shape[1]) if n not in undecomposed]

    def complete_ragged(self) -> None:
        """Offsets, by what the shapes of nodes need, clusters where each mode has one, numbers of a packed level."""
        numbers = {"core": self.cells * self.ranks.prod(1, np.float64)}
        for n in self.decomposed:
            others = np.delete(self.clusters, n, axis=1).prod(1, np.float64)
            of_clusters = self.rows[:, n] * self.mixture[:, n] * self.ranks[:, n]
            numbers[f"basis/{n}"] = of_clusters.astype(np.float64) * others
        if any(f"{self.name}rice/{n}" in self.whole for n in self.decomposed):
            self._unpack(numbers)
        self._own("core_offset", "core", numbers["core"])
        self._own("cell_offset", "core_scale", self.cells)
        for n in self.decomposed:
            entries = (self.rows[:, n] * self.mixture[:, n]).astype(np.float64)
            self._own(f"basis_offset/{n}", f"basis/{n}", numbers[f"basis/{n}"])
            # Bases have as many entries at the least, so that this is bounded by what the file holds.
            if (name := f"{self.name}cluster/{n}") not in self.whole:
                if self.clusters[:, n].max(initial=0) > 1:
                    raise fault("array-missing", name, "no such array", "an array, as nodes have clusters")
                self.whole[name] = np.zeros(int(entries.sum()), np.uint16)
            self._own(f"cluster_offset/{n}", f"cluster/{n}", entries)
        for n in range(self.rows.shape[1]):
            self.whole[f"{self.name}row_offset/{n}"] = self._sums(self.rows[:, n].astype(np.float64), "shape")

    def _unpack(self, numbers: Mapping[str, NDArray[np.float64]]) -> None:
        """The float16 numbers of a packed level, whose nodes have so many of each array."""
        rice = [self.whole.get(f"{self.name}rice/{n}") for n in range(self.rows.shape[1])]
        for n, own in enumerate(rice):
            if own is not None:
                check_entries(f"{self.name}rice/{n}", own, self.ranks[:, n])
        for name, count in numbers.items():
            stream = self.whole[self.name + name]
            if count.sum() > 8 * stream.size:  # no number has less than a bit: nothing larger is made than that allows
                raise fault("array-shape", self.name + name, [stream.size], f"the codes of {count.sum():.0f} numbers")
            of_mode = None if name == "core" else int(name.split("/")[1])
            own = of_core_numbers(rice, self.whole[self.name + "shape"]) if of_mode is None else of_basis_numbers(
                cast("U8", rice[of_mode]), self.ranks[:, of_mode], count.astype(np.int64))
            zeros = from_unary(stream, own.size)
            if (bad := fault_in(stream, own, zeros)) is not None:
                reason, found, allowed = bad
                raise fault(reason, self.name + name, found, allowed)
            steps = own if of_mode is not None else np.repeat(most_of_core(rice, self.ranks), count.astype(np.int64))
            self.whole[self.name + name] = from_whole(decoded(stream, own, zeros), steps)

    def _own(self, offsets: str, array: str, needed: NDArray[np.float64]) -> None:
        found = self.whole[self.name + array]
        if found.size != needed.sum():
            raise fault("array-shape", self.name + array, [found.size], [int(needed.sum())])
        self.whole[self.name + offsets] = self._sums(needed, array)

    def _sums(self, needed: NDArray[np.float64], array: str) -> U32:
        sums = np.concatenate([[0.0], np.cumsum(needed)])
        if sums[-1] > _MAX_U32:
            raise fault("array-shape", self.name + array, f"{sums[-1]:.0f} entries", f"at most {_MAX_U32}")
        return sums.astype(np.uint32)

    def complete_tree(self, nodes_below: int) -> Ints:
        """Parts and positions of rows; how many rows `[S, N]` each of the next level's nodes owns."""
        counts = check_children(self.name + "child", self.whole[self.name + "child"], self.cells, nodes_below)
        below = [np.repeat(self.rows[:, n], counts) for n in range(self.rows.shape[1])]
        for n in self.decomposed:
            mode = _Rows(self.shape[:, :, n], self.rows[:, n], counts)
            part = self._part(n, mode)
            if (name := f"{self.name}local/{n}") not in self.whole:
                self.whole[name] = mode.places(part)
            below[n] = mode.owned(part)[slot_of_child(self.clusters, n, counts)]
        return np.stack(below, axis=1)

    def _part(self, n: int, mode: _Rows) -> U16:
        name = f"{self.name}part/{n}"
        if name not in self.whole:
            if self.mixture[:, n].max(initial=0) != 1:
                raise fault("array-missing", name, "no such array", "an array, as clusters do not tell parts")
            self.whole[name] = mode.parts(self.whole[f"{self.name}cluster/{n}"])
        part, total = self.whole[name], self.rows[:, n].sum()
        if part.size != total:
            raise fault("array-shape", name, [part.size], f"[{total}], the rows of the level")
        check_part_range(name, part, mode.clusters[mode.node], mode.inner)
        return part


class _Rows:
    """The rows of a level in one mode: `shape` `[S, 3]`, how many rows each node owns, and how many children it has."""

    def __init__(self, shape: Ints, rows: Ints, counts: Ints) -> None:
        self.clusters, self.mixture, self.rows, self.counts = shape[:, 0], shape[:, 1], rows, counts

    @property
    def node(self) -> Ints:
        """The node of each row."""
        return np.repeat(np.arange(self.rows.size), self.rows)

    @property
    def inner(self) -> NDArray[np.bool_]:
        """Whether the node of each row has children."""
        return np.repeat(self.counts > 0, self.rows)

    def parts(self, cluster: U16) -> U16:
        """The part of each row where it is its only cluster; 0 in a leaf."""
        part = np.zeros(int(self.rows.sum()), np.uint16)
        part[np.repeat(self.mixture > 0, self.rows)] = cluster
        part[~self.inner] = 0
        return part

    def _slot(self, part: U16) -> Ints:
        inner = self.inner
        return slots_of(self.clusters, self.counts)[self.node[inner]] + part[inner]

    def owned(self, part: U16) -> Ints:
        """How many rows each slot gets: a part of a node with children."""
        return np.bincount(self._slot(part), minlength=int(slots_of(self.clusters, self.counts)[-1]))

    def places(self, part: U16) -> U32:
        """The position of each row among those of its part, in their order; 0 in a leaf."""
        slot, local = self._slot(part), np.zeros(part.size, np.uint32)
        order = np.argsort(slot, kind="stable")
        owned = np.bincount(slot)
        place = np.empty(slot.size, np.int64)
        place[order] = np.arange(slot.size) - np.repeat(np.cumsum(owned) - owned, owned)
        local[self.inner] = place
        return local
