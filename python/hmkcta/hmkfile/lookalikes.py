"""What a file that is no `.hmk` file looks like: a downloaded error page, or the source in place of its file."""

from __future__ import annotations

import os
import stat

from ..errors import ForeignFile, HmkctaError, Kind

_MAGIC = b"\x89HMK\r\n\x1a\n"
_COMPRESS = "hmkcta compress it, or give the .hmk file that was made of it"
_SEE = "see in a browser what the server says, and where the file is"
#: First bytes, lower-cased, what they look like, and what to do.
_STARTS = (
    (b"\x93numpy", "a NumPy array (.npy)", _COMPRESS),
    (b"pk\x03\x04", "a zip archive (.npz, Zarr)", f"unpack the .hmk file in it, or {_COMPRESS}"),
    (b"\x89hdf\r\n\x1a\n", "HDF5 or netCDF-4", _COMPRESS),
    (b"\x89png\r\n\x1a\n", "a PNG picture", _COMPRESS),
    (b"\xff\xd8\xff", "a JPEG picture", _COMPRESS),
    (b"ii*\0", "a TIFF picture", _COMPRESS),
    (b"mm\0*", "a TIFF picture", _COMPRESS),
    (b"v/1\x01", "an EXR picture", _COMPRESS),
    (b"nrrd0", "NRRD", _COMPRESS),
    (b"\x1f\x8b", "a file packed by gzip", "unpack it: gunzip"),
    (b"bzh", "a file packed by bzip2", "unpack it: bunzip2"),
    (b"\xfd7zxz\0", "a file packed by xz", "unpack it: unxz"),
    (b"\x28\xb5\x2f\xfd", "a file packed by zstd", "unpack it: unzstd"),
    (b"version https://git-lfs", "a pointer of Git LFS", "fetch what it points to: git lfs pull"),
    (b"<!doctype html", "a web page", _SEE),
    (b"<html", "a web page", _SEE),
)
#: Bytes that tell all of them.
START = 64


def foreign(start: bytes) -> HmkctaError:
    r"""The error of a file that does not begin as an `.hmk` file does, which says what it looks like.

    >>> foreign(b"\x1f\x8b\x08").found
    'what begins like a file packed by gzip'
    """
    begins = start.lstrip().lower() if start.lstrip().startswith(b"<") else start.lower()
    # Of safetensors there is a JSON object behind its length.
    other = "safetensors" if start[8:9] == b"{" else "no .hmk file"
    what, advice = next(((what, advice) for first, what, advice in _STARTS if begins.startswith(first)),
                        (other, "check that it is an .hmk file"))
    return ForeignFile(Kind.IO, "foreign-file", "header", found=f"what begins like {what}",
                       allowed="an .hmk file", hint=advice)


def is_hmk(path: str | os.PathLike[str]) -> bool:
    """Whether a path is one of an `.hmk` file: by the first bytes, so that any name will do, or by its ending.

    >>> is_hmk("none.HMK"), is_hmk("none.npy")
    (True, False)
    """
    if os.fspath(path).lower().endswith(".hmk"):  # whatever is in it: reading it says what that is
        return True
    try:
        if not stat.S_ISREG(os.stat(path).st_mode):  # a pipe would block on opening
            return False
        with open(path, "rb") as file:
            return file.read(len(_MAGIC)) == _MAGIC
    except (OSError, ValueError):
        return False
