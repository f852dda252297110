"""One door for all formats."""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import DTypeLike, NDArray

from ..errors import expect, invalid
from ..goals import memory_given
from ..support.memory import memory_for
from ..support.natural import in_order
from ..support.progress import Progress
from .formats import FORMATS, PAGES, format_of
from .raw import open_raw
from .series import open_series, pictures_of
from .source import io_error
from .unpacked import Unpacker
from .zarr_store import is_zarr, open_zarr

#: Endings behind which ``:member`` is told apart even if there is no such file.
_HOLDERS = tuple(ending for each in FORMATS if each.members for ending in each.endings)


def open_array(
    uri: str | Path, *, member: str | None = None, shape: Sequence[int] | None = None, dtype: DTypeLike | None = None,
    order: str = "C", offset: int = 0, max_memory: int | str | None = None, progress: Progress | None = None,
) -> NDArray[Any]:
    """Open a file as an array, memory-mapped where possible, else read or unpacked into a temporary file.

    Args:
        uri: a file of a format that docs/inputs.md lists, ``file.h5:/group/array`` for one of several arrays; a folder
            of pictures or a pattern such as ``shots/*.exr``, stacked in natural order; or raw binary.
        member: the array of several, instead of in the uri.
        shape: of raw binary.
        dtype: of raw binary, as NumPy writes it; ``>f4`` is big-endian float32.
        order: of raw binary: "C" (last axis fastest) or "F".
        offset: bytes to skip at the start of raw binary.
        max_memory: bytes to unpack in, or a text such as ``"200MB"``, half of them for the array itself; None: half of
            what is free.
        progress: called with a stage's name and the fraction of it done, while something is unpacked.

    Raises:
        HmkctaError: the file cannot be read, is damaged or shorter than it says, or holds no real numbers; the library
            for its format is not installed.

    >>> import hmkcta, numpy as np, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.save(f"{folder}/a.npy", np.eye(2, dtype=">f4"))
    ...     hmkcta.open_array(f"{folder}/a.npy").tolist(), hmkcta.open_array(f"{folder}/*.npy").shape
    ([[1.0, 0.0], [0.0, 1.0]], (1, 2, 2))
    """
    expect("uri", uri, str | os.PathLike, "the path of a file, with :member, or a pattern")
    if shape is not None or dtype is not None or order != "C" or offset:
        if member is not None:
            raise invalid("source-member", f"member of {uri}", repr(member), "none: raw binary is one array")
        _check_input(uri)
        return open_raw(Path(uri), shape, dtype, order, offset)
    if str(uri) == "":  # which would be the folder at hand
        raise invalid("argument-type", "uri", "''", "the path of a file or a folder, or a pattern",
                      "give one; '.' is the folder at hand")
    _check_input(uri)
    with memory_for(str(uri), "take a machine that has more, or write it as .npy or uncompressed: that is mapped"):
        return _opened(str(uri), member, memory_given(max_memory), progress)


def _opened(uri: str, member: str | None, limit: int | None, progress: Progress | None) -> NDArray[Any]:
    place, inner = _split(uri)
    member, unpacker = member if member is not None else inner, Unpacker(limit, progress)
    if _is_pattern(place):
        return open_series(_matches(place), place, lambda path, unpacker: _open(path, member, unpacker), unpacker,
                           _depth)
    return _open(Path(place), member, unpacker)


def _check_input(uri: str | Path) -> None:
    """Refuse what other commands take for their input, unless there is a file of that name."""
    if str(uri) == "-" and not os.path.exists("-"):
        raise invalid("argument-type", "uri", "standard input (-)", "the path of a file or a folder, or a pattern",
                      "write what comes from it to a file first, COMMAND > FILE, as a source is read more than once")


def _open(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    """A file, a store, or the pictures of a folder."""
    if not os.path.isdir(path):
        return format_of(path).open(path, member, unpacker)
    if is_zarr(path):
        return open_zarr(path, member, unpacker)
    return open_series(pictures_of(path, PAGES), str(path), lambda page, unpacker: _open(page, member, unpacker),
                       unpacker, _depth)


def _depth(path: Path) -> str:
    return "" if os.path.isdir(path) else format_of(path).depth(path)


def source_files(uri: str) -> list[Path]:
    """The files that a uri of `open_array` names, or the folder.

    >>> source_files("jet.h5:/density")
    [PosixPath('jet.h5')]
    """
    place, _ = _split(uri)
    return _found(place) if _is_pattern(place) else [Path(place)]


def _split(uri: str) -> tuple[str, str | None]:
    """Path or pattern, and member, of ``file.h5:/member``; a file of that very name comes first."""
    if "\0" in uri or os.path.exists(uri):
        return uri, None
    ends = [at for at, letter in enumerate(uri) if letter == ":"]
    for end in reversed(ends):
        if os.path.exists(uri[:end]) or (_is_pattern(uri[:end]) and _found(uri[:end])):
            return uri[:end], uri[end + 1:]
    for end in reversed(ends):
        if uri[:end].lower().endswith(_HOLDERS):
            return uri[:end], uri[end + 1:]
    return uri, None


def _is_pattern(place: str) -> bool:
    return glob.has_magic(place) and "\0" not in place and not os.path.exists(place)


def _matches(pattern: str) -> list[Path]:
    found = in_order(_found(pattern))
    if not found:
        raise io_error("unreadable", pattern, "no file that matches", "one or more",
                       "check the folder that the pattern begins with, and what it ends with")
    return found


def _found(pattern: str) -> list[Path]:
    return [Path(match) for match in glob.glob(pattern, recursive=True)]
