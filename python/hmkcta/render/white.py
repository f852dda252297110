"""White of integer pictures, and values that are sRGB-coded; the page follows the same rule."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis

F32 = NDArray[np.float32]

#: The number that shows as white, by the number type of pictures. Signed and wider integers are measurements.
WHITES = {"bool": 1.0, "uint8": 255.0, "uint16": 65535.0}
#: The number type that cameras and painting programs code by sRGB's curve; more bits are mostly linear.
CODED = "uint8"


def white_of(source_dtype: str, kind: str, axes: Sequence[Axis]) -> float | None:
    """The white of a picture's number type; None where the data decide.

    These are floats, signed and wide integers, and what is measured in three dimensions: volumes, and their slices.

    >>> from hmkcta.axes import name_axes
    >>> white_of("uint8", "generic", name_axes((4, 5, 3), ["y", "x", "rgb"]))
    255.0
    >>> white_of("uint8", "generic", name_axes((3, 4, 5), ["z", "y", "x"])) is None
    True
    """
    solid = kind == "volume" or (kind == "generic" and sum(axis.role == "space" for axis in axes) >= 3)
    return None if solid else WHITES.get(source_dtype)


def coded_white(source_dtype: str, kind: str, said: bool | None) -> float:
    """The white by which sRGB-coded values of a material are decoded to light; 0: they are light as they are.

    `said` is what the scene says, None for what the number type says.

    >>> coded_white("uint8", "svbrdf", None), coded_white("uint16", "svbrdf", None), coded_white("float32", "svbrdf", True)
    (255.0, 0.0, 1.0)
    """
    coded = source_dtype == CODED if said is None else said
    return WHITES.get(source_dtype, 1.0) if coded and kind == "svbrdf" else 0.0


def as_light(values: F32, white: float) -> F32:
    """Light of sRGB-coded values (IEC 61966-2-1), whose white stays what it is; a white of 0 changes nothing.

    >>> as_light(np.array([0.0, 127.5, 255.0], np.float32), 255.0).round(1).tolist()
    [0.0, 54.599998474121094, 255.0]
    """
    if not white:
        return values
    share = np.maximum(values / np.float32(white), np.float32(0))
    curve = np.power((share + np.float32(0.055)) / np.float32(1.055), np.float32(2.4))
    return np.asarray(np.where(share <= 0.04045, share / np.float32(12.92), curve) * np.float32(white), np.float32)
