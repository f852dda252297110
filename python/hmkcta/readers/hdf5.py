"""HDF5 by h5py, and with it netCDF-4, MATLAB 7.3 and MINC 2: what lies in one piece is mapped, the rest unpacked."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

from numpy.typing import NDArray

from ..conventions import conversion
from ..errors import HmkctaError, invalid, sentence
from ..labels import labelled, labels_of
from ..support.optional import library
from .hdf5_chunks import WholeChunks
from .hdf5_members import members_of
from .hdf5_outside import check_sources, outside_array
from .source import Layout, choose, guarded, io_error, map_part, opened
from .unpacked import Unpacker

MAGIC = b"\x89HDF\r\n\x1a\n"
#: How MATLAB 7.3 begins its block before HDF5.
MATLAB = b"MATLAB 7.3"
#: The shortest block of the user's before HDF5; longer ones are twice, four times, .. as long.
USER_BLOCK = 512


def begins_behind_block(file: BinaryIO) -> bool:
    """Whether HDF5 begins behind a block of the user's, of whatever length it may have."""
    size, at = file.seek(0, 2), USER_BLOCK
    while at + len(MAGIC) <= size:
        file.seek(at)
        if file.read(len(MAGIC)) == MAGIC:
            return True
        at *= 2
    return False


def open_hdf5(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    """Open a dataset of an HDF5 file; by default the only one of numbers that is no coordinate of another.

    It may lie in another file, to which a link leads. MATLAB writes its arrays with the axes in reverse, so they are
    turned back.

    Raises:
        HmkctaError: h5py or a filter is missing, a file is damaged or missing, or has no or several such datasets.
    """
    h5py = library("h5py", "h5py", "hdf5", "HDF5")
    with guarded(path, "HDF5 file"), h5py.File(path, "r") as file:
        dataset, where = _dataset(h5py, file, str(path), member)
        is_matlab = "MATLAB_class" in dataset.attrs
        if dataset.shape is None or (is_matlab and dataset.attrs.get("MATLAB_empty")):
            raise invalid("source-shape", where, "a dataset without a shape", "1 to 8 axes")
        array = _array(h5py, where, dataset, unpacker)
        return array.T if is_matlab else labelled(array, labels_of(dataset))


def _dataset(h5py: Any, file: Any, path: str, member: str | None) -> tuple[Any, str]:
    """A dataset, and what errors call it: by the file and the path that were given."""
    within, start = file, "/"
    if member is not None:
        start = f"/{member.strip('/')}"
        within = file.get(start)
        if isinstance(within, h5py.Dataset):
            return within, f"{path}:{member}"
        if within is None and (link := _link(file, start)):
            raise io_error("source-incomplete", f"{path}:{member}", f"a link to {link}, which cannot be opened",
                           "a link to a dataset that is there", "put that file where the link says, or name another")
    found, unread = members_of(h5py, file, start if within is not None else "/")
    chosen = choose(path, found, start if within is None else None, unread)
    return file[chosen], f"{path}:{chosen}"


def _link(file: Any, name: str) -> str:
    """What a link that leads nowhere names; empty: there is none of this name."""
    with suppress(KeyError, ValueError, OSError, RuntimeError):
        link = file.get(name, getlink=True)
        return f"{getattr(link, 'filename', '')}:{getattr(link, 'path', '')}".removeprefix(":").removesuffix(":")
    return ""


def _array(h5py: Any, where: str, dataset: Any, unpacker: Unpacker) -> NDArray[Any]:
    made, view = dataset.id.get_create_plist(), conversion(dataset)
    with opened(Path(dataset.file.filename)):  # another than that of the path, where a link leads to it
        pass
    if made.get_external_count():
        return outside_array(h5py, dataset, where, unpacker, view)
    offset = _offset(h5py, dataset, made)
    if view is None and offset is not None:
        return map_part(Path(dataset.file.filename), Layout(dataset.shape, dataset.dtype), offset, where)
    missing = _missing_filters(h5py, made)
    files = check_sources(h5py, dataset, where) if dataset.is_virtual else {Path(dataset.file.filename)}
    unpacker.check_widened(where, dataset.size * dataset.dtype.itemsize, sum(path.stat().st_size for path in files))
    stored = WholeChunks(dataset, where) if dataset.chunks and not missing else dataset
    try:
        return unpacker.chunks(where, replace(view, stored=stored) if view else stored, dataset.chunks)
    except OSError as error:
        if missing:
            raise invalid("hdf5plugin-missing", f"filter of {where}", f"{', '.join(missing)}, which is not installed",
                          "a filter that h5py has", "pip install hdf5plugin") from error
        raise io_error("source-damaged", where, sentence(error), "a dataset that can be read") from error


def _offset(h5py: Any, dataset: Any, made: Any) -> int | None:
    """Where in its file a dataset lies as NumPy would have it; None: it does not."""
    if made.get_layout() != h5py.h5d.CONTIGUOUS or dataset.dtype.kind not in "biuf":
        return None
    # A type of 12 bits, or of another float format, is converted by the library.
    if dataset.id.get_type() != h5py.h5t.py_create(dataset.dtype, logical=True):
        return None
    return dataset.id.get_offset()


def _missing_filters(h5py: Any, made: Any) -> list[str]:
    """Names of filters that the library has not, even with hdf5plugin where that is installed."""
    filters = [made.get_filter(number) for number in range(made.get_nfilters())]
    if any(not h5py.h5z.filter_avail(code) for code, *_ in filters):
        with suppress(HmkctaError):  # it brings a dozen filters, and registers them when it is imported
            library("hdf5plugin", "hdf5plugin", "hdf5", "HDF5 filters")
    return [f"{name.decode('utf-8', 'replace') or 'number'} {code}" for code, _, _, name in filters
            if not h5py.h5z.filter_avail(code)]
