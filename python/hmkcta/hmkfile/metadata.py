"""The header to and from JSON (`docs/format.md`): every field, type and range.

Coordinates of more than `INLINE_COORDS` numbers, or of many digits, are sections of the file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import MOST_COORDS, ROLES, Axis, Organisation, check_organisation, mode_sizes
from ..errors import HmkctaError
from ..packed import LevelQuality, Metadata
from ..transform import TRANSFORMS
from .fields import SAFE_INTEGER, Json, as_integer, as_list, as_map, as_number, as_object, as_text, check_sizes
from .limits import Limits, check_limit
from .reasons import fault
from .stages import MAX_U32, Stage, parse_stages, stage_to_json

KINDS = ("svbrdf", "lightfield", "volume", "generic")
SOURCE_DTYPES = ("bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64",
                 "float16", "float32", "float64")

#: More coordinates than this have a section, which takes this many bytes besides its numbers.
INLINE_COORDS, SECTION_BYTES = 64, 32

_DTYPES = {"F32": "<f4", "F64": "<f8"}
_FIELDS = ("axes", "organisation", "dtype", "stages", "quality")
_OPTIONAL = ("kind", "transform", "source", "writer", "seed")


@dataclass(frozen=True)
class CoordSection:
    """Coordinates of the axis of this number that are a section: number type, and numbers an index (0: plain ones)."""

    axis: int
    dtype: str
    width: int
    size: int

    @property
    def name(self) -> str:
        """What the section is called in errors."""
        return f"axes[{self.axis}].coordinates"

    @property
    def length(self) -> int:
        """Bytes of its numbers."""
        return self.size * max(1, self.width) * np.dtype(_DTYPES[self.dtype]).itemsize

    def numbers(self, data: memoryview) -> NDArray[Any]:
        """The coordinates, which must be finite."""
        flat = np.frombuffer(data, _DTYPES[self.dtype]).copy()  # of which no file is needed
        if not np.isfinite(flat).all():
            at = int(np.argmin(np.isfinite(flat)))
            raise fault("not-finite", self.name, f"{flat[at]} at {at}", "finite numbers")
        return flat.reshape(self.size, self.width) if self.width else flat


@dataclass(frozen=True, eq=False)
class Parsed:
    """A header as parsed: coordinates that are sections are still missing from the axes."""

    metadata: Metadata
    stages: tuple[Stage, ...]
    coords: tuple[CoordSection, ...]

    def resolve(self, arrays: Mapping[int, NDArray[Any]]) -> Metadata:
        """The metadata with the coordinates of axes of these numbers."""
        axes = tuple(replace(axis, coords=arrays.get(n, axis.coords)) for n, axis in enumerate(self.metadata.axes))
        return replace(self.metadata, axes=axes)


def is_section(axis: Axis) -> bool:
    """Whether an axis's coordinates are a section, not inline: they are if they are many, or take more digits."""
    if axis.coords is None:
        return False
    return axis.coords.size > INLINE_COORDS or _digits(axis) > coords_array(axis).nbytes + SECTION_BYTES


def _digits(axis: Axis) -> int:
    """Characters that inline coordinates take."""
    return len(str(_inline_coords(axis)).replace(" ", ""))


def coords_array(axis: Axis) -> NDArray[Any]:
    """The coordinates as the file stores them: float32 if that changes none of them, else float64."""
    coords = np.asarray(axis.coords)
    if coords.dtype.kind not in "iufb":
        raise fault("field-type", f"coords of axis {axis.name!r}", coords.dtype, "numbers")
    wide = np.ascontiguousarray(coords, "<f8")
    with np.errstate(over="ignore"):
        narrow = wide.astype("<f4")
    return narrow if np.array_equal(narrow, wide) else wide


def to_json(metadata: Metadata, stages: Sequence[Stage]) -> dict[str, Any]:
    """The header's object; what has its default is absent."""
    numbers = {axis.name: n for n, axis in enumerate(metadata.axes)}
    given = {"kind": metadata.kind, "transform": metadata.transform, "source": metadata.source,
             "writer": metadata.writer, "seed": int(metadata.seed)}
    absent = {"kind": "generic", "transform": {"name": "identity"}, "source": {}, "writer": "", "seed": 0}
    kept = {name: value for name, value in given.items() if value != absent[name]}
    return {
        "axes": [axis_to_json(axis) for axis in metadata.axes],
        "organisation": [[numbers[name] for name in mode] for mode in metadata.organisation],
        "dtype": metadata.source_dtype,
        "stages": [stage_to_json(stage) for stage in stages],
        "quality": [_quality_to_json(quality) for quality in metadata.quality],
        **kept,
    }


def axis_to_json(axis: Axis) -> dict[str, Any]:
    """The axis as the header holds it."""
    coords: dict[str, Any] = {}
    if is_section(axis):
        array = coords_array(axis)
        coords = {"coordinates": {"dtype": "F32" if array.dtype.itemsize == 4 else "F64",
                                  "width": array.shape[1] if array.ndim > 1 else 0}}
    elif axis.coords is not None:
        coords = {"coordinates": _inline_coords(axis)}
    role = {} if axis.role == "other" else {"role": axis.role}
    return {"name": axis.name, "size": int(axis.size), **role, **({"unit": axis.unit} if axis.unit else {}), **coords}


def _inline_coords(axis: Axis) -> list[Any]:
    """Coordinates in no more digits than they need: of float32, those that tell its numbers apart."""
    stored, given = coords_array(axis), np.asarray(axis.coords)
    single = given.dtype == np.float32
    numbers = [float(str(value)) if single else float(value) for value in given.reshape(-1)]
    shortest = [int(value) if value.is_integer() and abs(value) <= SAFE_INTEGER else value for value in numbers]
    return np.array(shortest, object).reshape(stored.shape).tolist()


def _quality_to_json(quality: LevelQuality) -> dict[str, Any]:
    """An exact reconstruction has an infinite SNR, which JSON cannot hold: null stands for it."""
    snr = None if quality.snr_db == math.inf else float(quality.snr_db)
    return {"snr_db": snr, "rmse": float(quality.rmse), "max_abs_error": float(quality.max_abs_error)}


def from_json(value: Json, size: int, limits: Limits) -> Parsed:
    """Check the header's object of a file of `size` bytes and return what it says."""
    root = "header"
    check_sizes(value, root, limits)
    fields = as_object(value, root, _FIELDS, _OPTIONAL)
    axes, coords = _parse_axes(fields["axes"], f"{root}.axes", limits)
    organisation = _parse_organisation(fields["organisation"], f"{root}.organisation", axes, limits)
    dtype = as_text(fields["dtype"], f"{root}.dtype", SOURCE_DTYPES)
    kind = as_text(fields.get("kind", "generic"), f"{root}.kind", KINDS)
    transform = _parse_transform(fields.get("transform", {"name": "identity"}), f"{root}.transform")
    stages = parse_stages(fields["stages"], f"{root}.stages", mode_sizes(axes, organisation), size, limits)
    levels = sum(not stage.bounds.is_cut for stage in stages)
    metadata = Metadata(
        dtype, axes, organisation, tuple(stage.bounds for stage in stages), kind, transform,
        _parse_quality(fields["quality"], f"{root}.quality", levels),
        as_map(fields.get("source", {}), f"{root}.source"), as_text(fields.get("writer", ""), f"{root}.writer"),
        as_integer(fields.get("seed", 0), f"{root}.seed"),
    )
    return Parsed(metadata, stages, coords)


def _parse_axes(value: Json, where: str, limits: Limits) -> tuple[tuple[Axis, ...], tuple[CoordSection, ...]]:
    items = as_list(value, where)
    check_limit("axes-limit", where, len(items), limits.axes)
    axes: list[Axis] = []
    sections: list[CoordSection] = []
    for n, item in enumerate(items):
        path = f"{where}[{n}]"
        fields = as_object(item, path, ("name", "size"), ("role", "unit", "coordinates"))
        name, size = as_text(fields["name"], f"{path}.name"), as_integer(fields["size"], f"{path}.size", 1, MAX_U32)
        role = as_text(fields.get("role", "other"), f"{path}.role", ROLES)
        unit, given, coords = as_text(fields.get("unit", ""), f"{path}.unit"), fields.get("coordinates"), None
        if isinstance(given, dict):
            sections.append(_parse_section(given, f"{path}.coordinates", n, size))
        elif "coordinates" in fields:
            coords = _parse_coords(given, f"{path}.coordinates", size)
        axes.append(_axis(name, size, role, coords, unit, path))
        if name in {axis.name for axis in axes[:-1]}:
            raise fault("field-value", f"{path}.name", repr(name), "names that differ")
    check_limit("elements-limit", where, prod(axis.size for axis in axes), limits.elements)
    return tuple(axes), tuple(sections)


def _axis(name: str, size: int, role: str, coords: NDArray[Any] | None, unit: str, path: str) -> Axis:
    try:
        return Axis(name, size, role, coords, unit)
    except HmkctaError as error:
        if error.reason != "bad-axis-name":
            raise
        raise fault("field-value", f"{path}.name", error.found, error.allowed) from error


def _parse_section(value: Json, where: str, axis: int, size: int) -> CoordSection:
    fields = as_object(value, where, ("dtype", "width"))
    dtype = as_text(fields["dtype"], f"{where}.dtype", _DTYPES)
    return CoordSection(axis, dtype, as_integer(fields["width"], f"{where}.width", 0, MOST_COORDS), size)


def _parse_coords(value: Json, where: str, size: int) -> NDArray[np.float64]:
    """Inline coordinates: a list of numbers, or of equally long lists of numbers, one an index."""
    items = as_list(value, where, size)
    width = len(items[0]) if isinstance(items[0], list) else None
    if width is None:
        return np.array([as_number(item, f"{where}[{n}]") for n, item in enumerate(items)])
    if not 1 <= width <= MOST_COORDS:
        raise fault("field-value", where, f"{width} numbers an index", f"1 to {MOST_COORDS}")
    return np.array([[as_number(number, f"{where}[{n}]") for number in as_list(item, f"{where}[{n}]", width)]
                     for n, item in enumerate(items)])


def _parse_organisation(value: Json, where: str, axes: tuple[Axis, ...], limits: Limits) -> Organisation:
    modes = as_list(value, where)
    check_limit("order-limit", where, len(modes), limits.order)
    numbers = [[as_integer(axis, f"{where}[{n}]") for axis in as_list(mode, f"{where}[{n}]")]
               for n, mode in enumerate(modes)]
    if not numbers or not all(numbers):
        raise fault("field-value", where, "a mode without axes" if numbers else "no modes", "axes in each mode")
    if sorted(axis for mode in numbers for axis in mode) != list(range(len(axes))):
        raise fault("organisation", where, numbers, f"each of 0 to {len(axes) - 1} exactly once")
    organisation = tuple(tuple(axes[axis].name for axis in mode) for mode in numbers)
    return check_organisation(organisation, axes)


def _parse_transform(value: Json, where: str) -> dict[str, Any]:
    name = as_map(value, where).get("name")
    if isinstance(name, str) and name not in TRANSFORMS:
        raise fault("transform-unknown", f"{where}.name", repr(name), ", ".join(TRANSFORMS), "update hmkcta")
    fields = as_object(value, where, ("name", *TRANSFORMS[name])) if isinstance(name, str) else as_object(
        value, where, ("name",))
    as_text(fields["name"], f"{where}.name")
    found: dict[str, Any] = {key: item if key == "name" else as_number(item, f"{where}.{key}")
                             for key, item in fields.items()}
    if "scale" in found and found["scale"] <= 0:
        raise fault("field-value", f"{where}.scale", found["scale"], "a number above 0")
    return found


def _parse_quality(value: Json, where: str, levels: int) -> tuple[LevelQuality, ...]:
    result: list[LevelQuality] = []
    for n, item in enumerate(as_list(value, where, levels)):
        path = f"{where}[{n}]"
        fields = as_object(item, path, ("snr_db", "rmse", "max_abs_error"))
        rmse, largest = (as_number(fields[key], f"{path}.{key}", 0.0) for key in ("rmse", "max_abs_error"))
        exact = fields["snr_db"] is None
        if exact != (rmse == largest == 0.0):
            raise fault("field-value", f"{path}.snr_db", "null" if exact else fields["snr_db"],
                        "null if and only if both errors are 0")
        snr = math.inf if exact else as_number(fields["snr_db"], f"{path}.snr_db")
        result.append(LevelQuality(snr, rmse, largest))
    return tuple(result)
