"""Random valid packed models, made without any fitting: what tests of the file and of the decoders work on."""

from __future__ import annotations

from collections.abc import Callable, Sequence, Set
from dataclasses import dataclass, replace
from math import prod
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hmkcta.axes import Axis, Organisation, name_axes, separate
from hmkcta.packed import F16, U16, U32, LevelQuality, Metadata, PackedLevel, bounds_of

Sizes = tuple[int, ...]
Ints = NDArray[np.int64]
Scalar = TypeVar("Scalar", bound=np.generic)


@dataclass(frozen=True)
class Shapes:
    """How large the nodes of a random model get, and how often a node is of a certain kind."""

    max_clusters: int = 3
    max_mixture: int = 2
    max_rank: int = 3
    max_cells: int = 12  # PC of a node, which bounds the number of its children
    zero: float = 0.15  # chance that a node below level 1 has shape zero
    leaf: float = 0.15  # chance that a node above the last stage has no children
    cut: float = 0.0  # chance that a node between the root and the last stage is a cut
    own: float = 0.0  # chance that a mode is undecomposed in a node, whatever it is in others
    tidy: bool = False  # rows go where their first cluster is


@dataclass(frozen=True, eq=False)
class Node:
    """One node before packing: rows, C, K and R a mode, and the arrays of its rows; no entries where undecomposed."""

    rows: Sizes
    clusters: Sizes
    mixture: Sizes
    ranks: Sizes
    core: F16  # [PC, R_1, .., R_N]
    scale: NDArray[np.float32]  # [PC]
    cluster: tuple[U16, ...]  # [m, K_n]
    basis: tuple[F16, ...]  # [m, K_n, PC_-n, R_n]
    part: tuple[U16, ...]  # [m]
    local: tuple[U32, ...]  # [m]
    children: tuple[Sizes, ...]  # rows of each child


def random_model(
    rng: np.random.Generator,
    sizes: Sequence[int],
    levels: int = 2,
    undecomposed: Sequence[int] = (),
    *,
    shapes: Shapes = Shapes(),
    axes: tuple[Axis, ...] | None = None,
    organisation: Organisation | None = None,
    coded: float = 0.0,
    cuts: Sequence[int] = (),
) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """A random model of a tensor with these mode sizes; every choice that is open is drawn from `rng`.

    The quality in the metadata is made up. With `axes` and `organisation` modes can be merged axes, of these sizes.
    Of `levels` stages, those numbered in `cuts` (from 1) have no numbers, but cut their nodes; `undecomposed` modes are
    so in all nodes.
    `coded`: which share of the stages with numbers has whole ones of a step, the others float16.
    """
    axes = axes if axes is not None else name_axes(sizes)
    packed: list[PackedLevel] = []
    rows = [tuple(sizes)]
    for level in range(1, levels + 1):
        own = replace(shapes, cut=1.0) if level in cuts else shapes
        nodes = [_random_node(rng, owned, undecomposed, own, root=level == 1, last=level == levels) for owned in rows]
        packed.append(_pack(nodes, len(sizes), last=level == levels))
        rows = [child for node in nodes for child in node.children]
    packed = [_in_steps(rng, level) if not level.is_cut and rng.random() < coded else level for level in packed]
    figures = 10.0 + 8.0 * np.arange(sum(not level.is_cut for level in packed))
    quality = tuple(LevelQuality(float(snr), float(1 / snr), float(2 / snr)) for snr in figures)
    metadata = Metadata(
        "float32",
        axes,
        organisation or separate(axes),
        tuple(map(bounds_of, packed)),
        quality=quality,
        source={"sha256": "0" * 64},
        writer="random_models",
    )
    return metadata, tuple(packed)


def _in_steps(rng: np.random.Generator, level: PackedLevel) -> PackedLevel:
    """The level with whole numbers of a step: core numbers up to 2^24, columns of any k."""
    step = float(np.float32(rng.uniform(0.01, 1.0)))
    core, scale = level.core.copy(), level.core_scale.copy()
    column, basis = [list[NDArray[Any]]() for _ in level.basis], [array.copy() for array in level.basis]
    rows = [np.diff(offset.astype(np.int64)) for offset in level.row_offset]
    for s in range(level.nodes):
        clusters, mixture, ranks = level.shape[s].astype(int).tolist()
        part = slice(*level.core_offset[s : s + 2])
        whole = _whole(rng, core[part].size)
        e = next(e for e in range(15) if np.abs(whole).max(initial=0) <= 2047 * 2**e)
        filled = np.ones(clusters, bool)
        for n in range(level.order):
            if mixture[n]:
                members: NDArray[np.uint16] = level.cluster[n][slice(*level.cluster_offset[n][s : s + 2])]
                there: NDArray[np.bool_] = np.isin(np.array(range(clusters[n])), members)
                filled &= there.reshape([-1 if m == n else 1 for m in range(level.order)])
        cells = filled.reshape(-1)
        whole = (whole.reshape(max(1, cells.size), -1) * cells[:, None]).reshape(-1) if whole.size else whole
        e = next(e for e in range(15) if np.abs(whole).max(initial=0) <= 2047 * 2**e)
        core[part] = (whole / 2.0**e).astype(np.float32)
        scale[slice(*level.cell_offset[s : s + 2])] = np.float32(np.float32(step) * np.float32(2**e))
        for n in range(level.order):
            if not mixture[n] or not ranks[n]:
                continue
            k = rng.integers(0, 40, (cells.size, ranks[n])) * cells[:, None]
            column[n].append(k.reshape(-1))
            members = level.cluster[n][slice(*level.cluster_offset[n][s : s + 2])].reshape(rows[n][s], mixture[n])
            own = np.moveaxis(k.reshape(*clusters, ranks[n]), n, 0).reshape(clusters[n], -1, ranks[n])[members]
            alive = np.moveaxis(filled, n, 0).reshape(clusters[n], -1)[members]
            q = np.rint(rng.normal(size=own.shape) * 2.0 ** (own / 2 - 1)) * alive[..., None]
            unit = np.where(own % 2, np.float32(0.70710678118654752), np.float32(1)) * np.float32(2.0) ** -(own // 2)
            basis[n][slice(*level.basis_offset[n][s : s + 2])] = (
                q.astype(np.float32) * unit.astype(np.float32)
            ).reshape(-1)
    columns = tuple(np.concatenate([np.zeros(0), *own]).astype(np.uint8) for own in column)
    return replace(level, core=core, core_scale=scale, basis=tuple(basis), step=step, column=columns)


def _whole(rng: np.random.Generator, count: int) -> Ints:
    """Whole numbers, some of them as large as can be."""
    small = np.rint(rng.laplace(0, 3, count)).astype(np.int64)
    large = rng.integers(-(2**24) + 1, 2**24, count) >> rng.integers(0, 20, count)
    return np.where(rng.random(count) < 0.05, large, small)


def _random_node(
    rng: np.random.Generator, rows: Sizes, undecomposed: Sequence[int], shapes: Shapes, *, root: bool, last: bool
) -> Node:
    order = len(rows)
    zero = 0 in rows or (not root and rng.random() < shapes.zero)
    if not zero and not last and rng.random() < shapes.cut * (shapes.cut == 1 or not root):
        return _random_cut(rng, rows, shapes)
    own = {n for n in range(order) if n in undecomposed or (shapes.own and rng.random() < shapes.own)}
    clusters, mixture, ranks = _random_shape(rng, rows, own, shapes) if not zero else ((0,) * order,) * 3
    inner = not zero and not last and rng.random() >= shapes.leaf

    def subsets(n: int) -> U16:
        chosen = [np.sort(rng.permutation(clusters[n])[: mixture[n]]) for _ in range(rows[n])]
        return np.array(chosen, np.uint16).reshape(rows[n], mixture[n])

    def basis(n: int) -> F16:
        others = prod(clusters[:n] + clusters[n + 1 :])
        return rng.uniform(-1, 1, (rows[n], mixture[n], others, ranks[n])).astype(np.float16)

    def parts(n: int) -> U16:
        drawn = inner and n not in own
        return (rng.integers(clusters[n], size=rows[n]) if drawn else np.zeros(rows[n])).astype(np.uint16)

    part = tuple(map(parts, range(order)))
    cluster = tuple(map(subsets, range(order)))
    if shapes.tidy and inner:
        part = tuple(p if n in own else c[:, 0] for n, (p, c) in enumerate(zip(part, cluster, strict=True)))
    core = rng.normal(size=(prod(clusters), *ranks)).astype(np.float16)
    scale = rng.uniform(0.25, 2.0, prod(clusters)).astype(np.float32)
    children = _child_rows(clusters, part) if inner else ()
    return Node(
        rows,
        clusters,
        mixture,
        ranks,
        core,
        scale,
        cluster,
        tuple(map(basis, range(order))),
        part,
        tuple(_places(p) if inner else np.zeros(p.size, np.uint32) for p in part),
        children,
    )


def _random_cut(rng: np.random.Generator, rows: Sizes, shapes: Shapes) -> Node:
    """A node without numbers: its rows go to parts along a grid, one of two axes, say, or to any."""
    order = len(rows)
    clusters = [min(rows[n], int(rng.integers(1, shapes.max_clusters + 2))) for n in range(order)]
    while prod(clusters) > max(2, shapes.max_cells):
        clusters[int(np.argmax(clusters))] = 1
    if prod(clusters) < 2:
        clusters[int(rng.integers(order))] = 2

    def parts(n: int) -> U16:
        i, c = np.arange(rows[n]), clusters[n]
        if rng.random() < 1 / 3:
            return rng.integers(c, size=rows[n]).astype(np.uint16)
        inside = next(size for size in (3, 2, 1) if rows[n] % size == 0)  # of a merged axis that is not cut
        return (i // inside * c * inside // rows[n]).astype(np.uint16)

    part = tuple(map(parts, range(order)))
    zeros = (0,) * order
    none = tuple(np.zeros(0, np.uint16) for _ in rows)
    return Node(
        rows,
        tuple(clusters),
        zeros,
        zeros,
        np.zeros(0, np.float16),
        np.zeros(0, np.float32),
        none,
        tuple(np.zeros(0, np.float16) for _ in rows),
        part,
        tuple(map(_places, part)),
        _child_rows(tuple(clusters), part),
    )


def _random_shape(rng: np.random.Generator, rows: Sizes, own: Set[int], shapes: Shapes) -> tuple[Sizes, Sizes, Sizes]:
    """C, K and R of a node; where there would be too many cells, the most clustered modes lose their clusters."""
    clusters = [1 if n in own else int(rng.integers(1, shapes.max_clusters + 1)) for n in range(len(rows))]
    while prod(clusters) > shapes.max_cells:
        clusters[int(np.argmax(clusters))] = 1
    mixture = tuple(
        0 if n in own else int(rng.integers(1, min(c, shapes.max_mixture) + 1)) for n, c in enumerate(clusters)
    )
    ranks = tuple(m if n in own else int(rng.integers(1, shapes.max_rank + 1)) for n, m in enumerate(rows))
    return tuple(clusters), mixture, ranks


def _places(part: U16) -> U32:
    """Positions in the children: rows of one part keep their order."""
    local = np.zeros(part.size, np.uint32)
    for p in np.unique(part):
        local[part == p] = np.arange(int((part == p).sum()))
    return local


def _child_rows(clusters: Sizes, part: tuple[U16, ...]) -> tuple[Sizes, ...]:
    """Rows of the PC children, in the order of their flattened part numbers."""
    counts = [np.bincount(p, minlength=c) for c, p in zip(clusters, part, strict=True)]
    return tuple(
        tuple(int(count[i]) for count, i in zip(counts, index, strict=True)) for index in np.ndindex(*clusters)
    )


def _pack(nodes: Sequence[Node], order: int, *, last: bool) -> PackedLevel:
    def ragged(get: Callable[[Node], NDArray[Any]], dtype: type[Scalar]) -> tuple[NDArray[Scalar], U32]:
        parts = [get(node).reshape(-1) for node in nodes]
        joined = np.concatenate([np.empty(0, dtype), *parts]).astype(dtype)
        return joined, offsets([part.size for part in parts])

    def modes(
        get: Callable[[Node], Sequence[NDArray[Any]]], dtype: type[Scalar]
    ) -> tuple[tuple[NDArray[Scalar], ...], tuple[U32, ...]]:
        packed = [ragged(lambda node, n=n: get(node)[n], dtype) for n in range(order)]
        return tuple(p[0] for p in packed), tuple(p[1] for p in packed)

    core, core_offset = ragged(lambda node: node.core, np.float16)
    scale, cell_offset = ragged(lambda node: node.scale, np.float32)
    cluster, cluster_offset = modes(lambda node: node.cluster, np.uint16)
    basis, basis_offset = modes(lambda node: node.basis, np.float16)
    absent = (None,) * order
    shape = np.array([(node.clusters, node.mixture, node.ranks) for node in nodes], np.uint32)
    return PackedLevel(
        shape=shape.reshape(len(nodes), 3, order),
        child=None if last else offsets([len(node.children) for node in nodes]),
        row_offset=tuple(offsets([node.rows[n] for node in nodes]) for n in range(order)),
        core=core,
        core_offset=core_offset,
        core_scale=scale,
        cell_offset=cell_offset,
        cluster=cluster,
        cluster_offset=cluster_offset,
        basis=basis,
        basis_offset=basis_offset,
        part=absent if last else modes(lambda node: node.part, np.uint16)[0],
        local=absent if last else modes(lambda node: node.local, np.uint32)[0],
    )


def offsets(counts: Sequence[int]) -> U32:
    """0 and the running sums of the counts."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.uint32)
