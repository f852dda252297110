"""Plain float64 references for fits: equation 2 cell by cell, truncated SVD, HOSVD, alternating least squares."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmkcta.model import Model
from hmkcta.packed import PackedLevel

F64 = NDArray[np.float64]
Rows = tuple[NDArray[np.intp], ...]


def snr(signal: Any, error: float) -> float:
    """SNR in dB of a squared error."""
    return float(10 * np.log10(energy(signal) / error))


def energy(tensor: Any) -> float:
    """Sum of squares in float64."""
    return float(np.square(np.asarray(tensor, np.float64)).sum())


# The stored model


def mode_sizes(model: Model) -> tuple[int, ...]:
    """Sizes of the tensor's modes, from the rows of the root node."""
    return tuple(int(offset[1]) for offset in model.levels[0].row_offset)


def equation_2(model: Model, upto: int | None = None) -> F64:
    """The tensor of all modes: the paper's equation 2, summed over nodes and levels."""
    sizes = mode_sizes(model)
    total = np.zeros(sizes)
    for level, nodes in zip(model.levels[:upto], node_rows(model), strict=False):
        for s, rows in enumerate(nodes):
            if level.shape[s, 0].any():
                with np.errstate(invalid="ignore"):  # BLAS may look at what lies beside a small matrix
                    total[np.ix_(*rows)] += node_sum(level, s)
    assert np.isfinite(total).all()
    return total


def node_rows(model: Model) -> list[list[Rows]]:
    """Of every level and node the rows it owns, in its own order."""
    levels: list[list[Rows]] = [[tuple(np.arange(size) for size in mode_sizes(model))]]
    for level in model.levels[:-1]:
        assert level.child is not None
        below: list[Rows] = []
        for s, owned in enumerate(levels[-1]):
            if level.child[s] == level.child[s + 1]:
                continue
            for part in product(*(range(int(c)) for c in level.shape[s, 0])):
                below.append(tuple(_child_rows(level, s, n, rows, part[n]) for n, rows in enumerate(owned)))
        levels.append(below)
    return levels


def _child_rows(level: PackedLevel, s: int, n: int, rows: NDArray[np.intp], part: int) -> NDArray[np.intp]:
    parts, local = level.part[n], level.local[n]
    if parts is None or local is None:
        return rows
    span = slice(int(level.row_offset[n][s]), int(level.row_offset[n][s + 1]))
    chosen = np.flatnonzero(parts[span] == part)
    ordered = np.empty(len(chosen), np.intp)
    ordered[local[span][chosen]] = rows[chosen]
    return ordered


def node_sum(level: PackedLevel, s: int) -> F64:
    """Sum over the cells c of Z_c x_1 U_1,c .. x_N U_N,c of one node."""
    clusters, _, ranks = (tuple(int(v) for v in row) for row in level.shape[s])
    cores = _part(level.core, level.core_offset, s).reshape(-1, *ranks)
    cores = cores * _part(level.core_scale, level.cell_offset, s).reshape(-1, *[1] * len(ranks))
    terms = [
        tucker_product(core, [cell_basis(level, s, n, cell) for n in range(len(ranks))])
        for core, cell in zip(cores, np.ndindex(*clusters), strict=True)
    ]
    return np.sum(terms, axis=0)


def cell_basis(level: PackedLevel, s: int, n: int, cell: Sequence[int]) -> F64:
    """U_n,c with its zero rows; an identity for a mode that is undecomposed in the node, K = 0."""
    clusters, mixture, ranks = (tuple(int(v) for v in row) for row in level.shape[s])
    if not mixture[n]:
        return np.eye(ranks[n])
    basis, cluster = level.basis[n], level.cluster[n]
    others = [c for m, c in enumerate(clusters) if m != n]
    flat = int(np.ravel_multi_index([c for m, c in enumerate(cell) if m != n], others)) if others else 0
    members = _part(cluster, level.cluster_offset[n], s).reshape(-1, mixture[n])
    stored = _part(basis, level.basis_offset[n], s).reshape(len(members), mixture[n], -1, ranks[n])
    return ((members == cell[n])[:, :, None] * stored[:, :, flat]).sum(axis=1)


def _part(array: NDArray[Any], offsets: NDArray[np.uint32] | None, s: int) -> F64:
    assert offsets is not None
    return array[int(offsets[s]) : int(offsets[s + 1])].astype(np.float64)


# What a fit should reach


def unfold(tensor: NDArray[Any], n: int) -> F64:
    """Mode-n unfolding."""
    return np.moveaxis(tensor, n, 0).reshape(tensor.shape[n], -1).astype(np.float64)


def tucker_product(core: F64, matrices: Sequence[F64]) -> F64:
    """core x_1 U_1 .. x_N U_N."""
    for n, matrix in enumerate(matrices):
        core = np.moveaxis(np.tensordot(matrix, core, (1, n)), 0, n)
    return core


def svd_error(matrix: NDArray[Any], rank: int) -> float:
    """Least squared error of any matrix of that rank."""
    return energy(np.linalg.svd(matrix.astype(np.float64), compute_uv=False)[rank:])


def tucker_bound(tensor: NDArray[Any], ranks: Sequence[int]) -> float:
    """No Tucker approximation of these ranks has less squared error: the worst unfolding's tail."""
    return max(svd_error(unfold(tensor, n), rank) for n, rank in enumerate(ranks))


def st_hosvd_error(tensor: NDArray[Any], ranks: Sequence[int]) -> float:
    """Squared error of sequentially truncated HOSVD, modes in order."""
    return energy(tensor) - energy(_project(tensor, _st_hosvd(tensor, ranks)))


def _st_hosvd(tensor: NDArray[Any], ranks: Sequence[int]) -> list[F64]:
    core, bases = tensor.astype(np.float64), list[F64]()
    for n, rank in enumerate(ranks):
        basis = np.linalg.svd(unfold(core, n), full_matrices=False)[0][:, :rank]
        core = np.moveaxis(np.tensordot(basis.T, core, (1, n)), 0, n)
        bases.append(basis)
    return bases


def hooi_error(tensor: NDArray[Any], ranks: Sequence[int], rounds: int = 50) -> float:
    """Squared error of alternating least squares (HOOI) from ST-HOSVD."""
    bases = _st_hosvd(tensor, ranks)
    for _ in range(rounds):
        for n, rank in enumerate(ranks):
            partial = _project(tensor, [u if m != n else np.eye(len(u)) for m, u in enumerate(bases)])
            bases[n] = np.linalg.svd(unfold(partial, n), full_matrices=False)[0][:, :rank]
    return energy(tensor) - energy(_project(tensor, bases))


def _project(tensor: NDArray[Any], bases: Sequence[F64]) -> F64:
    return tucker_product(tensor.astype(np.float64), [u.T for u in bases])
