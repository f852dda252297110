"""The encodings of NRRD other than raw, each as a source of bytes; and skipping that ends where the file does."""

from __future__ import annotations

import bz2
import gzip
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from .source import Layout, io_error, too_long, too_short

#: Every name of an encoding that is read.
ENCODINGS = {"raw": "raw", "gzip": "gzip", "gz": "gzip", "bzip2": "bzip2", "bz2": "bzip2", "ascii": "text",
             "text": "text", "txt": "text", "hex": "hex"}
#: Those whose bytes are counted, so that the last ones may be taken.
BINARY = ("raw", "gzip", "bzip2")
#: Bytes that are looked at or passed over at once, and the most letters of a number that is text.
BLOCK, LONGEST = 1 << 20, 400
#: A byte of a packed file holds no more than so many.
RATIOS = {"gzip": 1032, "bzip2": 1 << 21}
#: Bytes before the numbers, beyond as many as they are, that ``byte skip: -1`` passes over in packed data.
MOST_BEFORE = 1 << 26

Read = Callable[[int], bytes]


@dataclass(frozen=True)
class Leading:
    """What is before the numbers.

    Attributes:
        where: the file, for errors.
        begin: where in it the encoded data begin.
        skip: bytes to pass over, of packed data once they are unpacked; -1: all but the last ones.
    """

    where: str
    begin: int
    skip: int


def skip_lines(file: BinaryIO, count: int, where: str) -> None:
    """Pass over so many lines of a file.

    Raises:
        HmkctaError: it has not so many, or the count is negative.
    """
    if count < 0:
        raise io_error("source-damaged", where, f"line skip {count}", "0 or more lines", "correct its header")
    at, left = file.tell(), count
    while left:
        block = file.read(BLOCK)
        held = block.count(b"\n")
        if not block:
            raise io_error("source-truncated", where, f"{count - left} lines", f"the {count} of its line skip",
                           "fetch it again, or correct its header")
        if held < left:
            left, at = left - held, at + len(block)
            continue
        for _ in range(left):
            at, block = at + block.index(b"\n") + 1, block[block.index(b"\n") + 1:]
        left = 0
    file.seek(at)


def encoded(kind: str, file: BinaryIO, layout: Layout, leading: Leading) -> Read:
    """A source of the bytes of the numbers of an array, in the order in which they lie.

    Raises:
        HmkctaError: there are too few for the array, or for what is before it; or too many to look through.
    """
    held = file.seek(0, 2) - leading.begin
    if _least(kind, layout) > held:  # before there is room made for it
        raise too_short(leading.where, f"{held} bytes of {kind}", layout)
    if kind in ("text", "hex"):
        file.seek(leading.begin + leading.skip)
        return Words(file, layout.dtype).read if kind == "text" else _Hex(file).read
    skip = leading.skip
    if skip == -1:
        skip = _length(_unpacker(kind, file, leading.begin), layout, leading.where) - layout.nbytes
    read = _unpacker(kind, file, leading.begin)
    while skip:
        passed = len(read(min(skip, BLOCK)))
        if not passed:
            raise too_short(leading.where, f"the end of the file in the {leading.skip} bytes before", layout)
        skip -= passed
    return read


def _least(kind: str, layout: Layout) -> int:
    """Bytes of a file that an array takes at the least."""
    numbers = layout.nbytes // layout.dtype.itemsize
    return {"text": 2 * numbers - 1, "hex": layout.nbytes}.get(kind) or layout.nbytes // RATIOS[kind]


def _unpacker(kind: str, file: BinaryIO, begin: int) -> Read:
    file.seek(begin)
    return gzip.GzipFile(fileobj=file).read if kind == "gzip" else bz2.BZ2File(file).read


def _length(read: Read, layout: Layout, where: str) -> int:
    """Bytes that packed data have when they are unpacked."""
    held = 0
    while block := read(BLOCK):
        held += len(block)
        if held > 2 * layout.nbytes + MOST_BEFORE:
            raise too_long(where, f"more than {held} bytes, of which the last are to be taken", layout)
    if held < layout.nbytes:
        raise too_short(where, f"{held} bytes of numbers", layout)
    return held


class Readable(Protocol):
    """What gives bytes, one after another."""

    def read(self, count: int, /) -> bytes:
        """So many; fewer at the end."""
        ...


@dataclass
class Words:
    """Numbers written as text, parted by white space."""

    file: Readable
    dtype: np.dtype[Any]
    words: list[bytes] = field(default_factory=list[bytes])
    rest: bytes = b""

    def read(self, count: int) -> bytes:
        """The bytes of that many numbers, one at least; fewer at the end."""
        wanted, found = max(1, count // self.dtype.itemsize), list[bytes]()
        while wanted and (self.words or self._more()):
            taken, self.words = self.words[:wanted], self.words[wanted:]
            found.append(self._numbers(taken).tobytes())
            wanted -= len(taken)
        return b"".join(found)

    def _more(self) -> bool:
        """Take in the next words, of which the last may go on in the next block; whether there are any."""
        while not self.words:
            block = self.file.read(BLOCK)
            text = self.rest + block
            self.words = text.split()
            self.rest = self.words.pop() if block and self.words and not text[-1:].isspace() else b""
            if len(self.rest) > LONGEST:
                raise ValueError(f"{self.rest[:20]!r} .. is no number")
            if not block:
                break
        return bool(self.words)

    def _numbers(self, words: list[bytes]) -> NDArray[Any]:
        if any(b"_" in word or len(word) > LONGEST for word in words):  # which Python takes for numbers
            raise ValueError("_ in a number, or one too long")
        if self.dtype.kind == "f":
            return np.array([float(word) for word in words], self.dtype)
        return np.array([int(word) for word in words], self.dtype)


@dataclass
class _Hex:
    """Bytes written as two hexadecimal digits each, wherever the lines end."""

    file: BinaryIO
    digits: bytes = b""

    def read(self, count: int) -> bytes:
        """So many bytes; fewer at the end."""
        found = bytearray()
        while len(found) < count:
            take = min(len(self.digits) // 2, count - len(found))
            found += bytes.fromhex(self.digits[:2 * take].decode("ascii"))
            self.digits = self.digits[2 * take:]
            if len(found) == count:
                break
            block = self.file.read(BLOCK)
            self.digits += b"".join(block.split())
            if not block:
                if self.digits:
                    raise ValueError("half a byte at its end")
                break
        return bytes(found)
