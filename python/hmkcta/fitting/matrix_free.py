"""Joint rows and cores of cells that are too many for H of all of them, from the residual and H of one set at a time.

Rows that are in the same clusters need H of these alone. Cores go along conjugate gradients: what every cell sees of
the residual is the gradient, and what a step adds says how far to go. Sets of clusters stay, and the error never rises.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import prod

import numpy as np
from numpy.typing import NDArray

from .. import backends as kernels
from ..arrays import F32
from ..backends.coding import patterns
from ..cells import Cells
from .search import all_products

#: Steps of conjugate gradients for the cores.
STEPS = 2
#: Visits of a sweep to an element for which a number of H may be formed: six times the time of a Gauss-Seidel sweep ..
GRAM_VISITS = 3
#: .. and how many numbers in any case, which take two seconds. Joint rows leave 0.1 to 8 dB less error than sweeps of
#: Gauss-Seidel alone on light fields, materials and volumes of 10^5 to 10^6 elements.
SOON = 1 << 25
#: Elements of a tensor that a step is tried on at a time.
SLAB = 1 << 22


def sets_pay(cells: Cells) -> bool:
    """Whether H of all sets that rows are in takes no longer than sweeps over the residual that get as far."""
    numbers = sum(len(np.unique(cells.members[n], axis=0))
                  * (cells.spec.mixture[n] * cells.spec.cells // cells.spec.clusters[n] * cells.ranks[n]) ** 2
                  for n, skip in enumerate(cells.undecomposed) if not skip)
    return numbers < max(SOON, prod(cells.sizes) * prod(cells.spec.mixture) // GRAM_VISITS)


def joint_sweep(cells: Cells, residual: F32, omega: float) -> None:
    """Rows of every mode, gone `omega` times as far as they lie, then all cores; cells and residual change in place."""
    for n, skip in enumerate(cells.undecomposed):
        if not skip:
            rows_by_sets(cells, residual, n, omega)
            kernels.orthonormalise(cells, n)
    _solve_cores(cells, residual)


def rows_by_sets(cells: Cells, residual: F32, n: int, omega: float) -> None:
    """Rows of mode n for all their clusters jointly, one set of clusters after another, with H of these alone."""
    gradient, mixture = _row_gradient(cells, residual, n), cells.spec.mixture[n]
    step = np.zeros_like(cells.bases[n])
    for subset, rows in patterns(cells.members[n]):
        some, numbers = of_clusters(cells, n, subset)
        products = [None if m == n else product for m, product in enumerate(all_products(some))]
        h = kernels.dictionary_gram(some, products, n)
        rest = [count for m, count in enumerate(cells.spec.clusters) if m != n]
        b = gradient[rows].transpose(1, 2, 3, 0).reshape(mixture, *rest, cells.ranks[n], len(rows))
        b = np.moveaxis(b, 0, n).reshape(len(numbers), cells.ranks[n], len(rows)).astype(np.float64)
        kept = np.tile(np.arange(mixture, dtype=np.uint16), (len(rows), 1))
        _, x = kernels.code_rows(h, b, some.spec.clusters, n, kept, mixture, "fixed")
        step[rows] = np.float32(omega) * x.reshape(len(rows), mixture, -1, cells.ranks[n])
    kernels.accumulate(_with_basis(cells, n, step), residual, -1.0)
    cells.bases[n] = cells.bases[n] + step


def _solve_cores(cells: Cells, residual: F32) -> None:
    """Cores of all cells jointly, the bases being orthonormal."""
    n = max((m for m, skip in enumerate(cells.undecomposed) if not skip), key=lambda m: cells.spec.clusters[m])
    step: F32 = np.zeros_like(cells.cores)
    last = 1.0
    for _ in range(STEPS):
        gradient = _core_gradient(cells, residual, n)
        falls = float(np.square(gradient, dtype=np.float64).sum())
        step = (gradient + np.float32(falls / last) * step).astype(np.float32, copy=False)
        last = max(falls, np.finfo(np.float32).tiny)
        along = Cells(cells.sizes, cells.spec, cells.members, cells.bases, step)
        rows = max(1, SLAB * cells.sizes[n] // residual.size)
        squared = sum(float(np.square(_added(along, n, slice(start, start + rows)), dtype=np.float64).sum())
                      for start in range(0, cells.sizes[n], rows))
        far = falls / squared if squared > 0 else 0.0
        kernels.accumulate(along, residual, -far)
        cells.cores = (cells.cores + np.float32(far) * step).astype(np.float32, copy=False)


def _added(cells: Cells, n: int, some: slice) -> F32:
    """What the cells make of some rows of mode n."""
    part = cells.part([np.arange(size)[some] if m == n else np.arange(size) for m, size in enumerate(cells.sizes)])
    added = np.zeros(part.sizes, np.float32)
    kernels.accumulate(part, added, 1.0)
    return added


@dataclass(frozen=True, eq=False)
class _Seen:
    """What the cells of one cluster of a mode see of the rows that are in it.

    Attributes:
        numbers: of the cells.
        rows: the rows of the cluster.
        slots: where it is in their sets.
        y: the rows projected on all other bases of each cell, `[PC_-n, rows, prod_{m != n} R_m]`.
    """

    numbers: NDArray[np.intp]
    rows: NDArray[np.intp]
    slots: NDArray[np.intp]
    y: F32


def _each_seen(cells: Cells, residual: F32, n: int) -> Iterator[_Seen]:
    """Of every cluster of mode n that has rows."""
    for k in range(cells.spec.clusters[n]):
        rows, slots = np.nonzero(cells.members[n] == k)
        if len(rows):
            one, numbers = of_clusters(cells, n, [k])
            part = one.part([rows if m == n else np.arange(size) for m, size in enumerate(cells.sizes)])
            y = kernels.project_cells(part, np.ascontiguousarray(residual.take(rows, axis=n)), n)
            yield _Seen(numbers, rows, slots, y)


def _row_gradient(cells: Cells, residual: F32, n: int) -> F32:
    """D^T r of every row of mode n for the clusters that it is in, as bases are: `[I_n, K_n, PC_-n, R_n]`."""
    cores = np.moveaxis(cells.cores, n + 1, 1).reshape(cells.spec.cells, cells.ranks[n], -1)
    gradient = np.zeros_like(cells.bases[n])
    for seen in _each_seen(cells, residual, n):
        gradient[seen.rows, seen.slots] = (seen.y @ cores[seen.numbers].transpose(0, 2, 1)).transpose(1, 0, 2)
    return gradient


def _core_gradient(cells: Cells, residual: F32, n: int) -> F32:
    """The residual projected on the bases of every cell, by way of mode n: `[PC, R_1, .., R_N]`."""
    gradient = np.zeros((cells.spec.cells, cells.ranks[n], prod(cells.ranks) // cells.ranks[n]), np.float32)
    for seen in _each_seen(cells, residual, n):
        gradient[seen.numbers] = cells.bases[n][seen.rows, seen.slots].transpose(1, 2, 0) @ seen.y
    others = [rank for m, rank in enumerate(cells.ranks) if m != n]
    return np.ascontiguousarray(np.moveaxis(gradient.reshape(cells.spec.cells, cells.ranks[n], *others), 1, n + 1))


def _with_basis(cells: Cells, n: int, basis: F32) -> Cells:
    bases = [basis if m == n else own for m, own in enumerate(cells.bases)]
    return Cells(cells.sizes, cells.spec, cells.members, bases, cells.cores)


def of_clusters(cells: Cells, n: int, subset: Sequence[int]) -> tuple[Cells, NDArray[np.intp]]:
    """The cells with c_n in the subset, as those of a node, without bases of mode n; and their numbers."""
    clusters = cells.spec.clusters
    numbers = np.arange(cells.spec.cells).reshape(clusters).take(subset, axis=n).reshape(-1)
    count = len(subset)
    spec = replace(cells.spec, clusters=tuple(count if m == n else own for m, own in enumerate(clusters)),
                   mixture=tuple(1 if m == n else own for m, own in enumerate(cells.spec.mixture)))
    bases, members = list(cells.bases), list(cells.members)
    for m, skip in enumerate(cells.undecomposed):
        if m != n and not skip:
            rest = [own for other, own in enumerate(clusters) if other != m]
            own = cells.bases[m]
            taken = own.reshape(*own.shape[:2], *rest, own.shape[3]).take(subset, axis=2 + n - (n > m))
            bases[m] = np.ascontiguousarray(taken).reshape(*own.shape[:2], -1, own.shape[3])
    members[n] = np.zeros((cells.sizes[n], 1), np.uint16)
    bases[n] = np.zeros((cells.sizes[n], 1, len(numbers) // count, cells.ranks[n]), np.float32)
    return Cells(cells.sizes, spec, members, bases, cells.cores[numbers]), numbers
