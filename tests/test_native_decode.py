"""The native decoder and its readable twin give the same, on any model, and threads change nothing."""

from __future__ import annotations

import gc
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hmkcta import backends
from hmkcta.axes import name_axes
from hmkcta.backends import decoding, native
from hmkcta.decode import decode_block, decode_elements, dense, scattered
from hmkcta.errors import HmkctaError
from hmkcta.model import Model
from hmkcta.model import open as open_model
from hmkcta.packed import PackedLevel
from random_models import Shapes, random_model

Levels = Sequence[PackedLevel]

#: Ranks with unrolled loops and without, ranks beyond one vector, many choices of clusters, undecomposed modes.
#: Blocks of a grid, below one cut or two, below a level; with ranks and undecomposed modes of their own.
LARGER: dict[str, tuple[Any, ...]] = {
    "paper": ((40, 20, 50, 60), 3, (), Shapes(3, 2, 3, 24, 0.05, 0.05)),
    "high ranks": ((30, 40, 50), 1, (), Shapes(1, 1, 40)),
    "lanes of eight": ((12, 14, 9, 11), 2, (), Shapes(2, 2, 7, 4)),
    "time first": ((9, 30, 28, 26), 2, (0,), Shapes(3, 3, 3, 18)),
    "time last": ((30, 28, 26, 9), 2, (3,), Shapes(3, 3, 3, 18)),
    "time in the middle": ((30, 28, 9, 26), 3, (2,), Shapes(3, 2, 3, 18)),
    "clustered pca": ((90, 400), 2, (0,), Shapes(6, 3, 5)),
    "many clusters": ((40, 30, 50), 1, (), Shapes(8, 3, 3, 400)),
    "one mode": ((5000,), 3, (), Shapes(5)),
    "own undecomposed modes": ((30, 28, 9, 26), 3, (), Shapes(3, 2, 3, 18, own=0.3)),
    "blocks": ((48, 40, 36), 2, (), Shapes(6, 1, 4, 400, own=0.3), (1,)),
    "plain blocks": ((48, 40, 36), 3, (), Shapes(1, 1, 5, 400, own=0.3), (1, 2)),
    "blocks of merged axes": ((1200, 3, 24), 2, (1,), Shapes(9, 1, 4, 400, own=0.2), (1,)),
    "blocks below a level": ((48, 40, 36), 3, (), Shapes(3, 2, 3, 27, own=0.2), (2,)),
    "cuts here and there": ((30, 28, 26), 4, (), Shapes(3, 2, 3, 18, cut=0.4, own=0.3)),
    "six modes": ((5, 6, 4, 7, 5, 6), 2, (), Shapes(2, 2, 2, 16)),
}


@st.composite
def models(draw: st.DrawFn) -> tuple[tuple[int, ...], Levels]:
    """Random models of order 1 to 7 with one to three levels, undecomposed modes, per-node shapes."""
    order = draw(st.integers(1, 7))
    most = (60, 20, 9, 7, 5, 4, 3)[order - 1]
    sizes = tuple(draw(st.lists(st.integers(1, most), min_size=order, max_size=order)))
    undecomposed = tuple(n for n in range(order) if draw(st.integers(0, 5)) == 0)
    shapes = Shapes(draw(st.integers(1, 4)), draw(st.integers(1, 3)), draw(st.integers(1, 9 if order < 4 else 4)),
                    draw(st.sampled_from([1, 4, 12, 30])))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    depth = draw(st.integers(1, 3))
    shapes = replace(shapes, cut=draw(st.sampled_from([0.0, 0.3])), own=draw(st.sampled_from([0.0, 0.3])))
    cuts = [stage for stage in range(1, depth) if draw(st.integers(0, 3)) == 0]
    return sizes, random_model(rng, sizes, depth, undecomposed, shapes=shapes, cuts=cuts)[1]


def some_model(name: str) -> tuple[tuple[int, ...], Levels]:
    sizes, depth, undecomposed, shapes, *cuts = LARGER[name]
    rng = np.random.default_rng([*map(ord, name)])
    return sizes, random_model(rng, sizes, depth, undecomposed, shapes=shapes, cuts=cuts[0] if cuts else ())[1]


def assert_close(found: NDArray[Any], expected: NDArray[Any], relative: float) -> None:
    assert found.dtype == expected.dtype or expected.dtype == np.float64
    # Terms are about 1; a few elements alone may be what is left where they cancel.
    largest = max(0.05, float(np.abs(expected).max(initial=0)))
    np.testing.assert_allclose(found, expected, rtol=0, atol=relative * largest)


def check_elements(sizes: tuple[int, ...], levels: Levels, count: int, seed: int) -> None:
    """At every level, few elements (picked from float16) and many (widened), in both types."""
    rng = np.random.default_rng(seed)
    coords = np.stack([rng.integers(0, size, count) for size in sizes], axis=1).astype(np.intp)
    for upto in range(1, len(levels) + 1):
        expected = np.zeros(count)
        scattered.decode_batches(levels[:upto], coords, expected)
        for dtype, tolerance in ((np.float32, 1e-5), (np.float64, 1e-12)):
            found = np.zeros(count, dtype)
            decoding.decode_batches(levels[:upto], coords, found)
            assert_close(found, expected, tolerance)
            alone = np.zeros(1, dtype)
            decoding.decode_batches(levels[:upto], coords[:1], alone)
            np.testing.assert_array_equal(alone, found[:1])


def check_block(levels: Levels, rows: list[NDArray[np.intp]]) -> None:
    shape = [len(index) for index in rows]
    for upto in range(1, len(levels) + 1):
        expected = np.zeros(shape)
        dense.add_block(levels[:upto], rows, expected)
        found = np.zeros(shape, np.float32)
        decoding.add_block(levels[:upto], rows, found)
        assert_close(found, expected, 1e-5)
        for first in range(1, upto):
            decoding.add_block(levels[:upto], rows, found, first)
            dense.add_block(levels[:upto], rows, expected, first)
        assert_close(found, expected, 1e-5)


def some_rows(sizes: tuple[int, ...], seed: int) -> list[NDArray[np.intp]]:
    """Rows in any order, with repeats, of some modes only one."""
    rng = np.random.default_rng(seed)
    counts = [1 if rng.random() < 0.3 else int(rng.integers(1, size + 2)) for size in sizes]
    return [rng.integers(0, size, count) for size, count in zip(sizes, counts, strict=True)]


@settings(max_examples=150, deadline=None)
@given(models(), st.integers(0, 2**32 - 1))
def test_backends_agree(model: tuple[tuple[int, ...], Levels], seed: int) -> None:
    sizes, levels = model
    check_elements(sizes, levels, 37, seed)
    check_block(levels, [np.arange(size) for size in sizes])
    check_block(levels, some_rows(sizes, seed))


@pytest.mark.parametrize("name", LARGER)
def test_backends_agree_on_larger_models(name: str) -> None:
    sizes, levels = some_model(name)
    check_elements(sizes, levels, 5000, 1)
    check_block(levels, [np.arange(size) for size in sizes])
    check_block(levels, some_rows(sizes, 2))


@pytest.mark.parametrize("name", ["paper", "time first", "high ranks", "plain blocks", "blocks below a level"])
def test_threads_do_not_change_a_bit(name: str) -> None:
    sizes, levels = some_model(name)
    rng = np.random.default_rng(3)
    coords = np.stack([rng.integers(0, size, 30_000) for size in sizes], axis=1).astype(np.intp)
    outcomes: list[tuple[NDArray[Any], ...]] = []
    try:
        for threads in (1, 2, 5):
            native.set_threads(threads)
            elements, block = np.zeros(len(coords), np.float32), np.zeros(sizes, np.float32)
            decoding.decode_batches(levels, coords, elements)
            decoding.add_block(levels, [np.arange(size) for size in sizes], block)
            outcomes.append((elements, block))
    finally:
        native.set_threads(0)
    for elements, block in outcomes[1:]:
        np.testing.assert_array_equal(elements, outcomes[0][0])
        np.testing.assert_array_equal(block, outcomes[0][1])


def test_a_large_block_is_cut_into_runs() -> None:
    """More elements than a run has, of nodes with more than are put together at once."""
    sizes = (130, 9, 80, 100)
    shapes = Shapes(2, 2, 2, 4, 0.0, 0.0)
    _, levels = random_model(np.random.default_rng(4), sizes, 2, shapes=shapes)
    rows = [np.arange(size) for size in sizes]
    found = decode_block(levels, sizes, rows)
    part = [rows[0][3::40], rows[1], rows[2][::9], rows[3][::-7]]
    expected = np.zeros([len(index) for index in part])
    dense.add_block(levels, part, expected)
    assert_close(found[np.ix_(*part)], expected, 1e-5)


def test_the_environment_decides_who_decodes(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes, levels = some_model("paper")
    coords = np.zeros((1, 4), np.intp)
    with monkeypatch.context() as patch:
        patch.setattr(decoding, "decode_batches", None)
        with pytest.raises(TypeError):
            decode_elements(levels, sizes, coords)
        patch.setattr(backends, "name", "reference")
        assert decode_elements(levels, sizes, coords).shape == (1,)


@pytest.mark.parametrize("transform", [{"name": "identity"}, {"name": "log1p", "scale": 0.5}, {"name": "sqrt"}],
                         ids=lambda transform: str(transform["name"]))
def test_a_model_reads_the_same_with_either(transform: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """Merged axes, value transforms, slices, points, interpolation, reconstruction into float64."""
    axes = name_axes((4, 5, 6, 3), ["light", "y", "x", "rgb"])
    sizes = (12, 30)
    metadata, levels = random_model(np.random.default_rng(5), sizes, 2, axes=axes,
                                    organisation=(("light", "rgb"), ("y", "x")))
    model = Model(replace(metadata, transform=transform), levels)
    points = np.random.default_rng(6).uniform(0, [3, 4, 5, 2], (50, 4))

    def read() -> list[NDArray[Any]]:
        return [np.asarray(model), model[1, ::2], model[[0, 1], [2, 3], 4, 0], np.asarray(model[3, 4, 5, 2]),
                model.sample(points), model.reconstruct(np.empty(model.shape)), model.at_level(1)[:, 2]]

    found = read()
    monkeypatch.setattr(backends, "name", "reference")
    for own, expected in zip(found, read(), strict=True):
        assert_close(own, expected, 3e-5)


def test_large_numbers_overflow_to_what_a_caller_can_see() -> None:
    sizes, levels = some_model("high ranks")
    level = replace(levels[0], core_scale=np.full_like(levels[0].core_scale, 3e38),
                    core=np.full_like(levels[0].core, 65504))
    coords = np.zeros((9, 3), np.intp)
    assert not np.isfinite(decode_elements([level], sizes, coords)).any()
    assert np.isfinite(decode_elements([level], sizes, coords, dtype=np.float64)).all()


def broken(levels: Levels, **changes: Any) -> list[PackedLevel]:
    return [replace(levels[0], **changes), *levels[1:]]


def test_arrays_that_contradict_each_other_are_refused() -> None:
    """Models come from checked files; one made by hand must not read beyond its arrays."""
    sizes, levels = some_model("paper")
    first, coords = levels[0], np.array([[39, 19, 49, 59]], np.intp)
    clusters, local = np.full_like(first.cluster[0], 7), first.local[0]
    assert local is not None
    cases = [
        broken(levels, core=first.core[:-1]),
        broken(levels, part=(np.full_like(first.part[0], 99), *first.part[1:])),
        broken(levels, part=(None, *first.part[1:])),
        broken(levels, local=(local[:-1], *first.local[1:])),
        broken(levels, core_scale=first.core_scale[:-1]),
        broken(levels, basis=(first.basis[0][:-1], *first.basis[1:])),
        broken(levels, cluster=(clusters, *first.cluster[1:])),
        broken(levels, shape=np.where(np.arange(12).reshape(1, 3, 4) == 8, 0, first.shape).astype(np.uint32)),
        broken(levels, child=None if first.child is None else first.child + np.uint32(10**6)),
    ]
    for case in cases:
        with pytest.raises(HmkctaError, match="level-arrays"):
            decode_elements(case, sizes, coords)
        with pytest.raises(HmkctaError, match="level-arrays"):
            decode_block(case, sizes, [np.arange(size) for size in sizes])
    with pytest.raises(HmkctaError, match="level-arrays"):
        decoding.decode_batches([first, replace(first, row_offset=first.row_offset[:2])], coords, np.zeros(1))


def test_arrays_may_lie_anywhere() -> None:
    """Views with gaps and numbers that are not aligned, as a mapped file may have them."""
    sizes, levels = some_model("paper")
    coords = np.array([[1, 2, 3, 4], [39, 19, 49, 59]], np.intp)

    def moved(array: NDArray[Any]) -> NDArray[Any]:
        raw = np.zeros(array.nbytes + 1, np.uint8)
        view = raw[1:].view(array.dtype)
        view[:] = array
        return view

    level = levels[-1]
    wide = np.repeat(level.core, 2)[::2]
    strange = replace(level, core=wide, basis=tuple(map(moved, level.basis)))
    expected = decode_elements(levels, sizes, coords)
    np.testing.assert_array_equal(decode_elements([*levels[:-1], strange], sizes, coords), expected)


def test_the_arrays_of_a_level_are_flattened_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """To do it for every element took longer than to decode one; nothing is kept of a level that is gone."""
    sizes, levels = some_model("paper")
    decode_elements(levels, sizes, np.zeros((1, 4), np.intp))
    kept = len(decoding.flattened)
    monkeypatch.setattr(decoding, "_flat_arrays", pytest.fail)
    decode_block(levels, sizes, [np.array([1])] * 4)
    del levels
    gc.collect()
    assert len(decoding.flattened) == kept - 3


def test_a_file_that_something_writes_into_is_not_needed_once_it_is_open(tmp_path: Path) -> None:
    path = tmp_path / "a.hmk"
    for coded in (0.0, 1.0):
        Model(*random_model(np.random.default_rng(1), (12, 14, 9), 2, coded=coded)).save(path, overwrite=True)
        model, again = open_model(path), open_model(path)
        expected = model[...]
        with path.open("r+b") as file:
            file.write(b"\xff" * path.stat().st_size)
        np.testing.assert_array_equal(again[...], expected)
