"""What is served, and which part of it."""

from __future__ import annotations

import errno
import os
import re
import threading
from dataclasses import dataclass
from io import FileIO

_RANGE = re.compile(r"bytes=([0-9]{0,40})-([0-9]{0,40})", re.IGNORECASE)


class Held:
    """A file that was opened once: whatever its path leads to later, its bytes are served, until it is closed.

    Args:
        file: the file, which is closed with it.

    >>> import tempfile
    >>> with tempfile.TemporaryFile(buffering=0) as file:
    ...     _ = file.write(b"abcdef")
    ...     held = Held(file)
    ...     held.size(), held.read(2, 3)
    (6, b'cde')
    """

    def __init__(self, file: FileIO) -> None:
        self._file = file
        self._lock = threading.Lock()  # a descriptor that is closed meanwhile may be another file's a moment later

    def size(self) -> int:
        """How many bytes it has now.

        Raises:
            OSError: it is closed.
        """
        with self._lock:
            return os.fstat(self._descriptor()).st_size

    def read(self, begin: int, count: int) -> bytes:
        """Up to so many bytes from one on.

        Raises:
            OSError: it is closed, or cannot be read.
        """
        with self._lock:
            self._descriptor()
            self._file.seek(begin)
            return self._file.read(count)

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._file.close()

    def _descriptor(self) -> int:
        if self._file.closed:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        return self._file.fileno()


@dataclass(frozen=True)
class Resource:
    """An answer: bytes, or a file that is held.

    Args:
        content_type: its MIME type.
        data: the bytes.
        held: the file in their place.

    >>> page = Resource("text/html", data=b"page")
    >>> page.size(), page.read(1, 2)
    (4, b'ag')
    """

    content_type: str
    data: bytes = b""
    held: Held | None = None

    def size(self) -> int:
        """How many bytes it has.

        Raises:
            OSError: the file is closed.
        """
        return len(self.data) if self.held is None else self.held.size()

    def read(self, begin: int, count: int) -> bytes:
        """Up to so many bytes from one on.

        Raises:
            OSError: the file is closed, or cannot be read.
        """
        return self.data[begin:begin + count] if self.held is None else self.held.read(begin, count)

    def close(self) -> None:
        """Close the file, if there is one."""
        if self.held is not None:
            self.held.close()


def span_of(header: str | None, size: int) -> tuple[bool, tuple[int, int] | None]:
    """Whether a `Range` header asks for a part of so many bytes, and its begin and end; None if there are none such.

    What is not understood (several ranges, other units) is ignored, as HTTP has it.

    >>> [span_of(text, 10) for text in ("bytes=2-5", "bytes=8-", "bytes=-3", "bytes=10-", "lines=1")]
    [(True, (2, 6)), (True, (8, 10)), (True, (7, 10)), (True, None), (False, (0, 10))]
    """
    found = _RANGE.fullmatch(header.strip()) if header is not None else None
    if found is None or found.groups() == ("", ""):
        return False, (0, size)
    first, last = found.groups()
    if not first:
        return True, (max(0, size - int(last)), size) if int(last) and size else None
    if last and int(last) < int(first):
        return False, (0, size)
    begin, end = int(first), min(size, int(last) + 1) if last else size
    return True, (begin, end) if begin < size else None


