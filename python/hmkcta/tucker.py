"""HOSVD (paper, section 3.1): leading subspaces of the unfoldings, and the core tensor's energies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

#: Up to this side a Gram matrix is decomposed exactly; beyond it by randomised subspace iteration, and already beyond
#: the smaller one where few vectors of many are wanted.
EXACT_SIDE, SMALL_SIDE = 768, 160


def unfold(tensor: NDArray[np.floating], n: int) -> NDArray[np.floating]:
    """The mode-n unfolding `[I_n, prod_{m != n} I_m]`, columns in C order."""
    return np.moveaxis(tensor, n, 0).reshape(tensor.shape[n], -1)


def mode_product(tensor: NDArray[np.floating], matrix: NDArray[np.floating], n: int) -> NDArray[np.floating]:
    """The mode-n product ``tensor x_n matrix`` for a matrix `[J, I_n]`.

    >>> mode_product(np.ones((2, 3)), np.ones((5, 3)), 1).tolist()[0]
    [3.0, 3.0, 3.0, 3.0, 3.0]
    """
    return np.moveaxis(np.tensordot(matrix, tensor, (1, n)), 0, n)


def leading_subspace(tensor: F32, n: int, rank: int, rng: np.random.Generator) -> F32:
    """Leading left singular vectors of the mode-n unfolding: `[I_n, min(rank, its rank at most)]`, orthonormal."""
    matrix = unfold(tensor, n)
    rank = min(rank, *matrix.shape)
    exact = EXACT_SIDE if 6 * rank > min(matrix.shape) else SMALL_SIDE
    if len(matrix) <= min(exact, matrix.shape[1]):
        _, vectors = np.linalg.eigh(_gram(matrix))
        return np.ascontiguousarray(vectors[:, : -rank - 1 : -1], np.float32)
    if matrix.shape[1] <= exact:
        _, vectors = np.linalg.eigh(_gram(matrix.T))
        return _orthonormal(matrix @ vectors[:, : -rank - 1 : -1].astype(np.float32))
    sample = matrix @ rng.standard_normal((matrix.shape[1], min(rank + 12, *matrix.shape)), np.float32)
    for _ in range(3):
        sample = matrix @ (matrix.T @ _orthonormal(sample))
    basis = _orthonormal(sample)
    _, vectors = np.linalg.eigh(_gram(basis.T @ matrix))
    return basis @ vectors[:, : -rank - 1 : -1].astype(np.float32)


def _gram(matrix: NDArray[np.floating]) -> F64:
    """matrix matrix^T in float64: its small eigenvalues are the squares of what the basis is asked to tell apart."""
    gram = np.zeros((len(matrix), len(matrix)))
    step = max(1, 2**22 // max(1, len(matrix)))
    for start in range(0, matrix.shape[1], step):
        chunk = matrix[:, start : start + step].astype(np.float64)
        gram += chunk @ chunk.T
    return gram


def _orthonormal(matrix: NDArray[np.floating]) -> F32:
    return np.linalg.qr(matrix.astype(np.float64))[0].astype(np.float32)


def st_hosvd(tensor: F32, ranks: Sequence[int | None], rng: np.random.Generator) -> tuple[list[F32 | None], F32]:
    """Sequentially truncated HOSVD, the mode with the strongest truncation first; None: the mode stays as it is.

    Returns:
        Bases `[I_n, R_n]` (None for an undecomposed mode; fewer columns where the rank is not there) and the core.
    """
    bases: list[F32 | None] = [None] * tensor.ndim
    core = tensor
    decomposed = [
        (rank / size, n, rank) for n, (rank, size) in enumerate(zip(ranks, tensor.shape, strict=True)) if rank
    ]
    for _, n, rank in sorted(decomposed):
        basis = leading_subspace(core, n, rank, rng)
        bases[n] = basis
        core = mode_product(core, basis.T, n).astype(np.float32)
    return bases, np.ascontiguousarray(core)


def core_energies(tensor: F32, limits: Sequence[int | None], rng: np.random.Generator) -> F64:
    """Energy that HOSVD captures at every choice of ranks up to the limits: ``table[R_1 - 1, .., R_N - 1]``.

    An undecomposed mode (limit None) has one entry, its full size. Beyond what the limits keep nothing is promised:
    the energy is that of the truncated core, the error of the truncated reconstruction.
    """
    bases = [None if limit is None else leading_subspace(tensor, n, limit, rng) for n, limit in enumerate(limits)]
    core: NDArray[np.floating] = tensor
    kept = [1.0 if basis is None else basis.shape[1] / basis.shape[0] for basis in bases]
    for n in sorted(range(tensor.ndim), key=kept.__getitem__):
        basis = bases[n]
        if basis is not None:
            core = mode_product(core, basis.T, n)
    table = np.square(core, dtype=np.float64)
    for n, basis in enumerate(bases):
        table = table.sum(axis=n, keepdims=True) if basis is None else table.cumsum(axis=n)
    return table
