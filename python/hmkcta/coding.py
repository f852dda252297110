"""Block-sparse coding: slices of a tensor as combinations of a few clusters' dictionary columns (paper, section 5).

For slice t_i and cluster subset S the least squared error is |t_i|^2 less the gain b_S^T H_SS^-1 b_S, with b = D^T t_i
and H = D^T D, all in parameter space. H_SS = L L^T is factored cluster by cluster, so that subsets with the same first
clusters share that part of L and of y = L^-1 b, and the gain is |y|^2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
Rows = NDArray[np.intp]
Subset = tuple[int, ...]

#: Ridge on H relative to its diagonal: keeps collinear dictionaries solvable, costs nothing visible in SNR.
RIDGE = 1e-7

#: Numbers of factors that are kept, unless H has more: greedy searches look at more subsets than memory should hold.
MOST_KEPT = 1 << 24


@dataclass(eq=False)
class Coding:
    """b and H of one mode, and the best subset found so far for each of its rows.

    Attributes:
        h: `[C_n, Q, C_n, Q]`, of columns scaled to length 1, and the ridge.
        b: `[C_n, Q, I_n]`, likewise.
        length: `[C_n, Q]`, the lengths of the columns.
        gain: `[I_n]`, of the best subset.
        subset: which that is.
    """

    h: F64
    b: F64
    length: F64
    gain: F64
    subset: list[Subset]
    _factors: dict[Subset, tuple[F64, F64]] = field(default_factory=dict[Subset, "tuple[F64, F64]"])
    _kept: int = 0

    @classmethod
    def of(cls, h: F64, b: F64, clusters: int) -> Coding:
        """Of H `[C_n Q, C_n Q]` and b `[C_n Q, I_n]`, grouped by cluster.

        >>> h, b = np.array([[4.0, 1.0], [1.0, 9.0]]), np.array([[8.0], [3.0]])
        >>> coding = Coding.of(h, b, 2)
        >>> row = np.array([0])
        >>> coding.solve((0,), row).round(3).tolist(), coding.gain_of((0,), row).round(3).tolist()
        ([[2.0]], [16.0])
        """
        squared = np.einsum("ii->i", h)
        length = np.sqrt(np.where(squared > 0, squared, 1.0))
        unit = h / length
        unit /= length[:, None]  # in place: H may be the largest array of a fit
        np.einsum("ii->i", unit)[:] += RIDGE
        q, size = len(h) // clusters, b.shape[1]
        scaled = (b / length[:, None]).reshape(clusters, q, size)
        nothing: list[Subset] = [()] * size
        h, length = unit.reshape(clusters, q, clusters, q), length.reshape(clusters, q)
        return cls(h, scaled, length, gain=-np.ones(size), subset=nothing)

    @property
    def clusters(self) -> int:
        """C_n."""
        return len(self.b)

    def search(self, mixture: int) -> None:
        """The best of all subsets of so many clusters, for every row."""
        self._descend((), [], np.zeros(len(self.gain)), mixture)

    def _descend(self, subset: Subset, y: list[F64], gain: F64, more: int) -> None:
        for k in range(subset[-1] + 1 if subset else 0, self.clusters - more + 1):
            grown = (*subset, k)
            last = self._last(grown, y, self.b[k])
            grown_gain = gain + np.square(last).sum(axis=0)
            if more == 1:
                self.offer(grown, np.arange(len(gain)), grown_gain)
            else:
                self._descend(grown, [*y, last], grown_gain, more - 1)

    def gain_of(self, subset: Subset, rows: Rows) -> F64:
        """Gains of one subset for some rows."""
        rhs = self.b[:, :, rows]
        return sum((np.square(y).sum(axis=0) for y in self._forward(subset, rhs)), np.zeros(rhs.shape[2]))

    def offer(self, subset: Subset, rows: Rows, gain: F64) -> None:
        """Give the subset to those rows whose gain it raises; ties go to the subset seen first."""
        better = gain > self.gain[rows] * (1 + 1e-9)
        for i in rows[better]:
            self.subset[i] = subset
        self.gain[rows[better]] = gain[better]

    def solve(self, subset: Subset, rows: Rows) -> F64:
        """Coefficients `[|S| Q, rows]` of the given rows on the clusters of one subset: L^T x = y."""
        y = self._forward(subset, self.b[:, :, rows])
        x: list[F64] = []
        for d in reversed(range(len(subset))):
            w, low = self._factor(subset[: d + 1])
            x.insert(0, low.T @ y[d])
            y[:d] = [before - part @ x[0] for before, part in zip(y[:d], w.reshape(d, *low.shape), strict=True)]
        return np.concatenate([part / self.length[k, :, None] for k, part in zip(subset, x, strict=True)])

    def _forward(self, subset: Subset, rhs: F64) -> list[F64]:
        """y = L^-1 b of a subset, cluster by cluster; `rhs` is `[C_n, Q, ..]`."""
        y: list[F64] = []
        for d, k in enumerate(subset):
            y.append(self._last(subset[: d + 1], y, rhs[k]))
        return y

    def _last(self, subset: Subset, y: Sequence[F64], rhs: F64) -> F64:
        """y's part of the last cluster, given those before."""
        w, low = self._factor(subset)
        return low @ (rhs - w.T @ np.concatenate(y) if y else rhs)

    def _factor(self, subset: Subset) -> tuple[F64, F64]:
        """What the last cluster adds to L: W = L^-1 H of those before with it, and the inverse of its own corner."""
        if subset not in self._factors:
            k = subset[-1]
            q = self.h.shape[1]
            w = np.concatenate([np.zeros((0, q)), *self._forward(subset[:-1], self.h[:, :, k])])
            corner = np.linalg.cholesky(self.h[k, :, k] - w.T @ w)
            low = _inverse(np.asarray(corner, np.float64))
            if self._kept + w.size + low.size > max(MOST_KEPT, self.h.size):
                self._factors.clear()
                self._kept = 0
            self._factors[subset] = w, low
            self._kept += w.size + low.size
        return self._factors[subset]


def _inverse(low: F64) -> F64:
    """Of a lower triangular matrix, by halves: faster than a solver that does not know of the zeros."""
    half = len(low) // 2
    if half < 16:
        return np.asarray(np.linalg.inv(low), np.float64)
    inverse = np.zeros(low.shape)
    inverse[:half, :half] = first = _inverse(low[:half, :half])
    inverse[half:, half:] = last = _inverse(low[half:, half:])
    inverse[half:, :half] = -last @ (low[half:, :half] @ first)
    return inverse
