"""Checks of the tree: children numbered in order, and every row of a node in one place of one child list."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..packed import U16, U32
from .reasons import fault
from .tables import Geometry, Ints, first, offset_steps


def check_parts(above: Geometry, below: Geometry) -> None:
    """Check `child`, `part` and `local` of a level against the nodes of the next one."""
    child, part, local = above.packed.child, above.packed.part, above.packed.local
    assert child is not None  # `check_schema` requires it of every level but the last
    counts = check_children(above.name("child"), child, above.cells, below.packed.nodes)
    for n in range(above.packed.order):
        parts, locals_ = part[n], local[n]
        if parts is None or locals_ is None:
            _check_child_rows(below, n, np.repeat(above.rows[:, n], counts))
            continue
        owned = _check_mode(above, n, counts, parts, locals_)
        _check_child_rows(below, n, owned[slot_of_child(above.clusters, n, counts)])


def check_children(name: str, child: U32, cells: NDArray[np.float64], nodes: int) -> Ints:
    """The number of children of each node: none or PC, which together are the `nodes` of the next level."""
    counts = offset_steps(child, name)
    if (bad := first((counts != 0) & (counts != cells))) is not None:
        raise fault("child-order", name, f"{counts[bad]} children of node {bad[0]}",
                    f"0 or {cells[bad]:.0f}, one for each combination of parts")
    if int(child[-1]) != nodes:
        raise fault("child-order", name, f"{child[-1]} children", f"{nodes}, the nodes of the next level")
    return counts


def slots_of(clusters: Ints, counts: Ints) -> Ints:
    """First slot of each node in a table with a slot for each part of a mode of each node that has children.

    A node has at least as many children as parts, so the table is no longer than the next level. `clusters`: C_n `[S]`.
    """
    return np.concatenate([[0], np.cumsum(np.where(counts > 0, clusters, 0))])


def slot_of_child(clusters: Ints, n: int, counts: Ints) -> Ints:
    """The slot of mode n that gives each node of the next level its rows; `clusters`: `[S, N]`."""
    parents = np.repeat(np.arange(counts.size), counts)
    number = np.arange(parents.size) - np.repeat(np.cumsum(counts) - counts, counts)
    stride = clusters[parents, n + 1:].prod(1)  # parts are flattened in C order, the last mode fastest
    return slots_of(clusters[:, n], counts)[parents] + number // stride % clusters[parents, n]


def check_part_range(name: str, part: U16, allowed: Ints, inner: NDArray[np.bool_]) -> None:
    """Rows of nodes with children go to parts that these have."""
    if (bad := first(inner & (part >= allowed))) is not None:
        raise fault("part-range", name, f"{part[bad]} in row {bad[0]}", f"less than {allowed[bad]}")


def _check_mode(above: Geometry, n: int, counts: Ints, part: U16, local: U32) -> Ints:
    """Check the rows of one mode; return how many rows each slot gets."""
    rows = above.rows[:, n]
    for name, array in (("part", part), ("local", local)):
        if array.size != rows.sum():
            raise fault("array-shape", above.name(f"{name}/{n}"), [array.size], [int(rows.sum())])
    node = np.repeat(np.arange(rows.size), rows)
    inner = counts[node] > 0
    for name, array in (("part", part), ("local", local)):
        if (bad := first(~inner & (array != 0))) is not None:
            raise fault("leaf-rows", above.name(f"{name}/{n}"), f"{array[bad]} in row {bad[0]}", "0 in a leaf's rows")
    check_part_range(above.name(f"part/{n}"), part, above.clusters[node, n], inner)
    slots = slots_of(above.clusters[:, n], counts)
    slot = (slots[node] + part)[inner]
    owned = np.bincount(slot, minlength=int(slots[-1]))
    _check_places(above.name(f"local/{n}"), slot, owned, local[inner], np.flatnonzero(inner))
    position = np.arange(node.size) - np.repeat(np.cumsum(rows) - rows, rows)
    if (bad := first(inner & (above.cells[node] == 1) & (local != position))) is not None:
        raise fault("self-child", above.name(f"local/{n}"), f"{local[bad]} in row {bad[0]}",
                    f"{position[bad]}, as an only child keeps all rows in order")
    return owned


def _check_places(name: str, slot: Ints, owned: Ints, local: U32, row: Ints) -> None:
    """The local positions of the rows of each slot must be 0, 1, .. up to their number, each once."""
    if (bad := first(local >= owned[slot])) is not None:
        raise fault("local-range", name, f"{local[bad]} in row {row[bad]}", f"less than {owned[slot][bad]}")
    place = (np.cumsum(owned) - owned)[slot] + local
    taken = np.bincount(place, minlength=place.size)
    if (bad := first(taken[place] > 1)) is not None:
        raise fault("local-twice", name, f"{local[bad]} in row {row[bad]} and in another row of its part",
                    "each position once")


def _check_child_rows(below: Geometry, n: int, expected: Ints) -> None:
    if (bad := first(below.rows[:, n] != expected)) is not None:
        raise fault("row-count", below.name(f"row_offset/{n}"), f"{below.rows[bad[0], n]} rows of node {bad[0]}",
                    f"{expected[bad]}, those that its parent's parts give it")
