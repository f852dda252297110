"""The few data-sized kernels, where a run wants them: on the CPU or, inside of `use`, on a GPU.

On the CPU they are native (Rust) or their readable NumPy twins; the environment variable ``HMKCTA_BACKEND`` (``native``
or ``reference``) chooses. All compute the same up to rounding.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from ..arrays import F32, F64
from ..cells import Cells, Products
from ..errors import invalid
from . import reference
from .coding import U16
from .device import Device, Kernels
from .kmeans import Labels
from .reference import Rows

__all__ = ["Device", "Kernels", "accumulate", "cluster_rows", "code_rows", "collect", "contract_lanes",
           "dense_basis", "dictionary_gram", "find_device", "fit_cells", "gather", "magnitudes", "name",
           "nearest_with_room", "orthonormalise", "project_cells", "project_pair", "scatter", "set_threads",
           "solve_cores", "threads", "use"]  # fmt: skip

#: Where the kernels of the work at hand run; None: on the CPU.
_device: ContextVar[Kernels | None] = ContextVar("device", default=None)

if TYPE_CHECKING:
    #: The CPU's backend: ``native`` or ``reference``.
    name: str


def __getattr__(attribute: str) -> object:
    """`name` is known when it is first asked for, so that a wrong HMKCTA_BACKEND is an error then, not of an import."""
    if attribute == "name":
        return on_cpu().name
    raise AttributeError(f"module {__name__!r} has no attribute {attribute!r}")


@cache
def on_cpu() -> Kernels:
    """The CPU's kernels.

    Raises:
        HmkctaError: HMKCTA_BACKEND names no backend (``unknown-backend``).

    >>> on_cpu().name in ("native", "reference")
    True
    """
    wanted = os.environ.get("HMKCTA_BACKEND", "")
    if wanted not in ("", "native", "reference"):
        raise invalid("unknown-backend", "HMKCTA_BACKEND", repr(wanted), "native or reference", "correct or unset it")
    if wanted == "reference":
        return reference
    from . import native

    return native


def find_device(wanted: str) -> Device:
    """The device of that name, or the CPU with a sentence on what is missing.

    Raises:
        HmkctaError: the name is none of ``cpu`` and ``cuda``.

    >>> find_device("cpu").described
    'cpu'
    """
    if wanted not in ("cpu", "cuda"):
        raise invalid("unknown-device", "device", repr(wanted), "cpu or cuda")
    if wanted == "cpu":
        return Device()
    from .cuda import found  # which alone looks for CuPy

    return found()


@contextmanager
def use(device: Device) -> Generator[None]:
    """Kernels called inside, and in the threads of `executors.Pool` begun inside, work on the device.

    >>> with use(find_device("cpu")):
    ...     pass
    """
    gpu = None
    if device.name == "cuda":
        from .cuda import Cuda

        gpu = Cuda(device, on_cpu())
    before = _device.set(gpu)
    try:
        yield
    finally:
        _device.reset(before)
        if gpu is not None:
            gpu.free()


def _kernels() -> Kernels:
    return _device.get() or on_cpu()


def fit_cells(cells: Cells, residual: F32, sweeps: int, iterations: int) -> None:
    """Gauss-Seidel sweeps of HOOI over the cells; they and the `residual` that they leave change in place.

    See `reference.fit_cells`.
    """
    _kernels().fit_cells(cells, residual, sweeps, iterations)


def accumulate(cells: Cells, tensor: F32, weight: float) -> None:
    """`tensor += weight * model`, in place; the model is equation 2 of the paper, of the node's shape.

    >>> import numpy as np
    >>> from hmkcta.cells import zero_cells
    >>> from hmkcta.plan import LevelSpec
    >>> tensor = np.ones((2, 3), np.float32)
    >>> accumulate(zero_cells((2, 3), LevelSpec((1, 1), (1, 1), (1, 1))), tensor, 1.0)
    >>> tensor.tolist()
    [[1.0, 1.0, 1.0], [1.0, 1.0, 1.0]]
    """
    _kernels().accumulate(cells, tensor, weight)


def project_cells(cells: Cells, tensor: F32, n: int) -> F32:
    """`Y_n[c] = T x_{m != n} U_{m,c}^T`, `[PC, I_n, prod_{m != n} R_m]`; see `reference.project_cells`."""
    return _kernels().project_cells(cells, tensor, n)


def project_pair(cells: Cells, tensor: F32, pair: tuple[int, int]) -> F32:
    """The tensor projected on the bases of all cells in two modes; see `reference.project_pair`."""
    return _kernels().project_pair(cells, tensor, pair)


def contract_lanes(p: F32, w: F32) -> F32:
    """A further mode summed over, lane by lane; see `reference.contract_lanes`."""
    return _kernels().contract_lanes(p, w)


def collect(
    array: NDArray[Any], modes: Sequence[Sequence[int]], rows: Rows, out: NDArray[Any], factor: float | None = None
) -> None:
    """The sub-tensor of some rows of each mode of an array in any layout, into `out`; see `reference.collect`."""
    _kernels().collect(array, modes, rows, out, factor)


def magnitudes(values: F32) -> tuple[float, float, float]:
    """The sum of squares, the largest magnitude, and the smallest but zero; see `reference.magnitudes`.

    >>> import numpy as np
    >>> magnitudes(np.array([0, -3, 0.5], np.float32))
    (9.25, 3.0, 0.5)
    """
    return _kernels().magnitudes(values)


def gather(tensor: F32, rows: Rows) -> F32:
    """The sub-tensor of some rows of each mode, ascending, in one piece.

    >>> import numpy as np
    >>> gather(np.arange(6, dtype=np.float32).reshape(2, 3), [np.array([1]), np.array([0, 2])]).tolist()
    [[3.0, 5.0]]
    """
    return _kernels().gather(tensor, rows)


def scatter(tensor: F32, rows: Rows, block: F32) -> None:
    """Put a sub-tensor back, in place; several threads may, where no two write to the same elements."""
    _kernels().scatter(tensor, rows, block)


def dense_basis(cells: Cells, n: int) -> F32:
    """`U_n` of all cells with its zero rows written out; see `cells.dense_basis`."""
    return _kernels().dense_basis(cells, n)


def dictionary_gram(cells: Cells, products: Sequence[Products | None], n: int) -> F64:
    """H_n: inner products of all dictionary columns of mode n, `[PC R_n, PC R_n]`; see `reference.dictionary_gram`."""
    return _kernels().dictionary_gram(cells, products, n)


def solve_cores(cells: Cells, products: Sequence[Products | None], b: F64, steps: int) -> None:
    """Cores of all cells that leave less of a tensor together, in place; see `reference.solve_cores`."""
    _kernels().solve_cores(cells, products, b, steps)


def orthonormalise(cells: Cells, n: int) -> None:
    """Orthonormal bases of mode n for all cells, in place, with cores that keep the model."""
    _kernels().orthonormalise(cells, n)


def code_rows(
    h: F64, b: F64, clusters: Sequence[int], n: int, kept: U16 | None, mixture: int, search: str
) -> tuple[U16, F32]:
    """The best K_n cluster subsets of each row of mode n, and its rows of the bases; see `coding.code_rows`."""
    return _kernels().code_rows(h, b, clusters, n, kept, mixture, search)


def nearest_with_room(distance: F64, cap: float | None) -> Labels:
    """The nearest of some centres for each row, none for too many; see `kmeans.nearest_with_room`."""
    return _kernels().nearest_with_room(distance, cap)


def cluster_rows(features: F64, centres: F64, cap: float | None, rounds: int) -> tuple[Labels, float]:
    """Labels of rows by k-means from the given centres, and what is left; see `kmeans.cluster_rows`."""
    return _kernels().cluster_rows(features, centres, cap, rounds)


def set_threads(count: int) -> None:
    """How many threads of the CPU work on large nodes from now on; 0: all cores."""
    on_cpu().set_threads(count)


@contextmanager
def threads(count: int, after: int = 0) -> Generator[None]:
    """So many threads of the CPU work on large nodes inside, and `after` (0: all cores) from then on.

    >>> with threads(1):
    ...     pass
    """
    set_threads(count)
    try:
        yield
    finally:
        set_threads(after)
