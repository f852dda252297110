"""Names and coordinates that arrays of other libraries have, and arrays that keep theirs until they are compressed."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import prod
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from .axes import Axis, checked_coords, name_axes
from .conventions import meant, unapplied
from .errors import HmkctaError
from .packing import text_of
from .support.optional import library

#: Coordinates are kept where they take up to so many bytes, or this share of the array's as float32.
LEAST_BYTES, SHARE = 4096, 1000
#: What netCDF calls a dimension without coordinates.
NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"
_GIVE = 'Next: give numbers along an axis as Axis("x", size, coords=..), or by --coords'


@dataclass(frozen=True, eq=False)
class Labels:
    """What an array says of its own axes.

    Attributes:
        axes: one for each axis; None: it says nothing.
        notes: sentences on what it says and is not kept, for whoever compresses it.
    """

    axes: tuple[Axis, ...] | None = None
    notes: tuple[str, ...] = ()

    def named(self, shape: Sequence[int], given: Sequence[Axis | str] | None) -> tuple[Axis, ...]:
        """Axes by the names that are given, with own coordinates where it is a name alone; without any, its own axes.

        Raises:
            HmkctaError: what `name_axes` raises.
        """
        own = self.axes if self.axes is not None and tuple(axis.size for axis in self.axes) == tuple(shape) else None
        if not given:
            return name_axes(shape) if own is None else own
        axes = name_axes(shape, [axis.name if isinstance(axis, Axis) else axis for axis in given])
        if own is None:
            return axes
        return tuple(replace(axis, coords=each.coords, unit=each.unit) for axis, each in zip(axes, own, strict=True))


@dataclass(frozen=True, eq=False)
class _Dimension:
    """An axis as a library has it: its name, and a number for each index, if there are any."""

    name: str = ""
    coords: Any = None
    unit: str = ""


class LabelledArray(np.ndarray[Any, Any]):
    """An array that was opened with labels; nothing that is made of it has them."""

    hmkcta_labels: Labels | None = None


def labelled(array: NDArray[Any], labels: Labels) -> NDArray[Any]:
    """The array with labels, still a map if it was one.

    >>> labels_of(labelled(np.zeros((2, 3)), Labels(name_axes((2, 3), ["y", "x"])))).axes[0].name
    'y'
    """
    if labels.axes is None and not labels.notes:
        return array
    kept = array if isinstance(array, np.memmap) else array.view(LabelledArray)
    cast(Any, kept).hmkcta_labels = labels
    return kept


def named(array: NDArray[Any], names: tuple[str, ...]) -> NDArray[Any]:
    """The array with names of its axes, if they differ from each other.

    >>> [axis.name for axis in labels_of(named(np.zeros((2, 3)), ("y", "x"))).axes]
    ['y', 'x']
    """
    if len(names) != array.ndim or len(set(names)) < len(names):
        return array
    return labelled(array, Labels(name_axes(array.shape, names)))


def with_axes(array: NDArray[Any], axes: Sequence[Axis], notes: Sequence[str] = ()) -> NDArray[Any]:
    """The array with the axes that its file tells of, and sentences on what of it is not kept.

    Coordinates are left out, and that is said, where they are not finite, or take more of a file than they are worth.

    >>> array = with_axes(np.zeros((2, 3)), [Axis("light", 2, "light", [0, 30], "degrees"), Axis("x", 3, "space")])
    >>> [(axis.name, axis.unit) for axis in labels_of(array).axes]
    [('light', 'degrees'), ('x', '')]
    """
    return labelled(array, _kept(list(axes), [], notes))


def labels_of(array: Any) -> Labels:
    """Labels of an array of xarray, of an open dataset of h5py, Zarr or netCDF, of a `Model`, or of what `open_array`
    gave.
    """
    known = getattr(array, "hmkcta_labels", None)
    if isinstance(known, Labels):
        return known if known.axes is not None else replace(_own_labels(array), notes=known.notes)
    return _own_labels(array)


def _own_labels(array: Any) -> Labels:
    axes: Any = getattr(getattr(array, "metadata", None), "axes", None)
    if isinstance(axes, tuple) and all(isinstance(axis, Axis) for axis in cast("tuple[Any, ...]", axes)):
        return Labels(cast("tuple[Axis, ...]", axes))
    libraries = {base.__module__.partition(".")[0] for base in type(array).__mro__}
    if "h5py" in libraries and hasattr(array, "dims"):
        return _of_stored(array, [_scale(array, number) for number in range(len(array.shape))])
    if "zarr" in libraries and hasattr(array, "attrs"):
        return _of_stored(array, _zarr_dimensions(array))
    if isinstance(getattr(array, "dims", None), tuple):
        return _of_xarray(array)
    names: Any = getattr(array, "dimensions", None)  # of open variables of h5netcdf and netCDF4
    if not isinstance(names, tuple):
        return Labels()
    said = "coordinates of an open variable are not kept. Next: give its file to hmkcta.open_array, which keeps them"
    return _labels(np.shape(array), [_Dimension(str(name)) for name in cast("tuple[Any, ...]", names)], [], [said])


def _of_xarray(array: Any) -> Labels:
    coords: Mapping[Any, Any] = getattr(array, "coords", {})
    known: dict[Any, _Dimension] = {}
    for name, coord in coords.items():
        if tuple(coord.dims) == (name,):
            known[name] = _Dimension(str(name), *_as_numbers(coord.values, text_of(coord.attrs.get("units"))))
    dimensions = [known.get(name, _Dimension(str(name))) for name in array.dims]
    return _labels(np.shape(array), dimensions, [str(name) for name in coords if name not in known])


def _as_numbers(values: Any, unit: str) -> tuple[Any, str]:
    """Points in time and times as numbers; anything else as it is."""
    kind = values.dtype.kind
    if kind not in "mM":
        return values, unit
    zero = np.datetime64(0, "s") if kind == "M" else np.timedelta64(0, "s")
    return (values - zero) / np.timedelta64(1, "s"), "seconds since 1970-01-01" if kind == "M" else "seconds"


def _of_stored(array: Any, dimensions: Sequence[_Dimension]) -> Labels:
    names = {dimension.name for dimension in dimensions}
    others = [word for word in text_of(array.attrs.get("coordinates")).split() if word not in names]
    scaling = unapplied(array)
    said = [f"{' and '.join(scaling)} of the source are not applied: what is compressed are the numbers as stored. "
            "Next: multiply them yourself, if they are meant"] if scaling else []
    return _labels(array.shape, dimensions, others, said)


def _scale(dataset: Any, number: int) -> _Dimension:
    """The scale of an axis of HDF5, as netCDF-4 has it."""
    with suppress(KeyError, OSError, RuntimeError, ValueError):
        held = dataset.dims[number]
        if not len(held):
            return _Dimension(str(held.label))
        scale = held[0]
        name = str(scale.name or held.label).rpartition("/")[2]
        if text_of(scale.attrs.get("NAME")).startswith(NO_VARIABLE) or scale.shape != (dataset.shape[number],):
            return _Dimension(name)
        return _Dimension(name, np.asarray(meant(scale)), text_of(scale.attrs.get("units")))
    return _Dimension()


def _zarr_dimensions(array: Any) -> list[_Dimension]:
    """Dimensions as xarray writes them, each with an array of its name beside, if it has coordinates."""
    names: Any = getattr(array.metadata, "dimension_names", None) or array.attrs.get("_ARRAY_DIMENSIONS")
    if not isinstance(names, list | tuple) or len(cast("Sequence[Any]", names)) != len(array.shape):
        return [_Dimension()] * len(array.shape)
    return [_beside(array, name, size) for name, size in zip(cast("Sequence[Any]", names), array.shape, strict=True)]


def _beside(array: Any, name: Any, size: int) -> _Dimension:
    zarr = library("zarr", "zarr", "zarr", "Zarr")
    folder, _, own = str(array.path).rpartition("/")
    if not isinstance(name, str) or not name or name == own:
        return _Dimension(str(name or ""))
    try:
        beside = zarr.open_array(array.store, path=f"{folder}/{name}".lstrip("/"), mode="r")
        if beside.shape == (size,):
            return _Dimension(name, np.asarray(meant(beside)[:]), text_of(beside.attrs.get("units")))
    except Exception:  # there is none, or what there is cannot be read: whatever the store or a codec raises
        return _Dimension(name)
    return _Dimension(name)


def _labels(shape: Sequence[int], dimensions: Sequence[_Dimension], others: Iterable[str],
            said: Sequence[str] = ()) -> Labels:
    """Axes of dimensions with the coordinates that a file can keep, and sentences on the others."""
    words = ["_".join(re.findall(r"[^+, /=:]+", dimension.name)) for dimension in dimensions]
    if not (all(words) and len(set(words)) == len(words) and "".join(words).isprintable()):
        words = [f"axis{number}" for number in range(len(words))]
    axes = [replace(axis, coords=dimension.coords, unit=dimension.unit if dimension.coords is not None else "")
            for axis, dimension in zip(name_axes(shape, words) if words else (), dimensions, strict=True)]
    plain = all(not dimension.name and dimension.coords is None for dimension in dimensions)
    kept = _kept(axes, [*others], said)
    return replace(kept, axes=None) if plain else kept


def _kept(axes: list[Axis], others: list[str], said: Sequence[str]) -> Labels:
    """Axes with the coordinates that a file can keep, and sentences on those that it cannot, and on `others`."""
    notes = [*said]
    for number, axis in enumerate(axes):
        if axis.coords is None:
            continue
        try:
            axes[number] = checked_coords(replace(axis, coords=_exact(axis.coords)))
        except (HmkctaError, TypeError):
            others.append(axis.name)
            axes[number] = replace(axis, coords=None, unit="")
    size = sum(8 * np.size(axis.coords) for axis in axes if axis.coords is not None)
    if size > max(LEAST_BYTES, 4 * prod(axis.size for axis in axes) // SHARE):
        notes.append(f"coordinates of {', '.join(axis.name for axis in axes if axis.coords is not None)} are not kept: "
                     f"they would take {size} bytes of the file. {_GIVE}")
        axes = [replace(axis, coords=None, unit="") for axis in axes]
    if others:
        notes.append(f"coordinates {', '.join(others)} are not kept: they are not a finite number for each index of an "
                     f"axis. {_GIVE}")
    return Labels(tuple(axes), tuple(notes))


def _exact(values: Any) -> NDArray[Any]:
    """Numbers that float64 holds, in which a file keeps coordinates."""
    numbers = np.asarray(values)
    if numbers.dtype.kind in "iu" and (numbers.astype(np.float64).astype(numbers.dtype) != numbers).any():
        raise TypeError("float64 has fewer digits")
    return numbers
