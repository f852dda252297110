"""The Rust kernels; `backends/reference.py` says what each computes. All arrays are flat and contiguous."""

from typing import Any

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
def project_pair(shape: _Shape, members: _Members, tensor: _F32, bases: list[_F32], pair: tuple[int, int]) -> _F32: ...
def contract_lanes(p: _F32, w: _F32, sizes: tuple[int, int, int], rank: int, lanes: int) -> _F32: ...
def gather(tensor: _F32, sizes: list[int], rows: list[NDArray[np.uint32]]) -> _F32: ...
def scatter(tensor: _F32, sizes: list[int], rows: list[NDArray[np.uint32]], block: _F32) -> None: ...
def dictionary_gram(
    shape: _Shape, members: _Members, bases: list[_F32], cores: _F32, mode: int
) -> NDArray[np.float64]: ...
def solve_cores(
    shape: _Shape, members: _Members, bases: list[_F32], cores: _F32, b: NDArray[np.float64], steps: int
) -> None: ...
def code_rows(
    h: NDArray[np.float64],
    b: NDArray[np.float64],
    clusters: list[int],
    mode: int,
    rank: int,
    kept: NDArray[np.uint16] | None,
    mixture: int,
    search: str,
) -> tuple[NDArray[np.uint16], _F32]: ...

# The arrays of one level by their names in `packed.PackedLevel`, float16 as its bits.
_Level = dict[str, Any]
_I64 = NDArray[np.int64]

def decode_scattered_f32(levels: list[_Level], coords: _I64, out: _F32) -> None: ...
def decode_scattered_f64(levels: list[_Level], coords: _I64, out: NDArray[np.float64]) -> None: ...
def decode_block(levels: list[_Level], rows: list[_I64], first: int, out: _F32) -> None: ...
def set_threads(count: int) -> None: ...
