"""The Golomb-Rice code of whole numbers (`docs/format.md`, section 3, packed levels): few bits for small ones.

A number q is folded, z = 0, 1, 2, 3, .. for q = 0, -1, 1, -2, ..; u, the whole part of z / 2^k, is told by u bits of 0
and one of 1, and the rest by k bits. Where u would be more than 12 it is 12, and z has 16 bits of its own. Numbers that
fall off as those of cores and bases do take about a twentieth more than their entropy, if 2^k is near their size.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bitstream import I32, U8, from_stream, from_unary, stream_bytes, to_stream, to_unary

#: Most bits of 0 of a code, and the bits of z beside these.
MOST_ZEROS, RAW = 12, 16
#: Parameters k that there are.
PARAMETERS = 16
#: The largest magnitude that a number has.
MOST = 1 << (RAW - 1)


def folded(q: NDArray[Any]) -> I32:
    """z of each number.

    >>> folded(np.array([0, -1, 1, -2])).tolist()
    [0, 1, 2, 3]
    """
    whole = q.astype(np.int32)
    return (whole << 1) ^ (whole >> 31)


def unfolded(z: I32) -> I32:
    """The number of each z.

    >>> unfolded(np.array([0, 1, 2, 3])).tolist()
    [0, -1, 1, -2]
    """
    return (z >> 1) ^ -(z & 1)


def code_bits(z: I32, k: U8) -> I32:
    """Bits of the codes of folded numbers.

    >>> code_bits(np.array([0, 4, 7, 100]), np.array([0, 1, 1, 2], np.uint8)).tolist()
    [1, 4, 5, 29]
    """
    zeros = z >> k
    return np.where(zeros < MOST_ZEROS, zeros + 1 + k, MOST_ZEROS + 1 + RAW).astype(np.int32)


def code_bytes(q: NDArray[Any], k: U8) -> int:
    """Bytes of the array in which numbers of these parameters are stored."""
    return _bytes(_zeros(folded(q), k), k)


def encoded(q: NDArray[Any], k: U8) -> U8:
    """The array in which numbers of these parameters are stored.

    >>> encoded(np.array([2, -1, -4, 3]), np.array([1, 0, 1, 0], np.uint8)).tolist()
    [20, 129, 2]
    """
    z = folded(q)
    zeros = _zeros(z, k)
    return np.concatenate([to_unary(zeros), to_stream(z, _rest_of_each(zeros, k))])


def decoded(stream: U8, k: U8, zeros: I32 | None = None) -> I32:
    """The numbers of these parameters; the array must be as `fault_in` wants it. `zeros`: of its codes, if known.

    >>> decoded(np.array([20, 129, 2], np.uint8), np.array([1, 0, 1, 0], np.uint8)).tolist()
    [2, -1, -4, 3]
    """
    zeros = from_unary(stream, k.size) if zeros is None else zeros
    rest = from_stream(stream[_first_bytes(zeros) :], _rest_of_each(zeros, k))
    return unfolded(np.where(zeros < MOST_ZEROS, (zeros << k) | rest, rest))


def fault_in(stream: U8, k: U8, zeros: I32 | None = None) -> tuple[str, object, object] | None:
    """Why the array cannot hold the codes of numbers of these parameters: a reason, what was found, what is allowed.

    `zeros`: of its codes, if known.
    """
    zeros = from_unary(stream, k.size) if zeros is None else zeros
    if (bad := np.flatnonzero(zeros > MOST_ZEROS)).size:
        return "code-range", f"{zeros[bad[0]]} bits of 0 in code {bad[0]}", f"at most {MOST_ZEROS}"
    if zeros.size < k.size:
        return "array-shape", [stream.size], f"the codes of {k.size} numbers"
    needed = _bytes(zeros, k)
    return None if stream.size == needed else ("array-shape", [stream.size], [needed])


def _zeros(z: I32, k: U8) -> U8:
    return np.minimum(z >> k, MOST_ZEROS).astype(np.uint8)


def _rest_of_each(zeros: NDArray[Any], k: U8) -> U8:
    """Bits of each number beside its bits of 0 and 1."""
    return np.where(zeros < MOST_ZEROS, k, RAW).astype(np.uint8)


def _first_bytes(zeros: NDArray[Any]) -> int:
    """Bytes of the first sequence, of bits of 0 and 1."""
    return stream_bytes(int(zeros.sum(dtype=np.int64)) + zeros.size)


def _bytes(zeros: NDArray[Any], k: U8) -> int:
    """Bytes of both sequences."""
    return _first_bytes(zeros) + stream_bytes(int(_rest_of_each(zeros, k).sum(dtype=np.int64)))
