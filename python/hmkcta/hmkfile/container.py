"""The frame of a file: what it begins with, the header's bytes, and the sections behind it. Standard library only."""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from typing import NamedTuple, Protocol

from .limits import Limits
from .lookalikes import foreign
from .reasons import fault

MAGIC = b"\x89HMK\r\n\x1a\n"
VERSION = 1
#: Bytes before the header: magic, version, length and checksum of the header.
PREFIX_BYTES = len(MAGIC) + 12
#: Bytes of the checksum that ends a section.
CHECKSUM_BYTES = 4

_REFETCH = "fetch the file again"
# A control character is either white space that one flipped bit turns into other white space, or no JSON; of the
# digits of a \u escape one flipped bit changes the case and nothing else. So there is one way to write a header.
_CONTROL = re.compile(rb"[\x00-\x1f]")
_UPPER_CASE = re.compile(rb"(?<!\\)(?:\\\\)*\\u[0-9a-fA-F]{0,3}[A-F]")


class Held(Protocol):
    """Bytes of a file, in memory or read part by part."""

    def __len__(self) -> int: ...

    def __getitem__(self, part: slice, /) -> memoryview: ...


class Section(NamedTuple):
    """A section of a file: its payload from `begin` on, and the checksum that ends at `end`."""

    name: str
    begin: int
    end: int


def header_end(start: bytes, size: int, limits: Limits) -> int:
    """Where the header of a file of `size` bytes ends, told by its first `START` (all, if it has fewer).

    >>> header_end(MAGIC + bytes([1, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0]), 30, Limits())
    22
    """
    if not start[: len(MAGIC)] == MAGIC[:size]:
        raise foreign(start)
    if size < PREFIX_BYTES:
        raise fault("truncated", "header", f"a file of {size} bytes", f"{PREFIX_BYTES} bytes and more",
                    "if it was longer where it comes from, fetch it again")
    version, length = (int.from_bytes(start[at : at + 4], "little") for at in (len(MAGIC), len(MAGIC) + 4))
    if version != VERSION:
        raise fault("version-unknown", "header", version, VERSION, "update hmkcta")
    if length > limits.json_bytes:
        raise fault(
            "header-too-large",
            "header",
            f"{length} bytes",
            f"at most {limits.json_bytes}",
            "check that it is an .hmk file",
        )
    if PREFIX_BYTES + length > size:
        raise fault(
            "truncated", "header", f"a file of {size} bytes", f"a header up to byte {PREFIX_BYTES + length}", _REFETCH
        )
    return PREFIX_BYTES + length


def header_text(view: Held, end: int) -> str:
    """The text of the header, which ends at `end`."""
    raw = bytes(view[PREFIX_BYTES:end])
    stated = int.from_bytes(view[PREFIX_BYTES - 4 : PREFIX_BYTES], "little")
    _check_sum("header-crc", "header", raw, stated)
    if found := _CONTROL.search(raw) or (_UPPER_CASE.search(raw) if b"\\u" in raw else None):
        raise fault(
            "header-bytes",
            "header",
            f"{found[0]!r} at byte {PREFIX_BYTES + found.start()}",
            "no control characters, lower-case digits in \\u escapes",
        )
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise fault("json-encoding", "header", f"byte {PREFIX_BYTES + error.start}", "UTF-8") from error


def lay_out(begin: int, lengths: Sequence[tuple[str, int]], size: int) -> list[Section]:
    """The sections from the end of the header to the last byte of the file, by their names and payloads' lengths."""
    sections: list[Section] = []
    for name, length in lengths:
        sections.append(Section(name, begin, begin := begin + length + CHECKSUM_BYTES))
    if begin != size:
        short = begin > size
        raise fault(
            "truncated" if short else "trailing-bytes",
            "data",
            f"a file of {size} bytes",
            f"{begin} bytes",
            _REFETCH if short else "",
        )
    return sections


def payload(view: Held, section: Section, *, verify: bool = True) -> memoryview:
    """The payload of a section, compared with its checksum."""
    whole = view[section.begin : section.end]
    own, stated = whole[:-CHECKSUM_BYTES], whole[-CHECKSUM_BYTES:]
    if verify:
        _check_sum("section-crc", section.name, own, int.from_bytes(stated, "little"))
    return own


def _check_sum(reason: str, where: str, data: bytes | memoryview, stated: int) -> None:
    found = zlib.crc32(data)
    if found != stated:
        raise fault(
            reason,
            where,
            f"bytes whose checksum (CRC-32) is {found:#010x}",
            f"{stated:#010x}, as the file says",
            _REFETCH,
        )


def prefix_of(header: bytes) -> bytes:
    """What stands before a header."""
    return b"".join([MAGIC, *(number.to_bytes(4, "little") for number in (VERSION, len(header), zlib.crc32(header)))])


def closed(payloads: Sequence[bytes]) -> list[bytes]:
    """A section's payload in pieces, and its checksum."""
    crc = 0
    for piece in payloads:
        crc = zlib.crc32(piece, crc)
    return [*payloads, crc.to_bytes(4, "little")]
