"""What comes out of arrays in any layout: rows of modes, how large their numbers are; and what it takes in memory."""

from __future__ import annotations

from itertools import pairwise
from math import prod
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hmkcta import _native
from hmkcta.backends import native, reference
from hmkcta.metrics import squared_norm


@st.composite
def arrays_in_modes(draw: st.DrawFn) -> tuple[NDArray[Any], list[list[int]], list[NDArray[np.intp]]]:
    """An array of any type, layout and order, its axes in some modes, and some rows of each."""
    shape = draw(st.lists(st.integers(1, 7), min_size=1, max_size=5))
    dtype = draw(st.sampled_from(["f4", ">f4", "f8", "f2", "u1", "i2", "i8", "?", "c16"]))
    array = np.random.default_rng(draw(st.integers(0, 99))).integers(0, 99, [2 * size for size in shape]).astype(dtype)
    array = array.transpose(draw(st.permutations(range(array.ndim))))
    array = array[tuple(slice(None, None, draw(st.sampled_from([1, 2, -1, -2]))) for _ in shape)]
    order, cuts = draw(st.permutations(range(array.ndim))), draw(st.sets(st.integers(1, array.ndim)))
    bounds = sorted({0, array.ndim} | cuts)
    modes = [order[a:b] for a, b in pairwise(bounds)]
    sizes = [prod(array.shape[axis] for axis in mode) for mode in modes]
    rows = [np.array(draw(st.lists(st.integers(0, size - 1), max_size=12)), np.intp) for size in sizes]
    return array, [list(mode) for mode in modes], rows


@settings(max_examples=200, deadline=None)
@given(arrays_in_modes(), st.sampled_from([None, 0.5]))
def test_rows_of_an_array_in_any_layout_are_collected(
    given: tuple[NDArray[Any], list[list[int]], list[NDArray[np.intp]]], factor: float | None
) -> None:
    array, modes, rows = given
    factor = factor if array.dtype == np.float32 else None
    sizes = [prod(array.shape[axis] for axis in mode) for mode in modes]
    tensor = array.transpose([axis for mode in modes for axis in mode]).reshape(sizes)
    for backend in (native, reference):
        out = np.empty([len(chosen) for chosen in rows], array.dtype)
        backend.collect(array, modes, rows, out, factor)
        assert np.array_equal(out, tensor[np.ix_(*rows)] * (factor or np.array(1, array.dtype)))


def test_rows_outside_an_array_are_refused() -> None:
    array, out = np.zeros((4, 5), np.float32), np.zeros(1, np.float32)
    for offset in (-1, 20):
        with pytest.raises(ValueError, match="lead out of an array of 0 to 19"):
            _native.collect_scaled((array, out), [np.array([offset])], 1.0)
    with pytest.raises(ValueError, match="out must hold 2"):
        _native.collect_scaled((array, out), [np.array([0, 1])], 1.0)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(width=32, allow_subnormal=False), max_size=100))
def test_magnitudes_are_those_of_numpy(numbers: list[float]) -> None:
    values = np.array(numbers, np.float32)
    squares, largest, smallest = native.magnitudes(values)
    if not np.isfinite(values).all():
        assert not np.isfinite(squares)
        return
    assert squares == pytest.approx(squared_norm(values), rel=1e-12)
    assert (largest, smallest) == reference.magnitudes(values)[1:]
