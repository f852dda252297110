"""TIFF by tifffile: a stack that lies in one piece is mapped, any other unpacked page by page."""

from __future__ import annotations

import logging
from collections.abc import Generator
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError, invalid
from ..support.optional import library
from .source import Layout, choose, guarded, io_error, map_part
from .unpacked import Part, Unpacker, block_parts

MAGICS = ((0, b"II*\0"), (0, b"MM\0*"), (0, b"II+\0"), (0, b"MM\0+"))


def open_tiff(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    """Open a TIFF file: page (of several), y, x, channel (of several), or the axes that its series says.

    Pages of another shape or type are a series of their own, counted from 0: ``file.tif:1``.

    Raises:
        HmkctaError: tifffile or imagecodecs is missing, the file is damaged, or has several series and none is chosen.
    """
    tifffile = library("tifffile", "tifffile", "tiff", "TIFF")
    with guarded(path, "TIFF file"), _strictly(), tifffile.TiffFile(str(path)) as file:
        series = {str(number): each for number, each in enumerate(file.series)}
        shapes = {number: str(Layout(tuple(each.shape), np.dtype(each.dtype))) for number, each in series.items()}
        chosen = series[choose(str(path), shapes, member)]
        layout = Layout(tuple(chosen.shape), np.dtype(chosen.dtype))
        if chosen.dataoffset is not None:
            ordered = layout.dtype.newbyteorder(file.byteorder)
            return map_part(path, Layout(layout.shape, ordered), int(chosen.dataoffset), str(path))
        return _pages(chosen, layout, str(path), unpacker)


@contextmanager
def _strictly() -> Generator[None]:
    """Make errors of what the library only logs: pages that are not there, of which it would leave out the rest."""
    said: list[str] = []
    handler = logging.Handler(logging.ERROR)
    handler.emit = lambda record: said.append(record.getMessage())
    logger = logging.getLogger("tifffile")
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
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
