"""Whole numbers of few bits one after the other, without gaps (`docs/format.md`, section 3, packed levels)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

U8 = NDArray[np.uint8]
I32 = NDArray[np.int32]

#: Numbers looked at together: what is made of them on the way, some 40 bytes of each, stays in the cache.
_TOGETHER = 1 << 14


def stream_bytes(bits: int) -> int:
    """Bytes of so many bits."""
    return -(-bits // 8)


def to_stream(numbers: NDArray[Any], bits: U8) -> U8:
    """The numbers in two's complement, each in its `bits`, as bytes; what is left of the last one is 0.

    >>> to_stream(np.array([1, -1, 1]), np.array([2, 2, 3], np.uint8)).tolist()  # 01, 11, 001
    [29]
    """
    pieces, rest = list[U8](), np.zeros(0, np.uint8)
    for begin, end, starts in _chunks(bits):
        own, offset = bits[begin:end], starts - starts[:1] + rest.size
        values = numbers[begin:end].astype(np.int32).view(np.uint32)
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
    [1, -1, 1]
    """
    numbers = np.zeros(bits.size, np.int32)
    for begin, end, starts in _chunks(bits):
        own, first = bits[begin:end], int(starts[0]) // 8
        last = stream_bytes(int(starts[-1]) + int(own[-1]))
        ones, offset = np.unpackbits(stream[first:last], bitorder="little").astype(np.int32), starts - 8 * first
        for bit in range(int(own.max(initial=0))):
            has = own > bit
            weight = np.where(own[has] == bit + 1, -1, 1) << bit  # the highest bit counts below zero
            numbers[begin:end][has] += ones[offset[has] + bit] * weight
    return numbers


def _chunks(bits: U8) -> Iterator[tuple[int, int, NDArray[np.int64]]]:
    """Some numbers after others: the first, the one after the last, and the bit at which each begins."""
    done = 0
    for begin in range(0, bits.size, _TOGETHER):
        own = bits[begin : begin + _TOGETHER].astype(np.int64)
        ends = np.cumsum(own) + done
        yield begin, begin + own.size, ends - own
        done = int(ends[-1])
