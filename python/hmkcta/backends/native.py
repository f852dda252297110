"""The Rust kernels (`crates/hmkcta-kernels`) behind the signatures of `reference.py`, which says what each computes.

Arrays are worked on in place and without the interpreter lock, so nodes may be fitted in threads. Large nodes are
themselves worked on by several threads; results do not depend on how many.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32, F64
from ..cells import Cells, Products, check_shape
from ..errors import invalid
from ..support.extension import native
from . import reference
from .coding import U16
from .kmeans import Labels, most_rows
from .reference import Rows

Shape = tuple[list[int], list[int], list[int], list[int], list[bool]]

name = "native"

#: What numbers of so many bytes are copied as.
_NUMBERS = {1: np.uint8, 2: np.uint16, 4: np.uint32, 8: np.uint64}


def set_threads(count: int) -> None:
    """How many threads work on large nodes from now on; 0: all cores."""
    if count < 0:
        raise invalid("threads-negative", "threads", count, "0 (all cores) or more")
    native.set_threads(count)


def fit_cells(cells: Cells, residual: F32, sweeps: int, iterations: int) -> None:
    """Gauss-Seidel sweeps of HOOI over the cells, in place."""
    check_shape(residual, cells)
    target = _in_place(residual)
    # What is fitted must be arrays of its own that the kernel may write to.
    cells.bases = [np.require(basis, np.float32, ["C", "W"]) for basis in cells.bases]
    cells.cores = np.require(cells.cores, np.float32, ["C", "W"])
    native.fit_cells(*_node(cells), target, _bases(cells), cells.cores.reshape(-1), sweeps, iterations)


def accumulate(cells: Cells, tensor: F32, weight: float) -> None:
    """`tensor += weight * model`, in place."""
    check_shape(tensor, cells)
    native.accumulate(*_node(cells), _in_place(tensor), _bases(cells), _flat(cells.cores), weight)


def project_cells(cells: Cells, tensor: F32, n: int) -> F32:
    """`Y_n[c] = T x_{m != n} U_{m,c}^T`: `[PC, I_n, prod_{m != n} R_m]`."""
    check_shape(tensor, cells)
    y = native.project_cells(*_node(cells), _flat(tensor), _bases(cells), n)
    return y.reshape(cells.spec.cells, cells.sizes[n], -1)


def project_pair(cells: Cells, tensor: F32, pair: tuple[int, int]) -> F32:
    """The tensor projected on the bases of all cells in two modes: `[.., I_m, .., C_a, C_b, R_a, .., C_m, .., R_b]`."""
    check_shape(tensor, cells)
    a, b = pair
    kept = [m for m in range(cells.order) if m not in pair]
    clusters, ranks = cells.spec.clusters, cells.ranks
    rows, lanes = [cells.sizes[m] for m in kept], [clusters[m] for m in kept]
    p = native.project_pair(*_node(cells), _flat(tensor), _bases(cells), pair)
    return p.reshape([*rows, clusters[a], clusters[b], ranks[a], *lanes, ranks[b]])


def contract_lanes(p: F32, w: F32) -> F32:
    """`Y[i, k, r, l] = sum_j P[i, j, k, l] W[j, r, l]`."""
    before, size, after, lanes = p.shape
    rank = w.shape[1]
    if w.shape != (size, rank, lanes):
        raise invalid("wrong-shape", "w", w.shape, f"({size}, R, {lanes})")
    y = native.contract_lanes(_flat(p), _flat(w), (before, size, after), rank, lanes)
    return y.reshape(before, after, rank, lanes)


def collect(
    array: NDArray[Any], modes: Sequence[Sequence[int]], rows: Rows, out: NDArray[Any], factor: float | None = None
) -> None:
    """The sub-tensor of some rows of each mode of an array in any layout, into `out`; see `reference.collect`."""
    size, scaled = array.itemsize, factor is not None and array.dtype == np.float32 and array.dtype.isnative
    ready = array.flags.aligned and out.flags.c_contiguous and all(stride % size == 0 for stride in array.strides)
    if size not in _NUMBERS or not ready or (factor is not None and not scaled):
        reference.collect(array, modes, rows, out, factor)
        return
    offsets = [_offsets(array, mode, chosen) for mode, chosen in zip(modes, rows, strict=True)]
    both = np.asarray(array), out.reshape(-1)
    if factor is not None:
        native.collect_scaled(both, offsets, factor)
    else:
        native.collect((both[0].view(_NUMBERS[size]), both[1].view(_NUMBERS[size])), offsets)


def _offsets(array: NDArray[Any], mode: Sequence[int], rows: NDArray[np.intp]) -> NDArray[np.int64]:
    """Where the rows of a mode lie, in elements."""
    indices = np.unravel_index(rows, [array.shape[axis] for axis in mode])
    strides = [array.strides[axis] // array.itemsize for axis in mode]
    found = sum((at * stride for at, stride in zip(indices, strides, strict=True)), np.zeros(len(rows), np.intp))
    return np.ascontiguousarray(found, np.int64)


def magnitudes(values: F32) -> tuple[float, float, float]:
    """The sum of squares, the largest magnitude, and the smallest but zero."""
    return native.magnitudes(_flat(np.require(values, requirements="A")))


def gather(tensor: F32, rows: Rows) -> F32:
    """The sub-tensor of some rows of each mode, ascending, in one piece."""
    if not tensor.flags.c_contiguous:
        return reference.gather(tensor, rows)
    block = native.gather(tensor.reshape(-1), list(tensor.shape), _rows(rows))
    return block.reshape([len(r) for r in rows])


def scatter(tensor: F32, rows: Rows, block: F32) -> None:
    """Put a sub-tensor back, in place."""
    native.scatter(_in_place(tensor), list(tensor.shape), _rows(rows), _flat(block))


def dense_basis(cells: Cells, n: int) -> F32:
    """`U_n` of all cells with its zero rows written out: `[PC, I_n, R_n]`."""
    found = native.dense_basis(*_node(cells), n, _flat(cells.bases[n]))
    return found.reshape(cells.spec.cells, cells.sizes[n], cells.ranks[n])


def dictionary_gram(cells: Cells, products: Sequence[Products | None], n: int) -> F64:
    """`H_n = D_n^T D_n` of the dictionaries of all cells: `[PC R_n, PC R_n]`."""
    if cells.spec.cells == 1:  # a product of matrices, of which lanes for eight cells need not be made
        return reference.dictionary_gram(cells, products, n)
    side = cells.spec.cells * cells.ranks[n]
    return native.dictionary_gram(cells.ranks, _products(products), _flat(cells.cores), n).reshape(side, side)


def solve_cores(cells: Cells, products: Sequence[Products | None], b: F64, steps: int) -> None:
    """Cores of all cells that leave less of a tensor together, the bases given, in place."""
    cells.cores = np.require(cells.cores, np.float32, ["C", "W"])
    native.solve_cores(cells.ranks, _products(products), cells.cores.reshape(-1), _doubles(b), steps)


def orthonormalise(cells: Cells, n: int) -> None:
    """Orthonormal bases of mode n for all cells, in place, with cores that keep the model."""
    cells.bases[n], cells.cores = (np.require(array, np.float32, ["C", "W"]) for array in (cells.bases[n], cells.cores))
    native.orthonormalise(*_node(cells), n, cells.bases[n].reshape(-1), cells.cores.reshape(-1))


def code_rows(
    h: F64, b: F64, clusters: Sequence[int], n: int, kept: U16 | None, mixture: int, search: str
) -> tuple[U16, F32]:
    """The best cluster subsets of a mode's rows `[I_n, K_n]` and their coefficients `[I_n, K_n, PC_-n R_n]`."""
    rank, size = b.shape[1:]
    own = None if kept is None else np.ascontiguousarray(kept, np.uint16).reshape(-1)
    subsets, x = native.code_rows(_doubles(h), _doubles(b), list(clusters), n, rank, own, mixture, search)
    return subsets.reshape(size, mixture), x.reshape(size, mixture, -1)


def nearest_with_room(distance: F64, cap: float | None) -> Labels:
    """The nearest of C centres for I rows `[I, C]`, none for more than cap I/C (None: any); widest margins first."""
    rows, clusters = distance.shape
    return native.nearest_with_room(_doubles(distance), clusters, most_rows(rows, clusters, cap))


def cluster_rows(features: F64, centres: F64, cap: float | None, rounds: int) -> tuple[Labels, float]:
    """Labels of rows `[I, F]` by k-means from the given centres `[C, F]`, and what squared distances sum up to."""
    size, width = features.shape
    if centres.shape[1:] != (width,):
        raise invalid("wrong-shape", "centres", centres.shape, f"(C, {width})")
    most = most_rows(size, len(centres), cap)
    return native.cluster_rows(_doubles(features), _doubles(centres), width, most, rounds)


def _node(cells: Cells) -> tuple[Shape, list[NDArray[np.uint16]]]:
    spec = cells.spec
    shape = (list(cells.sizes), list(spec.clusters), list(spec.mixture), list(cells.ranks), list(cells.undecomposed))
    return shape, [np.ascontiguousarray(members, np.uint16).reshape(-1) for members in cells.members]


def _rows(rows: Rows) -> list[NDArray[np.uint32]]:
    return [np.ascontiguousarray(r, np.uint32) for r in rows]


def _bases(cells: Cells) -> list[F32]:
    nothing = (np.zeros(0, np.float32) for _ in cells.bases)
    return [none if skip else _flat(b) for b, skip, none in zip(cells.bases, cells.undecomposed, nothing, strict=True)]


def _products(products: Sequence[Products | None]) -> list[F64]:
    return [np.zeros(0) if m is None else _doubles(m) for m in products]


def _flat(array: F32) -> F32:
    return np.ascontiguousarray(array, np.float32).reshape(-1)


def _doubles(array: F64) -> F64:
    return np.ascontiguousarray(array, np.float64).reshape(-1)


def _in_place(array: F32) -> F32:
    """The array as one row of numbers that the kernel may write to, never a copy."""
    if array.dtype != np.float32 or not (array.flags.c_contiguous and array.flags.writeable):
        found = f"{array.dtype}, strides {array.strides}, writeable: {array.flags.writeable}"
        raise invalid("not-in-place", "tensor", found, "writeable float32 in C order")
    return array.reshape(-1)
