"""Formats that are known, but not read: what each is, and what makes one of it that is read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..errors import HmkctaError
from .source import io_error
from .unread_pictures import UNREAD_PICTURES

Magics = tuple[tuple[int, bytes], ...]


@dataclass(frozen=True)
class NotRead:
    """A format that somebody may take for one that is read.

    Attributes:
        name: as errors have it.
        hint: what reads it, or converts it.
        magics: bytes that tell it, each with its place in the file.
        endings: of file names that tell it where there are no such bytes.
        allowed: what is read instead.
    """

    name: str
    hint: str
    magics: Magics = ()
    endings: tuple[str, ...] = ()
    allowed: str = "one of the formats of docs/inputs.md"

    def refusal(self, path: Path) -> HmkctaError:
        """The error that says so."""
        return io_error("source-format", str(path), f"{self.name}, which is not read", self.allowed, self.hint)


def _at(*beginnings: bytes, place: int = 0) -> Magics:
    return tuple((place, beginning) for beginning in beginnings)


_NIBABEL = "nibabel reads it: nibabel.save(nibabel.Nifti1Image.from_image(nibabel.load(IN)), OUT.nii)"
_BIOFORMATS = "convert it to OME-TIFF: bfconvert IN OUT.ome.tif"
_SCIPY = "scipy.io.{} reads it; save the array by numpy.save"
ANALYZE = NotRead("an Analyze image", _NIBABEL, allowed="NIfTI, which followed it")
NOT_READ = (
    NotRead("netCDF-3", "convert it: nccopy -k netCDF-4 IN.nc OUT.nc; MINC 1: mincconvert -2 IN.mnc OUT.mnc",
            _at(b"CDF\1", b"CDF\2", b"CDF\5"), allowed="netCDF-4, which is HDF5"),
    NotRead("HDF4", "convert it: h4toh5 IN.hdf OUT.h5", _at(b"\x0e\x03\x13\x01"), allowed="HDF5"),
    NotRead("DICOM", "convert the whole series: dcm2niix FOLDER", _at(b"DICM", place=128), (".dcm",),
            allowed="NIfTI or NRRD"),
    # SciPy reads it, but a damaged one ends the process.
    NotRead("MATLAB before 7.3", "save it with -v7.3, or an array of scipy.io.loadmat by numpy.save",
            (*_at(b"MATLAB 5.0"), *_at(b"\0\1IM", b"\1\0MI", place=124)), (".mat",), "MATLAB 7.3, which is HDF5"),
    NotRead("a compressed file", "decode it first: hmkcta decompress IN.hmk -o OUT.npy",
            _at(b"\x89HMK\r\n\x1a\n"), allowed="the array that was compressed"),
    NotRead("a FreeSurfer volume (MGH)", "convert it: mri_convert IN.mgz OUT.nii.gz; or " + _NIBABEL,
            endings=(".mgz", ".mgh", ".mgh.gz"), allowed="NIfTI"),
    NotRead("AFNI's format", "convert it: 3dAFNItoNIFTI IN+orig", endings=(".head", ".brik", ".brik.gz"),
            allowed="NIfTI"),
    NotRead("Philips PAR/REC", "convert it: parrec2nii IN.PAR", endings=(".par", ".rec"), allowed="NIfTI"),
    NotRead("a GIFTI surface", "nibabel reads it; save an array of it by numpy.save", endings=(".gii", ".gii.gz")),
    NotRead("ECAT", _NIBABEL, _at(b"MATRIX7"), allowed="NIfTI"),
    NotRead("VTK before XML", "pyvista or ParaView read it; save an array of it by numpy.save",
            _at(b"# vtk DataFile")),
    NotRead("MRC", "mrcfile reads it; save its data by numpy.save", _at(b"MAP ", place=208), (".mrc",)),
    NotRead("GRIB", "convert it: cdo -f nc4 copy IN OUT.nc", _at(b"GRIB"), allowed="netCDF-4"),
    NotRead("CZI", _BIOFORMATS, _at(b"ZISRAWFILE"), allowed="TIFF"),
    NotRead("ND2", _BIOFORMATS, _at(b"\xda\xce\xbe\x0a"), allowed="TIFF"),
    NotRead("an ENVI header", "open the file beside it as raw binary, by --shape, --dtype and --offset of this header",
            _at(b"ENVI\n", b"ENVI\r\n"), allowed="raw binary that is described"),
    NotRead("an IDL save file", _SCIPY.format("readsav"), _at(b"SR\0\4", b"SR\0\6")),
    NotRead("sound", _SCIPY.format("wavfile"), _at(b"WAVE", place=8)),
    NotRead("Parquet or Arrow", "pandas reads it; save its numbers by numpy.save", _at(b"PAR1", b"ARROW1")),
    NotRead("bzip2", "unpack it: bunzip2", _at(b"BZh")),
    NotRead("xz", "unpack it: unxz", _at(b"\xfd7zXZ\0")),
    NotRead("Zstandard", "unpack it: unzstd", _at(b"\x28\xb5\x2f\xfd")),
    *(NotRead(name, hint, magics, allowed="a picture as PNG, TIFF or EXR") for name, magics, hint in UNREAD_PICTURES),
    NotRead("a pointer of Git LFS", "fetch what it points to: git lfs pull", _at(b"version https://git-lfs"),
            allowed="the file itself"),
    NotRead("a web page", "see in a browser what the server says, and where the file is",
            _at(b"<!DOCTYPE html", b"<!doctype html", b"<html", b"<HTML"), allowed="the file itself"),
    NotRead("a tar archive", "unpack it: tar -xf", _at(b"ustar", place=257)),
)


def by_start(start: bytes) -> NotRead | None:
    """The format that a file's first bytes tell."""
    return next((each for each in NOT_READ if any(start.startswith(magic, at) for at, magic in each.magics)), None)


def by_ending(name: str) -> NotRead | None:
    """The format that a file's name tells.

    >>> by_ending("T1.MGZ").name
    'a FreeSurfer volume (MGH)'
    """
    return next((each for each in NOT_READ if each.endings and name.lower().endswith(each.endings)), None)
