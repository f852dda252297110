"""Zarr 2 and 3 by zarr-python: folders and zip archives, unpacked by chunks."""

from __future__ import annotations

import json
import os
import warnings
import zipfile
from collections import defaultdict
from collections.abc import Callable, Generator, Iterator, Sequence, Set
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..conventions import conversion
from ..errors import sentence
from ..labels import labelled, labels_of
from ..packing import text_of
from ..support.optional import library
from .source import Layout, choose, guarded
from .unpacked import NARROW, Unpacker

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
    with guarded(path, "Zarr store"), warnings.catch_warnings(), ExitStack() as stack:
        warnings.simplefilter("ignore")  # on what other libraries might make of it
        if path.is_dir():
            store, root, names = zarr.storage.LocalStore(str(path), read_only=True), "", list(_in_folder(path))
        else:
            store, root = stack.enter_context(_opened_zip(zarr, path)), _root(path) or ""
            names = list(_in_archive(path, root))

        def opened_array(name: str) -> Any:
            return zarr.open_array(store, path="/".join(word for word in (root, name) if word), mode="r")

        name = _chosen(opened_array, names, str(path), member)
        array, where = opened_array(name), f"{path}:{name}" if name else str(path)
        layout = Layout(tuple(array.shape), np.dtype(array.dtype))
        if layout.nbytes > NARROW:  # many files are counted
            unpacker.check_widened(where, layout.nbytes, _held(path / name))
        return _array(array, where, unpacker)


def _held(path: Path) -> int:
    """Bytes of all files of an array, or of the archive in which it lies."""
    if not path.is_dir():
        return next(each for each in (path, *path.parents) if each.exists()).stat().st_size
    return sum(os.stat(os.path.join(place, name)).st_size for place, _, names in os.walk(path) for name in names)


@contextmanager
def _opened_zip(zarr: Any, path: Path) -> Generator[Any]:
    store = zarr.storage.ZipStore(str(path), mode="r")
    try:
        yield store
    finally:
        store.close()


def _in_folder(folder: Path) -> Iterator[str]:
    """Paths of the arrays in a folder, whose links are followed; what is in an array are its chunks."""
    waiting, seen = [""], set[tuple[int, int]]()
    while waiting:
        name = waiting.pop()
        status = os.stat(folder / name)
        if (status.st_dev, status.st_ino) in seen:
            continue
        seen.add((status.st_dev, status.st_ino))
        try:
            with os.scandir(folder / name) as entries:
                is_folder = {entry.name: entry.is_dir() for entry in entries}
        except PermissionError:
            yield name  # opening it says so, and the others are still found
            continue
        files = {each for each, folders in is_folder.items() if not folders}
        if _is_array(files, (folder / name / "zarr.json").read_bytes):
            yield name
        else:
            waiting += [f"{name}/{each}".lstrip("/") for each in sorted(is_folder.keys() - files)]


def _in_archive(path: Path, root: str) -> Iterator[str]:
    """The same of a zip archive, in whose folder `root` the store begins."""
    with zipfile.ZipFile(path) as archive:
        files = defaultdict[str, set[str]](set)
        for place in archive.namelist():
            folder, _, name = place.rpartition("/")
            if name in MARKS and (not root or folder == root or folder.startswith(f"{root}/")):
                files[folder].add(name)
        for folder, names in files.items():
            if _is_array(names, lambda folder=folder: archive.read(f"{folder}/zarr.json".lstrip("/"))):
                yield folder.removeprefix(root).lstrip("/")


def _is_array(files: Set[str], metadata: Callable[[], bytes]) -> bool:
    """Whether there are metadata of an array among the files of a folder, or some of version 3 that nobody can read."""
    if "zarr.json" not in files:
        return ".zarray" in files
    try:
        return json.loads(metadata())["node_type"] != "group"
    except Exception:  # of the archive, or of what is no JSON object; opening it will say which
        return True


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


def _chosen(opened_array: Callable[[str], Any], names: Sequence[str], where: str, member: str | None) -> str:
    """The path of an array in the store; each is looked at by itself, as one that is damaged may stand beside it."""
    wanted = None if member is None else member.strip("/")
    if wanted and wanted in names:
        return wanted
    found, aside, unread = dict[str, str](), set[str](), dict[str, str]()
    for name in names:
        try:
            item = opened_array(name)
            found[name] = str(Layout(item.shape, np.dtype(item.dtype)))
            folder = name.rpartition("/")[0]
            aside |= {f"{folder}/{word}".lstrip("/") for attribute in ("coordinates", "bounds")
                      for word in text_of(item.attrs.get(attribute)).split()}
            aside |= {name} if _is_coordinate(name, item) else set()
        except Exception as error:  # of a codec or a type that is not known here, or of damaged metadata
            unread[name or "/"] = sentence(error)
    if wanted is None:
        return choose(where, {name: text for name, text in found.items() if name not in aside} or found, None, unread)
    named = {name: text for name, text in found.items() if name}  # not a store that is one array
    return choose(where, named, wanted, unread)


def _is_coordinate(name: str, array: Any) -> bool:
    """Whether it is the scale of an axis, as xarray writes one: along itself."""
    along = getattr(array.metadata, "dimension_names", None) or array.attrs.get("_ARRAY_DIMENSIONS")
    return list(along or ()) == [name.rpartition("/")[2]]


def _array(array: Any, where: str, unpacker: Unpacker) -> NDArray[Any]:
    numbers = unpacker.chunks(where, conversion(array) or array, array.shards or array.chunks)
    return labelled(numbers, labels_of(array))
