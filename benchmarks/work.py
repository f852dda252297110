"""Useful work of the kernels: multiply-adds of the formulas (two flops each) and bytes that must move at the least."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import prod

import numpy as np

from hmkcta.cells import Cells


def expansion(sizes: Sequence[int], ranks: Sequence[int], modes: Sequence[int]) -> int:
    """Multiply-adds of a core tensor times bases, mode after mode as listed; undecomposed modes are not among them."""
    now, total = list(ranks), 0
    for n in modes:
        total += prod(now) * sizes[n]
        now[n] = sizes[n]
    return total


def projection(sizes: Sequence[int], ranks: Sequence[int], modes: Sequence[int]) -> int:
    """Multiply-adds of a tensor times transposed bases, mode after mode as listed."""
    now, total = list(sizes), 0
    for n in modes:
        total += prod(now) * ranks[n]
        now[n] = ranks[n]
    return total


def blocks(cells: Cells) -> list[tuple[int, ...]]:
    """Member rows of each mode, for every cell that has elements."""
    counts = [
        [int(np.count_nonzero(members == c)) for c in range(clusters)]
        for members, clusters in zip(cells.members, cells.spec.clusters, strict=True)
    ]
    return [sizes for sizes in product(*counts) if all(sizes)]


def accumulate_flops(cells: Cells) -> float:
    """Reconstruction of all cells, the last mode last, and adding them up."""
    modes = _decomposed(cells)
    return float(sum(2 * expansion(sizes, cells.ranks, modes) for sizes in blocks(cells)))


def project_flops(cells: Cells, n: int) -> float:
    """Projection on all modes but n, of which every row counts; in the order that costs least."""
    modes = [m for m in _decomposed(cells) if m != n]
    total = 0
    for sizes in blocks(cells):
        whole = [*sizes[:n], cells.sizes[n], *sizes[n + 1 :]]
        total += min(projection(whole, cells.ranks, order) for order in (modes, modes[::-1]))
    return 2.0 * total


def pair_flops(cells: Cells, pair: tuple[int, int]) -> float:
    """Projection of all cells on two modes, for all rows of the others, the cheaper mode first."""
    a, b = pair
    rows = [[int(np.count_nonzero(cells.members[n] == c)) for c in range(cells.spec.clusters[n])] for n in pair]
    total = 0
    for i, j in product(*rows):
        total += min(i * j * cells.ranks[b] + i * cells.ranks[b] * cells.ranks[a],
                     i * j * cells.ranks[a] + j * cells.ranks[a] * cells.ranks[b])
    tuples = prod(size for n, size in enumerate(cells.sizes) if n not in pair)
    return 2.0 * total * tuples * (cells.spec.cells // (cells.spec.clusters[a] * cells.spec.clusters[b]))


def sweep_flops(cells: Cells) -> float:
    """A Gauss-Seidel sweep: every cell is taken back in, projected once for each half of its modes, and given away."""
    modes = _decomposed(cells)
    total = 0
    for sizes in blocks(cells):
        model = expansion(sizes, cells.ranks, modes)
        halves = min(
            projection(sizes, cells.ranks, modes[at:][::-1]) + projection(sizes, cells.ranks, modes[:at])
            for at in range(1, max(2, len(modes)))
        )
        total += 2 * model + halves
    return 2.0 * total


def _decomposed(cells: Cells) -> list[int]:
    return [n for n, undecomposed in enumerate(cells.undecomposed) if not undecomposed]
