"""Scratch space on disk: a file without a name, gone when it is closed or the process ends, however it ends."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
import weakref
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32
from ..errors import DISK_FULL, HmkctaError, Kind
from ..support.memory import format_bytes


def scratch_folder(folder: str | os.PathLike[str] | None = None) -> Path:
    """Where scratch files go: the given folder, or the system's for temporary files (``TMPDIR``)."""
    return Path(tempfile.gettempdir() if folder is None else folder)


def unnamed_file(count: int, folder: Path, purpose: str = "", *, mapped: bool = False) -> Any:
    """A file of so many bytes. Where it will be `mapped` they are set aside, as a map cannot say that the disk is full.

    Raises:
        HmkctaError: the folder is not there, cannot be written to, or has no room; it says what the room is for.
    """
    room = f"{format_bytes(count)}{purpose and f' for {purpose}'}"
    try:
        free = shutil.disk_usage(folder).free
        if free < count:
            raise _io("scratch-full", folder, f"{format_bytes(free)} free", room)
        file = tempfile.TemporaryFile(dir=folder, buffering=0)  # noqa: SIM115 (the caller closes it)
        try:
            if not (mapped and _set_aside(file.fileno(), count)):
                file.truncate(count)
        except BaseException:
            file.close()
            raise
    except OSError as error:
        full = error.errno in DISK_FULL
        reason, allowed = ("scratch-full", room) if full else ("scratch", "a folder to write to")
        raise _io(reason, folder, error.strerror or error, allowed) from error
    return file


def _set_aside(file: int, count: int) -> bool:
    """Set bytes aside on the disk; whether the system can."""
    try:
        os.posix_fallocate(file, 0, count)
    except AttributeError:
        return False
    except OSError as error:
        if error.errno in (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS):
            return False
        raise
    return True


class Scratch:
    """Float32 numbers in a temporary file, read and written by position; any number of threads may do so at once.

    Args:
        count: how many numbers it holds.
        folder: where.

    Raises:
        HmkctaError: the folder is not there, cannot be written to, or has no room.

    >>> with Scratch(4) as scratch:
    ...     scratch.write(1, np.array([2, 3], np.float32))
    ...     scratch.read(0, 4).tolist()
    [0.0, 2.0, 3.0, 0.0]
    """

    def __init__(self, count: int, folder: str | os.PathLike[str] | None = None) -> None:
        self.folder = scratch_folder(folder)
        self.count = count
        self._file = unnamed_file(self.nbytes, self.folder)
        # Whoever forgets to close it, or is interrupted, gives the space back as well.
        self._closing = weakref.finalize(self, self._file.close)

    @property
    def nbytes(self) -> int:
        """Bytes it takes on disk at most."""
        return 4 * self.count

    def __enter__(self) -> Scratch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the space back."""
        self._closing()

    def read(self, start: int, count: int) -> F32:
        """Numbers from `start` on."""
        values = np.empty(count, np.float32)
        rest, at = memoryview(values.data).cast("B"), 4 * start
        try:
            while rest:
                got = os.preadv(self._file.fileno(), [rest], at)
                if got == 0:
                    raise OSError(None, "the file has become shorter")
                rest, at = rest[got:], at + got
        except OSError as error:
            raise _io("scratch", self.folder, error.strerror or error, "scratch space that can be read") from error
        return values

    def expect(self, start: int, count: int) -> None:
        """Numbers from `start` on will be read soon: the system may fetch them meanwhile."""
        if hasattr(os, "posix_fadvise"):
            os.posix_fadvise(self._file.fileno(), 4 * start, 4 * count, os.POSIX_FADV_WILLNEED)

    def write(self, start: int, values: NDArray[Any]) -> None:
        """Put contiguous float32 numbers from `start` on."""
        rest, at = memoryview(values.reshape(-1).data).cast("B"), 4 * start
        try:
            while rest:
                done = os.pwrite(self._file.fileno(), rest, at)
                rest, at = rest[done:], at + done
        except OSError as error:
            raise _io("scratch-full", self.folder, error.strerror or error, format_bytes(self.nbytes)) from error

    def copy(self) -> Scratch:
        """A second file with the same numbers."""
        other = Scratch(self.count, self.folder)
        self.copy_to(other)
        return other

    def copy_to(self, other: Scratch) -> None:
        """Give another file of the same length the same numbers."""
        step = 1 << 22
        for start in range(0, self.count, step):
            other.write(start, self.read(start, min(step, self.count - start)))


def _io(reason: str, folder: Path, found: object, allowed: object) -> HmkctaError:
    hint = "set TMPDIR to a folder with room"
    return HmkctaError(Kind.IO, reason, f"scratch space in {folder}", found=found, allowed=allowed, hint=hint)
