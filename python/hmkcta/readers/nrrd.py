"""NRRD by pynrrd: raw numbers are mapped, packed ones unpacked. Axes are as in the header's `sizes`."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..labels import Labels, labelled
from ..support.optional import library
from .nrrd_encodings import BINARY, ENCODINGS, Leading, encoded, skip_lines
from .source import Layout, guarded, io_error, map_part, opened, too_short
from .unpacked import Unpacker

MAGIC = b"NRRD00"
#: Bytes that a header may take; those of hundreds of directions take some 100 KiB.
MOST_HEADER = 1 << 24
#: Versions that pynrrd knows.
VERSIONS = range(1, 6)
_BYTES = {"char": 1, "int8": 1, "short": 2, "int16": 2, "int": 4, "int32": 4, "longlong": 8, "long long": 8, "int64": 8}
_QUANTISED = ("oldmin", "oldmax")


def open_nrrd(path: Path, unpacker: Unpacker) -> NDArray[Any]:
    """Open a NRRD file, or the data file that a detached header names; the first axis lies fastest.

    Raises:
        HmkctaError: pynrrd is missing, the file is damaged, shorter or longer than it says, or its header says what is
            not read, such as several data files.
    """
    nrrd = library("nrrd", "pynrrd", "nrrd", "NRRD")
    with guarded(path, "NRRD file"), ExitStack() as stack:
        file: BinaryIO = stack.enter_context(opened(path))
        header = _header(nrrd, file, path)
        layout = Layout(tuple(map(int, header["sizes"])), _number_type(header, path), fortran=True)
        if int(header["dimension"]) != len(layout.shape):
            found = f"dimension {header['dimension']} and {len(layout.shape)} sizes"
            raise io_error("source-damaged", str(path), found, "a size for each dimension", "correct its header")
        detached = header.get("datafile")
        if detached is not None:
            file = stack.enter_context(opened(_data_file(path, str(detached))))
        skip_lines(file, int(header.get("lineskip", 0)), str(path))
        array = _numbers(header, layout, path, file, unpacker)
        ends = [f"{header[name]:g}" for name in _QUANTISED if name in header]
        note = (f"the range {' to '.join(ends)} before quantisation, of which the header of {path} tells, is not put "
                "back: what is compressed are the numbers as stored. Next: unu unquantize, if it is meant")
        return labelled(array, Labels(notes=(note,))) if len(ends) == len(_QUANTISED) else array


def _header(nrrd: Any, file: BinaryIO, path: Path) -> dict[str, Any]:
    """Fields by name, without spaces, as each may be written with them; the file stands behind the header."""
    start = BytesIO(file.read(MOST_HEADER))
    version = re.match(rb"NRRD(\d{4})\s*\n", start.getvalue()[:16])
    if version is None or int(version[1]) not in VERSIONS:
        raise io_error("source-format", str(path), f"NRRD version {start.getvalue()[4:8].decode('ascii', 'replace')}",
                       f"{VERSIONS[0]} to {VERSIONS[-1]}", "write it anew: unu save -f nrrd")
    seen = set[str]()
    for name, value in _fields(start):
        if name == "datafile" and value.startswith("LIST"):  # which pynrrd does not always take
            raise _several(path, value)
        if name in seen:
            raise io_error("source-format", str(path), f"the field {name} twice in its header", "each field once",
                           "take one of the two lines out of it; pynrrd reads it with ALLOW_DUPLICATE_FIELD, and then "
                           "takes the last")
        seen.add(name)
    start.seek(0)
    fields: Mapping[str, Any] = nrrd.read_header(start)
    file.seek(start.tell())
    header = {_plain(name): value for name, value in fields.items()}
    missing = [name for name in ("type", "dimension", "sizes", "encoding") if header.get(name) is None]
    if missing:
        raise io_error("source-damaged", str(path), f"a header without {' and '.join(missing)}", "a complete header",
                       "write what is missing into it")
    return header


def _fields(start: BytesIO) -> Iterator[tuple[str, str]]:
    """Names of the fields as `_plain` writes them, and their values."""
    for line in start:
        text = line.decode("ascii", "ignore").rstrip()
        if not text:
            return
        if not text.startswith(("#", "NRRD")):
            name, _, value = text.partition(":")
            yield _plain(name), value.strip()


def _plain(name: str) -> str:
    return name.replace(" ", "")


def _data_file(path: Path, said: str) -> Path:
    """The file beside the header that holds the numbers."""
    numbers = path.parent / said
    if not numbers.exists() and (path.resolve().parent / said).exists():  # the header is a link to where both lie
        return path.resolve().parent / said
    if " " in said and not numbers.exists():
        raise _several(path, said)
    return numbers


def _several(path: Path, said: str) -> Exception:
    return io_error("source-format", str(path), f"data file: {said}", "one data file",
                    "open the data files by a pattern, as raw binary or pictures")


def _numbers(header: Mapping[str, Any], layout: Layout, path: Path, file: BinaryIO, unpacker: Unpacker) -> NDArray[Any]:
    skip, encoding = int(header.get("byteskip", 0)), str(header["encoding"]).lower()
    kind = ENCODINGS.get(encoding)
    if kind is None:
        raise io_error("source-format", str(path), f"encoding {encoding}", ", ".join(ENCODINGS),
                       "write it anew: unu save -f nrrd -e gzip")
    if skip < -1 or (skip == -1 and kind not in BINARY):
        allowed = "0 or more bytes, or -1 for the last ones of raw and packed data"
        raise io_error("source-damaged", str(path), f"byte skip {skip}", allowed, "correct its header")
    begin = file.tell()
    if kind != "raw":
        source = encoded(kind, file, layout, Leading(str(path), begin, skip))
        return unpacker.stream(str(path), source, layout)
    held = file.seek(0, 2)
    start = held - layout.nbytes if skip == -1 else begin + skip
    if start < begin:
        raise too_short(str(path), f"{held - begin} bytes of numbers", layout)
    return map_part(Path(file.name), layout, start, str(path), last=True)


def _number_type(header: Mapping[str, Any], path: Path) -> np.dtype[Any]:
    """NumPy's type for one of the many names that NRRD has for each."""
    name = str(header["type"]).lower().removesuffix("_t").removesuffix(" int")
    if name in ("float", "double"):
        kind, size = "f", 4 if name == "float" else 8
    else:
        kind = "u" if name.startswith("u") else "i"
        size = _BYTES.get(name.removeprefix("unsigned").removeprefix("signed").removeprefix("u").strip() or "int", 0)
    if not size:
        raise io_error("source-format", str(path), f"numbers of type {header['type']}", "integers, float or double",
                       "write them as one of these: unu convert -t float")
    if size > 1 and ENCODINGS.get(str(header["encoding"]).lower()) != "text":
        endian = str(header.get("endian"))
        if endian not in ("big", "little"):
            raise io_error("source-damaged", str(path), f"endian {endian}", "big or little", "write it into its header")
        return np.dtype({"big": ">", "little": "<"}[endian] + f"{kind}{size}")
    return np.dtype(f"{kind}{size}")
