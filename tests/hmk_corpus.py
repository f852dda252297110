"""The shared corpus of `.hmk` cases: reading it, and building each case's bytes (`tests/corpus/README.md`).

Deliberately independent of `hmkcta.hmkfile`: it takes files apart and puts them together with its own few lines.
"""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

TESTS = Path(__file__).parent
CORPUS = TESTS / "corpus" / "cases.json"
FIXTURES = TESTS / "fixtures"

MAGIC = bytes.fromhex("89484d4b0d0a1a0a")
PREFIX = 20


@dataclass
class Parts:
    """A file in parts: header text, and payloads of its sections."""

    text: bytes
    sections: list[bytes]
    version: int = 1

    @classmethod
    def split(cls, data: bytes) -> Parts:
        """Take a sound file apart."""
        version, length = struct.unpack("<II", data[8:16])
        text, at = data[PREFIX : PREFIX + length], PREFIX + length
        sections: list[bytes] = []
        for size in _lengths(json.loads(text)):
            sections.append(data[at : at + size])
            at += size + 4
        assert at == len(data)
        return cls(text, sections, version)

    @property
    def header(self) -> dict[str, Any]:
        """The header's object."""
        return json.loads(self.text)

    def with_header(self, header: Any) -> Parts:
        """The same with another header."""
        text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode("utf-8", "surrogatepass")
        return Parts(text, self.sections, self.version)

    def join(self) -> bytes:
        """The file, its checksums made anew."""
        prefix = MAGIC + struct.pack("<III", self.version, len(self.text), zlib.crc32(self.text))
        closed = (payload + struct.pack("<I", zlib.crc32(payload)) for payload in self.sections)
        return b"".join([prefix, self.text, *closed])


def _lengths(header: dict[str, Any]) -> list[int]:
    """Bytes of the sections' payloads."""
    lengths: list[int] = []
    for axis in header["axes"]:
        if isinstance(given := axis.get("coordinates"), dict):
            lengths.append(
                axis["size"]
                * max(1, int(cast("dict[str, Any]", given)["width"]))
                * {"F32": 4, "F64": 8}[given["dtype"]]
            )
    for stage in header["stages"]:
        for _, coded, cells, core, *basis in stage["runs"]:
            lengths.append(coded + (4 * cells + 2 * (core + sum(basis)) if "bits" in stage else 0))
    return lengths


@dataclass(frozen=True)
class Case:
    """One case: how its bytes are made and what a reader must say of them."""

    name: str
    base: str
    edits: list[dict[str, Any]]
    limits: dict[str, int]
    kind: str
    reason: str
    where: str | None

    def build(self) -> bytes:
        """The bytes of the case."""
        data = (FIXTURES / self.base).read_bytes() if self.base else b""
        for edit in self.edits:
            data = apply_edit(data, edit)
        return data


def read_corpus() -> list[Case]:
    """All cases of the corpus."""
    cases = json.loads(CORPUS.read_text(encoding="utf-8"))["cases"]
    return [
        Case(
            case["name"],
            case["base"],
            case.get("edits", []),
            case.get("limits", {}),
            case["kind"],
            case["reason"],
            case.get("where"),
        )
        for case in cases
    ]


def apply_edit(data: bytes, edit: dict[str, Any]) -> bytes:
    """One edit of a case: bytes to bytes."""
    op, new = edit["op"], bytes.fromhex(edit.get("hex", ""))
    if op == "append":
        return data + new
    if op == "truncate":
        return data[: edit["size"]]
    if op == "bytes":
        at = edit["at"] % len(data)
        return data[:at] + new + data[at + len(new) :]
    parts = Parts.split(data)
    if op == "text":  # the first of some bytes of the header become others
        parts.text = parts.text.replace(bytes.fromhex(edit["from"]), new, 1)
    elif op == "rewrite":  # the header and the first section, whose lengths go together
        head = parts.header
        for change in edit["header"]:
            head = _changed(head, change["path"], change)
        parts = Parts(parts.with_header(head).text, [new, *parts.sections[1:]])
    elif op == "section":
        own: bytes = parts.sections[int(edit["number"])]
        at = int(edit["at"]) % len(own) if "at" in edit else 0
        parts.sections[int(edit["number"])] = own[:at] + new + (own[at + len(new) :] if "at" in edit else b"")
    else:
        parts = parts.with_header(_changed(parts.header, edit["path"], edit))
    return parts.join()


def _changed(value: Any, path: list[str | int], edit: dict[str, Any]) -> Any:
    """A JSON value with what is at the path replaced by `to`, or left out."""
    if not path:
        return edit["to"]
    first, *rest = path
    if not rest and "to" not in edit:
        del value[first]
    else:
        value[first] = _changed(value[first] if rest else None, rest, edit)
    return value
