"""Linear packing of numbers and their fill values, and the attributes by which netCDF and Zarr say both (CF)."""

from __future__ import annotations

import base64
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Attributes that hold fill values.
FILLS = ("_FillValue", "missing_value")

Part = tuple[slice, ...]


@dataclass(frozen=True, eq=False)
class Meant:
    """A dataset that gives the numbers that are meant when it is indexed by slices, one an axis.

    Attributes:
        stored: a dataset, or an array of its stored numbers.
        dtype: of the result.
        convert: makes the numbers that are meant of stored ones, and of the part that they are.
    """

    stored: Any
    dtype: np.dtype[Any]
    convert: Callable[[NDArray[Any], Part], NDArray[Any]]

    @property
    def shape(self) -> tuple[int, ...]:
        """Sizes of the axes."""
        return tuple(self.stored.shape)

    def __getitem__(self, part: Part) -> NDArray[Any]:
        return self.convert(np.asarray(self.stored[part]), part)


@dataclass(frozen=True, eq=False)
class Packing:
    """How numbers are unpacked: ``scale * stored + offset``, and NaN for fill values.

    Attributes:
        stored: the type that the stored bytes are meant to have.
        dtype: of the result.
    """

    stored: np.dtype[Any]
    dtype: np.dtype[Any]
    scale: float
    offset: float
    fills: NDArray[Any]

    def __call__(self, stored: NDArray[Any]) -> NDArray[Any]:
        """The numbers that are meant."""
        stored = np.asarray(stored).view(self.stored)
        values = np.asarray(stored, self.dtype)
        if (self.scale, self.offset) != (1.0, 0.0):  # in float64, as an offset may be near what it is added to
            wide = stored.astype(np.float64)
            wide *= self.scale
            wide += self.offset
            values = wide.astype(self.dtype)
        return np.where(np.isin(stored, self.fills), self.dtype.type(np.nan), values) if self.fills.size else values


def packing(attributes: Mapping[str, Any], dtype: np.dtype[Any]) -> Packing | None:
    """What the attributes of an array say; None: it is stored as it is meant.

    >>> packing({"scale_factor": 0.5, "_FillValue": -1}, np.dtype("i2"))(np.array([4, -1], "i2")).tolist()
    [2.0, nan]
    >>> packing({"_Unsigned": "true"}, np.dtype("i2"))(np.array([4, -1], "i2")).tolist()
    [4, 65535]
    """
    if dtype.kind not in "iuf":
        return None
    held = {name: _numbers(attributes.get(name)) for name in ("scale_factor", "add_offset", *FILLS)}
    # Several factors are somebody's own convention, for whatever axis.
    scale, offset = (float(values[0]) if values.size == 1 else otherwise
                     for values, otherwise in ((held["scale_factor"], 1.0), (held["add_offset"], 0.0)))
    meant = _signed(attributes, dtype)
    fills = _fills([number for name in FILLS for number in held[name].tolist()], dtype, meant)
    if (scale, offset) == (1.0, 0.0) and not fills.size:
        return None if meant == dtype else Packing(meant, meant, scale, offset, fills)
    return Packing(meant, scaled_type(dtype), scale, offset, fills)


def _fills(said: Sequence[float], dtype: np.dtype[Any], meant: np.dtype[Any]) -> NDArray[Any]:
    """Numbers that stand for nothing, as the type that is meant; of integers every digit counts."""
    finite = [number for number in said if isfinite(number)]
    if meant.kind == "f":
        return np.array(finite, meant)
    count = 1 << (8 * meant.itemsize)
    least = -count // 2 if meant.kind == "i" else 0
    whole = [int(number) for number in finite]
    if meant != dtype:  # they may be said in either type
        whole = [(number - least) % count + least for number in whole]
    return np.array([number for number in whole if least <= number < least + count], meant)


def _signed(attributes: Mapping[str, Any], dtype: np.dtype[Any]) -> np.dtype[Any]:
    """The type that the netCDF attribute ``_Unsigned`` makes of one of integers: old files have signed ones alone."""
    said = attributes.get("_Unsigned")
    word = said.decode() if isinstance(said, bytes) else str(said)
    kind = {("i", "true"): "u", ("u", "false"): "i"}.get((dtype.kind, word.lower()))
    return dtype if kind is None else np.dtype(f"{kind}{dtype.itemsize}").newbyteorder(dtype.byteorder)


def _numbers(value: Any) -> NDArray[Any]:
    """An attribute as numbers; none, if it is something else."""
    values = np.ravel([] if value is None else value)
    return values if values.dtype.kind in "iuf" else np.empty(0)


def scaled_type(stored: np.dtype[Any]) -> np.dtype[Any]:
    """The type for multiples of numbers: float32 where it holds each of them exactly.

    >>> scaled_type(np.dtype(">i2")), scaled_type(np.dtype("i4"))
    (dtype('float32'), dtype('float64'))
    """
    exact = stored.itemsize <= 2 or (stored.kind == "f" and stored.itemsize == 4)
    return np.dtype(np.float32 if exact else np.float64)


def zarr_attributes(array: Any) -> dict[str, Any]:
    """Attributes, with the fill value that xarray keeps elsewhere: in version 2 the array's own, in 3 as base64."""
    attributes = dict(array.attrs)
    fill = attributes.get("_FillValue")
    if isinstance(fill, str):
        attributes["_FillValue"] = struct.unpack("<d", base64.b64decode(fill))[0]
    elif fill is None and array.metadata.zarr_format == 2 and "_ARRAY_DIMENSIONS" in attributes:
        attributes["_FillValue"] = array.fill_value
    return attributes


def text_of(value: Any) -> str:
    """An attribute as text; empty, if there is none.

    >>> text_of(b"zspace"), text_of(None), text_of(np.array(["a"], object))
    ('zspace', '', 'a')
    """
    values = np.ravel([] if value is None else value)
    first = values[0] if values.size else ""
    return first.decode("utf-8", "replace") if isinstance(first, bytes) else str(first)
