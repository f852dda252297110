"""HOSVD (paper, section 3.1): leading subspaces of the unfoldings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32, F64

#: Side of Gram matrices up to which they are decomposed exactly; vectors of larger ones are found by randomised
#: subspace iteration.
EXACT_SIDE = 768
#: The same where few vectors of many are wanted.
SMALL_SIDE = 160


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
    if _is_exact(matrix, rank):
        if len(matrix) <= matrix.shape[1]:
            return np.ascontiguousarray(leading_eigen(_gram(matrix), rank)[1], np.float32)
        return _orthonormal(matrix @ leading_eigen(_gram(matrix.T), rank)[1].astype(np.float32))
    sample = matrix @ rng.standard_normal((matrix.shape[1], min(rank + 12, *matrix.shape)), np.float32)
    for _ in range(3):
        sample = matrix @ (matrix.T @ _orthonormal(sample))
    basis = _orthonormal(sample)
    return (basis @ leading_eigen(_gram(basis.T @ matrix), rank)[1]).astype(np.float32)


def leading_eigen(gram: F64, count: int) -> tuple[F64, F64]:
    """So many eigenvalues of a Gram matrix, the largest first, and their vectors as columns.

    Of A A^T they are squares of singular values of A and its left singular vectors, of A^T A its right ones.

    >>> leading_eigen(np.diag([1.0, 9.0, 4.0]), 2)[0].tolist()
    [9.0, 4.0]
    """
    values, vectors = np.linalg.eigh(gram)
    return values[: -count - 1 : -1], vectors[:, : -count - 1 : -1]


def _gram(matrix: NDArray[np.floating]) -> F64:
    """matrix matrix^T in float64: its small eigenvalues are the squares of what the basis is asked to tell apart."""
    gram = np.zeros((len(matrix), len(matrix)))
    step = max(1, 2**18 // max(1, len(matrix)))  # which stays in the cache
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


def _is_exact(matrix: NDArray[np.floating], rank: int) -> bool:
    """Whether all singular vectors are worth finding, where `rank` of them are wanted."""
    exact = EXACT_SIDE if 6 * min(rank, *matrix.shape) > min(matrix.shape) else SMALL_SIDE
    return min(matrix.shape) <= exact
