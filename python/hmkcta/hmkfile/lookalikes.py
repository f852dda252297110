"""What a file that is no `.hmk` file looks like: a downloaded error page, or the source in place of its file."""

from __future__ import annotations

import os
import stat

from ..errors import ForeignFile, Kind
from .limits import DEFAULT_LIMITS, Limits

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


#: Where the JSON of a header begins.
_JSON_AT = 8


def check_start(start: bytes, size: int, limits: Limits) -> None:
    """Refuse a file of `size` bytes that begins as no `.hmk` file does, even a damaged or truncated one.

    Args:
        start: its first `START` bytes, or all there are.

    Raises:
        ForeignFile: reason ``foreign-file``: behind the length there is no ``{``, and the file begins as another format
            does, or the length is none that a header can have.

    >>> check_start(b"\\x1f\\x8b\\x08" + bytes(20), 23, DEFAULT_LIMITS)
    Traceback (most recent call last):
        ...
    hmkcta.errors.ForeignFile: header: found what begins like a file packed by gzip, allowed an .hmk file. Next: \
unpack it: gunzip. [Io/foreign-file]
    """
    if start[_JSON_AT:_JSON_AT + 1] == b"{":
        return
    length, found, advice = int.from_bytes(start[:_JSON_AT], "little"), "", ""
    if size > _JSON_AT:  # fewer bytes might be those of a length
        begins = start.lstrip().lower() if start.lstrip().startswith(b"<") else start.lower()
        found, advice = next(((what, advice) for first, what, advice in _STARTS if begins.startswith(first)), ("", ""))
    is_length = length <= limits.json_bytes and (size <= _JSON_AT or 0 < length <= size - _JSON_AT)
    if found or not is_length:
        raise ForeignFile(Kind.IO, "foreign-file", "header", found=f"what begins like {found or 'no .hmk file'}",
                          allowed="an .hmk file", hint=advice or "check that it is an .hmk file")


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
