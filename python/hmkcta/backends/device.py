"""What a device is to the rest: a name, and the kernels that every backend has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from ..arrays import F32, F64
from ..cells import Cells, Products
from .coding import U16
from .kmeans import Labels
from .reference import Rows


class Kernels(Protocol):
    """A backend: `reference.py` says what each of its kernels computes."""

    @property
    def name(self) -> str:
        """The backend's."""
        ...

    def fit_cells(self, cells: Cells, residual: F32, sweeps: int, iterations: int) -> None:
        """Gauss-Seidel sweeps of HOOI over the cells, in place."""
        ...

    def accumulate(self, cells: Cells, tensor: F32, weight: float) -> None:
        """`tensor += weight * model`, in place."""
        ...

    def project_cells(self, cells: Cells, tensor: F32, n: int) -> F32:
        """The tensor projected on the cells' bases of all modes but n."""
        ...

    def project_pair(self, cells: Cells, tensor: F32, pair: tuple[int, int]) -> F32:
        """The tensor projected on the bases of all cells in two modes."""
        ...

    def contract_lanes(self, p: F32, w: F32) -> F32:
        """A further mode summed over, lane by lane."""
        ...

    def collect(
        self, array: NDArray[Any], modes: Sequence[Sequence[int]], rows: Rows, out: NDArray[Any],
        factor: float | None = None,
    ) -> None:
        """The sub-tensor of some rows of each mode of an array in any layout, into `out`."""
        ...

    def magnitudes(self, values: F32) -> tuple[float, float, float]:
        """The sum of squares, the largest magnitude, and the smallest but zero."""
        ...

    def gather(self, tensor: F32, rows: Rows) -> F32:
        """The sub-tensor of some rows of each mode, ascending."""
        ...

    def scatter(self, tensor: F32, rows: Rows, block: F32) -> None:
        """Put a sub-tensor back, in place."""
        ...

    def dense_basis(self, cells: Cells, n: int) -> F32:
        """U_n of all cells with its zero rows written out."""
        ...

    def dictionary_gram(self, cells: Cells, products: Sequence[Products | None], n: int) -> F64:
        """Inner products of all dictionary columns of mode n."""
        ...

    def solve_cores(self, cells: Cells, products: Sequence[Products | None], b: F64, steps: int) -> None:
        """Cores of all cells that leave less together, in place."""
        ...

    def orthonormalise(self, cells: Cells, n: int) -> None:
        """Orthonormal bases of mode n for all cells, in place, with cores that keep the model."""
        ...

    def code_rows(
        self, h: F64, b: F64, clusters: Sequence[int], n: int, kept: U16 | None, mixture: int, search: str
    ) -> tuple[U16, F32]:
        """The best cluster subsets of a mode's rows and their coefficients, from H and b."""
        ...

    def nearest_with_room(self, distance: F64, cap: float | None) -> Labels:
        """The nearest of some centres for each row, none for too many."""
        ...

    def cluster_rows(self, features: F64, centres: F64, cap: float | None, rounds: int) -> tuple[Labels, float]:
        """Labels of rows by k-means from the given centres, and what squared distances sum up to."""
        ...

    def set_threads(self, count: int) -> None:
        """How many threads of the CPU work on large nodes."""
        ...


@dataclass(eq=False)
class Device:
    """Where the kernels of a run work, and how often they did.

    Attributes:
        name: ``cpu`` or ``cuda``.
        described: the name and, for a GPU, all that its rounding depends on.
        missing: why it is the CPU although another was asked for; else empty.
        calls: kernel calls on the GPU so far.
        calls_on_cpu: calls that were too small for the GPU.
    """

    name: str = "cpu"
    described: str = "cpu"
    missing: str = ""
    calls: int = 0
    calls_on_cpu: int = 0

    @property
    def fallback(self) -> str:
        """The sentence to say when the CPU takes over; empty if it does not."""
        return f"{self.missing}; the CPU is used instead." if self.missing else ""
