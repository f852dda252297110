"""Metadata to and from the JSON object of the file (`docs/format.md`, section 5): every field, type and range.

Coordinates of more than `INLINE_COORDS` numbers, or of many digits, are arrays of the file, named in the JSON.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import MOST_COORDS, ROLES, Axis, Organisation, check_organisation, mode_sizes
from ..errors import HmkctaError
from ..packed import LevelBounds, LevelQuality, Metadata
from ..plan import SCHEMES
from ..transform import TRANSFORMS
from .fields import SAFE_INTEGER, Json, as_integer, as_list, as_map, as_number, as_object, as_text, check_sizes
from .header import ITEM_SIZES, parse_shape
from .limits import Limits, check_limit
from .reasons import fault
from .schema import NUMBER_TYPES, SHORT, TYPE_NAMES, ArrayInfo, version_of
from .stored import Stored

#: The newest version that is read and written.
VERSION = list(NUMBER_TYPES)[-1]
KINDS = ("svbrdf", "lightfield", "volume", "generic")
SOURCE_DTYPES = ("bool", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64",
                 "float16", "float32", "float64")

#: More coordinates than this are stored as an array, which takes about so many bytes of header.
INLINE_COORDS, ARRAY_HEADER = 64, 160

_MAX_U32 = 2**32 - 1
_FIELDS = ("version", "source_dtype", "axes", "organisation", "levels", "undecomposed", "kind", "transform", "quality",
           "source", "writer", "seed", "arrays")


@dataclass(frozen=True)
class ArrayRecord:
    """What the metadata says of an array: CRC-32 of its bytes, and number type and shape up to version 1.1."""

    crc32: int
    info: ArrayInfo | None = None


@dataclass(frozen=True, eq=False)
class Parsed:
    """Metadata as parsed: coordinates that are arrays are still missing from the axes, `coords` names them."""

    metadata: Metadata
    version: str
    arrays: dict[str, ArrayRecord]
    coords: dict[int, str]

    def resolve(self, arrays: Mapping[str, NDArray[Any]]) -> Metadata:
        """The metadata with the named coordinate arrays put into its axes."""
        axes = list(self.metadata.axes)
        for n, name in self.coords.items():
            axes[n] = replace(axes[n], coords=arrays[name])
        return replace(self.metadata, axes=tuple(axes))


def coords_name(axis: Axis) -> str | None:
    """Name of the array that holds an axis's coordinates; None where they are inline, few and short, or absent."""
    if axis.coords is None:
        return None
    short = axis.coords.size <= INLINE_COORDS and _digits(axis) <= coords_array(axis).nbytes + ARRAY_HEADER
    return None if short else f"coords/{axis.name}"


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


def coords_info(axis: Axis) -> ArrayInfo:
    """Number type and shape of the array that holds an axis's coordinates."""
    coords = coords_array(axis)
    return ArrayInfo(TYPE_NAMES[coords.dtype], coords.shape)


def to_json(metadata: Metadata, arrays: Mapping[str, ArrayRecord]) -> dict[str, Any]:
    """The JSON object of the metadata and of the records of a file's arrays, which have infos here."""
    version = version_of({name: record.info for name, record in arrays.items() if record.info})
    return {
        "version": version, "source_dtype": metadata.source_dtype,
        "axes": [axis_to_json(axis) for axis in metadata.axes],
        "organisation": [list(mode) for mode in metadata.organisation],
        "levels": [{"C": _integers(level.clusters), "K": _integers(level.mixture), "R": _integers(level.ranks),
                    "scheme": level.scheme} for level in metadata.stages],
        "undecomposed": _integers(getattr(metadata, "undecomposed", ())), "kind": metadata.kind,
        "transform": metadata.transform,
        "quality": [_quality_to_json(quality) for quality in metadata.quality],
        "source": metadata.source, "writer": metadata.writer, "seed": int(metadata.seed),
        "arrays": {name: _record_to_json(record, version) for name, record in arrays.items()},
    }


def _record_to_json(record: ArrayRecord, version: str) -> Any:
    if record.info is None or version in SHORT:
        return record.crc32
    return {"dtype": record.info.dtype, "shape": list(record.info.shape), "crc32": record.crc32}


def _integers(values: Iterable[int]) -> list[int]:
    """Plain numbers: NumPy's own are unknown to JSON."""
    return [int(value) for value in values]


def axis_to_json(axis: Axis) -> dict[str, Any]:
    """The axis as the metadata holds it; long coordinates are an array of their own, named there."""
    coords = coords_name(axis)
    inline = None if axis.coords is None or coords else _inline_coords(axis)
    return {"name": axis.name, "size": int(axis.size), "role": axis.role, "coords": coords or inline, "unit": axis.unit}


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


def from_json(value: Json, limits: Limits) -> Parsed:
    """Check the JSON object of a file and return what it says."""
    root = "hmkcta"
    check_sizes(value, root, limits)
    version = as_map(value, root).get("version")
    if isinstance(version, str) and version not in NUMBER_TYPES:
        raise fault("version-unknown", f"{root}.version", repr(version), " or ".join(NUMBER_TYPES), "update hmkcta")
    fields = as_object(value, root, _FIELDS)
    version = as_text(fields["version"], f"{root}.version")
    axes, coords = _parse_axes(fields["axes"], f"{root}.axes", limits)
    organisation = _parse_organisation(fields["organisation"], f"{root}.organisation", axes, limits)
    sizes = mode_sizes(axes, organisation)
    undecomposed = _parse_undecomposed(fields["undecomposed"], f"{root}.undecomposed", len(sizes))
    levels = _parse_levels(fields["levels"], f"{root}.levels", sizes, undecomposed, limits)
    metadata = Stored(
        as_text(fields["source_dtype"], f"{root}.source_dtype", SOURCE_DTYPES), axes, organisation, levels,
        as_text(fields["kind"], f"{root}.kind", KINDS),
        _parse_transform(fields["transform"], f"{root}.transform"),
        _parse_quality(fields["quality"], f"{root}.quality", len(levels)),
        as_map(fields["source"], f"{root}.source"), as_text(fields["writer"], f"{root}.writer"),
        as_integer(fields["seed"], f"{root}.seed"), undecomposed,
    )
    return Parsed(metadata, version, _parse_arrays(fields["arrays"], f"{root}.arrays", version), coords)


def _parse_axes(value: Json, where: str, limits: Limits) -> tuple[tuple[Axis, ...], dict[int, str]]:
    items = as_list(value, where)
    check_limit("axes-limit", where, len(items), limits.axes)
    axes: list[Axis] = []
    named: dict[int, str] = {}
    for n, item in enumerate(items):
        path = f"{where}[{n}]"
        fields = as_object(item, path, ("name", "size", "role", "coords", "unit"))
        name, size = as_text(fields["name"], f"{path}.name"), as_integer(fields["size"], f"{path}.size", 1, _MAX_U32)
        role, unit = as_text(fields["role"], f"{path}.role", ROLES), as_text(fields["unit"], f"{path}.unit")
        coords = fields["coords"]
        if isinstance(coords, str):
            named[n] = as_text(coords, f"{path}.coords", (f"coords/{name}",))
            coords = None
        try:
            axes.append(Axis(name, size, role, _parse_coords(coords, f"{path}.coords", size), unit))
        except HmkctaError as error:
            if error.reason != "bad-axis-name":
                raise
            raise fault("field-value", f"{path}.name", error.found, error.allowed) from error
        if name in {axis.name for axis in axes[:-1]}:
            raise fault("field-value", f"{path}.name", repr(name), "names that differ")
    check_limit("elements-limit", where, prod(axis.size for axis in axes), limits.elements)
    return tuple(axes), named


def _parse_coords(value: Json, where: str, size: int) -> NDArray[np.float64] | None:
    """Inline coordinates: a list of numbers, or of equally long lists of numbers, one an index."""
    if value is None:
        return None
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
    organisation = tuple(tuple(as_text(name, f"{where}[{n}]") for name in as_list(mode, f"{where}[{n}]"))
                         for n, mode in enumerate(modes))
    if not organisation or not all(organisation):
        raise fault("field-value", where, "a mode without axes" if organisation else "no modes", "axes in each mode")
    try:
        return check_organisation(organisation, axes)
    except HmkctaError as error:
        raise fault("organisation", where, error.found, error.allowed) from error


def _parse_undecomposed(value: Json, where: str, order: int) -> tuple[int, ...]:
    modes = tuple(as_integer(mode, where, 0, order - 1) for mode in as_list(value, where))
    if list(modes) != sorted(set(modes)):
        raise fault("field-value", where, list(modes), "mode numbers that differ, ascending")
    return modes


def _parse_levels(value: Json, where: str, sizes: tuple[int, ...], undecomposed: tuple[int, ...], limits: Limits
                  ) -> tuple[LevelBounds, ...]:
    items = as_list(value, where)
    if not items:
        raise fault("field-value", where, "no levels", "1 level and more")
    check_limit("levels-limit", where, len(items), limits.levels)
    levels: list[LevelBounds] = []
    for n, item in enumerate(items):
        path = f"{where}[{n}]"
        fields = as_object(item, path, ("C", "K", "R", "scheme"))
        clusters, mixture, ranks = (tuple(as_integer(number, f"{path}.{key}") for number
                                          in as_list(fields[key], f"{path}.{key}", len(sizes))) for key in "CKR")
        scheme = as_text(fields["scheme"], f"{path}.scheme", SCHEMES)
        levels.append(LevelBounds(clusters, mixture, ranks, scheme))
        _check_bounds(levels[-1], path, sizes, undecomposed, limits)
    return tuple(levels)


def _check_bounds(bounds: LevelBounds, where: str, sizes: tuple[int, ...], undecomposed: tuple[int, ...],
                  limits: Limits) -> None:
    """Limits of a level; the arrays are held against these bounds later."""
    cost = 1
    for n, size in enumerate(sizes):
        check_limit("clusters-limit", f"{where}.C", bounds.clusters[n], limits.clusters)
        check_limit("mixture-limit", f"{where}.K", bounds.mixture[n], limits.mixture)
        check_limit("rank-limit", f"{where}.R", bounds.ranks[n], size if n in undecomposed else limits.rank)
        cost *= 1 if n in undecomposed else bounds.mixture[n] * bounds.ranks[n]
    check_limit("level-cost-limit", where, cost, limits.level_cost)


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


def _parse_arrays(value: Json, where: str, version: str) -> dict[str, ArrayRecord]:
    records: dict[str, ArrayRecord] = {}
    for name, item in as_map(value, where).items():
        path = f"{where}.{name}"
        if version in SHORT:
            records[name] = ArrayRecord(as_integer(item, path, 0, _MAX_U32))
            continue
        fields = as_object(item, path, ("dtype", "shape", "crc32"))
        info = ArrayInfo(as_text(fields["dtype"], f"{path}.dtype", ITEM_SIZES),
                         parse_shape(fields["shape"], f"{path}.shape"))
        records[name] = ArrayRecord(as_integer(fields["crc32"], f"{path}.crc32", 0, _MAX_U32), info)
    return records
