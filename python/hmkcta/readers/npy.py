"""NumPy's own formats: `.npy` mapped, `.npz` members mapped where the archive stores them as they are."""

from __future__ import annotations

import struct
import zipfile
import zlib
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError
from .source import LISTED, Layout, check_layout, choose, io_error, mapped, opened, too_long, too_short
from .unpacked import Unpacker

MAGIC = b"\x93NUMPY"
#: Bytes that a header may take; NumPy takes 10000 of those that it trusts.
MOST_HEADER = 1 << 16
ZIP_MAGICS = (b"PK\x03\x04", b"PK\x05\x06")  # an archive, an empty archive

#: What is raised of a damaged archive. RuntimeError: encrypted; NotImplementedError, which is one: an unknown
#: compression.
_DAMAGES = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, struct.error)
_HEADER_READERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
#: Bytes of a member's own header in a zip archive, and where in it the lengths of its name and of its extra field are.
_LOCAL_HEADER, _LOCAL_LENGTHS = 30, 26


def open_npy(path: Path) -> NDArray[Any]:
    """Map a `.npy` file.

    Raises:
        HmkctaError: it is damaged, shorter or longer than its header says, or holds no real numbers.
    """
    with opened(path) as file:
        size = file.seek(0, 2)
        file.seek(0)
        layout = _read_layout(file, str(path))
        start = file.tell()
    _check_length(layout, size - start, str(path))
    return mapped(path, layout, start)


def open_npz(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    """Open a member of an `.npz` archive; the only one by default.

    Raises:
        HmkctaError: the archive is damaged, has no such member, or has several and none is chosen.
    """
    with opened(path) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                info = _member(archive, str(path), member)
                where = f"{path}:{info.filename.removesuffix('.npy')}"
                if info.compress_type == zipfile.ZIP_STORED and not info.flag_bits & 1:
                    return _map_member(path, file, info, where)
                return _unpack_member(archive, info, where, unpacker)
        except _DAMAGES as error:
            raise io_error("source-damaged", str(path), error, "a complete .npz archive", "fetch it again") from error


@dataclass(frozen=True)
class _Bounded:
    """A file of which NumPy, which checks the length of a header once it has read it, reads no more than one takes."""

    file: BinaryIO

    def read(self, count: int) -> bytes:
        """So many bytes, fewer at the end."""
        if count > MOST_HEADER:
            raise ValueError(f"a header of {count} bytes")
        return self.file.read(count)


def _read_layout(file: BinaryIO, where: str) -> Layout:
    """Shape and number type from the header of a `.npy` file, checked."""
    try:
        version = cast("tuple[int, int]", tuple(np.lib.format.read_magic(file)))
        if version not in _HEADER_READERS:  # 3.0 is for field names of structured arrays only
            raise io_error("source-format", where, f"version {version[0]}.{version[1]} of the .npy format",
                           " or ".join(f"{major}.{minor}" for major, minor in _HEADER_READERS),
                           "load it with what wrote it, and save it with numpy.save")
        shape, fortran, dtype = _HEADER_READERS[version](cast("BinaryIO", _Bounded(file)))
    except (ValueError, TypeError, SyntaxError, EOFError, RecursionError, TokenError) as error:
        sentence = str(error).splitlines()[0].rstrip(".") if str(error) else type(error).__name__
        raise io_error("source-damaged", where, sentence, "a complete .npy file", "fetch it again") from error
    layout = Layout(tuple(map(int, shape)), dtype, fortran)
    check_layout(layout, where)
    return layout


def _check_length(layout: Layout, found: int, where: str) -> None:
    if found < layout.nbytes:
        raise too_short(where, f"{found} bytes of numbers", layout)
    if found > layout.nbytes:
        raise too_long(where, f"{found} bytes of numbers", layout)


def _member(archive: zipfile.ZipFile, where: str, name: str | None) -> zipfile.ZipInfo:
    members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()
               if info.filename.endswith(".npy")}
    texts = dict.fromkeys(members, "")
    if name not in members and len(members) > 1:  # they will be listed
        texts |= {each: _described(archive, members[each]) for each in sorted(members)[:LISTED]}
    return members[choose(where, texts, name)]


def _described(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> str:
    """Shape and number type of a member, of which the header alone is read; empty: it holds no real numbers."""
    with suppress(HmkctaError, *_DAMAGES), archive.open(info) as stream:
        return str(_read_layout(cast("BinaryIO", stream), info.filename))
    return ""


def _map_member(path: Path, file: BinaryIO, info: zipfile.ZipInfo, where: str) -> NDArray[Any]:
    """A member that the archive stores as it is lies in the file like a `.npy` file."""
    file.seek(info.header_offset + _LOCAL_LENGTHS)
    name, extra = struct.unpack("<HH", file.read(4))
    start = info.header_offset + _LOCAL_HEADER + name + extra
    file.seek(start)
    layout = _read_layout(file, where)
    _check_length(layout, start + info.file_size - file.tell(), where)
    numbers = file.tell()
    if file.seek(0, 2) < numbers + layout.nbytes:
        raise io_error("source-truncated", where, "the end of the file within it",
                       f"{layout.nbytes} bytes for {layout}", "fetch it again")
    return mapped(path, layout, numbers)


def _unpack_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, where: str, unpacker: Unpacker) -> NDArray[Any]:
    with archive.open(info) as stream:
        file = cast("BinaryIO", stream)
        layout = _read_layout(file, where)
        _check_length(layout, info.file_size - file.tell(), where)
        return unpacker.stream(where, file.read, layout)
