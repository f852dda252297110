"""Colour maps and transfer functions of volumes, and the colours of errors, as tables of 256 entries."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import invalid
from ..pictures import heat_colours
from .scene import Look

F32 = NDArray[np.float32]

ENTRIES = 256

#: Colours 0..255 at even steps from 0 to 1. The first four rise in brightness, the last one parts two signs.
COLOURS = {
    "grey": ((0, 0, 0), (255, 255, 255)),
    "inferno": ((0, 0, 4), (40, 11, 84), (101, 21, 110), (159, 42, 99), (212, 72, 66), (245, 125, 21), (250, 193, 39),
                (252, 255, 164)),
    "viridis": ((68, 1, 84), (70, 50, 127), (54, 92, 141), (39, 127, 142), (31, 161, 135), (74, 194, 109),
                (159, 218, 58), (253, 231, 37)),
    "ice": ((4, 6, 19), (31, 39, 88), (54, 79, 155), (66, 130, 186), (109, 180, 208), (180, 222, 230), (234, 252, 253)),
    "coolwarm": ((59, 76, 192), (124, 159, 249), (192, 212, 245), (221, 221, 221), (244, 196, 173), (222, 96, 77),
                 (180, 4, 38)),
}


def transfer_table(look: Look) -> F32:
    """Display colour and opacity per voxel of 256 shares, ``[256, 4]``.

    >>> transfer_table(Look(colours="grey", opacity=((0, 0), (1, 1))))[255].tolist()
    [1.0, 1.0, 1.0, 1.0]

    Raises:
        HmkctaError: the colour map is unknown, a list of colours or opacities is empty or does not rise.
    """
    share = np.linspace(0, 1, ENTRIES)
    if isinstance(look.colours, str):
        if look.colours not in COLOURS:
            raise invalid("unknown-colours", "volume.colours", repr(look.colours),
                          f"{', '.join(COLOURS)}, or a list of [share, red, green, blue]")
        stops = np.array(COLOURS[look.colours]) / 255
        places = np.linspace(0, 1, len(stops))
    else:
        points = _rising("volume.colours", look.colours)
        places, stops = points[:, 0], points[:, 1:]
    opacity = _rising("volume.opacity", look.opacity)
    columns = [np.interp(share, places, stops[:, c]) for c in range(3)]
    columns.append(np.clip(np.interp(share, opacity[:, 0], opacity[:, 1]), 0, 1))
    return np.stack(columns, axis=1).astype(np.float32)


def heat_table() -> F32:
    """Display colours of errors from 0 to the most shown, ``[256, 4]``."""
    colours = heat_colours(np.linspace(0, 1, ENTRIES)).astype(np.float32) / 255
    return np.concatenate([colours, np.ones((ENTRIES, 1), np.float32)], axis=1).astype(np.float32)


def _rising(where: str, points: tuple[tuple[float, ...], ...]) -> NDArray[np.float64]:
    table = np.array(points, np.float64)
    if not len(points) or (np.diff(table[:, 0]) < 0).any():
        raise invalid("transfer-points", where, [list(point) for point in points], "points whose shares rise")
    return table
