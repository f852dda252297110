"""What a model says of an element, word by word, one element at a time in Python numbers: an oracle, slow and plain."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmkcta.packed import PackedLevel


def element(stages: Sequence[PackedLevel], index: Sequence[int], upto: int) -> float:
    """Value of one element of the tensor of modes up to a stage, before the inverse of the value transform."""
    s, position, value = 0, list(index), 0.0
    for number, stage in enumerate(stages[:upto], 1):
        clusters, _, ranks = ([int(x) for x in row] for row in stage.shape[s])
        if not any(clusters):
            break  # empty: no numbers, and no children
        if any(ranks):  # not a cut
            value += _term(stage, s, position)
        child = stage.child
        if number == upto or child is None or child[s] == child[s + 1]:
            break
        parts: list[int] = []
        for n, (part, local) in enumerate(zip(stage.part, stage.local, strict=True)):
            assert part is not None
            assert local is not None
            row = int(stage.row_offset[n][s]) + position[n]
            parts.append(int(part[row]))
            position[n] = int(local[row])
        s = int(child[s]) + flat(parts, clusters)
    return value


def _term(stage: PackedLevel, s: int, position: Sequence[int]) -> float:
    """What one node adds to an element: a sum over all choices of one cluster subset a mode."""
    clusters, mixture, ranks = ([int(x) for x in row] for row in stage.shape[s])
    core = _of_node(stage.core, stage.core_offset, s).reshape(-1, *ranks)
    scale = _of_node(stage.core_scale, stage.cell_offset, s)
    total = 0.0
    for choice in product(*(range(max(1, k)) for k in mixture)):
        cell = [0 if not mixture[n] else int(_of_node(cluster, stage.cluster_offset[n], s)
                                             .reshape(-1, mixture[n])[position[n], choice[n]])
                for n, cluster in enumerate(stage.cluster)]
        block: NDArray[Any] = core[flat(cell, clusters)]
        for n in range(len(ranks)):  # the first remaining mode each time
            block = np.tensordot(_weights(stage, s, n, position[n], choice[n], cell), block, axes=(0, 0))
        total += float(scale[flat(cell, clusters)]) * float(block)
    return total


def _weights(stage: PackedLevel, s: int, n: int, position: int, choice: int, cell: Sequence[int]
             ) -> NDArray[np.float64]:
    """The R_n numbers of a row's basis; a unit vector where the mode is undecomposed."""
    clusters, mixture, ranks = ([int(x) for x in row] for row in stage.shape[s])
    if not mixture[n]:
        return np.eye(ranks[n])[position]
    others = flat([*cell[:n], *cell[n + 1:]], [*clusters[:n], *clusters[n + 1:]])
    cells = prod(clusters) // clusters[n]
    numbers = _of_node(stage.basis[n], stage.basis_offset[n], s).reshape(-1, mixture[n], cells, ranks[n])
    return numbers[position, choice, others]


def _of_node(array: NDArray[Any], offsets: NDArray[np.uint32], s: int) -> NDArray[np.float64]:
    return array[int(offsets[s]):int(offsets[s + 1])].astype(np.float64)


def flat(index: Sequence[int], sizes: Sequence[int]) -> int:
    """C-order flattening: the last number is the fastest."""
    number = 0
    for i, size in zip(index, sizes, strict=True):
        number = number * size + i
    return number
