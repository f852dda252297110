"""Packed numbers are the bits that `docs/format.md` says, one after the other: held against twins bit by bit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hmkcta import bitstream
from hmkcta import packed as packed_module
from hmkcta.bitstream import bits_needed, from_stream, stream_bytes, to_stream
from hmkcta.narrow import I8, U8
from hmkcta.packed import number_bits


def naive_stream(stored: Sequence[int], bits: Sequence[int]) -> bytes:
    """The upper bits of each byte, the lowest first, as digits; then eight digits a byte, the lowest first."""
    digits = "".join(f"{q % 256:08b}"[:width][::-1] for q, width in zip(stored, bits, strict=True))
    digits += "0" * (-len(digits) % 8)
    return bytes(int(digits[at : at + 8][::-1], 2) for at in range(0, len(digits), 8))


def arrays(numbers: Sequence[tuple[int, int]]) -> tuple[I8, U8]:
    """Bytes and their bits, of pairs of the two."""
    pairs = np.array(numbers, np.int16).reshape(-1, 2)
    return pairs[:, 0].astype(np.int8), pairs[:, 1].astype(np.uint8)


#: Bytes whose lower bits are 0, with as many bits as the upper ones are, or more.
NUMBERS = st.integers(1, 8).flatmap(
    lambda bits: st.tuples(st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1).map(lambda q: q << 8 - bits),
                           st.just(bits)))  # fmt: skip


@settings(max_examples=300, deadline=None)
@given(st.lists(NUMBERS, max_size=60), st.integers(1, 20), st.integers(0, 255))
def test_streams_are_those_of_the_text(numbers: list[tuple[int, int]], together: int, spare: int) -> None:
    """However many are looked at together, which parts bytes at any bit; spare bits may be anything."""
    stored, bits = arrays(numbers)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bitstream, "_TOGETHER", together)
        stream = to_stream(stored, bits)
        assert stream.tobytes() == naive_stream(stored.tolist(), bits.tolist())
        assert stream.size == stream_bytes(int(bits.sum()))
        used = int(bits.sum()) % 8
        if used:
            stream[-1] |= (spare << used) % 256
        np.testing.assert_array_equal(from_stream(stream, bits), stored)


def test_long_streams() -> None:
    rng = np.random.default_rng(0)
    bits = rng.integers(1, 9, 50_000).astype(np.uint8)
    stored = (rng.integers(0, 256, bits.size) >> (8 - bits) << (8 - bits)).astype(np.uint8).view(np.int8)
    stream = to_stream(stored, bits)
    assert stream.tobytes() == naive_stream(stored.tolist(), bits.tolist())
    np.testing.assert_array_equal(from_stream(stream, bits), stored)


def test_the_example_of_the_text() -> None:
    stored, bits = (np.array([0.5, -0.75, -0.5, 0.25]) * 128).astype(np.int8), np.array([2, 3, 2, 3], np.uint8)
    assert to_stream(stored, bits).tolist() == [0xF5, 0x00]
    np.testing.assert_array_equal(from_stream(np.array([0xF5, 0x00], np.uint8), bits), stored)


def test_a_number_of_too_few_bits_loses_its_lower_ones() -> None:
    """By which the writer sees that a column is too narrow."""
    stored, bits = np.array([3, -1], np.int8), np.array([7, 1], np.uint8)
    assert from_stream(to_stream(stored, bits), bits).tolist() == [2, -128]


@settings(max_examples=200, deadline=None)
@given(st.integers(1, 4), st.lists(st.lists(st.integers(-128, 127), min_size=4, max_size=4), min_size=1, max_size=6),
       st.lists(st.integers(0, 7), min_size=4, max_size=4))  # fmt: skip
def test_bits_needed_are_the_fewest_that_lose_nothing(rank: int, rows: list[list[int]], cut: list[int]) -> None:
    stored = np.array([[q >> own << own for q, own in zip(row, cut, strict=True)] for row in rows], np.int8)[:, :rank]
    expected = [next(bits for bits in range(1, 9) if all(q % 2 ** (8 - bits) == 0 for q in column))
                for column in stored.T.tolist()]  # fmt: skip
    assert bits_needed(stored).tolist() == expected


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.lists(st.integers(1, 8), max_size=4), st.integers(1, 5)), max_size=8), st.integers(1, 20))
def test_numbers_have_the_bits_of_their_columns(nodes: list[tuple[list[int], int]], together: int) -> None:
    """Of any nodes, one after the other, some of which have neither columns nor numbers."""
    width = np.array([bits for columns, _ in nodes for bits in columns], np.uint8)
    ranks = np.array([len(columns) for columns, _ in nodes], np.uint32)
    counts = np.array([len(columns) * rows for columns, rows in nodes], np.int64)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(packed_module, "_TOGETHER", together)
        found = number_bits(width, ranks, counts)
    assert found.tolist() == [bits for columns, rows in nodes for bits in columns * rows]
