"""FITS by astropy: plain images are mapped, scaled and packed ones unpacked; the last axis of the array is NAXIS1."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis
from ..labels import with_axes
from ..packing import Meant, Part, scaled_type
from ..support.optional import library
from .source import Layout, check_layout, choose, guarded, io_error, map_part, opened, too_long, too_short
from .unpacked import Unpacker

MAGIC = b"SIMPLE  ="
#: Types of axes (FITS standard 4.0, section 8) whose coordinates are those of a spectrum, or of Stokes parameters.
_SPECTRAL = ("FREQ", "ENER", "WAVN", "VRAD", "WAVE", "VOPT", "ZOPT", "AWAV", "VELO", "BETA", "STOKES")
_TIMES = ("TIME", "UTC", "TAI", "TT", "TDB")

Convert = Callable[[NDArray[Any], Part], NDArray[Any]]


def open_fits(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    """Open an image of a FITS file, by its EXTNAME or number; scaled as its header says, NaN for what is blank.

    Raises:
        HmkctaError: astropy is missing, there are several images and none is named, or the file is damaged, shorter or
            longer than it says.
    """
    fits = library("astropy.io.fits", "astropy", "fits", "FITS")
    with guarded(path, "FITS file"), ExitStack() as stack:
        stack.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore")  # of cards that are read all the same; lengths are looked at here
        with opened(path) as file:
            held = file.seek(0, 2)
        units = stack.enter_context(fits.open(path, memmap=True, do_not_scale_image_data=True))
        named = _named(units)
        images = {name: unit for name, unit in named.items() if unit.is_image and unit.shape and all(unit.shape)}
        if not images:
            raise io_error("source-format", str(path), "tables or headers, and no image", "an image",
                           "astropy.table.Table.read reads a table; save a column of it by numpy.save")
        if member is not None and member not in images and member.isdecimal():
            member = dict(enumerate(named)).get(int(member), member)
        place = units[len(units) - 1].fileinfo()
        end = place["datLoc"] + place["datSpan"]
        name = choose(str(path), {name: str(_layout(unit)) for name, unit in images.items()}, member)
        unit, layout, where = images[name], _layout(images[name]), f"{path}:{name}"
        check_layout(layout, where)
        if held != end:
            raise (too_short if held < end else too_long)(str(path), f"{held} bytes, of {end} of all parts,", layout)
        packed, meant = isinstance(unit, fits.CompImageHDU), _meant(unit.header, layout.dtype)
        if packed:
            unpacker.check_widened(path, layout.nbytes)
            numbers: Any = _Tiles(unit, layout.shape)
            meant = meant or (layout.dtype.newbyteorder("="), lambda values, _: values)
        else:
            numbers = map_part(path, layout, int(unit.fileinfo()["datLoc"]), where)
        array = numbers if meant is None else unpacker.chunks(
            where, Meant(numbers, *meant), list(map(int, unit.tile_shape)) if packed else None)
        return with_axes(array, _axes(unit.header, layout.shape))


def _named(units: Any) -> dict[str, Any]:
    """Parts of a file by their names; by their numbers where they have none, or that of another part."""
    named: dict[str, Any] = {}
    for number in range(len(units)):  # which reads their headers
        name = str(units[number].header.get("EXTNAME", "")).strip()
        named[str(number) if not name or name in named else name] = units[number]
    return named


def _layout(unit: Any) -> Layout:
    """Shape and number type of an image as it is stored."""
    bits = int(unit.header["BITPIX"])
    if bits not in (8, 16, 32, 64, -32, -64):
        raise ValueError(f"BITPIX = {bits}")
    kind = "u1" if bits == 8 else f">{'f' if bits < 0 else 'i'}{abs(bits) // 8}"
    return Layout(tuple(map(int, unit.shape)), np.dtype(kind))


@dataclass(frozen=True)
class _Tiles:
    """An image that is packed in tiles, of which astropy unpacks those that are asked for."""

    unit: Any
    shape: tuple[int, ...]

    def __getitem__(self, part: Any) -> NDArray[Any]:
        return np.asarray(self.unit.section[part])


def _meant(header: Mapping[str, Any], stored: np.dtype[Any]) -> tuple[np.dtype[Any], Convert] | None:
    """The number type of what is meant, and what makes it of stored numbers; None: it is they.

    Whole numbers with half their range as zero point stand for the types that FITS lacks; all other scaled numbers
    become floating-point numbers, as astropy has them.
    """
    scale, zero = float(header.get("BSCALE", 1)), float(header.get("BZERO", 0))
    whole, native = stored.kind in "iu", stored.newbyteorder("=")
    blank = header.get("BLANK") if whole else None
    if (scale, zero) == (1.0, 0.0) and blank is None:
        return None
    middle = 1 << (8 * stored.itemsize - 1)
    if whole and scale == 1.0 and blank is None and zero == (-middle if stored.kind == "u" else middle):
        bits = np.dtype(f"u{stored.itemsize}")
        other = np.dtype(f"i{stored.itemsize}") if stored.kind == "u" else bits
        return other, lambda values, _: (values.astype(native).view(bits) ^ bits.type(middle)).view(other)
    kind = scaled_type(stored)

    def scaled(values: NDArray[Any], _: object) -> NDArray[Any]:
        meant = (values.astype(np.float64) * scale + zero).astype(kind)
        return meant if blank is None else np.where(values == blank, kind.type(np.nan), meant)

    return kind, scaled


def _axes(header: Mapping[str, Any], shape: tuple[int, ...]) -> list[Axis]:
    """Axes by the header's types, with coordinates of those that are straight and not turned against each other."""
    axes: list[Axis] = []
    for number, size in enumerate(reversed(shape), start=1):
        kind, _, curve = str(header.get(f"CTYPE{number}", "")).strip().upper().partition("-")
        name, role = "xyz"[number - 1] if number <= 3 else f"axis{number}", "space" if number <= 3 else "other"
        if kind in _SPECTRAL or kind in _TIMES:
            name, role = kind.lower(), "channel" if kind in _SPECTRAL else "time"
        coords = None if curve else _straight(header, number, size, len(shape))
        unit = str(header.get(f"CUNIT{number}", "")).strip() if coords is not None else ""
        axes.append(Axis(name, size, role, coords, unit))
    unlike = len({axis.name for axis in axes}) == len(axes)
    return (axes if unlike else [Axis(f"axis{n}", axis.size) for n, axis in enumerate(axes, start=1)])[::-1]


def _straight(header: Mapping[str, Any], number: int, size: int, count: int) -> NDArray[Any] | None:
    """Coordinates by reference value, step and pixel (FITS standard 4.0, section 8.1); None: it says none."""
    others = [other for other in range(1, count + 1) if other != number]
    turned = any(float(header.get(f"{kind}{row}_{column}", 0)) for kind in ("CD", "PC") for other in others
                 for row, column in ((number, other), (other, number)))
    step = header.get(f"CDELT{number}", header.get(f"CD{number}_{number}"))
    if turned or step is None:
        return None
    step = float(step) * float(header.get(f"PC{number}_{number}", 1))
    pixels = np.arange(1, size + 1, dtype=np.float64) - float(header.get(f"CRPIX{number}", 0))
    return step * pixels + float(header.get(f"CRVAL{number}", 0))
