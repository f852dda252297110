"""The table of formats: what tells each, and what opens it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ..errors import invalid
from . import exr, hdf5, nifti, npy, nrrd, picture, tiff, zarr_store
from .source import io_error, opened
from .unpacked import Unpacker

Opener = Callable[[Path, str | None, Unpacker], NDArray[Any]]
#: Bytes at the start of a file that are looked at: HDF5 may begin behind a block of the user's.
START = 4096


@dataclass(frozen=True)
class Format:
    """A format of files.

    Attributes:
        name: as errors have it.
        endings: of file names. They tell formats without magic bytes, and what a damaged file was meant to be.
        magics: bytes that tell the format, each with its place in the file.
        opener: makes an array of a file, or of a member of it.
        pages: whether a folder of such files is a stack.
        members: whether a file may hold several arrays.
    """

    name: str
    endings: tuple[str, ...]
    magics: tuple[tuple[int, bytes], ...]
    opener: Opener
    pages: bool = False
    members: bool = True

    def open(self, path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
        """Open a file.

        Raises:
            HmkctaError: a member of a format that has none; whatever the opener raises.
        """
        if member is not None and not self.members:
            raise invalid("source-member", f"member of {path}", repr(member), "none: there is one array in it")
        return self.opener(path, member, unpacker)


def _single(name: str, endings: tuple[str, ...], magics: tuple[tuple[int, bytes], ...],
            opener: Callable[[Path, Unpacker], NDArray[Any]], pages: bool = False) -> Format:
    """A format of one array a file."""
    return Format(name, endings, magics, lambda path, _, unpacker: opener(path, unpacker), pages,
                  members=False)


def _at_once(opener: Callable[[Path], NDArray[Any]]) -> Callable[[Path, Unpacker], NDArray[Any]]:
    """An opener that maps, or reads a single picture."""
    return lambda path, _: opener(path)


def _open_zip(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    """Both `.npz` and zipped Zarr begin like any zip archive."""
    packed = path.suffix.lower() != ".npz" and zarr_store.is_zarr(path)
    return (zarr_store.open_zarr if packed else npy.open_npz)(path, member, unpacker)


def _older(name: str, magics: tuple[tuple[int, bytes], ...], allowed: str, hint: str) -> Format:
    """A format that is known, but not read."""
    def refuse(path: Path, *_: object) -> NDArray[Any]:
        raise io_error("source-format", str(path), name, allowed, hint)

    return Format(name, (), magics, refuse)


FORMATS = (
    _single(".npy", (".npy",), ((0, npy.MAGIC),), _at_once(npy.open_npy), pages=True),
    Format(".npz or zipped Zarr", (".npz", ".zip"), tuple((0, magic) for magic in npy.ZIP_MAGICS), _open_zip),
    Format("HDF5", (".h5", ".hdf5", ".hdf", ".he5", ".nc", ".nc4", ".mat"),
           tuple((at, hdf5.MAGIC) for at in (0, 512, 1024, 2048)), hdf5.open_hdf5),
    _older("netCDF-3", tuple((0, b"CDF" + bytes([version])) for version in (1, 2, 5)), "netCDF-4, which is HDF5",
           "convert it: nccopy -k netCDF-4 IN.nc OUT.nc"),
    _older("HDF4", ((0, b"\x0e\x03\x13\x01"),), "HDF5", "convert it: h4toh5 IN.hdf OUT.h5"),
    _older("DICOM", ((128, b"DICM"),), "NIfTI or NRRD", "convert the whole series: dcm2niix FOLDER"),
    # SciPy reads it, but a damaged one ends the process.
    _older("MATLAB before 7.3", ((0, b"MATLAB 5.0"),), "MATLAB 7.3, which is HDF5", "save it with -v7.3"),
    _older("a compressed file", ((8, b'{"__metadata__":{"hmkcta"'),), "the array that was compressed",
           "decode it first: hmkcta decompress IN.hmk -o OUT.npy"),
    _single("NIfTI", (".nii",), nifti.MAGICS, nifti.open_nifti),
    _single("NIfTI", (".nii.gz",), ((0, nifti.GZIP),), nifti.open_gzip),
    _single("NRRD", (".nrrd", ".nhdr"), ((0, nrrd.MAGIC),), nrrd.open_nrrd),
    Format("TIFF", (".tif", ".tiff"), tiff.MAGICS, tiff.open_tiff, pages=True),
    Format("EXR", (".exr",), ((0, exr.MAGIC),), lambda path, member, _: exr.open_exr(path, member), pages=True),
    _single("pictures", picture.ENDINGS, picture.MAGICS, _at_once(picture.open_picture), pages=True),
    _single("pictures", picture.OTHER_ENDINGS, (), _at_once(picture.open_picture), pages=True),
)
#: Endings of the files of which a folder is a stack.
PAGES = tuple(ending for each in FORMATS if each.pages for ending in each.endings)


def format_of(path: Path) -> Format:
    """The format of a file: by its first bytes, or by its ending where those tell nothing.

    Raises:
        HmkctaError: it cannot be read, is empty or damaged at its start, or of no format that is known.
    """
    with opened(path) as file:
        start = file.read(START)
    for each in FORMATS:
        if any(start.startswith(magic, at) for at, magic in each.magics):
            return each
    for each in FORMATS:
        if path.name.lower().endswith(each.endings):
            if not each.magics and start:
                return each
            found, hint = "an empty file", "write or fetch it again"
            if start:
                found, hint = "what begins as another format", "see what it is, and give it the ending of that"
            raise io_error("source-damaged", str(path), found, f"a complete {path.suffix} file", hint)
    known = ", ".join(dict.fromkeys(each.name for each in FORMATS if each.endings))
    raise io_error("source-format", str(path), "no format that is known", f"{known}; or raw binary that is described",
                   "say shape and dtype of raw binary, e.g. --shape 64,64,3 --dtype float32")
