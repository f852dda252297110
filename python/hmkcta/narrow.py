"""Core and basis numbers in a byte each (`docs/format.md`, section 3): what a byte stands for, and the nearest byte.

In memory they are the float16 numbers that the bytes stand for, so that fits and decoders know no other. Basis numbers
are multiples of 1/128. Those of a core, few of which are large, are finer the smaller they are: a byte q stands for
q |q|, as a share of the largest, so that what rounding leaves is about the same share of each.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bitstream import U8 as U8

F16 = NDArray[np.float16]
I8 = NDArray[np.int8]

#: Bits of a number that a level may store.
BITS = (16, 8)
#: The largest byte that is made of a number, but for the number of byte -128.
LARGEST = 127
_LEAST = -128

#: Values looked at together: what is made of them on the way, some 20 bytes of each, stays in the cache.
_TOGETHER = 1 << 14

_BYTES = np.arange(256, dtype=np.uint8).view(np.int8).astype(np.float64)
#: The number of each byte, by its bits: of a basis, and of a core before its factor.
BASIS_NUMBERS: F16 = (_BYTES / 128).astype(np.float16)
CORE_NUMBERS: F16 = (_BYTES * np.abs(_BYTES) / LARGEST**2).astype(np.float16)
#: The largest basis number that is written.
LARGEST_BASIS = LARGEST / 128


def widened(stored: I8, numbers: F16) -> F16:
    """The numbers of bytes.

    >>> widened(np.array([-127, -64, 1, 127], np.int8), BASIS_NUMBERS).tolist()
    [-0.9921875, -0.5, 0.0078125, 0.9921875]
    """
    return numbers[np.asarray(stored, np.int8).view(np.uint8)]


def narrowed(values: NDArray[Any], numbers: F16) -> I8:
    """For every value the byte whose number is nearest; those of `LARGEST` for all beyond it.

    Only the very number of byte -128, which other writers may use, becomes that byte.

    >>> narrowed(np.array([-2.0, -0.2, 0.0, 0.003, 1.0]), CORE_NUMBERS).tolist()
    [-127, -57, 0, 7, 127]
    """
    values = np.asarray(values)
    if values.dtype == np.float16:  # of which there are 65536
        return _of_halves(numbers.tobytes())[values.view(np.uint16)]
    flat, found = values.reshape(-1), np.empty(values.size, np.int8)
    for start in range(0, flat.size, _TOGETHER):
        found[start : start + _TOGETHER] = _nearest(flat[start : start + _TOGETHER], numbers)
    return found.reshape(values.shape)


@cache
def _of_halves(numbers: bytes) -> I8:
    """The bytes of all float16 numbers, by their bits."""
    halves = np.arange(1 << 16, dtype=np.uint16).view(np.float16)
    return _nearest(halves, np.frombuffer(numbers, np.float16))


def _nearest(values: NDArray[Any], numbers: F16) -> I8:
    ascending = numbers[: LARGEST + 1].astype(np.float64)
    between = (ascending[1:] + ascending[:-1]) / 2
    sizes = np.searchsorted(between, np.abs(values.astype(np.float64)), side="right").astype(np.int8)
    least = values == numbers[-_LEAST]
    return np.where(least, _LEAST, np.where(np.signbit(values), -sizes, sizes)).astype(np.int8)
