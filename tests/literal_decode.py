"""Section 4 of `docs/format.md` word by word, one element at a time in Python numbers: an oracle, slow and plain."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmkcta.packed import PackedLevel


def element(levels: Sequence[PackedLevel], index: Sequence[int], upto: int) -> float:
    """Value of one element of the tensor of modes up to a level, before the inverse of the value transform."""
    s, position, value = 0, list(index), 0.0
    for number, level in enumerate(levels[:upto], 1):
        if not level.shape[s, 0].any():
            break
        value += _term(level, s, position)
        child, clusters = level.child, [int(c) for c in level.shape[s, 0]]
        if number == upto or child is None or child[s] == child[s + 1]:
            break
        rows = [int(offset[s]) + p for offset, p in zip(level.row_offset, position, strict=True)]
        parts = [0 if part is None else int(part[row]) for part, row in zip(level.part, rows, strict=True)]
        position = [p if local is None else int(local[row])
                    for local, row, p in zip(level.local, rows, position, strict=True)]
        s = int(child[s]) + flat(parts, clusters)
    return value


def _term(level: PackedLevel, s: int, position: Sequence[int]) -> float:
    """What one node adds to an element: a sum over all choices of one cluster subset a mode."""
    clusters, mixture, ranks = ([int(x) for x in row] for row in level.shape[s])
    core = _of_node(level.core, level.core_offset, s).reshape(-1, *ranks)
    scale = _of_node(level.core_scale, level.cell_offset, s)
    total = 0.0
    for choice in product(*(range(k) for k in mixture)):
        cell = [0 if cluster is None else int(_of_node(cluster, level.cluster_offset[n], s)
                                              .reshape(-1, mixture[n])[position[n], choice[n]])
                for n, cluster in enumerate(level.cluster)]
        block: NDArray[Any] = core[flat(cell, clusters)]
        for n in range(len(ranks)):  # the first remaining mode each time
            block = np.tensordot(_weights(level, s, n, position[n], choice[n], cell), block, axes=(0, 0))
        total += float(scale[flat(cell, clusters)]) * float(block)
    return total


def _weights(level: PackedLevel, s: int, n: int, position: int, choice: int, cell: Sequence[int]
             ) -> NDArray[np.float64]:
    """The R_n numbers of a row's basis; a unit vector for an undecomposed mode."""
    clusters, mixture, ranks = ([int(x) for x in row] for row in level.shape[s])
    basis = level.basis[n]
    if basis is None:
        return np.eye(ranks[n])[position]
    others = flat([*cell[:n], *cell[n + 1:]], [*clusters[:n], *clusters[n + 1:]])
    cells = prod(clusters) // clusters[n]
    numbers = _of_node(basis, level.basis_offset[n], s).reshape(-1, mixture[n], cells, ranks[n])
    return numbers[position, choice, others]


def _of_node(array: NDArray[Any], offsets: NDArray[np.uint32] | None, s: int) -> NDArray[np.float64]:
    assert offsets is not None
    return array[int(offsets[s]):int(offsets[s + 1])].astype(np.float64)


def flat(index: Sequence[int], sizes: Sequence[int]) -> int:
    """C-order flattening: the last number is the fastest."""
    number = 0
    for i, size in zip(index, sizes, strict=True):
        number = number * size + i
    return number
