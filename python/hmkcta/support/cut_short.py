"""Mapped files that somebody cuts short while they are read: an error in place of the end of the process (SIGBUS)."""

from __future__ import annotations

import mmap
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any
from weakref import WeakSet

from ..errors import source_changed
from .extension import native

#: Maps of which a part reads as zeros, as their file had lost it. They stay so, whatever becomes of the file.
_CUT: WeakSet[mmap.mmap] = WeakSet()


def file_map(array: Any) -> mmap.mmap | None:
    """The map of a file that an array lies in; None: there is none."""
    base: Any = array
    while base is not None and not isinstance(base, mmap.mmap):
        base = getattr(base, "base", None)
    return base


def file_of(array: Any) -> str | None:
    """The path of the file that an array maps, as NumPy noted it; None: it maps none, or that is not known."""
    base: Any = array
    while base is not None:
        if getattr(base, "filename", None) is not None:
            return str(base.filename)
        base = getattr(base, "base", None)
    return None


@contextmanager
def whole_map(array: Any) -> Generator[None]:
    """While the block reads an array, what its file loses reads as zeros; then the block ends in an error.

    Raises:
        HmkctaError: `SourceChanged`, reason ``source-cut-short``; also of a map of which a part was lost before.
    """
    base = file_map(array)
    if base is None:
        yield
        return
    where = file_of(array) or "the file of the array"
    if base in _CUT:
        raise _lost(where)
    watch = native.MapWatch(base)
    try:
        yield
    finally:
        if watch.cut:  # whatever else went wrong came of zeros
            _CUT.add(base)
            raise _lost(where)


def _lost(where: str) -> Exception:
    return source_changed("source-cut-short", where, "has become shorter while it was mapped, or its disk failed")
