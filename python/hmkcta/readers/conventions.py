"""Attributes by which netCDF and Zarr say how stored numbers are meant: the CF conventions' packing and fill values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Attributes that hold fill values.
FILLS = ("_FillValue", "missing_value")


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
        if (self.scale, self.offset) != (1.0, 0.0):
            values = values * self.dtype.type(self.scale) + self.dtype.type(self.offset)
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
    fills, meant = np.concatenate([held[name] for name in FILLS]), _signed(attributes, dtype)
    fills = fills[np.isfinite(fills)]
    if meant != dtype:  # they may be said in either type
        count = 2.0 ** (8 * meant.itemsize)
        least = -count / 2 if meant.kind == "i" else 0.0
        fills = (fills - least) % count + least
    fills = fills.astype(meant)
    if (scale, offset) == (1.0, 0.0) and not fills.size:
        return None if meant == dtype else Packing(meant, meant, scale, offset, fills)
    return Packing(meant, scaled_type(dtype), scale, offset, fills)


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
