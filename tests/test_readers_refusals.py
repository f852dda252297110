"""Refusals that say what a file is, and what reads it; one part that cannot be read leaves the others."""

from __future__ import annotations

import gzip
import json
import shutil
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_tools import refused
from hmkcta.errors import Kind
from reader_tools import VALUES, needed, refusal, same


@pytest.mark.parametrize("block", [4096, 8192, 1 << 20])
@pytest.mark.parametrize("chunks", [None, (1, 4, 5)])
def test_long_user_blocks_open(tmp_path: Path, block: int, chunks: Any) -> None:
    with needed("h5py").File(tmp_path / "a.h5", "w", userblock_size=block) as file:
        file.create_dataset("a", data=VALUES, chunks=chunks)
    with open(tmp_path / "a.h5", "r+b") as raw:
        raw.write(b"#!/bin/sh\n" * 20)
    shutil.copy(tmp_path / "a.h5", tmp_path / "unnamed")
    for name in ("a.h5", "unnamed"):
        same(tmp_path / name, VALUES, mapped=chunks is None)


def damaged_hdf5(path: Path) -> None:
    """A file of three datasets and a group, of which one dataset's header is overwritten."""
    h5py = needed("h5py")
    with h5py.File(path, "w") as file:
        file["good"], file["other"], file["bad"], file["group/deep"] = VALUES, VALUES[0], VALUES[1], VALUES[2]
        at = h5py.h5o.get_info(file["bad"].id).addr
    data = bytearray(path.read_bytes())
    data[at:at + 40] = b"\xff" * 40
    path.write_bytes(data)


def test_one_damaged_dataset_leaves_the_others(tmp_path: Path) -> None:
    damaged_hdf5(tmp_path / "a.h5")
    same(f"{tmp_path}/a.h5:good", VALUES, mapped=True)
    same(f"{tmp_path}/a.h5:group", VALUES[2], mapped=True)
    error = refusal(tmp_path / "a.h5")
    assert (error.kind, error.reason) == (Kind.INVALID_ARGUMENT, "source-member")
    listed = str(error.found)
    assert "/bad (not read: " in listed
    for text in ("/good (3 x 4 x 5 of float32)", "/group/deep (4 x 5 of float32)", "/other (4 x 5 of float32)"):
        assert text in listed
    error = refusal(f"{tmp_path}/a.h5:bad")
    assert error.kind is Kind.IO
    assert "fetch it again" not in str(error)


@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("how", ["codec", "json", "gone"])
@pytest.mark.parametrize("packed", [False, True])
def test_one_damaged_array_leaves_the_others(tmp_path: Path, version: int, how: str, packed: bool) -> None:
    zarr = needed("zarr")
    group = zarr.open_group(tmp_path / "a.zarr", mode="w", zarr_format=version)
    for name in ("good", "run/other", "bad"):
        group.create_array(name, data=VALUES)
    described = tmp_path / "a.zarr" / "bad" / ("zarr.json" if version == 3 else ".zarray")
    if how == "codec":
        said = json.loads(described.read_text())
        said |= {"codecs": [{"name": "none.of.ours"}]} if version == 3 else {"compressor": {"id": "none-of-ours"}}
        described.write_text(json.dumps(said))
    else:
        described.write_text("{" if how == "json" else "{}")
    path = Path(shutil.make_archive(str(tmp_path / "b"), "zip", tmp_path / "a.zarr")) if packed else tmp_path / "a.zarr"
    same(f"{path}:good", VALUES)
    same(f"{path}:run/other", VALUES)
    error = refusal(path)
    assert error.reason == "source-member"
    assert "bad (not read: " in str(error)
    assert "good (3 x 4 x 5 of float32), run/other (3 x 4 x 5 of float32)" in str(error)
    error = refusal(f"{path}:bad")
    assert error.reason == "source-damaged"
    assert "fetch it again" not in str(error)


def analyze(folder: Path) -> Path:
    """A pair of files as they were before NIfTI."""
    nibabel = needed("nibabel")
    nibabel.save(nibabel.AnalyzeImage(VALUES, np.eye(4)), folder / "a.img")
    return folder / "a.hdr"


def test_what_is_known_is_named_with_what_reads_it(tmp_path: Path) -> None:
    nibabel, scipy = needed("nibabel"), needed("scipy.io")
    for name in ("a.mgz", "b.mgh"):
        nibabel.save(nibabel.MGHImage(VALUES, np.eye(4)), tmp_path / name)
    scipy.savemat(tmp_path / "4.mat", {"a": VALUES[0]}, format="4")
    scipy.savemat(tmp_path / "5.mat", {"a": VALUES}, format="5")
    analyze(tmp_path)
    (tmp_path / "renamed.dat").write_bytes((tmp_path / "5.mat").read_bytes())
    for name, what, reader in (
        ("a.mgz", "FreeSurfer", "mri_convert"), ("b.mgh", "FreeSurfer", "nibabel"), ("a.hdr", "Analyze", "nibabel"),
        ("a.img", "Analyze", "nibabel"), ("4.mat", "MATLAB before 7.3", "loadmat"),
        ("5.mat", "MATLAB before 7.3", "-v7.3"), ("renamed.dat", "MATLAB before 7.3", "loadmat"),
    ):
        error = refusal(tmp_path / name)
        assert (error.kind, error.reason) == (Kind.IO, "source-format"), name
        for words in (what, "not read", reader):
            assert words in str(error), name
        assert "fetch it again" not in str(error)


@pytest.mark.parametrize(("name", "start", "what", "reader"), [
    ("a.vtk", b"# vtk DataFile Version 3.0\n", "VTK", "pyvista"),
    ("a.hdr", b"ENVI\nsamples = 3\n", "ENVI", "--shape"),
    ("a.nii.bz2", b"BZh91AY", "bzip2", "bunzip2"), ("a+orig.HEAD", b"type = string", "AFNI", "3dAFNItoNIFTI"),
    ("a.PAR", b"# === DATA DESCRIPTION", "PAR/REC", "parrec2nii"), ("a.czi", b"ZISRAWFILE", "CZI", "bfconvert"),
    ("a.mrc", bytes(208) + b"MAP ", "MRC", "mrcfile"), ("a.grib", b"GRIB", "GRIB", "cdo"),
    ("a.sav", b"SR\0\4", "IDL", "readsav"), ("a.wav", b"RIFF\0\0\0\0WAVE", "sound", "wavfile"),
    ("a.tif", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "Git LFS", "git lfs pull"),
    ("a.npy", b"<!DOCTYPE html><html>", "a web page", "browser"), ("a", b"<html>404", "a web page", "browser"),
])
def test_other_formats_of_laboratories(tmp_path: Path, name: str, start: bytes, what: str, reader: str) -> None:
    (tmp_path / name).write_bytes(start.ljust(600, b"\0"))
    error = refusal(tmp_path / name)
    assert (error.kind, error.reason) == (Kind.IO, "source-format")
    assert what in str(error)
    assert reader in str(error)
    assert "fetch it again" not in str(error)


@pytest.mark.parametrize(("lines", "what"), [
    ("spacings: 1 1 1\nspacings: 2 2 2\n", "spacings"), ("line skip: 1\nlineskip: 2\n", "lineskip"),
    ("key:=1\nkey:=2\n", "key"), ("encoding: gzip\n", "encoding"),
])
def test_fields_of_nrrd_that_come_twice(tmp_path: Path, lines: str, what: str) -> None:
    needed("nrrd")
    header = f"NRRD0004\ntype: float\ndimension: 3\nsizes: 3 4 5\nencoding: raw\nendian: little\n{lines}\n"
    (tmp_path / "a.nrrd").write_bytes(header.encode() + VALUES.tobytes("F"))
    error = refusal(tmp_path / "a.nrrd")
    assert (error.kind, error.reason) == (Kind.IO, "source-format")
    assert f"the field {what} twice" in str(error)
    assert "ALLOW_DUPLICATE_FIELD" in str(error)
    sentence = refused("compress", tmp_path / "a.nrrd", "-o", tmp_path / "a.hmk", code=3)
    assert "source-format" in sentence
    assert "fetch it again" not in sentence


@pytest.mark.parametrize("change", [
    b"NRRD0006\n", b"NRRD0009\n", b"type: block\n", b"encoding: zrl\n", b"dimension: 2\n", b"endian: middle\n",
])
def test_what_a_whole_nrrd_may_say_and_is_not_read(tmp_path: Path, change: bytes) -> None:
    needed("nrrd")
    lines = [b"NRRD0004\n", b"type: float\n", b"dimension: 3\n", b"sizes: 3 4 5\n", b"encoding: raw\n",
             b"endian: little\n"]
    kept = [change if line[:4] == change[:4] else line for line in lines]
    (tmp_path / "a.nrrd").write_bytes(b"".join(kept) + b"\n" + VALUES.tobytes("F"))
    assert "fetch it again" not in str(refusal(tmp_path / "a.nrrd"))


@pytest.mark.parametrize("said", ["LIST\na.raw\nb.raw", "LIST 2\na.raw\nb.raw", "a%03d.raw 1 3 1"])
def test_a_nrrd_of_several_files_is_named_so(tmp_path: Path, said: str) -> None:
    needed("nrrd")
    (tmp_path / "a.nhdr").write_text("NRRD0004\ntype: float\ndimension: 3\nsizes: 3 4 5\nencoding: raw\n"
                                     f"endian: little\ndata file: {said}\n")
    error = refusal(tmp_path / "a.nhdr")
    assert error.reason == "source-format"
    assert "allowed one data file" in str(error)


def test_a_packed_analyze_image(tmp_path: Path) -> None:
    analyze(tmp_path)
    for name in ("a.hdr", "a.img"):
        (tmp_path / f"{name}.gz").write_bytes(gzip.compress((tmp_path / name).read_bytes()))
    assert "Analyze" in str(refusal(tmp_path / "a.img.gz"))


def test_pictures_of_volumes_by_either_name(tmp_path: Path) -> None:
    nibabel = needed("nibabel")
    nibabel.save(nibabel.Nifti1Pair(VALUES, np.eye(4)), tmp_path / "a.img")
    same(tmp_path / "a.img", VALUES, mapped=True)
    (tmp_path / "raw.img").write_bytes(bytes(1000))
    assert "--shape" in str(refusal(tmp_path / "raw.img"))


def test_nothing_is_said_of_headers_that_are_read(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    nibabel = needed("nibabel")
    nibabel.save(nibabel.Nifti1Image(VALUES, np.eye(4)), tmp_path / "a.nii")
    data = bytearray((tmp_path / "a.nii").read_bytes())
    data[108:112], data[76:80] = struct.pack("<f", 353), struct.pack("<f", 3)  # not for SPM; no handedness
    (tmp_path / "a.nii").write_bytes(data[:352] + b"\0" + data[352:])
    capfd.readouterr()
    same(tmp_path / "a.nii", VALUES, mapped=True)
    assert capfd.readouterr() == ("", "")


def test_empty_arrays_of_matlab_are_no_arrays(tmp_path: Path) -> None:
    with needed("h5py").File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file["empty"], file["full"] = np.array([0, 0], "u8"), VALUES.T
        for name in file:
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["empty"].attrs["MATLAB_empty"] = 1
    same(tmp_path / "a.mat", VALUES, mapped=True)
    assert refusal(tmp_path / "a.mat", member="empty").reason == "source-shape"


def test_names_in_attributes_may_be_bytes(tmp_path: Path) -> None:
    """As netCDF's own library writes them."""
    with needed("h5py").File(tmp_path / "a.nc", "w") as file:
        file["field"], file["lat"] = VALUES, VALUES[0]
        file["field"].attrs["coordinates"] = np.bytes_("lat")
    same(tmp_path / "a.nc", VALUES, mapped=True)
