"""Cluster subsets and rows of one mode: block-sparse coding of each slice in the dictionary of the other modes.

For slice t_i and cluster subset S the gain is b_S^T H_SS^-1 b_S with b = D^T t_i and H = D^T D, all in parameter space.
The optimal search looks at every subset (the paper's section 5), the greedy one lets subsets grow by their best next
cluster, and `extend` adds clusters by the residual's energy where even H does not fit.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from . import backends as kernels
from .cells import Cells, dense_basis, store_basis

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Subset = tuple[int, ...]

#: Ridge on H_SS relative to its mean diagonal: keeps collinear dictionaries solvable, costs nothing visible in SNR.
RIDGE = 1e-7


@dataclass
class Coding:
    """b and H of one mode, and the best subset found so far for each row with its coefficients."""

    h: F64  # [C_n Q, C_n Q], grouped by the mode's cluster
    b: F64  # [C_n Q, I_n]
    q: int
    gain: F64  # [I_n]
    rows: dict[Subset, NDArray[np.intp]] = field(default_factory=dict[Subset, NDArray[np.intp]])
    subset: list[Subset] = field(default_factory=list[Subset])
    coefficients: list[F64] = field(default_factory=list[F64])

    def solve(self, subset: Subset, rows: NDArray[np.intp]) -> tuple[F64, F64]:
        """Coefficients `[|S| Q, rows]` and gains of the given rows on the clusters of one subset."""
        at = np.concatenate([np.arange(k * self.q, (k + 1) * self.q) for k in subset])
        system = self.h[np.ix_(at, at)]
        diagonal = np.einsum("ii->i", system)
        diagonal += RIDGE * diagonal.mean() + np.finfo(np.float64).tiny
        b = self.b[np.ix_(at, rows)]
        x = np.linalg.solve(system, b)
        gain: F64 = np.sum(b * x, axis=0)
        return x.astype(np.float64), gain

    def consider(self, subset: Subset, rows: NDArray[np.intp]) -> None:
        """Give the subset to those rows whose gain it raises; ties go to the subset seen first."""
        x, gain = self.solve(subset, rows)
        better = gain > self.gain[rows] * (1 + 1e-9)
        for column, i in zip(np.flatnonzero(better), rows[better], strict=True):
            self.subset[i], self.coefficients[i] = subset, x[:, column]
        self.gain[rows[better]] = gain[better]


def joint_rows(cells: Cells, tensor: F32, n: int, mixture: int, search: str) -> None:
    """New subsets (of `mixture` clusters) and basis rows of mode n, jointly optimal given all else.

    `search` is ``optimal``, ``greedy`` or ``fixed`` (keep the subsets). The rows are not orthonormal afterwards.
    """
    choose_rows(cells, code(cells, kernels.project_cells(cells, tensor, n), n), n, mixture, search)


def choose_rows(cells: Cells, coding: Coding, n: int, mixture: int, search: str) -> None:
    """`joint_rows` with b and H at hand."""
    clusters, size = cells.spec.clusters[n], cells.sizes[n]
    everyone = np.arange(size)
    if search == "fixed":
        for subset, rows in _patterns(cells.members[n]):
            coding.consider(subset, rows)
    elif search == "optimal":
        for subset in combinations(range(clusters), mixture):
            coding.consider(subset, everyone)
    else:
        _grow(coding, clusters, mixture, everyone)
        if cells.members[n].shape[1] == mixture:  # what was there stays where growing leads to worse
            for subset, rows in _patterns(cells.members[n]):
                coding.consider(subset, rows)
    _store(cells, n, coding, mixture)


def code(cells: Cells, y: NDArray[np.floating], n: int) -> Coding:
    """b and H of mode n, grouped by its clusters, from the projections `y` `[PC, I_n, prod_{m != n} R_m]`."""
    rank, clusters = cells.ranks[n], cells.spec.clusters[n]
    cores = np.moveaxis(cells.cores, n + 1, 1).reshape(cells.spec.cells, rank, -1)
    b = np.matmul(cores.astype(np.float64), y.transpose(0, 2, 1))  # [PC, R_n, I_n]
    order = np.argsort(np.indices(cells.spec.clusters)[n].reshape(-1), kind="stable")
    columns = (order[:, None] * rank + np.arange(rank)).reshape(-1)  # grouped by the mode's cluster
    h = kernels.dictionary_gram(cells, n)[np.ix_(columns, columns)]
    size = cells.sizes[n]
    return Coding(
        h,
        b.reshape(-1, size)[columns],
        len(columns) // clusters,
        np.full(size, -1.0),
        subset=[()] * size,
        coefficients=[np.zeros(0)] * size,
    )


def project_model(cells: Cells, other: Cells, n: int) -> F64:
    """What `project_cells` makes of the other cells' reconstruction, from their bases and cores alone.

    `Y_n[c] = sum_d Z_d x_{m != n} (U_{m,c}^T U_{m,d}) x_n U_{n,d}`, `[PC, I_n, prod_{m != n} R_m]`; nothing the size of
    the tensor is touched.
    """
    modes = [m for m in range(cells.order) if m != n and not cells.undecomposed[m]]
    theirs = {m: dense_basis(other, m).astype(np.float64).transpose(0, 2, 1) for m in [*modes, n]}  # [PD, R_m, I_m]
    ours = {m: dense_basis(cells, m).astype(np.float64) for m in modes}  # [PC, I_m, R_m]
    expand = theirs[n].transpose(2, 0, 1).reshape(cells.sizes[n], -1)  # [I_n, PD R_n]
    y: list[F64] = []
    for c in range(cells.spec.cells):
        x: F64 = other.cores.astype(np.float64)
        for m in modes:
            gram = theirs[m] @ ours[m][c]  # [PD, R_m of d, R_m of c]
            x = np.moveaxis(x, m + 1, -1)
            shape = (*x.shape[:-1], gram.shape[2])
            x = np.moveaxis((x.reshape(len(gram), -1, gram.shape[1]) @ gram).reshape(shape), -1, m + 1)
        y.append(expand @ np.moveaxis(x, n + 1, 1).reshape(expand.shape[1], -1))
    return np.array(y)


def _patterns(members: NDArray[np.uint16]) -> Iterable[tuple[Subset, NDArray[np.intp]]]:
    """The distinct subsets in use, each with its rows."""
    distinct, which = np.unique(members, axis=0, return_inverse=True)
    for number, subset in enumerate(distinct):
        yield tuple(int(k) for k in subset), np.flatnonzero(which.reshape(-1) == number)


def _grow(coding: Coding, clusters: int, mixture: int, everyone: NDArray[np.intp]) -> None:
    """Greedy search with joint re-projection: every subset in use tries every further cluster."""
    for k in range(clusters):
        coding.consider((k,), everyone)
    for _ in range(mixture - 1):
        grown = list(coding.subset)
        coding.gain[:] = -1.0
        for subset in sorted(set(grown)):
            rows = np.array([i for i, s in enumerate(grown) if s == subset])
            for k in set(range(clusters)) - set(subset):
                coding.consider(tuple(sorted((*subset, k))), rows)


def _store(cells: Cells, n: int, coding: Coding, mixture: int) -> None:
    """Coefficients of a subset are ordered cluster, flat(c_-n), rank: the stored order of a basis row."""
    others, rank, size = cells.spec.cells // cells.spec.clusters[n], cells.ranks[n], cells.sizes[n]
    cells.members[n] = np.array(coding.subset, np.uint16).reshape(size, mixture)
    cells.bases[n] = np.array(coding.coefficients, np.float32).reshape(size, mixture, others, rank)
    cells.spec = replace(cells.spec, mixture=(*cells.spec.mixture[:n], mixture, *cells.spec.mixture[n + 1 :]))


def extend(cells: Cells, residual: F32, n: int) -> None:
    """One more cluster for every row of mode n: the one whose cells see most of the row's residual.

    Its basis rows start at zero, so the model is unchanged and Gauss-Seidel sweeps can only lower the error.
    """
    clusters, size, rank = cells.spec.clusters[n], cells.sizes[n], cells.ranks[n]
    seen = np.square(kernels.project_cells(cells, residual, n), dtype=np.float64).sum(axis=2)  # [PC, I_n]
    others = tuple(m for m in range(cells.order) if m != n)
    score = seen.reshape(*cells.spec.clusters, size).sum(axis=others).T  # [I_n, C_n]
    np.put_along_axis(score, cells.members[n].astype(np.intp), -1.0, axis=1)
    joined = np.concatenate([cells.members[n], score.argmax(axis=1)[:, None].astype(np.uint16)], axis=1)
    fresh = np.zeros((size, 1, cells.spec.cells // clusters, rank), np.float32)
    order = np.argsort(joined, axis=1)
    cells.bases[n] = np.ascontiguousarray(
        np.take_along_axis(np.concatenate([cells.bases[n], fresh], axis=1), order[:, :, None, None], axis=1)
    )
    cells.members[n] = np.take_along_axis(joined, order, axis=1)
    cells.spec = replace(cells.spec, mixture=(*cells.spec.mixture[:n], joined.shape[1], *cells.spec.mixture[n + 1 :]))


def orthonormalise(cells: Cells, n: int) -> None:
    """U_n = Q S for every cell with orthonormal Q, S into the core; dependent columns become zero and stay so.

    Symmetric: S comes from the eigenvectors of U^T U, so that rows outside a cell stay zero.
    """
    dense = dense_basis(cells, n).astype(np.float64)  # [PC, I_n, R_n]
    values, vectors = np.linalg.eigh(dense.transpose(0, 2, 1) @ dense)
    root = np.sqrt(np.maximum(values, 0.0))
    keep = root > 1e-6 * np.maximum(root[:, -1:], np.finfo(np.float64).tiny)
    inverse = np.where(keep, 1.0 / np.where(keep, root, 1.0), 0.0)
    store_basis(cells, n, dense @ (vectors * inverse[:, None]))
    factor = (vectors * root[:, None]).transpose(0, 2, 1)
    cores = np.moveaxis(cells.cores, n + 1, 1)  # [PC, R_n, others]
    mixed = np.matmul(factor, cores.reshape(*cores.shape[:2], -1).astype(np.float64)).reshape(cores.shape)
    cells.cores = np.ascontiguousarray(np.moveaxis(mixed, 1, n + 1), np.float32)
