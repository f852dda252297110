"""The safetensors header: eight bytes of length, a JSON object, and which bytes belong to which array.

Standard library only. Stricter than the safetensors library: no duplicate keys, no unknown fields, aligned arrays.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from math import prod
from typing import cast

from ..errors import ForeignFile
from .fields import Json, as_integer, as_list, as_map, as_object, as_text, check_sizes, parse_json
from .limits import Limits
from .reasons import REASONS, fault

#: Bytes of one number of each type that a file may hold.
ITEM_SIZES = {"I8": 1, "U8": 1, "F16": 2, "F32": 4, "F64": 8, "U16": 2, "U32": 4}

#: The two keys of the safetensors metadata.
TEXT_KEY = "hmkcta"
HASH_KEY = "hmkcta_sha256"

LENGTH_BYTES = 8
MAX_DIMENSIONS = 3

#: Characters that a figure of seven digits takes at the most with an exponent.
_LONGEST = 12
#: In JSON: a text, or a float without a fraction.
_TEXT_OR_WHOLE = re.compile(r'"(?:[^"\\]|\\.)*"|-?\d+\.0(?=[,\]}]|$)')

# A control character is either white space that one flipped bit turns into other white space, or no JSON; of the
# digits of a \u escape one flipped bit changes the case and nothing else. Both would go unnoticed.
_CONTROL = re.compile(rb"[\x00-\x1f]")
_UPPER_CASE = re.compile(rb"(?<!\\)(?:\\\\)*\\u[0-9a-fA-F]{0,3}[A-F]")


@dataclass(frozen=True)
class Entry:
    """An array as the header declares it: number type, shape, and byte range from the end of the header."""

    dtype: str
    shape: tuple[int, ...]
    begin: int
    end: int


@dataclass(frozen=True)
class Header:
    """A parsed header: the arrays in file order, the metadata text, which has its hash, and where the arrays start."""

    entries: dict[str, Entry]
    text: str
    data_start: int


def header_length(start: bytes, size: int, limits: Limits) -> int:
    """Bytes of the JSON of a file of `size` bytes, from the file's first eight.

    >>> header_length(bytes([2, 0, 0, 0, 0, 0, 0, 0]), 10, Limits())
    2
    """
    if size < LENGTH_BYTES:
        raise fault("truncated", "header", f"a file of {size} bytes", "8 bytes and more",
                    "if it was longer where it comes from, fetch it again")
    length = int.from_bytes(start[:LENGTH_BYTES], "little")
    if length > limits.json_bytes:
        raise fault("header-too-large", "header", f"{length} bytes", f"at most {limits.json_bytes}",
                    "check that it is an .hmk file")
    if LENGTH_BYTES + length > size:
        raise fault("truncated", "header", f"a file of {size} bytes", f"a header up to byte {LENGTH_BYTES + length}",
                    "fetch the file again")
    return length


def parse_header(raw: bytes, size: int, limits: Limits) -> Header:
    """Parse the JSON bytes of the header of a file of `size` bytes and check which bytes it gives to which array."""
    if found := _CONTROL.search(raw) or (_UPPER_CASE.search(raw) if b"\\u" in raw else None):
        raise fault("header-bytes", "header", f"{found[0]!r} at byte {LENGTH_BYTES + found.start()}",
                    "no control characters, lower-case digits in \\u escapes")
    if not raw.startswith(b"{"):
        raise fault("json-syntax", "header", repr(raw[:1]), "an object that starts with {")
    try:
        parsed = as_map(parse_json(raw.decode("utf-8"), "header", limits), "header")
    except UnicodeDecodeError as error:
        raise fault("json-encoding", "header", f"byte {LENGTH_BYTES + error.start}", "UTF-8") from error
    text = _metadata_text(parsed.pop("__metadata__", None), "header.__metadata__")
    check_sizes(parsed, "header", limits)
    entries = {name: _entry(value, f"header.{name}") for name, value in parsed.items()}
    entries = dict(sorted(entries.items(), key=lambda item: (item[1].begin, item[1].end)))
    data_start = LENGTH_BYTES + len(raw)
    _check_coverage(entries, data_start, size)
    return Header(entries, text, data_start)


def _metadata_text(texts: Json, where: str) -> str:
    """The metadata text, compared with its hash."""
    if not isinstance(texts, dict) or TEXT_KEY not in texts:
        raise ForeignFile(REASONS["not-hmk"].kind, "not-hmk", where, found=f"safetensors without {TEXT_KEY}",
                          allowed="an .hmk file", hint="compress the data with hmkcta first")
    texts = as_object(texts, where, (TEXT_KEY, HASH_KEY))
    text, text_hash = (as_text(texts[key], f"{where}.{key}") for key in (TEXT_KEY, HASH_KEY))
    try:
        digest = hashlib.sha256(text.encode()).hexdigest()
    except UnicodeEncodeError as error:
        raise fault("json-encoding", f"{where}.{TEXT_KEY}", f"character {error.start}",
                    "characters that UTF-8 can hold") from error
    if digest != text_hash:
        raise fault("metadata-hash", f"{where}.{HASH_KEY}", ascii(text_hash[:80]), digest, "fetch the file again")
    return text


def _entry(value: Json, where: str) -> Entry:
    fields = as_object(value, where, ("dtype", "shape", "data_offsets"))
    dtype = as_text(fields["dtype"], f"{where}.dtype", ITEM_SIZES)
    shape = parse_shape(fields["shape"], f"{where}.shape")
    offsets = as_list(fields["data_offsets"], f"{where}.data_offsets", 2)
    begin, end = (as_integer(item, f"{where}.data_offsets") for item in offsets)
    if end - begin != prod(shape) * ITEM_SIZES[dtype]:
        raise fault("array-size", where, f"{end - begin} bytes", f"{prod(shape) * ITEM_SIZES[dtype]} bytes")
    return Entry(dtype, shape, begin, end)


def parse_shape(value: Json, where: str) -> tuple[int, ...]:
    """The shape of an array; none of the format's has more than three dimensions."""
    items = as_list(value, where)
    if len(items) > MAX_DIMENSIONS:
        raise fault("field-value", where, f"{len(items)} dimensions", f"at most {MAX_DIMENSIONS}")
    return tuple(as_integer(item, where) for item in items)


def _check_coverage(entries: dict[str, Entry], data_start: int, size: int) -> None:
    """The arrays, in order, must cover the file from the header to the last byte, each one aligned."""
    position = 0
    for name, entry in entries.items():
        if entry.begin != position:
            raise fault("array-gap", f"header.{name}", f"begin {entry.begin}", f"begin {position}")
        if (data_start + entry.begin) % ITEM_SIZES[entry.dtype]:
            raise fault("array-alignment", f"header.{name}", f"file offset {data_start + entry.begin}",
                        f"a multiple of {ITEM_SIZES[entry.dtype]}")
        position = entry.end
    if data_start + position > size:
        raise fault("truncated", "data", f"a file of {size} bytes", f"{data_start + position} bytes",
                    "fetch the file again")
    if data_start + position < size:
        raise fault("trailing-bytes", "data", f"a file of {size} bytes", f"{data_start + position} bytes")


def format_header(
    arrays: Mapping[str, tuple[str, tuple[int, ...]]], text: str, text_hash: str, least: int = 0
) -> bytes:
    """Length and JSON of a header for arrays laid one after another in the given order.

    It is padded so that the U8 arrays that come first end at a multiple of 8, and to `least` bytes with its length.
    """
    entries: dict[str, object] = {"__metadata__": {TEXT_KEY: text, HASH_KEY: text_hash}}
    begin = first = 0
    for name, (dtype, shape) in arrays.items():
        end = begin + prod(shape) * ITEM_SIZES[dtype]
        entries[name] = {"dtype": dtype, "shape": list(shape), "data_offsets": [begin, end]}
        first = end if dtype == "U8" and begin == first else first
        begin = end
    raw = format_json(entries).encode().ljust(least - LENGTH_BYTES)
    raw += b" " * (-(len(raw) + first) % LENGTH_BYTES)
    return len(raw).to_bytes(LENGTH_BYTES, "little") + raw


def _as_dict(value: object) -> object:
    """A mapping that is no dict as one, for JSON; nothing else is taken for an object."""
    if isinstance(value, Mapping):
        return dict(cast("Mapping[str, object]", value))
    raise TypeError(f"Object of type {type(value).__name__} is not JSON serializable")


#: Made once, as sizes of headers are asked for thousands of times.
_ENCODE = json.JSONEncoder(ensure_ascii=False, allow_nan=False, separators=(",", ":"), default=_as_dict).encode


def format_json(value: object) -> str:
    """The one JSON text that the writer makes of a value: compact, keys in the given order, UTF-8 unescaped.

    Large numbers without a fraction have an exponent: an error of seven digits takes no more characters than any other.

    >>> format_json({"unit": "µm", "said": "[1234567890123.0]", "R": [1, 2], "rmse": 90780390000000.0})
    '{"unit":"µm","said":"[1234567890123.0]","R":[1,2],"rmse":9.078039e+13}'
    """
    return _TEXT_OR_WHOLE.sub(_with_exponent, _ENCODE(value))


def _with_exponent(found: re.Match[str]) -> str:
    text = found[0]
    return text if text.startswith('"') or len(text) <= _LONGEST else f"{Decimal(text).normalize():e}"
