"""Parameters of packed levels, of each number and of columns, against twins of one number each."""

from __future__ import annotations

from fractions import Fraction
from itertools import product
from math import gcd, prod

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from format_reader import nearest_half
from hmkcta import parameters as parameters_module
from hmkcta.bitstream import U8
from hmkcta.core_parameters import core_parameters
from hmkcta.parameters import (
    BELOW_ONE,
    bytes_of,
    from_whole,
    most_of_core,
    of_basis,
    of_basis_numbers,
    of_columns,
    of_core,
    of_core_numbers,
    whole,
    whole_of_core,
)
from hmkcta.rice import MOST, PARAMETERS, code_bits, folded

#: Of a node: clusters and ranks of three modes, all zero or none, from few enough that several nodes are alike.
NODES = st.lists(
    st.one_of(st.just(((0,) * 3,) * 2), st.tuples(*[st.tuples(*[st.integers(1, 3)] * 3)] * 2)), max_size=8)  # fmt: skip


def test_an_entry_is_two_halves_of_a_byte() -> None:
    lower, upper = np.array([*product(range(PARAMETERS), repeat=2)], np.uint8).T
    entries = bytes_of(lower, upper)
    assert entries.tolist() == [one + 16 * other for one, other in product(range(PARAMETERS), repeat=2)]
    np.testing.assert_array_equal(of_basis(entries), lower)
    np.testing.assert_array_equal(of_core(entries), upper)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(st.lists(st.integers(0, 255), max_size=4), st.integers(1, 5)), max_size=8),
       st.integers(1, 20))  # fmt: skip
def test_basis_numbers_have_the_parameters_of_their_columns(nodes: list[tuple[list[int], int]], together: int) -> None:
    """Of any nodes, one after the other, some of which have neither columns nor numbers."""
    rice = np.array([own for columns, _ in nodes for own in columns], np.uint8)
    ranks = np.array([len(columns) for columns, _ in nodes], np.uint32)
    counts = np.array([len(columns) * rows for columns, rows in nodes], np.int64)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parameters_module, "_TOGETHER", together)
        found = of_basis_numbers(rice, ranks, counts)
    assert found.tolist() == [own % 16 for columns, rows in nodes for own in columns * rows]


@settings(max_examples=200, deadline=None)
@given(NODES, st.sets(st.integers(0, 2), max_size=2), st.integers(1, 20), st.integers(0, 2**32 - 1))
def test_core_numbers_have_the_least_of_their_columns(
    nodes: list[tuple[tuple[int, ...], tuple[int, ...]]], undecomposed: set[int], together: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    columns = [[None if n in undecomposed else rng.integers(0, 256, ranks[n]).tolist() for n in range(3)]
               for _, ranks in nodes]  # fmt: skip
    expected, most = list[int](), list[int]()
    for (clusters, ranks), own in zip(nodes, columns, strict=True):
        each = [min(mode[i] // 16 for mode, i in zip(own, r, strict=True) if mode is not None)
                for r in product(*map(range, ranks))]  # fmt: skip
        expected += each * prod(clusters)
        most += [max(each)] if each else []
    rice: list[U8 | None] = [
        None if n in undecomposed else np.array([w for own in columns for w in own[n] or ()], np.uint8)
        for n in range(3)
    ]
    shape = np.array([[clusters, clusters, ranks] for clusters, ranks in nodes], np.uint32).reshape(-1, 3, 3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parameters_module, "_TOGETHER", together)
        assert of_core_numbers(rice, shape).tolist() == expected
    there = shape[:, 2, 0] > 0
    assert most_of_core(rice, shape[:, 2])[there].tolist() == most


@settings(max_examples=300, deadline=None)
@given(st.integers(0, PARAMETERS - 1), st.integers(-MOST, MOST - 1))
def test_numbers_are_the_nearest_ones_of_float16(k: int, q: int) -> None:
    own = np.array([k], np.uint8)
    found = from_whole(np.array([q], np.int32), own)
    assert found.dtype == np.float16
    assert float(found[0]) == nearest_half(q, k)
    again = int(whole(found, own)[0])
    assert Fraction(float(found[0])) == Fraction(again, 2 ** (k + BELOW_ONE))
    assert again == q or abs(q) > 2048


@settings(max_examples=300, deadline=None)
@given(st.lists(st.integers(-(2**15), 2**15), max_size=12), st.integers(-100, 100), st.integers(1, 8191))
def test_core_numbers_are_multiples_of_the_largest_number(numbers: list[int], exponent: int, step: int) -> None:
    """Each cell's, of steps that float32 holds with the eleven bits of float16."""
    rounded = np.array([numbers, [1] * len(numbers)], np.float16).astype(np.float64)
    cores = np.ldexp(rounded * step, exponent).astype(np.float32).reshape(2, -1, 1)
    found, steps = whole_of_core(cores)
    assert found.shape == cores.shape
    np.testing.assert_array_equal(found * steps.reshape(2, 1, 1), cores.astype(np.float64))
    for own, each in zip(found, steps, strict=True):
        assert gcd(*own[:, 0].tolist()) == 1 if own.any() else each == 1.0


@settings(max_examples=200, deadline=None)
@given(st.lists(st.integers(0, 12), min_size=1, max_size=4), st.integers(0, 2**32 - 1))
def test_columns_have_the_parameter_of_their_steps(lower: list[int], seed: int) -> None:
    rng, own = np.random.default_rng(seed), np.array(lower)
    basis = (rng.integers(-8, 8, (4, 1, 2, own.size)) * 2.0 ** (-own - BELOW_ONE)).astype(np.float32)
    basis[0, 0, 0] = 2.0 ** (-own - BELOW_ONE)  # one step
    assert of_columns(basis).tolist() == lower
    basis[..., 0] = 0
    assert of_columns(basis)[0] == 0
    basis[..., 0] = 3.0  # of which even the coarsest step is a part
    assert of_columns(basis)[0] == 0


@pytest.mark.parametrize("stored", [(True, True, True), (True, False, True), (False, True, False)])
def test_core_parameters_make_codes_short(stored: tuple[bool, bool, bool]) -> None:
    """Shorter than one parameter for all, where numbers fall off with their indices as those of HOSVD cores do."""
    rng = np.random.default_rng(0)
    falls = [2.0 ** -np.arange(size) if kept else np.ones(size) for size, kept in zip((6, 4, 5), stored, strict=True)]
    numbers = np.rint(1000 * rng.laplace(size=(3, 6, 4, 5)) * np.einsum("i,j,k->ijk", *falls)).astype(np.int32)
    found, z = core_parameters(numbers, stored), folded(numbers)
    assert [own is not None for own in found] == [*stored]
    said = [np.full(size, 15) if own is None else own for own, size in zip(found, (6, 4, 5), strict=True)]
    k = np.minimum(np.minimum(said[0][:, None, None], said[1][:, None]), said[2]).astype(np.uint8)
    taken = int(code_bits(z, np.broadcast_to(k, z.shape)).sum())
    for one in range(PARAMETERS):
        assert taken < 0.98 * code_bits(z, np.full(z.shape, one, np.uint8)).sum()
    for n, own in enumerate(found):  # no column gains by one more or one less
        for r, change in product(range(0 if own is None else own.size), (-1, 1)):
            other = [each.copy().astype(np.int64) for each in said]
            other[n][r] = np.clip(other[n][r] + change, 0, 15)
            least = np.minimum(np.minimum(other[0][:, None, None], other[1][:, None]), other[2]).astype(np.uint8)
            assert taken <= 1.001 * code_bits(z, np.broadcast_to(least, z.shape)).sum()


def test_a_core_that_float16_rounds_up_is_found_again() -> None:
    """There is no code for 2^15; float16 reads that of 2^15 - 1 as the same."""
    core = from_whole(np.array([MOST - 1]), np.array([3], np.uint8))
    assert int(whole(core, np.array([3], np.uint8))[0]) == MOST
