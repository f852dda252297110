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
NONE: Mapping[str, str] = {}
#: What to do where a library stumbles over a file, of which nobody knows whether it is whole.
WHOLE = "see whether it opens where it comes from; if so, save it as one of the formats of docs/inputs.md"


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
        if not stat.S_ISREG(mode := os.stat(path).st_mode):
            raise _no_file(path, mode)
        file = open(path, "rb")  # noqa: SIM115 (what is wrong with a path is not what is wrong with its bytes)
    except (OSError, ValueError) as error:  # a path with a zero byte is a ValueError
        raise _unreadable(path, error) from error
    with file:
        try:
            yield file
        except OSError as error:
            if error.errno is None:  # it is of a library that unpacks, and of the bytes
                raise
            raise _unreadable(path, error) from error


def _unreadable(path: Path, error: Exception) -> HmkctaError:
    found = getattr(error, "strerror", None) or error
    return io_error("unreadable", str(path), found, "a readable file", "check the path and its permissions",
                    told=f"cannot be read: {found}")


def _no_file(path: Path, mode: int) -> HmkctaError:
    """The error that says what it is in place of a file."""
    kinds = {stat.S_IFIFO: "a pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFSOCK: "a socket",
             stat.S_IFDIR: "a folder"}
    kind = kinds.get(stat.S_IFMT(mode), "something else")
    hint = "name a file in it" if kind == "a folder" else (
        "write what comes from it to a file first, COMMAND > FILE, as a source is read more than once")
    return io_error("unreadable", str(path), kind, "a file", hint, told=f"is {kind}, no regular file")


@contextmanager
def guarded(path: Path, what: str, hint: str = WHOLE) -> Generator[None]:
    """Whatever the library of a format raises on a file becomes one sentence; `hint` is what to do about it.

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
        raise io_error("source-damaged", str(path), sentence(error), f"a complete {what}", hint) from error


def choose(where: str, members: Mapping[str, str], wanted: str | None, unread: Mapping[str, str] = NONE) -> str:
    """The member of a file that is asked for, or the only one.

    Args:
        where: the file.
        members: what there is to choose from, each with a description or "".
        wanted: the name; None: there should be one only.
        unread: what is in the file and cannot be read, each with why not; it might be what is meant.

    Raises:
        HmkctaError: reason ``source-member``; what there is is listed. Or ``source-damaged``: it cannot be read.

    >>> choose("a.npz", {"wood": ""}, None)
    'wood'
    """
    texts = {**members, **{name: f"not read: {why}" for name, why in unread.items()}}
    named = [f"{name} ({text})" if text else name for name, text in sorted(texts.items())]
    listed = ", ".join(named[:LISTED]) or "none"
    listed += f" and {len(named) - LISTED} more" if len(named) > LISTED else ""
    if wanted is None and unread and not members:
        raise io_error("source-damaged", where, listed, "an array that can be read", WHOLE)
    if wanted is None:
        if len(texts) != 1 or unread:
            raise invalid("source-member", f"arrays of {where}", listed, "one, or the name of one",
                          f"write {where}:NAME" if members else "")
        return next(iter(members))
    if wanted in unread:
        raise io_error("source-damaged", f"{where}:{wanted}", unread[wanted], "an array that can be read",
                       f"write {where}:NAME with another one" if members else "")
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


def map_part(path: Path, layout: Layout, offset: int, where: str, *, last: bool = False) -> NDArray[Any]:
    """A read-only view of a part of a file that a header of some format describes; `last`: it ends with the file.

    Raises:
        HmkctaError: no real numbers, no element, or the file ends before, or goes on where it should not.
    """
    check_layout(layout, where)
    with opened(path) as file:
        held = max(0, file.seek(0, 2) - offset)
    if offset < 0 or held < layout.nbytes:
        raise too_short(where, f"{held} bytes of numbers", layout)
    if last and held > layout.nbytes:
        raise too_long(where, f"{held} bytes of numbers", layout)
    return mapped(path, layout, offset)


def too_short(where: str, found: str, layout: Layout) -> HmkctaError:
    """Fewer bytes than a header says: the rest is missing."""
    return io_error("source-truncated", where, found, f"{layout.nbytes} bytes for {layout}, as its header says",
                    "fetch it again")


def too_long(where: str, found: str, layout: Layout) -> HmkctaError:
    """More bytes than a header says: one of the two is wrong."""
    return io_error("source-too-long", where, found, f"{layout.nbytes} bytes for {layout}, as its header says",
                    "correct the header, or save one array a file")


def mapped(path: Path, layout: Layout, offset: int) -> NDArray[Any]:
    """A read-only view of a part of the file; the caller has checked that the file has it."""
    try:
        return np.memmap(path, layout.dtype, "r", offset, layout.shape, order="F" if layout.fortran else "C")
    except (OSError, ValueError) as error:
        raise io_error("unreadable", str(path), error, "a file that can be mapped",
                       told=f"cannot be mapped: {error}") from error
