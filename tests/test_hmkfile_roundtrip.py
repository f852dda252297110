"""What is written is read back: any valid model, always the same bytes, and a file that safetensors itself opens."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from math import inf, prod
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from safetensors import safe_open
from safetensors.numpy import load as safetensors_load

from hmkcta.axes import Axis
from hmkcta.hmkfile import (
    INLINE_COORDS,
    coords_info,
    coords_name,
    encode,
    encoded_size,
    file_size,
    level_schema,
    level_sizes,
    load,
    loads,
    prefix,
    save,
    short,
    table_bytes,
)
from hmkcta.hmkfile.metadata import to_json
from hmkcta.packed import LevelQuality, Metadata, PackedLevel
from make_fixture import (
    eight_model,
    lone_model,
    merged_model,
    mixed_model,
    packed_model,
    partly_model,
    small_model,
)
from random_models import Shapes, bounds_of, random_model

Model = tuple[Metadata, tuple[PackedLevel, ...]]


@st.composite
def models(draw: st.DrawFn) -> Model:
    """Any model of order 2 to 6, with modes of size 1 and undecomposed ones, of one to three levels."""
    sizes = draw(st.lists(st.integers(1, 6), min_size=2, max_size=6))
    undecomposed = tuple(n for n in range(len(sizes)) if draw(st.integers(0, 4)) == 0)
    shapes = draw(st.builds(Shapes, st.integers(1, 3), st.integers(1, 3), st.integers(1, 3), st.just(8),
                            st.sampled_from([0.0, 0.3]), st.sampled_from([0.0, 0.3]), st.booleans()))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    levels = draw(st.integers(1, 3))
    eight_from = draw(st.none() | st.integers(1, levels))
    packed_share = draw(st.sampled_from([0.0, 0.5, 1.0])) if eight_from else 0.0
    return random_model(rng, sizes, levels, undecomposed, shapes=shapes, eight_from=eight_from,
                        packed_share=packed_share)


def encoded(model: Model) -> bytes:
    """The bytes of a model's file."""
    return b"".join(encode(*model))


def assert_same(found: Model, expected: Model) -> None:
    """Metadata and every array are equal, number types included."""
    assert to_json(found[0], {}) == to_json(expected[0], {})
    for axis, other in zip(found[0].axes, expected[0].axes, strict=True):
        assert (axis.coords is None) == (other.coords is None)
        if axis.coords is not None and other.coords is not None:
            np.testing.assert_array_equal(axis.coords, other.coords)
    assert len(found[1]) == len(expected[1])
    for level, other in zip(found[1], expected[1], strict=True):
        for item in fields(PackedLevel):
            assert_equal(getattr(level, item.name), getattr(other, item.name))


def assert_equal(found: Any, expected: Any) -> None:
    """Arrays, or tuples of arrays and None, are the same to the bit."""
    if isinstance(expected, tuple):
        for one, other in zip(found, cast("tuple[Any, ...]", expected), strict=True):
            assert_equal(one, other)
    elif expected is None or isinstance(expected, int):
        assert found == expected
    else:
        assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
        assert found.tobytes() == expected.tobytes()


@settings(max_examples=150, deadline=None)
@given(models())
def test_round_trip(model: Model) -> None:
    data = encoded(model)
    assert_same(loads(data), model)
    assert encoded(loads(data)) == data
    assert encoded_size(*model) == len(data)


def test_order_1_and_one_element() -> None:
    for sizes, undecomposed in (((5,), ()), ((1,), ()), ((1, 1), (0, 1)), ((4, 5), (0, 1))):
        model = random_model(np.random.default_rng(0), sizes, 2, undecomposed)
        assert_same(loads(encoded(model)), model)


@pytest.mark.parametrize(("eight_from", "packed_share"), [(None, 0.0), (1, 0.0), (1, 1.0)])
def test_level_without_nodes(eight_from: int | None, packed_share: float) -> None:
    model = random_model(np.random.default_rng(0), (4, 3), 3, shapes=Shapes(leaf=1.0), eight_from=eight_from,
                         packed_share=packed_share)
    assert [level.nodes for level in model[1]] == [1, 0, 0]
    assert [len(level.rice) for level in model[1]] == [2 * (packed_share > 0)] * 3
    assert_same(loads(encoded(model)), model)


def test_save_and_load(tmp_path: Path) -> None:
    model = merged_model()
    size = save(tmp_path / "a.hmk", *model)
    assert size == (tmp_path / "a.hmk").stat().st_size == encoded_size(*model)
    assert [path.name for path in tmp_path.iterdir()] == ["a.hmk"]
    assert_same(load(tmp_path / "a.hmk"), model)
    assert_same(load(str(tmp_path / "a.hmk"), verify=False), model)


def test_same_model_same_bytes() -> None:
    assert encoded(merged_model()) == encoded(merged_model())
    strided = small_model()
    core = np.repeat(strided[1][0].core, 2)[::2].astype(">f2")
    assert encoded((strided[0], (replace(strided[1][0], core=core), *strided[1][1:]))) == encoded(small_model())


def test_loaded_arrays_are_read_only(tmp_path: Path) -> None:
    """Also what a file leaves out."""
    save(tmp_path / "a.hmk", *small_model())
    _, levels = load(tmp_path / "a.hmk")
    with pytest.raises(ValueError, match="read-only"):
        levels[0].core[0] = 0
    save(tmp_path / "b.hmk", *lone_model())
    save(tmp_path / "c.hmk", *packed_model())
    for level in (*load(tmp_path / "b.hmk")[1], *load(tmp_path / "c.hmk")[1]):
        for name, array in (*level.tables(), *level.wide()):
            assert not array.flags.writeable, name


@pytest.mark.parametrize(("make", "second"), [(mixed_model, np.int8), (partly_model, np.uint8)])
def test_safetensors_opens_bytes(make: Callable[[], Model], second: type[np.generic]) -> None:
    _, levels = model = make()
    found: dict[str, NDArray[Any]] = safetensors_load(encoded(model))
    assert {name: array.dtype for name, array in found.items() if name.endswith("/core")} == {
        "level/1/core": np.float16, "level/2/core": second, "level/3/core": np.int8}
    for level, packed in enumerate(levels, 1):
        for name, array in packed.coefficients():
            assert_equal(found[prefix(level) + name], array)


def test_safetensors_opens_it(tmp_path: Path) -> None:
    metadata, levels = merged_model()
    save(tmp_path / "a.hmk", metadata, levels)
    coords = metadata.axes[0].coords
    assert coords is not None
    expected = {"coords/light": coords} | {prefix(level) + name: array for level, packed in enumerate(levels, 1)
                                           for name, array in (*packed.tables(), *packed.coefficients())}
    with cast("Any", safe_open)(str(tmp_path / "a.hmk"), "np") as file:  # the library's types are incomplete
        assert set(file.metadata()) == {"hmkcta", "hmkcta_sha256"}
    found: dict[str, NDArray[Any]] = safetensors_load((tmp_path / "a.hmk").read_bytes())
    assert set(found) == set(expected)
    for name, array in expected.items():
        assert_equal(found[name], array)


def header_of(data: bytes) -> tuple[int, dict[str, Any]]:
    """Length and parsed JSON of a file's header."""
    length = int.from_bytes(data[:8], "little")
    return length, json.loads(data[8:8 + length])


@pytest.mark.parametrize("make", [merged_model, eight_model, mixed_model, lone_model, packed_model, partly_model])
def test_order_on_disk(make: Callable[[], Model]) -> None:
    data = encoded(make())
    length, header = header_of(data)
    del header["__metadata__"]
    names = list(header)
    numbers = [name for name in names if name.endswith("/core") or "/basis/" in name]
    tables = names[:-len(numbers)]
    assert names == tables + numbers
    kinds = ["4 bytes" if header[name]["dtype"] in ("U32", "F32") else header[name]["dtype"] for name in tables]
    assert kinds == sorted(kinds, key=["U8", "4 bytes", "U16"].index)
    assert numbers == sorted(numbers, key=lambda name: (name.split("/")[1], "basis" in name, name))
    types = [header[name]["dtype"] for name in numbers]
    assert types == sorted(types, key=lambda dtype: dtype != "F16")
    assert (length + sum(prod(header[name]["shape"]) for name in tables if header[name]["dtype"] == "U8")) % 8 == 0
    for entry in header.values():
        item = (entry["data_offsets"][1] - entry["data_offsets"][0]) // max(prod(entry["shape"]), 1)
        assert item == 0 or (8 + length + entry["data_offsets"][0]) % item == 0


@pytest.mark.parametrize("make", [small_model, merged_model])
def test_the_schema_of_a_level_tells_types_and_size(make: Callable[[], Model]) -> None:
    metadata, levels = make()
    data = encoded((metadata, levels))
    _, header = header_of(data)
    infos = {name: coords_info(axis) for axis in metadata.axes if (name := coords_name(axis)) is not None}
    for number, level in enumerate(levels, 1):
        schema = level_schema(level.order, metadata.undecomposed, level.nodes, level.child is None, level.bits)
        infos |= {(name := prefix(number) + part): info._replace(shape=tuple(header[name]["shape"]))
                  for part, info in schema}
    assert {name: info.dtype for name, info in infos.items()} == {
        name: entry["dtype"] for name, entry in header.items() if name != "__metadata__"}
    assert file_size(metadata, infos) == len(data)


def payload(data: bytes) -> int:
    """Bytes of a file's arrays."""
    return len(data) - 8 - header_of(data)[0]


@pytest.mark.parametrize(("eight_from", "packed_share", "version"), [
    (None, 0.0, "1.0"), (1, 0.0, "1.2"), (2, 0.0, "1.2"), (1, 1.0, "1.4"), (2, 1.0, "1.4")])  # fmt: skip
def test_the_version_hangs_on_number_types(
    eight_from: int | None, packed_share: float, version: str, tmp_path: Path
) -> None:
    model = random_model(np.random.default_rng(0), (4, 5), 2, eight_from=eight_from, packed_share=packed_share)
    data = encoded(model)
    assert json.loads(header_of(data)[1]["__metadata__"]["hmkcta"])["version"] == version
    (tmp_path / "a.hmk").write_bytes(data)
    tables = table_bytes(tmp_path / "a.hmk")
    assert len(tables) == len(model[1])
    numbers = [level.number_bytes for level in model[1]]
    assert payload(data) == sum(tables) + sum(numbers)
    assert level_sizes(model[1]) == [own + count for own, count in zip(tables, numbers, strict=True)]


@pytest.mark.parametrize("make", [packed_model, partly_model])
def test_the_schema_of_packed_levels_tells_types(make: Callable[[], Model]) -> None:
    """All of a level that is not left out, with parameters of its decomposed modes where it is packed."""
    metadata, levels = make()
    header = header_of(encoded((metadata, levels)))[1]
    for number, level in enumerate(levels, 1):
        schema = dict(level_schema(level.order, metadata.undecomposed, level.nodes, level.child is None, level.bits,
                                   short=True, packed=bool(level.rice)))
        found = {name.removeprefix(prefix(number)): entry["dtype"] for name, entry in header.items()
                 if name.startswith(prefix(number))}
        assert {name for name in found if "rice" in name} == {name for name in schema if "rice" in name}
        assert {name: found[name] for name in schema if name.startswith(("core", "basis", "rice"))} == {
            name: info.dtype for name, info in schema.items() if name.startswith(("core", "basis", "rice"))}


def test_what_follows_is_left_out() -> None:
    """Where each row has one cluster and all keep their order, shapes, children, scales and clusters are left."""
    shapes = Shapes(3, 1, 3, zero=0.0, leaf=0.0, tidy=True)
    model = random_model(np.random.default_rng(1), (9, 7, 2), 2, (2,), shapes=shapes, eight_from=1)
    clusters = [f"level/{number}/cluster/{n}" for number, level in enumerate(model[1], 1) for n in (0, 1)
                if level.shape[:, 0, n].max() > 1]
    assert len(clusters) > 2
    header = header_of(encoded(model))[1]
    tables = {name for name, entry in header.items() if name != "__metadata__" and entry["dtype"] != "I8"}
    assert tables == {"level/1/child", *clusters,
                      *(prefix(level) + name for level in (1, 2) for name in ("shape", "core_scale"))}
    assert {header[name]["dtype"] for name in tables if "core_scale" not in name} == {"U8"}
    assert_same(loads(encoded(model)), model)


def test_tables_may_be_wider_than_need_be(monkeypatch: pytest.MonkeyPatch) -> None:
    def as_it_is(array: NDArray[Any], largest: int) -> NDArray[Any]:
        assert array.max(initial=0) <= largest
        return array

    monkeypatch.setattr(short, "_narrow", as_it_is)
    for model in (eight_model(), mixed_model(), lone_model()):
        data = encoded(model)
        assert {entry.get("dtype") for entry in header_of(data)[1].values()} <= {None, "U16", "U32", "F32", "F16", "I8"}
        assert_same(loads(data), model)


@pytest.mark.parametrize(("count", "dtype"), [(256, "U8"), (257, "U16")])
def test_clusters_are_as_narrow_as_can_be(count: int, dtype: str) -> None:
    shapes = Shapes(1, 1, 1, zero=0.0, leaf=0.0, tidy=True)
    metadata, (level,) = random_model(np.random.default_rng(1), (600, 2), 1, (1,), shapes=shapes, eight_from=1)
    rows, ones = np.arange(600, dtype=np.uint16), np.ones(count, np.float32)
    shape = np.array([[[count, 1], [1, 1], [1, 2]]], np.uint32)
    core = np.ones((count, 2), np.float16).reshape(-1)
    level = replace(level, shape=shape, cluster=(rows % count, None), core=core, core_scale=ones,
                    core_offset=np.array([0, 2 * count], np.uint32), cell_offset=np.array([0, count], np.uint32))
    model = replace(metadata, levels=(bounds_of(level),)), (level,)
    header = header_of(encoded(model))[1]
    assert [header[f"level/1/{name}"]["dtype"] for name in ("cluster/0", "shape")] == [dtype, "U16"]
    assert_same(loads(encoded(model)), model)


def test_bytes_are_the_nearest_numbers() -> None:
    level = random_model(np.random.default_rng(1), (9, 8), 1, shapes=Shapes(3, 1, 3, 9), eight_from=1)[1][0]
    stored = dict(level.coefficients())
    assert {array.dtype for array in stored.values()} == {np.dtype(np.int8)}
    for (name, bytes_), exact in zip(stored.items(), (level.core, *level.basis), strict=True):
        assert exact is not None
        q = bytes_.astype(np.float64)
        expected = q * np.abs(q) / 127**2 if name == "core" else q / 128
        np.testing.assert_array_equal(exact, expected.astype(np.float16))


def test_exact_reconstruction_is_null() -> None:
    metadata, levels = small_model()
    data = encoded((replace(metadata, quality=(LevelQuality(inf, 0.0, 0.0),) * 2), levels))
    text = json.loads(header_of(data)[1]["__metadata__"]["hmkcta"])
    assert text["quality"][0] == {"snr_db": None, "rmse": 0.0, "max_abs_error": 0.0}
    assert loads(data)[0].quality[0].snr_db == inf


@pytest.mark.parametrize("dtype", ["float32", "float64", "int64", "float16"])
@pytest.mark.parametrize("shape", [(INLINE_COORDS,), (INLINE_COORDS + 1,), (33, 2), (2, 2)])
@pytest.mark.parametrize("step", [1.0, 1 / 3])
def test_coordinates(dtype: str, shape: tuple[int, ...], step: float) -> None:
    coords = (step * np.arange(prod(shape)).reshape(shape)).astype(dtype)
    axes = (Axis("x", shape[0], "space", coords, "mm"), Axis("t", 2))
    model = random_model(np.random.default_rng(0), (shape[0], 2), 1, axes=axes)
    data = encoded(model)
    stored = "coords/x" in header_of(data)[1]
    found = loads(data)[0].axes[0].coords
    assert found is not None
    assert stored == (coords.size > INLINE_COORDS or (step < 1 and dtype != "int64" and coords.size == INLINE_COORDS))
    exact = dtype == "float64" and step < 1
    assert found.dtype == (np.float32 if stored and not exact else np.float64)
    np.testing.assert_array_equal(found.astype(dtype), coords)
    assert encoded(loads(data)) == data


def test_coordinates_have_no_more_digits_than_they_need() -> None:
    def written(coords: list[float], dtype: str) -> str:
        axes = (Axis("x", len(coords), "space", np.array(coords, dtype)), Axis("t", 2))
        text = header_of(encoded(random_model(np.random.default_rng(0), (len(coords), 2), 1, axes=axes)))[1]
        return text["__metadata__"]["hmkcta"].partition('"coords":')[2].partition(',"unit"')[0]

    assert written([0, 0.1, -2.5, 1e-7], "float32") == "[0,0.1,-2.5,1e-07]"
    assert written([0, 0.1, -30], "float64") == "[0,0.1,-30]"
    assert written([float(np.float32(0.1)), 2.0**60], "float64") == "[0.10000000149011612,1.152921504606847e+18]"


def test_figures_of_quality_do_not_change_the_size() -> None:
    metadata, levels = small_model()
    plain = replace(metadata, quality=(LevelQuality(1.0, 1.0, 1.0),) * 2)
    for quality in (LevelQuality(inf, 0.0, 0.0), LevelQuality(-123.456789, 1.234567e-38, 0.0001234567)):
        assert len(encoded((replace(metadata, quality=(quality,) * 2), levels))) == encoded_size(plain, levels)
