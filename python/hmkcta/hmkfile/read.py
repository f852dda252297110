"""Read a file into memory: nothing is believed before it is checked, and no damage goes unnoticed."""

from __future__ import annotations

import os
import stat
from collections.abc import Generator
from contextlib import contextmanager
from io import FileIO
from typing import Any, NamedTuple

from ..errors import HmkctaError, expect, shown
from ..packed import Metadata, PackedLevel
from ..support.memory import check_memory
from .check import check_largest, check_nodes, check_reach, reach_of
from .coding import decode_stage, root_places
from .container import Held, Section, header_end, header_text, lay_out, payload
from .fields import parse_json
from .limits import DEFAULT_LIMITS, Limits
from .lookalikes import START
from .metadata import Parsed, from_json
from .reasons import fault

#: What a file holds: the metadata, and the arrays of each stage.
Loaded = tuple[Metadata, tuple[PackedLevel, ...]]


class Frame(NamedTuple):
    """A file's header and its sections: coordinates, then stage by stage its runs."""

    parsed: Parsed
    header: int
    coords: list[Section]
    runs: list[list[Section]]


def load(path: str | os.PathLike[str], *, verify: bool = True, limits: Limits = DEFAULT_LIMITS) -> Loaded:
    """Read a file; `verify`: compare the checksums of its sections.

    Raises:
        HmkctaError: it is missing, damaged, of a later version, or beyond the limits.
    """
    with open_regular(path) as file:
        return load_open(file, path, verify=verify, limits=limits)


def load_open(
    file: FileIO, path: str | os.PathLike[str], *, verify: bool = True, limits: Limits = DEFAULT_LIMITS
) -> Loaded:
    """Read a file that is open, and may be closed then, as `load` does; `path` is what it is called in errors."""
    expect("limits", limits, Limits, "hmkcta.Limits")
    data = _FileBytes(file, path)
    try:
        return _loaded(data, limits, verify=verify)
    except HmkctaError as error:
        error.args = (f"{path}: {error}",)  # `where` is a place in the file; people have several files
        raise


def loads(data: bytes | bytearray | memoryview, *, verify: bool = True, limits: Limits = DEFAULT_LIMITS) -> Loaded:
    """Read a file whose bytes are in memory. As `load` in all else."""
    return _loaded(memoryview(data).toreadonly(), limits, verify=verify)


def _loaded(view: Held, limits: Limits, *, verify: bool) -> Loaded:
    parsed, _, coords, runs = frame_of(view, limits)
    arrays: dict[int, Any] = {own.axis: own.numbers(payload(view, section, verify=verify))
                              for own, section in zip(parsed.coords, coords, strict=True)}
    metadata = parsed.resolve(arrays)
    return metadata, _stages(view, parsed, runs, limits, verify=verify)


def _stages(
    view: Held, parsed: Parsed, runs: list[list[Section]], limits: Limits, *, verify: bool
) -> tuple[PackedLevel, ...]:
    places = root_places(parsed.metadata.axes, parsed.metadata.organisation)
    levels: list[PackedLevel] = []
    reach = 0.0
    for t, (stage, sections) in enumerate(zip(parsed.stages, runs, strict=True)):
        name = f"stages[{t}]"
        after = parsed.stages[t + 1] if t + 1 < len(parsed.stages) else None
        payloads = [payload(view, section, verify=verify) for section in sections]
        level, places = decode_stage(stage, places, after, payloads, name)
        check_nodes(level, stage, limits, name)
        check_largest(level, stage, name)
        reach += reach_of(level, name)
        check_reach(reach, name)
        levels.append(level)
    return tuple(levels)


def frame_of(view: Held, limits: Limits = DEFAULT_LIMITS) -> Frame:
    """Check a file's header, and that the file is as long as that says."""
    end = header_end(bytes(view[:START]), len(view), limits)
    parsed = from_json(parse_json(header_text(view, end), "header", limits), len(view), limits)
    lengths = [(own.name, own.length) for own in parsed.coords]
    lengths += [(f"stages[{t}].runs[{i}]", length) for t, stage in enumerate(parsed.stages)
                for i, length in enumerate(stage.lengths)]
    sections = iter(lay_out(end, lengths, len(view)))
    return Frame(parsed, end, [next(sections) for _ in parsed.coords],
                 [[next(sections) for _ in stage.runs] for stage in parsed.stages])


def level_bytes(path: str | os.PathLike[str]) -> list[int]:
    """Bytes of each level's sections, with those of stages without numbers before it, in a file that `load` accepts."""
    with open_regular(path) as file:
        frame = frame_of(_FileBytes(file, path))
    sizes = [sum(section.end - section.begin for section in own) for own in frame.runs]
    return by_level([stage.bounds.is_cut for stage in frame.parsed.stages], sizes)


def by_level(cut: list[bool], sizes: list[int]) -> list[int]:
    """Sums over the stages of each level.

    >>> by_level([True, False, False], [1, 2, 4])
    [3, 4]
    """
    sums, held = list[int](), 0
    for is_cut, size in zip(cut, sizes, strict=True):
        held += size
        if not is_cut:
            sums.append(held)
            held = 0
    return sums


def open_regular(path: str | os.PathLike[str]) -> FileIO:
    """Open a regular file to read it, unbuffered: whatever its path leads to later, it is this file.

    Raises:
        HmkctaError: reason ``unreadable``: there is none, it may not be read, or it is a folder, a pipe or a device.
    """
    with _as_unreadable(path):
        # A pipe would block on opening, a device may have no end; asked again of what was opened, as links change.
        if _is_regular(os.stat(path)):
            file = FileIO(path, opener=_unblocked)
            if _is_regular(os.fstat(file.fileno())):
                return file
            file.close()
    raise fault("unreadable", str(path), "no regular file", "a file", told="is no regular file")


def _is_regular(found: os.stat_result) -> bool:
    return stat.S_ISREG(found.st_mode)


def _unblocked(path: str, flags: int) -> int:
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


class _FileBytes:
    """Bytes of an open file, read when they are asked for.

    They are not mapped: where somebody cuts a mapped file short, the system ends whoever reads it (SIGBUS).
    """

    def __init__(self, file: FileIO, path: str | os.PathLike[str]) -> None:
        self._file, self._path = file, path
        with _as_unreadable(path):
            self._size = os.fstat(file.fileno()).st_size

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> memoryview:
        start, stop, _ = part.indices(self._size)
        check_memory(stop - start, f"a section of {self._path}", "take a machine that has more")
        data, held = memoryview(bytearray(max(0, stop - start))), 0
        with _as_unreadable(self._path):
            self._file.seek(start)
            while held < len(data) and (count := self._file.readinto(data[held:])):
                held += count
        if held < len(data):
            raise fault("truncated", "data", f"the end of the file at byte {start + held}",
                        f"{self._size} bytes, as there were when it was opened", "fetch the file again")
        return data.toreadonly()


@contextmanager
def _as_unreadable(path: str | os.PathLike[str]) -> Generator[None]:
    try:
        yield
    except (OSError, ValueError) as error:
        where = shown(path) if isinstance(path, bytes) else str(path)  # which may be what somebody read from a file
        said = getattr(error, "strerror", None) or error
        raise fault("unreadable", where, said, "a readable file", told=f"cannot be read: {said}") from error
