"""What the numbers of a TIFF file mean: ImageJ's calibration, and scale, offset and missing values of GDAL."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ..packing import Packing, packing
from .source import Layout, io_error
from .unpacked import BLOCK, Unpacker, block_parts

Convert = Callable[[NDArray[Any]], NDArray[Any]]

#: ImageJ's function of a straight line, and its offset of signed numbers of 16 bits.
_STRAIGHT, _SIGNED = 0, -32768
#: Tags in which GDAL keeps its items, as XML, and the number that stands for nothing, as text.
_GDAL_METADATA, _GDAL_NODATA = 42112, 42113
#: A scaling that changes nothing.
_PLAIN = {"scale_factor": 1.0, "add_offset": 0.0}


def as_meant(array: NDArray[Any], page: Any, imagej: Mapping[str, Any] | None, where: str, unpacker: Unpacker
             ) -> NDArray[Any]:
    """The numbers that are meant, NaN where none is.

    Args:
        array: stored numbers.
        page: tifffile's first page of the series.
        imagej: what ImageJ says of the file; None: it did not write it.
        where: names the file in errors.
        unpacker: makes arrays of numbers that differ from the stored ones.

    Raises:
        HmkctaError: `Io`, reason ``source-format``: a calibration that is no straight line, or differs by channel.
    """
    attributes = {**_calibration(imagej or {}, where), **_gdal(page, where)}
    if attributes.get("add_offset") == _SIGNED and attributes.get("scale_factor") == 1 and array.dtype.itemsize == 2:
        return _unpacked(array, np.dtype(np.int16), _signed, where, unpacker)
    packed: Packing | None = packing(attributes, array.dtype)
    return array if packed is None else _unpacked(array, packed.dtype, packed, where, unpacker)


def _signed(stored: NDArray[Any]) -> NDArray[Any]:
    return stored.astype(np.int32) + _SIGNED


def _unpacked(array: NDArray[Any], dtype: np.dtype[Any], convert: Convert, where: str, unpacker: Unpacker
              ) -> NDArray[Any]:
    parts = block_parts(array.shape, [1] * array.ndim, BLOCK)
    return unpacker.array(where, Layout(array.shape, dtype), parts, lambda part: convert(array[part]))


def _calibration(imagej: Mapping[str, Any], where: str) -> dict[str, float]:
    """Slope c1 and offset c0 of ImageJ's straight line; none where nothing is calibrated."""
    if "cf" not in imagej and "c0" not in imagej:
        return {}
    function, offset, slope = imagej.get("cf", _STRAIGHT), imagej.get("c0", 0), imagej.get("c1", 1)
    if function != _STRAIGHT or not all(isinstance(number, int | float) for number in (offset, slope)):
        raise io_error("source-format", where, f"a calibration by ImageJ's function {function}", "a straight line",
                       "apply it in ImageJ: Process > Math, or save without calibration")
    return {"scale_factor": float(slope), "add_offset": float(offset)}


def _gdal(page: Any, where: str) -> dict[str, float]:
    """Scale, offset and the number that stands for nothing; of all channels the same."""
    found: dict[str, float] = {}
    items = page.tags.valueof(_GDAL_METADATA)
    said = [*ElementTree.fromstring(items).iter("Item")] if items else []
    for role, name, otherwise in (("scale", "scale_factor", 1.0), ("offset", "add_offset", 0.0)):
        of_channel = {item.get("sample", "0"): float(item.text) for item in said
                      if item.get("role") == role and item.text}
        values = {of_channel.get(str(channel), otherwise) for channel in range(page.samplesperpixel)}
        if len(values) > 1:
            raise io_error("source-format", where, f"channels of GDAL's {role} {sorted(values)}", "one for all",
                           "apply them: gdal_translate -unscale -ot Float32")
        found[name] = values.pop()
    missing = page.tags.valueof(_GDAL_NODATA)
    return ({} if found == _PLAIN else found) | ({"_FillValue": float(missing.strip("\0 "))} if missing else {})
