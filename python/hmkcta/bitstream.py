"""Numbers of fewer than eight bits one after the other, without gaps (`docs/format.md`, section 3, packed bases).

A number of w bits is a byte whose lower 8 - w bits are zero, of which the upper w are stored, the lowest of them first.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .narrow import I8, U8

#: Numbers looked at together: what is made of them on the way, some 40 bytes of each, stays in the cache.
_TOGETHER = 1 << 14


def bits_needed(stored: I8) -> U8:
    """Bits of a number of each column `[R]` of the bytes `[.., R]`: of so many the lowest is not always 0.

    >>> bits_needed(np.array([[64, 3, 0], [-64, 1, 0]], np.int8)).tolist()
    [2, 8, 1]
    """
    used = np.bitwise_or.reduce(stored.reshape(-1, stored.shape[-1]).view(np.uint8), axis=0).astype(np.int16)
    lowest = used & -used
    return np.where(used == 0, 1, 8 - np.log2(np.maximum(lowest, 1)).astype(np.int16)).astype(np.uint8)


def stream_bytes(bits: int) -> int:
    """Bytes of so many bits."""
    return -(-bits // 8)


def to_stream(stored: I8, bits: U8) -> U8:
    """The numbers, each in its `bits`, as bytes; what is left of the last one is 0.

    >>> to_stream(np.array([64, -64, 32], np.int8), np.array([2, 2, 3], np.uint8)).tolist()  # 01, 11, 001
    [29]
    """
    pieces, rest = list[U8](), np.zeros(0, np.uint8)
    for begin, end, starts in _chunks(bits):
        own, offset = bits[begin:end], starts - starts[:1] + rest.size
        values = stored[begin:end].view(np.uint8) >> (8 - own)
        ones = np.concatenate([rest, np.zeros(int(own.sum()), np.uint8)])
        for bit in range(int(own.max(initial=0))):
            has = own > bit
            ones[offset[has] + bit] = (values[has] >> bit) & 1
        whole = ones.size // 8 * 8
        pieces.append(np.packbits(ones[:whole], bitorder="little"))
        rest = ones[whole:]
    return np.concatenate([*pieces, np.packbits(rest, bitorder="little")])


def from_stream(stream: U8, bits: U8) -> I8:
    """The bytes that numbers of so many `bits` each stand for.

    >>> from_stream(np.array([29], np.uint8), np.array([2, 2, 3], np.uint8)).tolist()
    [64, -64, 32]
    """
    stored = np.zeros(bits.size, np.uint8)
    for begin, end, starts in _chunks(bits):
        own, first = bits[begin:end], int(starts[0]) // 8
        last = stream_bytes(int(starts[-1]) + int(own[-1]))
        ones, offset = np.unpackbits(stream[first:last], bitorder="little"), starts - 8 * first
        for bit in range(int(own.max(initial=0))):
            has = own > bit
            stored[begin:end][has] |= ones[offset[has] + bit] << (8 - own[has] + bit)
    return stored.view(np.int8)


def _chunks(bits: U8) -> Iterator[tuple[int, int, NDArray[np.int64]]]:
    """Some numbers after others: the first, the one after the last, and the bit at which each begins."""
    done = 0
    for begin in range(0, bits.size, _TOGETHER):
        own = bits[begin : begin + _TOGETHER].astype(np.int64)
        ends = np.cumsum(own) + done
        yield begin, begin + own.size, ends - own
        done = int(ends[-1])
