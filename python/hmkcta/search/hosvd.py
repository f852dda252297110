"""HOSVDs of blocks of one shape, not truncated: bases, and cores with any modes left undecomposed."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from math import prod
from typing import TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32

#: Modes of more rows stay undecomposed: a file has no basis of more columns, and eigenvectors take too long.
LONGEST_MODE = 1024
#: Most modes of a block that may be left undecomposed; more has not paid on any data set.
MOST_UNDECOMPOSED = 2

Undecomposed = tuple[int, ...]
Real = TypeVar("Real", np.float32, np.float64)


class BlockBatch:
    """Blocks `[blocks, n_1, .., n_N]` with the bases of their HOSVDs (paper, section 3.1)."""

    def __init__(self, values: F32, *, precise: bool = False, keeps: bool = False) -> None:
        """Find all bases.

        Args:
            values: the blocks.
            precise: by float64 Gram matrices, as those of float32 end at some 65 dB.
            keeps: cores are kept, as they are asked for at more steps than one.
        """
        self.values, self.keeps = values, keeps
        self.sizes: tuple[int, ...] = values.shape[1:]
        self.precise = precise
        self.bases: list[F32 | None] = [self._basis(n) if self._may_have_basis(n) else None
                                        for n in range(len(self.sizes))]
        self._cores: dict[Undecomposed, F32] = {}

    def __len__(self) -> int:
        return len(self.values)

    def undecomposed_sets(self) -> Iterator[Undecomposed]:
        """Modes that may be left undecomposed together; those without bases always are."""
        modes = range(len(self.sizes))
        forced = {n for n in modes if self.bases[n] is None}
        for count in range(MOST_UNDECOMPOSED + 1):
            yield from (chosen for chosen in combinations(modes, count) if forced <= set(chosen))

    def cores(self, undecomposed: Undecomposed, at: NDArray[np.intp] | None = None) -> F32:
        """Cores in all columns of the bases, `[blocks, n_1, .., n_N]`, of some blocks or all."""
        found = self._cores.get(undecomposed)
        if found is None:
            found = self.values if at is None or self.keeps else self.values[at]
            for n in range(len(self.sizes)):
                basis = self.bases[n]
                if n not in undecomposed and basis is not None:
                    own = basis if len(basis) == len(found) else basis[at]
                    found = mode_product(own.swapaxes(1, 2), found, n)
            if not self.keeps:
                return found
            self._cores[undecomposed] = found
        return found if at is None else found[at]

    def _may_have_basis(self, n: int) -> bool:
        """Not where a mode is too long, or the longer one of a matrix, whose rows are then stored as they are."""
        size = self.sizes[n]
        return size <= LONGEST_MODE and (len(self.sizes) != 2 or size <= self.sizes[1 - n])

    def _basis(self, n: int) -> F32:
        """Left singular vectors of the unfoldings along a mode, `[blocks, n_n, n_n]`, the largest first."""
        unfolded = np.moveaxis(self.values, n + 1, 1).reshape(len(self), self.sizes[n], -1)
        if self.precise:
            unfolded = unfolded.astype(np.float64)
        vectors = np.linalg.eigh(unfolded @ unfolded.swapaxes(1, 2))[1]
        return np.ascontiguousarray(vectors[:, :, ::-1], np.float32)


def mode_product(matrices: NDArray[Real], tensors: NDArray[Real], mode: int) -> NDArray[Real]:
    """Each tensor `[blocks, n_1, .., n_N]` times its matrix `[blocks, r, n]` along a mode (paper, equation 1)."""
    blocks, before, after = len(tensors), prod(tensors.shape[1 : mode + 1]), prod(tensors.shape[mode + 2 :])
    shape = (*tensors.shape[: mode + 1], matrices.shape[1], *tensors.shape[mode + 2 :])
    if after == 1:  # the last mode: rows of the tensor against rows of the matrix
        return cast("NDArray[Real]", tensors.reshape(blocks, before, -1) @ matrices.swapaxes(1, 2)).reshape(shape)
    stacked = tensors.reshape(blocks, before, tensors.shape[mode + 1], after)
    return cast("NDArray[Real]", matrices[:, None] @ stacked).reshape(shape)
