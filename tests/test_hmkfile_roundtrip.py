"""What is written is read back: any valid model, always the same bytes, in a header of few bytes."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from math import inf
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import hmkcta
from hmk_corpus import Parts
from hmkcta.axes import Axis
from hmkcta.hmkfile import encode, encoded_size, level_bytes, level_sizes, load, loads, save
from hmkcta.packed import LevelQuality, Metadata, PackedLevel, bounds_of
from make_fixture import MODELS
from random_models import Shapes, random_model

Model = tuple[Metadata, tuple[PackedLevel, ...]]


@st.composite
def models(draw: st.DrawFn) -> Model:
    """Any model of order 1 to 5, with modes of size 1 and undecomposed ones, of one to three stages, also cuts."""
    sizes = draw(st.lists(st.integers(1, 6), min_size=1, max_size=5))
    undecomposed = tuple(n for n in range(len(sizes)) if draw(st.integers(0, 5)) == 0)
    stages = draw(st.integers(1, 3))
    share = st.sampled_from([0.0, 0.3])
    shapes = draw(
        st.builds(
            Shapes, st.integers(1, 3), st.integers(1, 3), st.integers(1, 3), st.just(8), share, share, share, share
        )
    )
    cut = stages > 1 and max(sizes) > 1 and draw(st.booleans())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return random_model(
        rng,
        sizes,
        stages,
        undecomposed,
        shapes=shapes,
        coded=draw(st.sampled_from([0.0, 0.5, 1.0])),
        cuts=(1,) if cut else (),
    )


def encoded(model: Model) -> bytes:
    return b"".join(encode(*model))


def assert_same(found: Model, expected: Model) -> None:
    """The same metadata, and the same numbers in arrays of the same types."""
    for field in fields(Metadata):
        if field.name != "axes":
            assert getattr(found[0], field.name) == getattr(expected[0], field.name), field.name
    for stage, other in zip(found[1], expected[1], strict=True):
        for field in fields(PackedLevel):
            one, two = getattr(stage, field.name), getattr(other, field.name)
            assert_equal(one, two, field.name)


def assert_equal(one: Any, two: Any, name: str) -> None:
    if isinstance(one, tuple):
        for a, b in zip(cast("tuple[Any, ...]", one), two, strict=True):
            assert_equal(a, b, name)
    elif isinstance(one, np.ndarray):
        array = cast("NDArray[Any]", one)
        assert array.dtype == two.dtype, name
        np.testing.assert_array_equal(array, two, name)
    else:
        assert one == two, name


@settings(deadline=None, max_examples=60)
@given(models())
def test_round_trip(model: Model) -> None:
    data = encoded(model)
    assert len(data) == encoded_size(*model)
    found = loads(data)
    assert_same(found, model)
    assert encoded(found) == data


@pytest.mark.parametrize("name", MODELS)
def test_save_open_and_save_again(name: str, tmp_path: Path) -> None:
    model = MODELS[name]()
    save(tmp_path / "a.hmk", *model)
    hmkcta.open(tmp_path / "a.hmk").save(tmp_path / "b.hmk")
    assert (tmp_path / "a.hmk").read_bytes() == (tmp_path / "b.hmk").read_bytes() == encoded(model)
    assert level_bytes(tmp_path / "a.hmk") == level_sizes(*model)


@pytest.mark.parametrize("k", [0, 1, 7, 20, 21, 22, 23, 40, 63])
def test_all_whole_numbers_keep_their_bytes(k: int, tmp_path: Path) -> None:
    """Numbers that float16 rounds become others of the same float16 number, once and no more."""
    del tmp_path
    metadata, (stage,) = _two_rows()
    rng = np.random.default_rng(k)
    unit = np.float32(2.0) ** -(k // 2) * np.float32(0.70710678118654752 if k % 2 else 1.0)
    most = min(2**24 - 1, int(60000 / float(unit)))
    for size in (3, 100, 1500, 2047, 2049, 40000, most):
        q = rng.integers(-size, size + 1, 2)
        basis = (q.astype(np.float32) * unit).astype(np.float16)
        core = rng.integers(-size, size + 1, 1)
        e = next(e for e in range(15) if abs(int(core[0])) <= 2047 * 2**e)
        made = replace(
            stage,
            step=0.1,
            column=(np.array([k], np.uint8), np.array([2], np.uint8)),
            core=(core * np.float32(2.0**-e)).astype(np.float16),
            core_scale=np.array([np.float32(0.1) * np.float32(2**e)], np.float32),
            basis=(basis, stage.basis[1]),
        )
        data = encoded((metadata, (made,)))
        again = loads(data)
        assert encoded(again) == data
        np.testing.assert_array_equal(again[1][0].basis[0], basis)
        np.testing.assert_array_equal(again[1][0].core * again[1][0].core_scale, made.core * made.core_scale)


def _two_rows() -> Model:
    """Two modes of two rows, one cell of rank 1."""
    metadata, (stage,) = random_model(np.random.default_rng(0), (2, 2), 1, shapes=Shapes(1, 1, 1, zero=0.0))
    return metadata, (replace(stage, basis=(stage.basis[0], np.array([0.5, -0.5], np.float16))),)


def test_one_block_takes_less_than_600_bytes_of_header_and_tables() -> None:
    axes = (Axis("y", 64, "space"), Axis("x", 64, "space"), Axis("t", 32, "time"), Axis("rgb", 3, "channel"))
    metadata, stages = random_model(
        np.random.default_rng(0), (64, 64, 32, 3), 1, axes=axes, coded=1.0, shapes=Shapes(1, 1, 3, zero=0.0)
    )
    data = encoded((metadata, stages))
    assert len(data) - sum(map(len, Parts.split(data).sections)) < 600


@pytest.mark.parametrize("stages", [2, 3])
def test_a_stage_without_nodes(stages: int) -> None:
    model = random_model(np.random.default_rng(1), (3, 4), stages, shapes=Shapes(leaf=1.0, zero=0.0), coded=0.5)
    assert model[1][1].nodes == 0
    assert_same(loads(encoded(model)), model)


def test_several_runs_are_read_as_one() -> None:
    """A stage of more than 256 KiB of code; cut in runs by its numbers alone, whatever the threads."""
    from hmkcta import _native

    rng = np.random.default_rng(0)
    metadata, stages = random_model(rng, (60, 60, 60), 2, cuts=(1,), coded=1.0, shapes=Shapes(6, 1, 2, 400, zero=0.0))
    ranks = stages[1].shape[:, 2]
    assert ranks.any()
    wide = replace(metadata, stages=tuple(map(bounds_of, stages)))
    whole = encoded((wide, stages))
    _native.set_threads(1)
    assert encoded((wide, stages)) == whole
    _native.set_threads(0)


def test_exact_reconstruction_is_null() -> None:
    metadata, stages = _two_rows()
    exact = replace(metadata, quality=(LevelQuality(inf, 0.0, 0.0),))
    data = encoded((exact, stages))
    assert Parts.split(data).header["quality"] == [{"snr_db": None, "rmse": 0.0, "max_abs_error": 0.0}]
    assert loads(data)[0].quality[0].snr_db == inf


@pytest.mark.parametrize("dtype", ["float32", "float64", "int32"])
@pytest.mark.parametrize("shape", [(2,), (2, 1), (2, 16)])
@pytest.mark.parametrize("step", [1.0, 0.1])
def test_coordinates(dtype: str, shape: tuple[int, ...], step: float) -> None:
    coords = (np.arange(np.prod(shape)).reshape(shape) * step).astype(dtype)
    metadata, stages = _two_rows()
    axes = (replace(metadata.axes[0], coords=coords), metadata.axes[1])
    found = loads(encoded((replace(metadata, axes=axes), stages)))[0].axes[0].coords
    assert found is not None
    assert found.shape == shape
    np.testing.assert_array_equal(np.asarray(found, dtype), coords)


def test_many_coordinates_are_a_section() -> None:
    metadata, stages = random_model(np.random.default_rng(0), (100, 2), 1, shapes=Shapes(1, 1, 1, zero=0.0))
    axes = (replace(metadata.axes[0], coords=np.arange(100) / 7), metadata.axes[1])
    data = encoded((replace(metadata, axes=axes), stages))
    parts = Parts.split(data)
    assert parts.header["axes"][0]["coordinates"] == {"dtype": "F64", "width": 0}
    np.testing.assert_array_equal(np.frombuffer(parts.sections[0], "<f8"), np.arange(100) / 7)


def test_loaded_arrays_are_read_only(tmp_path: Path) -> None:
    save(tmp_path / "a.hmk", *MODELS["merged"]())
    for stage in load(tmp_path / "a.hmk")[1]:
        assert not stage.core.flags.writeable
        assert not any(array.flags.writeable for array in (*stage.basis, *stage.cluster))


def test_the_header_leaves_out_what_has_its_default() -> None:
    metadata, stages = _two_rows()
    plain = Metadata(
        metadata.source_dtype, metadata.axes, metadata.organisation, metadata.stages, quality=metadata.quality
    )
    text = Parts.split(encoded((plain, stages))).text.decode()
    assert json.loads(text).keys() == {"axes", "organisation", "dtype", "stages", "quality"}
    assert "role" not in text or '"role":"other"' not in text
