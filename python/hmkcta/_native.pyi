"""The Rust kernels; `backends/reference.py` says what each computes. All arrays are flat and contiguous."""

import numpy as np
from numpy.typing import NDArray

_F32 = NDArray[np.float32]
_Members = list[NDArray[np.uint16]]
# sizes, clusters, mixture, ranks, undecomposed
_Shape = tuple[list[int], list[int], list[int], list[int], list[bool]]

def fit_cells(
    shape: _Shape, members: _Members, residual: _F32, bases: list[_F32], cores: _F32, sweeps: int, iterations: int
) -> None: ...
def accumulate(
    shape: _Shape, members: _Members, tensor: _F32, bases: list[_F32], cores: _F32, weight: float
) -> None: ...
def project_cells(shape: _Shape, members: _Members, tensor: _F32, bases: list[_F32], mode: int) -> _F32: ...
def dictionary_gram(
    shape: _Shape, members: _Members, bases: list[_F32], cores: _F32, mode: int
) -> NDArray[np.float64]: ...
def set_threads(count: int) -> None: ...
