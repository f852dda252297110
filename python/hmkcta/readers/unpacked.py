"""What a library reads but cannot map: unpacked block by block, into memory, or a file without a name if it is large.

Everything after a reader takes an array or a map of a file, and reads it more than once.
"""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import product
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..memory import check_memory, format_bytes, memory_budget
from ..scratch import scratch_folder
from .source import Layout, check_numbers, check_shape, io_error

Part = tuple[slice, ...]
#: Elements that are unpacked at once, and the share of the memory for fitting that they, and the whole, may take.
BLOCK, BLOCK_SHARE, WHOLE_SHARE = 1 << 24, 8, 2


def unpacked(
    where: str, layout: Layout, parts: Iterable[Part], read: Callable[[Part], NDArray[Any]], limit: int | None = None
) -> NDArray[Any]:
    """An array in C order whose parts a library reads.

    Where it takes more than half of `limit` bytes (None: a quarter of the free memory) it is unpacked into the folder
    for temporary files (``TMPDIR``), and the file is gone when nobody looks at the array any more.

    Raises:
        HmkctaError: no real numbers, no element, or no room for the file.

    >>> unpacked("ones", Layout((2, 2), np.dtype("u1")), block_parts((2, 2), (1, 1)), lambda part: 1).tolist()
    [[1, 1], [1, 1]]
    """
    check_numbers(layout.dtype, where)
    check_shape(layout, where)
    if layout.nbytes <= memory_budget(limit) // WHOLE_SHARE:
        whole = np.empty(layout.shape, layout.dtype)
        for part in parts:
            whole[part] = read(part)
        return whole
    with _unnamed_file(where, layout.nbytes) as file:
        for part in parts:  # mapped anew each time, so that what is written leaves memory
            np.memmap(file, layout.dtype, "r+", 0, layout.shape)[part] = read(part)
        return np.memmap(file, layout.dtype, "r", 0, layout.shape)


def from_stream(
    where: str, source: Callable[[int], bytes], stored: Layout, convert: Callable[[NDArray[Any]], NDArray[Any]],
    dtype: np.dtype[Any], limit: int | None,
) -> NDArray[Any]:
    """An array from bytes that come one after another, such as a decompressor's.

    Args:
        where: the file, for errors.
        source: gives so many of the bytes that come next, fewer at their end.
        stored: how the bytes are to be understood.
        convert: what is made of the numbers.
        dtype: the type of that.
        limit: bytes of memory to work in, as of `unpacked`.

    Raises:
        HmkctaError: what `unpacked` raises; the bytes end before.
    """
    check_numbers(stored.dtype, where)
    shape = stored.shape[::-1] if stored.fortran else stored.shape

    def read(part: Part) -> NDArray[Any]:
        lengths = [span.stop - span.start for span in part]
        count = prod(lengths) * stored.dtype.itemsize
        data = source(count)
        if len(data) < count:
            raise io_error("source-truncated", where, "the end of the file within it", f"{stored}", "fetch it again")
        return convert(np.frombuffer(data, stored.dtype).reshape(lengths))

    parts = block_parts(shape, [1] * len(shape), _elements(dtype, limit))
    array = unpacked(where, Layout(shape, dtype), parts, read, limit)
    source(1)  # behind the last number is the checksum, which is compared when it is read
    return array.T if stored.fortran else array


def blocks(where: str, layout: Layout, chunks: Sequence[int] | None, limit: int | None) -> Iterator[Part]:
    """Parts to unpack an array by that lies in chunks of this shape; None: row by row.

    Raises:
        HmkctaError: not even a chunk fits into memory.
    """
    chunks = chunks or [1] * len(layout.shape)
    hint = "write it with smaller chunks, or as .npy: that is mapped, not read"
    check_memory(2 * prod(map(min, chunks, layout.shape)) * layout.dtype.itemsize, f"a chunk of {where}", hint, limit)
    return block_parts(layout.shape, chunks, _elements(layout.dtype, limit))


def block_parts(shape: Sequence[int], chunks: Sequence[int], limit: int = BLOCK) -> Iterator[Part]:
    """Cut an array into blocks of whole chunks, each of up to `limit` elements unless a chunk has more.

    Of chunks of one element the blocks are runs in C order, and follow one another.

    >>> [[(span.start, span.stop) for span in part] for part in block_parts((3, 5), (2, 2), 8)]
    [[(0, 2), (0, 4)], [(0, 2), (4, 5)], [(2, 3), (0, 4)], [(2, 3), (4, 5)]]
    """
    block = [max(1, min(chunk, size)) for chunk, size in zip(chunks, shape, strict=True)]
    for axis in reversed(range(len(shape))):
        block[axis] = min(shape[axis], block[axis] * max(1, limit // max(1, prod(block))))
    starts = product(*(range(0, size, max(1, step)) for size, step in zip(shape, block, strict=True)))
    for corner in starts:
        yield tuple(slice(at, min(at + step, size)) for at, step, size in zip(corner, block, shape, strict=True))


def _elements(dtype: np.dtype[Any], limit: int | None) -> int:
    """How many are unpacked at once."""
    return max(1, min(BLOCK, memory_budget(limit) // BLOCK_SHARE // dtype.itemsize))


def _unnamed_file(where: str, count: int) -> Any:
    """A file of so many bytes."""
    folder = scratch_folder()
    place, room = f"scratch space in {folder}", f"{format_bytes(count)} for {where}, which is unpacked"
    hint = "set TMPDIR to a folder with room"
    try:
        free = shutil.disk_usage(folder).free
        if free < count:
            raise io_error("scratch-full", place, f"{format_bytes(free)} free", room, hint)
        file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115 (the caller closes it)
        try:
            _reserve(file, count)
        except BaseException:
            file.close()
            raise
    except OSError as error:
        raise io_error("scratch-full", place, error.strerror or error, room, hint) from error
    return file


def _reserve(file: Any, count: int) -> None:
    """Set bytes aside on the disk where the system can, as a map cannot say that it is full."""
    try:
        os.posix_fallocate(file.fileno(), 0, count)
    except (AttributeError, OSError) as error:
        if getattr(error, "errno", None) not in (None, errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS):
            raise
        file.truncate(count)
