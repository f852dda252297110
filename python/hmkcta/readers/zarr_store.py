"""Zarr 2 and 3 by zarr-python: folders and zip archives, unpacked by chunks."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..conventions import packing, zarr_attributes
from ..support.optional import library
from .source import Layout, choose, guarded
from .unpacked import Unpacker

#: Files of which every Zarr array or group has one.
MARKS = ("zarr.json", ".zarray", ".zgroup")


def is_zarr(path: Path) -> bool:
    """Whether a folder or a zip archive is a Zarr array or group."""
    if path.is_dir():
        return any(os.path.isfile(path / mark) for mark in MARKS)  # False also where the folder may not be read
    return _root(path) is not None


def open_zarr(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    """Open an array of a Zarr store; by default the only one that is no coordinate.

    Chunks that are not there are the fill value, as Zarr defines it.

    Raises:
        HmkctaError: zarr is missing, the store is damaged, or has no or several such arrays.
    """
    zarr = library("zarr", "zarr", "zarr", "Zarr")
    with guarded(path, "Zarr store"):
        if path.is_dir():
            return _array(_chosen(zarr, zarr.open(str(path), mode="r"), str(path), member), str(path), unpacker)
        store = zarr.storage.ZipStore(str(path), mode="r")
        try:
            found = zarr.open(store, path=_root(path) or "", mode="r")
            return _array(_chosen(zarr, found, str(path), member), str(path), unpacker)
        finally:
            store.close()


def _root(path: Path) -> str | None:
    """Where in a zip archive the store begins: at its top, or in the folder that was packed."""
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except (zipfile.BadZipFile, OSError, ValueError, RuntimeError):  # whoever reads it says what is wrong
        return None
    places = [name.removesuffix(mark).rstrip("/") for name in names for mark in MARKS
              if name == mark or name.endswith(f"/{mark}")]
    return min(places, key=len) if places else None


def _chosen(zarr: Any, found: Any, where: str, member: str | None) -> Any:
    if isinstance(found, zarr.Array) and member is None:
        return found
    held = dict(found.members(max_depth=None)) if isinstance(found, zarr.Group) else {}
    arrays = {name: item for name, item in held.items() if isinstance(item, zarr.Array)}
    if member is None:
        arrays = {name: item for name, item in arrays.items() if not _is_coordinate(name, item)} or arrays
    shapes = {name: str(Layout(item.shape, np.dtype(item.dtype))) for name, item in arrays.items()}
    return arrays[choose(where, shapes, None if member is None else member.strip("/"))]


def _is_coordinate(name: str, array: Any) -> bool:
    """Whether it is the scale of an axis, as xarray writes one: along itself."""
    along = getattr(array.metadata, "dimension_names", None) or array.attrs.get("_ARRAY_DIMENSIONS")
    return list(along or ()) == [name.rpartition("/")[2]]


def _array(array: Any, path: str, unpacker: Unpacker) -> NDArray[Any]:
    where = f"{path}:{array.path}" if array.path else path
    convert = packing(zarr_attributes(array), np.dtype(array.dtype))
    return unpacker.chunks(where, array, array.shards or array.chunks, convert)
