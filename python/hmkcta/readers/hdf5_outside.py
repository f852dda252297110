"""Numbers of HDF5 datasets that lie in files beside: raw files, and the sources of virtual datasets.

HDF5 reads what is missing there as zeros or as the fill value, without a word, so that it is looked for before.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ..errors import invalid
from ..packing import Meant
from .source import Layout, io_error, map_part, opened
from .unpacked import Unpacker

#: Virtual datasets of virtual datasets of .. are followed so far.
DEPTH = 16


def outside_array(h5py: Any, dataset: Any, where: str, unpacker: Unpacker, view: Meant | None) -> NDArray[Any]:
    """A dataset whose numbers lie in raw files, one after another: mapped if it is one file, else unpacked.

    Raises:
        HmkctaError: a file is not there, could be either of two, or is too short; numbers of a type unknown to NumPy.
    """
    if dataset.id.get_type() != h5py.h5t.py_create(dataset.dtype, logical=True) or dataset.dtype.kind not in "biuf":
        raise invalid("source-dtype", f"number type of {where}", "one that raw files beside cannot be mapped in",
                      "a type of NumPy's", "copy it into the file: h5repack")
    made, layout = dataset.id.get_create_plist(), Layout(tuple(dataset.shape), dataset.dtype)
    pieces, left = list[tuple[Path, int, int]](), layout.nbytes
    for number in range(made.get_external_count()):
        name, offset, size = made.get_external(number)
        size = min(int(size), left)
        if size:
            pieces.append((_raw_file(Path(dataset.file.filename), os.fsdecode(name), where), int(offset), size))
            left -= size
    for path, offset, size in pieces:
        with opened(path) as file:
            held = file.seek(0, 2)
        if held < offset + size:
            raise io_error("source-truncated", str(path), f"{held} bytes", f"{offset + size} bytes, of which {where} "
                           "takes the last", "fetch it again")
    if left:
        raise io_error("source-truncated", where, f"{layout.nbytes - left} bytes of numbers in files beside",
                       f"{layout.nbytes} bytes for {layout}")
    if len(pieces) == 1:
        raw = map_part(pieces[0][0], layout, pieces[0][1], where)
    else:
        raw = unpacker.stream(where, _Pieces(pieces).read, layout)
    if view is None:
        return raw
    return unpacker.chunks(where, Meant(raw, view.dtype, view.convert), None)


@dataclass
class _Pieces:
    """Parts of files that follow one another."""

    pieces: list[tuple[Path, int, int]]
    at: int = 0
    used: int = 0

    def read(self, count: int) -> bytes:
        """So many bytes of those that come next, fewer at the end."""
        data = list[bytes]()
        while count and self.at < len(self.pieces):
            path, offset, size = self.pieces[self.at]
            with opened(path) as file:
                file.seek(offset + self.used)
                data.append(file.read(min(count, size - self.used)))
            count -= len(data[-1])
            self.used += len(data[-1])
            if self.used == size or not data[-1]:
                self.at, self.used = self.at + 1, 0
        return b"".join(data)


def _raw_file(own: Path, name: str, where: str) -> Path:
    """The raw file of a name: beside the file that names it, or where HDF5 looks, in the folder at hand.

    Raises:
        HmkctaError: it is in neither, or there is one in both.
    """
    prefix = os.environ.get("HDF5_EXTFILE_PREFIX", "").replace("${ORIGIN}", str(own.parent))
    if prefix:
        return Path(prefix) / name
    found = [path for path in (own.parent / name, Path(name)) if path.exists()]
    if not found:
        raise io_error("source-incomplete", where, f"no file {name}", "all files that hold its numbers",
                       f"put it beside {own.name}")
    if len(found) == 2 and not os.path.samefile(*found):
        both = f"a file {name} beside {own.name}, and another in the folder at hand"
        raise io_error("source-incomplete", where, both, "one file of this name",
                       "set HDF5_EXTFILE_PREFIX to the folder that is meant")
    return found[0]


def check_sources(h5py: Any, dataset: Any, where: str, depth: int = DEPTH) -> set[Path]:
    """The files of a virtual dataset; it is refused if a source is not there: its part would read as the fill value.

    Raises:
        HmkctaError: a file or a dataset in it is missing, or sources are nested too deeply.
    """
    if not depth:
        raise io_error("source-format", where, f"virtual datasets of virtual datasets, {DEPTH} deep", "fewer")
    own = Path(dataset.file.filename)
    files, wanted = {own}, {(source.file_name, source.dset_name) for source in dataset.virtual_sources()}
    for file_name, name in sorted(wanted):
        if "%b" in file_name + name:  # as many as there are
            continue
        file_name, name = file_name.replace("%%", "%"), name.replace("%%", "%")
        path = own if file_name == "." else _source_file(own, file_name)
        if path is None:
            raise _missing(where, f"no file {file_name}")
        files.add(path)
        with opened(path), h5py.File(path, "r") as file:
            source = file.get(name)
            if not isinstance(source, h5py.Dataset):
                raise _missing(where, f"no dataset {name} in {path}")
            if source.is_virtual:
                files |= check_sources(h5py, source, f"{path}:{name}", depth - 1)
            elif source.id.get_create_plist().get_external_count():
                raise io_error("source-format", where, f"{path}:{name}, whose numbers lie in raw files",
                               "sources that hold their numbers", "copy it into its file: h5repack")
    return files


def _source_file(own: Path, name: str) -> Path | None:
    """Where HDF5 finds a file that a virtual dataset names."""
    prefix = os.environ.get("HDF5_VDS_PREFIX", "").replace("${ORIGIN}", str(own.parent))
    places = [Path(prefix) / name if prefix else None, own.parent / name, Path(name), own.resolve().parent / name]
    return next((path for path in places if path is not None and path.exists()), None)


def _missing(where: str, found: str) -> Exception:
    return io_error("source-incomplete", where, found, "all sources of a virtual dataset", "fetch that one too")
