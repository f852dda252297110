"""Write a packed model: the same bytes for the same model, and never half a file at the target path."""

from __future__ import annotations

import hashlib
import os
import zlib
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from math import prod
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError, Kind, invalid
from ..narrow import BASIS_NUMBERS, CORE_NUMBERS, widened
from ..packed import Metadata, PackedLevel
from ..plan import SCHEMES
from .check import check_levels
from .header import ITEM_SIZES, TEXT_KEY, format_header, format_json
from .limits import DEFAULT_LIMITS, Limits
from .metadata import ArrayRecord, coords_array, coords_name, to_json
from .publish import check_output, published
from .read import loads
from .reasons import fault
from .schema import (
    LEVEL_TYPES,
    NUMPY_TYPES,
    TYPE_NAMES,
    WHOLE,
    ArrayInfo,
    check_schema,
    file_order,
    in_file_order,
    prefix,
)
from .short import shortened
from .stored import level_parts, to_stored
from .tables import check_entries

Piece: TypeAlias = bytes | memoryview

#: A checksum with the most digits, and a figure as long as any of six decimals, or of seven digits and an exponent.
_WIDEST_CRC, _WIDEST_FIGURE = 2**32 - 1, -1234.567891


def encode(metadata: Metadata, levels: Sequence[PackedLevel]) -> list[Piece]:
    """The bytes of the file, in pieces that share the memory of the model's arrays. `save` also checks the model.

    Raises:
        HmkctaError: `InvalidArgument` where the model holds something that has no place in a file at all.
    """
    with _as_invalid_argument():
        metadata, levels = to_stored(metadata, levels)
        coords = _coords(metadata)
        _check_types(levels)
        if _is_short(levels):
            _check_whole(metadata, levels, coords)
        infos = _infos(levels, coords, short=_is_short(levels))
        arrays = _arrays(levels, coords, short=_is_short(levels))
        _check_bytes(arrays, levels)
        pieces = [_bytes_of(array, infos[name].dtype) for name, array in arrays.items()]
        records = {name: ArrayRecord(zlib.crc32(piece), infos[name])
                   for name, piece in zip(arrays, pieces, strict=True)}
        text = _metadata_text(metadata, records)
        header = format_header(
            infos, text, hashlib.sha256(text.encode()).hexdigest(), least=header_size(metadata, infos)
        )
    return [header, *pieces]


def encoded_size(metadata: Metadata, levels: Sequence[PackedLevel]) -> int:
    """Exact number of bytes of the file that `save` writes; neither checksums nor quality change it."""
    with _as_invalid_argument():
        metadata, levels = to_stored(metadata, levels)
        _check_types(levels)
        return file_size(metadata, _infos(levels, _coords(metadata), short=_is_short(levels)))


def level_sizes(levels: Sequence[PackedLevel]) -> list[int]:
    """Bytes of each level's arrays in the file of all of them."""
    levels = level_parts(levels)
    sizes = [0] * len(levels)
    for name, (dtype, shape) in _infos(levels, {}, short=_is_short(levels)).items():
        sizes[int(name.split("/")[1]) - 1] += prod(shape) * ITEM_SIZES[dtype]
    return sizes


def file_size(metadata: Metadata, arrays: Mapping[str, ArrayInfo]) -> int:
    """Bytes of a file with these arrays, known before their values and the figures of quality are."""
    numbers = sum(prod(shape) * ITEM_SIZES[dtype] for dtype, shape in arrays.values())
    return header_size(metadata, in_file_order(arrays)) + numbers


def header_size(metadata: Metadata, arrays: Mapping[str, ArrayInfo]) -> int:
    """Bytes of the header, where all that is known only after a fit (checksums, figures of quality, subdivision) takes
    the most room it usually may."""
    records = {name: ArrayRecord(_WIDEST_CRC, info) for name, info in arrays.items()}
    text = _metadata_text(metadata, records, widest=True)
    return len(format_header(arrays, text, "0" * 64))


def _widest(value: Any) -> Any:
    """A JSON value, its measured figures (null is one) replaced by texts as wide as such figures come."""
    if isinstance(value, Mapping):
        return {key: _widest(item) for key, item in cast("Mapping[str, Any]", value).items()}
    if isinstance(value, list | tuple):
        return [_widest(item) for item in cast("Sequence[Any]", value)]
    if value is None or isinstance(value, float):
        return value if len(repr(value)) > len(repr(_WIDEST_FIGURE)) else _WIDEST_FIGURE
    return value


def save(path: str | os.PathLike[str], metadata: Metadata, levels: Sequence[PackedLevel], *, overwrite: bool = False,
         limits: Limits = DEFAULT_LIMITS) -> int:
    """Check the model and write it, atomically; return the number of bytes.

    Raises:
        HmkctaError: `InvalidArgument` with a reader's reason code if the model is not valid, `ResourceLimit` if it is
            beyond the limits, `Io` if the output is there already (``output-exists``), the disk is full
            (``disk-full``) or the folder cannot be written to (``unwritable``). The target is then as it was.
    """
    check_output(path, overwrite)
    data = b"".join(encode(metadata, levels))
    with _as_invalid_argument():
        loads(data, verify=False, limits=limits)  # no file is written that the reader would refuse
    with published(path, overwrite) as file:
        file.write(data)
    return len(data)


@contextmanager
def _as_invalid_argument() -> Generator[None]:
    """Turn a reader's verdict on the file into one on the writer's arguments; limits stay limits."""
    try:
        yield
    except HmkctaError as error:
        if error.kind is Kind.RESOURCE_LIMIT:
            hint = "stay within it, as readers refuse more"
            raise HmkctaError(
                error.kind, error.reason, error.where, found=error.found, allowed=error.allowed, hint=hint
            ) from error
        raise invalid(error.reason, error.where, error.found, error.allowed, error.hint) from error


def _metadata_text(metadata: Metadata, records: dict[str, ArrayRecord], *, widest: bool = False) -> str:
    try:
        described = to_json(metadata, records)
        if widest:
            described |= {field: _widest(described[field]) for field in ("quality", "source")}
            described["levels"] = [{**level, "scheme": max(SCHEMES, key=len)} for level in described["levels"]]
        text = format_json(described)
        text.encode()
        return text
    except (TypeError, ValueError, RecursionError) as error:
        raise fault("field-type", TEXT_KEY, error, "strings, finite numbers, lists and objects") from error


def _coords(metadata: Metadata) -> dict[str, NDArray[Any]]:
    """The coordinates that are arrays."""
    return {name: coords_array(axis) for axis in metadata.axes if (name := coords_name(axis)) is not None}


def _is_short(levels: Sequence[PackedLevel]) -> bool:
    """Whether the file leaves out what follows from other arrays: readers that know bytes know that as well."""
    return any(packed.bits == 8 for packed in levels)


def _check_whole(metadata: Metadata, levels: Sequence[PackedLevel], coords: Mapping[str, NDArray[Any]]) -> None:
    """A model is checked with all that short tables leave out: what is wrong might be among it."""
    names = {n: name for n, axis in enumerate(metadata.axes) if (name := coords_name(axis)) is not None}
    check_schema(metadata, WHOLE, names, _infos(levels, coords, short=False), DEFAULT_LIMITS)
    check_levels(metadata, levels)


def _arrays(levels: Sequence[PackedLevel], coords: Mapping[str, NDArray[Any]], *, short: bool, wide: bool = False
            ) -> dict[str, NDArray[Any]]:
    """Names and arrays in the order of the file; if `wide`, core and basis numbers as they are in memory."""
    stored = [(prefix(level) + name, array) for level, packed in enumerate(levels, 1)
              for name, array in (*(shortened(packed) if short else replace(packed, rice=()).tables()),
                                  *(packed.wide() if wide else packed.coefficients()))]
    return file_order([*coords.items(), *stored])


def _infos(levels: Sequence[PackedLevel], coords: Mapping[str, NDArray[Any]], *, short: bool) -> dict[str, ArrayInfo]:
    """Number types and shapes in the order of the file, for which no number is narrowed."""
    infos = {name: ArrayInfo(TYPE_NAMES[array.dtype.newbyteorder("<")], array.shape)
             for name, array in _arrays(levels, coords, short=short, wide=True).items()}
    for level, packed in enumerate(levels, 1):
        for name, array in packed.wide() if packed.bits == 8 else ():
            if short and packed.rice:  # of a whole file offsets are still to be checked, by which bits are counted
                stored = packed.core_bytes if name == "core" else packed.basis_bytes(int(name.split("/")[1]))
                infos[prefix(level) + name] = ArrayInfo("U8", (stored,))
            else:
                infos[prefix(level) + name] = ArrayInfo("I8", array.shape)
    return infos


def _check_bytes(arrays: Mapping[str, NDArray[Any]], levels: Sequence[PackedLevel]) -> None:
    """The bytes of a level must stand for the very numbers that it holds."""
    for level, packed in enumerate(levels, 1):
        for name, numbers in packed.wide() if packed.bits == 8 else ():
            stored = arrays[prefix(level) + name]
            table = CORE_NUMBERS if name == "core" else BASIS_NUMBERS
            differ = (packed.unpacked(name, stored) if packed.rice else widened(stored, table)) != numbers
            if not differ.any():
                continue
            found = numbers[differ][0]
            raise fault("array-dtype" if np.isfinite(found) else "not-finite", prefix(level) + name, found,
                        "whole numbers that there are codes for" if packed.rice else "numbers that a byte stands for")


def _check_types(levels: Sequence[PackedLevel]) -> None:
    """Wrong types and parameters are refused first, as they would also spoil the order and the sizes in the file."""
    for level, packed in enumerate(levels, 1):
        if packed.shape.ndim != 3:
            raise fault("array-shape", f"{prefix(level)}shape", list(packed.shape.shape), "[nodes, 3, modes]")
        for name, array in (*packed.tables(), *packed.wide()):
            allowed = LEVEL_TYPES[name.split("/")[0]]
            if TYPE_NAMES.get(array.dtype.newbyteorder("<")) != allowed:
                raise fault("array-dtype", prefix(level) + name, array.dtype, NUMPY_TYPES[allowed])
        _check_columns(packed, prefix(level))


def _check_columns(packed: PackedLevel, level: str) -> None:
    """Without sound parameters there is no telling how long the arrays of a packed level are."""
    if packed.rice and len(packed.rice) != packed.order:
        raise fault("array-shape", f"{level}rice", f"of {len(packed.rice)} modes", f"of {packed.order}, or of none")
    for n, (entries, basis) in enumerate(zip(packed.rice, packed.basis, strict=bool(packed.rice))):
        if entries is not None and (packed.bits != 8 or basis is None):
            raise fault("array-unexpected", f"{level}rice/{n}", "an array", "one beside a basis of few bits alone")
        if basis is not None and entries is None:
            raise fault("array-missing", f"{level}rice/{n}", "no such array", "one for each decomposed mode")
        if entries is not None:
            check_entries(f"{level}rice/{n}", entries, packed.shape[:, 2, n])
    if packed.rice and all(basis is None for basis in packed.basis):
        raise fault("array-dtype", f"{level}core", "packed", "a level with bases")


def _bytes_of(array: NDArray[Any], dtype: str) -> Piece:
    """The array's little-endian bytes in C order, without a copy where it has them."""
    if not array.size:
        return b""
    return np.ascontiguousarray(array, NUMPY_TYPES[dtype]).reshape(-1).view(np.uint8).data
