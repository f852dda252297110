"""Parameters of core numbers, column by column, of which codes are short: coordinate descent.

A core number of index (r_1, .., r_N) has the least of what its columns say. What a column says concerns its own slice
of the core alone, so that all columns of a mode are improved together, by the bits that each of their slices would
take with one more and one less.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from .bitstream import I32, U8
from .rice import PARAMETERS, code_bits, folded

#: How often each mode's parameters are changed at most, each time by one of these.
ROUNDS, CHANGES = 3, (0, -1, 1)
#: Share of the mean of folded numbers, which fall off geometrically, that 2^k is to be near to.
SHARE = 0.7


def core_parameters(whole: I32, stored: Sequence[bool]) -> list[U8 | None]:
    """What each column `[R_n]` says of the whole core numbers `[PC, R_1, .., R_N]`; None of modes that are not stored.

    >>> core_parameters(np.array([[[200, -12], [9, 3]]]), (True, True))[0].tolist()
    [7, 3]
    """
    z = folded(whole)
    said = [_first(z, n) if kept else None for n, kept in enumerate(stored)]
    for _ in range(ROUNDS):
        before = _joined(said)
        for n, kept in enumerate(stored):
            if kept:
                said[n] = _improved(z, said, n)
        if np.array_equal(_joined(said), before):
            break
    return [None if own is None else own.astype(np.uint8) for own in said]


def _first(z: I32, n: int) -> NDArray[np.int64]:
    """By the mean of each slice along mode n."""
    means = z.mean(axis=tuple(m for m in range(z.ndim) if m != n + 1), dtype=np.float64)
    return np.clip(np.rint(np.log2(np.maximum(SHARE * means, 1))), 0, PARAMETERS - 1).astype(np.int64)


def _improved(z: I32, said: Sequence[NDArray[np.int64] | None], n: int) -> NDArray[np.int64]:
    """What mode n's columns should say while the others say this."""
    own = said[n]
    assert own is not None
    others = [_along(each, m, z.ndim) for m, each in enumerate(said) if each is not None and m != n]
    least = reduce(np.minimum, others, np.array(PARAMETERS - 1))
    rest = tuple(m for m in range(z.ndim) if m != n + 1)
    tried = np.clip(own[None] + np.array(CHANGES)[:, None], 0, PARAMETERS - 1)
    taken = [
        code_bits(z, np.minimum(_along(each, n, z.ndim), least).astype(np.uint8)).sum(axis=rest, dtype=np.int64)
        for each in tried
    ]
    return tried[np.argmin(taken, axis=0), np.arange(own.size)]


def _joined(said: Sequence[NDArray[np.int64] | None]) -> NDArray[np.int64]:
    return np.concatenate([own for own in said if own is not None])


def _along(said: NDArray[np.int64], n: int, dimensions: int) -> NDArray[np.int64]:
    shape = [1] * dimensions
    shape[n + 1] = said.size
    return said.reshape(shape)
