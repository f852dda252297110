"""What the numbers of an open dataset mean: attributes and neighbours by which a laboratory's format scales them."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from .neighbours import by_neighbours
from .packing import Meant, packing, text_of, zarr_attributes
from .support.slabs import slabs

#: Libraries whose arrays give numbers as they are stored, with the attributes beside them. Others apply them (netCDF4)
#: or take them off when they do (xarray).
STORING = ("h5py", "h5netcdf", "zarr")
#: Elements that are unpacked at once.
SLAB = 1 << 22
#: Names of attributes by which some format or other scales, as letters alone, and the value that changes nothing.
_NEUTRAL = {
    **dict.fromkeys(("scale", "scales", "scalefactor", "scalingfactor", "slope", "gain", "rescaleslope", "sclslope",
                     "radiancescales", "reflectancescales", "calibrationfactor", "multiplier"), 1.0),
    **dict.fromkeys(("offset", "offsets", "addoffset", "intercept", "rescaleintercept", "sclinter", "radianceoffsets",
                     "reflectanceoffsets"), 0.0),
}


def conversion(dataset: Any) -> Meant | None:
    """A dataset of h5py, h5netcdf or Zarr as it is meant; None: it is stored as it is meant.

    Raises:
        HmkctaError: its format scales it in a way that is not known well enough.
    """
    is_zarr, dtype = "zarr" in _libraries(dataset), np.dtype(dataset.dtype)
    packed = packing(zarr_attributes(dataset) if is_zarr else dataset.attrs, dtype)
    scaled = by_neighbours(dataset) if "h5py" in _libraries(dataset) and dtype.kind in "iuf" else None
    if scaled is not None or packed is None:
        return scaled
    return Meant(dataset, packed.dtype, lambda values, _: packed(values))


def unapplied(dataset: Any) -> list[str]:
    """Names of attributes that look like a scaling which `conversion` does not apply.

    >>> class Dataset:
    ...     attrs = {"ScaleFactor": 0.1, "Offset": 0.0, "scale_factor": 2.0, "units": "K"}
    >>> unapplied(Dataset())
    ['ScaleFactor']
    """
    def counts(name: str, value: Any) -> bool:
        neutral = _NEUTRAL.get(re.sub(r"[^a-z]", "", name.lower()))
        values = np.ravel(value if value is not None else [])
        if neutral is None or not values.size:
            return False
        if values.dtype.kind not in "iuf":  # a number as text is what `packing` passes over
            return _as_number(text_of(value), neutral) != neutral
        return not (values == neutral).all() and (name not in ("scale_factor", "add_offset") or values.size != 1)

    return sorted(str(name) for name, value in dict(dataset.attrs).items() if counts(str(name), value))


def _as_number(text: str, otherwise: float) -> float:
    try:
        return float(text)
    except ValueError:
        return otherwise


def meant(array: Any) -> Any:
    """What the numbers of an open dataset of h5py, h5netcdf or Zarr mean, as `open_array` has it.

    Anything else is returned as it is, and so is what has no such attributes.

    >>> meant([1, 2])
    [1, 2]
    """
    if not is_stored(array):
        return array
    view = conversion(array)
    if view is None:
        return array
    values = np.empty(view.shape, view.dtype)
    for part in slabs(view.shape, SLAB):  # so that what is stored is never in memory beside all that it means
        whole = (*part, *[slice(None)] * (values.ndim - len(part)))
        values[part] = view[whole]
    return values


def is_stored(array: Any) -> bool:
    """Whether it is an open dataset of a library that leaves attributes to be applied."""
    known = not _libraries(array).isdisjoint(STORING)
    return known and all(hasattr(array, name) for name in ("attrs", "dtype", "shape"))


def _libraries(array: Any) -> set[str]:
    return {base.__module__.partition(".")[0] for base in type(array).__mro__}
