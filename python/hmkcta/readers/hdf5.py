"""HDF5 by h5py, and with it netCDF-4 and MATLAB 7.3: a dataset that lies in one piece is mapped, any other unpacked."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ..conventions import packing
from ..errors import HmkctaError, invalid
from ..support.optional import library
from .source import Layout, choose, guarded, io_error, map_part, reading
from .unpacked import Unpacker

MAGIC = b"\x89HDF\r\n\x1a\n"


def open_hdf5(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    """Open a dataset of an HDF5 file; by default the only one of numbers that is no coordinate of another.

    MATLAB writes its arrays with the axes in reverse, so they are turned back.

    Raises:
        HmkctaError: h5py or a filter is missing, the file is damaged, or has no or several such datasets.
    """
    h5py = library("h5py", "h5py", "hdf5", "HDF5")
    with guarded(path, "HDF5 file"), h5py.File(path, "r") as file:
        dataset = _dataset(h5py, file, str(path), member)
        if dataset.shape is None:
            raise invalid("source-shape", f"{path}:{dataset.name}", "a dataset without a shape", "1 to 8 axes")
        array = _array(h5py, path, dataset, unpacker)
        return array.T if "MATLAB_class" in dataset.attrs else array


def _dataset(h5py: Any, file: Any, where: str, member: str | None) -> Any:
    within = file
    if member is not None:
        within = file.get(member.strip("/") or "/")
        if isinstance(within, h5py.Dataset):
            return within
    found: dict[str, Any] = {}

    def note(_: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and _is_data(item):
            found[str(item.name)] = item

    (file if within is None else within).visititems(note)
    if member is None:
        aside = {word for item in found.values() for name in ("coordinates", "bounds")
                 for word in str(item.attrs.get(name, "")).split()}
        found = {name: item for name, item in found.items() if name.rpartition("/")[2] not in aside} or found
    shapes = {name: str(Layout(item.shape, item.dtype)) for name, item in found.items()}
    return found[choose(where, shapes, member if within is None else None)]


def _is_data(dataset: Any) -> bool:
    """Whether it holds numbers that are no scale of an axis, no text, and none of MATLAB's own."""
    matlab = dataset.attrs.get("MATLAB_class", b"double")
    return (dataset.dtype.kind in "biuf" and dataset.ndim > 0 and dataset.size > 0 and not dataset.is_scale
            and not dataset.name.startswith("/#") and matlab not in (b"char", b"cell"))


def _array(h5py: Any, path: Path, dataset: Any, unpacker: Unpacker) -> NDArray[Any]:
    where = f"{path}:{dataset.name}"
    convert = packing(dataset.attrs, dataset.dtype)
    for file in _files(dataset):
        reading(file)
    offset = _offset(h5py, dataset)
    if convert is None and offset is not None:
        return map_part(path, Layout(dataset.shape, dataset.dtype), offset, where)
    missing = _missing_filters(h5py, dataset)
    if dataset.is_virtual:
        _check_sources(dataset, path, where)
    try:
        return unpacker.chunks(where, dataset, dataset.chunks, convert)
    except OSError as error:
        if not missing:
            raise
        raise invalid("hdf5plugin-missing", f"filter of {where}", f"{', '.join(missing)}, which is not installed",
                      "a filter that h5py has", "pip install hdf5plugin") from error


def _offset(h5py: Any, dataset: Any) -> int | None:
    """Where in the file a dataset lies as NumPy would have it; None: it does not."""
    made = dataset.id.get_create_plist()
    if made.get_layout() != h5py.h5d.CONTIGUOUS or made.get_external_count() or dataset.dtype.kind not in "biuf":
        return None
    # A type of 12 bits, or of another float format, is converted by the library.
    if dataset.id.get_type() != h5py.h5t.py_create(dataset.dtype, logical=True):
        return None
    return dataset.id.get_offset()


def _files(dataset: Any) -> list[Path]:
    """The files in which the numbers of a dataset lie, so far as it names them."""
    own, made = Path(dataset.file.filename), dataset.id.get_create_plist()
    external = [os.fsdecode(made.get_external(number)[0]) for number in range(made.get_external_count())]
    virtual = [each.file_name for each in dataset.virtual_sources()] if dataset.is_virtual else []
    return [own, *(own.parent / name for name in (*external, *virtual) if name != "." and "%" not in name)]


def _check_sources(dataset: Any, path: Path, where: str) -> None:
    """Refuse a virtual dataset of which a file is not there: its part would read as the fill value."""
    for source in dataset.virtual_sources():
        if source.file_name != "." and "%" not in source.file_name and not (path.parent / source.file_name).exists():
            raise io_error("source-incomplete", where, f"no file {source.file_name}", "all files of a virtual dataset",
                           "fetch that one too")


def _missing_filters(h5py: Any, dataset: Any) -> list[str]:
    """Names of filters that the library has not, even with hdf5plugin where that is installed."""
    made = dataset.id.get_create_plist()
    filters = [made.get_filter(number) for number in range(made.get_nfilters())]
    if any(not h5py.h5z.filter_avail(code) for code, *_ in filters):
        with suppress(HmkctaError):  # it brings a dozen filters, and registers them when it is imported
            library("hdf5plugin", "hdf5plugin", "hdf5", "HDF5 filters")
    return [f"{name.decode('utf-8', 'replace') or 'number'} {code}" for code, _, _, name in filters
            if not h5py.h5z.filter_avail(code)]

