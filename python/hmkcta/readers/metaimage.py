"""MetaImage (`.mha`, `.mhd` with a file of numbers): raw numbers are mapped, packed ones and text unpacked."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis
from ..labels import with_axes
from .nrrd_encodings import BLOCK, Leading, encoded
from .source import Layout, check_layout, guarded, io_error, map_part, opened, too_long, too_short
from .unpacked import Unpacker

MAGICS = ((0, b"ObjectType"), (0, b"NDims"))
#: Bytes that a header may take, and the most that a byte of zlib unpacks to.
MOST_HEADER, RATIO = 1 << 20, 1032
NAMES = ("x", "y", "z", "t")
_TYPES = {"CHAR": "i1", "UCHAR": "u1", "SHORT": "i2", "USHORT": "u2", "INT": "i4", "UINT": "u4", "LONG": "i4",
          "ULONG": "u4", "LONG_LONG": "i8", "ULONG_LONG": "u8", "FLOAT": "f4", "DOUBLE": "f8"}
_NEEDED = ("ndims", "dimsize", "elementtype", "elementdatafile")
_POSITIONS, _SPACINGS = ("offset", "position", "origin"), ("elementspacing", "elementsize")
_ROTATIONS = ("transformmatrix", "rotation", "orientation")
_REWRITE = "write it anew with what reads it: SimpleITK.WriteImage(SimpleITK.ReadImage(IN), OUT.mha)"


def open_metaimage(path: Path, unpacker: Unpacker) -> NDArray[Any]:
    """Open a MetaImage; axes x, y, z, t as its header has them, the first one lies fastest; channels come last.

    Raises:
        HmkctaError: the file is damaged, shorter or longer than it says, or says what is not read, such as a list of
            several files.
    """
    where = str(path)
    with guarded(path, "MetaImage"), ExitStack() as stack:
        file: BinaryIO = stack.enter_context(opened(path))
        header = _header(file, where)
        said = header["elementdatafile"]
        if said.upper() == "LIST" or "%" in said:
            raise io_error("source-format", where, f"ElementDataFile = {said}", "one file of numbers", _REWRITE)
        if said.upper() != "LOCAL":
            file = stack.enter_context(opened(path.parent / said))
            file.seek(max(0, int(header.get("headersize", 0))))
        sizes = tuple(map(int, header["dimsize"].split()))
        if len(sizes) != int(header["ndims"]):
            raise io_error("source-damaged", where, f"NDims = {header['ndims']} and {len(sizes)} sizes",
                           "a size for each dimension", "correct its header")
        array = _numbers(header, sizes, file, where, unpacker)
        axes, notes = _axes(header, sizes)
        if array.ndim > len(sizes):
            array, axes = np.moveaxis(array, 0, -1), [*axes, Axis("channel", array.shape[0], "channel")]
        return with_axes(array, axes, notes)


def _header(file: BinaryIO, where: str) -> dict[str, str]:
    """Fields by their names in small letters; the file stands behind the last one, which names the numbers' file."""
    fields: dict[str, str] = {}
    while "elementdatafile" not in fields:
        line = file.readline(MOST_HEADER)
        name, equals, value = line.decode("utf-8", "replace").partition("=")
        if not line or file.tell() > MOST_HEADER or (name.strip() and not equals):
            break
        fields[name.strip().lower()] = value.strip()
    missing = [name for name in _NEEDED if not fields.get(name)]
    if missing:
        raise io_error("source-damaged", where, f"a header without {', '.join(missing)}", "a complete header",
                       "write what is missing into it, or fetch it again")
    kind = fields.get("objecttype", "Image")
    if kind.lower() != "image":
        raise io_error("source-format", where, f"ObjectType = {kind}", "Image", "save what it stands for as an image")
    return fields


def _numbers(header: Mapping[str, str], sizes: tuple[int, ...], file: BinaryIO, where: str, unpacker: Unpacker
             ) -> NDArray[Any]:
    """The numbers ``[channel, x, y, ..]``, without the axis of channels where there is one."""
    channels = int(header.get("elementnumberofchannels", 1))
    shape = sizes if channels == 1 else (channels, *sizes)
    begin = file.tell()
    held = file.seek(0, 2) - begin
    packed, text = _true(header, "compresseddata"), not _true(header, "binarydata", otherwise="True")
    layout = Layout(shape, _number_type(header, shape, -1 if packed or text else held, where), fortran=True)
    check_layout(layout, where)
    if text:
        return unpacker.stream(where, encoded("text", file, layout, Leading(where, begin, 0)), layout)
    if packed:
        count = int(header.get("compresseddatasize", held))
        if held < count or layout.nbytes > RATIO * held:
            raise too_short(where, f"{held} bytes of packed numbers", layout)
        if held > count:
            raise too_long(where, f"{held} bytes, of which {count} are packed numbers,", layout)
        file.seek(begin)
        return unpacker.stream(where, _Inflated(file).read, layout)
    if int(header.get("headersize", 0)) == -1:  # the last bytes
        begin = begin + held - layout.nbytes
    return map_part(Path(file.name), layout, begin, where, last=True)


def _number_type(header: Mapping[str, str], shape: tuple[int, ...], held: int, where: str) -> np.dtype[Any]:
    """NumPy's type; `held` bytes of plain numbers tell what LONG is, 4 bytes by its definition and 8 to some."""
    name = header["elementtype"].upper().removeprefix("MET_").removesuffix("_ARRAY")
    if name not in _TYPES:
        raise io_error("source-format", where, f"numbers of type {header['elementtype']}",
                       ", ".join(f"MET_{each}" for each in _TYPES), _REWRITE)
    kind = np.dtype(_TYPES[name])
    if name in ("LONG", "ULONG") and held == Layout(shape, np.dtype("i8")).nbytes:
        kind = np.dtype(f"{kind.kind}8")
    big = _true(header, "binarydatabyteordermsb") or _true(header, "elementbyteordermsb")
    return kind.newbyteorder(">" if big else "<")


def _true(header: Mapping[str, str], name: str, otherwise: str = "False") -> bool:
    return header.get(name, otherwise)[:1].upper() in ("T", "1", "Y")


def _axes(header: Mapping[str, str], sizes: tuple[int, ...]) -> tuple[list[Axis], list[str]]:
    """Axes with positions in the scanner where they lie along its own, and a sentence where they do not."""
    count = len(sizes)
    names = NAMES[:count] if count <= len(NAMES) else [f"axis{n}" for n in range(count)]
    offset, spacing = (_floats(header, fields, count) for fields in (_POSITIONS, _SPACINGS))
    rotation = _floats(header, _ROTATIONS, count * count)
    straight = rotation is None or np.array_equal(rotation.reshape(count, count), np.eye(count))
    unit = header.get("distanceunits", "mm")
    axes: list[Axis] = []
    for number, (name, size) in enumerate(zip(names, sizes, strict=True)):
        coords = None
        if straight and not (offset is None and spacing is None):
            coords = (0.0 if offset is None else offset[number]) + np.arange(size) * (
                1.0 if spacing is None else spacing[number])
        role = "time" if name == "t" else "space" if name in NAMES else "other"
        axes.append(Axis(name, size, role, coords, unit if coords is not None and role == "space" else ""))
    turned = "its axes lie askew to the scanner's, so that positions are not kept. Next: resample it, if they matter"
    return axes, [] if straight else [turned]


def _floats(header: Mapping[str, str], names: tuple[str, ...], count: int) -> NDArray[np.float64] | None:
    """Numbers of the first of several fields that is there, if they are so many."""
    text = next((header[name] for name in names if name in header), "")
    found = np.array([float(word) for word in text.split()])
    return found if len(found) == count else None


@dataclass
class _Inflated:
    """Bytes that zlib has packed, from where a file stands."""

    file: BinaryIO
    inflater: Any = field(default_factory=zlib.decompressobj)

    def read(self, count: int) -> bytes:
        """So many bytes; fewer at the end."""
        found = bytearray()
        while len(found) < count and not self.inflater.eof:
            packed = self.inflater.unconsumed_tail or self.file.read(BLOCK)
            if not packed:
                raise EOFError("the packed numbers end early")
            found += self.inflater.decompress(packed, count - len(found))
        if self.inflater.unused_data or (self.inflater.eof and self.file.read(1)):
            raise ValueError("bytes behind the packed numbers")
        return bytes(found)
