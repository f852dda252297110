"""Reflectance of single materials without magic bytes: MERL's isotropic and UTIA's anisotropic measurements."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis
from ..errors import HmkctaError
from ..labels import with_axes
from ..packing import Meant, Part
from .source import Layout, check_layout, io_error, map_part, opened, too_short
from .unpacked import Unpacker

#: MERL's header: whole numbers of half-vector zeniths, difference zeniths, difference azimuths.
_SIZES = struct.Struct("<3i")
#: The sizes that MERL's own reader demands; azimuths are those of 180 degrees, as the others follow by reciprocity.
MERL = (90, 90, 180)
#: What the numbers of MERL's red, green and blue are multiplied with (BRDFRead.cpp of the database).
SCALES = np.array([1.0, 1.15, 1.66]) / 1500.0
#: UTIA's sizes: colour, zenith and azimuth of the light, of the view; in steps of 15 and 7.5 degrees.
UTIA = (3, 6, 48, 6, 48)
_RAW = "say shape and dtype of raw binary, e.g. --shape 64,64,3 --dtype float32"


def open_merl(path: Path, unpacker: Unpacker) -> NDArray[Any]:
    """Open a BRDF of the MERL database: zenith of the half vector, zenith and azimuth of the difference, colour.

    Numbers are scaled as the database says, so that they are BRDF values in 1/sr; negative ones, which stand for
    directions below the horizon, become NaN.

    Raises:
        HmkctaError: it is shorter or longer than its header says, or no such file.
    """
    where = str(path)
    with opened(path) as file:
        start, held = file.read(_SIZES.size), file.seek(0, 2)
    sizes = _SIZES.unpack(start) if len(start) == _SIZES.size else MERL
    stored = Layout((len(SCALES), *sizes), np.dtype("<f8"))
    if len(start) < _SIZES.size:
        raise too_short(where, f"{held} bytes", stored)
    if sizes != MERL and held != _SIZES.size + stored.nbytes:
        raise _unknown(path, f"no BRDF of the MERL database, which begins with {', '.join(map(str, MERL))}")
    check_layout(stored, where)
    numbers = map_part(path, stored, _SIZES.size, where, last=True)
    array = unpacker.chunks(where, Meant(numbers, np.dtype(np.float64), _radiometric), None)
    half, difference, azimuth = (np.arange(size) for size in sizes)
    return with_axes(np.moveaxis(array, 0, -1), (
        Axis("theta_half", sizes[0], coords=90.0 * half**2 / sizes[0]**2, unit="degrees"),  # close at highlights
        Axis("theta_diff", sizes[1], coords=90.0 * difference / sizes[1], unit="degrees"),
        Axis("phi_diff", sizes[2], coords=180.0 * azimuth / sizes[2], unit="degrees"),
        Axis("rgb", len(SCALES), "channel"),
    ))


def _radiometric(stored: NDArray[Any], part: Part) -> NDArray[Any]:
    """BRDF values of stored numbers ``[colour, ..]``, NaN where there is none."""
    return np.where(stored < 0, np.nan, stored * SCALES[part[0]].reshape(-1, 1, 1, 1))


def open_utia(path: Path) -> NDArray[Any]:
    """Map a BRDF of the UTIA database: zenith and azimuth of the light, then of the view, colour.

    Raises:
        HmkctaError: it has another length: the format has no header.
    """
    layout = Layout(UTIA, np.dtype("<f8"))
    with opened(path) as file:
        held = file.seek(0, 2)
    if held != layout.nbytes:
        raise _unknown(path, f"{held} bytes, and a BRDF of the UTIA database has {layout.nbytes}")
    array = map_part(path, layout, 0, str(path), last=True)
    zeniths, azimuths = 15.0 * np.arange(UTIA[1]), 7.5 * np.arange(UTIA[2])
    directions = [Axis(f"{angle}_{end}", len(steps), role, steps, "degrees")
                  for end, role in (("i", "light"), ("v", "view"))
                  for angle, steps in (("theta", zeniths), ("phi", azimuths))]
    return with_axes(np.moveaxis(array, 0, -1), (*directions, Axis("rgb", UTIA[0], "channel")))


def _unknown(path: Path, found: str) -> HmkctaError:
    allowed = "such a file whole, or raw binary that is described"
    return io_error("source-format", str(path), found, allowed, _RAW)
