"""The reference decoder against a plain loop over the elements (`literal_decode.py`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import prod
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hmkcta import backends
from hmkcta.decode import decode_block, decode_elements, dense, scattered
from hmkcta.errors import HmkctaError
from hmkcta.packed import PackedLevel, level_ends
from literal_decode import element
from random_models import Shapes, random_model

Levels = Sequence[PackedLevel]

#: Blocks: nodes with ranks and undecomposed modes of their own, most of one cell.
BLOCKS = Shapes(1, 1, 4, own=0.4)
#: Mode sizes, stages, undecomposed modes, node shapes, and the stages that are cuts: the paper's family from PCA to
#: hierarchies, blocks of a grid, and odd corners.
MODELS: dict[str, tuple[Any, ...]] = {
    "three levels": ((7, 6, 5, 8), 3, (), Shapes(max_clusters=3)),
    "dense tree": ((9, 8, 7), 3, (), Shapes(max_clusters=3, max_cells=18, zero=0.0, leaf=0.0)),
    "pca": ((20, 6), 1, (1,), Shapes(max_clusters=1)),
    "clustered pca": ((6, 30), 2, (0,), Shapes(max_clusters=6, max_mixture=3)),
    "time in the middle": ((6, 4, 7), 3, (1,), Shapes()),
    "two undecomposed": ((3, 7, 4), 2, (0, 2), Shapes()),
    "nothing decomposed": ((3, 4), 2, (0, 1), Shapes()),
    "one mode": ((23,), 3, (), Shapes(max_clusters=4)),
    "sizes of one": ((1, 5, 1), 2, (), Shapes()),
    "hosvd": ((9, 8, 7), 1, (), Shapes(max_clusters=1, max_rank=7)),
    "flat, many clusters": ((16, 12, 10), 1, (), Shapes(max_clusters=8, max_mixture=3, max_cells=200)),
    "own undecomposed modes": ((7, 6, 5), 3, (), Shapes(own=0.4)),
    "blocks": ((12, 10, 9), 2, (), replace(BLOCKS, max_clusters=4, max_cells=64), (1,)),
    "blocks of blocks": ((12, 10, 9), 3, (), replace(BLOCKS, max_clusters=3), (1, 2)),
    "blocks below a level": ((12, 10, 9), 3, (), Shapes(2, 2, 3, own=0.2), (2,)),
    "blocks of merged axes": ((36, 3, 20), 2, (1,), replace(BLOCKS, max_clusters=5, max_cells=36), (1,)),
    "cuts here and there": ((9, 8, 7), 4, (), Shapes(2, 2, 3, cut=0.4, own=0.3)),
    "many clusters in the last mode": ((5, 60), 1, (), Shapes(max_clusters=40, max_cells=80)),
}


@pytest.fixture(autouse=True)
def _the_readable_decoder(monkeypatch: pytest.MonkeyPatch) -> None:
    """The twin of the native kernels, which tests/test_native_decode.py holds against it."""
    monkeypatch.setattr(backends, "name", "reference")


def slow_tensor(levels: Levels, sizes: Sequence[int], upto: int) -> NDArray[np.float64]:
    """Up to a stage."""
    return np.array([element(levels, index, upto) for index in np.ndindex(*sizes)]).reshape(sizes)


def every_index(sizes: Sequence[int]) -> NDArray[np.intp]:
    return np.stack(np.unravel_index(np.arange(prod(sizes)), sizes), axis=1)


def assert_close(found: NDArray[Any], expected: NDArray[Any], relative: float = 1e-5) -> None:
    assert found.shape == expected.shape
    largest = max(1e-30, float(np.abs(expected).max(initial=0)))
    np.testing.assert_allclose(found, expected, rtol=0, atol=relative * largest)


def some_model(name: str, seed: int = 0) -> tuple[tuple[int, ...], Levels]:
    sizes, depth, undecomposed, shapes, *cuts = MODELS[name]
    rng = np.random.default_rng([seed, *map(ord, name)])
    return sizes, random_model(rng, sizes, depth, undecomposed, shapes=shapes, cuts=cuts[0] if cuts else ())[1]


@pytest.mark.parametrize("name", MODELS)
def test_elements_and_block_equal_the_plain_loop_at_every_level(name: str) -> None:
    for seed in range(2):
        sizes, levels = some_model(name, seed)
        for upto, stages in enumerate(level_ends(levels), 1):
            expected = slow_tensor(levels, sizes, stages)
            assert np.abs(expected).max() > 0
            elements = decode_elements(levels, sizes, every_index(sizes), upto)
            assert elements.dtype == np.float32
            assert_close(elements.reshape(sizes), expected)
            assert_close(decode_block(levels, sizes, [np.arange(size) for size in sizes], upto), expected)
            exact = decode_elements(levels, sizes, every_index(sizes), upto, dtype=np.float64)
            assert_close(exact.reshape(sizes), expected, 1e-12)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("way", ["nodes one by one", "elements", "small tiles"])
def test_every_way_to_decode_a_block_gives_the_same(name: str, way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if way == "elements":
        monkeypatch.setattr(dense, "_PLAIN_NS", np.inf)
        monkeypatch.setattr(dense, "_CELL_NS", np.inf)
    else:
        monkeypatch.setattr(dense, "_PLAIN_NS", 0.0)
        monkeypatch.setattr(dense, "_CELL_NS", 0.0)
    if way == "small tiles":
        monkeypatch.setattr(dense, "TILE", 40)
        monkeypatch.setattr(dense, "BATCH", 50)
        monkeypatch.setattr("hmkcta.decode.cells.STEP", 1)
        monkeypatch.setattr("hmkcta.decode.cells.DENSE", 0)
    sizes, levels = some_model(name, 6)
    rng = np.random.default_rng(3)
    rows = [rng.integers(0, size, size + 2) for size in sizes]
    expected = decode_elements(levels, sizes, every_index(sizes), dtype=np.float64).reshape(sizes)[np.ix_(*rows)]
    assert_close(decode_block(levels, sizes, rows), expected)


@pytest.mark.parametrize("name", ["dense tree", "hosvd", "time in the middle", "flat, many clusters"])
@pytest.mark.parametrize("way", ["gathered", "shared", "few"])
def test_every_way_to_contract_a_core_gives_the_same(name: str, way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes, levels = some_model(name, 1)
    coords = np.random.default_rng(4).permutation(every_index(sizes))
    expected = decode_elements(levels, sizes, coords, dtype=np.float64)
    monkeypatch.setattr(scattered, "FEW", 10**9 if way == "few" else 0)
    monkeypatch.setattr(scattered, "PRODUCT_COST", -(10**9) if way == "shared" else 10**12)
    monkeypatch.setattr(scattered, "SORT_WORTH", 1 if way == "shared" else 10**9)
    monkeypatch.setattr(scattered, "BATCH", 100)
    monkeypatch.setattr(scattered, "CHUNK_NUMBERS", 500)
    assert_close(decode_elements(levels, sizes, coords), expected)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), data=st.data())
def test_blocks_of_any_rows_equal_the_elements(seed: int, data: st.DataObject) -> None:
    rng = np.random.default_rng(seed)
    sizes = tuple(data.draw(st.lists(st.integers(1, 9), min_size=1, max_size=4)))
    undecomposed = [n for n in range(len(sizes)) if rng.random() < 0.2]
    depth = data.draw(st.integers(1, 3))
    coded = data.draw(st.sampled_from([0.0, 0.5, 1.0]))
    shapes, cuts = data.draw(st.sampled_from([(Shapes(), ()), (Shapes(cut=0.3, own=0.3), ()), (BLOCKS, (1,))]))
    cuts = cuts if depth > 1 else ()
    _, levels = random_model(rng, sizes, depth, undecomposed, coded=coded, shapes=shapes, cuts=cuts)
    rows = [np.array(data.draw(st.lists(st.integers(0, size - 1), max_size=6)), np.int16) for size in sizes]
    coords = np.stack([axis.reshape(-1) for axis in np.meshgrid(*rows, indexing="ij")], axis=1)
    expected = decode_elements(levels, sizes, coords, dtype=np.float64).reshape([len(index) for index in rows])
    assert_close(decode_block(levels, sizes, rows), expected)


def test_a_few_of_many_small_nodes() -> None:
    """Thousands of nodes with one cluster each: batched where equal, element by element where not."""
    shapes = Shapes(max_clusters=6, max_cells=1296, max_mixture=1, max_rank=2, zero=0.1, leaf=0.0)
    rng = np.random.default_rng(12)
    sizes = (40, 12, 24)
    _, upper = random_model(rng, sizes, 3, shapes=shapes)
    assert upper[2].nodes > 500
    rows = [np.arange(size) for size in sizes]
    expected = decode_elements(upper, sizes, every_index(sizes), dtype=np.float64).reshape(sizes)
    assert_close(decode_block(upper, sizes, rows), expected)
    assert_close(decode_block(upper, sizes, [rows[0][5:6], rows[1], rows[2][::-3]]), expected[5:6, :, ::-3])


def test_out_is_overwritten_and_returned() -> None:
    sizes, levels = some_model("dense tree")
    rows = [np.arange(size) for size in sizes]
    expected = decode_block(levels, sizes, rows)
    for out in (np.full(sizes, 9, np.float32), np.full(sizes[::-1], 9, np.float64).T):
        assert decode_block(levels, sizes, rows, out=out) is out
        assert_close(out, expected)


def test_nothing_asked_nothing_given() -> None:
    sizes, levels = some_model("dense tree")
    assert decode_elements(levels, sizes, np.empty((0, 3), np.intp)).shape == (0,)
    assert decode_block(levels, sizes, [np.arange(2), np.empty(0, np.intp), np.arange(1)]).shape == (2, 0, 1)


def test_large_numbers_overflow_to_what_a_caller_can_see() -> None:
    """Cores at the end of float16 times scales at the end of float32: infinite in float32, finite in float64."""
    sizes, levels = some_model("hosvd")
    level = replace(levels[0], core_scale=np.full_like(levels[0].core_scale, 3e38),
                    core=np.full_like(levels[0].core, 65504))
    assert not np.isfinite(decode_elements([level], sizes, every_index(sizes))).all()
    assert np.isfinite(decode_elements([level], sizes, every_index(sizes), dtype=np.float64)).all()


BAD_COORDS: list[tuple[Any, str]] = [
    (np.zeros((2, 2), np.intp), "coords-shape"), (np.zeros(3, np.intp), "coords-shape"),
    (np.zeros((2, 3)), "index-type"), (np.zeros((2, 3), np.bool_), "index-type"),
    (np.array([[0, 0, 7]]), "index-out-of-range"), (np.array([[0, -1, 0]]), "index-out-of-range"),
]


@pytest.mark.parametrize(("coords", "reason"), BAD_COORDS)
def test_bad_coords_are_refused(coords: NDArray[Any], reason: str) -> None:
    sizes, levels = some_model("dense tree")
    with pytest.raises(HmkctaError) as caught:
        decode_elements(levels, sizes, coords)
    assert caught.value.reason == reason


def test_a_level_that_is_not_there_is_refused_before_anything_is_written() -> None:
    sizes, levels = some_model("dense tree")
    out = np.full((3, 3, 3), 7.0, np.float32)
    with pytest.raises(HmkctaError, match="level"):
        decode_block(levels, sizes, [np.arange(3)] * 3, upto=9, out=out)
    assert (out == 7).all()
    with pytest.raises(HmkctaError, match="level"):
        decode_elements(levels, sizes, np.empty((0, 3), np.intp), upto=9)


BAD_ROWS: list[tuple[Any, dict[str, Any], str]] = [
    ([np.arange(3)], {}, "rows-count"),
    ([np.arange(3), np.arange(4).reshape(2, 2), np.arange(2)], {}, "rows-shape"),
    ([np.arange(3), np.array([8]), np.arange(2)], {}, "index-out-of-range"),
    ([np.arange(3), np.array([0.5]), np.arange(2)], {}, "index-type"),
    ([np.arange(3)] * 3, {"out": np.empty((3, 3, 2), np.float32)}, "out-shape"),
    ([np.arange(3)] * 3, {"out": np.empty((3, 3, 3), np.int32)}, "dtype"),
    ([np.arange(3)] * 3, {"upto": 4}, "level-out-of-range"),
    ([np.arange(3)] * 3, {"upto": 0}, "level-out-of-range"),
]


@pytest.mark.parametrize(("rows", "options", "reason"), BAD_ROWS)
def test_bad_rows_are_refused(rows: Any, options: dict[str, Any], reason: str) -> None:
    sizes, levels = some_model("dense tree")
    with pytest.raises(HmkctaError) as caught:
        decode_block(levels, sizes, rows, **options)
    assert caught.value.reason == reason
