"""Widths of packed levels: bits of each number, and the fewest that hold them, against twins of one number each."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import product
from math import gcd, prod

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from format_reader import nearest_half
from hmkcta import widths as widths_module
from hmkcta.bitstream import U8
from hmkcta.widths import (
    MOST_OF_BASIS,
    MOST_OF_CORE,
    basis_bits,
    basis_number_bits,
    bits_for,
    core_bits,
    core_number_bits,
    from_whole,
    most_core_bits,
    whole,
    whole_of_core,
    widths,
    widths_of,
)

#: Of a node: clusters and ranks of three modes, all zero or none, from few enough that several nodes are alike.
NODES = st.lists(
    st.one_of(st.just(((0,) * 3,) * 2), st.tuples(*[st.tuples(*[st.integers(1, 3)] * 3)] * 2)), max_size=8)  # fmt: skip


def test_a_width_is_two_halves_of_a_byte() -> None:
    found = [(lower, upper) for upper in range(1, MOST_OF_CORE + 1) for lower in range(1, MOST_OF_BASIS + 1)]
    lower, upper = np.array(found, np.uint8).T
    width = widths(lower, upper)
    assert width.tolist() == [one - 1 + 16 * (other - 1) for one, other in found]
    np.testing.assert_array_equal(basis_bits(width), lower)
    np.testing.assert_array_equal(core_bits(width), upper)
    assert int(basis_bits(np.array([255], np.uint8))[0]) == 16  # which readers must see to refuse it


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.lists(st.integers(0, 255), max_size=4), st.integers(1, 5)), max_size=8),
       st.integers(1, 20))  # fmt: skip
def test_basis_numbers_have_the_bits_of_their_columns(nodes: list[tuple[list[int], int]], together: int) -> None:
    """Of any nodes, one after the other, some of which have neither columns nor numbers."""
    width = np.array([own for columns, _ in nodes for own in columns], np.uint8)
    ranks = np.array([len(columns) for columns, _ in nodes], np.uint32)
    counts = np.array([len(columns) * rows for columns, rows in nodes], np.int64)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(widths_module, "_TOGETHER", together)
        found = basis_number_bits(width, ranks, counts)
    assert found.tolist() == [own % 16 + 1 for columns, rows in nodes for own in columns * rows]


@settings(max_examples=200, deadline=None)
@given(NODES, st.sets(st.integers(0, 2), max_size=2), st.integers(1, 20), st.integers(0, 2**32 - 1))
def test_core_numbers_have_the_least_bits_of_their_columns(
    nodes: list[tuple[tuple[int, ...], tuple[int, ...]]], undecomposed: set[int], together: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    columns = [[None if n in undecomposed else rng.integers(0, 256, ranks[n]).tolist() for n in range(3)]
               for _, ranks in nodes]  # fmt: skip
    expected, most = list[int](), list[int]()
    for (clusters, ranks), own in zip(nodes, columns, strict=True):
        each = [min(mode[i] // 16 + 1 for mode, i in zip(own, r, strict=True) if mode is not None)
                for r in product(*map(range, ranks))]  # fmt: skip
        expected += each * prod(clusters)
        most += [max(each)] if each else []
    width: list[U8 | None] = [
        None if n in undecomposed else np.array([w for own in columns for w in own[n] or ()], np.uint8)
        for n in range(3)
    ]
    shape = np.array([[clusters, clusters, ranks] for clusters, ranks in nodes], np.uint32).reshape(-1, 3, 3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(widths_module, "_TOGETHER", together)
        assert core_number_bits(width, shape).tolist() == expected
    there = shape[:, 2, 0] > 0
    assert most_core_bits(width, shape[:, 2])[there].tolist() == most


@settings(max_examples=300, deadline=None)
@given(st.integers(1, MOST_OF_CORE).flatmap(
    lambda bits: st.tuples(st.just(bits), st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1))))  # fmt: skip
def test_whole_numbers_are_the_nearest_halves(number: tuple[int, int]) -> None:
    bits, q = number
    own = np.array([bits], np.uint8)
    found = from_whole(np.array([q], np.int32), own)
    assert found.dtype == np.float16
    assert float(found[0]) == nearest_half(q, bits)
    again = int(whole(found, own)[0])
    assert Fraction(float(found[0])) == Fraction(again, 2 ** (bits - 1))
    assert again == q or bits > MOST_OF_BASIS


@settings(max_examples=300, deadline=None)
@given(st.lists(st.integers(-(2**15), 2**15), max_size=12), st.integers(-100, 100))
def test_core_numbers_are_multiples_of_the_largest_number(numbers: list[int], exponent: int) -> None:
    cores = np.ldexp(np.array(numbers, np.float32), exponent).reshape(-1, 1)
    found, step = whole_of_core(cores)
    assert found.shape == cores.shape
    np.testing.assert_array_equal(found * step, cores.astype(np.float64))
    if any(numbers):
        assert gcd(*found[:, 0].tolist()) == 1
    else:
        assert step == 1.0


@settings(max_examples=200, deadline=None)
@given(st.lists(st.integers(-(2**15), 2**15 - 1), max_size=6))
def test_bits_for_are_the_fewest_of_twos_complement(numbers: list[int]) -> None:
    bits = bits_for(np.array(numbers, np.int32))
    assert all(-(2 ** (bits - 1)) <= q < 2 ** (bits - 1) for q in numbers)
    assert bits == 1 or not all(-(2 ** (bits - 2)) <= q < 2 ** (bits - 2) for q in numbers)


def fewest(numbers: Sequence[float], most: int) -> int:
    """The fewest bits of basis numbers, by trying."""
    return next(bits for bits in range(1, most + 1)
                if all(float(q * 2 ** (bits - 1)).is_integer() for q in numbers))  # fmt: skip


@settings(max_examples=200, deadline=None)
@given(st.tuples(st.integers(1, 2), *[st.integers(1, 3)] * 3), st.integers(0, 2**32 - 1))
def test_widths_are_the_fewest_that_hold_the_numbers(shape: tuple[int, int, int, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells, *ranks = shape
    cores = rng.integers(-(2**15), 2**15, shape) >> rng.integers(0, 17, ranks)
    lower = [rng.integers(1, MOST_OF_BASIS + 1, rank) for rank in ranks]
    bases = [None if n == 1 else (rng.integers(-(1 << own - 1), 1 << own - 1, (4, 1, cells, own.size))
                                  / 2.0 ** (own - 1)).astype(np.float16) for n, own in enumerate(lower)]  # fmt: skip
    found = widths_of(cores.astype(np.int32), bases)
    for n, (width, basis) in enumerate(zip(found, bases, strict=True)):
        assert (width is None) == (basis is None)
        if width is None or basis is None:
            continue
        columns = basis.reshape(-1, ranks[n]).T.astype(np.float64).tolist()
        assert basis_bits(width).tolist() == [fewest(column, MOST_OF_BASIS) for column in columns]
        slices = np.moveaxis(cores, n + 1, 0)
        assert core_bits(width).tolist() == [bits_for(own.astype(np.int32)) for own in slices]


def test_a_core_that_float16_rounds_up_has_the_most_bits() -> None:
    """2^15 has the bits of 2^15 - 1, which float16 rounds to it."""
    width = widths_of(np.array([[1 << 15]], np.int32), [np.zeros((1, 1, 1, 1), np.float16)])[0]
    assert width is not None
    assert core_bits(width).tolist() == [16]
    assert float(from_whole(np.array([2**15 - 1]), np.array([16], np.uint8))[0]) == 1.0
