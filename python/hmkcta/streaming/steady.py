"""Whether an array is at the end what it was at the beginning: files, and arrays, may be rewritten during a fit."""

from __future__ import annotations

import hashlib
import os
import zlib
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import source_changed
from ..support.cut_short import file_of
from ..support.memory import drop_pages, looked_at
from ..support.progress import Progress
from ..support.slabs import slabs

#: Runs of elements that a sample is made of, and how many elements each has.
RUNS, RUN = 64, 1024
#: Elements that are hashed at once.
SLAB = 1 << 22
#: Seconds between two looks during a fit; and how many times as long as a look takes the next one waits, at the least.
EVERY, PAUSE = 1.0, 20.0

Stamp = tuple[int, ...]


def stamp_of(path: str | os.PathLike[str]) -> Stamp | None:
    """Device, inode, size, and times of the last change to content and state of a file; None: it is not there."""
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return None
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns, found.st_ctime_ns


def fingerprint_start(dtype: np.dtype[Any], shape: tuple[int, ...]) -> Any:
    """The SHA-256 that a fingerprint begins with: of type and shape."""
    return hashlib.sha256(f"{dtype.newbyteorder('=').name} {shape}".encode())


def fingerprint_of(array: NDArray[Any], dtype: np.dtype[Any] | None = None) -> str | None:
    """The SHA-256 by which a file knows its source: of type, shape and values in C order.

    Args:
        array: any layout and byte order.
        dtype: take the values as numbers of this type; None: the array's own.

    Returns:
        Hexadecimal digits; None where a value is none of `dtype`.

    >>> ones = np.ones(3, np.float32)
    >>> fingerprint_of(ones) == fingerprint_of(ones.astype(">f8"), np.dtype(np.float32)) != fingerprint_of(ones * 2)
    True
    >>> fingerprint_of(ones / 3, np.dtype(np.uint8))
    """
    own = array.dtype.newbyteorder("=")
    dtype = own if dtype is None else dtype
    digest = fingerprint_start(dtype, array.shape)
    for part in slabs(array.shape, SLAB):
        found = np.ascontiguousarray(looked_at(array, part), own)
        with np.errstate(all="ignore"):
            values = found if dtype == own else found.astype(dtype)
        if values is not found and not np.array_equal(values.astype(own), found, equal_nan=own.kind == "f"):
            return None
        digest.update(values.data)
        drop_pages(array)
    return digest.hexdigest()


def _sample(array: NDArray[Any]) -> int:
    """A checksum of runs of elements all over the array, each along the axis that lies closest in memory."""
    inner = min(range(array.ndim), key=lambda n: (array.shape[n] == 1, abs(array.strides[n])))
    outer = [size for n, size in enumerate(array.shape) if n != inner]
    lines, long, checksum = int(np.prod(outer, dtype=object)), array.shape[inner], 0
    for number in range(RUNS):
        # As far along its line as it is among the lines, so that few lines are looked at in more places than one.
        line, start = number * lines // RUNS, number * max(0, long - RUN) // (RUNS - 1)
        at = [int(i) for i in np.unravel_index(line, outer)] if outer else []
        run = array[(*at[:inner], slice(start, start + RUN), *at[inner:])]
        checksum = zlib.crc32(np.ascontiguousarray(run).view(np.uint8).data, checksum)
        drop_pages(array)  # a system may map megabytes around each place
    return checksum


class Steady:
    """Looks whether an array is what it was when this was made.

    The state of the file that it maps and a sample of its values are looked at. Where either is another one, and the
    fingerprint is known, all values are: a file may be touched, or written again as it was.

    Attributes:
        fingerprint: of the values when this was made; None: not known yet.

    >>> array = np.zeros(5)
    >>> steady = Steady(array)
    >>> steady.check()
    >>> array[2] = 1
    >>> steady.check()
    Traceback (most recent call last):
        ...
    hmkcta.errors.HmkctaError: the array: has changed while it was read. Next: wait until nobody writes it, and begin \
anew. [SourceChanged/source-changed]
    """

    def __init__(self, array: NDArray[Any], fingerprint: str | None = None) -> None:
        self.array, self.fingerprint = array, fingerprint
        self._path = file_of(array)
        self._seen = self._look()
        self._next = monotonic() + EVERY

    def check(self) -> None:
        """Look, and look at all values where a difference is seen.

        Raises:
            HmkctaError: `SourceChanged`, reason ``source-changed``.
        """
        seen = self._look()
        if seen != self._seen:
            if self.fingerprint is None or fingerprint_of(self.array) != self.fingerprint:
                raise source_changed("source-changed", self._path or "the array", "has changed while it was read")
            self._seen = seen

    def told(self, progress: Progress) -> Progress:
        """The same progress, which looks now and then: a fit of hours that is in vain ends early."""
        def tell(stage: str, done: float) -> None:
            if monotonic() > self._next:
                begun = monotonic()
                self._next = begun + 3600.0  # for other threads
                self.check()
                self._next = monotonic() + max(EVERY, PAUSE * (monotonic() - begun))
            progress(stage, done)

        return tell

    def _look(self) -> tuple[Stamp | None, int]:
        return None if self._path is None else stamp_of(self._path), _sample(self.array)
