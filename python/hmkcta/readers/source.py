"""What all readers share: files that may not be there, members by name, mapping, number types."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError, Kind, invalid, sentence

KINDS_TAKEN = "integers, booleans, or float16 to float64"
#: Members of a file that an error lists.
LISTED = 20


#: What is called with each file and folder that a reader is about to read; None: nobody wants to know.
_READING: ContextVar[Callable[[Path], None] | None] = ContextVar("reading", default=None)


def reading(path: Path) -> None:
    """Say that a file or a folder is about to be read, to whoever watches that it stays as it is."""
    watcher = _READING.get()
    if watcher is not None:
        watcher(path)


@contextmanager
def watched_by(watcher: Callable[[Path], None]) -> Generator[None]:
    """Have `watcher` called with each file and folder that readers read in the block.

    >>> found = []
    >>> with watched_by(found.append):
    ...     reading(Path("wood.npy"))
    >>> found
    [PosixPath('wood.npy')]
    """
    token = _READING.set(watcher)
    try:
        yield
    finally:
        _READING.reset(token)


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


def io_error(reason: str, where: str, found: object = None, allowed: object = None, hint: str = "", *, told: str = ""
             ) -> HmkctaError:
    """An `Io` error: the input is not what it should be."""
    return HmkctaError(Kind.IO, reason, where, found=found, allowed=allowed, hint=hint, told=told)


@contextmanager
def opened(path: Path) -> Generator[BinaryIO]:
    """The file, open for reading.

    Raises:
        HmkctaError: it is not there, is no regular file, or cannot be read.
    """
    reading(path)
    try:
        # A pipe would block on opening, a device may have no end.
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise io_error("unreadable", str(path), "no regular file", "a file", told="is no regular file")
        with open(path, "rb") as file:
            yield file
    except (OSError, ValueError) as error:  # a path with a zero byte is a ValueError
        found = getattr(error, "strerror", None) or error
        hint = "check the path and its permissions"
        raise io_error("unreadable", str(path), found, "a readable file", hint,
                       told=f"cannot be read: {found}") from error


@contextmanager
def guarded(path: Path, what: str) -> Generator[None]:
    """Whatever the library of a format raises on a file becomes one sentence.

    Raises:
        HmkctaError: reason ``source-damaged``.
    """
    reading(path)
    try:
        yield
    except (HmkctaError, MemoryError):
        raise
    except BlockingIOError as error:
        raise io_error("unreadable", str(path), sentence(error), f"a {what} that nobody is writing",
                       "wait until its writer has closed it") from error
    except Exception as error:  # of a dozen parsers, each of which has its own ways to stumble over a damaged file
        raise io_error("source-damaged", str(path), sentence(error), f"a complete {what}",
                       "see whether what wrote it opens it; if that fails too, fetch or write it again") from error


def choose(where: str, members: Mapping[str, str], wanted: str | None) -> str:
    """The member of a file that is asked for, or the only one.

    Args:
        where: the file.
        members: what there is to choose from, each with a description or "".
        wanted: the name; None: there should be one only.

    Raises:
        HmkctaError: reason ``source-member``; what there is is listed.

    >>> choose("a.npz", {"wood": ""}, None)
    'wood'
    """
    named = [f"{name} ({text})" if text else name for name, text in sorted(members.items())]
    listed = ", ".join(named[:LISTED]) or "none"
    listed += f" and {len(named) - LISTED} more" if len(named) > LISTED else ""
    if wanted is None:
        if len(members) != 1:
            raise invalid("source-member", f"arrays of {where}", listed, "one, or the name of one",
                          f"write {where}:NAME" if members else "")
        return next(iter(members))
    if wanted not in members:
        hint = f"write {where}:NAME with one of these" if members else ""
        raise invalid("source-member", f"member of {where}", repr(wanted), listed, hint)
    return wanted


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


def check_layout(layout: Layout, where: str) -> None:
    """Refuse arrays of no real numbers, without an axis, or without an element."""
    check_numbers(layout.dtype, where)
    if not layout.shape or not all(size >= 1 for size in layout.shape):
        raise invalid("source-shape", f"shape of {where}", layout.shape, "one axis or more, each of size 1 or more")


def map_part(path: Path, layout: Layout, offset: int, where: str) -> NDArray[Any]:
    """A read-only view of a part of a file that a header of some format describes.

    Raises:
        HmkctaError: no real numbers, no element, or the file ends before.
    """
    check_layout(layout, where)
    with opened(path) as file:
        held = max(0, file.seek(0, 2) - offset)
    if offset < 0 or held < layout.nbytes:
        raise io_error("source-truncated", where, f"{held} bytes of numbers",
                       f"{layout.nbytes} bytes for {layout}, as its header says", "fetch it again")
    return mapped(path, layout, offset)


def mapped(path: Path, layout: Layout, offset: int) -> NDArray[Any]:
    """A read-only view of a part of the file; the caller has checked that the file has it."""
    try:
        return np.memmap(path, layout.dtype, "r", offset, layout.shape, order="F" if layout.fortran else "C")
    except (OSError, ValueError) as error:
        raise io_error("unreadable", str(path), error, "a file that can be mapped",
                       told=f"cannot be mapped: {error}") from error
