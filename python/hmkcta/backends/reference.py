"""The readable twin of the native kernels: one cell at a time, in float64, close to the paper's formulas.

A cell is a cluster c = (c_1..c_N) of the paper's equation 2. It owns the sub-tensor of the rows that have c_n among
their subsets S_n(i) in every mode, and a Tucker model of it: core Z_c and bases U_{n,c}.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32, F64
from ..cells import Cells, Products
from ..cells import dense_basis as dense_basis
from ..metrics import squared_norm
from .coding import code_rows as code_rows  # the twin of the native search
from .kmeans import cluster_rows as cluster_rows  # and of the native clustering
from .kmeans import nearest_with_room as nearest_with_room

#: Row numbers of each mode.
Rows = Sequence[NDArray[np.intp]]

name = "reference"

#: What is left of a column once its parts along earlier ones are taken out is rounding noise below this share of it.
DEPENDENT = 1e-5
#: Where what is left of the right sides, squared, is a smaller share of them, cores are exact.
EXACT = 1e-14


def set_threads(count: int) -> None:
    """Threads are for the native kernels; this does nothing."""


@dataclass
class Cell:
    """One cell: its rows in every mode and its Tucker model.

    Attributes:
        number: flat(c).
        subset: c.
        rows: for each mode the rows i with c_n in S_n(i).
        bases: for each mode U_{n,c}, member rows only `[m_n, R_n]`; None for an undecomposed mode.
        core: Z_c `[R_1, .., R_N]`.
    """

    number: int
    subset: tuple[int, ...]
    rows: list[NDArray[np.intp]]
    bases: list[F64 | None]
    core: F64


def fit_cells(cells: Cells, residual: F32, sweeps: int, iterations: int) -> None:
    """Gauss-Seidel over the cells, in place: each in turn takes back its part and fits itself to the residual.

    Args:
        cells: their bases and cores are replaced.
        residual: data minus model, on entry and on return.
        sweeps: rounds over all cells.
        iterations: subspace iterations of each mode update.
    """
    for _ in range(sweeps):
        for cell in _each_cell(cells):
            here = np.ix_(*cell.rows)
            block = residual[here] + _reconstruct(cell)
            _hooi(cell, block, iterations)
            residual[here] = block - _reconstruct(cell)
            _store(cells, cell)


def accumulate(cells: Cells, tensor: F32, weight: float) -> None:
    """`tensor += weight * model`, in place."""
    for cell in _each_cell(cells):
        tensor[np.ix_(*cell.rows)] += np.asarray(weight * _reconstruct(cell), np.float32)


def project_cells(cells: Cells, tensor: F32, n: int) -> F32:
    """`Y_n[c] = T x_{m != n} U_{m,c}^T` for all rows of mode n, whatever their subsets; zero for empty cells.

    Returns:
        `[PC, I_n, prod_{m != n} R_m]`, the unfoldings along mode n.
    """
    size = cells.sizes[n]
    y = np.zeros((cells.spec.cells, size, int(np.prod(cells.ranks)) // cells.ranks[n]), np.float32)
    for cell in _each_cell(cells, whole=[n]):
        block = tensor[np.ix_(*cell.rows)].astype(np.float64)
        y[cell.number] = _unfold(_project(block, [None if m == n else u for m, u in enumerate(cell.bases)]), n)
    return y


def project_pair(cells: Cells, tensor: F32, pair: tuple[int, int]) -> F32:
    """The tensor projected on the bases of all cells in two modes a and b, for all rows of the other, kept modes.

    Returns:
        ``[.., I_m, .., C_a, C_b, R_a, .., C_m, .., R_b]`` with m the kept modes: cells whose bases are read together
        lie side by side. Zero for cells without rows in a or b.
    """
    a, b = pair
    kept = [m for m in range(cells.order) if m not in pair]
    clusters, ranks = cells.spec.clusters, cells.ranks
    p = np.zeros([*(cells.sizes[m] for m in kept), clusters[a], clusters[b], ranks[a], *(clusters[m] for m in kept),
                  ranks[b]], np.float32)  # fmt: skip
    for cell in _each_cell(cells, whole=kept):
        block = tensor[np.ix_(*cell.rows)].astype(np.float64)
        projected = _project(block, [u if m in pair else None for m, u in enumerate(cell.bases)])
        c = cell.subset
        p[(..., c[a], c[b], slice(None), *(c[m] for m in kept), slice(None))] = np.moveaxis(projected, pair, (-2, -1))
    return p


def contract_lanes(p: F32, w: F32) -> F32:
    """`Y[i, k, r, l] = sum_j P[i, j, k, l] W[j, r, l]`."""
    return np.einsum("ijkl,jrl->ikrl", p, w, dtype=np.float64).astype(np.float32)


def collect(
    array: NDArray[Any], modes: Sequence[Sequence[int]], rows: Rows, out: NDArray[Any], factor: float | None = None
) -> None:
    """The sub-tensor of some rows of each mode of an array in any layout, into `out`, of the array's type.

    A mode merges the axes it lists, in order. Float32 numbers may be multiplied by a factor.
    """
    index: list[Any] = [slice(None)] * array.ndim
    for n, (mode, chosen) in enumerate(zip(modes, rows, strict=True)):
        along = [-1 if m == n else 1 for m in range(len(modes))]
        for axis, at in zip(mode, np.unravel_index(chosen, [array.shape[axis] for axis in mode]), strict=True):
            index[axis] = at.reshape(along)
    out[...] = array[tuple(index)] if factor is None else array[tuple(index)] * np.float32(factor)


def magnitudes(values: F32) -> tuple[float, float, float]:
    """The sum of squares in float64, which is not finite if a number is not; the largest magnitude, and the smallest
    but zero, infinite if there is none.

    >>> magnitudes(np.array([0, -3, 0.5], np.float32))
    (9.25, 3.0, 0.5)
    """
    sizes = np.abs(values)
    return squared_norm(values), float(sizes.max(initial=0.0)), float(sizes.min(where=sizes > 0, initial=np.inf))


def gather(tensor: F32, rows: Rows) -> F32:
    """The sub-tensor of some rows of each mode, ascending, in one piece."""
    return np.ascontiguousarray(tensor[np.ix_(*rows)])


def scatter(tensor: F32, rows: Rows, block: F32) -> None:
    """Put a sub-tensor back, in place."""
    tensor[np.ix_(*rows)] = block


def dictionary_gram(cells: Cells, products: Sequence[Products | None], n: int) -> F64:
    """Inner products of all dictionary columns `D_{n,c}[r] = vec(Z_c[r] x_{m != n} U_{m,c})`.

    `H_n[c,c'] = unf_n(Z_c) (kron_{m != n} M_m) unf_n(Z_c')^T` with `M_m = U_{m,c}^T U_{m,c'}`.

    Args:
        cells: their cores are used, not their bases.
        products: M_m of all pairs of cells, as `search.all_products` has them; that of mode n is not used.
        n: the mode.

    Returns:
        `[PC R_n, PC R_n]`, symmetric.
    """
    count, rank = cells.spec.cells, cells.ranks[n]
    cores = cells.cores.astype(np.float64)
    h = np.empty((count, rank, count, rank))
    for c in range(count):
        to_others = [None if p is None or m == n else p[:, c].transpose(0, 2, 1) for m, p in enumerate(products)]
        x = _multiplied(np.broadcast_to(cores[c], cores.shape), to_others)
        left, right = (np.moveaxis(z, n + 1, 1).reshape(count, rank, -1) for z in (x, cores))
        h[c] = np.einsum("drq,dsq->rds", left, right, optimize=True)
    return h.reshape(count * rank, count * rank)


def solve_cores(cells: Cells, products: Sequence[Products | None], b: F64, steps: int) -> None:
    """Cores of all cells that leave less of a tensor together, the bases given, in place.

    `G Z = b` by conjugate gradients from the present cores, with `(G Z)_c = sum_c' Z_c' x_m M_m` over all decomposed
    modes m, `M_m = U_{m,c}^T U_{m,c'}`: what is left falls with every step.

    Args:
        cells: their cores are replaced.
        products: M_m of all pairs of cells, as `search.all_products` has them.
        b: the tensor projected on the bases of every cell, `[PC, R_1, .., R_N]`.
        steps: of conjugate gradients, at the most.
    """

    def applied(z: F64) -> F64:
        to_each = ([None if p is None else p[..., c] for p in products] for c in range(len(z)))
        return np.array([_multiplied(z, to_c).sum(axis=0) for to_c in to_each])

    z = cells.cores.astype(np.float64)
    r = b - applied(z)
    p, left = r, float(np.vdot(r, r))
    for _ in range(steps):
        q = applied(p)
        curvature = float(np.vdot(p, q))
        if left <= EXACT * float(np.vdot(b, b)) or curvature <= 0:
            break
        z, r = z + left / curvature * p, r - left / curvature * q
        before, left = left, float(np.vdot(r, r))
        p = r + left / before * p
    cells.cores = z.astype(np.float32)


def orthonormalise(cells: Cells, n: int) -> None:
    """`U_n = Q S` for every cell, in place: Q takes the place of the basis, and the core becomes `Z x_n S`.

    Q is orthonormal in the order of its columns; those that depend on earlier ones become zero, and stay so.
    """
    for cell in _each_cell(cells, whole=[m for m in range(cells.order) if m != n]):
        u = cell.bases[n]
        assert u is not None
        cell.bases[n] = q = _orthonormal(u)
        cell.core = np.moveaxis(np.tensordot(q.T @ u, cell.core, (1, n)), 0, n)
        _store(cells, cell)


def _multiplied(x: F64, matrices: Sequence[F64 | None]) -> F64:
    """`x_d x_m M_d` over all modes m: every core `[PC, R_1, .., R_N]` by matrices of its own, `[R_m, PC, new R_m]`."""
    for m, matrix in enumerate(matrices):
        if matrix is not None:
            x = np.moveaxis(np.einsum("d...r,rds->d...s", np.moveaxis(x, m + 1, -1), matrix), -1, m + 1)
    return x


def _each_cell(cells: Cells, whole: Sequence[int] = ()) -> Iterator[Cell]:
    """All cells that own elements, in C order; of the modes `whole` with all their rows."""
    for number in range(cells.spec.cells):
        subset = tuple(int(k) for k in np.unravel_index(number, cells.spec.clusters))
        rows: list[NDArray[np.intp]] = []
        bases: list[F64 | None] = []
        for n, k in enumerate(subset):
            members, slots = np.nonzero(cells.members[n] == k)
            rows.append(np.arange(cells.sizes[n]) if n in whole else members)
            bases.append(None if cells.undecomposed[n] else cells.bases[n][members, slots, _others(cells, subset, n)])
        if all(len(r) for r in rows):
            bases = [None if u is None else u.astype(np.float64) for u in bases]
            yield Cell(number, subset, rows, bases, cells.cores[number].astype(np.float64))


def _others(cells: Cells, subset: Sequence[int], n: int) -> int:
    """flat(c_-n): where the bases of mode n of this cell lie among those of the same cluster subset."""
    clusters = [c for m, c in enumerate(cells.spec.clusters) if m != n]
    return int(np.ravel_multi_index([k for m, k in enumerate(subset) if m != n], clusters)) if clusters else 0


def _store(cells: Cells, cell: Cell) -> None:
    cells.cores[cell.number] = cell.core
    for n, u in enumerate(cell.bases):
        if u is not None:
            members, slots = np.nonzero(cells.members[n] == cell.subset[n])
            cells.bases[n][members, slots, _others(cells, cell.subset, n)] = u


def _hooi(cell: Cell, block: F64, iterations: int) -> None:
    """One HOOI round (paper, section 3.1): every basis in turn, from the block projected on all the others."""
    cell.bases = [None if u is None else _orthonormal(u) for u in cell.bases]
    for n, u in enumerate(cell.bases):
        if u is not None:
            e = _unfold(_project(block, [None if m == n else v for m, v in enumerate(cell.bases)]), n)
            cell.bases[n] = _subspace(e, u, iterations)
    cell.core = _project(block, cell.bases)


def _subspace(e: F64, u: F64, iterations: int) -> F64:
    """Towards the leading left subspace of `e` `[m, q]` from `u` `[m, R]`: U <- orth(E orth(E^T U)).

    The energy of `e` within the subspace never falls.
    """
    if e.shape[1] <= u.shape[1] and iterations > 0:  # all of e is spanned
        return _orthonormal(np.pad(e, ((0, 0), (0, u.shape[1] - e.shape[1]))))
    for _ in range(iterations):
        u = _orthonormal(e @ _orthonormal(e.T @ u))
    return u


def _orthonormal(u: F64) -> F64:
    """The columns of `u` `[m, R]` by Gram and Schmidt, twice; columns that depend on earlier ones become zero."""
    q = np.zeros_like(u)
    for r in range(u.shape[1]):
        column = u[:, r]
        for _ in range(2):
            column = column - q @ (q.T @ column)
        length = np.linalg.norm(column)
        if length > DEPENDENT * np.linalg.norm(u[:, r]):
            q[:, r] = column / length
    return q


def _reconstruct(cell: Cell) -> F64:
    """`Z x_1 U_1 .. x_N U_N`, member rows only `[m_1, .., m_N]`."""
    x = cell.core
    for n, u in enumerate(cell.bases):
        x = x if u is None else np.moveaxis(np.tensordot(u, x, (1, n)), 0, n)
    return x


def _project(x: F64, bases: Sequence[F64 | None]) -> F64:
    """`x x_1 U_1^T .. x_N U_N^T`; modes without a basis stay as they are."""
    for n, u in enumerate(bases):
        x = x if u is None else np.moveaxis(np.tensordot(u, x, (0, n)), 0, n)
    return x


def _unfold(x: F64, n: int) -> F64:
    """The mode-n unfolding `[I_n, rest]`, rest in C order."""
    return np.moveaxis(x, n, 0).reshape(x.shape[n], -1)
