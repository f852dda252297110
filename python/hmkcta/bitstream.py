"""Whole numbers one after the other as bits, without gaps (`docs/format.md`, section 3, packed levels)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]

#: Numbers, or bytes, looked at together: what is made of them on the way, some 40 bytes of each, stays in the cache.
_TOGETHER = 1 << 14


def stream_bytes(bits: int) -> int:
    """Bytes of so many bits."""
    return -(-bits // 8)


def to_stream(numbers: NDArray[Any], bits: U8) -> U8:
    """The lowest `bits` of each number, as bytes; what is left of the last one is 0.

    >>> to_stream(np.array([1, 3, 1]), np.array([2, 2, 3], np.uint8)).tolist()  # 01, 11, 001
    [29]
    """
    pieces, rest = list[U8](), np.zeros(0, np.uint8)
    for begin, end, starts in _chunks(bits):
        own, offset = bits[begin:end], starts - starts[:1] + rest.size
        values = numbers[begin:end].astype(np.int32)
        ones = np.concatenate([rest, np.zeros(int(own.sum(dtype=np.int64)), np.uint8)])
        for bit in range(int(own.max(initial=0))):
            has = own > bit
            ones[offset[has] + bit] = (values[has] >> bit) & 1
        whole = ones.size // 8 * 8
        pieces.append(np.packbits(ones[:whole], bitorder="little"))
        rest = ones[whole:]
    return np.concatenate([*pieces, np.packbits(rest, bitorder="little")])


def from_stream(stream: U8, bits: U8) -> I32:
    """The numbers of so many `bits` each.

    >>> from_stream(np.array([29], np.uint8), np.array([2, 2, 3], np.uint8)).tolist()
    [1, 3, 1]
    """
    numbers = np.zeros(bits.size, np.int32)
    for begin, end, starts in _chunks(bits):
        own, first = bits[begin:end], int(starts[0]) // 8
        last = stream_bytes(int(starts[-1]) + int(own[-1]))
        ones, offset = np.unpackbits(stream[first:last], bitorder="little").astype(np.int32), starts - 8 * first
        for bit in range(int(own.max(initial=0))):
            has = own > bit
            numbers[begin:end][has] += ones[offset[has] + bit] << bit
    return numbers


def to_unary(zeros: U8) -> U8:
    """So many bits of 0, up to 30, and one of 1 for each number, as bytes.

    >>> to_unary(np.array([2, 0, 4], np.uint8)).tolist()  # 001, 1, 00001
    [12, 1]
    """
    return to_stream(np.left_shift(1, zeros.astype(np.int32)), zeros + np.uint8(1))


def from_unary(stream: U8, count: int) -> I32:
    """The bits of 0 before each of the first `count` bits of 1, or of all where there are fewer.

    >>> from_unary(np.array([12, 1], np.uint8), 3).tolist()
    [2, 0, 4]
    """
    pieces, found, last = list[I32](), 0, -1
    for begin in range(0, stream.size, _TOGETHER):
        if found >= count:
            break
        ones = np.flatnonzero(np.unpackbits(stream[begin : begin + _TOGETHER], bitorder="little"))[: count - found]
        places = ones + 8 * begin
        pieces.append((np.diff(places, prepend=last) - 1).astype(np.int32))
        found, last = found + ones.size, int(places[-1]) if ones.size else last
    return np.concatenate([*pieces, np.zeros(0, np.int32)])


def _chunks(bits: U8) -> Iterator[tuple[int, int, NDArray[np.int64]]]:
    """Some numbers after others: the first, the one after the last, and the bit at which each begins."""
    done = 0
    for begin in range(0, bits.size, _TOGETHER):
        own = bits[begin : begin + _TOGETHER].astype(np.int64)
        ends = np.cumsum(own) + done
        yield begin, begin + own.size, ends - own
        done = int(ends[-1])
