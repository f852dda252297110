"""The model as an array: NumPy's indexing on the dense reconstruction is the measure of every key."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import isnan, prod
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from numpy.typing import NDArray

from hmkcta import model as model_module
from hmkcta.axes import Organisation, name_axes, organise, separate
from hmkcta.decode import decode_elements
from hmkcta.errors import HmkctaError, Kind
from hmkcta.model import Model
from hmkcta.model import open as open_model
from hmkcta.support import memory
from hmkcta.support.memory import available_memory
from hmkcta.transform import Transform
from random_models import Shapes, random_model

SHAPE = (6, 5, 1, 7)
NAMES = ("light", "y", "rgb", "x")
ORGANISATIONS: list[Organisation] = [
    separate(name_axes(SHAPE, NAMES)),
    (("light", "rgb"), ("y", "x")),
    (("x",), ("rgb", "y"), ("light",)),
    (("x", "light", "y", "rgb"),),
]


def make_model(organisation: Organisation, shape: Sequence[int] = SHAPE, seed: int = 0, levels: int = 2,
               undecomposed: Sequence[int] = ()) -> Model:
    axes = name_axes(shape, NAMES[: len(shape)])
    size = {axis.name: axis.size for axis in axes}
    sizes = [prod(size[name] for name in mode) for mode in organisation]
    metadata, packed = random_model(np.random.default_rng(seed), sizes, levels, undecomposed, axes=axes,
                                    organisation=organisation, shapes=Shapes(zero=0.05, leaf=0.05))
    return Model(metadata, packed)


def dense(model: Model) -> NDArray[np.float64]:
    """The tensor in float64, element by element, put back into source axes by a route of its own."""
    metadata = model.metadata
    number = organise(np.arange(model.size).reshape(model.shape), metadata.axes, metadata.organisation)
    coords = np.stack(np.unravel_index(np.arange(number.size), number.shape), axis=1)
    flat = np.empty(model.size)
    flat[number.reshape(-1)] = decode_elements(model.levels, number.shape, coords, dtype=np.float64)
    return flat.reshape(model.shape)


MODELS = [make_model(organisation, seed=n) for n, organisation in enumerate(ORGANISATIONS)]
MODELS.append(make_model(ORGANISATIONS[2], seed=9, undecomposed=(0,)))
DENSE = [dense(model) for model in MODELS]


def assert_same(found: Any, expected: Any, scale: float = 1.0) -> None:
    assert found.dtype == np.float32
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-5 * max(scale, float(np.abs(expected).max(initial=0))))


def advanced_keys(shape: tuple[int, ...]) -> st.SearchStrategy[Any]:
    """Tuples of anything NumPy takes, some beyond the range or the order."""
    array = npst.arrays(np.int64, npst.array_shapes(min_dims=1, max_dims=2, max_side=3), elements=st.integers(-5, 5))
    item = st.one_of(st.integers(-6, 6), npst.basic_indices(shape[:1], allow_ellipsis=False), array,
                     st.lists(st.integers(-5, 4), max_size=3), st.just(...), st.none(), st.slices(6),
                     *(npst.arrays(np.bool_, shape[i:j]) for i in range(4) for j in range(i + 1, 5)))
    return st.lists(item, max_size=5).map(tuple)


#: What decides how elements are decoded that several modes' indices share.
WAYS: dict[str, dict[str, int]] = {
    "elements": {"_BLOCK_WORTH": 512},
    "blocks": {"_BLOCK_WORTH": 1, "_AROUND_BLOCKS": 0, "_AROUND_ELEMENTS": 0},
    "around": {"_BLOCK_WORTH": 1},
}


@settings(max_examples=250, deadline=None)
@given(which=st.integers(0, len(MODELS) - 1), key=advanced_keys(SHAPE), way=st.sampled_from(sorted(WAYS)))
@example(0, (slice(None), [0, 1], ..., [0, 0], slice(None)), "blocks")  # an empty ellipsis parts index arrays
@example(0, ([0, 1], slice(None), 0, [1, 2]), "elements")  # so do slices, and an integer is an index array
@example(1, np.zeros(SHAPE, np.bool_), "around")
@example(0, (2**70,), "blocks")
@example(0, (slice(None), [], [9]), "elements")  # NumPy looks at no index that broadcasting leaves nothing of,
@example(0, (slice(None), [], 9), "elements")  # but at integers
def test_indexing_is_numpys(which: int, key: Any, way: str) -> None:
    model, reference = MODELS[which], DENSE[which]
    try:
        expected = reference[key]
    except IndexError:
        with pytest.raises(IndexError) as caught:
            model[key]
        assert isinstance(caught.value, HmkctaError)
        return
    with pytest.MonkeyPatch.context() as patch:
        for name, value in WAYS[way].items():
            patch.setattr(model_module, name, value)
        assert_same(model[key], np.asarray(expected), float(np.abs(reference).max()))


@settings(max_examples=100, deadline=None)
@given(which=st.integers(0, len(MODELS) - 1), key=npst.basic_indices(SHAPE, allow_newaxis=True))
def test_slicing_is_numpys(which: int, key: Any) -> None:
    assert_same(MODELS[which][key], np.asarray(DENSE[which][key]), float(np.abs(DENSE[which]).max()))


@settings(max_examples=50, deadline=None)
@given(which=st.integers(0, len(MODELS) - 1), key=npst.integer_array_indices(SHAPE, result_shape=npst.array_shapes()))
def test_points_are_numpys(which: int, key: Any) -> None:
    assert_same(MODELS[which][key], DENSE[which][key], float(np.abs(DENSE[which]).max()))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.uint32, np.uint64, np.int8])
def test_index_arrays_are_of_any_integers(dtype: type[np.integer[Any]]) -> None:
    index = np.array([[4, 0], [1, 4]], dtype)
    assert_same(MODELS[0][index, index[0]], DENSE[0][index, index[0]], float(np.abs(DENSE[0]).max()))
    with pytest.raises(IndexError, match="index-out-of-range"):
        MODELS[0][index + dtype(100)]


def test_an_index_that_is_one_bool_is_called_so() -> None:
    """NumPy makes an axis of it."""
    for key in (True, (..., np.True_), (..., np.array(True))):
        with pytest.raises(IndexError, match=r"a lone bool, True, .* None for a new axis"):
            MODELS[0][key]


@pytest.mark.parametrize("key", [True, np.True_, np.array(True), 1.5, "x", np.zeros(3), [0, [1, 2]], (..., ...),
                                 (0,) * 5, 6, [-7], np.ones(5, np.bool_), ([0, 1], [0, 1, 2]), (None,) * 70], ids=repr)
def test_bad_keys_are_index_errors(key: Any) -> None:
    with pytest.raises(IndexError) as caught:
        MODELS[0][key]
    assert isinstance(caught.value, HmkctaError)
    assert caught.value.kind is Kind.INVALID_ARGUMENT


def test_the_system_is_not_asked_for_memory_for_an_element(monkeypatch: pytest.MonkeyPatch) -> None:
    """That takes longer than to decode it."""
    monkeypatch.setattr(memory, "available_memory", lambda: 0)
    assert MODELS[0][5, -1, 0, 2] == pytest.approx(DENSE[0][5, -1, 0, 2])


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[list[int]]:
    """Rows of each mode of every block that is decoded from now on; single elements must not be."""
    blocks: list[list[int]] = []
    original = model_module.decode_block

    def spy(levels: Any, sizes: Any, rows: Any, **options: Any) -> Any:
        blocks.append([len(index) for index in rows])
        return original(levels, sizes, rows, **options)

    monkeypatch.setattr(model_module, "decode_block", spy)
    monkeypatch.setattr(model_module, "decode_elements", None)
    return blocks


def test_only_what_is_asked_for_is_decoded(asked: list[list[int]]) -> None:
    """A slice is one block of its own size; points of an outer product never become coordinates."""
    model = make_model((("light", "rgb"), ("y", "x")))
    _ = model[2:4, :, 0, 5]
    _ = model[np.ix_([0, 3, 1], [4, 0], [0], [1, 2])]
    _ = model[1]
    assert asked == [[2, 5], [3, 4], [1, 35]]


def test_large_results_are_decoded_in_slabs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_module, "_SLAB", 20)
    monkeypatch.setattr(model_module, "_SCATTERED", 7)
    for model, reference in zip(MODELS, DENSE, strict=True):
        assert_same(model[...], reference)
        assert_same(model[::-1, :, 0, [[0, 1], [6, 2]]], reference[::-1, :, 0, [[0, 1], [6, 2]]])
        mask = reference > 0
        assert_same(model[mask], reference[mask])
        with monkeypatch.context() as patch:
            patch.setattr(model_module, "_BLOCK_WORTH", 1)
            assert_same(model[mask], reference[mask])


def test_elements_that_nearly_fill_a_block_are_taken_out_of_it(asked: list[list[int]]) -> None:
    """One by one, or in a block for each pixel of a region, they would take ten times as long and more."""
    model = make_model((("light",), ("y",), ("x", "rgb")), (12, 30, 20, 3))
    reference, disk = dense(model), np.hypot(*np.mgrid[-15:15, -10:10]) < 9
    assert_same(model[reference > 0], reference[reference > 0])
    assert_same(model[:, disk], reference[:, disk])
    assert_same(model[2:6, disk, 1], reference[2:6, disk, 1])
    assert asked == [[12, 30, 60], [12, 17, 51], [4, 17, 17]]


def test_whole_array() -> None:
    model, reference = MODELS[1], DENSE[1]
    assert_same(np.asarray(model), reference)
    assert np.asarray(model, np.float64).dtype == np.float64
    assert float(np.mean(model)) == pytest.approx(reference.mean(), abs=1e-5)  # pyright: ignore
    assert_same(np.stack(list(model)), reference)
    with pytest.raises(ValueError, match="copy"):
        model.__array__(copy=False)  # which NumPy 2 calls for `np.array(model, copy=False)`


def test_reconstruct_into_an_array(tmp_path: Path) -> None:
    model, reference = MODELS[0], DENSE[0]
    mapped = np.memmap(tmp_path / "out.raw", ">f8", "w+", shape=SHAPE)
    assert model.reconstruct(mapped) is mapped
    np.testing.assert_allclose(mapped, reference, atol=1e-5 * np.abs(reference).max())
    assert_same(model.reconstruct(), reference)
    whole = np.empty(SHAPE, np.int16)
    assert model.reconstruct(whole) is whole
    np.testing.assert_allclose(whole, reference, atol=0.51)
    fixed = np.broadcast_to(np.float32(0), SHAPE)
    for out in (np.empty(SHAPE[1:], np.float32), np.empty(SHAPE, np.complex64), np.empty(SHAPE, "U3"), fixed):
        with pytest.raises(HmkctaError) as caught:
            model.reconstruct(out)
        assert caught.value.reason == "out-shape"


def test_as_integers_values_are_rounded_and_cut_off() -> None:
    """A cast would turn white, decoded as a little more than it was, into black."""
    values = MODELS[0].reconstruct()
    assert values.min() < -0.5
    assert np.array_equal(np.asarray(MODELS[0], np.uint8), np.clip(np.rint(values), 0, 255))
    assert np.array_equal(np.asarray(MODELS[0], ">i2"), np.rint(values))
    assert np.array_equal(np.asarray(MODELS[0], np.bool_), values >= 0.5)


@pytest.mark.parametrize("dtype", [np.float16, ">f2"])
def test_as_float16_too_large_values_are_its_largest(dtype: str) -> None:
    """As in `reconstruct`: a cast would make infinities of finite numbers."""
    loud = [replace(level, core_scale=level.core_scale * np.float32(1e6)) for level in MODELS[0].levels]
    model = Model(MODELS[0].metadata, loud)
    values = np.asarray(model, dtype)
    assert values.dtype == np.dtype(dtype)
    assert np.array_equal(values, model.reconstruct(np.empty(SHAPE, dtype)))
    assert (values.min(), values.max()) == (-65504, 65504)
    assert np.asarray(model, np.float64).max() > 1e5


def test_too_little_memory_is_said_before_it_is_taken() -> None:
    with pytest.raises(HmkctaError, match="memmap") as caught:
        MODELS[0].reconstruct(max_memory=400)
    assert (caught.value.kind, caught.value.reason) == (Kind.RESOURCE_LIMIT, "memory")
    with pytest.raises(HmkctaError, match="TiB"):
        MODELS[0][np.zeros((1 << 20, 1), np.intp), np.zeros((1, 1 << 20), np.intp), 0, 0]
    free = available_memory()
    assert free is None or 0 <= free < 1 << 50


def test_levels() -> None:
    model = make_model(ORGANISATIONS[0], seed=3, levels=3)
    sizes = [SHAPE[n] for n in range(4)]
    coords = np.stack(np.unravel_index(np.arange(prod(sizes)), sizes), axis=1)
    for level in (1, 2, 3):
        view = model.at_level(level)
        expected = decode_elements(model.levels, sizes, coords, upto=level, dtype=np.float64).reshape(SHAPE)
        assert_same(view[...], expected)
        assert len(view.levels) == len(view.bounds) == len(view.quality) == level
        assert view.snr == model.quality[level - 1].snr_db
    assert model.at_level(1).nbytes < model.at_level(2).nbytes < model.nbytes
    for level in (0, 4, -1):
        with pytest.raises(HmkctaError, match="1 to 3"):
            model.at_level(level)


def test_saved_and_opened_again(tmp_path: Path) -> None:
    model = make_model(ORGANISATIONS[1], seed=4)
    for number, one in enumerate((model, model.at_level(1))):
        path = tmp_path / f"{number}.hmk"
        one.save(path)
        assert path.stat().st_size == one.nbytes
        again = open_model(path)
        np.testing.assert_array_equal(again[...], one[...])
        assert repr(again) == repr(one)
        with pytest.raises(HmkctaError):
            one.save(path)
        one.save(path, overwrite=True)


@pytest.mark.parametrize("level", [1, 2, 3])
def test_coded_stages_stay_coded(level: int, tmp_path: Path) -> None:
    """Opened and saved again, of all levels or the first ones, a file is the same; what is left keeps its steps."""
    model = Model(*random_model(np.random.default_rng(5), SHAPE, 3, shapes=Shapes(zero=0.05, leaf=0.05),
                                coded=1.0)).at_level(level)
    model.save(tmp_path / "a.hmk")
    again = open_model(tmp_path / "a.hmk")
    again.save(tmp_path / "b.hmk")
    assert (tmp_path / "a.hmk").read_bytes() == (tmp_path / "b.hmk").read_bytes()
    assert (tmp_path / "a.hmk").stat().st_size == model.nbytes == again.nbytes
    for one, other in zip(again.levels, model.levels, strict=True):
        assert one.step == other.step is not None
        for own, expected in zip(one.column, other.column, strict=True):
            np.testing.assert_array_equal(own, expected)
    np.testing.assert_array_equal(again[...], model[...])


def test_its_shape_is_that_of_its_axes() -> None:
    with pytest.raises(AttributeError):
        setattr(MODELS[0], "shape", (1, 2))  # noqa: B010 (type checkers would refuse the plain assignment)
    assert MODELS[0].shape == SHAPE


def test_what_it_says_about_itself() -> None:
    model = make_model(ORGANISATIONS[2], seed=9, undecomposed=(0,))
    assert (model.shape, model.ndim, model.size, len(model), model.dtype) == (SHAPE, 4, 210, 6, np.float32)
    cost = 0
    for level in model.levels:
        nodes = level.shape.astype(int)
        cost += max(int(prod(node[1, n] * node[2, n] for n in (1, 2))) for node in nodes)
    assert model.decode_cost == cost
    assert repr(model) == (f"<hmkcta.Model light=6 y=5 rgb=1 x=7: 2 levels, {model.snr:.2f} dB, "
                           f"{model.nbytes / 1024:.2f} KiB, {cost} multiply-adds an element>")
    assert isnan(Model(replace(model.metadata, quality=()), model.levels).snr)
    with pytest.raises(HmkctaError) as caught:
        Model(model.metadata, model.levels[:1])
    assert caught.value.reason == "level-count"


def test_value_transform_is_undone() -> None:
    for transform in (Transform("log1p", 0.5), Transform("asinh", 2.0), Transform("sqrt")):
        model = Model(replace(MODELS[0].metadata, transform=transform.to_json()), MODELS[0].levels)
        expected = transform.inverse(DENSE[0])
        np.testing.assert_allclose(model[...], expected, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(model[[1, 2], [3, 4], 0], expected[[1, 2], [3, 4], 0], rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(model.sample([1.5, 0, 0, 2]), (expected[1, 0, 0, 2] + expected[2, 0, 0, 2]) / 2,
                                   rtol=1e-4, atol=1e-4)


def test_no_infinity_or_nan_from_finite_numbers() -> None:
    model = MODELS[0]
    loud = [replace(level, core_scale=np.full_like(level.core_scale, 3e38)) for level in model.levels]
    for transform in (Transform(), Transform("log1p"), Transform("asinh"), Transform("sqrt")):
        values = Model(replace(model.metadata, transform=transform.to_json()), loud)[...]
        assert values.dtype == np.float32
        assert np.isfinite(values).all()
        assert values.max() > 1e38


@settings(max_examples=50, deadline=None)
@given(which=st.integers(0, len(MODELS) - 1), data=st.data())
def test_sample_is_multilinear(which: int, data: st.DataObject) -> None:
    model, reference = MODELS[which], DENSE[which]
    position = st.tuples(*(st.one_of(st.integers(0, size - 1), st.floats(0, size - 1)) for size in SHAPE))
    points = np.array(data.draw(st.lists(position, min_size=1, max_size=4)), np.float64)
    expected = [interpolate(reference, point) for point in points]
    assert_same(model.sample(points), np.array(expected), float(np.abs(reference).max()))


def interpolate(values: NDArray[np.float64], point: NDArray[np.float64]) -> float:
    """Axis by axis, the first one first."""
    for position in point:
        low = min(int(position), len(values) - 1)
        high = min(low + 1, len(values) - 1)
        values = values[low] + (position - low) * (values[high] - values[low])
    return float(values)


def test_sample_shapes_and_range() -> None:
    model, reference = MODELS[0], DENSE[0]
    grid = np.stack(np.meshgrid(*map(np.arange, SHAPE), indexing="ij"), axis=-1)
    assert_same(model.sample(grid), reference)
    assert model.sample([5.0, 4.0, 0.0, 6.0]) == pytest.approx(reference[5, 4, 0, 6], rel=1e-4)
    assert model.sample(np.empty((0, 4))).shape == (0,)
    for bad in ([0, 0, 0, 6.001], [-0.001, 0, 0, 0], [0, np.nan, 0, 0], [0, 0, 0.5, 0]):
        with pytest.raises(HmkctaError) as caught:
            model.sample([[0, 0, 0, 0], bad])
        assert caught.value.reason == "coords-out-of-range"
    for shape in ((3,), (2, 5), ()):
        with pytest.raises(HmkctaError, match=r"\[.., 4\]"):
            model.sample(np.zeros(shape))
    with pytest.raises(HmkctaError, match=r"coords: found 1 masked values, allowed no mask") as caught:
        model.sample(np.ma.masked_equal([[0.0, 0, 0, 1], [2, 0, 0, 0]], 2))
    assert caught.value.reason == "masked"
    assert_same(model.sample(np.ma.masked_array([1.0, 0, 0, 0], False)), reference[1, 0, 0, 0])
