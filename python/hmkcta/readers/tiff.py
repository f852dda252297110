"""TIFF by tifffile: a stack that lies in one piece is mapped, any other unpacked page by page.

Axes are those of tifffile's series, but for the samples of planes, which come last as those of pixels do.
"""

from __future__ import annotations

import logging
import re
import warnings
from collections.abc import Generator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError, invalid
from ..labels import named
from ..support.optional import library
from .source import Layout, choose, guarded, io_error, map_part, reading
from .tiff_scaling import as_meant
from .unpacked import BLOCK, Part, Unpacker, block_parts

#: Names of axes by tifffile's letters; others get tifffile's own words.
_NAMES = {"X": "x", "Y": "y", "Z": "z", "T": "t", "C": "channel", "I": "page"}
#: Values of PhotometricInterpretation, and of Compression.
_RGB, _PALETTE, _YCC, _JPEG = 2, 3, 6, 7
#: Planes that OME-TIFF may say to have; a file of as many would have directories of 100 MiB.
MOST_PLANES = 1 << 20
MAGICS = ((0, b"II*\0"), (0, b"MM\0*"), (0, b"II+\0"), (0, b"MM\0+"))


def open_tiff(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    """Open a TIFF file: page (of several), y, x, channel (of several), or the axes that its series says.

    Palettes are looked up, but for those of ImageJ, which only say how its numbers are shown. Pages of another shape or
    type are a series of their own, counted from 0: ``file.tif:1``. Calibrations of ImageJ and GDAL are applied.

    Raises:
        HmkctaError: tifffile or imagecodecs is missing, the file is damaged, or has several series and none is chosen.
    """
    tifffile = library("tifffile", "tifffile", "tiff", "TIFF")
    with guarded(path, "TIFF file"), _strictly(), tifffile.TiffFile(str(path)) as file:
        _check_planes(file, path)
        series = {str(number): each for number, each in enumerate(file.series)}
        shapes = {number: str(Layout(tuple(each.shape), np.dtype(each.dtype))) for number, each in series.items()}
        chosen = series[choose(str(path), shapes, member)]
        _check_samples(chosen.keyframe, path)
        layout = Layout(tuple(chosen.shape), np.dtype(chosen.dtype))
        holders = _holders(chosen, path)
        if _has_palette(chosen.keyframe):
            array = _looked_up(chosen, layout, str(path), unpacker)
        elif len(holders) == 1 and chosen.dataoffset is not None:
            ordered = layout.dtype.newbyteorder(chosen.keyframe.parent.byteorder)
            array = map_part(holders.pop(), Layout(layout.shape, ordered), int(chosen.dataoffset), str(path))
        else:
            array = _pages(chosen, layout, str(path), unpacker)
        array = as_meant(array, chosen.keyframe, file.imagej_metadata, str(path), unpacker)
        return _with_axes(array, chosen)


def _check_planes(file: Any, path: Path) -> None:
    """Refuse OME-TIFF that says to have more planes than anything holds: the library sets room aside for each."""
    pixels = re.findall(r"<(?:\w+:)?Pixels\s[^>]*>", file.ome_metadata or "")
    planes = sum(prod(int(size) for size in re.findall(r"\bSize[ZCT]\s*=\s*[\"'](\d{1,18})[\"']", each))
                 for each in pixels)
    if planes > MOST_PLANES:
        raise io_error("source-damaged", str(path), f"{planes} planes, by its header", f"up to {MOST_PLANES}",
                       "correct its OME-XML")


def _holders(series: Any, named: Path) -> set[Path]:
    """The files in which the pages of a series lie, of OME-TIFF perhaps others than the one named."""
    pages = [page for page in series.pages if page is not None] if series.is_multifile else [series.keyframe]
    found = {Path(page.parent.filehandle.path) for page in pages}
    files = {named if path == named.absolute() else path for path in found}
    for path in files:
        reading(path)
    return files


def tiff_depth(path: Path) -> str:
    """Bits of a number on the first page, of which a stack has one.

    Raises:
        HmkctaError: tifffile is missing, or the file is damaged.
    """
    tifffile = library("tifffile", "tifffile", "tiff", "TIFF")
    with guarded(path, "TIFF file"), _strictly(), tifffile.TiffFile(str(path)) as file:
        return f"{file.pages.first.bitspersample} bits"


def _check_samples(page: Any, path: Path) -> None:
    """Refuse samples that differ in their bits: the library would spread them over 8."""
    bits = page.bitspersample
    if isinstance(bits, tuple):
        raise io_error("source-format", str(path), f"samples of {', '.join(map(str, cast('Any', bits)))} bits",
                       "samples of as many bits each", "save it with 8 or 16 bits a sample")


def _has_palette(page: Any) -> bool:
    return page.photometric == _PALETTE and not page.is_imagej and page.colormap is not None


def _with_axes(array: NDArray[Any], series: Any) -> NDArray[Any]:
    """The array with its axes named, and the samples of a pixel last, also where they lie plane by plane."""
    letters = series.axes if array.ndim == len(series.axes) else series.axes + "S"  # colours of a palette
    at, page = letters.find("S"), series.keyframe
    if at >= 0:
        letters, array = letters.replace("S", "", 1) + "S", np.moveaxis(array, at, -1)
    rgb = page.photometric in (_RGB, _PALETTE) or (page.photometric == _YCC and page.compression == _JPEG)
    last = "rgb" if rgb and array.shape[-1] in (3, 4) else "colour"
    names = [last if letter == "S" else _NAMES.get(letter, f"axis{n}") for n, letter in enumerate(letters)]
    return named(array, tuple(names))


def _looked_up(series: Any, layout: Layout, where: str, unpacker: Unpacker) -> NDArray[Any]:
    """The colours of a picture that has a palette: of 8 bits where it has no more, else of 16."""
    pages = [page.aspage() for page in series.pages if page is not None]
    tables = [np.asarray(page.colormap, np.uint16) for page in pages]
    if any(not np.array_equal(table, tables[0]) for table in tables) or pages[0].samplesperpixel != 1:
        raise io_error("source-format", where, "several palettes, or a palette with other channels", "one palette",
                       "save it in RGB")
    table = tables[0]
    short = np.array_equal(table // 257 * 257, table) or np.array_equal(table // 256 * 256, table)
    table = (table >> 8).astype(np.uint8) if short else table
    indices = _pages(series, layout, where, unpacker)
    colours = Layout((*layout.shape, 3), table.dtype)
    parts = block_parts(colours.shape, [1] * len(colours.shape), BLOCK)
    return unpacker.array(where, colours, parts, lambda part: table.T[indices[part[:-1]]][..., part[-1]])


@contextmanager
def _strictly() -> Generator[None]:
    """Make errors of what the library only logs: pages that are not there, of which it would leave out the rest.

    Its warnings are of what it does all the same, such as reading pages of a file that it opens anew.
    """
    said: list[str] = []
    handler = logging.Handler(logging.ERROR)
    handler.emit = lambda record: said.append(record.getMessage())
    logger = logging.getLogger("tifffile")
    logger.addHandler(handler)
    logger.propagate, propagated = False, logger.propagate
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logger.removeHandler(handler)
        logger.propagate = propagated
    for message in said:
        if "TiffTag.fromfile" not in message:  # tags of some vendor's own that are not understood
            raise ValueError(message)


def _pages(series: Any, layout: Layout, where: str, unpacker: Unpacker) -> NDArray[Any]:
    """The pages of a series, of which each is decoded at once."""
    pages, page = list(series.pages), tuple(series.pages[0].shape)
    lead = layout.shape[:len(layout.shape) - len(page)]
    if None in pages:  # which the library would fill with zeros
        found, said = f"{len(pages) - pages.count(None)} pages", f"{len(pages)}, as it says"
        raise io_error("source-incomplete", where, found, said,
                       "fetch it again, or write the pages that are there as a file of their own")
    paged = layout.shape[len(lead):] == page and prod(lead) == len(pages)
    unpacker.check_widened(where, layout.nbytes, sum(each.stat().st_size for each in _holders(series, Path(where))))
    once = Layout(page, layout.dtype) if paged else layout
    unpacker.check_memory(once, f"a page of {where}", "write it uncompressed: that is mapped")

    def read(part: Part) -> NDArray[Any]:
        if not paged:
            return series.asarray()
        number = np.ravel_multi_index([span.start for span in part[:len(lead)]], lead) if lead else 0
        return pages[int(number)].asarray()

    chunks = [1] * len(lead) + [*page] if paged else layout.shape
    try:
        return unpacker.array(where, layout, block_parts(layout.shape, chunks, 1), read)
    except ValueError as error:
        raise _coded(error, where) from error


def _coded(error: ValueError, where: str) -> HmkctaError | ValueError:
    """The error that says what to install, if it is that."""
    if "imagecodecs" not in str(error):
        return error
    found = f"{str(error).partition(' ')[0]}, for which imagecodecs is missing"
    return invalid("imagecodecs-missing", f"compression of {where}", found, "imagecodecs", 'pip install "hmkcta[tiff]"')
