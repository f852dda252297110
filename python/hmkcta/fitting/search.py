"""Of one mode, with the cores and all other bases given, the best cluster subsets of every row and its rows of the
bases, by coding in the dictionary that these make; and the best cores of all cells, with all bases given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from .. import backends as kernels
from ..arrays import F32, F64
from ..cells import Cells, Products
from .projection import passes, project

#: omega of sweeps that others follow: a third of the sweeps for the same error.
OVER_RELAXED = 1.75
#: Steps of conjugate gradients for the cores.
CORE_STEPS = 2
#: Projections turned into float64 at a time.
WIDENED = 1 << 18


def sweep(
    cells: Cells, tensor: F32, mixture: Sequence[int], search: str, omegas: Sequence[float] = (1.0,)
) -> None:
    """`choose_rows` for one mode after another, their columns orthonormal again, then cores; once for each of `omegas`.

    The error never rises.
    """
    products = all_products(cells) if omegas else []
    last = passes(cells)[-1][-1]
    for omega, kept in product(omegas, passes(cells)):
        seen = project(cells, tensor, kept)
        for n in kept:
            y = seen.onto(cells, n)
            choose_rows(cells, products, right_sides(cells, y, n), n, mixture[n], search, omega)
            kernels.orthonormalise(cells, n)
            products[n] = _inner_products(cells, n)
            if n == last:
                refit_cores(cells, products, y, n)


def all_products(cells: Cells) -> list[Products | None]:
    """Inner products `M_m(c, c') = U_{m,c}^T U_{m,c'}` of every mode; None where it is undecomposed."""
    return [None if skip else _inner_products(cells, m) for m, skip in enumerate(cells.undecomposed)]


def _dense(cells: Cells, m: int) -> F64:
    """U_m of all cells, `[PC, I_m, R_m]`."""
    return kernels.dense_basis(cells, m).astype(np.float64)


def _inner_products(cells: Cells, m: int) -> Products:
    columns = kernels.dense_basis(cells, m).transpose(1, 2, 0).astype(np.float64, order="C")  # [I_m, R_m, PC]
    columns = columns.reshape(cells.sizes[m], -1)
    return (columns.T @ columns).reshape(2 * (cells.ranks[m], cells.spec.cells))


def choose_rows(
    cells: Cells,
    products: Sequence[Products | None],
    b: F64,
    n: int,
    mixture: int,
    search: str,
    omega: float = 1.0,
) -> None:
    """New subsets (of `mixture` clusters) and basis rows of mode n, jointly optimal given all else.

    `products` are those of the other modes, b `[PC, R_n, I_n]` the `right_sides` of this one; `search` is ``optimal``,
    ``greedy`` or ``fixed`` (keep the subsets). The rows are not orthonormal afterwards.

    Rows that keep their subset go `omega` times as far as the best ones lie (successive over-relaxation): as the error
    is quadratic in them, it is no larger than before up to omega = 2, and the sweeps that follow get further.
    """
    spec, size, before = cells.spec, cells.sizes[n], cells.bases[n]
    kept = cells.members[n] if search == "fixed" or cells.members[n].shape[1] == mixture else None
    h = kernels.dictionary_gram(cells, products, n)
    cells.members[n], x = kernels.code_rows(h, b, spec.clusters, n, kept, mixture, search)
    cells.bases[n] = x.reshape(size, mixture, spec.cells // spec.clusters[n], cells.ranks[n])
    if mixture != spec.mixture[n]:
        cells.spec = replace(spec, mixture=(*spec.mixture[:n], mixture, *spec.mixture[n + 1 :]))
    if omega != 1 and kept is not None:
        same = (kept == cells.members[n]).all(axis=1)
        cells.bases[n][same] += np.float32(omega - 1) * (cells.bases[n][same] - before[same])


def right_sides(cells: Cells, y: NDArray[np.floating], n: int) -> F64:
    """b of mode n `[PC, R_n, I_n]` from the projections `y` `[PC, I_n, prod_{m != n} R_m]`."""
    cores = np.moveaxis(cells.cores, n + 1, 1).reshape(cells.spec.cells, cells.ranks[n], -1)
    wide, rows = cores.astype(np.float64), max(1, WIDENED * y.shape[1] // max(1, y.size))
    b = np.empty((*wide.shape[:2], y.shape[1]))
    for start in range(0, y.shape[1], rows):  # projections on an undecomposed mode are as large as the tensor
        b[:, :, start : start + rows] = wide @ y[:, start : start + rows].transpose(0, 2, 1)
    return b


def refit_cores(cells: Cells, products: Sequence[Products | None], y: NDArray[np.floating], n: int) -> None:
    """Cores of all cells by joint least squares, the bases given, from the projections `y` of mode n.

    New rows change a core by one matrix a mode; this finds what else would help.
    """
    b = np.matmul(_dense(cells, n).transpose(0, 2, 1), y)
    others = [rank for m, rank in enumerate(cells.ranks) if m != n]
    kernels.solve_cores(cells, products, np.moveaxis(b.reshape(*b.shape[:2], *others), 1, n + 1), CORE_STEPS)


def project_model(cells: Cells, other: Cells, n: int) -> F64:
    """What `project_cells` makes of the other cells' reconstruction, from their bases and cores alone.

    `Y_n[c] = sum_d Z_d x_{m != n} (U_{m,c}^T U_{m,d}) x_n U_{n,d}`, `[PC, I_n, prod_{m != n} R_m]`; nothing the size of
    the tensor is touched.
    """
    decomposed = [m for m in range(cells.order) if not cells.undecomposed[m]]
    modes = [m for m in decomposed if m != n]
    theirs = {m: _dense(other, m).transpose(0, 2, 1) for m in decomposed}  # [PD, R_m, I_m]
    ours = {m: _dense(cells, m) for m in modes}  # [PC, I_m, R_m]
    y: list[F64] = []
    for c in range(cells.spec.cells):
        x: F64 = other.cores.astype(np.float64)
        for m in modes:
            gram = theirs[m] @ ours[m][c]  # [PD, R_m of d, R_m of c]
            x = np.moveaxis(x, m + 1, -1)
            shape = (*x.shape[:-1], gram.shape[2])
            x = np.moveaxis((x.reshape(len(gram), -1, gram.shape[1]) @ gram).reshape(shape), -1, m + 1)
        x = np.moveaxis(x, n + 1, 1)  # [PD, R_n, ..]
        if n in theirs:
            expand = theirs[n].transpose(2, 0, 1).reshape(cells.sizes[n], -1)  # [I_n, PD R_n]
            y.append(expand @ x.reshape(expand.shape[1], -1))
        else:
            y.append(x.sum(axis=0).reshape(cells.sizes[n], -1))
    return np.array(y)
