"""Which sub-tensor of the next level each row goes to (paper, section 4.2).

The error of row i approximated by its k-th cluster subset alone is |t_i|^2 - 2 x_ik b_ik + x_ik^T H_kk x_ik; the most
significant scheme takes the subset with the least, the least significant the one with the largest. Modes are judged one
at a time, the others keeping all their subsets, where the paper sums errors over the subdivided tensors of all modes.
Where K_n > 1 no part gets more than `CAP` I_n / C_n rows: rows that share a cluster would all stay together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .. import backends as kernels
from ..arrays import F32
from ..backends.coding import Dictionary
from ..cells import Cells, Products
from ..metrics import squared_norm
from .memberships import uniform_blocks
from .projection import Projection, passes, project
from .search import all_products, project_model, right_sides

#: Rows of a part at most, times I/C.
CAP = 1.25


def subdivide(cells: Cells, tensor: F32 | None, scheme: str) -> list[NDArray[np.intp]]:
    """For each mode the part `[I_n]` of every row, 0 <= part < C_n.

    Tensor is what the cells were fitted to. None: rows are taken for the best that their subsets allow together, where
    b = H x, which is true of rows that were found jointly and nearly so of the others.
    """
    parts: dict[int, NDArray[np.intp]] = {}
    judged = [n for n, mixture in enumerate(cells.spec.mixture) if mixture > 1 and scheme != "uniform"]
    if tensor is not None and cells.spec.search == "fast":  # inner products of so many cells take gigabytes
        return [_parts(cells, _residual_errors(cells, tensor, n) if n in judged else None, n, scheme)
                for n in range(cells.order)]
    products = all_products(cells) if judged else []
    for kept in passes(cells):
        seen = project(cells, tensor, kept) if tensor is not None and any(n in judged for n in kept) else None
        for n in kept:
            errors = _subset_errors(cells, products, seen, n) if n in judged else None
            parts[n] = _parts(cells, errors, n, scheme)
    return [parts.get(n, np.zeros(size, np.intp)) for n, size in enumerate(cells.sizes)]


def _parts(cells: Cells, errors: NDArray[np.float64] | None, n: int, scheme: str) -> NDArray[np.intp]:
    """The part of every row of mode n, by the errors of its subsets where it has several."""
    if scheme == "uniform":
        return uniform_blocks(cells.sizes[n], cells.spec.clusters[n])
    if errors is None:
        return cells.members[n][:, 0].astype(np.intp)
    # A row goes elsewhere only where none of its subsets has room.
    worth = np.full((cells.sizes[n], cells.spec.clusters[n]), np.inf)
    np.put_along_axis(worth, cells.members[n].astype(np.intp), errors if scheme == "most" else -errors, axis=1)
    return kernels.nearest_with_room(worth, CAP)


def _residual_errors(cells: Cells, tensor: F32, n: int) -> NDArray[np.float64]:
    """`[I_n, K_n]`: squared norm of each row in the residual of the tensor less each of its subsets alone."""
    errors = np.empty(cells.members[n].shape)
    spec = replace(cells.spec, mixture=tuple(1 if m == n else k for m, k in enumerate(cells.spec.mixture)))
    for k in range(cells.spec.mixture[n]):
        alone = Cells(cells.sizes, spec, list(cells.members), list(cells.bases), cells.cores)
        alone.members[n], alone.bases[n] = cells.members[n][:, k : k + 1].copy(), cells.bases[n][:, k : k + 1].copy()
        residual = tensor.copy()
        kernels.accumulate(alone, residual, -1.0)
        errors[:, k] = [squared_norm(row) for row in np.moveaxis(residual, n, 0)]
    return errors


def _subset_errors(
    cells: Cells, products: Sequence[Products | None], seen: Projection | None, n: int
) -> NDArray[np.float64]:
    """`[I_n, K_n]`: squared error of each row by each of its subsets alone, less |t_i|^2."""
    y = project_model(cells, cells, n) if seen is None else seen.onto(cells, n)
    h = kernels.dictionary_gram(cells, products, n)
    dictionary = Dictionary.of(h, right_sides(cells, y, n), cells.spec.clusters, n)
    x = cells.bases[n].astype(np.float64)  # [I_n, K_n, PC_-n, R_n]
    errors = np.empty(cells.members[n].shape)
    for k, length in enumerate(dictionary.length):
        h_kk, b_k = dictionary.h[k, :, k], dictionary.b[k].T  # b_k: [I_n, PC_-n R_n]
        rows, slots = np.nonzero(cells.members[n] == k)
        x_k = x[rows, slots].reshape(len(rows), len(length)) * length
        errors[rows, slots] = np.einsum("iq,iq->i", x_k, x_k @ h_kk - 2.0 * b_k[rows])
    return errors
