"""What a file that is no `.hmk` file looks like: a downloaded error page, or the source in place of its file."""

from __future__ import annotations

import os
import stat

from ..errors import ForeignFile, HmkctaError
from .limits import DEFAULT_LIMITS

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


#: Where the JSON of a header begins, and the reasons of a length before it that can be none.
_JSON_AT, _NO_LENGTH = 8, ("header-too-large", "truncated")


def recognised(error: HmkctaError, start: bytes) -> HmkctaError:
    """The error about a file's header; where the file begins as no `.hmk` file does, one that says what it looks like.

    >>> from .reasons import fault
    >>> print(recognised(fault("truncated", "header", "a file of 40 bytes", "8 bytes and more"), b"\\x1f\\x8b\\x08"))
    header: found what begins like a file packed by gzip, allowed an .hmk file. Next: unpack it: gunzip. \
[InsufficientData/truncated]
    """
    if error.where != "header" or start[_JSON_AT:_JSON_AT + 1] == b"{":
        return error
    begins = start.lstrip().lower() if start.lstrip().startswith(b"<") else start.lower()
    found, advice = next(((what, advice) for first, what, advice in _STARTS if begins.startswith(first)), ("", ""))
    no_length = error.reason in _NO_LENGTH or not any(start[:_JSON_AT])
    if not found and (not no_length or len(start) <= _JSON_AT):
        return error
    found = f"what begins like {found}" if found else "what begins like no .hmk file"
    return ForeignFile(error.kind, error.reason, error.where, found=found, allowed="an .hmk file",
                       hint=advice or "check that it is an .hmk file")


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
            start, size = file.read(_JSON_AT + 1), os.fstat(file.fileno()).st_size
    except (OSError, ValueError):
        return False
    length = int.from_bytes(start[:_JSON_AT], "little")
    return start[_JSON_AT:] == b"{" and 2 <= length <= min(size - _JSON_AT, DEFAULT_LIMITS.json_bytes)
