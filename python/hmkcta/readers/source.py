"""What all readers share: opening a file that may not be there, mapping it, and the number types taken."""

from __future__ import annotations

import os
import stat
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError, Kind, invalid

KINDS_TAKEN = "integers, booleans, or float16 to float64"


@dataclass(frozen=True)
class Layout:
    """How an array lies in a file."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    fortran: bool = False

    @property
    def nbytes(self) -> int:
        """Bytes of the array, a Python integer: no shape overflows it."""
        return prod(self.shape) * self.dtype.itemsize

    def __str__(self) -> str:
        return f"{' x '.join(map(str, self.shape)) or 'one number'} of {self.dtype.name}"


def io_error(reason: str, where: str, found: object = None, allowed: object = None, hint: str = "") -> HmkctaError:
    """An `Io` error: the input is not what it should be."""
    return HmkctaError(Kind.IO, reason, where, found=found, allowed=allowed, hint=hint)


@contextmanager
def opened(path: Path) -> Generator[BinaryIO]:
    """The file, open for reading.

    Raises:
        HmkctaError: it is not there, is no regular file, or cannot be read.
    """
    try:
        # A pipe would block on opening, a device may have no end.
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise io_error("unreadable", str(path), "no regular file", "a file")
        with open(path, "rb") as file:
            yield file
    except (OSError, ValueError) as error:  # a path with a zero byte is a ValueError
        found = getattr(error, "strerror", None) or error
        hint = "check the path and its permissions"
        raise io_error("unreadable", str(path), found, "a readable file", hint) from error


def check_numbers(dtype: np.dtype[Any], where: str) -> None:
    """Refuse what has no place among real numbers.

    >>> check_numbers(np.dtype("c8"), "field.npy")
    Traceback (most recent call last):
        ...
    hmkcta.errors.HmkctaError: number type of field.npy: found complex64, allowed integers, booleans, or \
float16 to float64. Next: compress real and imaginary part as an axis of two. [InvalidArgument/source-dtype]
    """
    if dtype.kind in "biu" or (dtype.kind == "f" and dtype.itemsize <= 8):
        return
    hints = {"c": "compress real and imaginary part as an axis of two", "f": "convert it to float64 first",
             "V": "compress one field of it"}
    raise invalid("source-dtype", f"number type of {where}", dtype.name if dtype.kind != "V" else "a structured type",
                  KINDS_TAKEN, hints.get(dtype.kind, "convert it to numbers first"))


def check_shape(layout: Layout, where: str) -> None:
    """Refuse arrays without an axis or without an element."""
    if not layout.shape or not all(size >= 1 for size in layout.shape):
        raise invalid("source-shape", f"shape of {where}", layout.shape, "one axis or more, each of size 1 or more")


def mapped(path: Path, layout: Layout, offset: int) -> NDArray[Any]:
    """A read-only view of a part of the file; the caller has checked that the file has it."""
    try:
        return np.memmap(path, layout.dtype, "r", offset, layout.shape, order="F" if layout.fortran else "C")
    except (OSError, ValueError) as error:
        raise io_error("unreadable", str(path), error, "a file that can be mapped") from error
