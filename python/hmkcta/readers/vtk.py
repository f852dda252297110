"""Regular grids of VTK (`.vti`, `.vtr`): plain appended numbers are mapped; packed ones, base64 and text unpacked."""

from __future__ import annotations

import re
import zlib
from base64 import b64decode
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis
from ..labels import with_axes
from .nrrd_encodings import Words
from .source import Layout, check_layout, choose, guarded, io_error, map_part, opened, too_long, too_short
from .unpacked import Unpacker
from .vtk_header import CELLS, COORDINATES, POINTS, Stored, VtkHeader, vtk_header

MAGICS = ((0, b"<VTKFile"), (0, b'<?xml version="1.0"?>\n<VTKFile'), (0, b'<?xml version="1.0"?>\r\n<VTKFile'))
#: Bytes that are read at once, and the most that a byte of zlib unpacks to.
BLOCK, RATIO = 1 << 20, 1032
_TYPES = {"Float32": "f4", "Float64": "f8", **{f"{name}{8 * size}": f"{kind}{size}" for size in (1, 2, 4, 8)
                                               for name, kind in (("Int", "i"), ("UInt", "u"))}}
_PART = re.compile(rb"[^=]+={0,2}")


def open_vtk(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    """Open an array of the points or cells of a grid: z, y, x, and components if there are several.

    Raises:
        HmkctaError: there are several and none is named; the file is damaged, cut, or of another grid than of image or
            rectilinear kind.
    """
    with guarded(path, "VTK file"), opened(path) as file:
        header = vtk_header(file, path)
        members = _members(header)
        layouts = {name: _layout(header, stored) for name, stored in members.items()}
        unread = {name: f"numbers of type {members[name].attributes.get('type')}" for name, layout in layouts.items()
                  if layout is None}
        texts = {name: str(layout) for name, layout in layouts.items() if layout is not None}
        stored = members[choose(str(path), texts, member, unread)]
        array = _Numbers(path, file, header, unpacker).array(stored)
        axes, notes = _axes(header, stored, [
            np.asarray(_Numbers(path, file, header, unpacker).array(each)) for each in header.arrays
            if each.place == COORDINATES])
        if array.ndim > len(axes):
            axes.append(Axis("component", array.shape[-1], "channel"))
        return with_axes(array, axes, notes)


def _members(header: VtkHeader) -> dict[str, Stored]:
    """Arrays of points by their names, and those of cells, which have their element before a name that points have."""
    members: dict[str, Stored] = {}
    for stored in header.arrays:
        name = stored.attributes.get("Name", "")
        if stored.place != COORDINATES:
            members[f"{stored.place}/{name}" if name in members else name] = stored
    return members


def _extent(header: VtkHeader) -> list[int]:
    """First and last index of points along x, y and z."""
    found = list(map(int, header.grid["WholeExtent"].split()))
    if len(found) != 6 or any(last < first for first, last in zip(found[::2], found[1::2], strict=True)):
        raise ValueError(f"an extent of {header.grid['WholeExtent']}")
    return found


def _layout(header: VtkHeader, stored: Stored) -> Layout | None:
    """Shape and type of an array; None: it does not hold numbers."""
    kind = _TYPES.get(stored.attributes.get("type", ""))
    if kind is None:
        return None
    extent = _extent(header)
    counts = [last - first for first, last in zip(extent[::2], extent[1::2], strict=True)]
    if stored.place == COORDINATES:
        axis = [each for each in header.arrays if each.place == COORDINATES].index(stored)
        shape: tuple[int, ...] = (counts[axis] + 1,)
    else:  # cells lie between points; along an axis of one point there is one
        shape = tuple(count + 1 if stored.place == POINTS else max(1, count) for count in reversed(counts))
    components = int(stored.attributes.get("NumberOfComponents", "1"))
    order = ">" if header.file.get("byte_order") == "BigEndian" else "<"
    return Layout(shape if components == 1 else (*shape, components), np.dtype(f"{order}{kind}"))


@dataclass
class _Numbers:
    """Reads arrays of a file."""

    path: Path
    file: BinaryIO
    header: VtkHeader
    unpacker: Unpacker

    def array(self, stored: Stored) -> NDArray[Any]:
        """The numbers of an array, mapped if they lie in the file as they are."""
        layout, where = _layout(self.header, stored), f"{self.path}:{stored.attributes.get('Name', '')}"
        if layout is None:
            raise ValueError(f"numbers of type {stored.attributes.get('type')}")
        check_layout(layout, where)
        kind, encoding = stored.attributes.get("format", "ascii"), "base64"
        held = self.file.seek(0, 2)
        if kind == "ascii":
            if layout.nbytes > 8 * held:  # a digit and a space make 8 bytes at most
                raise too_short(where, f"{stored.end - stored.begin} bytes of text", layout)
            text = _Region(self.file, stored.begin, stored.end)
            return self.unpacker.stream(where, Words(text, layout.dtype.newbyteorder("=")).read,
                                        Layout(layout.shape, layout.dtype.newbyteorder("=")))
        if kind == "appended":
            if self.header.appended < 0:
                raise ValueError("appended numbers, and none are appended")
            encoding = self.header.encoding
            begin, end = self.header.appended + int(stored.attributes["offset"]), held
        else:
            begin, end = stored.begin, stored.end
        region = _Region(self.file, begin, end)
        source = _Bytes(region if encoding == "raw" else _Base64(region), self._counts(), where)
        if self.header.file.get("compressor"):
            source.open_packed(layout, held)
            return self.unpacker.stream(where, source.read, layout)
        source.open_plain(layout)
        if encoding == "raw":
            return map_part(self.path, layout, begin + source.counts.itemsize, where)
        if layout.nbytes > held:
            raise too_short(where, f"{held} bytes of base64", layout)
        return self.unpacker.stream(where, source.read, layout)

    def _counts(self) -> np.dtype[Any]:
        """The type of the numbers that say how many bytes follow."""
        kind = "8" if self.header.file.get("header_type") == "UInt64" else "4"
        return np.dtype((">" if self.header.file.get("byte_order") == "BigEndian" else "<") + f"u{kind}")


@dataclass
class _Region:
    """A part of a file, from `at` to `end`."""

    file: BinaryIO
    at: int
    end: int

    def read(self, count: int = -1) -> bytes:
        """So many bytes; fewer at the end."""
        self.file.seek(self.at)
        left = max(0, self.end - self.at)
        found = self.file.read(left if count < 0 else min(count, left))
        self.at += len(found)
        return found


@dataclass
class _Base64:
    """Bytes of text in base64, of which several ends may follow one another: header and numbers are packed alone."""

    region: _Region
    text: bytes = b""
    found: bytearray = field(default_factory=bytearray)

    def read(self, count: int) -> bytes:
        """So many bytes; fewer at the end."""
        while len(self.found) < count:
            block = self.region.read(max(64, min(BLOCK, 2 * count)))
            if not block:
                break
            block, tag, _ = block.partition(b"<")  # of what follows appended numbers
            self.region.end = self.region.at if tag else self.region.end
            self.text += b"".join(block.split())
            whole = len(self.text) // 4 * 4
            for part in _PART.findall(self.text[:whole]):
                self.found += b64decode(part, validate=True)
            self.text = self.text[whole:]
        taken = bytes(self.found[:count])
        del self.found[:count]
        return taken


@dataclass
class _Bytes:
    """The bytes of one array, behind the numbers that say how many they are, packed in blocks or not.

    Attributes:
        source: reads on from these numbers.
        counts: their type.
        where: the array, for errors.
        left: bytes that are still to come, of numbers that are not packed.
        blocks: packed and unpacked bytes of the blocks to come, the next one last.
    """

    source: _Region | _Base64
    counts: np.dtype[Any]
    where: str
    left: int = 0
    blocks: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])
    found: bytearray = field(default_factory=bytearray)

    def open_plain(self, layout: Layout) -> None:
        """Read how many bytes follow.

        Raises:
            HmkctaError: they are not those of the array.
        """
        self.left = self._take(1)[0]
        self._check(self.left, layout)

    def open_packed(self, layout: Layout, held: int) -> None:
        """Read how many blocks follow, and how long they are, before and after packing.

        Raises:
            HmkctaError: they do not make the array, or a file of `held` bytes has no room for them.
        """
        count, size, last = self._take(3)
        full = count - (last > 0)
        self._check(size * full + last, layout)
        if count * self.counts.itemsize > held or layout.nbytes > RATIO * held:
            raise too_short(self.where, f"{held} bytes of the whole file", layout)
        sizes = [size] * full + [last] * (count - full)
        self.blocks = list(zip(self._take(count), sizes, strict=True))[::-1]

    def read(self, count: int) -> bytes:
        """So many bytes; fewer at the end."""
        if not self.blocks and not self.found:
            taken = self.source.read(min(count, self.left))
            self.left -= len(taken)
            return taken
        while len(self.found) < count and self.blocks:
            packed, size = self.blocks.pop()
            unpacked = zlib.decompressobj().decompress(self.source.read(packed), size + 1)
            if len(unpacked) != size:
                raise ValueError(f"a block of {len(unpacked)} bytes, which should have {size}")
            self.found += unpacked
        taken = bytes(self.found[:count])
        del self.found[:count]
        return taken

    def _take(self, count: int) -> list[int]:
        data = self.source.read(count * self.counts.itemsize)
        if len(data) < count * self.counts.itemsize:
            raise io_error("source-truncated", self.where, f"{len(data)} bytes", "the numbers of its blocks",
                           "fetch it again")
        return np.frombuffer(data, self.counts).tolist()

    def _check(self, nbytes: int, layout: Layout) -> None:
        if nbytes < layout.nbytes:
            raise too_short(self.where, f"{nbytes} bytes of numbers", layout)
        if nbytes > layout.nbytes:
            raise too_long(self.where, f"{nbytes} bytes of numbers", layout)


def _axes(header: VtkHeader, stored: Stored, given: Sequence[NDArray[Any]]) -> tuple[list[Axis], list[str]]:
    """The axes z, y and x with positions of points, or of the middles of cells, and a sentence where there are none."""
    extent = _extent(header)
    straight = np.array_equal(_floats(header, "Direction", np.eye(3).ravel()), np.eye(3).ravel())
    origin, spacing = _floats(header, "Origin", np.zeros(3)), _floats(header, "Spacing", np.ones(3))
    axes: list[Axis] = []
    for axis, name in enumerate("xyz"):
        first, last = extent[2 * axis:2 * axis + 2]
        positions = given[axis] if len(given) == 3 else origin[axis] + spacing[axis] * np.arange(first, last + 1)
        if stored.place == CELLS and len(positions) > 1:
            positions = (positions[1:] + positions[:-1]) / 2
        axes.append(Axis(name, len(positions), "space", positions if straight else None))
    turned = "the grid lies askew, so that its positions are not kept. Next: resample it, if they matter"
    return axes[::-1], [] if straight else [turned]


def _floats(header: VtkHeader, name: str, otherwise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Numbers of an attribute of the grid."""
    found = np.array([float(word) for word in header.grid.get(name, "").split()])
    return found if len(found) == len(otherwise) else otherwise
