"""Random stages with everything that a coded run can hold, as flat arrays for the run coders."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@dataclass
class Ragged:
    """What a stage is made of, node by node."""

    order: int
    shape: list[Array] = field(default_factory=list[Array])
    children: list[int] = field(default_factory=list[int])
    cluster: list[list[Array]] = field(default_factory=list[list[Array]])
    part: list[list[Array]] = field(default_factory=list[list[Array]])
    column: list[list[Array]] = field(default_factory=list[list[Array]])
    core: list[Array] = field(default_factory=list[Array])
    basis: list[list[Array]] = field(default_factory=list[list[Array]])

    def arrays(self, *, last: bool, coded: bool) -> dict[str, Any]:
        """The arrays as the native coder takes them."""

        def joined(pieces: list[Array], dtype: type) -> Array:
            flat: list[Array] = [np.zeros(0), *(np.asarray(piece).reshape(-1) for piece in pieces)]
            return np.asarray(np.concatenate(flat), np.dtype(dtype))

        def of_modes(pieces: list[list[Array]], dtype: type) -> list[Array]:
            return [joined([node[n] for node in pieces], dtype) for n in range(self.order)]

        return {
            "last": last,
            "coded": coded,
            "shape": joined(self.shape, np.uint32),
            "children": np.array(self.children, np.uint32),
            "cluster": of_modes(self.cluster, np.uint16),
            "part": [] if last else of_modes(self.part, np.uint16),
            "column": of_modes(self.column, np.uint8),
            "core": joined(self.core, np.int32),
            "basis": of_modes(self.basis, np.int32),
        }


def root_places(extents: list[list[int]]) -> dict[str, Array]:
    """Where the only node of the first stage lies, whose modes have these extents."""
    flat = [size for own in extents for size in own]
    ends = np.cumsum([0, *map(len, extents)])
    return {
        "rows": np.array([prod(own) for own in extents], np.uint32),
        "extents": np.array(flat, np.uint32),
        "ends": ends.astype(np.uint32),
    }


def random_stage(
    rng: np.random.Generator,
    places: dict[str, Array],
    order: int,
    *,
    last: bool,
    coded: bool = True,
    cells: float = 0.6,
    big: float = 0.05,
) -> dict[str, Any]:
    """A stage of random nodes at these places; `cells`: how many nodes have numbers, `big`: how many numbers are."""
    stage = Ragged(order)
    rows = places["rows"].reshape(-1, order).astype(int)
    for s in range(len(rows)):
        own = [
            places["extents"][slice(*places["ends"][s * order + n : s * order + n + 2])].astype(int).tolist()
            for n in range(order)
        ]
        kind = rng.random()
        if (rows[s] == 0).any():
            _add_empty(stage, rows[s])
        elif kind < cells:
            _add_cells(rng, stage, rows[s], parted=not last and bool(rng.random() < 0.5), big=big)
        elif kind < cells + 0.3 and not last and rows[s].max() > 1:
            _add_cut(rng, stage, rows[s], own)
        else:
            _add_empty(stage, rows[s])
    return stage.arrays(last=last, coded=coded)


def _none(order: int) -> list[Array]:
    return [np.zeros(0, int)] * order


def _add_empty(stage: Ragged, rows: Array) -> None:
    stage.shape.append(np.zeros((3, stage.order), int))
    stage.children.append(0)
    stage.cluster.append(_none(stage.order))
    stage.part.append([np.zeros(m, int) for m in rows])
    stage.column.append(_none(stage.order))
    stage.core.append(np.zeros(0, int))
    stage.basis.append(_none(stage.order))


def _add_cut(rng: np.random.Generator, stage: Ragged, rows: Array, extents: list[list[int]]) -> None:
    while True:
        clusters, part = list[int](), list[Array]()
        for n, m in enumerate(rows):
            grid = [min(int(rng.choice([1, 1, 2, 3])), extent) for extent in extents[n]]
            if rng.random() < 0.3:
                clusters.append(int(rng.integers(1, 4)))
                part.append(_runs(rng, m, clusters[-1]))
            else:
                clusters.append(prod(grid))
                part.append(grid_part(grid, extents[n]))
        if prod(clusters) > 1:
            break
    _add_empty(stage, rows)
    stage.shape[-1] = np.array([clusters, [0] * stage.order, [0] * stage.order])
    stage.children[-1] = prod(clusters)
    stage.part[-1] = part


def grid_part(grid: list[int], extents: list[int]) -> Array:
    """The part of each row by the rule of a grid."""
    along = list[Array]()
    for segments, extent in zip(grid, extents, strict=True):
        own = np.zeros(extent, int)
        for p in range(segments):
            own[extent * p // segments : extent * (p + 1) // segments] = p
        along.append(own)
    return np.array([np.ravel_multi_index(index, grid) for index in product(*(own.tolist() for own in along))], int)


def _runs(rng: np.random.Generator, rows: int, count: int) -> Array:
    """Labels of rows, many of them as the row before."""
    labels = rng.integers(0, count, rows)
    for i in range(1, rows):
        if rng.random() < 0.6:
            labels[i] = labels[i - 1]
    return labels


def _add_cells(rng: np.random.Generator, stage: Ragged, rows: Array, *, parted: bool, big: float) -> None:
    order = stage.order
    free = [bool(rng.random() < 0.75) for _ in range(order)]
    clusters = [int(rng.choice([1, 1, 2, 3])) if own else 1 for own in free]
    mixture = [int(rng.integers(1, c + 1)) if own else 0 for own, c in zip(free, clusters, strict=True)]
    ranks = [int(rng.integers(1, 5)) if own else int(m) for own, m in zip(free, rows, strict=True)]
    cells = prod(clusters)
    cluster = [_subsets(rng, m, k, c) for m, k, c in zip(rows, mixture, clusters, strict=True)]
    filled = np.ones(clusters, bool)
    for n in range(order):
        if free[n]:
            there = np.isin(np.arange(clusters[n]), cluster[n])
            filled &= there.reshape([-1 if m == n else 1 for m in range(order)])
    column, basis = list[Array](), list[Array]()
    for n in range(order):
        others = cells // clusters[n]
        k = np.where(filled.reshape(-1, 1), np.clip(rng.normal(12, 4, (cells, ranks[n])), 0, 63).astype(int), 0)
        numbers = _numbers(rng, (int(rows[n]), mixture[n], others, ranks[n]), big)
        flat = np.moveaxis(filled, n, 0).reshape(clusters[n], others)
        if free[n]:
            numbers *= flat[cluster[n].reshape(int(rows[n]), mixture[n])][..., None]
        column.append(k if free[n] else np.zeros(0, int))
        basis.append(numbers)
    stage.shape.append(np.array([clusters, mixture, ranks]))
    stage.children.append(cells if parted else 0)
    stage.cluster.append(cluster)
    stage.part.append([_part(rng, *own, parted=parted) for own in zip(rows, cluster, mixture, clusters, strict=True)])
    stage.column.append(column)
    stage.core.append(_numbers(rng, (cells, *ranks), big) * filled.reshape(-1, *[1] * order))
    stage.basis.append(basis)


def _part(rng: np.random.Generator, rows: int, cluster: Array, mixture: int, clusters: int, *, parted: bool) -> Array:
    if not parted or clusters == 1:
        return np.zeros(rows, int)
    if rng.random() < 0.5:
        return _runs(rng, rows, clusters)
    return cluster.reshape(rows, mixture)[np.arange(rows), rng.integers(0, mixture, rows)]


def _subsets(rng: np.random.Generator, rows: int, mixture: int, clusters: int) -> Array:
    if mixture == 0:
        return np.zeros((rows, 0), int)
    subsets = np.array([np.sort(rng.choice(clusters, mixture, replace=False)) for _ in range(rows)])
    for i in range(1, rows):
        if rng.random() < 0.5:
            subsets[i] = subsets[i - 1]
    return subsets


def _numbers(rng: np.random.Generator, shape: tuple[int, ...], big: float) -> Array:
    numbers = np.rint(rng.laplace(0, 2, shape)).astype(int)
    large = rng.integers(-(2**24) + 1, 2**24, shape) >> rng.integers(0, 20, shape)
    return np.where(rng.random(shape) < big, large, numbers)
