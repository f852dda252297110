"""Batched kernels compute what the reference does, on NumPy and on arrays as strict as CuPy's, in bounded memory."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import partial
from itertools import pairwise, product
from math import prod
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import cupy_stand_in
from cupy_stand_in import StandIn
from hmkcta.backends import Kernels, batched, batches, reference
from hmkcta.backends.batched import Arrays
from hmkcta.backends.batches import MOST_PADDED, Batch, projection_batches, sweep_batches
from hmkcta.backends.cuda import arrays
from hmkcta.cells import Cells, dense_basis
from hmkcta.errors import HmkctaError
from hmkcta.fitting.search import all_products
from hmkcta.plan import LevelSpec
from test_kernels import (
    LARGE,
    SCALES,
    Node,
    check_same,
    check_scale,
    check_sweeps,
    close,
    energy,
    nodes,
    random_cells,
    smooth_data,
)

BUDGETS = (1, 100, 4000, 1 << 25)


def on_numpy(budget: int) -> Arrays:
    return Arrays(np, np.array, np.copyto, budget)


def on_stand_in(budget: int) -> Arrays:
    device = StandIn()
    return arrays(device, budget)


LIBRARIES = pytest.mark.parametrize("library", [on_numpy, on_stand_in], ids=["numpy", "stand-in"])
Library = Callable[[int], Arrays]


def kernels_of(on: Arrays) -> Kernels:
    """The batched kernels as a backend."""
    names = ("fit_cells", "accumulate", "project_cells", "project_pair", "dictionary_gram")
    return cast("Kernels", SimpleNamespace(**{name: partial(getattr(batched, name), on) for name in names}))


@LIBRARIES
@settings(max_examples=60, deadline=None)
@given(nodes(), st.sampled_from(BUDGETS))
def test_batched_is_as_the_reference(library: Library, node: Node, budget: int) -> None:
    check_same(*node, kernels_of(library(budget)))


@pytest.mark.parametrize(("sizes", "spec"), LARGE[2::3], ids=[str(sizes) for sizes, _ in LARGE[2::3]])
def test_batched_is_as_the_reference_on_large_nodes(sizes: tuple[int, ...], spec: LevelSpec) -> None:
    check_same(random_cells(sizes, spec, 1), smooth_data(sizes, 2), kernels_of(on_stand_in(1 << 16)))


def test_places_may_need_many_digits(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of tensors of more than 2^31 elements."""
    monkeypatch.setattr(batches, "NARROW", 0)
    spec = LevelSpec((2, 3, 2), (3, 4, 2), (1, 2, 1))
    cells = random_cells((9, 14, 8), spec, 6)
    assert sweep_batches(cells, 4000)[0].rows[0].dtype == np.int64
    check_same(cells, smooth_data((9, 14, 8), 6), kernels_of(on_stand_in(4000)))


@settings(max_examples=50, deadline=None)
@given(nodes(), st.integers(1, 3))
def test_no_sweep_raises_the_error(node: Node, iterations: int) -> None:
    check_sweeps(kernels_of(on_numpy(4000)), node, iterations)


@SCALES
def test_scale_does_not_matter(scale: float) -> None:
    check_scale(kernels_of(on_stand_in(4000)), scale)


def test_columns_that_depend_on_others_become_zero() -> None:
    """Data of rank one leaves nothing for a second column, and nothing that is not a number."""
    cells, data = random_cells((8, 9, 7), LevelSpec((3, 3, 3), (2, 1, 1), (1, 1, 1)), 5), np.ones((8, 9, 7), np.float32)
    cells.cores[:] = 0
    batched.fit_cells(on_stand_in(4000), cells, data, 3, 2)
    assert energy(data) < 1e-9 * data.size
    for n in range(3):
        lengths = np.linalg.norm(dense_basis(cells, n).astype(np.float64), axis=1)  # [PC, R_n]
        np.testing.assert_allclose(lengths, [[1, 0, 0]] * 2, atol=1e-6)


def test_cells_that_are_projected_together_get_their_own_numbers() -> None:
    """As close to the reference as each cell's numbers are large."""
    spec = LevelSpec((2, 3, 2), (3, 4, 2), (1, 2, 1))
    cells, data = random_cells((9, 14, 8), spec, 6), smooth_data((9, 14, 8), 6)
    for n in range(3):
        y = batched.project_cells(on_stand_in(1 << 25), cells, data, n)
        for found, expected in zip(y, reference.project_cells(cells, data, n), strict=True):
            close(found, expected, 1e-5)


# Batches


def elements_of(cells: Cells, number: int) -> set[tuple[int, ...]]:
    """The elements of a cell, by their places."""
    subset = np.unravel_index(number, cells.spec.clusters)
    rows = [np.flatnonzero((own == k).any(axis=1)) for own, k in zip(cells.members, subset, strict=True)]
    return set(product(*(map(int, own) for own in rows)))


def shallow(cells: Cells, data: reference.F32) -> bool:
    """Small enough to look at every element of every cell."""
    return data.size * prod(cells.spec.mixture) < 20_000


@settings(max_examples=100, deadline=None)
@given(nodes().filter(lambda node: shallow(*node)), st.sampled_from(BUDGETS))
def test_batches_keep_the_order_of_cells_that_share_elements(node: Node, budget: int) -> None:
    cells, _ = node
    found = sweep_batches(cells, budget)
    elements = {c: own for c in range(cells.spec.cells) if (own := elements_of(cells, c))}
    place = {int(c): number for number, batch in enumerate(found) for c in batch.numbers}
    assert sorted(place) == sorted(elements)
    assert sum(len(batch.numbers) for batch in found) == len(place)
    for first in place:
        for second in place:
            if first < second and elements[first] & elements[second]:
                assert place[first] < place[second]
    for batch in found:
        check_tables(cells, batch, elements)
        owned = sum(len(elements[int(c)]) for c in batch.numbers)
        padded = len(batch.numbers) * prod(batch.shape)
        assert len(batch.numbers) == 1 or (padded <= budget and padded <= MOST_PADDED * owned)


def check_tables(cells: Cells, batch: Batch, elements: dict[int, set[tuple[int, ...]]]) -> None:
    """Every element of every cell once, and nothing else but padding."""
    for b, c in enumerate(batch.numbers):
        rows = [own[b] for own in batch.rows]
        places = np.minimum(sum(np.ix_(*rows), np.zeros((), np.int64)).reshape(-1), batch.end)
        real = sorted(int(place) for place in places if place < batch.end)
        expected = sorted(int(np.ravel_multi_index(at, cells.sizes)) for at in elements[int(c)])
        assert real == expected
        assert batch.padded or len(real) == len(places)
        assert not batch.whole or len(real) == batch.end


@pytest.mark.parametrize(("mixture", "count"), [((1, 1, 1), 1), ((1, 2, 1), 3), ((2, 1, 1), 2), ((2, 2, 1), 6)])
def test_cells_that_share_nothing_go_together(mixture: tuple[int, ...], count: int) -> None:
    cells = random_cells((36, 36, 36), LevelSpec((2, 2, 2), (2, 3, 4), mixture), 7)
    for n, (clusters, k) in enumerate(zip(cells.spec.clusters, mixture, strict=True)):
        if k == 1:  # as large as the others
            cells.members[n] = (np.arange(36)[:, None] % clusters).astype(np.uint16)
    assert len(sweep_batches(cells, 1 << 25)) == count


def test_where_all_cells_meet_they_come_one_by_one_in_order() -> None:
    spec = LevelSpec((1, 1, 1, 1), (6, 5, 8, 8), (2, 2, 2, 2))
    found = sweep_batches(random_cells((180, 90, 200, 200), spec, 8), 1 << 25)
    assert [int(c) for batch in found for c in batch.numbers] == list(range(spec.cells))


def test_projections_read_a_block_once_for_all_cells_that_share_it() -> None:
    cells = random_cells((20, 21, 22), LevelSpec((2, 2, 2), (2, 3, 4), (1, 1, 2)), 9)
    for n in range(3):
        bundles = projection_batches(cells, [n], 1 << 25)
        found = np.concatenate([batch.numbers.reshape(-1) for batch in bundles])
        assert sorted(map(int, found)) == list(range(24))
        assert all(batch.numbers.shape[1] == cells.spec.clusters[n] for batch in bundles)


# Memory


def peak(budget: int) -> float:
    """Bytes on the device at most, for every float32 of the tensor, while a node of 64 equal cells is fitted."""
    device = StandIn()
    sizes = (32, 32, 32, 16)
    spec = LevelSpec((2, 2, 2, 2), (2, 2, 4, 4), (1, 1, 1, 1))
    cells, data = random_cells(sizes, spec, 10), smooth_data(sizes, 10)
    on = arrays(device, budget)
    batched.fit_cells(on, cells, data, 1, 2)
    batched.accumulate(on, cells, data, 1.0)
    for n in range(4):
        batched.project_cells(on, cells, data, n)
    assert device.memory.used == 0, "something stays on the device"
    return device.memory.peak / data.nbytes


def test_batches_bound_the_memory() -> None:
    """Beside the tensor there are a batch's blocks, six times its elements at most."""
    peaks = [peak(budget) for budget in (1 << 14, 1 << 17, 1 << 25)]
    assert all(small < large for small, large in pairwise(peaks))
    assert peaks[0] < 1.5
    assert peaks[2] < 7.5


def test_a_projection_on_two_modes_is_on_the_device() -> None:
    cells = random_cells((32, 32, 32, 16), LevelSpec((2, 2, 4, 4), (2, 2, 4, 4), (1, 1, 1, 1)), 10)
    data = smooth_data(cells.sizes, 10)
    for budget in (1 << 10, 1 << 25):
        device = StandIn()
        found = batched.project_pair(arrays(device, budget), cells, data, (2, 3))
        assert device.memory.peak < data.nbytes + 2 * found.nbytes + 24 * min(budget, data.size)
        assert device.memory.used == 0


def test_grams_are_made_in_parts() -> None:
    cells = random_cells((30, 30, 30), LevelSpec((2, 2, 2), (4, 4, 4), (1, 1, 1)), 11)
    device = StandIn()
    whole = 8 * cells.spec.cells**2 * prod(cells.ranks)
    batched.dictionary_gram(arrays(device, 1 << 12), cells, all_products(cells), 0)
    assert device.memory.peak < whole / 2


# Strictness


def test_wrong_shapes_are_refused() -> None:
    cells, data = random_cells((6, 5), LevelSpec((2, 2), (2, 1), (1, 1)), 9), smooth_data((5, 6), 9)
    on = on_numpy(4000)
    calls: list[Callable[[], object]] = [
        lambda: batched.accumulate(on, cells, data, 1.0), lambda: batched.fit_cells(on, cells, data, 1, 1),
        lambda: batched.project_cells(on, cells, data, 0),
    ]  # fmt: skip
    for call in calls:
        with pytest.raises(HmkctaError, match="wrong-shape"):
            call()


def test_the_stand_in_is_strict() -> None:
    device: Any = StandIn()
    host: Any = np.ones((2, 3), np.float32)
    array: Any = device.array(host)
    mistakes: list[Callable[[], Any]] = [
        lambda: np.asarray(array), lambda: np.sqrt(array), lambda: np.sum(array),
        lambda: np.concatenate([array, array]), lambda: array + host, lambda: host * array,
        lambda: array[np.array([0])], lambda: array.__setitem__(slice(None), host), lambda: device.take(host, array),
        lambda: np.matmul(array, host), lambda: float(array), lambda: list(array), lambda: host.__setitem__(0, array),
    ]  # fmt: skip
    for mistake in mistakes:
        with pytest.raises(TypeError):
            mistake()
    np.testing.assert_array_equal(device.asnumpy(2.0 * array + array), 3 * host)


def test_cupy_has_what_the_stand_in_has() -> None:
    cupy = pytest.importorskip("cupy", reason="CuPy is not installed: nothing to compare the stand-in with")
    for name, arguments in cupy_stand_in.FUNCTIONS.items():
        function = getattr(cupy, name)
        if arguments:
            assert set(arguments) <= set(inspect.signature(function).parameters), name
    own = {name for name, value in vars(StandIn).items() if inspect.isfunction(value) and not name.startswith("_")}
    assert own == set(cupy_stand_in.FUNCTIONS)
    for name in ("reshape", "transpose", "astype", "get"):
        assert callable(getattr(cupy.ndarray, name))
    for name in ("getDeviceCount", "runtimeGetVersion", "memGetInfo", "getDeviceProperties"):
        assert callable(getattr(cupy.cuda.runtime, name))
    assert cupy.cuda.memory.OutOfMemoryError.__module__.startswith("cupy")
