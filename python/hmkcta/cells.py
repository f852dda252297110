"""The cells of one node at one level while it is being fitted: memberships, bases and cores in float32.

A cell is a cluster c = (c_1..c_N) of the paper's equation 2. The layout is the file's (`docs/format.md`, section 4), so
that packing only rounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import prod

import numpy as np
from numpy.typing import NDArray

from .arrays import F32
from .errors import invalid
from .plan import LevelSpec

#: Inner products of the bases of all pairs of cells: `[R_m, PC, R_m, PC]`.
Products = NDArray[np.float64]
U16 = NDArray[np.uint16]


@dataclass(eq=False)
class Cells:
    """Memberships, bases and cores of one node.

    Attributes:
        sizes: the node's mode sizes.
        spec: R, C, K, clamped to the node.
        members: for each mode `[I_n, K_n]`, the distinct cluster subsets S_n(i) of each row, ascending.
        bases: for each mode `[I_n, K_n, PC_-n, R_n]`; empty for an undecomposed mode.
        cores: `[PC, R_1, .., R_N]`.
    """

    sizes: tuple[int, ...]
    spec: LevelSpec
    members: list[U16]
    bases: list[F32]
    cores: F32

    @property
    def order(self) -> int:
        """N, the number of modes."""
        return len(self.sizes)

    @property
    def ranks(self) -> tuple[int, ...]:
        """R_n, an undecomposed mode's being its size."""
        return _whole_ranks(self.spec.ranks, self.sizes)

    @property
    def undecomposed(self) -> tuple[bool, ...]:
        """Which modes keep their identity basis."""
        return tuple(r is None for r in self.spec.ranks)

    def part(self, rows: Sequence[NDArray[np.intp]]) -> Cells:
        """The model of an outer product of rows of the node."""
        cores = self.cores
        for n, (chosen, skip) in enumerate(zip(rows, self.undecomposed, strict=True)):
            if skip and len(chosen) < self.sizes[n]:
                cores = cores.take(chosen, axis=n + 1)
        members = [own[chosen] for own, chosen in zip(self.members, rows, strict=True)]
        stored = zip(self.bases, rows, self.undecomposed, strict=True)
        bases = [own if skip else own[chosen] for own, chosen, skip in stored]
        return Cells(tuple(map(len, rows)), self.spec, members, bases, cores)

    def copy(self) -> Cells:
        """Cells that may be changed in place."""
        bases = [basis.copy() for basis in self.bases]
        return Cells(self.sizes, self.spec, list(self.members), bases, self.cores.copy())

    def rounded(self) -> Cells:
        """The cells as they are stored: float16 numbers, cores with a float32 factor a cell."""
        stored, scale = round_cores(self.cores)
        wide = stored.astype(np.float32) * scale.reshape(-1, *[1] * len(self.sizes))
        bases = [basis.astype(np.float16, order="C").astype(np.float32) for basis in self.bases]
        return Cells(self.sizes, self.spec, self.members, bases, wide)


def check_shape(tensor: F32, cells: Cells) -> None:
    """Refuse a tensor that is not of the node's sizes.

    Raises:
        HmkctaError: it is not (``wrong-shape``).
    """
    if tensor.shape != cells.sizes:
        raise invalid("wrong-shape", "tensor", tensor.shape, str(cells.sizes))


def round_cores(cores: F32) -> tuple[NDArray[np.float16], F32]:
    """Cores `[PC, ..]` as float16 with the largest number of each near 1, and the float32 factors `[PC]`.

    >>> stored, scale = round_cores(np.array([[3e6, 1e6], [0, 0]], np.float32))
    >>> [float(x) for x in scale], [float(x) for x in stored[1]]
    ([2097152.0, 1.0], [0.0, 0.0])
    """
    peak = np.abs(cores).reshape(len(cores), -1).max(axis=1, initial=0.0)
    # A power of two, so that scaling rounds nothing.
    scale = np.exp2(np.floor(np.log2(np.where(peak > 0, peak, 1.0)))).astype(np.float32)
    return (cores / scale.reshape(-1, *[1] * (cores.ndim - 1))).astype(np.float16), scale


def empty_cells(sizes: Sequence[int], spec: LevelSpec, members: Sequence[U16], rng: np.random.Generator) -> Cells:
    """Cells with zero cores and random bases: where subspace iteration starts from."""
    cells = zero_cells(sizes, spec)
    cells.members = list(members)
    cells.bases = [rng.standard_normal(basis.shape, np.float32) for basis in cells.bases]
    return cells


def zero_cells(sizes: Sequence[int], spec: LevelSpec) -> Cells:
    """Cells of the right shapes with nothing in them."""
    spec = spec.clamped(sizes)
    members = [np.zeros((size, k), np.uint16) for size, k in zip(sizes, spec.mixture, strict=True)]
    ranks = _whole_ranks(spec.ranks, tuple(sizes))
    bases = [
        np.zeros(
            0 if spec.ranks[n] is None else (sizes[n], spec.mixture[n], spec.cells // spec.clusters[n], ranks[n]),
            np.float32,
        )
        for n in range(len(sizes))
    ]
    return Cells(tuple(sizes), spec, members, bases, np.zeros((spec.cells, *ranks), np.float32))


@lru_cache(1 << 10)
def _whole_ranks(ranks: tuple[int | None, ...], sizes: tuple[int, ...]) -> tuple[int, ...]:
    """Asked for at every step of a sweep."""
    return tuple(size if rank is None else rank for rank, size in zip(ranks, sizes, strict=True))


def dense_basis(cells: Cells, n: int) -> F32:
    """U_n of all cells with its zero rows written out: `[PC, I_n, R_n]`."""
    clusters = cells.spec.clusters
    before, after = prod(clusters[:n]), prod(clusters[n + 1 :])
    size, rank = cells.sizes[n], cells.ranks[n]
    stored = cells.bases[n].reshape(size, -1, before, after, rank)
    dense = np.zeros((before, clusters[n], after, size, rank), np.float32)
    for k in range(stored.shape[1]):
        rows = np.arange(size)
        dense[:, cells.members[n][:, k], :, rows] = stored[:, k]
    return dense.reshape(cells.spec.cells, size, rank)
