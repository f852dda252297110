"""NIfTI and NRRD: axes as in the header, first one fastest; mapped where the numbers are stored as they are."""

from __future__ import annotations

import bz2
import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hmkcta.errors import Kind
from hmkcta.readers import open_array
from reader_tools import DTYPES, VALUES, little_memory, needed, refusal, refused_wherever_cut, same, survives_damage


def nifti(path: Path, values: Any, *, slope: float | None = None, kind: str = "Nifti1Image") -> Path:
    """The values as a NIfTI image, in their own byte order."""
    nibabel = needed("nibabel")
    made = getattr(nibabel, kind)
    header = made.header_class(endianness=">" if values.dtype.byteorder == ">" else "<")
    image = made(values, np.eye(4), header, dtype=values.dtype.newbyteorder("="))
    if slope is not None:
        image.header.set_slope_inter(slope, 1.5)
    nibabel.save(image, path)
    return path


@pytest.mark.parametrize("dtype", [each for each in DTYPES if each != "i1"])
@pytest.mark.parametrize("kind", ["Nifti1Image", "Nifti2Image"])
def test_nifti_as_it_is_is_mapped(tmp_path: Path, dtype: str, kind: str) -> None:
    path = nifti(tmp_path / "a.nii", VALUES.astype(dtype), kind=kind)
    same(path, VALUES, dtype, mapped=True)
    (tmp_path / "a.nii.gz").write_bytes(gzip.compress(path.read_bytes()))
    same(tmp_path / "a.nii.gz", VALUES, dtype)


def test_nifti_of_two_files(tmp_path: Path) -> None:
    nifti(tmp_path / "a.img", VALUES, kind="Nifti1Pair")
    same(tmp_path / "a.hdr", VALUES, mapped=True)


@pytest.mark.parametrize("ending", [".nii", ".nii.gz"])
@pytest.mark.parametrize(("dtype", "expected"), [("<i2", "f4"), (">i2", "f4"), ("<i4", "f8"), (">f4", "f4")])
def test_nifti_is_scaled(tmp_path: Path, ending: str, dtype: str, expected: str) -> None:
    path = nifti(tmp_path / f"a{ending}", VALUES.astype(dtype), slope=0.25)
    image = needed("nibabel").load(path)
    array = open_array(path)
    assert array.dtype == np.dtype(expected)
    assert image.dataobj.slope == 0.25
    assert np.array_equal(array, image.get_fdata())
    assert not np.array_equal(array, VALUES)


def test_nifti_of_colours_is_refused(tmp_path: Path) -> None:
    colour = np.zeros((3, 4, 5), [("R", "u1"), ("G", "u1"), ("B", "u1")])
    needed("nibabel").save(needed("nibabel").Nifti1Image(colour, np.eye(4)), tmp_path / "a.nii")
    assert refusal(tmp_path / "a.nii").reason == "source-dtype"


def test_cut_nifti_is_refused(tmp_path: Path) -> None:
    refused_wherever_cut(nifti(tmp_path / "a.nii", VALUES), 11)
    refused_wherever_cut(nifti(tmp_path / "a.nii.gz", VALUES), 3)
    survives_damage(tmp_path / "a.nii")
    survives_damage(tmp_path / "a.nii.gz")


def test_gzip_of_anything_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.raw.gz").write_bytes(gzip.compress(VALUES.tobytes()))
    error = refusal(tmp_path / "a.raw.gz")
    assert (error.kind, error.reason) == (Kind.IO, "source-format")
    assert "gunzip" in str(error)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("encoding", ["raw", "gzip", "bzip2"])
@pytest.mark.parametrize("ending", [".nrrd", ".nhdr"])
def test_nrrd(tmp_path: Path, dtype: str, encoding: str, ending: str) -> None:
    path = tmp_path / f"a{ending}"
    needed("nrrd").write(str(path), VALUES.astype(dtype), {"encoding": encoding})
    same(path, VALUES, dtype, mapped=encoding == "raw")


@pytest.mark.parametrize("name", ["unsigned char", "uchar", "uint8_t", "short int", "unsigned short int", "int",
                                  "unsigned int", "uint", "long long", "unsigned long long int", "ulonglong", "double",
                                  "signed char", "signed short", "uint32_t"])
def test_names_of_nrrd_types(tmp_path: Path, name: str) -> None:
    nrrd = needed("nrrd")
    header = f"NRRD0004\ntype: {name}\ndimension: 1\nsizes: 40\nencoding: raw\nendian: big\n\n".encode()
    (tmp_path / "a.nrrd").write_bytes(header)
    expected = nrrd.reader._determine_datatype(nrrd.read_header(str(tmp_path / "a.nrrd")))
    (tmp_path / "a.nrrd").write_bytes(header + (bytes(range(64)) * 8)[:40 * expected.itemsize])
    array = open_array(tmp_path / "a.nrrd")
    assert array.dtype == expected
    assert np.array_equal(array, np.frombuffer(bytes(range(64)) * 8, expected)[:40])


def test_nrrd_as_text(tmp_path: Path) -> None:
    needed("nrrd").write(str(tmp_path / "a.nrrd"), VALUES, {"encoding": "ascii"})
    same(tmp_path / "a.nrrd", VALUES)
    text = "NRRD0004\ntype: float\ndimension: 3\nsizes: 3 4 5\nencoding: text\nline skip: 2\n"
    numbers = "7\n8\n" + " ".join(map(str, VALUES.ravel("F").tolist()))
    (tmp_path / "b.nrrd").write_text(f"{text}\n{numbers}")
    same(tmp_path / "b.nrrd", VALUES)
    (tmp_path / "c.nhdr").write_text(f"{text}data file: c.txt\n")
    (tmp_path / "c.txt").write_text(numbers)
    same(tmp_path / "c.nhdr", VALUES)


@pytest.mark.parametrize(("fields", "before"), [
    ("byte skip: 9\n", b"\1" * 9), ("line skip: 2\nbyte skip: 3\n", b"a\nbb\nccc"), ("byteskip: -1\n", b"\1" * 33),
])
def test_nrrd_skips(tmp_path: Path, fields: str, before: bytes) -> None:
    needed("nrrd")
    text = f"NRRD0004\ntype: float\ndimension: 3\nsizes: 3 4 5\nencoding: raw\nendian: little\n{fields}"
    (tmp_path / "a.nrrd").write_bytes(f"{text}\n".encode() + before + VALUES.tobytes("F"))
    same(tmp_path / "a.nrrd", VALUES, mapped=True)
    (tmp_path / "b.nhdr").write_text(f"{text}data file: b.raw\n")
    (tmp_path / "b.raw").write_bytes(before + VALUES.tobytes("F"))
    same(tmp_path / "b.nhdr", VALUES, mapped=True)


def test_packed_nrrd_skips_behind_its_unpacking(tmp_path: Path) -> None:
    needed("nrrd")
    text = "NRRD0004\ntype: float\ndimension: 3\nsizes: 3 4 5\nencoding: {}\nendian: little\nbyte skip: 5\n\n"
    for encoding, pack in (("gz", gzip.compress), ("bz2", bz2.compress)):
        (tmp_path / "a.nrrd").write_bytes(text.format(encoding).encode() + pack(b"abcde" + VALUES.tobytes("F")))
        same(tmp_path / "a.nrrd", VALUES)


@pytest.mark.parametrize(("change", "reason"), [
    ("data file: LIST\n", "source-format"), ("data file: slice%03d.raw 1 10 1\n", "source-format"),
    ("data file: gone.raw\n", "unreadable"), ("type: block\n", "source-format"), ("sizes: 3 0 5\n", "source-shape"),
    ("sizes: 3 4 5000\n", "source-truncated"), ("encoding: hex\n", "source-damaged"), ("endian: \n", "source-damaged"),
])
def test_what_nrrd_headers_may_not_say(tmp_path: Path, change: str, reason: str) -> None:
    needed("nrrd")
    lines = ["type: float\n", "dimension: 3\n", "sizes: 3 4 5\n", "encoding: raw\n", "endian: little\n"]
    kept = [line for line in lines if line.partition(":")[0] != change.partition(":")[0]]
    (tmp_path / "a.nrrd").write_bytes("".join(["NRRD0004\n", *kept, change, "\n"]).encode() + VALUES.tobytes())
    assert refusal(tmp_path / "a.nrrd").reason == reason


def test_cut_nrrd_is_refused(tmp_path: Path) -> None:
    for encoding in ("raw", "gzip", "bzip2"):
        path = tmp_path / f"{encoding}.nrrd"
        needed("nrrd").write(str(path), VALUES, {"encoding": encoding})
        refused_wherever_cut(path, 7)
        survives_damage(path)


def test_what_does_not_fit_is_unpacked_into_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.arange(40 * 50 * 60, dtype=np.int16).reshape(40, 50, 60)
    path = nifti(tmp_path / "a.nii.gz", values, slope=2)
    little_memory(monkeypatch, 10_000)
    same(path, 2 * values.astype("f4") + np.float32(1.5), mapped=True)
