"""The Golomb-Rice code of packed levels, against a twin of one number each that was written from docs/format.md."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hmkcta.bitstream import U8
from hmkcta.rice import (
    MOST,
    MOST_ZEROS,
    PARAMETERS,
    code_bits,
    code_bytes,
    decoded,
    encoded,
    fault_in,
    folded,
    unfolded,
)

#: Whole numbers, most of them small, and parameters.
NUMBERS = st.lists(
    st.tuples(st.one_of(st.integers(-20, 20), st.integers(-MOST, MOST - 1)), st.integers(0, PARAMETERS - 1)),
    max_size=60)  # fmt: skip


def naive(numbers: Sequence[tuple[int, int]]) -> bytes:
    """Both sequences as digits, each filled up with 0s to whole bytes."""
    first = second = ""
    for q, k in numbers:
        z = 2 * q if q >= 0 else -2 * q - 1
        u = min(z // 2**k, 12)
        first += "0" * u + "1"
        digits = k if u < 12 else 16
        second += f"{z % 2**digits:0{digits}b}"[::-1] if digits else ""
    both = "".join(each + "0" * (-len(each) % 8) for each in (first, second))
    return bytes(int(both[at : at + 8][::-1], 2) for at in range(0, len(both), 8))


def arrays(numbers: Sequence[tuple[int, int]]) -> tuple[np.ndarray, U8]:
    pairs = np.array(numbers, np.int32).reshape(-1, 2)
    return pairs[:, 0], pairs[:, 1].astype(np.uint8)


@settings(max_examples=300, deadline=None)
@given(NUMBERS)
def test_codes_are_those_of_the_text(numbers: list[tuple[int, int]]) -> None:
    q, k = arrays(numbers)
    stored = encoded(q, k)
    assert stored.tobytes() == naive(numbers)
    assert code_bytes(q, k) == stored.size
    assert fault_in(stored, k) is None
    np.testing.assert_array_equal(decoded(stored, k), q)
    np.testing.assert_array_equal(unfolded(folded(q)), q)
    bits = int(code_bits(folded(q), k).sum())
    assert bits <= 8 * stored.size < bits + 16


def test_long_arrays() -> None:
    rng = np.random.default_rng(0)
    q, k = np.rint(rng.laplace(0, 20, 50_000)).astype(np.int32), rng.integers(0, 6, 50_000).astype(np.uint8)
    stored = encoded(q, k)
    assert stored.tobytes() == naive(list(zip(q.tolist(), k.tolist(), strict=True)))
    np.testing.assert_array_equal(decoded(stored, k), q)


@settings(max_examples=300, deadline=None)
@given(NUMBERS.filter(bool), st.integers(1, 3))
def test_arrays_of_another_length_are_told(numbers: list[tuple[int, int]], more: int) -> None:
    q, k = arrays(numbers)
    stored = encoded(q, k)
    for wrong in (stored[:-more], np.append(stored, np.ones(more, np.uint8))):
        bad = fault_in(wrong, k)
        assert bad is not None
        assert bad[0] == "array-shape"
        assert bad[1] == [wrong.size]


def test_more_bits_of_0_than_there_may_be_are_told() -> None:
    for zeros in (MOST_ZEROS, MOST_ZEROS + 1, 30):
        digits = "1" + "0" * zeros + "1"
        first = int(digits[::-1], 2).to_bytes(-(-len(digits) // 8), "little")
        stored = np.frombuffer(first + bytes(2), np.uint8)
        bad = fault_in(stored, np.zeros(2, np.uint8))
        assert bad == (None if zeros == MOST_ZEROS else ("code-range", f"{zeros} bits of 0 in code 1", "at most 12"))


def test_bits_that_are_left_may_be_anything() -> None:
    stored = encoded(np.array([2, -1, -4]), np.array([1, 0, 1], np.uint8))
    other = stored | np.array([0, 0b11111110, 0b11111100][: stored.size], np.uint8)
    assert fault_in(other, np.array([1, 0, 1], np.uint8)) is None
    assert decoded(other, np.array([1, 0, 1], np.uint8)).tolist() == [2, -1, -4]


@pytest.mark.parametrize("scale", [0.4, 2.0, 30.0, 500.0])
def test_of_geometric_numbers_codes_are_near_their_entropy(scale: float) -> None:
    z = np.random.default_rng(0).geometric(1 / (1 + scale), 20_000) - 1
    entropy = -np.log2(1 / (1 + scale)) - scale * np.log2(scale / (1 + scale))
    fewest = min(code_bits(z.astype(np.int32), np.full(z.size, k, np.uint8)).mean() for k in range(PARAMETERS))
    assert entropy - 0.02 * entropy < fewest < max(1.06 * entropy, 1.45)
