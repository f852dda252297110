"""Packed numbers are the bits that `docs/format.md` says, one after the other: held against twins bit by bit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hmkcta import bitstream
from hmkcta.bitstream import U8, from_stream, from_unary, stream_bytes, to_stream, to_unary


def naive_stream(stored: Sequence[int], bits: Sequence[int]) -> bytes:
    """The bits of each number, the lowest first, as digits; then eight digits a byte, the lowest first."""
    digits = "".join(f"{q % 2**own:0{own}b}"[::-1] if own else "" for q, own in zip(stored, bits, strict=True))
    digits += "0" * (-len(digits) % 8)
    return bytes(int(digits[at : at + 8][::-1], 2) for at in range(0, len(digits), 8))


def arrays(numbers: Sequence[tuple[int, int]]) -> tuple[NDArray[np.int32], U8]:
    """Whole numbers and their bits, of pairs of the two."""
    pairs = np.array(numbers, np.int32).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1].astype(np.uint8)


#: Whole numbers with as many bits as they need, or more.
NUMBERS = st.integers(0, 16).flatmap(lambda bits: st.tuples(st.integers(0, 2**bits - 1), st.just(bits)))


@settings(max_examples=300, deadline=None)
@given(st.lists(NUMBERS, max_size=60), st.integers(1, 20), st.integers(0, 255))
def test_streams_are_those_of_the_text(numbers: list[tuple[int, int]], together: int, spare: int) -> None:
    """However many are looked at together, which parts bytes at any bit; spare bits may be anything."""
    stored, bits = arrays(numbers)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bitstream, "_TOGETHER", together)
        stream = to_stream(stored, bits)
        assert stream.tobytes() == naive_stream(stored.tolist(), bits.tolist())
        assert stream.size == stream_bytes(int(bits.sum(dtype=np.int64)))
        used = int(bits.sum(dtype=np.int64)) % 8
        if used:
            stream[-1] |= (spare << used) % 256
        np.testing.assert_array_equal(from_stream(stream, bits), stored)


def test_long_streams() -> None:
    """Longer than what is looked at together, and twice as long to the number."""
    rng = np.random.default_rng(0)
    for count in (2 << 14, 50_000):
        bits = rng.integers(0, 17, count).astype(np.uint8)
        stored = rng.integers(0, 1 << bits.astype(np.int64))
        stream = to_stream(stored, bits)
        assert stream.tobytes() == naive_stream(stored.tolist(), bits.tolist())
        np.testing.assert_array_equal(from_stream(stream, bits), stored)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.integers(0, 30), max_size=60), st.integers(1, 20), st.binary(max_size=5))
def test_bits_of_0_before_bits_of_1(zeros: list[int], together: int, after: bytes) -> None:
    """Whatever follows them, and where there are fewer than are asked for."""
    own = np.array(zeros, np.uint8)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bitstream, "_TOGETHER", together)
        stream = to_unary(own)
        assert stream.tobytes() == naive_stream([1 << each for each in zeros], [each + 1 for each in zeros])
        longer = np.concatenate([stream, np.frombuffer(after, np.uint8)])
        np.testing.assert_array_equal(from_unary(longer, own.size), own)
        np.testing.assert_array_equal(from_unary(stream, own.size + 3), own)


def test_of_a_number_of_too_few_bits_the_lowest_are_kept() -> None:
    stored, bits = np.array([4, 11, 2**31 - 1], np.int32), np.array([3, 3, 16], np.uint8)
    assert from_stream(to_stream(stored, bits), bits).tolist() == [4, 3, 2**16 - 1]
