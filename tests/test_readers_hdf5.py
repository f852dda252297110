"""HDF5, netCDF-4 and MATLAB 7.3: mapped where the numbers lie in one piece, and never what they do not mean."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hmkcta
from hmkcta import conventions
from hmkcta.errors import Kind
from hmkcta.measure import measure
from hmkcta.readers import open_array
from reader_tools import DTYPES, VALUES, little_memory, needed, refusal, refused_wherever_cut, same, survives_damage


@pytest.fixture
def h5py() -> Any:
    """The library."""
    return needed("h5py")


@pytest.mark.parametrize("dtype", [*DTYPES, "<f2", ">i8", "?"])
@pytest.mark.parametrize("block", [0, 512, 2048])
def test_a_dataset_in_one_piece_is_mapped(h5py: Any, tmp_path: Path, dtype: str, block: int) -> None:
    with h5py.File(tmp_path / "a.h5", "w", userblock_size=block) as file:
        file["group/array"] = VALUES.astype(dtype)
        file["group/text"] = "no numbers"
    for uri in ("a.h5", "a.h5:/group/array", "a.h5:group/array", "a.h5:/group"):
        same(f"{tmp_path}/{uri}", VALUES.astype(dtype), dtype, mapped=True)


@pytest.mark.parametrize("options", [
    {"chunks": (2, 2, 5)}, {"chunks": (1, 4, 3), "compression": "gzip", "shuffle": True}, {"compression": "lzf"},
    {"chunks": (3, 4, 5), "fletcher32": True},
])
def test_chunks_are_unpacked(h5py: Any, tmp_path: Path, options: dict[str, Any]) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("array", data=VALUES.astype(">f8"), **options)
    same(tmp_path / "a.h5", VALUES, ">f8")


def test_a_compact_dataset_a_virtual_one_and_numbers_of_12_bits_are_not_mapped(h5py: Any, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        compact = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        compact.set_layout(h5py.h5d.COMPACT)
        space = h5py.h5s.create_simple(VALUES.shape)
        h5py.Dataset(h5py.h5d.create(file.id, b"compact", h5py.h5t.IEEE_F32LE, space, compact))[...] = VALUES
        narrow = h5py.h5t.STD_I16LE.copy()
        narrow.set_precision(12)
        h5py.Dataset(h5py.h5d.create(file.id, b"narrow", narrow, space))[...] = -VALUES
        file["whole"] = VALUES
        layout = h5py.VirtualLayout(VALUES.shape, "f4")
        layout[...] = h5py.VirtualSource(file["whole"])
        file.create_virtual_dataset("virtual", layout)
    same(f"{tmp_path}/a.h5:compact", VALUES)
    same(f"{tmp_path}/a.h5:narrow", -VALUES, "i2")
    same(f"{tmp_path}/a.h5:virtual", VALUES)


def test_a_virtual_dataset_whose_file_is_gone_is_refused(h5py: Any, tmp_path: Path) -> None:
    layout = h5py.VirtualLayout(VALUES.shape, "f4")
    layout[...] = h5py.VirtualSource("gone.h5", "a", VALUES.shape)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_virtual_dataset("virtual", layout)
    error = refusal(tmp_path / "a.h5")
    assert error.reason == "source-incomplete"
    assert "gone.h5" in str(error)


def test_several_datasets_are_listed_with_their_shapes(h5py: Any, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["density"] = VALUES
        file["run/speed"] = VALUES[0].astype("u2")
    for uri in ("a.h5", "a.h5:/speed", "a.h5:/density/more"):
        error = refusal(f"{tmp_path}/{uri}")
        assert (error.kind, error.reason) == (Kind.INVALID_ARGUMENT, "source-member")
        assert "/density (3 x 4 x 5 of float32), /run/speed (4 x 5 of uint16)" in str(error)
    same(tmp_path / "a.h5", VALUES[0], "u2", mapped=True, member="/run/speed")


def test_very_many_datasets_are_counted(h5py: Any, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for number in range(25):
            file[f"{number:02}"] = VALUES
    assert str(refusal(tmp_path / "a.h5")).count("3 x 4 x 5") == 20
    assert "and 5 more" in str(refusal(tmp_path / "a.h5"))


def test_coordinates_of_netcdf_are_no_default(h5py: Any, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["field"] = VALUES
        for number, name in enumerate(("time", "y", "x")):
            file[name] = np.arange(VALUES.shape[number])
            file[name].make_scale(name)
            file["field"].dims[number].attach_scale(file[name])
        file["area"] = VALUES[0]
        file["field"].attrs["coordinates"] = "area"
    same(tmp_path / "a.nc", VALUES, mapped=True)
    same(f"{tmp_path}/a.nc:/area", VALUES[0], mapped=True)


@pytest.mark.parametrize(("dtype", "expected"), [("<i2", "f4"), (">u1", "f4"), ("<i4", "f8"), (">f4", "f4")])
def test_packed_numbers_are_unpacked_and_fill_values_are_none(
    h5py: Any, tmp_path: Path, dtype: str, expected: str
) -> None:
    with h5py.File(tmp_path / "a.nc", "w") as file:
        field = file.create_dataset("field", data=VALUES.astype(dtype))
        field.attrs.update({"scale_factor": 0.5, "add_offset": 10.0, "_FillValue": np.array([7], dtype)})
    array = open_array(tmp_path / "a.nc")
    assert array.dtype == np.dtype(expected)
    assert np.array_equal(array, np.where(VALUES == 7, np.nan, VALUES / 2 + 10), equal_nan=True)


@pytest.mark.parametrize(("dtype", "fill"), [("i8", -9223372036854775806), ("u8", 18446744073709551614)])
def test_fill_values_keep_all_their_digits(h5py: Any, tmp_path: Path, dtype: str, fill: int) -> None:
    with h5py.File(tmp_path / "a.nc", "w") as file:
        field = file.create_dataset("field", data=np.array([[1, 2, fill]], dtype))
        field.attrs["_FillValue"] = np.array(fill, dtype)
    assert np.array_equal(open_array(tmp_path / "a.nc"), [[1, 2, np.nan]], equal_nan=True)


def test_unsigned_numbers_may_be_stored_as_signed_ones(h5py: Any, tmp_path: Path) -> None:
    """As netCDF says it, whose old files have no others; fill values are said in either type."""
    meant = np.array([[0, 7, 40_000], [65_535, 60_000, 1]], np.uint16)
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file.create_dataset("plain", data=meant.view(">i2")).attrs["_Unsigned"] = "true"
        for name, fill in (("signed", np.int16(-1)), ("unsigned", np.uint16(65_535))):
            packed = file.create_dataset(name, data=meant.view(np.int16))
            packed.attrs.update({"_Unsigned": b"true", "scale_factor": 0.5, "_FillValue": fill})
        file.create_dataset("bytes", data=np.array([255, 1], np.uint8)).attrs["_Unsigned"] = "false"
    assert open_array(f"{tmp_path}/a.nc:/plain").tolist() == meant.view(">i2").view(">u2").tolist()
    for name in ("signed", "unsigned"):
        array = open_array(f"{tmp_path}/a.nc:/{name}")
        assert np.array_equal(array, np.where(meant == 65_535, np.nan, meant / 2), equal_nan=True)
    assert open_array(f"{tmp_path}/a.nc:/bytes").tolist() == [-1, 1]


def test_attributes_of_another_convention_are_nobodys_business(h5py: Any, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        dataset = file.create_dataset("field", data=VALUES)
        dataset.attrs.update({"scale_factor": [1.0, 2.0, 3.0], "add_offset": "none", "_FillValue": h5py.Empty("f4")})
        file["nothing"] = h5py.Empty("f4")
    same(tmp_path / "a.h5", VALUES, mapped=True)


def test_a_file_that_somebody_writes(h5py: Any, tmp_path: Path) -> None:
    program = "import h5py, sys; file = h5py.File(sys.argv[1], 'w'); print(flush=True); sys.stdin.read()"
    writer = subprocess.Popen([sys.executable, "-c", program, tmp_path / "a.h5"], stdin=subprocess.PIPE,
                              stdout=subprocess.PIPE)
    try:
        assert writer.stdout is not None
        writer.stdout.readline()
        del h5py
        error = refusal(tmp_path / "a.h5")
    finally:
        writer.communicate()
    assert (error.kind, error.reason) == (Kind.IO, "unreadable")
    assert "nobody is writing" in str(error)


def test_a_fill_value_that_is_no_number_leaves_the_map(h5py: Any, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file.create_dataset("field", data=VALUES).attrs["_FillValue"] = np.float32(np.nan)
    same(tmp_path / "a.nc", VALUES, mapped=True)


@pytest.mark.parametrize("chunks", [None, (2, 2, 2)])
def test_matlab_has_its_axes_back(h5py: Any, tmp_path: Path, chunks: Any) -> None:
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file.create_dataset("wood", data=VALUES.T, chunks=chunks).attrs["MATLAB_class"] = np.bytes_("single")
        file.create_dataset("name", data=VALUES.astype("u2")).attrs["MATLAB_class"] = np.bytes_("char")
        file["#refs#/a"] = VALUES
    with open(tmp_path / "a.mat", "r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file")
    same(tmp_path / "a.mat", VALUES, mapped=chunks is None)


@pytest.mark.parametrize(("name", "start", "hint"), [
    ("a.mat", b"MATLAB 5.0 MAT-file", "-v7.3"), ("a.nc", b"CDF\x02", "nccopy"),
    ("a.hdf", b"\x0e\x03\x13\x01", "h4toh5"), ("IM0001", bytes(128) + b"DICM", "dcm2niix"),
])
def test_older_relatives_are_named(tmp_path: Path, name: str, start: bytes, hint: str) -> None:
    (tmp_path / name).write_bytes(start.ljust(600, b"\0"))
    error = refusal(tmp_path / name)
    assert (error.kind, error.reason) == (Kind.IO, "source-format")
    assert hint in str(error)


def test_what_is_no_array_of_real_numbers_is_refused(h5py: Any, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["text"], file["waves"], file["one"] = "words", VALUES.astype("c8"), 1.0
        file["empty"], file["null"] = np.zeros((0, 3)), h5py.Empty("f4")
    assert refusal(tmp_path / "a.h5").reason == "source-member"
    for member, reason in (("text", "source-dtype"), ("waves", "source-dtype"), ("one", "source-shape"),
                           ("empty", "source-shape"), ("null", "source-shape")):
        assert refusal(tmp_path / "a.h5", member=member).reason == reason, member


def test_a_filter_that_is_not_installed_is_named(h5py: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "hdf5plugin", None)
    made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    made.set_chunk((3, 4, 5))
    made.set_filter(32099, h5py.h5z.FLAG_OPTIONAL, ())
    with h5py.File(tmp_path / "a.h5", "w") as file:
        space = h5py.h5s.create_simple(VALUES.shape)
        dataset = h5py.Dataset(h5py.h5d.create(file.id, b"a", h5py.h5t.IEEE_F32LE, space, made))
        dataset.id.write_direct_chunk((0, 0, 0), VALUES.tobytes(), 0)
    error = refusal(tmp_path / "a.h5")
    assert error.reason == "hdf5plugin-missing"
    assert "32099" in str(error)
    assert "pip install hdf5plugin" in str(error)


def test_cut_files_are_refused(h5py: Any, tmp_path: Path) -> None:
    for name, options in (("a.h5", {}), ("b.h5", {"chunks": (1, 4, 5), "compression": "gzip"})):
        with h5py.File(tmp_path / name, "w") as file:
            file.create_dataset("array", data=VALUES, **options)
        refused_wherever_cut(tmp_path / name, 37)
        survives_damage(tmp_path / name)


def test_a_damaged_chunk_is_refused(h5py: Any, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        dataset = file.create_dataset("array", data=VALUES, chunks=(3, 4, 5), fletcher32=True)
        at = dataset.id.get_chunk_info(0).byte_offset
    data = bytearray((tmp_path / "a.h5").read_bytes())
    data[at + 9] ^= 1
    (tmp_path / "a.h5").write_bytes(data)
    assert refusal(tmp_path / "a.h5").reason == "source-damaged"


def test_what_does_not_fit_is_unpacked_into_a_file(
    h5py: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = np.arange(60 * 70 * 80, dtype=np.int32).reshape(60, 70, 80)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("array", data=values, chunks=(7, 9, 11), compression="gzip")
    little_memory(monkeypatch, 100_000)
    same(tmp_path / "a.h5", values, mapped=True)
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file.create_dataset("array", data=values, chunks=(60, 70, 80))
    assert refusal(tmp_path / "b.h5").reason == "memory"


def test_an_open_dataset_is_compressed_as_its_file_would_be(h5py: Any, tmp_path: Path) -> None:
    """Packed numbers and fill values are no data in Python either, and what they mean is measured against, too."""
    with h5py.File(tmp_path / "a.nc", "w") as file:
        field = file.create_dataset("field", data=VALUES.astype("i2"))
        field.attrs.update({"scale_factor": 0.5, "add_offset": 10.0, "_FillValue": np.int16(7)})
    by_name = open_array(tmp_path / "a.nc")
    with h5py.File(tmp_path / "a.nc") as file:
        for function in (hmkcta.compress, hmkcta.estimate):
            with pytest.raises(hmkcta.HmkctaError, match=r"1 values that are NaN.*nan=24.9 "):
                function(file["field"], snr=30)
        model = hmkcta.compress(file["field"], "R=2", nan=20)
        assert measure(model, file["field"], nan=20)[-1].snr_db == pytest.approx(model.snr, abs=1e-6)
    expected = hmkcta.compress(by_name, "R=2", nan=20)
    model.save(tmp_path / "a.hmk")
    expected.save(tmp_path / "b.hmk")
    assert (tmp_path / "a.hmk").read_bytes() == (tmp_path / "b.hmk").read_bytes()
    assert model.metadata.source_dtype == "float32"


def test_an_open_dataset_without_such_attributes_is_taken_as_it_is(h5py: Any, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("field", data=VALUES.astype("i2")).attrs["units"] = "K"
        assert hmkcta.compress(file["field"], "R=1").metadata.source_dtype == "int16"


def test_large_open_datasets_are_unpacked_slab_by_slab(
    h5py: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(conventions, "SLAB", 7)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        field = file.create_dataset("field", data=VALUES.astype("u2"))
        field.attrs["scale_factor"] = 0.5
        assert np.array_equal(conventions.meant(field), VALUES / 2)
