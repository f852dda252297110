"""The table of formats: what tells each, and what opens it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ..errors import invalid
from . import exr, fits, hdf5, metaimage, nifti, npy, nrrd, picture, reflectance, tensor_file, tiff, vtk, zarr_store
from .not_read import by_ending, by_start
from .source import WHOLE, io_error, opened
from .unpacked import Unpacker

Opener = Callable[[Path, str | None, Unpacker], NDArray[Any]]
#: Bytes at the start of a file that are looked at.
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
        depth: what a file's numbers reach up to, where their type does not say it; in a stack all have the same.
    """

    name: str
    endings: tuple[str, ...]
    magics: tuple[tuple[int, bytes], ...]
    opener: Opener
    pages: bool = False
    members: bool = True
    depth: Callable[[Path], str] = lambda _: ""

    def open(self, path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
        """Open a file.

        Raises:
            HmkctaError: a member of a format that has none; whatever the opener raises.
        """
        if member is not None and not self.members:
            raise invalid("source-member", f"member of {path}", repr(member), "none: there is one array in it")
        return self.opener(path, member, unpacker)


def _single(name: str, endings: tuple[str, ...], magics: tuple[tuple[int, bytes], ...],
            opener: Callable[[Path, Unpacker], NDArray[Any]], pages: bool = False,
            depth: Callable[[Path], str] = lambda _: "") -> Format:
    """A format of one array a file."""
    return Format(name, endings, magics, lambda path, _, unpacker: opener(path, unpacker), pages,
                  members=False, depth=depth)


def _at_once(opener: Callable[[Path], NDArray[Any]]) -> Callable[[Path, Unpacker], NDArray[Any]]:
    """An opener that maps."""
    return lambda path, _: opener(path)


def _open_zip(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    """Both `.npz` and zipped Zarr begin like any zip archive."""
    packed = path.suffix.lower() != ".npz" and zarr_store.is_zarr(path)
    return (zarr_store.open_zarr if packed else npy.open_npz)(path, member, unpacker)


HDF5 = Format("HDF5", (".h5", ".hdf5", ".hdf", ".he5", ".nc", ".nc4", ".mat", ".mnc"), ((0, hdf5.MAGIC),),
              hdf5.open_hdf5)
FORMATS = (
    _single(".npy", (".npy",), ((0, npy.MAGIC),), _at_once(npy.open_npy), pages=True),
    Format(".npz or zipped Zarr", (".npz", ".zip"), tuple((0, magic) for magic in npy.ZIP_MAGICS), _open_zip),
    HDF5,
    _single("NIfTI", (".nii",), nifti.MAGICS, nifti.open_nifti),
    _single("NIfTI", (".nii.gz",), ((0, nifti.GZIP),), nifti.open_gzip),
    _single("NIfTI", (".hdr", ".img"), (), nifti.open_pair),
    _single("NRRD", (".nrrd", ".nhdr"), ((0, nrrd.MAGIC),), nrrd.open_nrrd),
    _single("MetaImage", (".mha", ".mhd"), metaimage.MAGICS, metaimage.open_metaimage),
    Format("TIFF", (".tif", ".tiff"), tiff.MAGICS, tiff.open_tiff, pages=True, depth=tiff.tiff_depth),
    Format("EXR", (".exr",), ((0, exr.MAGIC),), exr.open_exr, pages=True),
    _single("pictures", picture.ENDINGS, picture.MAGICS, picture.open_picture, pages=True,
            depth=picture.picture_depth),
    _single("pictures", picture.OTHER_ENDINGS, (), picture.open_picture, pages=True,
            depth=picture.picture_depth),
    Format("tensor file", (".bsdf", ".pbsdf"), ((0, tensor_file.MAGIC),), tensor_file.open_tensor_file),
    Format("FITS", (".fits", ".fit", ".fts"), ((0, fits.MAGIC),), fits.open_fits),
    Format("VTK", (".vti", ".vtr"), vtk.MAGICS, vtk.open_vtk),
    _single("MERL", (".binary",), (), reflectance.open_merl),
    _single("UTIA", (".bin",), (), _at_once(reflectance.open_utia)),
)
#: Endings of the files of which a folder is a stack.
PAGES = tuple(ending for each in FORMATS if each.pages for ending in each.endings)


def format_of(path: Path) -> Format:
    """The format of a file: by its first bytes, or by its ending where those tell nothing.

    Raises:
        HmkctaError: it cannot be read, is empty or damaged at its start, or of no format that is read.
    """
    with opened(path) as file:
        start = file.read(START)
        behind_block = hdf5.begins_behind_block(file)
    for each in FORMATS:
        if any(start.startswith(magic, at) for at, magic in each.magics) or (each is HDF5 and behind_block):
            return each
    ending = path.name.lower()
    named = next((each for each in FORMATS if ending.endswith(each.endings)), None)
    other = by_start(start)
    if other is None and start and not start.startswith(hdf5.MATLAB) and (named is None or named.magics):
        other = by_ending(ending)
    if other is not None:
        raise other.refusal(path)
    if named is not None and start and not named.magics:
        return named
    if named is not None:
        found = f"{len(start)} bytes that do not begin as such a file does" if start else "an empty file"
        raise io_error("source-damaged", str(path), found, f"a complete {path.suffix} file",
                       WHOLE if start else "fetch it again")
    known = ", ".join(dict.fromkeys(each.name for each in FORMATS))
    raise io_error("source-format", str(path), "no format that is known", f"{known}; or raw binary that is described",
                   "say shape and dtype of raw binary, e.g. --shape 64,64,3 --dtype float32")
