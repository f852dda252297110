"""How much memory is free, to refuse with a sentence what would otherwise end the process; how much was taken; how it
is kept."""

from __future__ import annotations

import ctypes
import mmap
import os
import sys
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError, Kind

_MEMINFO = Path("/proc/meminfo")
#: Which control groups the process is in, and where they are: containers and batch systems limit memory by these.
_GROUP, _GROUPS = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
#: Parameters of glibc's `mallopt` by number: freed bytes at the top of a heap from which on they are given back; bytes
#: from which on an allocation is mapped for itself; and how many heaps there may be.
_MALLOC, _HEAPS = {-1: 2**28, -3: 2**25, -4: 0}, -8
#: Bytes of a mapped file that a read brings into memory around each place it touches; and together, at the most.
_AROUND, LOOKED_AT = 1 << 16, 1 << 24

#: Bytes that are there: to ask the system takes longer than to decode an element.
FEW = 1 << 20


def available_memory() -> int | None:
    """Bytes that can be allocated now, within the limits of a container; None where the system does not say."""
    free = [*_of_machine("MemAvailable"), *(limit - _taken(group) for group, limit in _limits())]
    return max(0, min(free)) if free else None


def peak_memory() -> int:
    """Most resident bytes of this process so far; 0 where the system does not say."""
    with suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text().splitlines()
        return 1024 * int(next(line.split()[1] for line in lines if line.startswith("VmHWM")))
    with suppress(ImportError):
        import resource  # not on Windows

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return 0


def _of_machine(field: str) -> list[int]:
    """Bytes that the system tells of the machine's memory; none on another system."""
    try:
        fields = dict(line.split(":", 1) for line in _MEMINFO.read_text().splitlines())
        return [int(fields[field].split()[0]) * 1024]
    except (OSError, ValueError, KeyError):
        return []


def _limits() -> Iterator[tuple[Path, int]]:
    """The control groups (version 2) around the process that have a limit, and its bytes."""
    inner = PurePosixPath("/")
    with suppress(OSError):  # another system
        lines = _GROUP.read_text().splitlines()
        inner = next((PurePosixPath(line[3:]) for line in lines if line.startswith("0::")), inner)
    for group in (inner, *inner.parents):
        folder = _GROUPS / group.relative_to("/")
        with suppress(OSError, ValueError):  # a group of elsewhere, or no limit ("max")
            yield folder, int((folder / "memory.max").read_text())


def _taken(group: Path) -> int:
    """Bytes that a group holds, but for those of files that the system drops when they are asked for."""
    try:
        taken = int((group / "memory.current").read_text())
        kinds = dict(line.split() for line in (group / "memory.stat").read_text().splitlines())
        return taken - int(kinds["inactive_file"])
    except (OSError, ValueError, KeyError):
        return 0


def stays_cached(count: int) -> bool:
    """Whether a file of `count` bytes stays in the system's cache while it is worked on: it takes up to half of the
    memory that the machine, or the container, has. False where the system does not say."""
    had = [*_of_machine("MemTotal"), *(limit for _, limit in _limits())]
    return bool(had) and 2 * count <= min(had)


def memory_budget(limit: int | None = None) -> int:
    """Bytes that a fit may take: the given limit, or half of what is free (1 GiB where the system does not say).

    >>> memory_budget(5)
    5
    """
    if limit is not None:
        return limit
    free = available_memory()
    return 2**30 if free is None else free // 2


def keep_freed_memory(threads: int) -> None:
    """Let freed memory serve the next node instead of going back to the system, and each thread have a heap.

    Nodes come and go by the hundred, each with arrays of some megabytes: mapping, zeroing and unmapping these took a
    third of the time of a level, and what one core has just written costs another one dear. Where the C library is not
    glibc, or its environment variables say how it should be, it stays as it is.
    """
    if any(name.startswith(("MALLOC_", "GLIBC_TUNABLES")) for name in os.environ):
        return
    with suppress(TypeError, OSError, AttributeError):  # Windows; other C libraries
        mallopt = ctypes.CDLL(None).mallopt
        for parameter, value in {**_MALLOC, _HEAPS: max(1, threads)}.items():
            mallopt(parameter, value)


def give_back_freed_memory() -> None:
    """Give freed memory back to the system, where the C library can: what a choice took counts beside its fit."""
    with suppress(TypeError, OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def drop_pages(array: NDArray[Any]) -> None:
    """Let go of the memory that pages of a mapped file take once they have been looked at; they stay readable.

    Does nothing to an array that maps no file, or may have been written to.
    """
    base, advice = mapped(array), getattr(mmap, "MADV_DONTNEED", None)
    if base is not None and advice is not None:
        with suppress(OSError, ValueError):  # a system that has none of it, a map that is closed
            base.madvise(advice)


def looked_at(array: NDArray[Any], part: tuple[slice, ...]) -> NDArray[Any]:
    """`array[part]`, of a mapped file as a copy where a look at it would bring much more of the file into memory.

    Every few rows of a file touch most of its pages, as rows do that lie across it: pages are dropped on the way.
    """
    view = array[part]
    most = max(LOOKED_AT, view.nbytes)
    if mapped(array) is None or _touched(view) <= most:
        return np.asarray(view)
    found = np.empty(view.shape, view.dtype)
    waiting = [(np.asarray(view), found)]
    while waiting:
        values, into = waiting.pop()
        if (pieces := min(-(-_touched(values) // most), max(values.shape, default=1))) > 1:
            outer = max((n for n, size in enumerate(values.shape) if size > 1), key=lambda n: abs(values.strides[n]))
            both = (np.array_split(each, min(pieces, values.shape[outer]), outer) for each in (values, into))
            waiting += zip(*both, strict=True)
            continue
        into[...] = values
        drop_pages(array)
    return found


def _touched(view: NDArray[Any]) -> int:
    return touched(list(zip(map(abs, view.strides), view.shape, strict=True)), view.itemsize)


def touched(steps: Sequence[tuple[float, int]], itemsize: int) -> int:
    """Bytes of a mapped file, about, that come into memory when numbers in it are looked at.

    `steps` has, for each axis, how many bytes apart they lie and how many there are.
    """
    found, span = float(_AROUND), float(itemsize)
    for step, size in sorted(steps):
        span += step * (size - 1)
        found = min(found * size, span + _AROUND)
    return int(found)


def mapped(array: NDArray[Any]) -> Any:
    """The map of a file that the array lies in; None: there is none, or it may have been written to."""
    base: Any = array
    only_read = False
    while base is not None and not isinstance(base, mmap.mmap):
        only_read = only_read or getattr(base, "mode", None) == "r"  # a copy-on-write map would lose what was written
        base = getattr(base, "base", None)
    return base if only_read else None


def check_memory(needed: int, what: str, hint: str, limit: int | None = None) -> None:
    """Refuse to allocate more than `limit` bytes, or than is available; for a few of them nobody is asked.

    >>> check_memory(10, "a row", "ask for less", limit=9)
    Traceback (most recent call last):
        ...
    hmkcta.errors.HmkctaError: memory for a row: 10 B are needed, 9 B are allowed. Next: ask for less. \
[ResourceLimit/memory]
    >>> check_memory(2**31 + 1, "a row", "ask for less", limit=2**31)
    Traceback (most recent call last):
        ...
    hmkcta.errors.HmkctaError: memory for a row: 2147483649 B are needed, 2147483648 B are allowed. Next: \
ask for less. [ResourceLimit/memory]
    """
    if limit is None and needed <= FEW:
        return
    allowed = available_memory() if limit is None else limit
    if allowed is not None and needed > allowed:
        alike = format_bytes(needed) == format_bytes(allowed)
        found, most = (f"{needed} B", f"{allowed} B") if alike else (format_bytes(needed), _as_given(allowed))
        raise HmkctaError(Kind.RESOURCE_LIMIT, "memory", f"memory for {what}", found=found, allowed=most, hint=hint,
                          told=f"{found} are needed, {most} are {'free' if limit is None else 'allowed'}")


@contextmanager
def memory_for(what: str, hint: str) -> Generator[None]:
    """Make of a plain `MemoryError` in the block one that says what there was no memory for, and what to do.

    Raises:
        HmkctaError: `ResourceLimit`, reason ``memory``.

    >>> with memory_for("a row", "ask for less"):
    ...     raise MemoryError
    Traceback (most recent call last):
        ...
    hmkcta.errors.HmkctaError: memory for a row: there is none left. Next: ask for less. [ResourceLimit/memory]
    """
    try:
        yield
    except MemoryError as error:
        raise HmkctaError(Kind.RESOURCE_LIMIT, "memory", f"memory for {what}", hint=hint,
                          told="there is none left") from error


def _as_given(count: int) -> str:
    """Bytes for people who may have given them in units of 10^3.

    >>> _as_given(240_000_000), _as_given(2**28)
    ('240 MB (228.88 MiB)', '256.00 MiB')
    """
    digits = str(count)
    zeros = min(9, (len(digits) - len(digits.rstrip("0"))) // 3 * 3)
    if zeros < 3:
        return format_bytes(count)
    return f"{count // 10**zeros} {' KMG'[zeros // 3]}B ({format_bytes(count)})"


def format_bytes(count: int) -> str:
    """Bytes for people, in units of 2^10.

    >>> format_bytes(800), format_bytes(23_373_000)
    ('800 B', '22.29 MiB')
    """
    size, unit = float(count), "B"
    for larger in ("KiB", "MiB", "GiB", "TiB"):
        if size < 1024:
            break
        size, unit = size / 1024, larger
    return f"{size:.2f} {unit}" if unit != "B" else f"{count} B"
