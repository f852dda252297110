"""A file of checked records that only grows: after a crash at any moment what it holds is a prefix of what was written.

A record is a header (key, length, CRC-32) and its bytes. Reading stops at the first one that is torn or damaged, and
what follows is cut off, so a record that was read is whole and all before it are.
"""

from __future__ import annotations

import errno
import os
import struct
import sys
import threading
import time
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

Key = tuple[int, int]

#: Step, node, CRC-32 of these two and of the bytes, number of bytes.
_HEADER = struct.Struct("<IIIQ")
_KEY = struct.Struct("<II")
#: Seconds after which records are forced to the disk. A killed process loses nothing, a power cut no more than these.
_SYNC_EVERY = 5.0


class Busy(Exception):
    """Another process has the file open."""


class RecordLog:
    """Records by key, each written once and for good; safe to use from several threads.

    Args:
        path: created if it is not there.

    Raises:
        Busy: another process works on it.
        OSError: it cannot be read or written.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     log = RecordLog(Path(folder, "log"))
    ...     log.append((1, 7), b"seven")
    ...     log.close()
    ...     again = RecordLog(Path(folder, "log"))
    ...     len(again), again.read((1, 7)), again.read((1, 8))
    ...     again.close()
    (1, b'seven', None)
    """

    def __init__(self, path: Path) -> None:
        self._lock = threading.Lock()
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
        try:
            _claim(self._descriptor)
            self._places = dict(self._scan(os.fstat(self._descriptor).st_size))
            self._end = max((start + length for start, length in self._places.values()), default=0)
            os.ftruncate(self._descriptor, self._end)
        except BaseException:
            os.close(self._descriptor)
            raise
        self._synced = time.monotonic()

    def __len__(self) -> int:
        """How many records there are."""
        return len(self._places)

    def __iter__(self) -> Iterator[Key]:
        """The keys of all records, in the order they were written."""
        return iter(list(self._places))

    def read(self, key: Key) -> bytes | None:
        """The bytes of a record; None: there is none."""
        place = self._places.get(key)
        if place is None:
            return None
        with self._lock:
            return self._at(*place)

    def append(self, key: Key, content: bytes) -> None:
        """Write a record. If that fails (a full disk) the file is as it was.

        Raises:
            OSError: as the operating system has it.
        """
        record = _HEADER.pack(*key, _checksum(key, content), len(content)) + content
        with self._lock:
            try:
                os.lseek(self._descriptor, self._end, os.SEEK_SET)
                left = memoryview(record)
                while left:
                    left = left[os.write(self._descriptor, left):]
            except OSError:
                with suppress(OSError):
                    os.ftruncate(self._descriptor, self._end)
                raise
            self._places[key] = (self._end + _HEADER.size, len(content))
            self._end += len(record)
            due = time.monotonic() - self._synced > _SYNC_EVERY
            if due:
                self._synced = time.monotonic()
        if due:
            self.sync()

    def clear(self) -> None:
        """Forget every record."""
        with self._lock:
            os.ftruncate(self._descriptor, 0)
            self._places.clear()
            self._end = 0

    def sync(self) -> None:
        """Force what was written to the disk."""
        os.fsync(self._descriptor)

    def close(self) -> None:
        """Let go of the file."""
        with self._lock:
            os.close(self._descriptor)

    def _scan(self, size: int) -> Iterator[tuple[Key, tuple[int, int]]]:
        start = 0
        while start + _HEADER.size <= size:
            step, node, checksum, length = _HEADER.unpack(self._at(start, _HEADER.size))
            start += _HEADER.size
            if length > size - start or _checksum((step, node), self._at(start, length)) != checksum:
                return
            yield (step, node), (start, length)
            start += length

    def _at(self, start: int, length: int) -> bytes:
        os.lseek(self._descriptor, start, os.SEEK_SET)
        found = bytearray()
        while len(found) < length:
            part = os.read(self._descriptor, length - len(found))
            if not part:
                raise OSError(errno.EIO, "the file has become shorter")
            found += part
        return bytes(found)


def _checksum(key: Key, content: bytes) -> int:
    return zlib.crc32(content, zlib.crc32(_KEY.pack(*key)))


def in_use(path: Path) -> bool:
    """Whether another process works on the file, which is only looked at."""
    try:
        descriptor = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
    except OSError:
        return False
    try:
        _claim(descriptor)
    except Busy:
        return True
    finally:
        os.close(descriptor)
    return False


def _claim(descriptor: int) -> None:
    """Lock the file for as long as this process has it open."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in (errno.EAGAIN, errno.EACCES, errno.EDEADLK):
            raise Busy from error
        if error.errno not in (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP):  # a network drive without locks
            raise
