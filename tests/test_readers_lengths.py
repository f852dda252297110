"""Files are as long as their headers say, in every format: others are refused, and wild counts end with the file."""

from __future__ import annotations

import bz2
import gzip
import os
import shutil
import struct
import time
import tracemalloc
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hmkcta.errors import Kind
from hmkcta.readers import nrrd_encodings, open_array
from reader_tools import VALUES, needed, refusal, same, survives_damage

#: An encoding of NRRD, and what it makes of bytes.
PACKED: dict[str, Callable[[bytes], bytes]] = {
    "raw": lambda data: data, "gzip": gzip.compress, "bz2": bz2.compress,
    "hex": lambda data: b"\n".join(data.hex()[at:at + 70].encode() for at in range(0, 2 * len(data), 70)) + b"\n",
    "txt": lambda data: b"\n".join(str(float(number)).encode() for number in np.frombuffer(data, "<f4")) + b"\n",
}
DATA = VALUES.tobytes("F")


def nrrd(path: Path, encoding: str, data: bytes, fields: str = "", *, detached: bool = False, sizes: str = "3 4 5"
         ) -> Path:
    """A NRRD file of float32, with its header or beside it."""
    needed("nrrd")
    header = (f"NRRD0004\ntype: float\ndimension: 3\nsizes: {sizes}\nencoding: {encoding}\nendian: little\n{fields}")
    if detached:
        path = path.with_suffix(".nhdr")
        path.with_suffix(".bin").write_bytes(data)
        path.write_text(f"{header}data file: {path.stem}.bin\n")
    else:
        path.write_bytes(f"{header}\n".encode() + data)
    return path


@pytest.mark.parametrize("encoding", PACKED)
@pytest.mark.parametrize("detached", [False, True])
def test_nrrd_is_as_long_as_its_header_says(tmp_path: Path, encoding: str, detached: bool) -> None:
    pack = PACKED[encoding]
    same(nrrd(tmp_path / "a.nrrd", encoding, pack(DATA), detached=detached), VALUES, mapped=encoding == "raw")
    for data, reason in ((DATA[:-4], "source-truncated"), (DATA + DATA[:4], "source-too-long"),
                         (DATA[:-100], "source-truncated"), (DATA + DATA, "source-too-long")):
        error = refusal(nrrd(tmp_path / "a.nrrd", encoding, pack(data), detached=detached))
        assert (error.kind, error.reason) == (Kind.IO, reason)
    path = nrrd(tmp_path / "b.nrrd", encoding, pack(DATA), detached=detached, sizes="3 4 4")
    assert refusal(path).reason == "source-too-long"


@pytest.mark.parametrize("encoding", ["raw", "gzip", "bz2"])
@pytest.mark.parametrize("before", [0, 3, 4, 999])
def test_byte_skip_minus_one_takes_the_last_bytes(tmp_path: Path, encoding: str, before: int) -> None:
    for detached in (False, True):
        data = PACKED[encoding](b"\1" * before + DATA)
        path = nrrd(tmp_path / "a.nrrd", encoding, data, "byte skip: -1\n", detached=detached)
        same(path, needed("nrrd").read(str(path))[0], mapped=encoding == "raw")
        same(path, VALUES, mapped=encoding == "raw")
        path = nrrd(tmp_path / "a.nrrd", encoding, PACKED[encoding](DATA[4:]), "byte skip: -1\n", detached=detached)
        assert refusal(path).reason == "source-truncated"  # the header's letters are no voxels


def test_lines_and_bytes_before_packed_data(tmp_path: Path) -> None:
    for encoding in ("gzip", "bz2"):
        data = b"two\nlines\n" + PACKED[encoding](b"12345" + DATA)
        same(nrrd(tmp_path / "a.nrrd", encoding, data, "line skip: 2\nbyte skip: 5\n"), VALUES)
    for encoding in ("hex", "txt"):
        data = b"two\nlines\nxyz" + PACKED[encoding](DATA)
        same(nrrd(tmp_path / "a.nrrd", encoding, data, "lineskip: 2\nbyteskip: 3\n"), VALUES)


@pytest.mark.parametrize(("fields", "reason"), [
    ("line skip: 2000000000\n", "source-truncated"), ("byte skip: 2000000000000\n", "source-truncated"),
    ("line skip: -1\n", "source-damaged"), ("byte skip: -2\n", "source-damaged"),
])
@pytest.mark.parametrize("encoding", PACKED)
def test_wild_counts_end_with_the_file(tmp_path: Path, fields: str, reason: str, encoding: str) -> None:
    for detached in (False, True):
        path = nrrd(tmp_path / "a.nrrd", encoding, PACKED[encoding](DATA), fields, detached=detached)
        began = time.monotonic()
        assert refusal(path).reason == reason
        assert time.monotonic() - began < 1


@pytest.mark.parametrize("encoding", PACKED)
def test_wild_sizes_end_with_the_file(tmp_path: Path, encoding: str) -> None:
    for sizes in ("3 4 2000000000", "3 4 50000"):
        path = nrrd(tmp_path / "a.nrrd", encoding, PACKED[encoding](DATA), sizes=sizes)
        assert refusal(path).reason == "source-truncated"


def test_a_packed_file_with_endless_bytes_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nrrd_encodings, "MOST_BEFORE", 1 << 16)
    path = nrrd(tmp_path / "a.nrrd", "bz2", bz2.compress(bytes(1 << 22) + DATA), "byte skip: -1\n")
    assert refusal(path).reason == "source-too-long"


@pytest.mark.parametrize("number", ["seven", "1_0", "1,2", "0x10", "9" * 5000])
def test_text_that_is_no_number(tmp_path: Path, number: str) -> None:
    data = PACKED["txt"](DATA).replace(b"\n7.0\n", f"\n{number}\n".encode())
    assert refusal(nrrd(tmp_path / "a.nrrd", "txt", data)).reason == "source-damaged"


def test_whole_numbers_as_text_are_of_their_type(tmp_path: Path) -> None:
    needed("nrrd")
    header = "NRRD0004\ntype: uchar\ndimension: 1\nsizes: 3\nencoding: text\n\n"
    for text, values in (("1 2\n255", [1, 2, 255]), ("1 2 256", None), ("1 2 -1", None), ("1 2.5 3", None)):
        (tmp_path / "a.nrrd").write_text(header + text)
        if values is None:
            assert refusal(tmp_path / "a.nrrd").reason == "source-damaged"
        else:
            same(tmp_path / "a.nrrd", np.array(values, np.uint8))


def test_text_across_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nrrd_encodings, "BLOCK", 7)
    for encoding in PACKED:
        same(nrrd(tmp_path / "a.nrrd", encoding, b"a\nb\n" + PACKED[encoding](DATA), "line skip: 2\n"), VALUES,
             mapped=encoding == "raw")


@pytest.mark.parametrize("slope", [None, 2.0])
@pytest.mark.parametrize("ending", [".nii", ".nii.gz"])
def test_nifti_is_as_long_as_its_header_says(tmp_path: Path, slope: float | None, ending: str) -> None:
    nibabel = needed("nibabel")
    image = nibabel.Nifti1Image(VALUES.astype("i2"), np.eye(4), dtype="i2")
    image.header.set_slope_inter(slope, None if slope is None else 0)
    nibabel.save(image, tmp_path / "a.nii")
    whole = (tmp_path / "a.nii").read_bytes()
    pack = gzip.compress if ending == ".nii.gz" else bytes
    path = tmp_path / f"b{ending}"
    path.write_bytes(pack(whole))
    assert np.array_equal(open_array(path), VALUES * (slope or 1))
    for data, reason in ((whole[:-2], "source-truncated"), (whole + b"\0\0", "source-too-long"),
                         (whole + whole, "source-too-long")):
        path.write_bytes(pack(data))
        assert refusal(path).reason == reason


def test_nifti_of_two_files_is_as_long_as_its_header_says(tmp_path: Path) -> None:
    nibabel = needed("nibabel")
    nibabel.save(nibabel.Nifti1Pair(VALUES, np.eye(4)), tmp_path / "a.img")
    same(tmp_path / "a.img", VALUES, mapped=True)
    whole = (tmp_path / "a.img").read_bytes()
    for data, reason in ((whole[:-4], "source-truncated"), (whole + b"\0", "source-too-long")):
        (tmp_path / "a.img").write_bytes(data)
        assert refusal(tmp_path / "a.hdr").reason == refusal(tmp_path / "a.img").reason == reason
    (tmp_path / "a.img").unlink()
    error = refusal(tmp_path / "a.hdr")
    assert error.reason == "unreadable"
    assert "a.img" in str(error)


def test_a_packed_nifti_whose_header_says_more_than_gzip_can_hold(tmp_path: Path) -> None:
    nibabel = needed("nibabel")
    nibabel.save(nibabel.Nifti1Image(VALUES, np.eye(4)), tmp_path / "a.nii")
    data = bytearray((tmp_path / "a.nii").read_bytes())
    data[40:48] = np.array([3, 30_000, 30_000, 30_000], "<i2").tobytes()
    (tmp_path / "a.nii.gz").write_bytes(gzip.compress(bytes(data)))
    assert refusal(tmp_path / "a.nii.gz").reason == "source-truncated"


@pytest.mark.parametrize("version", [2, 3])
def test_chunks_of_zarr_are_as_long_as_its_metadata_say(tmp_path: Path, version: int) -> None:
    zarr = needed("zarr")
    for number, compressors in enumerate((None, "auto")):
        folder = tmp_path / f"{number}.zarr"
        zarr.create_array(folder, data=VALUES, chunks=(3, 4, 5), zarr_format=version, compressors=compressors)
        chunk = folder / ("0.0.0" if version == 2 else "c/0/0/0")
        whole = chunk.read_bytes()
        for data in (whole[:-4], whole + b"\0\0\0\0", whole * 2):
            chunk.write_bytes(data)
            if compressors is None or len(data) < len(whole):
                assert refusal(folder).reason == "source-damaged"


def test_members_of_npz_are_as_long_as_their_headers_say(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", VALUES)
    whole = (tmp_path / "a.npy").read_bytes()
    for compression in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        for data, reason in ((whole[:-4], "source-truncated"), (whole + b"\0", "source-too-long")):
            with zipfile.ZipFile(tmp_path / "a.npz", "w", compression) as archive:
                archive.writestr("a.npy", data)
            assert refusal(tmp_path / "a.npz").reason == reason


def test_hdf5_in_one_piece_is_within_its_file(tmp_path: Path) -> None:
    h5py: Any = needed("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a"] = np.zeros(4000)
    whole = (tmp_path / "a.h5").read_bytes()
    (tmp_path / "a.h5").write_bytes(whole[:-8])
    with warnings.catch_warnings():
        assert refusal(tmp_path / "a.h5").kind is Kind.IO


@pytest.mark.parametrize("filters", [{}, {"compression": "gzip"}, {"compression": "gzip", "shuffle": True},
                                     {"compression": "gzip", "fletcher32": True}])
def test_chunks_of_hdf5_are_as_long_as_their_dataset_says(filters: dict[str, Any], tmp_path: Path) -> None:
    """What is missing HDF5 leaves as it finds memory."""
    h5py: Any = needed("h5py")

    def stored(rows: int) -> tuple[int, bytes]:
        """A chunk of so many rows, as the filters make it."""
        with h5py.File(tmp_path / "chunk.h5", "w") as file:
            dataset = file.create_dataset("a", (rows, 30), chunks=(rows, 30), dtype="i4", **filters)
            dataset[...] = np.arange(rows * 30).reshape(rows, 30)
            file.flush()
            return dataset.id.read_direct_chunk((0, 0))

    for rows, reason in ((20, ""), (10, "source-truncated"), (30, "source-too-long")):
        with h5py.File(tmp_path / "a.h5", "w") as file:
            dataset = file.create_dataset("a", (40, 30), chunks=(20, 30), dtype="i4", **filters)
            dataset[:20] = np.arange(600).reshape(20, 30)
            mask, data = stored(rows)
            dataset.id.write_direct_chunk((20, 0), data, mask)
        if reason:
            error = refusal(tmp_path / "a.h5")
            assert error.reason == reason
            assert "chunk at 20, 0" in str(error)
        else:
            same(tmp_path / "a.h5", np.tile(np.arange(600).reshape(20, 30), (2, 1)), "i4")


def test_what_is_stored_of_an_array_is_not_widened_without_bounds(tmp_path: Path) -> None:
    h5py, zarr = needed("h5py"), needed("zarr")
    shape, zeros = (50, 1024, 1024), np.zeros((50, 1024, 1024), np.uint16)
    with h5py.File(tmp_path / "few.h5", "w") as file:
        file.create_dataset("a", shape, "u2", chunks=(1, 256, 256), compression="gzip")[0, 0, 0] = 0
    with h5py.File(tmp_path / "none.h5", "w") as file:
        file.create_dataset("a", shape, "u2")
    layout = h5py.VirtualLayout(shape, "u2")
    layout[0, :4, :4] = h5py.VirtualSource("few.h5", "a", shape)[0, :4, :4]
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        file.create_virtual_dataset("a", layout)
    zarr.create_array(str(tmp_path / "a.zarr"), shape=shape, dtype="u2", chunks=(1, 256, 256))
    shutil.make_archive(str(tmp_path / "a"), "zip", tmp_path / "a.zarr")
    for name in ("few.h5", "none.h5", "virtual.h5", "a.zarr", "a.zip"):
        error = refusal(tmp_path / name)
        assert error.reason == "source-too-large", name
        assert "--max-memory 100MiB" in str(error)
        assert np.array_equal(open_array(tmp_path / name, max_memory="300MiB"), zeros)


def test_headers_are_read_no_further_than_one_takes(tmp_path: Path) -> None:
    """Their lengths are what the file says, and a packed one may go on for long."""
    begins = b"\x93NUMPY\2\0" + (1 << 27).to_bytes(4, "little")
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", begins + bytes(1 << 27))
    (tmp_path / "a.npy").write_bytes(begins)
    os.truncate(tmp_path / "a.npy", 1 << 27)
    (tmp_path / "a.pgm").write_bytes(b"P5" + b"#\n" * (1 << 20) + b"1 1 255\n0")
    (tmp_path / "a.pam").write_bytes(b"P7\n" + b"# \n" * (1 << 20) + b"WIDTH 1\nHEIGHT 1\nDEPTH 1\nMAXVAL 9\nENDHDR\n0")
    tracemalloc.start()
    try:
        for name in ("a.npz", "a.npy", "a.pgm", "a.pam"):
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            assert refusal(tmp_path / name).reason == "source-damaged"
            assert tracemalloc.get_traced_memory()[1] - before < 16 << 20, name
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("kind", ["Nifti1Image", "Nifti2Image"])
@pytest.mark.parametrize("order", "<>")
def test_extensions_of_nifti_are_within_its_header(tmp_path: Path, kind: str, order: str) -> None:
    nibabel = needed("nibabel")
    made = getattr(nibabel, kind)
    image = made(VALUES, np.eye(4), made.header_class(endianness=order))
    for length in (24, 100):
        image.header.extensions.append(nibabel.nifti1.Nifti1Extension("comment", b"x" * length))
    nibabel.save(image, tmp_path / "a.nii")
    same(tmp_path / "a.nii", VALUES, f"{order}f4", mapped=True)
    whole, begin = (tmp_path / "a.nii").read_bytes(), 352 if kind == "Nifti1Image" else 544
    place, form = (108, "f") if kind == "Nifti1Image" else (168, "q")
    for at, number in ((begin, 1 << 30), (begin + 32, 1 << 30), (begin + 32, 0), (begin + 32, -16), (place, 1 << 30)):
        data = bytearray(whole)
        struct.pack_into(order + (form if at == place else "i"), data, at, number)
        (tmp_path / "a.nii.gz").write_bytes(gzip.compress(bytes(data)))
        error = refusal(tmp_path / "a.nii.gz")
        assert error.reason == "source-damaged"
        assert "an extension of" in str(error) or "numbers that begin at" in str(error)


@pytest.mark.parametrize("sizes", ['SizeZ="1000000000" SizeC="1" SizeT="1"', 'SizeT="99999" SizeC="9999" SizeZ="9999"'])
def test_planes_of_tiff_are_no_more_than_a_file_can_have(tmp_path: Path, sizes: str) -> None:
    said = ('<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0">'
            f'<Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint16" SizeX="9" SizeY="8" {sizes}><TiffData/>'
            "</Pixels></Image></OME>")
    needed("tifffile").imwrite(tmp_path / "a.ome.tif", np.zeros((8, 9), "u2"), description=said, metadata=None)
    error = refusal(tmp_path / "a.ome.tif")
    assert error.reason == "source-damaged"
    assert "planes, by its header" in str(error)


@pytest.mark.parametrize("encoding", PACKED)
def test_damaged_nrrd_is_an_array_or_refused(tmp_path: Path, encoding: str) -> None:
    for detached in (False, True):
        path = nrrd(tmp_path / "a.nrrd", encoding, PACKED[encoding](DATA), "byte skip: 0\n", detached=detached)
        survives_damage(path)
