"""RTI: pictures of one object under many lights, listed with the directions of the lights in a text file, `.lp`."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis
from ..errors import invalid
from .series import files_of, led_by, open_series
from .source import io_error, opened
from .unpacked import Unpacker

ENDING = ".lp"
#: Bytes that a list may have: some hundred thousand lights.
MOST = 1 << 24
#: How far from 1 the length of a unit vector may be, as files write three digits or more of each number.
UNIT = 0.01


def light_list(path: Path) -> Path | None:
    """The list of lights that a path means: itself, or the only one in a folder; None: it is something else.

    Raises:
        HmkctaError: several in the folder.
    """
    if path.suffix.lower() == ENDING and os.path.isfile(path):
        return path
    found = [each for each in files_of(path) if each.suffix.lower() == ENDING] if os.path.isdir(path) else []
    if len(found) > 1:
        listed = ", ".join(sorted(each.name for each in found))
        raise invalid("source-member", f"lists of lights of {path}", listed, "one",
                      f"name one of them, {found[0]}, or the pictures by a pattern")
    return found[0] if found else None


def open_lights(
    path: Path, opener: Callable[[Path, Unpacker], NDArray[Any]], unpacker: Unpacker, depth: Callable[[Path], str],
) -> NDArray[Any]:
    """Stack the pictures of a list of lights in its order, along an axis `light` with their directions.

    Raises:
        HmkctaError: the list is damaged, or of another length than it says; a picture is not there; or what
            `open_series` raises.
    """
    names, directions = _read(path)
    stack = open_series([_picture(path, name) for name in names], str(path), opener, unpacker, depth)
    lengths = np.linalg.norm(directions, axis=1)
    unit = "unit vector" if (abs(lengths - 1) <= UNIT).all() else ""  # lights that are near have positions
    return led_by(stack, [Axis("light", len(names), "light", directions, unit)])


def _read(path: Path) -> tuple[list[str], NDArray[np.float64]]:
    """Names of pictures, and where their lights are ``[light, 3]``."""
    where = str(path)
    with opened(path) as file:
        lines = [line for line in file.read(MOST).decode("utf-8-sig", "surrogateescape").splitlines() if line.strip()]
    count = lines[0].strip() if lines else ""
    if not (count.isascii() and count.isdigit()) or len(count) > 9 or int(count) < 1:
        found = f"{count[:40]!r} in its first line" if count else "an empty file"
        raise io_error("source-damaged", where, found, "the number of lights there, then NAME X Y Z in each line",
                       "write it so, or name the pictures by a pattern and give --coords light=FILE")
    if len(lines) - 1 != int(count):
        short = len(lines) - 1 < int(count)
        raise io_error("source-truncated" if short else "source-too-long", where, f"{len(lines) - 1} lights",
                       f"{count}, as its first line says", "fetch it again" if short else "correct its first line")
    names, directions = list[str](), list[list[float]]()
    for number, line in enumerate(lines[1:], start=1):
        words = line.strip().rsplit(None, 3)
        try:
            direction = [float(word) for word in words[1:]]
            if len(direction) != 3 or not np.isfinite(direction).all():
                raise ValueError
        except ValueError:
            raise io_error("source-damaged", where, f"{line.strip()[:60]!r} for light {number}",
                           "a file's name and three finite numbers", "correct this line") from None
        names.append(words[0].strip('"'))
        directions.append(direction)
    return names, np.array(directions)


def _picture(path: Path, name: str) -> Path:
    """The file of a light: beside its list first, as lists are moved and name the folder in which they were made."""
    said = Path(name.replace("\\", "/"))
    beside = path.parent / said.name
    tried = [beside, said] if said.is_absolute() else [path.parent / said, beside]
    for each in tried:
        if os.path.isfile(each):
            return each
    raise io_error("unreadable", str(tried[0]), f"no such file, which {path.name} names as {name}", "a picture",
                   "put the pictures into its folder, or correct it")
