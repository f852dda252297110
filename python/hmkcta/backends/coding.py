"""Block-sparse coding: slices of a tensor as combinations of a few clusters' dictionary columns (optimal search, which
section 5 of the paper names).

A row has a set S of K_n of the mode's clusters (the paper's cluster subsets). For slice t_i and set S the least squared
error is |t_i|^2 less the gain b_S^T H_SS^-1 b_S, with b = D^T t_i and H = D^T D, all in parameter space; the columns of
the dictionary D are the cores times the other modes' bases (docs/notation.md). The optimal search looks at every set,
the greedy one lets sets grow by their best next cluster. Fits use the native twin of this (`coding.rs`), which shares
factors of H between sets.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32, F64

U16 = NDArray[np.uint16]
Rows = NDArray[np.intp]
Subset = tuple[int, ...]

#: Ridge on H relative to its diagonal: keeps collinear dictionaries solvable, costs nothing visible in SNR.
RIDGE = 1e-7
#: A subset must be better by so much of the gain, so that ties go to the one seen first.
TIE = 1e-9


def code_rows(
    h: F64, b: F64, clusters: Sequence[int], n: int, kept: U16 | None, mixture: int, search: str
) -> tuple[U16, F32]:
    """The best subset of `mixture` clusters for each row of mode n, and its coefficients.

    Args:
        h: H `[PC R_n, PC R_n]`, cells in C order.
        b: `[PC, R_n, I_n]`.
        clusters: C_1, .., C_N.
        n: the mode.
        kept: the subsets `[I_n, K_n]` that rows have, and keep unless a better one is found; None: they have none.
        mixture: K_n.
        search: ``optimal``, ``greedy`` or ``fixed`` (none).

    Returns:
        Subsets `[I_n, K_n]`, ascending, and coefficients `[I_n, K_n, PC_-n R_n]`, ordered as they are stored.
    """
    dictionary = Dictionary.of(h, b, clusters, n)
    best = Best(dictionary)
    if search == "optimal":
        best.search(mixture)
    elif search == "greedy":
        best.grow(mixture)
    if kept is not None and search != "optimal":
        for subset, rows in patterns(kept):
            best.offer(subset, rows)
    subsets = np.array(best.subset, np.uint16).reshape(-1, mixture)
    x = np.empty((len(subsets), mixture, dictionary.h.shape[1]), np.float32)
    for subset, rows in patterns(subsets):
        x[rows] = dictionary.solve(subset, rows)
    return subsets, x


def patterns(subsets: U16) -> Iterable[tuple[Subset, Rows]]:
    """The distinct subsets in use, each with its rows."""
    distinct, which = np.unique(subsets, axis=0, return_inverse=True)
    for number, subset in enumerate(distinct):
        yield tuple(int(k) for k in subset), np.flatnonzero(which.reshape(-1) == number)


@dataclass(frozen=True, eq=False)
class Dictionary:
    """H and b of one mode, cluster after cluster.

    Attributes:
        h: `[C_n, Q, C_n, Q]`, of columns scaled to length 1, and the ridge; Q = PC_-n R_n.
        b: `[C_n, Q, I_n]`, likewise.
        length: `[C_n, Q]`, the lengths of the columns.
    """

    h: F64
    b: F64
    length: F64

    @classmethod
    def of(cls, h: F64, b: F64, clusters: Sequence[int], n: int) -> Dictionary:
        """Of H `[PC R_n, PC R_n]` and b `[PC, R_n, I_n]`.

        >>> h, b = np.array([[4.0, 1.0], [1.0, 9.0]]), np.array([[[8.0]], [[3.0]]])
        >>> dictionary = Dictionary.of(h, b, [2], 0)
        >>> row = np.array([0])
        >>> dictionary.solve((0,), row).round(3).tolist(), dictionary.gain((0,), row).round(3).tolist()
        ([[[2.0]]], [16.0])
        """
        side, rank = len(h), b.shape[1]
        columns: Rows = np.moveaxis(np.arange(side).reshape(*clusters, rank), n, 0).reshape(-1)
        h, b = h[np.ix_(columns, columns)], b.reshape(side, -1)[columns]
        squared = np.einsum("ii->i", h)
        length = np.sqrt(np.where(squared > 0, squared, 1.0))
        h = h / length / length[:, None] + RIDGE * np.eye(side)
        own, q = clusters[n], side // clusters[n]
        return cls(h.reshape(own, q, own, q), (b / length[:, None]).reshape(own, q, -1), length.reshape(own, q))

    def gain(self, subset: Subset, rows: Rows) -> F64:
        """What the clusters of one subset explain of the squared length of some rows: b^T H^-1 b."""
        h, b = self._system(subset, rows)
        return np.einsum("qi,qi->i", b, np.linalg.solve(h, b))

    def solve(self, subset: Subset, rows: Rows) -> F64:
        """Coefficients `[rows, |S|, Q]` of some rows on the clusters of one subset: H x = b."""
        x = np.linalg.solve(*self._system(subset, rows))
        return np.moveaxis(x.reshape(len(subset), -1, len(rows)) / self.length[list(subset), :, None], 2, 0)

    def _system(self, subset: Subset, rows: Rows) -> tuple[F64, F64]:
        side = len(subset) * self.h.shape[1]
        h = self.h[np.ix_(subset, range(self.h.shape[1]), subset, range(self.h.shape[1]))]
        return h.reshape(side, side), self.b[list(subset)][:, :, rows].reshape(side, -1)


class Best:
    """The best subset found so far for each row.

    Attributes:
        gain: `[I_n]`.
        subset: whose it is.
    """

    def __init__(self, dictionary: Dictionary) -> None:
        self.dictionary = dictionary
        self.gain = -np.ones(dictionary.b.shape[2])
        self.subset: list[Subset] = [()] * len(self.gain)

    def search(self, mixture: int) -> None:
        """Among all subsets of `mixture` clusters."""
        for subset in combinations(range(len(self.dictionary.b)), mixture):
            self.offer(subset, np.arange(len(self.gain)))

    def grow(self, mixture: int) -> None:
        """From the best single clusters on every subset in use tries every further cluster."""
        self.search(1)
        for _ in range(mixture - 1):
            grown = list(patterns(np.array(self.subset, np.uint16)))
            self.gain[:] = -1.0
            for subset, rows in grown:
                for k in sorted(set(range(len(self.dictionary.b))) - set(subset)):
                    self.offer(tuple(sorted((*subset, k))), rows)

    def offer(self, subset: Subset, rows: Rows) -> None:
        """Give the subset to those rows whose gain it raises."""
        gain = self.dictionary.gain(subset, rows)
        better = gain > self.gain[rows] * (1 + TIE)
        for i in rows[better]:
            self.subset[i] = subset
        self.gain[rows[better]] = gain[better]
