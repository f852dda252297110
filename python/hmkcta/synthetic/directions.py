"""Directions over the upper hemisphere, and a check of directions that the caller brings."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import invalid

GOLDEN_ANGLE = np.pi * (3.0 - np.sqrt(5.0))  # radians between neighbours of a Fibonacci spiral

#: Gonioreflectometers stop near this zenith angle (degrees): beyond it the sample is seen edge on.
MAX_ZENITH = 75.0

#: How far a direction's length may be from 1: float16 storage loses as much.
LENGTH_TOLERANCE = 2e-3


def hemisphere_directions(count: int, turn: float = 0.0, max_zenith: float = MAX_ZENITH) -> NDArray[np.float32]:
    """Unit vectors ``[count, 3]`` spread evenly by area, from the zenith (0, 0, 1) down to `max_zenith` degrees.

    A Fibonacci spiral, turned by `turn` radians about the normal: zenith angles rise with the index, azimuths jump
    from each to the next by the golden angle.

    >>> spread = hemisphere_directions(24)
    >>> spread.shape, bool(spread[:, 2].min() > np.cos(np.radians(75))), round(float(spread[0, 2]), 2)
    ((24, 3), True, 0.98)
    """
    number = np.arange(count)
    z = 1.0 - (number + 0.5) / count * (1.0 - np.cos(np.radians(max_zenith)))
    radius = np.sqrt(1.0 - z * z)
    azimuth = number * GOLDEN_ANGLE + turn
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1).astype(np.float32)


def upper_unit_vectors(directions: NDArray[Any], where: str) -> NDArray[np.float64]:
    """The directions ``[count, 3]`` at exactly unit length; an error unless they are unit vectors with z > 0.

    >>> upper_unit_vectors(np.array([[0.0, 0.6, 0.8]]), "lights").tolist()
    [[0.0, 0.6, 0.8]]
    """
    vectors = np.asarray(directions, np.float64)
    if vectors.ndim != 2 or vectors.shape[1] != 3 or not len(vectors):
        raise invalid("directions-shape", where, f"shape {vectors.shape}", "[count, 3] with one row or more")
    length = np.sqrt((vectors**2).sum(axis=1, keepdims=True))
    bad = ~((abs(length[:, 0] - 1.0) <= LENGTH_TOLERANCE) & (vectors[:, 2] > 0.0))
    if bad.any():
        row = int(np.argmax(bad))
        raise invalid("bad-direction", f"{where}[{row}]", vectors[row].tolist(), "a unit vector with z > 0")
    return vectors / length
