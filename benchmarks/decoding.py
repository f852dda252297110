"""Rates of decoding: scattered elements and whole blocks of a model with the paper's WH4 parameters, random numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import best_of
from benchmarks.report import Row
from hmkcta.backends import native
from hmkcta.decode import decode_block, decode_elements
from hmkcta.packed import PackedLevel

SIZES = (174, 58, 400, 380)
#: R, C, K of each level.
WH4 = (
    ((4, 4, 6, 6), (1, 1, 1, 1), (1, 1, 1, 1)),
    ((2, 2, 3, 3), (4, 3, 4, 4), (2, 2, 2, 2)),
    ((2, 2, 3, 3), (3, 3, 4, 4), (2, 2, 2, 2)),
)
Spec = tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]


def balanced_model(sizes: Sequence[int] = SIZES, specs: Sequence[Spec] = WH4, seed: int = 0) -> list[PackedLevel]:
    """Levels whose nodes all have the spec's shape and nearly equal parts, in no order; random float16 numbers."""
    rng = np.random.default_rng(seed)
    levels: list[PackedLevel] = []
    nodes = [tuple(sizes)]
    for number, spec in enumerate(specs, start=1):
        level, nodes = _level(rng, nodes, spec, last=number == len(specs))
        levels.append(level)
    return levels


def _level(
    rng: np.random.Generator, nodes: list[tuple[int, ...]], spec: Spec, *, last: bool
) -> tuple[PackedLevel, list[tuple[int, ...]]]:
    """One level over nodes of the given sizes, and the sizes of its children."""
    ranks, clusters, mixture = spec
    cells, modes, rows = prod(clusters), range(len(ranks)), np.array(nodes)
    per_row = [mixture[n] * cells // clusters[n] * ranks[n] for n in modes]
    members = [
        np.sort(np.argsort(rng.random((int(rows[:, n].sum()), clusters[n])), axis=1)[:, : mixture[n]], axis=1)
        for n in modes
    ]
    ways = [_ways_down(rng, rows[:, n].tolist(), clusters[n]) for n in modes]
    children = [
        tuple(len(range(c, nodes[s][n], clusters[n])) for n, c in zip(modes, index, strict=True))
        for s in range(len(nodes))
        for index in np.ndindex(*clusters)
    ]
    core_size = cells * prod(ranks)
    level = PackedLevel(
        shape=np.tile(np.array([clusters, mixture, ranks], np.uint32), (len(nodes), 1, 1)),
        child=None if last else _offsets([cells] * len(nodes)),
        row_offset=tuple(_offsets(rows[:, n]) for n in modes),
        core=rng.standard_normal(len(nodes) * core_size, np.float32).astype(np.float16),
        core_offset=_offsets([core_size] * len(nodes)),
        core_scale=rng.uniform(0.5, 1, len(nodes) * cells).astype(np.float32),
        cell_offset=_offsets([cells] * len(nodes)),
        cluster=tuple(m.astype(np.uint16).reshape(-1) for m in members),
        cluster_offset=tuple(_offsets(rows[:, n] * mixture[n]) for n in modes),
        basis=tuple(
            rng.standard_normal(int(rows[:, n].sum()) * per_row[n], np.float32).astype(np.float16) for n in modes
        ),
        basis_offset=tuple(_offsets(rows[:, n] * per_row[n]) for n in modes),
        part=tuple(None if last else part.astype(np.uint16) for part, _ in ways),
        local=tuple(None if last else local.astype(np.uint32) for _, local in ways),
    )
    return level, children


def _ways_down(rng: np.random.Generator, rows: list[int], parts: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Part of each row, in turn but shuffled, and its position there: rows of a part keep their order."""
    part = [rng.permutation(count) % parts for count in rows]
    return np.concatenate(part), np.concatenate([_places(each, parts) for each in part])


def _places(part: NDArray[Any], parts: int) -> NDArray[Any]:
    places = np.empty(len(part), np.intp)
    for c in range(parts):
        rows = np.flatnonzero(part == c)
        places[rows] = np.arange(len(rows))
    return places


def _offsets(counts: Any) -> NDArray[np.uint32]:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32)


def work(levels: Sequence[PackedLevel]) -> tuple[float, float]:
    """Flops and stored bytes of one scattered element: cores times basis rows, one mode after the other."""
    flops, moved = 0.0, 0.0
    for level in levels:
        _, mixture, ranks = level.shape[0].tolist()
        contraction = sum(prod(ranks[: n + 1]) for n in range(len(ranks)))
        flops += 2.0 * prod(mixture) * contraction
        moved += 2.0 * prod(mixture) * (prod(ranks) + sum(ranks))
    return flops, moved


def dense_flops(levels: Sequence[PackedLevel]) -> float:
    """Flops of one element of a large block: only the last mode's product is paid for by every element."""
    return sum(2.0 * prod(level.shape[0, 1].tolist()) * float(level.shape[0, 2, -1]) for level in levels)


def rows(threads: Sequence[int], elements: int = 1 << 20, lights: int = 16) -> Iterator[Row]:
    """Scattered elements, and a block of the first rows of the first mode, at every level."""
    levels, rng = balanced_model(), np.random.default_rng(1)
    coords = np.stack([rng.integers(0, size, elements) for size in SIZES], axis=1)
    index = [np.arange(lights), *(np.arange(size) for size in SIZES[1:])]
    block = np.empty([len(i) for i in index], np.float32)
    for count in threads:
        native.set_threads(count)
        for upto in range(1, len(levels) + 1):
            used = levels[:upto]
            seconds = best_of(lambda used=used: decode_elements(used, SIZES, coords), 3)
            flops, moved = work(used)
            detail = f"WH4, levels 1..{upto}"
            yield Row("decode, scattered", detail, count, *seconds, elements, elements * flops, elements * moved)
            seconds = best_of(lambda used=used: decode_block(used, SIZES, index, out=block), 3)
            yield Row("decode, block", detail, count, *seconds, block.size, block.size * dense_flops(used),
                      4.0 * block.size)
    native.set_threads(0)
