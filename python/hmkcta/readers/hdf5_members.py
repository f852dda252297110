"""What datasets there are in an HDF5 file and behind its links, and what cannot be read of them, and why."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from ..errors import sentence
from ..packing import text_of
from .source import Layout


def members_of(h5py: Any, file: Any, start: str) -> tuple[dict[str, str], dict[str, str]]:
    """Datasets of numbers below a group, by their paths, with shape and type; and what cannot be read, with why not.

    Links are followed, into other files, too. What has several paths comes once, under its own before those of links.
    Coordinates are left out where there is something else.
    """
    found: dict[str, str] = {}
    unread: dict[str, str] = {}
    aside: set[str] = set()
    seen: set[tuple[Any, ...]] = set()
    waiting, links = deque([start]), deque[str]()
    while waiting or links:
        path = (waiting or links).popleft()
        try:
            item = file[path]
            if (mark := _identity(h5py, item)) in seen:
                continue
            seen.add(mark)
            if isinstance(item, h5py.Dataset):
                if _is_data(item, path):
                    found[path] = str(Layout(item.shape, item.dtype))
                    aside |= {word for name in ("coordinates", "bounds") for word in
                              text_of(item.attrs.get(name)).split()}
            elif isinstance(item, h5py.Group):
                for name, is_link in _names(h5py, item, path, unread):
                    (links if is_link else waiting).append(name)
        except Exception as error:  # whatever the library makes of a damaged header; the others are not its fault
            unread[path] = _why(h5py, file, path, error)
    main = {path: text for path, text in found.items() if path.rpartition("/")[2] not in aside}
    return main or found, unread


def _names(h5py: Any, group: Any, path: str, unread: dict[str, str]) -> Iterator[tuple[str, bool]]:
    """Paths of what a group holds, and whether each is a link to something that has a path of its own."""
    try:
        for name in group:
            link = group.get(name, getlink=True)
            yield f"{path.rstrip('/')}/{name}", not isinstance(link, h5py.HardLink)
    except (KeyError, OSError, RuntimeError, ValueError) as error:
        unread[path] = f"a group, {sentence(error)}"


def _identity(h5py: Any, item: Any) -> tuple[Any, ...]:
    """What tells an object from all others, whatever links lead to it: its file, and its place there."""
    name = os.fsdecode(h5py.h5f.get_name(item.id))
    place = h5py.h5o.get_info(item.id).addr
    with suppress(OSError):
        status = os.stat(name)
        return status.st_dev, status.st_ino, place
    return name, place


def _why(h5py: Any, file: Any, path: str, error: Exception) -> str:
    with suppress(KeyError, OSError, RuntimeError, ValueError):
        link = file.get(path, getlink=True)
        if isinstance(link, h5py.ExternalLink):
            return f"a link to {link.path} in {link.filename}, which cannot be opened"
        if isinstance(link, h5py.SoftLink):
            return f"a link to {link.path}, which is not there"
    return sentence(error)


def _is_data(dataset: Any, path: str) -> bool:
    """Whether it holds numbers that are no scale of an axis, no text, and nothing of MATLAB's or MINC's own."""
    matlab = dataset.attrs.get("MATLAB_class", b"double")
    folder, _, name = path.rpartition("/")
    of_minc = "/minc-2.0/dimensions" in folder or (name in ("image-min", "image-max") and "image" in dataset.parent)
    return (dataset.dtype.kind in "biuf" and dataset.ndim > 0 and dataset.size > 0 and not dataset.is_scale
            and not path.startswith("/#") and not of_minc and matlab not in (b"char", b"cell")
            and not dataset.attrs.get("MATLAB_empty"))
