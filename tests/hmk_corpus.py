"""The shared corpus of `.hmk` cases: reading it, and building each case's bytes (`tests/corpus/README.md`).

Deliberately independent of `hmkcta.hmkfile`: it takes files apart and puts them together with its own few lines.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from dataclasses import dataclass, field
from itertools import takewhile
from math import prod
from pathlib import Path
from typing import Any, cast

TESTS = Path(__file__).parent
CORPUS = TESTS / "corpus"
FIXTURES = TESTS / "fixtures"

_ITEM_SIZES = {"I8": 1, "U8": 1, "F16": 2, "F32": 4, "F64": 8, "U16": 2, "U32": 4}
_U32_MAX = 2**32 - 1


@dataclass(frozen=True)
class Case:
    """One case: how its bytes are made and what a reader must say of them."""

    name: str
    base: str | None
    edits: list[dict[str, Any]]
    limits: dict[str, int]
    kind: str
    reason: str
    where: str | None

    def build(self) -> bytes | None:
        """The bytes of the case; None if there must be no file at all."""
        if self.base is None:
            return None
        data = (FIXTURES / self.base).read_bytes() if self.base else b""
        for edit in self.edits:
            data = apply_edit(data, edit)
        return data


def read_corpus() -> list[Case]:
    """All cases of all files of the corpus."""
    cases: list[Case] = []
    for path in sorted(CORPUS.glob("*.json")):
        for item in json.loads(path.read_text(encoding="utf-8"))["cases"]:
            expected = item["expect"]
            cases.append(Case(item["name"], item["base"], item.get("edits", []), item.get("limits", {}),
                              expected["kind"], expected["reason"], expected.get("where")))
    return cases


def apply_edit(data: bytes, edit: dict[str, Any]) -> bytes:
    """One edit of a case: bytes to bytes."""
    op = cast("str", edit["op"])
    if op in ("bytes", "truncate", "append"):
        return _edit_bytes(data, op, edit)
    parts = Parts.split(data)
    if op.startswith("header"):
        return _edit_header(parts, op, edit)
    if op.startswith("metadata"):
        _edit_metadata(parts, op, edit)
    else:
        _edit_array(parts, op, edit)
    return parts.join()


def _edit_bytes(data: bytes, op: str, edit: dict[str, Any]) -> bytes:
    if op == "append":
        return data + bytes.fromhex(edit["hex"])
    if op == "truncate":
        return data[:edit["size"]]
    new = bytes.fromhex(edit["hex"])
    at = edit["at"] % len(data)
    return data[:at] + new + data[at + len(new):]


@dataclass
class Parts:
    """A file taken apart: header object, metadata text, and for each array in file order dtype, shape and bytes."""

    header: dict[str, Any]
    text: str
    arrays: dict[str, tuple[str, list[int], bytes]] = field(default_factory=dict[str, tuple[str, list[int], bytes]])
    data: bytes = b""

    @classmethod
    def split(cls, data: bytes) -> Parts:
        """Take a well-formed file apart."""
        length = int.from_bytes(data[:8], "little")
        header = json.loads(data[8:8 + length])
        body = data[8 + length:]
        arrays = {name: (entry["dtype"], entry["shape"], body[slice(*entry["data_offsets"])])
                  for name, entry in header.items() if name != "__metadata__"}
        return cls(header, header["__metadata__"]["hmkcta"], arrays, body)

    def join(self) -> bytes:
        """Put the file together: offsets and SHA-256 are made anew, nothing else is."""
        digest = hashlib.sha256(self.text.encode()).hexdigest()
        header: dict[str, Any] = {"__metadata__": {"hmkcta": self.text, "hmkcta_sha256": digest}}
        begin = 0
        for name, (dtype, shape, data) in self.arrays.items():
            header[name] = {"dtype": dtype, "shape": shape, "data_offsets": [begin, begin + len(data)]}
            begin += len(data)
        return frame(compact(header), b"".join(data for _, _, data in self.arrays.values()), lead=self.lead)

    @property
    def lead(self) -> int:
        """Bytes of the U8 arrays at the beginning."""
        first = takewhile(lambda array: array[0] == "U8", self.arrays.values())
        return sum(len(data) for _, _, data in first)

    def record(self, name: str) -> None:
        """Make the metadata's record of an array anew, or remove it with the array."""
        metadata = json.loads(self.text)
        if name in self.arrays:
            dtype, shape, data = self.arrays[name]
            crc = zlib.crc32(data)
            short = metadata["version"] in ("1.2", "1.4")
            metadata["arrays"][name] = crc if short else {"dtype": dtype, "shape": shape, "crc32": crc}
        else:
            del metadata["arrays"][name]
        self.text = compact(metadata)


def frame(header: str, body: bytes, pad: int | None = None, lead: int = 0) -> bytes:
    """Length, header text, padding (unless given up to where `lead` bytes more end at a multiple of 8) and body."""
    raw = header.encode("utf-8", "surrogatepass")
    raw += b" " * (-(len(raw) + lead) % 8 if pad is None else pad)
    return len(raw).to_bytes(8, "little") + raw + body


def compact(value: Any) -> str:
    """Compact JSON, characters beyond ASCII as they are."""
    return json.dumps(value, ensure_ascii=False, separators=(",", ":"))


def set_path(root: Any, edit: dict[str, Any]) -> None:
    """Set or remove the value at a path of keys and list positions."""
    *path, last = edit["path"]
    for key in path:
        root = root[key]
    if edit.get("remove"):
        del root[last]
    else:
        root[last] = edit["value"]


def replace_once(text: str, edit: dict[str, Any]) -> str:
    """Replace a piece of text, which must occur."""
    assert edit["old"] in text, edit
    return text.replace(edit["old"], edit["new"], 1)


def _edit_header(parts: Parts, op: str, edit: dict[str, Any]) -> bytes:
    if op == "header":
        set_path(parts.header, edit)
        return frame(compact(parts.header), parts.data, lead=parts.lead)
    text = compact(parts.header)
    text = replace_once(text, edit) if op == "header-text" else text
    return frame(text, parts.data, edit.get("pad"), parts.lead)


def _edit_metadata(parts: Parts, op: str, edit: dict[str, Any]) -> None:
    if op == "metadata":
        metadata = json.loads(parts.text)
        set_path(metadata, edit)
        parts.text = compact(metadata)
    else:
        parts.text = replace_once(parts.text, edit)


def _edit_array(parts: Parts, op: str, edit: dict[str, Any]) -> None:
    name: str = edit["name"]
    if op == "array-drop":
        del parts.arrays[name]
    elif op == "array-last":
        parts.arrays[name] = parts.arrays.pop(name)
    elif op == "array-put":
        dtype, shape, old = parts.arrays[name]
        new = pack(edit["values"], dtype) if "values" in edit else bytes.fromhex(edit["hex"])
        at = edit["at"] * _ITEM_SIZES[dtype]
        assert at + len(new) <= len(old), edit
        parts.arrays[name] = (dtype, shape, old[:at] + new + old[at + len(new):])
    else:
        assert op == "array-set", op
        dtype, shape = edit["dtype"], edit["shape"]
        data = pack(edit["values"], dtype) if "values" in edit else bytes(prod(shape) * _ITEM_SIZES[dtype])
        parts.arrays[name] = (dtype, shape, data)
        if edit.get("first"):
            parts.arrays = {name: parts.arrays.pop(name), **parts.arrays}
    parts.record(name)


def pack(values: list[int], dtype: str) -> bytes:
    """Whole numbers as little-endian U8, U16 or U32."""
    assert dtype in ("U8", "U16", "U32")
    assert all(0 <= value <= _U32_MAX for value in values)
    return b"".join(value.to_bytes(_ITEM_SIZES[dtype], "little") for value in values)
