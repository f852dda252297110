"""Read a file: nothing is believed before it is checked, and no damage goes unnoticed.

Checks come in this order, so that every reader gives the same reason: header, metadata hash, byte ranges, metadata,
which arrays there are, their checksums, their contents (`docs/format.md`, section 8).
"""

from __future__ import annotations

import mmap
import os
import stat
import zlib
from collections import Counter
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..axes import mode_sizes
from ..errors import HmkctaError, expect, shown
from ..packed import Metadata, PackedLevel
from .check import check_coords, check_levels
from .fields import parse_json
from .header import LENGTH_BYTES, TEXT_KEY, Entry, Header, header_length, parse_header
from .limits import DEFAULT_LIMITS, Limits
from .lookalikes import START, recognised
from .metadata import ArrayRecord, Parsed, from_json
from .reasons import fault
from .schema import NUMPY_TYPES, SHORT, ArrayInfo, check_order, check_schema, is_number, level_of
from .short import completed
from .stored import from_stored

Loaded: TypeAlias = tuple[Metadata, tuple[PackedLevel, ...]]


def load(path: str | os.PathLike[str], *, verify: bool = True, limits: Limits = DEFAULT_LIMITS) -> Loaded:
    """Read a file. Its arrays are read-only views of the memory-mapped file; bytes and packed numbers are widened.

    Args:
        path: a regular file.
        verify: compare the CRC-32 of each array. Without it, flipped bits in the numbers go unnoticed; indices,
            offsets and finiteness are checked in any case.
        limits: the largest sizes accepted.

    Raises:
        HmkctaError: the file cannot be read, or violates the format in any way; see `REASONS`.
    """
    expect("limits", limits, Limits, "hmkcta.Limits")
    data = _mapped(path)
    try:
        return loads(data, verify=verify, limits=limits)
    except HmkctaError as error:
        told = recognised(error, bytes(data[:START]))
        told.args = (f"{path}: {told}",)  # `where` is a place in the file; people have several files
        raise told from error.__cause__


def table_bytes(path: str | os.PathLike[str]) -> list[int]:
    """Bytes that each level's arrays but core and basis numbers have in a file that `load` accepts."""
    entries = read_header(memoryview(_mapped(path)), DEFAULT_LIMITS).entries
    counted = Counter[int]()
    for name, entry in entries.items():
        if name.startswith("level/") and not is_number(name):
            counted[int(name.split("/")[1])] += entry.end - entry.begin
    return [counted[level] for level in sorted(counted)]


def _mapped(path: str | os.PathLike[str]) -> bytes | mmap.mmap:
    try:
        # A pipe would block on opening, a device may have no end.
        if not stat.S_ISREG(os.stat(path).st_mode):
            raise fault("unreadable", str(path), "no regular file", "a file", told="is no regular file")
        with open(path, "rb") as file:
            size = os.fstat(file.fileno()).st_size
            # An empty file cannot be mapped.
            return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if size else b""
    except (OSError, ValueError) as error:
        where = shown(path) if isinstance(path, bytes) else str(path)  # which may be what somebody read from a file
        said = getattr(error, "strerror", None) or error
        raise fault("unreadable", where, said, "a readable file", told=f"cannot be read: {said}") from error


def loads(data: bytes | bytearray | mmap.mmap, *, verify: bool = True, limits: Limits = DEFAULT_LIMITS) -> Loaded:
    """Read a file whose bytes are in memory; the arrays are views of them. As `load` in all else."""
    view = memoryview(data).toreadonly()
    header = read_header(view, limits)
    parsed = from_json(parse_json(header.text, TEXT_KEY, limits), limits)
    infos = {name: ArrayInfo(entry.dtype, entry.shape) for name, entry in header.entries.items()}
    _check_records(parsed.arrays, infos)
    check_schema(parsed.metadata, parsed.version, parsed.coords, infos, limits)
    check_order(list(infos), infos)
    if verify:
        _verify(view, header, parsed)
    arrays = {name: _array(view, header.data_start, entry) for name, entry in header.entries.items()}
    check_coords({name: arrays[name] for name in parsed.coords.values()})
    metadata = parsed.resolve(arrays)
    if parsed.version in SHORT:
        sizes = mode_sizes(metadata.axes, metadata.organisation)
        arrays = completed(arrays, sizes, len(metadata.levels), metadata.undecomposed)
    levels = tuple(level_of(arrays, level, len(metadata.organisation))
                   for level in range(1, len(metadata.levels) + 1))
    check_levels(metadata, levels)
    return from_stored(metadata, levels)


def read_header(view: memoryview, limits: Limits) -> Header:
    """Parse the header of a file's bytes and check which bytes it gives to which array."""
    length = header_length(bytes(view[:LENGTH_BYTES]), len(view), limits)
    return parse_header(bytes(view[LENGTH_BYTES:LENGTH_BYTES + length]), len(view), limits)


def _check_records(records: Mapping[str, ArrayRecord], infos: Mapping[str, ArrayInfo]) -> None:
    """The header and the metadata must speak of the same arrays."""
    for name, record in records.items():
        if name not in infos:
            raise fault("array-missing", name, "no such array", "an array, as the metadata has a record of it")
        if record.info is not None and infos[name].dtype != record.info.dtype:
            raise fault("array-dtype", name, infos[name].dtype, record.info.dtype)
        if record.info is not None and infos[name].shape != record.info.shape:
            raise fault("array-shape", name, list(infos[name].shape), list(record.info.shape))
    for name in infos:
        if name not in records:
            raise fault("array-unexpected", name, "an array", "none without a record in the metadata")


def _verify(view: memoryview, header: Header, parsed: Parsed) -> None:
    for name, entry in header.entries.items():
        crc = zlib.crc32(view[header.data_start + entry.begin:header.data_start + entry.end])
        if crc != parsed.arrays[name].crc32:
            found = f"stored bytes whose checksum (CRC-32) is {crc:#010x}"
            allowed = f"{parsed.arrays[name].crc32:#010x}, as the metadata say"
            raise fault("array-crc", name, found, allowed, "fetch the file again")


def _array(view: memoryview, start: int, entry: Entry) -> NDArray[Any]:
    dtype = np.dtype(NUMPY_TYPES[entry.dtype])
    if entry.begin == entry.end:
        return np.empty(entry.shape, dtype)
    count = (entry.end - entry.begin) // dtype.itemsize
    return np.frombuffer(view, dtype, count, start + entry.begin).reshape(entry.shape)
