"""Bits of the numbers of a packed level (`docs/format.md`, section 3): tables of widths, and numbers as whole ones.

A width is a byte for each column of a basis: the lower four bits are one less than the bits of the column's numbers,
the upper four one less than the most bits of the core numbers that stand for this column. A core number, which stands
for a column of each mode, has the least of these.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arrays import F32
from .bitstream import U8

F16 = NDArray[np.float16]
I32 = NDArray[np.int32]

#: Most bits of a basis number: float16 holds all of these.
MOST_OF_BASIS = 12
#: The same of a core number, of which float16 keeps the upper ones.
MOST_OF_CORE = 16
#: Bits that float16 keeps.
KEPT = 11


def widths(basis: U8, core: U8) -> U8:
    """The table entries of columns whose numbers have so many bits, and their core numbers at most so many.

    >>> widths(np.array([8, 3], np.uint8), np.array([16, 1], np.uint8)).tolist()
    [247, 2]
    """
    return (basis - 1) | ((core - 1) << 4)


def basis_bits(width: U8) -> U8:
    """Bits of the basis numbers of each column.

    >>> basis_bits(np.array([247, 2], np.uint8)).tolist()
    [8, 3]
    """
    return (width & 15) + np.uint8(1)


def core_bits(width: U8) -> U8:
    """Most bits of the core numbers of each column.

    >>> core_bits(np.array([247, 2], np.uint8)).tolist()
    [16, 1]
    """
    return (width >> 4) + np.uint8(1)


def bits_of_basis(width: U8, ranks: NDArray[np.integer[Any]], numbers: NDArray[np.integer[Any]]) -> U8:
    """Bits of each number of a mode's bases, by the widths of each node's columns, its rank and how many numbers it has.

    >>> bits_of_basis(np.array([7, 2, 4], np.uint8), np.array([2, 1]), np.array([4, 3])).tolist()
    [8, 3, 8, 3, 5, 5, 5]
    """
    bits, ends = basis_bits(width), np.cumsum(ranks.astype(np.int64))
    nodes = zip(ends - ranks, ends, numbers, strict=True)
    return np.concatenate([np.zeros(0, np.uint8), *(np.resize(bits[begin:end], count) for begin, end, count in nodes)])


def bits_of_core(columns: Sequence[U8 | None], ranks: Sequence[int]) -> U8:
    """Bits `[R_1, .., R_N]` of a cell's core numbers, by the core bits of each mode's columns; None: undecomposed.

    >>> bits_of_core([np.array([9, 4], np.uint8), None, np.array([6, 5], np.uint8)], (2, 1, 2)).tolist()
    [[[6, 5]], [[4, 4]]]
    """
    bits = np.full(tuple(ranks), MOST_OF_CORE, np.uint8)
    for n, own in enumerate(columns):
        if own is not None:
            np.minimum(bits, own.reshape([-1 if m == n else 1 for m in range(len(ranks))]), out=bits)
    return bits


def whole_of_core(cores: F32) -> tuple[I32, float]:
    """Core numbers `[..]` as whole ones, and the power of two that they are multiples of; 1.0 where all are 0.

    >>> whole, step = whole_of_core(np.array([0.75, -0.5, 0], np.float32))
    >>> whole.tolist(), step
    ([3, -2, 0], 0.25)
    """
    mantissa, exponent = np.frexp(cores[cores != 0])
    if not mantissa.size:
        return np.zeros(cores.shape, np.int32), 1.0
    whole = (mantissa.astype(np.float64) * 2.0**24).astype(np.int64)
    lowest = np.log2((whole & -whole).astype(np.float64)).astype(np.int64) + exponent - 24
    step = 2.0 ** int(lowest.min())
    return np.rint(cores.astype(np.float64) / step).astype(np.int32), step


def bits_for(whole: I32) -> int:
    """Bits of the largest of these numbers in two's complement, one at the least.

    >>> bits_for(np.array([3, -4])), bits_for(np.array([0])), bits_for(np.array([4]))
    (3, 1, 4)
    """
    most = max(int(whole.max(initial=0)), -int(whole.min(initial=0)) - 1)
    return most.bit_length() + 1


def widths_of(whole: I32, bases: Sequence[F16 | None]) -> list[U8 | None]:
    """Widths of the columns of a node: of core numbers `[PC, R_1, .., R_N]` and of bases `[.., R_n]`; None: undecomposed.

    A column's numbers have the bits of which the lowest is not always 0, its core numbers those of the largest.
    """
    found = list[U8 | None]()
    for n, basis in enumerate(bases):
        if basis is None:
            found.append(None)
            continue
        used = np.bitwise_or.reduce(whole_of_basis(basis, None).reshape(-1, basis.shape[-1]), axis=0)
        own = np.where(used == 0, 1, MOST_OF_BASIS - np.log2(np.maximum(used & -used, 1)).astype(np.int32))
        slices = np.moveaxis(whole, n + 1, 0)
        found.append(widths(own.astype(np.uint8), np.array([bits_for(each) for each in slices], np.uint8)))
    return found


def whole_of_basis(basis: NDArray[Any], bits: U8 | None) -> I32:
    """Basis numbers as whole ones of so many bits (None: of the most).

    >>> whole_of_basis(np.array([0.5, -0.75], np.float16), np.array([2, 3], np.uint8)).tolist()
    [1, -3]
    """
    ones = np.exp2(float(MOST_OF_BASIS - 1) if bits is None else bits.astype(np.float64) - 1)
    return np.rint(basis.astype(np.float64) * ones).astype(np.int32)


def from_whole(whole: I32, bits: Any) -> F16:
    """The float16 numbers nearest to whole ones of so many bits, of which the largest is near 1.

    >>> from_whole(np.array([1, -3]), np.array([2, 3], np.uint8)).tolist()
    [0.5, -0.75]
    """
    return (whole / np.exp2(np.asarray(bits, np.float64) - 1)).astype(np.float16)


def most_core_bits(columns: Sequence[U8 | None]) -> int:
    """Bits of the core number of a node that has most: the least, over the modes, of the most of its columns."""
    return min((int(own.max()) for own in columns if own is not None and own.size), default=MOST_OF_CORE)


def columns_of_nodes(width: Sequence[U8 | None], ranks: NDArray[np.integer[Any]]) -> Iterator[list[U8 | None]]:
    """For each node of a level the widths of its columns of every mode; `ranks` `[S, N]`."""
    ends = np.cumsum(ranks.astype(np.int64), axis=0)
    for node, after in zip(ranks, ends, strict=True):
        yield [None if own is None else own[end - rank : end] for own, rank, end in zip(width, node, after, strict=True)]
