"""HOSVD (paper, section 3.1): leading subspaces of the unfoldings, and the core tensor's energies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32, F64
from ..metrics import squared_norm

#: Side of Gram matrices up to which they are decomposed exactly; vectors of larger ones are found by randomised
#: subspace iteration.
EXACT_SIDE = 768
#: The same where few vectors of many are wanted.
SMALL_SIDE = 160
#: Where few vectors may be enough, so many are found first.
FEW = 32
#: Each further attempt finds so many times as many.
GROWING = 4


def unfold(tensor: NDArray[np.floating], n: int) -> NDArray[np.floating]:
    """The mode-n unfolding `[I_n, prod_{m != n} I_m]`, columns in C order."""
    return np.moveaxis(tensor, n, 0).reshape(tensor.shape[n], -1)


def mode_product(tensor: NDArray[np.floating], matrix: NDArray[np.floating], n: int) -> NDArray[np.floating]:
    """The mode-n product ``tensor x_n matrix`` for a matrix `[J, I_n]`.

    >>> mode_product(np.ones((2, 3)), np.ones((5, 3)), 1).tolist()[0]
    [3.0, 3.0, 3.0, 3.0, 3.0]
    """
    return np.moveaxis(np.tensordot(matrix, tensor, (1, n)), 0, n)


def leading_subspace(tensor: F32, n: int, rank: int, rng: np.random.Generator, enough: float = 0.0) -> F32:
    """Leading left singular vectors of the mode-n unfolding: `[I_n, min(rank, its rank at most)]`, orthonormal.

    Fewer where so many leave `enough` of the squared norm or less, and it takes less to find them alone.
    """
    if (few := _few_leading(tensor, n, rank, rng, enough)) is not None:
        return few[0]
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


def _few_leading(
    tensor: F32, n: int, rank: int, rng: np.random.Generator, enough: float
) -> tuple[F32, F32] | None:
    """A quarter of so many leading singular vectors, and ``U^T A``; None where they take as long or leave too much."""
    shape = tensor.shape[n], tensor.size // max(1, tensor.shape[n])
    rank = min(rank, *shape)
    if not enough or rank <= GROWING * FEW or min(shape) <= EXACT_SIDE:
        return None
    basis = leading_subspace(tensor, n, max(FEW, rank // GROWING), rng, enough)
    projected = _projected(unfold(tensor, n), basis)
    return (basis, projected) if squared_norm(tensor) - squared_norm(projected) <= enough else None


def _gram(matrix: NDArray[np.floating]) -> F64:
    """matrix matrix^T in float64: its small eigenvalues are the squares of what the basis is asked to tell apart."""
    gram = np.zeros((len(matrix), len(matrix)))
    step = max(1, 2**18 // max(1, len(matrix)))  # which stays in the cache
    for start in range(0, matrix.shape[1], step):
        chunk = matrix[:, start : start + step].astype(np.float64)
        gram += chunk @ chunk.T
    return gram


def _projected(matrix: NDArray[np.floating], basis: F32) -> F32:
    """``U^T A`` summed in float64: float32 sums of thousands of like terms drift, by 1e-4 of the energy."""
    rows = basis.T.astype(np.float64)
    step = max(1, 2**18 // max(1, len(matrix)))
    found = np.empty((len(rows), matrix.shape[1]), np.float32)
    for start in range(0, matrix.shape[1], step):
        found[:, start : start + step] = rows @ matrix[:, start : start + step].astype(np.float64)
    return found


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


def core_energies(
    tensor: F32, limits: Sequence[int | None], rng: np.random.Generator, enough: float = 0.0
) -> F64:
    """Energy that HOSVD captures at every choice of ranks up to the limits: ``table[R_1 - 1, .., R_N - 1]``.

    A mode of limit None is left undecomposed, and has one entry. The energy is that of the truncated core, the error of
    the truncated reconstruction. Errors of less than `enough` are not told apart: the table may end there.

    >>> core_energies(np.outer([1, 2], [2, 0]).astype(np.float32), (2, 1), np.random.default_rng(0)).round(3).tolist()
    [[20.0], [20.0]]
    """
    decomposed = [n for n, limit in enumerate(limits) if limit is not None]
    if len(decomposed) == 1 and (found := _squares(unfold(tensor, n := decomposed[0]), limits[n] or 0)) is not None:
        return np.cumsum(found).reshape([-1 if m == n else 1 for m in range(tensor.ndim)])
    core, scale = full_core(tensor, limits, rng, enough)
    kept = np.square(core[tuple(slice(limit) for limit in limits)])
    undecomposed = tuple(n for n, limit in enumerate(limits) if limit is None)
    table = scale * kept.sum(axis=undecomposed, keepdims=True, dtype=np.float64)
    for n, limit in enumerate(limits):
        if limit is not None:
            np.cumsum(table, axis=n, out=table)
    return table


def full_core(
    tensor: F32, limits: Sequence[int | None], rng: np.random.Generator, enough: float = 0.0
) -> tuple[F32, float]:
    """The tensor rotated into the singular vectors of its unfoldings, the strongest first: its HOSVD core.

    A mode of limit None is not rotated. One longer than its unfolding has columns comes out with as many rows as they
    are many, and a long one of a low limit with `limit` rows, or fewer if these leave no more than `enough`. Others
    keep their length.

    Returns:
        The core, and the scale of its energies: the tensor's squared norm by that of its rotation.
    """
    for n, limit in enumerate(limits):
        if limit is not None and (few := _few_leading(tensor, n, limit, rng, enough)) is not None:
            rest = [size for m, size in enumerate(tensor.shape) if m != n]
            tensor = np.moveaxis(few[1].reshape(-1, *rest), 0, n)
    order, sizes = tensor.ndim, tensor.shape
    # A mode longer than its unfolding has columns comes first, as the tensor is smaller afterwards.
    first = next((n for n in range(order) if sizes[n] ** 2 > tensor.size), 0)
    modes = [(first + n) % order for n in range(order)]
    core = np.ascontiguousarray(tensor.transpose(modes))
    iterated = list[int]()
    # Modes are cycled, so that the one at hand is axis 0: it comes out last, and after all of them they lie as before.
    for axis, n in enumerate(modes):
        limit, matrix = limits[n], core.reshape(core.shape[0], -1)
        found = None if limit is None else _rotated(matrix, limit)
        iterated += [axis] if found is None and limit is not None else []
        rotated = matrix.T if found is None else found
        core = np.ascontiguousarray(rotated).reshape(*core.shape[1:], rotated.shape[1])
    # Rotations keep the norm: what float32 sums lose of it would look like error, or hide it.
    scale = squared_norm(tensor) / max(squared_norm(core), 1e-300)
    for axis in iterated:
        core = _truncated(core, axis, limits[modes[axis]] or 0, rng)
    return core.transpose(sorted(range(order), key=modes.__getitem__)), scale


def _truncated(core: F32, n: int, rank: int, rng: np.random.Generator) -> F32:
    """The core with mode n rotated into its `rank` leading singular vectors: few would not do, or were found before."""
    basis = leading_subspace(core, n, rank, rng)
    others = [size for m, size in enumerate(core.shape) if m != n]
    return np.moveaxis(_projected(unfold(core, n), basis).reshape(-1, *others), 0, n)


def _squares(matrix: NDArray[np.floating], rank: int) -> F64 | None:
    """Squares of so many singular values, the largest first; None where their vectors are iterated."""
    if not _is_exact(matrix, rank):
        return None
    gram = _gram(matrix if len(matrix) <= matrix.shape[1] else matrix.T)
    return np.maximum(np.linalg.eigvalsh(gram)[: -rank - 1 : -1], 0.0)


def _is_exact(matrix: NDArray[np.floating], rank: int) -> bool:
    """Whether all singular vectors are worth finding, where `rank` of them are wanted."""
    exact = EXACT_SIDE if 6 * min(rank, *matrix.shape) > min(matrix.shape) else SMALL_SIDE
    return min(matrix.shape) <= exact


def _rotated(matrix: F32, rank: int) -> F32 | None:
    """Transpose of ``U^T A``, U being all left singular vectors of A; None where it is worth finding `rank` alone."""
    if not _is_exact(matrix, rank):
        return None
    if len(matrix) <= matrix.shape[1]:
        return matrix.T @ leading_eigen(_gram(matrix), len(matrix))[1].astype(np.float32)
    energies, vectors = leading_eigen(_gram(matrix.T), matrix.shape[1])
    return (vectors * np.sqrt(np.maximum(energies, 0))).astype(np.float32)
