"""Every array that can be read is read right, and everything else is refused with a sentence that says why."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hmkcta.errors import HmkctaError, Kind
from hmkcta.readers import open_array, read_coordinates
from reader_tools import refusal

VALUES = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
DTYPES = ["<f4", ">f4", "<f2", ">f2", "<f8", ">f8", "u1", "i1", "<i2", ">u2", "<i4", ">i4", "<i8", ">u8"]


def saved(path: Path, array: Any) -> Path:
    """The array as a `.npy` file."""
    np.save(path, array, allow_pickle=False)
    return path


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("order", ["C", "F"])
def test_npy_is_mapped(tmp_path: Path, dtype: str, order: Any) -> None:
    array = open_array(saved(tmp_path / "a.npy", VALUES.astype(dtype, order=order)))
    assert isinstance(array, np.memmap)
    assert array.dtype == np.dtype(dtype)
    assert np.array_equal(array, VALUES)


def test_npy_of_version_two(tmp_path: Path) -> None:
    with open(tmp_path / "a.npy", "wb") as file:
        np.lib.format.write_array(file, VALUES, version=(2, 0))
    assert np.array_equal(open_array(tmp_path / "a.npy"), VALUES)


def test_npy_of_an_unknown_version(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.npy", VALUES)
    path.write_bytes(path.read_bytes()[:6] + b"\x09\x01" + path.read_bytes()[8:])
    assert str(refusal(path)) == (
        f"{path}: found version 9.1 of the .npy format, allowed 1.0 or 2.0. "
        "Next: load it with what wrote it, and save it with numpy.save. [Io/source-format]"
    )


def test_array_of_one_element(tmp_path: Path) -> None:
    assert open_array(saved(tmp_path / "a.npy", np.ones(1))).tolist() == [1.0]


@pytest.mark.parametrize("compressed", [False, True])
def test_single_npz_member_is_the_default(tmp_path: Path, compressed: bool) -> None:
    path = tmp_path / "a.npz"
    (np.savez_compressed if compressed else np.savez)(path, wood=np.asfortranarray(VALUES))
    array = open_array(path)
    assert isinstance(array, np.memmap) != compressed
    assert np.array_equal(array, VALUES)


def test_npz_member_by_name(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, wood=VALUES, jet=-VALUES)
    assert np.array_equal(open_array(f"{path}:jet"), -VALUES)
    assert np.array_equal(open_array(path, member="wood"), VALUES)


def test_npz_with_several_members_lists_them(tmp_path: Path) -> None:
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "a.npz", wood=VALUES, jet=VALUES[0].astype("u2"), notes=["oak"])
        error = refusal(tmp_path / "a.npz")
        assert (error.kind, error.reason) == (Kind.INVALID_ARGUMENT, "source-member")
        listed = "jet (3 x 4 of uint16), notes, wood (2 x 3 x 4 of float32)"
        assert f"found {listed}, allowed" in str(error)
        assert f"{listed}. Next: write {tmp_path}/a.npz:NAME" in str(refusal(f"{tmp_path}/a.npz:stone"))


def test_colon_in_a_file_name(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz:b", wood=VALUES)
    assert np.array_equal(open_array(tmp_path / "a.npz:b.npz"), VALUES)


@pytest.mark.parametrize(("dtype", "order", "offset"), [("<f4", "C", 0), (">f4", "F", 7), ("uint8", "C", 512)])
def test_raw_binary(tmp_path: Path, dtype: str, order: Any, offset: int) -> None:
    stored = VALUES.astype(dtype)
    (tmp_path / "a.raw").write_bytes(b"\0" * offset + stored.tobytes(order))
    array = open_array(tmp_path / "a.raw", shape=(2, 3, 4), dtype=dtype, order=order, offset=offset)
    assert isinstance(array, np.memmap)
    assert np.array_equal(array, VALUES)


@pytest.mark.parametrize(("count", "kind"), [(95, Kind.IO), (0, Kind.IO), (97, Kind.INVALID_ARGUMENT)])
def test_raw_of_another_size_gives_both_numbers(tmp_path: Path, count: int, kind: Kind) -> None:
    (tmp_path / "a.raw").write_bytes(bytes(count))
    error = refusal(tmp_path / "a.raw", shape=(2, 3, 4), dtype="float32")
    assert error.kind is kind
    assert f"found {count} bytes" in str(error)
    assert "96 bytes for 2 x 3 x 4 of float32" in str(error)


@pytest.mark.parametrize(("options", "reason"), [
    ({"shape": (24,)}, "raw-description"),
    ({"dtype": "float32"}, "raw-description"),
    ({"shape": (24,), "dtype": "float33"}, "raw-dtype"),
    ({"shape": (24,), "dtype": "float32", "order": "A"}, "raw-order"),
    ({"shape": (24,), "dtype": "float32", "offset": -4}, "raw-offset"),
    ({"shape": (), "dtype": "float32"}, "source-shape"),
    ({"shape": (24, 0), "dtype": "float32"}, "source-shape"),
    ({"shape": (-4, -6), "dtype": "f4"}, "source-shape"),
    ({"shape": (12,), "dtype": "complex64"}, "source-dtype"),
    ({"shape": (2**62, 2**62), "dtype": "f4"}, "raw-too-short"),
])
def test_wrong_description_of_raw(tmp_path: Path, options: dict[str, Any], reason: str) -> None:
    (tmp_path / "a.raw").write_bytes(bytes(96))
    assert refusal(tmp_path / "a.raw", **options).reason == reason


@pytest.mark.parametrize("array", [
    np.zeros(3, np.complex64), np.zeros(3, "M8[s]"), np.zeros(3, "U4"), np.zeros(3, "S4"),
    np.zeros(3, [("a", "f4")]), np.zeros(3, np.longdouble),
], ids=lambda array: str(array.dtype))
def test_numbers_that_are_not_real_are_refused(tmp_path: Path, array: Any) -> None:
    error = refusal(saved(tmp_path / "a.npy", array))
    assert (error.kind, error.reason) == (Kind.INVALID_ARGUMENT, "source-dtype")
    assert "integers, booleans, or float16 to float64" in str(error)


def test_pickled_objects_are_refused_unread(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([{"x": 1}, None], object), allow_pickle=True)
    assert refusal(tmp_path / "a.npy").reason == "source-dtype"


@pytest.mark.parametrize("shape", [(), (0,), (3, 0)])
def test_arrays_without_elements_or_axes(tmp_path: Path, shape: tuple[int, ...]) -> None:
    assert refusal(saved(tmp_path / "a.npy", np.zeros(shape))).reason == "source-shape"


def test_every_truncation_is_refused(tmp_path: Path) -> None:
    whole = saved(tmp_path / "whole.npy", VALUES).read_bytes()
    for length in range(len(whole)):
        (tmp_path / "a.npy").write_bytes(whole[:length])
        error = refusal(tmp_path / "a.npy")
        assert error.kind is Kind.IO, (length, error)
        assert error.reason in ("source-truncated", "source-damaged")


def test_every_truncation_of_an_archive_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "whole.npz", wood=VALUES)
    whole = (tmp_path / "whole.npz").read_bytes()
    for length in range(0, len(whole), 3):
        (tmp_path / "a.npz").write_bytes(whole[:length])
        assert refusal(tmp_path / "a.npz").kind is Kind.IO, length


def test_archive_with_a_damaged_member(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", wood=np.random.default_rng(0).random(1000))
    data = bytearray((tmp_path / "a.npz").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "a.npz").write_bytes(data)
    assert refusal(tmp_path / "a.npz").reason == "source-damaged"


def test_stored_members_that_end_before_their_numbers(tmp_path: Path) -> None:
    """Because the archive holds less of them, or says that it does."""
    path, whole = tmp_path / "a.npz", saved(tmp_path / "a.npy", VALUES).read_bytes()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("wood.npy", whole[:-4])
    said = "allowed 96 bytes for 2 x 3 x 4 of float32"
    assert f"{path}:wood: found 92 bytes of numbers, {said}, as its header says. Next: fetch" in str(refusal(path))
    longer = np.lib.format.header_data_from_array_1_0(VALUES) | {"shape": (2, 3, 4000)}
    with open(tmp_path / "b.npy", "wb") as file:
        np.lib.format.write_array_header_1_0(file, longer)
        header = file.tell()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("wood.npy", (tmp_path / "b.npy").read_bytes() + VALUES.tobytes())
        archive.getinfo("wood.npy").file_size = header + 96_000  # as its directory says, which is written at the end
    assert str(refusal(path)) == (
        f"{path}:wood: found the end of the file within it, allowed 96000 bytes for 2 x 3 x 4000 of float32. "
        "Next: fetch it again. [Io/source-truncated]"
    )


def test_archive_without_arrays(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("readme.txt", "no arrays")
    assert refusal(tmp_path / "a.npz").reason == "source-member"


def test_longer_than_its_header_says(tmp_path: Path) -> None:
    with open(saved(tmp_path / "a.npy", VALUES), "ab") as file:
        file.write(b"\0")
    assert "found 97 bytes" in str(refusal(tmp_path / "a.npy"))


@pytest.mark.parametrize("header", [
    "{'descr': '<f4', 'fortran_order': False, 'shape': (4611686018427387904, 4), }", "{'descr': '<f4'}", "[1, 2]",
    "{'descr': '<f4', 'fortran_order': False, 'shape': (-2, -2), }", "(" * 500, "not even Python",
    "{'descr': '<q9', 'fortran_order': False, 'shape': (2,), }",
])
def test_lies_in_the_header(tmp_path: Path, header: str) -> None:
    text = header.encode().ljust(117) + b"\n"
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + bytes(16))
    assert refusal(tmp_path / "a.npy").kind in (Kind.IO, Kind.INVALID_ARGUMENT)


@pytest.mark.parametrize("name", ["missing.npy", ".", "n" * 300, "nul\0.npy"])
def test_files_that_are_not_there(tmp_path: Path, name: str) -> None:
    error = refusal(tmp_path / name)
    assert (error.kind, error.reason) == (Kind.IO, "unreadable")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_pipe_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.npy")
    assert refusal(tmp_path / "pipe.npy").reason == "unreadable"


def test_unknown_format_asks_for_a_description(tmp_path: Path) -> None:
    (tmp_path / "a.dat").write_bytes(bytes(96))
    error = refusal(tmp_path / "a.dat")
    assert error.reason == "source-format"
    assert "--shape 64,64,3 --dtype float32" in str(error)


def test_member_of_a_plain_array(tmp_path: Path) -> None:
    assert refusal(saved(tmp_path / "a.npy", VALUES), member="wood").reason == "source-member"


@pytest.mark.parametrize(("name", "text", "expected"), [
    ("a.txt", "# zenith\n\n30\n60\n", [30, 60]), ("a.csv", "0,0,1\n0.6, 0, 0.8 # second\n", [[0, 0, 1], [0.6, 0, 0.8]]),
    ("a.txt", "", []), ("a.csv", "theta, phi\n30,1\n60,2\n", [[30, 1], [60, 2]]), ("a.txt", "zenith\n30\n", [30]),
])
def test_coordinates_from_a_table(tmp_path: Path, name: str, text: str, expected: list[Any]) -> None:
    (tmp_path / name).write_text(text)
    assert read_coordinates(str(tmp_path / name)).tolist() == expected


@pytest.mark.parametrize(("name", "text"), [
    ("a.txt", "1 2\n3\n"), ("a.txt", "1,2\n"), ("a.csv", "nan,y\n1,2\n"),
    ("a.csv", "x,1\n1,2\n"), ("a.csv", "x,y\nx,y\n1,2\n"),
])
def test_what_is_no_table_is_refused(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(HmkctaError) as caught:
        read_coordinates(str(tmp_path / name))
    assert (caught.value.kind, caught.value.reason) == (Kind.IO, "coords-table")
