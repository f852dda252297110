"""What a file that is no `.hmk` file looks like: a downloaded error page, or the source in place of its file."""

from __future__ import annotations

from ..errors import HmkctaError

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


def recognised(error: HmkctaError, start: bytes) -> HmkctaError:
    """The error about a file's header, with what the file looks like as the next step where its first bytes tell.

    >>> from .reasons import fault
    >>> print(recognised(fault("truncated", "header", "a file of 40 bytes", "8 bytes and more"), b"\\x1f\\x8b\\x08"))
    header: found a file of 40 bytes, allowed 8 bytes and more. Next: it begins like a file packed by gzip; \
unpack it: gunzip. [InsufficientData/truncated]
    """
    begins = start.lstrip().lower() if start.lstrip().startswith(b"<") else start.lower()
    for first, what, advice in _STARTS:
        if error.where == "header" and begins.startswith(first):
            hint = f"it begins like {what}; {advice}"
            return HmkctaError(error.kind, error.reason, error.where, found=error.found, allowed=error.allowed,
                               hint=hint)
    return error
