"""What a file that is no `.hmk` file looks like: a downloaded error page, or the source in place of its file."""

from __future__ import annotations

import os
import stat

from ..errors import ForeignFile, HmkctaError
from .reasons import REASONS

_MAGIC = b"\x89HMK\r\n\x1a\n"
_COMPRESS = "hmkcta compress it, or give the .hmk file that was made of it"
#: First bytes, lower-cased, what they look like, and what to do.
_STARTS = (
    (b"\x93numpy", "a NumPy array (.npy)", _COMPRESS),
    (b"pk\x03\x04", "a zip archive (.npz, Zarr)", f"unpack the .hmk file in it, or {_COMPRESS}"),
    (b"\x89hdf\r\n\x1a\n", "HDF5 or netCDF-4", _COMPRESS),
    (b"\x89png\r\n\x1a\n", "a PNG picture", _COMPRESS),
    (b"\x1f\x8b", "a file packed by gzip", "unpack it: gunzip"),
    (b"version https://git-lfs", "a pointer of Git LFS", "fetch what it points to: git lfs pull"),
    (b"<!doctype html", "a web page", "see in a browser what the server says, and fetch the file again"),
    (b"<html", "a web page", "see in a browser what the server says, and fetch the file again"),
)
#: Bytes that tell all of them.
START = 64


def foreign(start: bytes) -> HmkctaError:
    """The error of a file that does not begin as an `.hmk` file does, which says what it looks like.

    >>> print(foreign(b"\x1f\x8b\x08"))
    header: found what begins like a file packed by gzip, allowed an .hmk file. Next: unpack it: gunzip. \
[Compatibility/not-hmk]
    """
    begins = start.lstrip().lower() if start.lstrip().startswith(b"<") else start.lower()
    what, advice = next(((what, advice) for first, what, advice in _STARTS if begins.startswith(first)),
                        ("no .hmk file", "check that it is an .hmk file"))
    return ForeignFile(REASONS["not-hmk"].kind, "not-hmk", "header", found=f"what begins like {what}",
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
