"""NIfTI by nibabel: mapped where its numbers lie in the file as they are meant, else unpacked and scaled."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..conventions import Packing, scaled_type
from ..support.optional import library
from .source import Layout, guarded, io_error, map_part, reading
from .unpacked import Unpacker

GZIP = b"\x1f\x8b"
#: Where the header says what it is, in version 1 (one file, or two) and 2.
MAGICS = ((344, b"n+1\0"), (344, b"ni1\0"), (4, b"n+2\0"), (4, b"ni2\0"))


def open_nifti(path: Path, unpacker: Unpacker) -> NDArray[Any]:
    """Open a NIfTI image; axes as in its header (x, y, z, time, ..), numbers scaled by its slope and intercept.

    Raises:
        HmkctaError: nibabel is missing, the file is damaged or shorter than its header says.
    """
    nibabel = library("nibabel", "nibabel", "nifti", "NIfTI")
    with guarded(path, "NIfTI file"):
        image = nibabel.load(str(path))
        numbers = Path(image.file_map["image"].filename)  # another file than the header's for .hdr with .img
        proxy = image.dataobj
        stored, where = Layout(tuple(map(int, proxy.shape)), np.dtype(proxy.dtype), fortran=True), str(path)
        reading(numbers)
        plain = (float(proxy.slope), float(proxy.inter)) == (1.0, 0.0)
        with open(numbers, "rb") as file:
            packed = file.read(len(GZIP)) == GZIP
        if not packed and (plain or stored.dtype.kind not in "iuf"):
            return map_part(numbers, stored, int(proxy.offset), where)
        kind, slope, inter = scaled_type(stored.dtype), float(proxy.slope), float(proxy.inter)
        scaled = Packing(stored.dtype, kind, slope, inter, np.empty(0))
        with (gzip.open if packed else open)(numbers, "rb") as stream:
            stream.seek(int(proxy.offset))
            return unpacker.stream(where, stream.read, stored, None if plain else scaled)


def open_gzip(path: Path, unpacker: Unpacker) -> NDArray[Any]:
    """Open what is told by gzip's magic bytes: a NIfTI image, no other format is packed so.

    Raises:
        HmkctaError: it is something else, or what `open_nifti` raises.
    """
    if not path.name.lower().endswith((".nii.gz", ".img.gz", ".hdr.gz")):
        raise io_error("source-format", str(path), "gzip", "a format in itself, or .nii.gz", "unpack it: gunzip")
    return open_nifti(path, unpacker)
