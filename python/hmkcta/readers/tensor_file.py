"""Tensor files, in which RGL's material database keeps measured BSDFs (`.bsdf`) and others polarised ones (`.pbsdf`).

Several arrays a file, each mapped; what is measured says in arrays beside it at which angles and wavelengths.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis
from ..labels import with_axes
from .source import Layout, choose, guarded, io_error, map_part, opened, too_long
from .unpacked import Unpacker

MAGIC = b"tensor_file\0"
VERSION = (1, 0)
#: Number types by their code.
_TYPES = ("", "u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8")
#: Axes of the arrays of RGL's files and of polarised ones: the angles of the light, or of half vector and difference;
#: what comes in each direction; and rows and columns of the unit square onto which directions are spread.
_INCIDENT, _SQUARE = ("phi_i:light", "theta_i:light"), ("v:space", "u:space")
_AXES = {
    "spectra": (*_INCIDENT, "wavelength:channel", *_SQUARE), "rgb": (*_INCIDENT, "rgb:channel", *_SQUARE),
    "luminance": (*_INCIDENT, *_SQUARE), "vndf": (*_INCIDENT, *_SQUARE), "ndf": _SQUARE, "sigma": _SQUARE,
    "M": ("phi_d:other", "theta_d:other", "theta_h:other", "wavelength:channel", "mueller_row:other",
          "mueller_column:other"),
}
#: Arrays that hold the coordinates of an axis, if not those of its own name, and their units.
_COORDS = {"wavelength": ("wavelengths", "wvls")}
_UNITS = {"phi_i": "radians", "theta_i": "radians", "wavelength": "nm"}

Tensors = Mapping[str, tuple[Layout, int]]


def open_tensor_file(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    """Map one of the arrays of a tensor file.

    Raises:
        HmkctaError: there are several and none is named, or the file is damaged, shorter or longer than it says.
    """
    del unpacker
    with guarded(path, "tensor file"):
        with opened(path) as file:
            tensors, held = _tensors(file, path), file.seek(0, 2)
        texts = {name: str(layout) for name, (layout, _) in tensors.items() if layout.shape and layout.nbytes}
        unread = {name: "no element" if layout.shape else "one number" for name, (layout, _) in tensors.items()
                  if name not in texts}
        last = max(tensors.values(), key=lambda each: each[1] + each[0].nbytes, default=None)
        if last is not None and held > last[1] + last[0].nbytes:
            raise too_long(str(path), f"{held - last[1]} bytes of its last array", last[0])
        name = choose(str(path), texts, member, unread)
        layout, offset = tensors[name]
        return with_axes(map_part(path, layout, offset, f"{path}:{name}"), _axes(path, tensors, name))


def _tensors(file: BinaryIO, path: Path) -> Tensors:
    """Layout and place of each array, by name; the file stands behind its header."""
    def take(form: str) -> tuple[Any, ...]:
        return struct.unpack(f"<{form}", file.read(struct.calcsize(f"<{form}")))

    file.seek(len(MAGIC))
    version = take("BB")
    if version != VERSION:
        raise io_error("source-format", str(path), f"version {'.'.join(map(str, version))} of tensor files", "1.0",
                       "write it again with what made it, as version 1.0")
    tensors: dict[str, tuple[Layout, int]] = {}
    for _ in range(take("I")[0]):
        name = file.read(take("H")[0]).decode("utf-8")
        axes, kind, offset = take("HBQ")
        if name in tensors or not 1 <= kind < len(_TYPES):
            found = f"the array {name!r} twice" if name in tensors else f"number type {kind} of {name!r}"
            raise ValueError(found)
        tensors[name] = Layout(take(f"{axes}Q"), np.dtype(_TYPES[int(kind)])), offset
    return tensors


def _axes(path: Path, tensors: Tensors, name: str) -> list[Axis]:
    """Axes of an array by its name, with the angles and wavelengths that the file has for them."""
    shape = tensors[name][0].shape
    known = _AXES.get(name, ())
    if len(known) != len(shape):
        return [Axis(f"axis{number}", size) for number, size in enumerate(shape)]
    axes: list[Axis] = []
    for word, size in zip(known, shape, strict=True):
        axis, _, role = word.partition(":")
        beside = next((each for each in _COORDS.get(axis, (axis,)) if each in tensors and each != name), None)
        coords = None
        if beside is not None and tensors[beside][0].shape == (size,):
            layout, offset = tensors[beside]
            coords = map_part(path, layout, offset, f"{path}:{beside}").astype(layout.dtype.newbyteorder("="))
        axes.append(Axis(axis, size, role, coords, "" if coords is None else _UNITS.get(axis, "")))
    return axes
