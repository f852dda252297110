"""NRRD by pynrrd: raw numbers are mapped, packed ones unpacked. Axes are as in the header's `sizes`."""

from __future__ import annotations

import bz2
import gzip
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..support.optional import library
from .source import Layout, guarded, io_error, map_part, opened
from .unpacked import Unpacker

MAGIC = b"NRRD00"
_BYTES = {"char": 1, "int8": 1, "short": 2, "int16": 2, "int": 4, "int32": 4, "longlong": 8, "long long": 8, "int64": 8}


def open_nrrd(path: Path, unpacker: Unpacker) -> NDArray[Any]:
    """Open a NRRD file, or the data file that a detached header names; the first axis lies fastest.

    Raises:
        HmkctaError: pynrrd is missing, the file is damaged, shorter than it says, or lists several data files.
    """
    nrrd = library("nrrd", "pynrrd", "nrrd", "NRRD")
    with guarded(path, "NRRD file"), ExitStack() as stack:
        file: BinaryIO = stack.enter_context(opened(path))
        header = dict(nrrd.read_header(file))
        layout = Layout(tuple(map(int, header["sizes"])), _number_type(header), fortran=True)
        detached = header.get("data file", header.get("datafile"))
        if detached is not None:
            numbers = path.parent / detached
            if detached == "LIST" or (" " in detached and not numbers.exists()):
                raise io_error("source-format", str(path), f"data file: {detached}", "one data file",
                               "open the data files by a pattern, as raw binary or pictures")
            file = stack.enter_context(opened(numbers))
        for _ in range(int(header.get("line skip", header.get("lineskip", 0)))):
            file.readline()
        return _numbers(nrrd, header, layout, path, file, unpacker)


def _numbers(
    nrrd: Any, header: dict[str, Any], layout: Layout, path: Path, file: BinaryIO, unpacker: Unpacker
) -> NDArray[Any]:
    skip, encoding = int(header.get("byte skip", header.get("byteskip", 0))), str(header["encoding"]).lower()
    if encoding == "raw":
        start = file.seek(0, 2) - layout.nbytes if skip == -1 else file.tell() + skip
        return map_part(Path(file.name), layout, start, str(path))
    if encoding in ("gzip", "gz", "bzip2", "bz2"):
        packed = gzip.GzipFile(fileobj=file) if encoding[0] == "g" else bz2.BZ2File(file)
        with packed as stream:
            stream.seek(max(0, skip))
            return unpacker.stream(str(path), stream.read, layout)
    unpacker.check_memory(layout, f"{path}, which is text", "write it with encoding raw: that is mapped")
    ahead = ("line skip", "lineskip", "data file", "datafile")  # the file is open, and behind those lines
    return nrrd.read_data({name: field for name, field in header.items() if name not in ahead}, file, str(path))


def _number_type(header: dict[str, Any]) -> np.dtype[Any]:
    """NumPy's type for one of the many names that NRRD has for each."""
    name = str(header["type"]).lower().removesuffix("_t").removesuffix(" int")
    if name in ("float", "double"):
        kind, size = "f", 4 if name == "float" else 8
    else:
        kind = "u" if name.startswith("u") else "i"
        size = _BYTES[name.removeprefix("unsigned").removeprefix("signed").removeprefix("u").strip() or "int"]
    if size > 1 and header["encoding"] in ("raw", "gzip", "gz", "bzip2", "bz2"):
        return np.dtype({"big": ">", "little": "<"}[header["endian"]] + f"{kind}{size}")
    return np.dtype(f"{kind}{size}")
