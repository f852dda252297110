"""Bits of the numbers of a packed level (`docs/format.md`, section 3): tables of widths, and numbers as whole ones.

A width is a byte for each column of a basis: the lower four bits are one less than the bits of the column's numbers,
the upper four one less than the most bits of the core numbers that stand for this column. A core number, which stands
for a column of each mode, has the least of these.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arrays import F32
from .bitstream import U8

F16 = NDArray[np.float16]
I32 = NDArray[np.int32]
U32 = NDArray[np.uint32]

#: Numbers looked at together: what is made of them on the way stays in the cache.
_TOGETHER = 1 << 14
#: Most bits of a basis number: float16 holds all of these.
MOST_OF_BASIS = 12
_MOST = np.array(MOST_OF_BASIS, np.uint8)
#: The same of a core number, of which float16 keeps the upper ones.
MOST_OF_CORE = 16
#: About what the most bits leave of the energy of what a level is to hold.
LEFT = 2e-7


def widths(basis: U8, core: U8) -> U8:
    """The table entries of columns whose numbers have so many bits, and their core numbers at most so many.

    >>> widths(np.array([8, 3], np.uint8), np.array([16, 1], np.uint8)).tolist()
    [247, 2]
    """
    return ((basis - 1) | ((core - 1) << 4)).astype(np.uint8)


def basis_bits(width: U8) -> U8:
    """Bits of the basis numbers of each column.

    >>> basis_bits(np.array([247, 2], np.uint8)).tolist()
    [8, 3]
    """
    return ((width & 15) + 1).astype(np.uint8)


def core_bits(width: U8) -> U8:
    """Most bits of the core numbers of each column.

    >>> core_bits(np.array([247, 2], np.uint8)).tolist()
    [16, 1]
    """
    return ((width >> 4) + 1).astype(np.uint8)


def basis_number_bits(width: U8, ranks: NDArray[np.integer[Any]], numbers: NDArray[np.integer[Any]]) -> U8:
    """Bits of each number of a mode's bases, by the widths of the nodes' columns, their ranks and how many numbers.

    >>> basis_number_bits(np.array([7, 2, 4], np.uint8), np.array([2, 1]), np.array([4, 3])).tolist()
    [8, 3, 8, 3, 5, 5, 5]
    """
    ranks, ends = ranks.astype(np.int64), np.cumsum(numbers.astype(np.int64))
    starts, columns, own = ends - numbers, np.cumsum(ranks) - ranks, basis_bits(width)
    bits = np.empty(int(ends[-1]) if ends.size else 0, np.uint8)
    for begin in range(0, bits.size, _TOGETHER):  # of nodes there can be a million, of numbers more
        end = min(begin + _TOGETHER, bits.size)
        first, last = (int(np.searchsorted(ends, at, side="right")) for at in (begin, end - 1))
        edges = np.clip(np.append(starts[first : last + 1], ends[last]), begin, end)
        node = np.repeat(np.arange(first, last + 1), np.diff(edges))
        bits[begin:end] = own[columns[node] + (np.arange(begin, end) - starts[node]) % ranks[node]]
    return bits


def core_number_bits(width: Sequence[U8 | None], shape: U32) -> U8:
    """Bits of each core number of a level, by the widths of its columns and the shapes `[S, 3, N]` of its nodes.

    >>> width = [np.array([128, 48], np.uint8), None, np.array([80, 64], np.uint8)]
    >>> core_number_bits(width, np.array([[[1, 1, 1], [1, 1, 1], [2, 3, 2]]], np.uint32)).tolist()
    [6, 5, 6, 5, 6, 5, 4, 4, 4, 4, 4, 4]
    """
    ranks, cells = shape[:, 2].astype(np.int64), shape[:, 0].prod(axis=1, dtype=np.int64)
    sizes, own = cells * ranks.prod(axis=1), [None if each is None else core_bits(each) for each in width]
    begins, columns = np.cumsum(sizes) - sizes, np.cumsum(ranks, axis=0) - ranks
    bits = np.empty(int(sizes.sum()), np.uint8)
    alike, kind, counts = np.unique(np.column_stack([cells, ranks]), axis=0, return_inverse=True, return_counts=True)
    order, ends = np.argsort(kind.reshape(-1), kind="stable"), np.cumsum(counts)
    for (count, *rank), begin, end in zip(alike.tolist(), ends - counts, ends, strict=True):
        each = count * prod(rank)  # numbers of a node
        together = max(1, _TOGETHER // max(1, each))
        for first in range(begin, end if each else begin, together):
            nodes = order[first : min(first + together, end)]
            found = np.full((nodes.size, *rank), MOST_OF_CORE, np.uint8)
            for n, of_mode in enumerate(own):
                if of_mode is not None:
                    of_rows = of_mode[columns[nodes, n][:, None] + np.arange(rank[n])]
                    along = (nodes.size, *(rank[n] if m == n else 1 for m in range(len(rank))))
                    np.minimum(found, of_rows.reshape(along), out=found)
            bits[begins[nodes][:, None] + np.arange(each)] = np.tile(found.reshape(nodes.size, -1), (1, count))
    return bits


def most_core_bits(width: Sequence[U8 | None], ranks: NDArray[np.integer[Any]]) -> U8:
    """Bits of the core number of each node that has most, `[S]`: the least, over the modes, of the most of its columns.

    >>> most_core_bits([np.array([128, 48], np.uint8), np.array([80, 64], np.uint8)], np.array([[2, 2]])).tolist()
    [6]
    """
    most = np.full(len(ranks), MOST_OF_CORE, np.uint8)
    for own, rank in zip(width, ranks.astype(np.int64).T, strict=True):
        if own is not None and own.size:
            there = rank > 0
            starts = (np.cumsum(rank) - rank)[there]
            most[there] = np.minimum(most[there], np.maximum.reduceat(core_bits(own), starts))
    return most


def whole_of_core(cores: F32) -> tuple[I32, float]:
    """Core numbers `[..]` as whole ones, and the largest number that all are multiples of; 1.0 where all are 0.

    >>> whole, step = whole_of_core(np.array([0.75, -1.5, 0], np.float32))
    >>> whole.tolist(), step
    ([1, -2, 0], 0.75)
    """
    mantissa, exponent = np.frexp(cores[cores != 0])
    if not mantissa.size:
        return np.zeros(cores.shape, np.int32), 1.0
    lowest = int(exponent.min()) - 24
    digits = np.ldexp(mantissa.astype(np.float64), exponent - lowest).astype(np.int64)
    step = float(np.ldexp(float(np.gcd.reduce(digits)), lowest))
    return np.rint(cores.astype(np.float64) / step).astype(np.int32), step


def bits_for(whole: I32) -> int:
    """Bits of the largest of these numbers in two's complement, one at the least.

    >>> bits_for(np.array([3, -4])), bits_for(np.array([0])), bits_for(np.array([4]))
    (3, 1, 4)
    """
    most = max(int(whole.max(initial=0)), -int(whole.min(initial=0)) - 1)
    return most.bit_length() + 1


def widths_of(cores: I32, bases: Sequence[F16 | F32 | None]) -> list[U8 | None]:
    """Widths of a node's columns, for core numbers `[PC, R_1, .., R_N]` and bases `[.., R_n]`; None: undecomposed.

    A column's numbers have the bits of which the lowest is not always 0, its core numbers those of the largest.
    """
    found = list[U8 | None]()
    for n, basis in enumerate(bases):
        if basis is None:
            found.append(None)
            continue
        used = np.bitwise_or.reduce(whole(basis, _MOST).reshape(-1, basis.shape[-1]), axis=0)
        own = np.where(used == 0, 1, MOST_OF_BASIS - np.log2(np.maximum(used & -used, 1)).astype(np.int32))
        # 2^15 has 16 bits as well: in float16 it is the number of 2^15 - 1.
        most = [min(bits_for(each), MOST_OF_CORE) for each in np.moveaxis(cores, n + 1, 0)]
        found.append(widths(own.astype(np.uint8), np.array(most, np.uint8)))
    return found


def whole(numbers: F16 | F32, bits: U8) -> I32:
    """Numbers of so many bits, of which the largest is near 1, as whole ones.

    >>> whole(np.array([0.5, -0.75], np.float16), np.array([2, 3], np.uint8)).tolist()
    [1, -3]
    """
    found, flat = np.empty(numbers.size, np.int32), numbers.reshape(-1)
    each = np.broadcast_to(bits, numbers.shape).reshape(-1)
    for part in _parts(found.size):
        found[part] = np.rint(flat[part].astype(np.float64) * np.exp2(each[part].astype(np.float64) - 1))
    return found.reshape(numbers.shape)


def from_whole(whole: I32, bits: U8) -> F16:
    """The float16 numbers nearest to whole ones of so many bits.

    >>> from_whole(np.array([1, -3]), np.array([2, 3], np.uint8)).tolist()
    [0.5, -0.75]
    """
    found, flat = np.empty(whole.size, np.float16), whole.reshape(-1)
    each = np.broadcast_to(bits, whole.shape).reshape(-1)
    for part in _parts(found.size):
        found[part] = flat[part] / np.exp2(each[part].astype(np.float64) - 1)
    return found.reshape(whole.shape)


def _parts(count: int) -> Iterator[slice]:
    """Some numbers after others, of so many."""
    return (slice(begin, begin + _TOGETHER) for begin in range(0, count, _TOGETHER))
