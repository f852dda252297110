"""The search for cells that are too many for H of all of them: rows exchange one cluster of their set at a time.

With the residual in memory, what one slot of all sets explains is put back, and every row takes into that slot the
cluster, of those that it is not in, which explains most, with its rows of the bases by joint least squares over the
cells of that cluster. This is the search of `choose_rows` for one of K_n clusters, whose H of one cluster is smaller by
C_n squared. The error never rises.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import backends as kernels
from ..arrays import F32
from ..cells import Cells
from .matrix_free import of_clusters
from .search import all_products, right_sides

#: A cluster must explain so much more than the one that a row has.
TIE = 1e-9


def exchange(cells: Cells, residual: F32) -> None:
    """Every slot of every clustered mode once; cells and the residual that they leave change in place."""
    for n, skip in enumerate(cells.undecomposed):
        if not skip:
            for slot in range(cells.spec.mixture[n]):
                fill_slot(cells, residual, n, slot)
            kernels.orthonormalise(cells, n)


def extend(cells: Cells, residual: F32, n: int) -> None:
    """One more cluster for every row of mode n: the one that explains most of what is left of the row."""
    size, clusters = cells.sizes[n], cells.spec.clusters[n]
    free = np.ones((size, clusters), bool)
    np.put_along_axis(free, cells.members[n].astype(np.intp), values=False, axis=1)
    cells.members[n] = np.concatenate([cells.members[n], free.argmax(axis=1)[:, None].astype(np.uint16)], axis=1)
    cells.bases[n] = np.concatenate([cells.bases[n], np.zeros_like(cells.bases[n][:, :1])], axis=1)
    mixture = [k + (m == n) for m, k in enumerate(cells.spec.mixture)]
    cells.spec = replace(cells.spec, mixture=tuple(mixture))
    fill_slot(cells, residual, n, mixture[n] - 1)


def fill_slot(cells: Cells, residual: F32, n: int, slot: int) -> None:
    """The best cluster in one slot of every row of mode n, and its rows of the bases."""
    alone = _with_slot(cells, n, slot)
    kernels.accumulate(alone, residual, 1.0)
    b = right_sides(alone, kernels.project_cells(alone, residual, n), n)
    others = np.delete(cells.members[n], slot, axis=1)
    before = cells.members[n][:, slot].copy()
    best, members, rows = np.full(cells.sizes[n], -1.0), before.copy(), cells.bases[n][:, slot].copy()
    for k in range(cells.spec.clusters[n]):
        one, at = of_clusters(alone, n, [k])
        h, b_k = kernels.dictionary_gram(one, all_products(one), n), np.ascontiguousarray(b[at])
        _, x = kernels.code_rows(h, b_k, one.spec.clusters, n, None, 1, "optimal")
        x = x.reshape(len(x), len(at), -1)  # [I_n, PC_-n, R_n]
        gain = np.einsum("icr,cri->i", x, b_k)
        gain[(others == k).any(axis=1)] = -1.0
        gain[before == k] *= 1 + TIE
        better = gain > best
        best[better], members[better], rows[better] = gain[better], k, x[better]
    cells.members[n][:, slot], cells.bases[n][:, slot] = members, rows
    kernels.accumulate(_with_slot(cells, n, slot), residual, -1.0)
    order = np.argsort(cells.members[n], axis=1)
    cells.members[n] = np.take_along_axis(cells.members[n], order, axis=1)
    cells.bases[n] = np.take_along_axis(cells.bases[n], order[:, :, None, None], axis=1)


def _with_slot(cells: Cells, n: int, slot: int) -> Cells:
    """The cells with one slot of each row of mode n alone."""
    spec = replace(cells.spec, mixture=tuple(1 if m == n else k for m, k in enumerate(cells.spec.mixture)))
    alone = Cells(cells.sizes, spec, list(cells.members), list(cells.bases), cells.cores)
    alone.members[n] = np.ascontiguousarray(cells.members[n][:, slot : slot + 1])
    alone.bases[n] = np.ascontiguousarray(cells.bases[n][:, slot : slot + 1])
    return alone
