"""The Rust kernels behind NumPy signatures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .. import _native
from ..cells import Cells

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


def _node(cells: Cells) -> tuple[object, list[NDArray[np.uint16]]]:
    shape = (list(cells.sizes), list(cells.spec.clusters), list(cells.spec.mixture), list(cells.ranks), list(cells.undecomposed))
    return shape, [m.reshape(-1) for m in cells.members]


def fit_cells(cells: Cells, residual: F32, sweeps: int, iterations: int) -> None:
    _native.fit_cells(*_node(cells), residual.reshape(-1), [b.reshape(-1) for b in cells.bases], cells.cores.reshape(-1), sweeps, iterations)


def accumulate(cells: Cells, tensor: F32, weight: float) -> None:
    _native.accumulate(*_node(cells), tensor.reshape(-1), [b.reshape(-1) for b in cells.bases], cells.cores.reshape(-1), weight)


def project_cells(cells: Cells, tensor: F32, n: int) -> F32:
    y = _native.project_cells(*_node(cells), tensor.reshape(-1), [b.reshape(-1) for b in cells.bases], n)
    return y.reshape(cells.spec.cells, cells.sizes[n], -1)


def dictionary_gram(cells: Cells, n: int) -> F64:
    h = _native.dictionary_gram(*_node(cells), [b.reshape(-1) for b in cells.bases], cells.cores.reshape(-1), n)
    side = cells.spec.cells * cells.ranks[n]
    return h.reshape(side, side)
