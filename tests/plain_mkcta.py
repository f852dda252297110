"""MK-CTA written down once more, from equation 2 of the paper alone: dense, slow, in float64, sharing no code.

Block coordinate descent on |A - sum over c of Z_c x_1 U_1,c .. x_N U_N,c|^2, where row i of U_n,c is zero unless c_n is
one of the row's K_n clusters. For every row of a mode all sets of K_n clusters are tried, each by least squares; then
all cores are solved for together.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits  # pyright: ignore[reportMissingTypeStubs] (it has none)

F64 = NDArray[np.float64]


class Plain:
    """A model being fitted: `bases[n]` is `[PC, I_n, R_n]`, zero rows included, and cores are `[PC, R_1, .., R_N]`."""

    def __init__(self, tensor: F64, ranks: list[int], clusters: list[int], mixture: list[int], seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.tensor, self.clusters, self.mixture = tensor, clusters, mixture
        self.cells = list(np.ndindex(*clusters))
        self.cores: F64 = rng.standard_normal((len(self.cells), *ranks))
        self.bases: list[F64] = []
        for n, (size, rank) in enumerate(zip(tensor.shape, ranks, strict=True)):
            sets = np.array([rng.choice(clusters[n], mixture[n], replace=False) for _ in range(size)])
            basis = rng.standard_normal((len(self.cells), size, rank))
            for number, cell in enumerate(self.cells):
                basis[number][(sets != cell[n]).all(axis=1)] = 0
            self.bases.append(basis)

    def columns(self, skipped: int | None = None) -> F64:
        """What every number of the cores multiplies, with mode `skipped` left out: `[PC, I.., R_1, .., R_N]`."""
        order, cells = self.tensor.ndim, len(self.cells)
        rows: F64 = np.ones((cells, *[1] * (2 * order)))
        for n, basis in enumerate(self.bases):
            if n != skipped:
                shape = [cells, *[1] * (2 * order)]
                shape[1 + n], shape[1 + order + n] = basis.shape[1:]
                rows = rows * basis.reshape(shape)
        return rows

    def solve_rows(self, n: int) -> None:
        """The best set of clusters of every row of mode n, and its rows of the bases."""
        order, rank = self.tensor.ndim, self.cores.shape[n + 1]
        weighted = self.columns(n) * self.cores.reshape(len(self.cells), *[1] * order, *self.cores.shape[1:])
        others = tuple(1 + order + m for m in range(order) if m != n)
        dictionary = weighted.sum(axis=others).reshape(len(self.cells), -1, rank)  # [PC, prod of other I, R_n]
        slices = np.moveaxis(self.tensor, n, 0).reshape(self.tensor.shape[n], -1).T
        best = np.full(slices.shape[1], np.inf)
        basis = np.zeros_like(self.bases[n])
        for chosen in combinations(range(self.clusters[n]), self.mixture[n]):
            numbers = [number for number, cell in enumerate(self.cells) if cell[n] in chosen]
            matrix = dictionary[numbers].transpose(1, 0, 2).reshape(len(slices), -1)
            x = _least_squares(matrix, slices)
            error = np.square(slices - matrix @ x).sum(axis=0)
            better = error < best
            best[better], basis[:, better] = error[better], 0
            rows = x.reshape(len(numbers), rank, -1).transpose(0, 2, 1)
            for number, own in zip(numbers, rows, strict=True):
                basis[number][better] = own[better]
        length = np.sqrt(np.square(basis).sum(axis=1, keepdims=True))
        self.bases[n] = basis / np.where(length > 0, length, 1)

    def sweep(self) -> float:
        """Rows of one mode after another, then cores; the squared error that is left."""
        for n in range(self.tensor.ndim):
            self.solve_rows(n)
        return self.solve_cores()

    def solve_cores(self) -> float:
        """All cores together; the squared error that is left."""
        order = self.tensor.ndim
        columns = np.moveaxis(self.columns(), 0, order).reshape(self.tensor.size, -1)
        x = _least_squares(columns, self.tensor.reshape(-1, 1))
        self.cores = x.reshape(self.cores.shape)
        return float(np.square(self.tensor.reshape(-1, 1) - columns @ x).sum())


def _least_squares(matrix: F64, values: F64) -> F64:
    """x of least |matrix x - values|, with a ridge that is rounding."""
    gram: F64 = matrix.T @ matrix
    ridge = 1e-12 * np.trace(gram) / len(gram) + 1e-300
    whole: F64 = gram + ridge * np.eye(len(gram))
    return np.asarray(np.linalg.solve(whole, matrix.T @ values), np.float64)


def plain_snr(
    tensor: NDArray[np.floating], rank: int, clusters: int, mixture: int, seed: int = 0, *, sweeps: int = 25,
    starts: int = 6,
) -> float:
    """SNR in dB of the best of several starts, the same R, C and K in every mode."""
    wide = tensor.astype(np.float64)
    least = np.inf
    for start in range(starts):
        model = Plain(wide, *([each] * wide.ndim for each in (rank, clusters, mixture)), seed=starts * seed + start)
        with threadpool_limits(1):  # matrices are so small that threads would wait for each other
            least = min(least, [model.sweep() for _ in range(sweeps)][-1])
    return float(10 * np.log10(np.square(wide).sum() / least))
