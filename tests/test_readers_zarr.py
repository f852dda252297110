"""Zarr, versions 2 and 3, in folders and zip archives."""

from __future__ import annotations

import base64
import json
import shutil
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hmkcta
from hmkcta.errors import Kind
from hmkcta.readers import open_array
from reader_tools import DTYPES, VALUES, little_memory, needed, refusal, refused_wherever_cut, same


@pytest.fixture
def zarr() -> Any:
    """The library."""
    return needed("zarr")


def zipped(folder: Path, inside: bool = False) -> Path:
    """A store as a zip archive, with its folder or without."""
    root, base = (folder.parent, folder.name) if inside else (folder, ".")
    return Path(shutil.make_archive(str(folder.parent / "zipped"), "zip", root, base))


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("dtype", DTYPES)
def test_arrays_are_unpacked(zarr: Any, tmp_path: Path, version: int, dtype: str) -> None:
    zarr.create_array(tmp_path / "a", data=VALUES.astype(dtype), chunks=(2, 3, 2), zarr_format=version)
    native = dtype if version == 2 else np.dtype(dtype).newbyteorder("=")
    same(tmp_path / "a", VALUES, native)
    same(zipped(tmp_path / "a"), VALUES, native)
    same(zipped(tmp_path / "a", inside=True), VALUES, native)


def test_shards_and_fortran_order(zarr: Any, tmp_path: Path) -> None:
    zarr.create_array(tmp_path / "a", data=VALUES, chunks=(1, 2, 1), shards=(2, 4, 2))
    zarr.create_array(tmp_path / "b", data=VALUES, chunks=(3, 2, 2), zarr_format=2, order="F")
    same(tmp_path / "a", VALUES)
    same(tmp_path / "b", VALUES)


@pytest.mark.parametrize("version", [2, 3])
def test_members_of_groups(zarr: Any, tmp_path: Path, version: int) -> None:
    group = zarr.open_group(tmp_path / "a.zarr", mode="w", zarr_format=version)
    group.create_array("run/speed", data=VALUES)
    same(tmp_path / "a.zarr", VALUES)
    group.create_array("mask", data=VALUES[0] > 3)
    error = refusal(tmp_path / "a.zarr")
    assert (error.kind, error.reason) == (Kind.INVALID_ARGUMENT, "source-member")
    assert "mask (4 x 5 of bool), run/speed (3 x 4 x 5 of float32)" in str(error)
    assert refusal(f"{tmp_path}/a.zarr:speed").reason == "source-member"
    for uri in ("a.zarr:run/speed", "a.zarr:/run/speed", "a.zarr/run/speed"):
        same(tmp_path / uri, VALUES)
    same(f"{zipped(tmp_path / 'a.zarr', inside=True)}:mask", VALUES[0] > 3)


@pytest.mark.parametrize("version", [2, 3])
def test_coordinates_are_no_default_and_packing_is_undone(zarr: Any, tmp_path: Path, version: int) -> None:
    group = zarr.open_group(tmp_path / "a.zarr", mode="w", zarr_format=version)
    names = {"dimension_names": ["time", "y", "x"]} if version == 3 else {}
    field = group.create_array("field", data=VALUES.astype("i2"), **names)
    field.attrs.update({"scale_factor": 0.5, "_FillValue": 7})
    time = group.create_array("time", data=VALUES[:, 0, 0], **({"dimension_names": ["time"]} if names else {}))
    if version == 2:
        time.attrs["_ARRAY_DIMENSIONS"] = ["time"]
    expected = np.where(VALUES == 7, np.float32(np.nan), VALUES / 2)
    array = open_array(tmp_path / "a.zarr")
    assert array.dtype == np.float32
    assert np.array_equal(array, expected, equal_nan=True)


def test_fill_values_where_xarray_keeps_them(zarr: Any, tmp_path: Path) -> None:
    expected = np.where(VALUES == 7, np.float32(np.nan), VALUES)
    old = zarr.create_array(tmp_path / "a", data=VALUES.astype("i2"), zarr_format=2, fill_value=7)
    same(tmp_path / "a", VALUES, "i2")
    old.attrs["_ARRAY_DIMENSIONS"] = ["t", "y", "x"]
    assert np.array_equal(open_array(tmp_path / "a"), expected, equal_nan=True)
    new = zarr.create_array(tmp_path / "b", data=VALUES)
    new.attrs["_FillValue"] = base64.b64encode(struct.pack("<d", 7.0)).decode()
    assert np.array_equal(open_array(tmp_path / "b"), expected, equal_nan=True)


@pytest.mark.parametrize("place", ["filters", "compressor"])
def test_a_pickle_is_refused_unread(zarr: Any, tmp_path: Path, place: str) -> None:
    pickle = {"id": "pickle", "protocol": 5}
    zarr.create_array(tmp_path / "a", data=VALUES, chunks=(3, 4, 5), zarr_format=2, compressors=None)
    described = json.loads((tmp_path / "a" / ".zarray").read_text())
    described[place] = [pickle] if place == "filters" else pickle
    (tmp_path / "a" / ".zarray").write_text(json.dumps(described))
    (tmp_path / "a" / "0.0.0").write_bytes(f"cbuiltins\nopen\n(S'{tmp_path}/run'\nS'w'\ntR.".encode())
    assert refusal(tmp_path / "a").reason == "source-damaged"
    assert not (tmp_path / "run").exists()


def test_text_and_waves_are_refused(zarr: Any, tmp_path: Path) -> None:
    zarr.create_array(tmp_path / "a", data=VALUES.astype("c8"))
    zarr.create_array(tmp_path / "b", data=np.array(["x", "y"]), zarr_format=2)
    assert refusal(tmp_path / "a").reason == "source-dtype"
    assert refusal(tmp_path / "b").reason == "source-dtype"


@pytest.mark.parametrize("version", [2, 3])
def test_damage_is_refused(zarr: Any, tmp_path: Path, version: int) -> None:
    zarr.create_array(tmp_path / "a", data=VALUES, chunks=(3, 4, 5), zarr_format=version)
    refused_wherever_cut(tmp_path / "a" / (".zarray" if version == 2 else "zarr.json"), 25, tmp_path / "a")
    chunk = next(path for path in (tmp_path / "a").rglob("*0*") if path.is_file())
    refused_wherever_cut(chunk, 10, tmp_path / "a")
    refused_wherever_cut(zipped(tmp_path / "a"), 41)


def test_what_does_not_fit_is_unpacked_into_a_file(
    zarr: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = np.arange(60 * 70 * 80, dtype=np.int32).reshape(60, 70, 80)
    zarr.create_array(tmp_path / "a", data=values, chunks=(7, 9, 11))
    little_memory(monkeypatch, 100_000)
    same(tmp_path / "a", values, mapped=True)


@pytest.mark.parametrize("version", [2, 3])
def test_an_open_array_is_compressed_as_its_store_would_be(zarr: Any, tmp_path: Path, version: int) -> None:
    array = zarr.create_array(tmp_path / "a", data=VALUES.astype("i2"), zarr_format=version)
    array.attrs.update({"add_offset": 300.0, "missing_value": 7})
    with pytest.raises(hmkcta.HmkctaError, match="1 values that are NaN"):
        hmkcta.compress(array, "R=2")
    by_name = open_array(tmp_path / "a")
    found, expected = (np.asarray(hmkcta.compress(each, "R=2", nan=300)) for each in (array, by_name))
    assert np.array_equal(found, expected)
    assert found.min() > 290
