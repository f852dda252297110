"""What a library reads but cannot map: unpacked block by block, into memory, or a file without a name if it is large.

Everything after a reader takes an array or a map of a file, and reads it more than once.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..packing import Packing
from ..streaming.scratch import scratch_folder, unnamed_file
from ..support.memory import check_memory, memory_budget
from ..support.progress import Progress
from .source import Layout, check_layout, check_numbers, io_error, too_long, too_short

Part = tuple[slice, ...]
#: Elements that are unpacked at once, and the share of the memory for fitting that they, and the whole, may take.
BLOCK, BLOCK_SHARE, WHOLE_SHARE = 1 << 24, 8, 2
#: Bytes that any file may be unpacked to, and how many times its own; deflate reaches that.
NARROW, WIDENED = 1 << 26, 1 << 10


@dataclass(frozen=True)
class Unpacker:
    """Makes arrays of what a library reads part by part.

    What takes more than half of `limit` is unpacked into the folder for temporary files (``TMPDIR``), and the file is
    gone when nobody looks at the array any more.

    Attributes:
        limit: bytes of memory to work in; None: half of what is free.
        progress: called with the stage's name and the fraction of it done.

    >>> parts = block_parts((2, 2), (1, 1))
    >>> Unpacker().array("ones", Layout((2, 2), np.dtype("u1")), parts, lambda part: 1).tolist()
    [[1, 1], [1, 1]]
    """

    limit: int | None = None
    progress: Progress | None = None

    def array(
        self, where: str, layout: Layout, parts: Iterable[Part], read: Callable[[Part], NDArray[Any]]
    ) -> NDArray[Any]:
        """An array in C order, read by parts, none of which is read twice.

        Raises:
            HmkctaError: no real numbers, no element, or no room for the file.
        """
        check_layout(layout, where)
        parts = self._counted(parts, prod(layout.shape))
        if layout.nbytes <= memory_budget(self.limit) // WHOLE_SHARE:
            whole = np.empty(layout.shape, layout.dtype)
            for part in parts:
                whole[part] = read(part)
            return whole
        with unnamed_file(layout.nbytes, scratch_folder(), f"{where}, which is unpacked", mapped=True) as file:
            for part in parts:  # mapped anew each time, so that what is written leaves memory
                np.memmap(file, layout.dtype, "r+", 0, layout.shape)[part] = read(part)
            return np.memmap(file, layout.dtype, "r", 0, layout.shape)

    def chunks(self, where: str, array: Any, chunks: Sequence[int] | None) -> NDArray[Any]:
        """An array that a library reads when it is indexed, and keeps in chunks of this shape; None: row by row.

        Raises:
            HmkctaError: what `array` raises; not even a chunk fits into memory.
        """
        layout = Layout(tuple(array.shape), np.dtype(array.dtype))
        chunks = chunks or [1] * len(layout.shape)
        self.check_memory(Layout(tuple(map(min, chunks, layout.shape)), layout.dtype), f"a chunk of {where}",
                          "write it with smaller chunks, or as .npy: that is mapped, not read")
        return self.array(where, layout, block_parts(layout.shape, chunks, self._elements(layout.dtype)),
                          lambda part: array[part])

    def stream(
        self, where: str, source: Callable[[int], bytes], stored: Layout, convert: Packing | None = None
    ) -> NDArray[Any]:
        """An array from bytes that come one after another, such as a decompressor's.

        Args:
            where: the file, for errors.
            source: called with a number of bytes, gives as many of those that come next, fewer at their end.
            stored: how the bytes are to be understood.
            convert: makes of the numbers what is meant.

        Raises:
            HmkctaError: what `array` raises; the bytes end before, or go on.
        """
        check_numbers(stored.dtype, where)
        shape = stored.shape[::-1] if stored.fortran else stored.shape
        layout = Layout(shape, stored.dtype if convert is None else convert.dtype)

        def read(part: Part) -> NDArray[Any]:
            lengths = [span.stop - span.start for span in part]
            count = prod(lengths) * stored.dtype.itemsize
            data = source(count)
            if len(data) < count:
                raise too_short(where, "the end of the file within it", stored)
            numbers = np.frombuffer(data, stored.dtype).reshape(lengths)
            return numbers if convert is None else convert(numbers)

        array = self.array(where, layout, block_parts(shape, [1] * len(shape), self._elements(layout.dtype)), read)
        if source(1):  # reading on also compares the checksum that is behind the last number
            raise too_long(where, "bytes behind the last number", stored)
        return array.T if stored.fortran else array

    def check_memory(self, layout: Layout, what: str, hint: str) -> None:
        """Refuse what has to be read at once, and takes so much as bytes and again as numbers.

        Raises:
            HmkctaError: that is more memory than there is.
        """
        check_memory(2 * layout.nbytes, what, hint, self.limit)

    def check_widened(self, where: Path | str, nbytes: int, held: int | None = None) -> None:
        """Refuse what would take far more than its file, as damaged sizes do, unless so much memory is given.

        Args:
            where: the file, or what it is called in errors.
            nbytes: that its numbers would take.
            held: that are stored of it; None: as many as the file has.

        Raises:
            HmkctaError: reason ``source-too-large``.
        """
        held = os.stat(where).st_size if held is None else held
        most = max(NARROW, WIDENED * held, self.limit or 0)
        if nbytes > most:
            raise io_error("source-too-large", str(where), f"{nbytes / 2**20:.0f} MiB of numbers, by its header",
                           f"up to {most / 2**20:.0f} MiB for what is stored of it, {held} bytes",
                           f"where that is meant, allow it: --max-memory {-(-nbytes >> 20)}MiB")

    def _elements(self, dtype: np.dtype[Any]) -> int:
        """How many are unpacked at once."""
        return max(1, min(BLOCK, memory_budget(self.limit) // BLOCK_SHARE // dtype.itemsize))

    def _counted(self, parts: Iterable[Part], elements: int) -> Iterator[Part]:
        """The parts; each is told as done when the next one is asked for."""
        done = 0
        for part in parts:
            yield part
            done += prod(span.stop - span.start for span in part)
            if self.progress is not None:
                self.progress("unpacking", done / elements)


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
