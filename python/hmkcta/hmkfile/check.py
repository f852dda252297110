"""Structural checks of the arrays of all levels: every index and offset before anything uses it.

A shader that follows a bad index reads some other number and shows a wrong picture without a word, so nothing is
left to the decoders. All checks are array operations: a file may have a million nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import mode_sizes
from ..packed import F16, U16, U32, LevelBounds, Metadata, PackedLevel
from .check_tree import check_parts
from .reasons import fault
from .tables import Geometry, Ints, check_end, first, offset_steps, read_geometry

_MAX_F32 = float(np.finfo(np.float32).max)
_F16_INFINITY = 0x7C00
_CHUNK = 1 << 20  # numbers looked at in one go, so that a check needs little memory beside the file


def check_levels(metadata: Metadata, levels: Sequence[PackedLevel]) -> None:
    """Check the arrays of all levels, whose names, types and table shapes `check_schema` has let through."""
    geometries = [read_geometry(packed, level, metadata.undecomposed) for level, packed in enumerate(levels, 1)]
    _check_root(geometries[0], mode_sizes(metadata.axes, metadata.organisation))
    for geometry, bounds in zip(geometries, metadata.levels, strict=True):
        _check_bounds(geometry, bounds)
        _check_node_sizes(geometry)
        _check_clusters(geometry)
    for above, below in pairwise(geometries):
        check_parts(above, below)
    _check_range(geometries)


def check_coords(arrays: dict[str, NDArray[Any]]) -> None:
    """Coordinates must be finite."""
    for name, array in arrays.items():
        _check_finite(array, name)


def _check_root(root: Geometry, sizes: Sequence[int]) -> None:
    """Level 1 has one node, which owns all rows."""
    if root.packed.nodes != 1:
        raise fault("array-shape", root.name("shape"), list(root.packed.shape.shape), "one node at level 1")
    for n, size in enumerate(sizes):
        if root.rows[0, n] != size:
            raise fault("row-count", root.name(f"row_offset/{n}"), f"{root.rows[0, n]} rows", f"{size}, the mode size")


def _check_bounds(geometry: Geometry, bounds: LevelBounds) -> None:
    """The metadata's C, K and R are the largest of the level: shaders and limits rely on them."""
    tables = (("C", geometry.clusters, bounds.clusters), ("K", geometry.mixture, bounds.mixture),
              ("R", geometry.ranks, bounds.ranks))
    for key, table, bound in tables:
        largest = table.max(axis=0, initial=0).tolist()
        if largest != list(bound):
            raise fault("level-bounds", f"hmkcta.levels[{geometry.level - 1}].{key}", list(bound), largest)


def _check_node_sizes(geometry: Geometry) -> None:
    """Ragged arrays: each node owns as many numbers as its C, K, R and row counts need."""
    packed, cells, rank = geometry.packed, geometry.cells, geometry.ranks.prod(1, np.float64)
    _check_ragged(geometry, "cell_offset", packed.cell_offset, packed.core_scale, cells)
    _check_ragged(geometry, "core_offset", packed.core_offset, packed.core, cells * rank)
    for n in geometry.decomposed:
        others = np.delete(geometry.clusters, n, axis=1).prod(1, np.float64)
        entries = (geometry.rows[:, n] * geometry.mixture[:, n]).astype(np.float64)
        _check_ragged(geometry, f"cluster_offset/{n}", packed.cluster_offset[n], packed.cluster[n], entries)
        _check_ragged(geometry, f"basis_offset/{n}", packed.basis_offset[n], packed.basis[n],
                      entries * others * geometry.ranks[:, n])


def _check_ragged(geometry: Geometry, name: str, offsets: U32 | None, array: NDArray[Any] | None,
                  needed: NDArray[np.float64]) -> None:
    assert offsets is not None  # `check_schema` requires both of a decomposed mode
    assert array is not None
    steps = offset_steps(offsets, geometry.name(name))
    if (bad := first(steps != needed)) is not None:
        raise fault("offset-size", geometry.name(name), f"{steps[bad]} numbers of node {bad[0]}", f"{needed[bad]:.0f}")
    check_end(offsets, array, geometry.name(name))


def _check_clusters(geometry: Geometry) -> None:
    """Every row's cluster subsets exist in its node, are distinct and ascend."""
    for n in geometry.decomposed:
        cluster = geometry.packed.cluster[n]
        assert cluster is not None  # `check_schema` requires it of a decomposed mode
        rows, mixture = geometry.rows[:, n], geometry.mixture[:, n]
        name = geometry.name(f"cluster/{n}")
        allowed = np.repeat(geometry.clusters[:, n], rows * mixture)
        if (bad := first(cluster >= allowed)) is not None:
            raise fault("cluster-range", name, f"{cluster[bad]} at {bad[0]}", f"less than {allowed[bad]}")
        bad = first(~_starts(rows, mixture)[1:] & (cluster[1:] <= cluster[:-1]))
        if bad is not None:
            raise fault("cluster-order", name, f"{cluster[bad[0] + 1]} after {cluster[bad[0]]} at {bad[0]}",
                        "distinct subsets, ascending within a row")


def _starts(rows: Ints, mixture: Ints) -> NDArray[np.bool_]:
    """Which entries of a cluster array are the first of their row."""
    filled = mixture > 0  # no array backs the rows of other nodes: there can be billions of them
    width = np.repeat(mixture[filled], rows[filled])
    starts = np.zeros(int(width.sum()), np.bool_)
    starts[np.cumsum(width) - width] = True
    return starts


def _check_range(geometries: Sequence[Geometry]) -> None:
    """All stored numbers are finite, and no sum or product that a float32 decoder forms of them overflows.

    The bound is the sum over the levels of the largest scale times the largest core number times, for every
    decomposed mode, K R times the largest basis number, with no factor below 1.
    """
    reach = 0.0
    for geometry in geometries:
        packed = geometry.packed
        scale = _check_finite(packed.core_scale, geometry.name("core_scale"))
        level = max(1.0, scale * _magnitude(packed.core, geometry.name("core")))
        for n in geometry.decomposed:
            terms = int(geometry.mixture[:, n].max(initial=0) * geometry.ranks[:, n].max(initial=0))
            basis = packed.basis[n]
            assert basis is not None  # `check_schema` requires it of a decomposed mode
            level *= max(1.0, terms * _magnitude(basis, geometry.name(f"basis/{n}")))
        reach += level
        if reach > _MAX_F32:
            raise fault("value-range", geometry.name("core_scale"), f"values up to {reach:.3g}",
                        f"values up to {_MAX_F32:.3g}")


def _check_finite(array: NDArray[Any], name: str) -> float:
    """The largest magnitude of float32 or float64 numbers, all of which must be finite."""
    if (bad := first(~np.isfinite(array))) is not None:
        raise fault("not-finite", name, f"{array[bad]} at {', '.join(map(str, bad))}", "finite numbers")
    return float(np.abs(array).max(initial=0))


def _magnitude(array: F16, name: str) -> float:
    """The largest magnitude of float16 numbers, all of which must be finite.

    Without their sign bit, float16 numbers ascend as the integers with the same bits do.
    """
    bits: U16 = array.view(np.uint16)
    largest = 0
    for begin in range(0, bits.size, _CHUNK):
        chunk = bits[begin:begin + _CHUNK] & np.uint16(0x7FFF)
        largest = max(largest, int(chunk.max()))
        if largest >= _F16_INFINITY:
            at = begin + int(np.argmax(chunk >= _F16_INFINITY))
            raise fault("not-finite", name, f"{array[at]} at {at}", "finite numbers")
    return float(np.array(largest, np.uint16).view(np.float16))
