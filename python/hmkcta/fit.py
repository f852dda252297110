"""One level on one node: MK-CTA (paper, section 3.2) by joint least squares in the Gram domain."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from .backends import native as kernels
from .cells import Cells, dense_basis, empty_cells, store_basis
from .memberships import start_candidates
from .plan import LevelSpec

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

import os
SWEEPS = [int(x) for x in os.environ.get("SWEEPS", "1,2,2,3").split(",")]


def fit_level(tensor: F32, spec: LevelSpec, rng: np.random.Generator, candidates: int | None = None) -> tuple[Cells, F32]:
    spec = spec.clamped(tensor.shape)
    cells, residual = disjoint_start(tensor, spec, rng, candidates)
    if max(spec.mixture) == 1:
        kernels.fit_cells(cells, residual, SWEEPS[3], 2)
        return cells, residual
    rounds, before, its, after = SWEEPS
    for _ in range(rounds):
        for n in range(tensor.ndim):
            if spec.mixture[n] >= 1 and spec.ranks[n] is not None and spec.cells > 1:
                joint_rows(cells, tensor, n, search=spec.mixture[n] < spec.clusters[n])
                orthonormalise(cells, n)
        residual = tensor.copy()
        kernels.accumulate(cells, residual, -1.0)
        kernels.fit_cells(cells, residual, after, its)
    return cells, residual


def disjoint_start(tensor: F32, spec: LevelSpec, rng, candidates=None):
    single = replace(spec, mixture=(1,) * spec.order)
    best = None
    for number, labels in enumerate(start_candidates(tensor, spec.clusters, rng)):
        if best is not None and (spec.cells == 1 or (candidates is not None and number >= candidates)):
            break
        members = [l[:, None].astype(np.uint16) for l in labels]
        cells = empty_cells(tensor.shape, single, members, np.random.default_rng(0))
        residual = tensor.copy()
        kernels.fit_cells(cells, residual, 1, 3)
        error = float(np.vdot(residual, residual))
        if best is None or error < best[0]:
            best = (error, cells, residual)
    best[1].spec = best[1].spec
    cells = best[1]
    cells.spec = spec if max(spec.mixture) == 1 else replace(spec, mixture=cells.spec.mixture)
    cells.target = spec
    return cells, best[2]


def joint_rows(cells: Cells, tensor: F32, n: int, search: bool) -> None:
    """Rows of mode n and their cluster subsets together: block-sparse coding of each slice t_i in the dictionary."""
    target = cells.target
    c_n, k_n, r_n = target.clusters[n], target.mixture[n], target.ranks[n]
    y = kernels.project_cells(cells, tensor, n)
    cores = np.moveaxis(cells.cores, n + 1, 1).reshape(cells.spec.cells, r_n, -1)
    b = np.einsum("ciq,crq->cri", y, cores, dtype=np.float64, optimize=True)  # [PC, R, I]
    h = kernels.dictionary_gram(cells, n)
    cluster_of = np.indices(target.clusters)[n].reshape(-1)
    columns = [np.flatnonzero(np.repeat(cluster_of == k, r_n)) for k in range(c_n)]
    b = b.reshape(-1, b.shape[-1])
    size = b.shape[1]
    subsets = list(combinations(range(c_n), k_n))
    best_gain = np.full(size, -np.inf)
    best = np.zeros(size, int)
    rows: list[F64] = []
    for number, subset in enumerate(subsets):
        at = np.concatenate([columns[k] for k in subset])
        system = h[np.ix_(at, at)]
        diagonal = np.einsum("ii->i", system)
        diagonal += 1e-5 * diagonal.mean() * 1e-2 + 1e-7 * diagonal + 1e-30
        x = np.linalg.solve(system, b[at])
        gain = (b[at] * x).sum(0)
        better = gain > (best_gain if number == 0 else best_gain * (1 + 1e-9))
        best_gain[better] = gain[better]
        best[better] = number
        rows.append(x)
    members = np.array(subsets, np.uint16)[best]
    cells.members[n] = members
    cells.spec = replace(cells.spec, mixture=tuple(k_n if m == n else k for m, k in enumerate(cells.spec.mixture)))
    others = target.cells // c_n
    basis = np.empty((size, k_n, others, r_n), np.float32)
    for number in range(len(subsets)):
        where = best == number
        # columns of a subset are ordered by cluster, then flat(c_-n) as in C order of all cells, then rank
        basis[where] = rows[number][:, where].T.reshape(-1, k_n, others, r_n)
    cells.bases[n] = basis


def orthonormalise(cells: Cells, n: int) -> None:
    """U_n = Q S with orthonormal Q for every cell, S into the core; dependent columns become zero."""
    dense = dense_basis(cells, n).astype(np.float64)
    values, vectors = np.linalg.eigh(dense.transpose(0, 2, 1) @ dense)
    root = np.sqrt(np.maximum(values, 0))
    keep = root > 1e-6 * root[:, -1:]
    inverse = np.where(keep, 1 / np.where(keep, root, 1), 0)
    store_basis(cells, n, dense @ (vectors * inverse[:, None]))
    factor = (vectors * root[:, None]).transpose(0, 2, 1)  # new core = S x_n core
    cores = np.moveaxis(cells.cores, n + 1, 1)
    mixed = np.matmul(factor, cores.reshape(*cores.shape[:2], -1)).reshape(cores.shape)
    cells.cores = np.ascontiguousarray(np.moveaxis(mixed, 1, n + 1), np.float32)
