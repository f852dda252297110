"""Mutants of a file that know its structure: header and sections, each with lengths and checksums made anew.

What is not to be found by a checksum alone must get past it: after a change the CRC-32 of the header and of each
section are right again, unless the change is of them.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from typing import Any, cast

import numpy as np

from hmk_corpus import MAGIC, PREFIX, Parts

Generator = np.random.Generator

#: What stands in a text in the place of a value.
VALUES: tuple[Any, ...] = (
    0, 1, 2, 3, -1, 7, 255, 256, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**48, 2**53 - 1, 2**53, 2**64,
    10**30, 0.5, -0.0, 1e-320, 1e308, "", "x", "identity", "most", "é", "\ud800", "\x00", "x" * 5000,
    None, True, False, [], {}, [0], {"a": 1}, [[[[[[[[[[[[[[[[[[]]]]]]]]]]]]]]]]]],
)
#: Pieces that are put into a text.
PIECES = (
    ",", ":", "{", "}", "[", "]", '"', "\\", "0", "-", ".", "e9", "1e400", "NaN", "Infinity", " ", "\t", "\n", "\x00",
    "\\u0041", "\\uD800", "\\ud83d\\ude00", "\ufeff", "null", "true", "01", "1.0", "/**/", "'",
)


def pick(rng: Generator, items: Any) -> Any:
    """One of some items, whatever they are."""
    return items[int(rng.integers(0, len(items)))]


def mutated(rng: Generator, parent: bytes, others: list[bytes]) -> tuple[str, bytes]:
    """A mutant of a file, and what was done to it; of what cannot be taken apart the bytes are changed.

    Args:
        rng: all that is drawn comes from it.
        parent: the file.
        others: files whose parts may come in place of the file's own.
    """
    try:
        parts, done = Parts.split(parent), list[str]()
        for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
            change = CHANGES[int(rng.choice(len(CHANGES), p=WEIGHTS))]
            done.append(change.__name__)
            made = change(rng, parts, others)
            if made is not None:
                return " + ".join(done), made
        return " + ".join(done), parts.join()
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError, UnicodeError, struct.error,
            AssertionError):
        return "raw_bytes", raw_bytes(rng, parent)


def raw_bytes(rng: Generator, data: bytes) -> bytes:
    """Bits flipped, pieces cut out, doubled or put in, with no checksum made anew."""
    found = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        at, length = int(rng.integers(0, len(found) + 1)), int(rng.choice([1, 1, 2, 8, 64]))
        kind = int(rng.integers(0, 5))
        if kind == 0 and at < len(found):
            found[at] ^= 1 << int(rng.integers(0, 8))
        elif kind == 1:
            del found[at:at + length]
        elif kind == 2:
            found[at:at] = found[at:at + length]
        elif kind == 3:
            found[at:at + length] = rng.bytes(length)
        else:
            del found[at:]
    return bytes(found)


def bytes_changed(rng: Generator, parts: Parts, _: list[bytes]) -> bytes:
    """Any bytes of the file."""
    return raw_bytes(rng, parts.join())


def prefix_changed(rng: Generator, parts: Parts, _: list[bytes]) -> bytes:
    """What stands before the header: magic, version, length, checksum."""
    data = parts.join()
    length = int.from_bytes(data[12:16], "little")
    words = [pick(rng, (0, 1, 2, 2**31, 2**32 - 1, length - 1, length + 1, len(data), len(data) - PREFIX)) % 2**32
             for _ in range(3)]
    whole = [int.from_bytes(data[at:at + 4], "little") for at in (8, 12, 16)]
    place = int(rng.integers(0, 4))
    if place == 3:
        return raw_bytes(rng, MAGIC) + data[len(MAGIC):]
    whole[place] = words[place]
    return MAGIC + struct.pack("<III", *whole) + data[PREFIX:]


def header_value(rng: Generator, parts: Parts, _: list[bytes]) -> None:
    """A value of the header."""
    header = parts.header
    change_value(rng, header)
    parts.text = parts.with_header(header).text


def header_number(rng: Generator, parts: Parts, _: list[bytes]) -> None:
    """A number of the header, by little."""
    header = parts.header
    numbers = [path for path in paths(header) if type(at(header, path)) in (int, float)]
    path = pick(rng, numbers)
    old = at(header, path)
    at(header, path[:-1])[path[-1]] = pick(rng, (old + 1, old - 1, old * 2, -old, old + 0.5, old * 1000))
    parts.text = parts.with_header(header).text


def header_text(rng: Generator, parts: Parts, _: list[bytes]) -> None:
    """The text of the header."""
    parts.text = changed_text(rng, parts.text.decode()).encode()


def header_of_another(rng: Generator, parts: Parts, others: list[bytes]) -> None:
    """A field of the header, or of a stage, as another file has it."""
    header, other = parts.header, Parts.split(pick(rng, others)).header
    if rng.random() < 0.5:
        key = pick(rng, list(other))
        header[key] = other[key]
    else:
        stage = pick(rng, other["stages"])
        key = pick(rng, list(stage))
        pick(rng, header["stages"])[key] = stage[key]
    parts.text = parts.with_header(header).text


def code_bits(rng: Generator, parts: Parts, _: list[bytes]) -> None:
    """Bits or bytes of a section, which stays as long."""
    place = int(rng.integers(0, len(parts.sections)))
    found = bytearray(parts.sections[place])
    for _step in range(int(rng.choice([1, 1, 2, 5])) if found else 0):
        byte = int(len(found) * rng.random() ** 2)  # what comes first says what the rest is
        found[byte] = pick(rng, (found[byte] ^ 1 << int(rng.integers(0, 8)), int(rng.integers(0, 256)), 0, 255))
    parts.sections[place] = bytes(found)


def section_length(rng: Generator, parts: Parts, _: list[bytes]) -> None:
    """A run with more or fewer bytes, and a header that says so or does not."""
    header, place = parts.header, int(rng.integers(0, len(parts.sections)))
    by = int(rng.choice([-8, -2, -1, 1, 2, 100]))
    data = parts.sections[place]
    parts.sections[place] = (data[:by] if by < 0 else data + pick(rng, (bytes(by), rng.bytes(by))))
    runs = [run for stage in header["stages"] for run in stage["runs"]]
    number = place - (len(parts.sections) - len(runs))
    if number >= 0 and rng.random() < 0.8:
        runs[number][1] += len(parts.sections[place]) - len(data)
        parts.text = parts.with_header(header).text


def section_set(rng: Generator, parts: Parts, others: list[bytes]) -> None:
    """Which sections there are, and in what order; one may come from another file."""
    place, kind = int(rng.integers(0, len(parts.sections))), int(rng.integers(0, 4))
    if kind == 0:
        del parts.sections[place]
    elif kind == 1:
        other = int(rng.integers(0, len(parts.sections)))
        sections = parts.sections
        sections[place], sections[other] = sections[other], sections[place]
    elif kind == 2:
        parts.sections.insert(place, parts.sections[place])
    else:
        parts.sections[place] = pick(rng, Parts.split(pick(rng, others)).sections)


Change = Callable[[Generator, Parts, list[bytes]], bytes | None]
#: All changes, and how often each is made; those that return bytes are the last of a mutant.
CHANGES: tuple[Change, ...] = (
    code_bits, header_value, header_number, section_length, section_set, header_of_another, header_text, bytes_changed,
    prefix_changed,
)
WEIGHTS = np.array([30, 16, 16, 10, 4, 8, 8, 3, 2]) / 97


def change_value(rng: Generator, tree: Any) -> None:
    """Another value somewhere in parsed JSON, none, one more, or two exchanged."""
    path = pick(rng, paths(tree))
    parent, key, kind = at(tree, path[:-1]), path[-1], int(rng.integers(0, 5))
    if kind == 0:
        del parent[key]
    elif kind == 1:
        if isinstance(parent, list):
            cast("list[Any]", parent).insert(key, parent[key])
        else:
            parent[pick(rng, ("x", "", key + " ", "version", "__proto__"))] = parent[key]
    elif kind == 2:
        other = pick(rng, paths(tree))
        parent[key] = json.loads(json.dumps(at(tree, other)))
    else:
        parent[key] = pick(rng, VALUES)


def changed_text(rng: Generator, text: str) -> str:
    """The text with a piece put in, left out or doubled."""
    place, length = int(rng.integers(0, len(text) + 1)), int(rng.choice([1, 1, 1, 2, 10, 60]))
    kind = int(rng.integers(0, 4))
    if kind == 0:
        return text[:place] + text[place + length:]
    if kind == 1:
        return text[:place + length] + text[place:]
    if kind == 2:
        return text[:place] + pick(rng, PIECES) + text[place + length:]
    return text[:place] + pick(rng, PIECES) + text[place:]


def paths(tree: Any, before: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Where values are in parsed JSON."""
    if isinstance(tree, list):
        items: list[tuple[Any, Any]] = list(enumerate(cast("list[Any]", tree)))
    else:
        items = list(cast("dict[str, Any]", tree).items()) if isinstance(tree, dict) else []
    found = [before] if before else []
    for key, value in items:
        found += paths(value, (*before, key))
    return found


def at(tree: Any, path: tuple[Any, ...]) -> Any:
    """The value at a place."""
    for key in path:
        tree = tree[key]
    return tree
