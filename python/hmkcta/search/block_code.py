"""A block's whole numbers at a step D: rounded bases, the core fitted to them and rounded; the twin of `block_code.rs`.

Fitting the core again to the bases *as rounded* mends part of their error (0.12 to 0.30 dB).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32, F64
from .rate_model import MODEL, RateModel

I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]
#: Largest exponent k of a column, whose numbers are multiples of 2^(-k/2) (docs/format.md).
MOST_EXPONENT = 63
#: Largest magnitude of a whole number (docs/format.md).
MOST_WHOLE = 2**24 - 1


@dataclass(frozen=True, eq=False)
class BlockCode:
    """Whole numbers of one block.

    Attributes:
        exponents: k of the kept columns, mode by mode, `[R_n]`; none in an undecomposed mode.
        bases: `[rows, R_n]`, mode by mode, likewise.
        core: `[R_1, .., R_N]`.
        error: squared error of the block as decoded.
    """

    exponents: tuple[U8, ...]
    bases: tuple[I32, ...]
    core: I32
    error: float


def rounded(numbers: NDArray[np.floating], model: RateModel = MODEL) -> NDArray[np.floating]:
    """Whole numbers next to these, magnitudes rounded up only from 0.5 + dead zone on.

    >>> rounded(np.array([0.55, -0.65, 1.7])).tolist()
    [0.0, -1.0, 2.0]
    """
    whole = np.floor(np.abs(numbers) + (0.5 - model.dead_zone))
    return np.sign(numbers) * np.minimum(whole, MOST_WHOLE)


def code_block(
    values: F32, bases: Sequence[F32 | None], core: F32, ranks: Sequence[int], step: float, model: RateModel = MODEL
) -> BlockCode:
    """Round one block.

    Args:
        values: the block, `[n_1, .., n_N]`.
        bases: orthonormal, `[n_n, n_n]`; None: the mode is undecomposed.
        core: of all columns, `[n_1, .., n_N]`.
        ranks: columns kept of each mode (all zero: nothing is stored), n_n where it is undecomposed.
        step: D.
        model: what numbers cost.
    """
    if not all(ranks):
        none = tuple(np.zeros((0, 0), np.int32) for _ in ranks)
        return BlockCode(tuple(np.zeros(0, np.uint8) for _ in ranks), none, np.zeros((0,) * len(ranks), np.int32),
                         float(np.square(values, dtype=np.float64).sum()))
    kept = core[tuple(slice(0, rank) for rank in ranks)].astype(np.float64)
    exponents: list[U8] = []
    whole: list[I32] = []
    decoded: list[F64 | None] = []
    tensor = values.astype(np.float64)
    for n, basis in enumerate(bases):
        if basis is None:
            exponents.append(np.zeros(0, np.uint8))
            whole.append(np.zeros((0, 0), np.int32))
            decoded.append(None)
            continue
        rows: F64 = np.moveaxis(kept, n, 0).reshape(ranks[n], -1)
        energies: F64 = np.einsum("ij,ij->i", rows, rows) / step**2
        exponent = np.clip(np.round(np.log2(np.maximum(energies, 1.0))), 0, MOST_EXPONENT).astype(np.float64)
        scale: F64 = np.exp2(exponent / 2)
        numbers: F64 = np.asarray(rounded(basis[:, : ranks[n]] * scale, model), np.float64)
        columns: F64 = numbers / scale
        gram = columns.T @ columns + 1e-9 * np.eye(ranks[n])
        fitted: F64 = np.asarray(np.linalg.solve(gram, columns.T), np.float64)
        tensor = along_mode(fitted, tensor, n)
        exponents.append(exponent.astype(np.uint8))
        whole.append(numbers.astype(np.int32))
        decoded.append(columns)
    numbers = np.asarray(rounded(tensor / step, model), np.float64)
    approximation: F64 = numbers * step
    for n, own in enumerate(decoded):
        if own is not None:
            approximation = along_mode(own, approximation, n)
    error = float(np.square(values - approximation).sum())
    return BlockCode(tuple(exponents), tuple(whole), numbers.astype(np.int32), error)


def along_mode(matrix: F64, tensor: F64, mode: int) -> F64:
    """The mode product `tensor x_mode matrix` (paper, equation 1)."""
    return np.moveaxis(np.tensordot(matrix, tensor, axes=(1, mode)), 0, mode)
