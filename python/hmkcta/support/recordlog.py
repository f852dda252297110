"""A file of checked records: after a crash at any moment what it holds is a prefix of what was written.

A record is a header (key, length, CRC-32) and its bytes. Reading stops at the first one that is torn or damaged, and
what follows is cut off, so a record that was read is whole and all before it are. Where the file would outgrow a bound
it is written anew without the records of the smallest keys.
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

    Attributes:
        most: bytes that the file may have; None: as many as there are.

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
        self._lock, self._path = threading.Lock(), path
        self.most: int | None = None
        self._descriptor = _opened(path)
        try:
            claim(self._descriptor)
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

        Beyond `most` the smallest keys are forgotten, be they others or this one: keys ascend, so that these are of
        what was finished first, and asking for it once more does not drive out what comes next.

        Raises:
            OSError: as the operating system has it.
        """
        record = _HEADER.pack(*key, _checksum(key, content), len(content)) + content
        with self._lock:
            if self.most is not None and self._end + len(record) > self.most:
                self._shorten(self.most // 2)
                if self._end + len(record) > self.most or (self._places and key < min(self._places)):
                    return
            try:
                _write(self._descriptor, self._end, record)
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
        with self._lock:  # under which it may be another file
            os.fsync(self._descriptor)

    def close(self) -> None:
        """Let go of the file."""
        with self._lock:
            os.close(self._descriptor)

    def _shorten(self, most: int) -> None:
        """Write the file anew with the records of the largest keys, up to so many bytes."""
        kept, held = set[Key](), 0
        for key in sorted(self._places, reverse=True):
            held += _HEADER.size + self._places[key][1]
            if held > most:
                break
            kept.add(key)
        beside = self._path.with_name(f".{self._path.name}.tmp")
        descriptor = _opened(beside)
        try:
            claim(descriptor)
            os.ftruncate(descriptor, 0)
            places, end = dict[Key, tuple[int, int]](), 0
            for key in (key for key in self._places if key in kept):
                start, length = self._places[key]
                _write(descriptor, end, self._at(start - _HEADER.size, _HEADER.size + length))
                places[key] = (end + _HEADER.size, length)
                end += _HEADER.size + length
            os.fsync(descriptor)
            os.replace(beside, self._path)
        except BaseException:
            os.close(descriptor)
            raise
        os.close(self._descriptor)
        self._descriptor, self._places, self._end = descriptor, places, end

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


def _opened(path: Path) -> int:
    return os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)


def _write(descriptor: int, start: int, content: bytes) -> None:
    os.lseek(descriptor, start, os.SEEK_SET)
    left = memoryview(content)
    while left:
        left = left[os.write(descriptor, left):]


def _checksum(key: Key, content: bytes) -> int:
    return zlib.crc32(content, zlib.crc32(_KEY.pack(*key)))


def in_use(path: Path) -> bool:
    """Whether another process works on the file, which is only looked at."""
    try:
        descriptor = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
    except OSError:
        return False
    try:
        claim(descriptor)
    except Busy:
        return True
    finally:
        os.close(descriptor)
    return False


def claim(descriptor: int) -> bool:
    """Lock the file for as long as this process has it open; False: there are no locks where it lies.

    Raises:
        Busy: another process has locked it.
    """
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
        return False
    return True
