"""NIfTI by nibabel: mapped where its numbers lie in the file as they are meant, else unpacked and scaled."""

from __future__ import annotations

import gzip
import struct
import warnings
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..packing import Packing, scaled_type
from ..support.optional import library
from .not_read import ANALYZE, by_ending
from .source import Layout, guarded, io_error, map_part, opened, too_short
from .unpacked import NARROW, Unpacker

GZIP = b"\x1f\x8b"
#: A byte of a gzip file holds no more than so many.
GZIP_RATIO = 1032
#: Where the header says what it is, in version 1 (one file, or two) and 2.
MAGICS = ((344, b"n+1\0"), (344, b"ni1\0"), (4, b"n+2\0"), (4, b"ni2\0"))
#: Bytes of the header of version 1, and of Analyze before it, as it says itself in either byte order.
HEADER = 348
#: Bytes of the header of version 2.
HEADER_2 = 540
_HEADERS = (struct.pack("<i", HEADER), struct.pack(">i", HEADER))


def open_nifti(path: Path, unpacker: Unpacker) -> NDArray[Any]:
    """Open a NIfTI image; axes as in its header (x, y, z, time, ..), numbers scaled by its slope and intercept.

    Raises:
        HmkctaError: nibabel is missing, the file is damaged, shorter or longer than its header says, or Analyze.
    """
    nibabel = library("nibabel", "nibabel", "nifti", "NIfTI")
    with guarded(path, "NIfTI file"), _quietly(nibabel):
        _check_extensions(path)
        image = nibabel.load(str(path))
        if not isinstance(image, nibabel.Nifti1Pair | nibabel.Nifti2Pair | nibabel.Cifti2Image):
            raise ANALYZE.refusal(path)
        numbers = Path(image.file_map["image"].filename)  # another file than the header's for .hdr with .img
        real = path.resolve()
        if not numbers.exists() and real != path.absolute():  # the header is a link to where both lie
            return open_nifti(real, unpacker)
        proxy = image.dataobj
        stored, where = Layout(tuple(map(int, proxy.shape)), np.dtype(proxy.dtype), fortran=True), str(path)
        plain = (float(proxy.slope), float(proxy.inter)) == (1.0, 0.0)
        with opened(numbers) as file:
            packed, held = file.read(len(GZIP)) == GZIP, file.seek(0, 2)
        if not packed and (plain or stored.dtype.kind not in "iuf"):
            return map_part(numbers, stored, int(proxy.offset), where, last=True)
        if packed and stored.nbytes > GZIP_RATIO * held:
            raise too_short(where, f"{held} bytes of gzip", stored)
        kind, slope, inter = scaled_type(stored.dtype), float(proxy.slope), float(proxy.inter)
        scaled = Packing(stored.dtype, kind, slope, inter, np.empty(0))
        with (gzip.open if packed else open)(numbers, "rb") as stream:
            stream.seek(int(proxy.offset))
            return unpacker.stream(where, stream.read, stored, None if plain else scaled)


def _check_extensions(path: Path) -> None:
    """Refuse extensions of a header that go beyond it: the library reads each as a whole, whatever its length."""
    with opened(path) as file:
        room = max(NARROW, file.seek(0, 2))
        file.seek(0)
        packed = file.read(len(GZIP)) == GZIP
        file.seek(0)
        stream = gzip.GzipFile(fileobj=file) if packed else file
        head = stream.read(HEADER_2 + 4)
        order = "<" if head.startswith((struct.pack("<i", HEADER), struct.pack("<i", HEADER_2))) else ">"
        second = struct.unpack_from(f"{order}i", head)[0] == HEADER_2
        at, kind, place = (HEADER_2 + 4, "q", 168) if second else (HEADER + 4, "f", 108)
        end = int(struct.unpack_from(order + kind, head, place)[0])  # where the numbers begin
        if end > room:
            raise io_error("source-damaged", str(path), f"numbers that begin at byte {end}", f"a place up to {room}",
                           "correct its header")
        if any(head.startswith(magic, where) for where, magic in MAGICS[1::2]):  # they are in a file of their own
            end = room
        left = head[at - 4:at - 3] not in (b"", b"\0")
        while left and at + 16 <= end:
            stream.seek(at)
            said = stream.read(4)
            if len(said) < 4:
                return
            length = int(struct.unpack(f"{order}i", said)[0])
            if length < 8 or at + length > end:
                raise io_error("source-damaged", str(path), f"an extension of {length} bytes at byte {at}",
                               f"one that ends up to byte {end}", "correct its header")
            at += length


@contextmanager
def _quietly(nibabel: Any) -> Generator[None]:
    """Without what the library says of headers that it reads all the same."""
    logger = nibabel.imageglobals.logger
    before, logger.disabled = logger.disabled, True
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.disabled = before


def open_pair(path: Path, unpacker: Unpacker) -> NDArray[Any]:
    """Open what is called ``.hdr`` or ``.img``: an image of two files by that of its numbers.

    Raises:
        HmkctaError: it is Analyze, or something else; or what `open_nifti` raises.
    """
    beside = [each.with_suffix(ending) for each in (path, path.resolve()) for ending in (".hdr", ".HDR")]
    header = next((each for each in beside if each.exists()), path)
    with opened(header) as file:
        start = file.read(HEADER)
    if any(start.startswith(magic, at) for at, magic in MAGICS):
        return open_nifti(header, unpacker)
    if start.startswith(_HEADERS):
        raise ANALYZE.refusal(path)
    raise io_error("source-format", str(path), f"an {path.suffix} file without a NIfTI header", "NIfTI, or raw binary",
                   "say shape and dtype of raw binary, e.g. --shape 64,64,3 --dtype float32")


def open_gzip(path: Path, unpacker: Unpacker) -> NDArray[Any]:
    """Open what is told by gzip's magic bytes: a NIfTI image, no other format is packed so.

    Raises:
        HmkctaError: it is something else, or what `open_nifti` raises.
    """
    other = by_ending(path.name)
    if other is not None:
        raise other.refusal(path)
    if not path.name.lower().endswith((".nii.gz", ".img.gz", ".hdr.gz")):
        raise io_error("source-format", str(path), "gzip", "a format in itself, or .nii.gz", "unpack it: gunzip")
    return open_nifti(path, unpacker)
