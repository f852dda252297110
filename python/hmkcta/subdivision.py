"""Which sub-tensor of the next level each row goes to (paper, section 4.2).

The error of row i approximated by its k-th cluster subset alone is |t_i|^2 - 2 x_ik b_ik + x_ik^T H_kk x_ik; the most
significant scheme takes the subset with the least, the least significant the one with the largest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import backends as kernels
from .cells import Cells
from .memberships import uniform_blocks
from .search import code, project_model

F32 = NDArray[np.float32]


def subdivide(cells: Cells, tensor: F32 | None, scheme: str) -> list[NDArray[np.intp]]:
    """For each mode the part `[I_n]` of every row, 0 <= part < C_n.

    Tensor is what the cells were fitted to. None: rows are taken for the best that their subsets allow together, where
    b = H x, which is true of rows that were found jointly and nearly so of the others.
    """
    parts: list[NDArray[np.intp]] = []
    for n, (size, clusters, mixture) in enumerate(
        zip(cells.sizes, cells.spec.clusters, cells.spec.mixture, strict=True)
    ):
        if scheme == "uniform":
            parts.append(uniform_blocks(size, clusters))
        elif mixture == 1:
            parts.append(cells.members[n][:, 0].astype(np.intp))
        else:
            errors = _subset_errors(cells, tensor, n)
            slot = errors.argmin(axis=1) if scheme == "most" else errors.argmax(axis=1)
            parts.append(np.take_along_axis(cells.members[n], slot[:, None], axis=1)[:, 0].astype(np.intp))
    return parts


def _subset_errors(cells: Cells, tensor: F32 | None, n: int) -> NDArray[np.float64]:
    """`[I_n, K_n]`: squared error of each row by each of its subsets alone, less |t_i|^2."""
    y = project_model(cells, cells, n) if tensor is None else kernels.project_cells(cells, tensor, n)
    coding = code(cells, y, n)
    side = coding.q
    x = cells.bases[n].astype(np.float64)  # [I_n, K_n, PC_-n, R_n]
    errors = np.empty(cells.members[n].shape)
    for k in range(cells.spec.clusters[n]):
        at = slice(k * side, (k + 1) * side)
        h_kk, b_k = coding.h[at, at], coding.b[at].T  # b_k: [I_n, PC_-n R_n]
        rows, slots = np.nonzero(cells.members[n] == k)
        x_k = x[rows, slots].reshape(len(rows), side)
        errors[rows, slots] = np.einsum("iq,iq->i", x_k, x_k @ h_kk - 2.0 * b_k[rows])
    return errors
