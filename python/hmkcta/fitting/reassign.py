"""The search for memberships where cells share no element (K = 1): K-subspaces, over one mode after another.

With everything else given, what cell c may explain of a row of mode n is its projection `y_c` (of `project_cells`) on
the R_n leading directions V_c `[prod_{m != n} R_m, R_n]` of the cell's rows, and a cluster's gain is the sum over its
cells of `|V_c^T y_c|^2`. Rows go where the gain is largest, the V_c follow, and a move is kept only if all cells
together explain more. V_c fits the rows it was made of better than others, so a row is judged in its own cluster as if
it had been left out: the move that pays then is the one of Hartigan's k-means, and clusters of few rows can still lose
them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .. import backends as kernels
from ..arrays import F32, F64
from ..cells import Cells

Labels = NDArray[np.intp]

#: Moves tried for a mode before the next one's turn; more gain less than 0.02 dB.
TRIALS = 8
#: A move must explain so much more, of all that is explained: less is rounding.
LEAST = 1e-6
#: Share of the rows that is moved next, where moving all that would gain did not pay.
FEWER = 0.25
#: Ridge on Gram matrices of a cell's coordinates, of their mean diagonal.
RIDGE = 1e-6
#: Numbers of projections at a time where all rows of a mode are assigned.
PROJECTED = 1 << 22


def search_memberships(cells: Cells, tensor: F32, rounds: int) -> None:
    """Move rows of every clustered mode to other clusters while that explains more of the tensor; K_n = 1 throughout.

    Cells change in place: bases and cores are those of a HOOI step of every mode. It ends after so many rounds over all
    modes, or when no row moves.
    """
    for _ in range(rounds):
        moved = 0
        for n, skip in enumerate(cells.undecomposed):
            if not skip:
                rows = _Rows.of(cells, kernels.project_cells(cells, tensor, n), n)
                moved += rows.improve() if cells.spec.clusters[n] > 1 else 0
                rows.store(cells, n)
        if not moved:
            break


def assign_rows(cells: Cells, tensor: F32, n: int) -> None:
    """Give every row of mode n to the cluster that explains most of it, with its best rows of the bases.

    What the cells leave does not rise; the tensor is looked at some rows at a time, and bases end orthonormal.
    """
    cores = _unfolded_cores(cells, n)
    directions = _orthonormal(cores.transpose(0, 1, 3, 2))
    back = np.linalg.pinv(cores.astype(np.float64) @ directions, rcond=RIDGE)  # from y V to rows of the basis
    members, basis = np.empty_like(cells.members[n]), np.empty_like(cells.bases[n])
    step = max(1, PROJECTED // (cells.spec.cells * cores.shape[3]))
    for start in range(0, cells.sizes[n], step):
        some = np.arange(start, min(start + step, cells.sizes[n]))
        part = cells.part([some if m == n else np.arange(size) for m, size in enumerate(cells.sizes)])
        slab = np.ascontiguousarray(tensor[(*[slice(None)] * n, slice(start, start + step))])
        p = _by_cluster(cells, kernels.project_cells(part, slab, n), n) @ directions
        labels = _squares(p).sum(axis=1).argmax(axis=0)
        own = p[labels, :, np.arange(len(some))].astype(np.float64)  # [I, PC_-n, R]
        members[some] = labels[:, None]
        basis[some] = np.einsum("icr,icrs->ics", own, back[labels])[:, None]
    cells.members[n], cells.bases[n] = members, basis
    kernels.orthonormalise(cells, n)


def with_all_rows(cells: Cells, n: int, size: int, step: int) -> Cells:
    """The cells with all rows of mode n instead of every step-th: those between are like the one before."""
    source = np.arange(size) // step
    sizes = (*cells.sizes[:n], size, *cells.sizes[n + 1 :])
    members, bases = list(cells.members), list(cells.bases)
    members[n], bases[n] = members[n][source], bases[n][source]
    return replace(cells, sizes=sizes, members=members, bases=bases)


@dataclass(eq=False)
class _Rows:
    """Rows of a mode as the cells of every cluster see them, and where they are.

    Attributes:
        y: projections `[C_n, PC_-n, I_n, Q]`.
        norms: their squared norms `[C_n, PC_-n, I_n]`.
        labels: the cluster of every row.
        directions: V `[C_n, PC_-n, Q, R]`, orthonormal columns.
        p: y V, `[C_n, PC_-n, I_n, R]`.
        gains: what every cell explains of every row, `[C_n, PC_-n, I_n]`.
    """

    y: F32
    norms: F32
    labels: Labels
    directions: F32
    p: F32
    gains: F32

    @classmethod
    def of(cls, cells: Cells, projected: F32, n: int) -> _Rows:
        """Those of mode n by their projections Y_n, fitted once to the clusters that they are in."""
        y = _by_cluster(cells, projected, n)
        directions = _orthonormal(_unfolded_cores(cells, n).transpose(0, 1, 3, 2))
        p = y @ directions
        rows = cls(y, _squares(y), cells.members[n][:, 0].astype(np.intp), directions, p, _squares(p))
        return rows.fitted_to(rows.labels)

    def fitted_to(self, labels: Labels) -> _Rows:
        """The same with these labels: a power iteration takes V to the leading directions of each cell's rows."""
        directions = _orthonormal(self.y.transpose(0, 1, 3, 2) @ (self.p * self._mask(labels)))
        p = self.y @ directions
        return _Rows(self.y, self.norms, labels, directions, p, _squares(p))

    def improve(self) -> int:
        """Move rows while that explains more; how many moved."""
        moved, share, explained = 0, 1.0, self.explained
        wanted, order = self._wanted()
        for _ in range(TRIALS):
            if not len(order):
                break
            some = order[: max(1, int(len(order) * share))]
            labels = self.labels.copy()
            labels[some] = wanted[some]
            tried = self.fitted_to(labels) if np.bincount(labels, minlength=len(self.y)).all() else None
            if tried is not None and tried.explained > explained * (1 + LEAST):
                self.labels, self.directions, self.p, self.gains = labels, tried.directions, tried.p, tried.gains
                moved, share, explained = moved + len(some), min(1.0, share / FEWER), tried.explained
                wanted, order = self._wanted()
            elif len(some) == 1:
                break
            else:
                share *= FEWER
        return moved

    @property
    def explained(self) -> float:
        """What all rows' own cells explain of them."""
        return float(self._own(self.gains).sum(dtype=np.float64))

    def store(self, cells: Cells, n: int) -> None:
        """Make these the cells' rows, bases and cores of mode n."""
        bases, triangles = np.linalg.qr(self.p * self._mask(self.labels))
        rank = bases.shape[3]
        cells.members[n] = self.labels[:, None].astype(np.uint16)
        cells.bases[n] = np.zeros_like(cells.bases[n])
        cells.bases[n][:, 0, :, :rank] = self._own(bases)
        cores = np.zeros((*self.y.shape[:2], cells.ranks[n], self.y.shape[3]), np.float32)
        cores[:, :, :rank] = triangles @ self.directions.transpose(0, 1, 3, 2)
        cells.cores = _in_order(cells, cores, n)

    def _wanted(self) -> tuple[Labels, Labels]:
        """The cluster that explains most of each row without it, and the rows that would move, by what they gain."""
        gains = self.gains.sum(axis=1)  # [C_n, I_n]
        at: Labels = np.arange(len(self.labels))
        gains[self.labels, at] = self._left_out()
        wanted = gains.argmax(axis=0)
        more = gains[wanted, at] - gains[self.labels, at]
        rows = np.flatnonzero(wanted != self.labels)
        return wanted, rows[np.argsort(-more[rows], kind="stable")]

    def _left_out(self) -> F32:
        """What their own cells would explain of rows that they had not been fitted to, `[I_n]`.

        With S = p^T p over a cell's rows, z = S^-1 p, leverage h = p z and e the squared error of a row, this error is
        e / ((1 - h)^2 + e |z|^2) once the row is taken out of what V came of.
        """
        p, norms = self._own(self.p).astype(np.float64), self._own(self.norms)
        own = (self.p * self._mask(self.labels)).astype(np.float64)
        gram: F64 = own.transpose(0, 1, 3, 2) @ own
        ridge = RIDGE * np.einsum("kcrr->kc", gram) / gram.shape[3] + np.finfo(np.float32).tiny
        gram += ridge[..., None, None] * np.eye(gram.shape[3])
        z = np.einsum("icrs,ics->icr", np.linalg.inv(gram)[self.labels], p)
        leverage = np.minimum(np.einsum("icr,icr->ic", z, p), 1.0)
        error: F32 = np.maximum(norms - self._own(self.gains), 0.0)
        within = (1 - leverage) ** 2 + error * np.einsum("icr,icr->ic", z, z)
        left = np.minimum(np.divide(error, within, out=norms.astype(np.float64), where=within > 0), norms)
        return (norms - left).sum(axis=1).astype(np.float32)

    def _mask(self, labels: Labels) -> F32:
        """1 for the rows of each cluster, else 0: `[C_n, 1, I_n, 1]`."""
        return (labels == np.arange(len(self.y))[:, None]).astype(np.float32)[:, None, :, None]

    def _own(self, values: F32) -> F32:
        """Of `[C_n, PC_-n, I_n, ..]` those of each row's own cluster: `[I_n, PC_-n, ..]`."""
        return values[self.labels, :, np.arange(len(self.labels))]


def _squares(values: F32) -> F32:
    return np.einsum("...r,...r->...", values, values)


def _orthonormal(columns: NDArray[np.floating]) -> F32:
    """Orthonormal columns `[.., Q, min(Q, R)]` that span what the given ones do, and more where these are dependent."""
    return np.linalg.qr(columns.astype(np.float32, copy=False))[0]


def _by_cluster(cells: Cells, values: F32, n: int) -> F32:
    """`[PC, ..]` as `[C_n, PC_-n, ..]`."""
    clusters = cells.spec.clusters
    apart = np.moveaxis(values.reshape(*clusters, *values.shape[1:]), n, 0)
    return np.ascontiguousarray(apart).reshape(clusters[n], -1, *values.shape[1:])


def _unfolded_cores(cells: Cells, n: int) -> F32:
    """`[C_n, PC_-n, R_n, Q]`."""
    return _by_cluster(cells, np.moveaxis(cells.cores, n + 1, 1).reshape(cells.spec.cells, cells.ranks[n], -1), n)


def _in_order(cells: Cells, cores: F32, n: int) -> F32:
    """Unfolded cores `[C_n, PC_-n, R_n, Q]` as `[PC, R_1, .., R_N]`."""
    others: Sequence[int] = [rank for m, rank in enumerate(cells.ranks) if m != n]
    rest = [count for m, count in enumerate(cells.spec.clusters) if m != n]
    apart = np.moveaxis(cores.reshape(cores.shape[0], *rest, cells.ranks[n], *others), 0, n)
    flat = apart.reshape(cells.spec.cells, cells.ranks[n], *others)
    return np.ascontiguousarray(np.moveaxis(flat, 1, n + 1))
