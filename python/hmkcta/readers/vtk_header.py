"""Headers of VTK's XML files of regular grids: what arrays they hold, and where in the file their numbers are."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO
from xml.parsers import expat

from .source import io_error

#: Bytes that are parsed at once, looked through for the end of the file, or passed over before appended numbers.
BLOCK, TAIL = 1 << 16, 1 << 12
GRIDS = ("ImageData", "RectilinearGrid")
POINTS, CELLS, COORDINATES = "PointData", "CellData", "Coordinates"
_END = re.compile(rb"</VTKFile>\s*$")


@dataclass
class Stored:
    """An array as the file has it.

    Attributes:
        place: the element that holds it, `POINTS`, `CELLS` or `COORDINATES`.
        attributes: of its own element.
        begin: where in the file its numbers begin, of those that are not appended.
        end: where they end.
    """

    place: str
    attributes: dict[str, str]
    begin: int = -1
    end: int = -1


@dataclass
class VtkHeader:
    """What a file says of its grid.

    Attributes:
        file: attributes of the whole file: type of the grid, byte order, compressor.
        grid: attributes of the grid.
        pieces: attributes of each of its pieces.
        arrays: of points, cells and coordinates.
        encoding: of appended numbers, ``raw`` or ``base64``; empty: there are none.
        appended: where these begin.
    """

    file: dict[str, str] = field(default_factory=dict[str, str])
    grid: dict[str, str] = field(default_factory=dict[str, str])
    pieces: list[dict[str, str]] = field(default_factory=list[dict[str, str]])
    arrays: list[Stored] = field(default_factory=list[Stored])
    encoding: str = ""
    appended: int = -1


class _Appended(Exception):
    """What follows is no XML any more."""


class _Parser:
    """Notes elements and the places of their contents; no text is kept."""

    def __init__(self) -> None:
        self.header = VtkHeader()
        self._within: list[str] = []
        self._open: Stored | None = None
        self._parser: Any = expat.ParserCreate()
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._text
        self._parser.StartDoctypeDeclHandler = self._refuse

    def parse(self, file: BinaryIO) -> None:
        """Parse a file up to its appended numbers, or to its end."""
        try:
            while block := file.read(BLOCK):
                self._parser.Parse(block, False)
            self._parser.Parse(b"", True)
        except _Appended:
            at = self.header.appended
            file.seek(at)
            start = file.read(BLOCK)
            self.header.appended = at + start.index(b"_", start.index(b">")) + 1

    def _refuse(self, *_: object) -> None:
        raise ValueError("a document type, which no such file has")

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self._close()
        header = self.header
        if name == "VTKFile":
            header.file = attributes
        elif self._within == ["VTKFile"] and name in GRIDS:
            header.grid = attributes
        elif name == "Piece":
            header.pieces.append(attributes)
        elif name == "DataArray" and self._within and self._within[-1] in (POINTS, CELLS, COORDINATES):
            self._open = Stored(self._within[-1], attributes)
            header.arrays.append(self._open)
        elif name == "AppendedData":
            header.encoding = attributes.get("encoding", "base64")
            header.appended = self._parser.CurrentByteIndex
            raise _Appended
        self._within.append(name)

    def _text(self, _: str) -> None:
        if self._open is not None and self._open.begin < 0:
            self._open.begin = self._parser.CurrentByteIndex

    def _end(self, _: str) -> None:
        self._close()
        self._within.pop()

    def _close(self) -> None:
        """Note where the text of an array ends: where its element does, or another begins in it."""
        if self._open is not None:
            self._open.end = self._parser.CurrentByteIndex
            self._open.begin = self._open.end if self._open.begin < 0 else self._open.begin
        self._open = None


def vtk_header(file: BinaryIO, path: Path) -> VtkHeader:
    """The header of a file of a regular grid in one piece.

    Raises:
        HmkctaError: it is cut, goes on behind its end, or is of another kind.
        ValueError, expat.ExpatError: it is damaged.
    """
    parser = _Parser()
    parser.parse(file)
    header, where = parser.header, str(path)
    kind = header.file.get("type", "nothing")
    if kind not in GRIDS:
        raise io_error("source-format", where, f"VTK's {kind}, which is not read", f"{' or '.join(GRIDS)} (.vti, .vtr)",
                       "pyvista and ParaView read it; resample it to an image, or save an array of it by numpy.save")
    file.seek(max(0, file.seek(0, os.SEEK_END) - TAIL))
    if not _END.search(file.read()):
        raise io_error("source-truncated", where, "no </VTKFile> at its end", "a complete file", "fetch it again")
    compressor = header.file.get("compressor", "")
    if compressor not in ("", "vtkZLibDataCompressor"):
        raise io_error("source-format", where, f"numbers packed by {compressor}", "vtkZLibDataCompressor, or none",
                       "write it anew with writer.SetCompressorTypeToZLib()")
    whole = header.grid.get("WholeExtent", "").split()
    if [piece.get("Extent", "").split() for piece in header.pieces] != [whole]:
        raise io_error("source-format", where, f"a grid in {len(header.pieces)} pieces", "one, of all of it",
                       "write it in one piece: ParaView's Save Data of the merged grid")
    return header
