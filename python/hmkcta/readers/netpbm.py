"""Netpbm's pictures (PBM, PGM, PPM, PAM, PFM), read here, as Pillow rescales all but 8 bits and has no colour PFM."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .source import Layout, check_layout, io_error

#: Channels of the picture by the first two bytes; of P7 and what is unknown its header says it.
_CHANNELS = {b"P1": 1, b"P2": 1, b"P3": 3, b"P4": 1, b"P5": 1, b"P6": 3, b"Pf": 1, b"PF": 3, b"P7": 0}
MAGICS = tuple((0, kind + space) for kind in _CHANNELS for space in (b"\n", b"\r", b"\t", b" ", b"#"))
#: A number of a header, behind spaces and comments.
_WORD = re.compile(rb"(?:\s|#[^\n\r]*[\n\r])*([^\s#]+)")
_PAM = re.compile(rb"P7\s.*?\bENDHDR[ \t]*\n", re.DOTALL)
_MOST = 65535
#: Bytes that a header may take, with all its comments.
MOST_HEADER = 1 << 16


@dataclass(frozen=True)
class Header:
    """What a header says.

    Attributes:
        kind: its first two bytes.
        shape: rows, columns, and channels if there are several.
        most: the number that stands for white; 1 is black and white; 0: floats.
        start: where the numbers begin.
        little: whether floats lie with their low byte first.
        scale: of floats, by the header.
    """

    kind: bytes
    shape: tuple[int, ...]
    most: int
    start: int
    little: bool = False
    scale: float = 1.0

    @property
    def dtype(self) -> np.dtype[Any]:
        """The number type of the numbers as they lie in the file."""
        if not self.most:
            return np.dtype("<f4" if self.little else ">f4")
        return np.dtype("u1" if self.most < 256 else ">u2")


def header_of(data: bytes) -> Header:
    """The header of a file's bytes.

    >>> header_of(b"P6 # a comment\\n 2 3 1023\\n...").shape, header_of(b"P6 2 3 1023\\n").most
    ((3, 2, 3), 1023)

    Raises:
        ValueError: it is none.
    """
    kind = data[:2]
    if kind == b"P7":
        return _pam_header(data)
    words = 2 if kind in (b"P1", b"P4") else 3
    at, found = 2, list[bytes]()
    for _ in range(words):
        match = _WORD.match(data, at, MOST_HEADER)
        if match is None:
            raise ValueError("the header ends early")
        found.append(match[1])
        at = match.end()
    if kind in (b"Pf", b"PF"):
        most, little, scale = 0, float(found[2]) < 0, abs(float(found[2]))
    else:
        most, little, scale = _white(found[2]) if words == 3 else 1, False, 1.0
    shape = (int(found[1]), int(found[0]), _CHANNELS[kind])
    return Header(kind, shape[:2] if shape[2] == 1 else shape, most, at + 1, little, scale)


def _pam_header(data: bytes) -> Header:
    whole = _PAM.match(data, 0, MOST_HEADER)
    if whole is None:
        raise ValueError("the header ends early")
    lines = [line.split(None, 1) for line in whole[0].splitlines()[1:] if not line.startswith(b"#")]
    fields = {line[0]: line[1].strip() for line in lines if len(line) == 2}
    shape = tuple(int(fields[name]) for name in (b"HEIGHT", b"WIDTH", b"DEPTH"))
    return Header(b"P7", shape[:2] if shape[2] == 1 else shape, _white(fields[b"MAXVAL"]), whole.end())


def _white(word: bytes) -> int:
    most = int(word)
    if not 1 <= most <= _MOST:
        raise ValueError(f"a largest number of {most}")
    return most


def read_netpbm(path: Path, data: bytes) -> NDArray[Any]:
    """The picture of a file's bytes: numbers as they are, 0 to what its header says; black and white is boolean.

    Raises:
        HmkctaError: it is shorter or longer than it says, holds several pictures, or numbers above what it says.
    """
    header = header_of(data)
    check_layout(Layout(header.shape, header.dtype), str(path))
    picture = _plain(path, data, header) if header.kind in (b"P1", b"P2", b"P3") else _binary(path, data, header)
    if header.most and int(picture.max()) > header.most:
        raise io_error("source-damaged", str(path), f"a number of {picture.max()}",
                       f"0 to {header.most}, as its header says", "write it again with what made it")
    if header.kind in (b"Pf", b"PF"):  # from the bottom up
        return np.ascontiguousarray(picture[::-1], np.float32)
    if header.most > 1:
        return picture.astype(picture.dtype.newbyteorder("="))
    return picture == 0 if header.kind in (b"P1", b"P4") else picture > 0  # bits stand for ink there


def _binary(path: Path, data: bytes, header: Header) -> NDArray[Any]:
    rows, columns = header.shape[:2]
    layout = Layout((rows, -(-columns // 8)), np.dtype("u1")) if header.kind == b"P4" else Layout(
        header.shape, header.dtype)
    _check_length(path, len(data) - header.start, layout.nbytes)
    numbers = np.frombuffer(data, layout.dtype, offset=header.start).reshape(layout.shape)
    return np.unpackbits(numbers, axis=1, count=columns) if header.kind == b"P4" else numbers


def _plain(path: Path, data: bytes, header: Header) -> NDArray[Any]:
    """Numbers as text; of black and white digits may stand without spaces."""
    text = re.sub(rb"#[^\n\r]*", b"", data[header.start - 1:])
    words = re.findall(rb"\S", text) if header.kind == b"P1" else text.split()
    _check_length(path, len(words), Layout(header.shape, np.dtype("u1")).nbytes, "numbers")
    numbers = np.array([int(word) for word in words], np.int64)
    if numbers.min() < 0 or numbers.max() > _MOST:
        raise ValueError(f"numbers from {numbers.min()} to {numbers.max()}")
    return numbers.astype(header.dtype).reshape(header.shape)


def _check_length(path: Path, found: int, expected: int, what: str = "bytes of numbers") -> None:
    if found < expected:
        raise io_error("source-truncated", str(path), f"{max(0, found)} {what}", f"{expected}, as its header says",
                       "fetch it again")
    if found > expected:
        raise io_error("source-too-long", str(path), f"{found} {what}", f"{expected}, as its header says",
                       "write each picture as a file of its own")
