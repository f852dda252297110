"""Many files as one array: a folder of pictures, or what a pattern finds, stacked along a leading axis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis, name_axes
from ..errors import invalid
from ..labels import Labels, labelled, labels_of, with_axes
from ..support.cut_short import whole_map
from ..support.memory import drop_pages
from ..support.natural import in_order
from .source import Layout, io_error, reading
from .unpacked import Part, Unpacker, block_parts


def files_of(folder: Path) -> list[Path]:
    """The files of a folder in no order, without hidden ones.

    Raises:
        HmkctaError: it cannot be read.
    """
    reading(folder)
    try:
        return [path for path in folder.iterdir() if not path.name.startswith(".") and path.is_file()]
    except OSError as error:
        hint = "check its permissions"
        raise io_error("unreadable", str(folder), error.strerror, "a readable folder", hint,
                       told=f"cannot be read: {error.strerror}") from error


def pictures_of(folder: Path, endings: Sequence[str]) -> list[Path]:
    """The files of a folder with one of these endings, in natural order; hidden and other files are passed over.

    Raises:
        HmkctaError: there is none, or they are of several formats.
    """
    files = [path for path in files_of(folder) if path.suffix.lower() in endings]
    found = sorted({path.suffix.lower() for path in files})
    if not found:
        raise io_error("unreadable", str(folder), "a folder without pictures", "a file, or a folder of pictures",
                       f"name a file in it, or a pattern: '{folder}/*.npy'")
    if len(found) > 1:
        raise invalid("series-mixed", str(folder), f"files of {', '.join(found)}", "one format",
                      f"choose by a pattern, '{folder}/*{found[0]}'")
    return in_order(files)


def open_series(
    paths: Sequence[Path], where: str, opener: Callable[[Path, Unpacker], NDArray[Any]], unpacker: Unpacker,
    depth: Callable[[Path], str] = lambda _: "",
) -> NDArray[Any]:
    """Stack files of one shape and type, and of one depth, as `depth` says it of each.

    Raises:
        HmkctaError: the first file that differs is named; or what opening one raises.
    """
    silent = replace(unpacker, progress=None)  # it is files that are counted
    first, deep = opener(paths[0], silent), depth(paths[0])
    layout = Layout((len(paths), *first.shape), first.dtype.newbyteorder("="))

    def read(part: Part) -> NDArray[Any]:
        number: int = part[0].start
        path = paths[number]
        array = opener(path, silent)
        if (array.shape, array.dtype.newbyteorder("=")) != (first.shape, layout.dtype):
            raise invalid("series-mixed", str(path), str(Layout(array.shape, array.dtype)),
                          f"{Layout(first.shape, first.dtype)}, as {paths[0].name} is",
                          "choose files of one shape and type by a pattern")
        if (own := depth(path)) != deep:
            raise invalid("series-mixed", str(path), f"numbers of {own}", f"{deep}, as {paths[0].name} has",
                          "choose files of one depth by a pattern")
        with whole_map(array):
            values = np.array(array, layout.dtype)[np.newaxis]
        drop_pages(array)
        return values

    stack = unpacker.array(where, layout, block_parts(layout.shape, (1, *first.shape), 1), read)
    return labelled(stack, _stacked(labels_of(first), layout.shape))


def led_by(stack: NDArray[Any], leading: Sequence[Axis]) -> NDArray[Any]:
    """A stack with other axes in place of its first one, which has as many files as they have indices together.

    Raises:
        HmkctaError: one of them is called as an axis of the files is.
    """
    own = labels_of(stack)
    axes = [*leading, *(own.axes or name_axes(stack.shape))[1:]]
    name_axes([axis.size for axis in axes], [axis.name for axis in axes])  # which differ
    return with_axes(stack.reshape([axis.size for axis in axes]), axes, own.notes)


def _stacked(labels: Labels, shape: tuple[int, ...]) -> Labels:
    """Labels of a stack by those of its first file: other files may have other coordinates."""
    if labels.axes is None:
        return labels
    kept = [axis.name for axis in labels.axes if axis.coords is not None]
    said = f"coordinates {', '.join(kept)} of single files are not kept. Next: give those of the stack by --coords"
    names = ["file", *(axis.name for axis in labels.axes)]
    axes = name_axes(shape, names) if len(set(names)) == len(names) else None
    return Labels(axes, (*labels.notes, *([said] if kept else [])))
