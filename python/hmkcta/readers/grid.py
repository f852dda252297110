"""Grids of pictures: which place in it the name of a file says, or its turn; and one picture of all views."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis, name_axes
from ..errors import invalid, shown
from ..labels import labels_of, with_axes
from ..support.natural import in_order
from .series import files_of

#: Behind the size of a grid: all views of one place lie together, as under the lenslets of a camera.
LENSLETS = "lenslets"
_VIEWS = "rows and columns, 17x17 or (17, 17); of one picture with a lens over the views of each place 14x14:lenslets"
_NAMES = "a name with fields in braces and * for what does not matter, out_{row}_{column}_*"
_FIELD = re.compile(r"\{([^{}]*)\}")


@dataclass(frozen=True)
class Views:
    """A grid of views.

    Attributes:
        shape: rows and columns.
        lenslets: whether a picture has all views of a place together, else each view is a tile of it.
    """

    shape: tuple[int, int]
    lenslets: bool = False


def views_given(given: object) -> Views | None:
    """The grid that callers give.

    >>> views_given("17x17"), views_given((9, 5)).shape, views_given("14x14:lenslets").lenslets
    (Views(shape=(17, 17), lenslets=False), (9, 5), True)

    Raises:
        HmkctaError: reason ``source-views``.
    """
    if given is None:
        return None
    text = "x".join(map(str, cast("Sequence[object]", given))) if isinstance(given, tuple | list) else str(given)
    found = re.fullmatch(rf"\s*([1-9][0-9]{{0,5}})\s*[x,]\s*([1-9][0-9]{{0,5}})\s*(:\s*{LENSLETS})?\s*", text)
    if found is None:
        raise invalid("source-views", "views", shown(cast(object, given)), _VIEWS)
    return Views((int(found[1]), int(found[2])), found[3] is not None)


def arranged(paths: Sequence[Path], where: str, names: str | None, views: Views | None
             ) -> tuple[list[Path], list[Axis]]:
    """Files in the order of their grid, and the grid's axes.

    Args:
        paths: the files, in the order in which people count.
        where: what names them, for errors.
        names: how they are called, `out_{row}_{column}_*`: whole numbers in place of the fields say where each belongs,
            and `{NAME:ROLE}` says what an axis is; others are passed over. None: all, in their order.
        views: rows and columns; None: as many as there are numbers.

    Raises:
        HmkctaError: reason ``source-names`` or ``source-views``: a place of the grid has no file, or two.
    """
    if views is not None and views.lenslets:
        raise invalid("source-views", f"views of {where}", LENSLETS, "a picture for each view",
                      "leave that word out, or name the one picture")
    if names is None:
        axes = [Axis("file", len(paths))]
        placed: dict[tuple[int, ...], Path] = {(number,): path for number, path in enumerate(paths)}
    else:
        axes, placed = _placed(paths, where, names)
    if views is not None and len(axes) == 1:
        axes = [Axis(name, size, "view") for name, size in zip(("row", "column"), views.shape, strict=True)]
    found, wanted = [axis.size for axis in axes], len(placed)
    if views is not None and (tuple(found) != views.shape or wanted != prod(views.shape)):
        raise invalid("source-views", f"views of {where}",
                      f"{wanted} files" if names is None else f"{wanted} files that are called {names}",
                      f"{prod(views.shape)}, {' x '.join(map(str, views.shape))}",
                      "choose the files by a pattern, or by --names 'out_{row}_{column}_*'")
    return [placed[place] for place in sorted(placed)], axes


def _placed(paths: Sequence[Path], where: str, names: str) -> tuple[list[Axis], dict[tuple[int, ...], Path]]:
    """Axes of the fields of a name, and the file at each place by its numbers."""
    fields = _FIELD.findall(names)
    if not fields:
        raise invalid("source-names", "names", repr(names), _NAMES)
    pattern = _pattern(names)
    placed: dict[tuple[int, ...], Path] = {}
    for path in paths:
        found = pattern.fullmatch(path.name)
        place = tuple(map(int, found.groups())) if found else ()
        if place in placed:
            raise invalid("source-names", f"files of {where}", f"{placed[place].name} and {path.name}, both at {place}",
                          "one file for each place", "write more of the name in place of *")
        if found:
            placed[place] = path
    if not placed:
        first = f"{paths[0].name}, .." if paths else "no file"
        raise invalid("source-names", f"files of {where}", first, f"some that are called {names}", f"write {_NAMES}")
    numbers = [sorted(set(column)) for column in zip(*placed, strict=True)]
    missing = next((place for place in product(*numbers) if place not in placed), None)
    if missing is not None:
        said = ", ".join(f"{field.partition(':')[0]} {number}" for field, number in zip(fields, missing, strict=True))
        raise invalid("source-names", f"files of {where}", f"none for {said}", "one file for each place of the grid",
                      "fetch it, or choose a whole grid by a pattern")
    axes = name_axes([len(column) for column in numbers], fields)
    return [axis if column == list(range(axis.size)) else Axis(axis.name, axis.size, axis.role, np.array(column))
            for axis, column in zip(axes, numbers, strict=True)], placed


def _pattern(names: str) -> re.Pattern[str]:
    """What matches a file's whole name, with a group for each field.

    >>> _pattern("out_{row}_{column}_*").fullmatch("out_02_16_-7.5_.png").groups()
    ('02', '16')
    """
    parts = re.split(r"(\{[^{}]*\}|\*|\?)", names)
    kinds = {"*": ".*", "?": "."}
    return re.compile("".join("([0-9]+)" if part.startswith("{") else kinds.get(part) or re.escape(part)
                              for part in parts), re.DOTALL)


def named_files(folder: Path, names: str) -> list[Path]:
    """The files of a folder that are called so, in the order in which people count.

    Raises:
        HmkctaError: the folder cannot be read.
    """
    pattern = _pattern(names)
    return in_order(path for path in files_of(folder) if pattern.fullmatch(path.name))


def unfolded(picture: NDArray[Any], views: Views, where: str) -> NDArray[Any]:
    """The views ``[row, column, y, x, ..]`` of one picture ``[y, x, ..]`` that has all, as tiles or under lenslets.

    >>> picture = np.arange(24).reshape(4, 6)
    >>> unfolded(picture, Views((2, 3)), "")[1, 2].tolist()
    [[16, 17], [22, 23]]
    >>> unfolded(picture, Views((2, 3), lenslets=True), "")[1, 2].tolist()
    [[8, 11], [20, 23]]

    Raises:
        HmkctaError: reason ``source-views``: it is no picture, or its sides are no multiples of the grid's.
    """
    own = labels_of(picture)
    inner = own.axes or name_axes(picture.shape, [*"yx", *(f"axis{n}" for n in range(2, picture.ndim))][:picture.ndim])
    if [axis.name for axis in inner[:2]] != ["y", "x"]:
        raise invalid("source-views", f"axes of {where}", ", ".join(axis.name for axis in inner), "y, x and colours",
                      "give a picture, or a folder of as many as there are views")
    (rows, columns), (down, right) = views.shape, picture.shape[:2]
    if down % rows or right % columns:
        raise invalid("source-views", f"size of {where}", f"{down} x {right}",
                      f"multiples of {rows} x {columns}, the views", "cut it to a multiple, or give other --views")
    tall, wide = down // rows, right // columns
    split = (tall, rows, wide, columns) if views.lenslets else (rows, tall, columns, wide)
    order = (1, 3, 0, 2) if views.lenslets else (0, 2, 1, 3)
    array = picture.reshape(*split, *picture.shape[2:]).transpose(*order, *range(4, picture.ndim + 2))
    space = [Axis(axis.name, size, axis.role) for axis, size in zip(inner, (tall, wide), strict=False)]
    return with_axes(array, [Axis("row", rows, "view"), Axis("column", columns, "view"), *space, *inner[2:]], own.notes)
