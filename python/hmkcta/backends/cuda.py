"""The kernels on an NVIDIA GPU: `batched.py` with CuPy's arrays.

A call takes its node to the device, does all its sweeps there and brings back what changed. One call at a time works on
the device, whichever threads ask: more would share its memory and wait for one another's launches anyway, while the
other threads search for memberships and gather nodes on the CPU.

CuPy is imported by `found` and `Cuda` only, so that nobody needs it for anything else.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise
from math import prod
from threading import Lock
from typing import Any, TypeVar

import numpy as np

from ..arrays import F32, F64
from ..cells import Cells, Products, empty_cells
from ..errors import HmkctaError, Kind
from ..plan import LevelSpec
from . import batched, reference
from .batched import Arrays
from .device import Device, Kernels

T = TypeVar("T")

INSTALL = 'pip install "hmkcta[cuda]"'
#: Calls go where they take less time by this estimate: multiply-adds a second of eight cores; bytes a second to the GPU
#: or from it, out of memory that is not pinned; seconds until the operations of a batch of cells have begun in a
#: Gauss-Seidel sweep, and in anything else. Measured on an H100 beside 16 cores.
CORES, LINK, SWEPT, BEGUN = 1.6e11, 8e9, 1e-2, 1e-3
#: Most elements of a batch: at first, and after the device's memory ran out.
BUDGETS = (1 << 25, 1 << 21, 1 << 17)

_turn, _counting = Lock(), Lock()


def found() -> Device:
    """The GPU, or the CPU with what is missing."""
    described, missing = _looked_for()
    if missing:
        return Device(missing=missing)
    return Device("cuda", described)


class Cuda:
    """The kernels on the GPU; too small ones on the CPU.

    Args:
        device: keeps count of the calls.
        cpu: the kernels for small calls.
        always: do every call that can be done on the GPU there, as benchmarks want.
    """

    name = "cuda"

    def __init__(self, device: Device, cpu: Kernels, *, always: bool = False) -> None:
        self._device, self._cpu, self._always, self._cupy = device, cpu, always, _cupy()
        # All other kernels are the CPU's, whatever the size of what they work on.
        self.collect, self.magnitudes, self.gather, self.scatter = cpu.collect, cpu.magnitudes, cpu.gather, cpu.scatter
        self.dense_basis, self.contract_lanes = cpu.dense_basis, cpu.contract_lanes
        self.solve_cores, self.orthonormalise, self.code_rows = cpu.solve_cores, cpu.orthonormalise, cpu.code_rows
        self.nearest_with_room, self.cluster_rows = cpu.nearest_with_room, cpu.cluster_rows
        self.set_threads = cpu.set_threads

    def fit_cells(self, cells: Cells, residual: F32, sweeps: int, iterations: int) -> None:
        """Gauss-Seidel sweeps of HOOI over the cells, in place."""
        # A cell's model is taken back in and away, and each mode projected on what is left of the others.
        work = 5.0 * max(cells.ranks) * _visits(cells) * sweeps
        if self._pays(work, 8 * residual.size, SWEPT * sweeps * _batches(cells)):
            self._run(cells, lambda on: batched.fit_cells(on, cells, residual, sweeps, iterations))
        else:
            self._cpu.fit_cells(cells, residual, sweeps, iterations)

    def accumulate(self, cells: Cells, tensor: F32, weight: float) -> None:
        """`tensor += weight * model`, in place."""
        if self._pays(float(cells.ranks[-1] * _visits(cells)), 8 * tensor.size, BEGUN * _batches(cells)):
            self._run(cells, lambda on: batched.accumulate(on, cells, tensor, weight))
        else:
            self._cpu.accumulate(cells, tensor, weight)

    def project_cells(self, cells: Cells, tensor: F32, n: int) -> F32:
        """The tensor projected on the cells' bases of all modes but n."""
        rows = _visits(cells) * cells.spec.clusters[n] // cells.spec.mixture[n]
        if self._pays(float(rows * cells.ranks[-1]), 4 * tensor.size, BEGUN):
            return self._run(cells, lambda on: batched.project_cells(on, cells, tensor, n))
        return self._cpu.project_cells(cells, tensor, n)

    def project_pair(self, cells: Cells, tensor: F32, pair: tuple[int, int]) -> F32:
        """The tensor projected on the bases of all cells in two modes."""
        kept = [m for m in range(cells.order) if m not in pair]
        each = cells.spec.cells * prod(cells.spec.mixture[m] / cells.spec.clusters[m] for m in pair)
        numbers = cells.spec.cells * prod(cells.sizes[m] for m in kept) * prod(cells.ranks[m] for m in pair)
        if self._pays(tensor.size * each * cells.ranks[pair[1]], 4 * (tensor.size + numbers), BEGUN):
            return self._run(cells, lambda on: batched.project_pair(on, cells, tensor, pair))
        return self._cpu.project_pair(cells, tensor, pair)

    def dictionary_gram(self, cells: Cells, products: Sequence[Products | None], n: int) -> F64:
        """Inner products of all dictionary columns of mode n."""
        pairs, side = cells.spec.cells**2, cells.spec.cells * cells.ranks[n]
        if self._pays(float(pairs * prod(cells.ranks) * sum(cells.ranks)), 8 * side**2, BEGUN):
            return self._run(cells, lambda on: batched.dictionary_gram(on, cells, products, n))
        return self._cpu.dictionary_gram(cells, products, n)

    def free(self) -> None:
        """Give the device's memory back to it."""
        self._cupy.get_default_memory_pool().free_all_blocks()
        self._cupy.get_default_pinned_memory_pool().free_all_blocks()

    def _pays(self, work: float, moved: int, begun: float) -> bool:
        """Whether the GPU takes less time for `work` multiply-adds and `moved` bytes, `begun` seconds ahead of it."""
        pays = self._always or moved / LINK + begun < work / CORES
        with _counting:
            self._device.calls += pays
            self._device.calls_on_cpu += not pays
        return pays

    def _run(self, cells: Cells, work: Callable[[Arrays], T]) -> T:
        """Do it in batches as large as the device has memory for; what it works on changes only when it succeeds."""
        with _turn:
            for budget in BUDGETS:
                try:
                    return work(arrays(self._cupy, budget))
                except self._cupy.cuda.memory.OutOfMemoryError:
                    pass  # outside of this clause, where the failed call's arrays are gone
                except Exception as error:
                    if not _of_cupy(error):
                        raise
                    raise _failed(error) from error
                self.free()
        raise self._too_large(cells)

    def _too_large(self, cells: Cells) -> HmkctaError:
        free, total = self._cupy.cuda.runtime.memGetInfo()
        shape = " x ".join(map(str, cells.sizes))
        return HmkctaError(
            Kind.RESOURCE_LIMIT, "device-memory", "--device cuda", found=f"a node of {shape} elements",
            allowed=f"what fits into its memory ({free / 2**30:.1f} GiB of {total / 2**30:.1f} GiB are free)",
            hint="use --device cpu, or give --max-memory so that the tensor is streamed")  # fmt: skip


def _visits(cells: Cells) -> int:
    """How many elements all cells have together."""
    return prod(cells.sizes) * prod(cells.spec.mixture)


def _batches(cells: Cells) -> int:
    """About how many batches a sweep has: cells that differ in a mode of K = 1 go together."""
    return prod(c for c, k in zip(cells.spec.clusters, cells.spec.mixture, strict=True) if k > 1)


def arrays(cupy: Any, budget: int) -> Arrays:
    """CuPy's arrays, `budget` elements at once."""
    return Arrays(cupy, cupy.asnumpy, lambda target, values: values.get(out=target), budget)


def _cupy() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about parts that are not used; what is used is tried
        import cupy  # pyright: ignore[reportMissingImports] (optional, and not to be had on every system)
    return cupy  # pyright: ignore[reportUnknownVariableType]


@cache
def _looked_for() -> tuple[str, str]:
    """What the GPU is called with all that its rounding depends on, and what is missing if there is none to work on."""
    try:
        cupy = _cupy()
    except ModuleNotFoundError as error:
        if error.name == "cupy":
            return "", f"--device cuda needs CuPy, which is not installed (next: {INSTALL})"
        return "", f"CuPy is installed but cannot be loaded: {_gist(error)} (next: {INSTALL})"
    except ImportError as error:
        return "", f"CuPy is installed but cannot be loaded: {_gist(error)} (next: {INSTALL})"
    try:
        if not cupy.cuda.runtime.getDeviceCount():
            return "", "CuPy is installed but finds no NVIDIA GPU"
        _try(arrays(cupy, BUDGETS[0]))
        about = cupy.cuda.runtime.getDeviceProperties(0)
        runtime = cupy.cuda.runtime.runtimeGetVersion()
    except Exception as error:
        if not (_of_cupy(error) or isinstance(error, (ImportError, OSError, RuntimeError))):
            raise
        advice = f"next: a driver for CUDA 12 from nvidia.com, and {INSTALL}"
        return "", f"CuPy is installed but there is no NVIDIA GPU that works: {_gist(error)} ({advice})"
    capability = f"compute capability {about['major']}.{about['minor']}"
    versions = f"CuPy {cupy.__version__}, CUDA {runtime // 1000}.{runtime % 1000 // 10}"
    return f"cuda: {about['name'].decode()}, {capability}, {versions}", ""


def _try(on: Arrays) -> None:
    """Fit a small node as the reference does, or fail."""
    rng = np.random.default_rng(0)
    spec = LevelSpec((1, 2, None), (2, 2, 1), (1, 2, 1))
    members = [np.array([[0], [0], [1]], np.uint16), np.tile(np.array([0, 1], np.uint16), (4, 1)),
               np.zeros((5, 1), np.uint16)]  # fmt: skip
    data = rng.standard_normal((3, 4, 5), np.float32)
    fits: list[Callable[[Cells, F32], None]] = [
        lambda cells, residual: reference.fit_cells(cells, residual, 2, 2),
        lambda cells, residual: batched.fit_cells(on, cells, residual, 2, 2),
    ]
    left: list[float] = []
    for fit in fits:
        residual = data.copy()
        fit(empty_cells(data.shape, spec, members, np.random.default_rng(1)), residual)
        left.append(float(np.vdot(residual, residual)))
    if abs(left[0] - left[1]) > 1e-3 * left[0]:
        raise RuntimeError(f"it computes {left[1]:g} where {left[0]:g} is right")


def _of_cupy(error: Exception) -> bool:
    """Whether it is the device, its driver or its libraries that failed, and not this program."""
    return type(error).__module__.partition(".")[0] in ("cupy", "cupy_backends", "cupyx", "cuda")


def _failed(error: Exception) -> HmkctaError:
    return HmkctaError(Kind.RESOURCE_LIMIT, "device-failed", "--device cuda", found=_gist(error),
                       hint="use --device cpu, or try again")  # fmt: skip


def _gist(error: Exception) -> str:
    """The line that says it: of CuPy's banners that after "Original error", else the first."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip(" =")]
    original = [after for before, after in pairwise(lines) if before == "Original error:"]
    return (original or lines or [type(error).__name__])[0].rstrip(".")
