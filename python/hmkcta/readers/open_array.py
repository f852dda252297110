"""One door for all formats."""

from __future__ import annotations

import glob
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import DTypeLike, NDArray

from ..errors import expect, invalid
from ..goals import memory_given
from ..support.memory import memory_for
from ..support.natural import in_order
from ..support.progress import Progress
from .formats import FORMATS, PAGES, format_of
from .grid import Views, arranged, named_files, unfolded, views_given
from .raw import open_raw
from .relighting import light_list, open_lights
from .series import led_by, open_series, pictures_of
from .source import io_error
from .unpacked import Unpacker
from .zarr_store import is_zarr, open_zarr

#: Endings behind which ``:member`` is told apart even if there is no such file.
_HOLDERS = tuple(ending for each in FORMATS if each.members for ending in each.endings)


def open_array(
    uri: str | Path, *, member: str | None = None, shape: Sequence[int] | None = None, dtype: DTypeLike | None = None,
    order: str = "C", offset: int = 0, views: Sequence[int] | str | None = None, names: str | None = None,
    max_memory: int | str | None = None, progress: Progress | None = None,
) -> NDArray[Any]:
    """Open a file as an array, memory-mapped where possible, else read or unpacked into a temporary file.

    Args:
        uri: a file of a format that docs/inputs.md lists, ``file.h5:/group/array`` for one of several arrays; a folder
            of pictures or a pattern such as ``shots/*.exr``, stacked in natural order; a list of lights, ``.lp``, or
            its folder; or raw binary.
        member: the array of several, instead of in the uri.
        shape: of raw binary.
        dtype: of raw binary, as NumPy writes it; ``>f4`` is big-endian float32.
        order: of raw binary: "C" (last axis fastest) or "F".
        offset: bytes to skip at the start of raw binary.
        views: rows and columns of a light field, ``(17, 17)`` or ``"17x17"``: of a folder's pictures in their order, or
            of one picture that has all views as tiles, or ``"14x14:lenslets"`` under the lenslets of a camera.
        names: how the files of a folder are called, ``"out_{row}_{column}_*"``: whole numbers in the place of the
            fields say where each belongs, and the fields name the axes; ``{t:view}`` says what an axis is.
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
    grid = Grid(views_given(views), names)
    if shape is not None or dtype is not None or order != "C" or offset:
        if member is not None:
            raise invalid("source-member", f"member of {uri}", repr(member), "none: raw binary is one array")
        if grid.given:
            raise invalid("source-views", f"views or names of {uri}", "both they and raw binary", "files of a format",
                          "reshape what open_array gives, or write each view as .npy")
        _check_input(uri)
        return open_raw(Path(uri), shape, dtype, order, offset)
    if str(uri) == "":  # which would be the folder at hand
        raise invalid("argument-type", "uri", "''", "the path of a file or a folder, or a pattern",
                      "give one; '.' is the folder at hand")
    _check_input(uri)
    with memory_for(str(uri), "take a machine that has more, or write it as .npy or uncompressed: that is mapped"):
        return _opened(str(uri), member, grid, Unpacker(memory_given(max_memory), progress))


@dataclass(frozen=True)
class Grid:
    """How pictures make a grid, as `open_array` has it."""

    views: Views | None
    names: str | None

    @property
    def given(self) -> bool:
        """Whether anything is said."""
        return self.views is not None or self.names is not None


def _opened(uri: str, member: str | None, grid: Grid, unpacker: Unpacker) -> NDArray[Any]:
    place, inner = _split(uri)
    member = member if member is not None else inner

    def opener(path: Path, unpacker: Unpacker) -> NDArray[Any]:
        return _open(path, member, unpacker)

    if grid.given:
        return _grid(place, grid, opener, unpacker)
    if _is_pattern(place):
        return open_series(_matches(place), place, opener, unpacker, _depth)
    return opener(Path(place), unpacker)


def _grid(place: str, grid: Grid, opener: Callable[[Path, Unpacker], NDArray[Any]], unpacker: Unpacker) -> NDArray[Any]:
    """A grid of the pictures of a folder, of what a pattern finds, or of one picture that has all views."""
    folder = Path(place)
    if _is_pattern(place):
        paths = _matches(place)
    elif not os.path.isdir(folder) or is_zarr(folder):
        picture = opener(folder, unpacker)
        if grid.names is not None or grid.views is None:
            raise invalid("source-names", f"names in {place}", "one file", "a folder, or a pattern of several files",
                          "give --views alone for a picture that has all views")
        return unfolded(picture, grid.views, place)
    else:
        paths = pictures_of(folder, PAGES) if grid.names is None else named_files(folder, grid.names)
    paths, axes = arranged(paths, place, grid.names, grid.views)
    return led_by(open_series(paths, place, opener, unpacker, _depth), axes)


def _check_input(uri: str | Path) -> None:
    """Refuse what other commands take for their input, unless there is a file of that name."""
    if str(uri) == "-" and not os.path.exists("-"):
        raise invalid("argument-type", "uri", "standard input (-)", "the path of a file or a folder, or a pattern",
                      "write what comes from it to a file first, COMMAND > FILE, as a source is read more than once")


def _open(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    """A file, a store, or the pictures of a folder or of a list of lights."""
    is_folder = os.path.isdir(path)
    if is_folder and is_zarr(path):
        return open_zarr(path, member, unpacker)
    lights = light_list(path)
    if lights is not None:
        return open_lights(lights, lambda page, unpacker: _file(page, member, unpacker), unpacker, _depth)
    if not is_folder:
        return _file(path, member, unpacker)
    return open_series(pictures_of(path, PAGES), str(path), lambda page, unpacker: _open(page, member, unpacker),
                       unpacker, _depth)


def _file(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    return format_of(path).open(path, member, unpacker)


def _depth(path: Path) -> str:
    return "" if os.path.isdir(path) or light_list(path) is not None else format_of(path).depth(path)


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
