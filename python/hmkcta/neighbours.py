"""Scaling that datasets beside a dataset of HDF5 say: MINC 2, NeXus, and the weather radars' ODIM."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import HmkctaError, invalid
from .packing import Meant, Packing, Part, scaled_type, text_of
from .support.optional import library


def by_neighbours(dataset: Any) -> Meant | None:
    """An open dataset of h5py as the datasets and groups beside it have it; None: they say nothing.

    Raises:
        HmkctaError: reason ``source-scaling``: they contradict it, or what they say can be understood in two ways.
    """
    group, name = home(dataset)
    if group is None:
        return None
    return _minc(dataset, group, name) or _nexus(dataset, group, name) or _radar(dataset, group, name)


def home(dataset: Any) -> tuple[Any, str]:
    """The group in which an open dataset of h5py lies, and its name there, whatever links led to it.

    None for the group: it has no name, or none any more.
    """
    h5py, file, path = library("h5py", "h5py", "hdf5", "HDF5"), dataset.file, str(dataset.name)
    there = file.get(path) == dataset and isinstance(file.get(path, getlink=True), h5py.HardLink)
    if not there:  # it is called as the link is, perhaps one of another file
        path = (h5py.h5r.get_name(dataset.ref, file.id) or b"").decode("utf-8", "surrogateescape")
    folder, _, name = path.rpartition("/")
    return file[folder or "/"] if path else None, name


def _minc(dataset: Any, group: Any, own: str) -> Meant | None:
    """Integers of MINC 2: ``valid_range`` stands for the values from ``image-min`` to ``image-max``, slice by slice."""
    if own != "image" or dataset.dtype.kind not in "iu" or not {"image-min", "image-max"} <= set(group):
        return None
    least, most = (np.asarray(group[name][()], np.float64) for name in ("image-min", "image-max"))
    order = _words(dataset.attrs.get("dimorder"))[:least.ndim]
    named = all(_words(group[name].attrs.get("dimorder"))[:least.ndim] in ([], order)
                for name in ("image-min", "image-max"))
    ends = np.iinfo(dataset.dtype)
    low, high = np.resize(np.asarray(dataset.attrs.get("valid_range", (ends.min, ends.max)), np.float64), 2)
    if not (named and least.shape == most.shape == dataset.shape[:least.ndim] and ends.min <= low < high <= ends.max):
        raise _unclear(dataset, f"image-min and image-max of shapes {least.shape} and {most.shape}, valid_range "
                       f"{low:g} to {high:g}", "a range of the image's type for each index of its first axes")
    slope = (most - least) / (high - low)
    spread = (..., *[np.newaxis] * (len(dataset.shape) - least.ndim))

    def convert(values: NDArray[Any], part: Part) -> NDArray[Any]:
        place = part[:least.ndim]
        clipped = np.clip(values.astype(np.float64), low, high)
        return clipped * slope[place][spread] + (least - low * slope)[place][spread]

    return Meant(dataset, np.dtype(np.float64), convert)


def _nexus(dataset: Any, group: Any, own: str) -> Meant | None:
    """Fields of NXdata: ``(stored + NAME_offset) * NAME_scaling_factor``.

    The older names, of the group's signal, left it open which of the two comes first.
    """
    if text_of(group.attrs.get("NX_class")) != "NXdata":
        return None
    scale, offset = _number(group, f"{own}_scaling_factor", 1.0), _number(group, f"{own}_offset", 0.0)
    if own == (text_of(group.attrs.get("signal")) or "data") or "signal" in dataset.attrs:
        older = _number(group, "scaling_factor", 1.0), _number(group, "offset", 0.0)
        if older[1] and older[0] != 1:
            raise _unclear(dataset, "scaling_factor and offset of NeXus, of which either may come first",
                           f"{own}_scaling_factor and {own}_offset")
        scale, offset = scale * older[0], offset + older[1]
    return _linear(dataset, scale, scale * offset, [])


def _radar(dataset: Any, group: Any, own: str) -> Meant | None:
    """Measurements of weather radars: gain and offset in the group ``what``; neither measured nor detected is NaN."""
    if own != "data" or not text_of(dataset.file.attrs.get("Conventions")).startswith("ODIM_H5"):
        return None
    for holder in (group, group.parent):
        said: Any = holder["what"].attrs if "what" in holder else ()
        if "gain" in said:
            fills = [float(said[word]) for word in ("nodata", "undetect") if word in said]
            return _linear(dataset, float(said["gain"]), float(said.get("offset", 0.0)), fills)
    return None


def _linear(dataset: Any, scale: float, offset: float, fills: list[float]) -> Meant | None:
    if (scale, offset) == (1.0, 0.0) and not fills:
        return None
    kind = dataset.dtype
    packed = Packing(kind, scaled_type(kind), scale, offset, np.array(fills, np.float64))
    return Meant(dataset, packed.dtype, lambda values, _: packed(values))


def _number(group: Any, name: str, otherwise: float) -> float:
    """The one number of a dataset, or a value where there is none of this name."""
    if name not in group:
        return otherwise
    values = np.ravel(group[name][()])
    if values.size != 1 or values.dtype.kind not in "iuf":
        raise _unclear(group[name], f"{values.size} values of {values.dtype}", "one number")
    return float(values[0])


def _unclear(dataset: Any, found: str, allowed: str) -> HmkctaError:
    hint = "read it by the library of its format (nibabel for MINC, h5py for NeXus), and save it by numpy.save"
    return invalid("source-scaling", f"scaling of {dataset.name}", found, allowed, hint)


def _words(value: Any) -> list[str]:
    return [word.strip() for word in text_of(value).split(",") if word.strip()]
