"""Mutants of a file that know its structure: header, metadata, arrays, each with checksums and offsets made anew.

What is not to be found by a checksum alone must get past it: after a change the SHA-256 of the metadata, the CRC-32 of
the array and the byte ranges are right again, unless the change is of them.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from math import prod
from typing import Any, cast

import numpy as np

from hmk_corpus import Parts, compact, frame

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
SIZES = {"I8": 1, "U8": 1, "F16": 2, "BF16": 2, "F32": 4, "F64": 8, "U16": 2, "I16": 2, "U32": 4, "I32": 4, "U64": 8,
         "I64": 8, "BOOL": 1}
#: Numbers of arrays that are likely to be at a border.
BORDERS = (0, 1, 2, 3, 0x7C00, 0xFC00, 0x7E00, 0x7BFF, 0x7F800000, 0x7FC00000, 0xFFFF, 0x7FFF, 0x8000, 0xFFFFFFFF,
           0x80000000, 0x7FFFFFFF)


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
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError, UnicodeError):
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


def length_changed(rng: Generator, parts: Parts, _: list[bytes]) -> bytes:
    """The length of the header."""
    data = parts.join()
    length = int.from_bytes(data[:8], "little")
    other = pick(rng, (0, 1, length - 1, length + 1, length + 8, len(data), len(data) - 8, 2**31, 2**32, 2**63, -1))
    return (other % 2**64).to_bytes(8, "little") + data[8:]


def header_value(rng: Generator, parts: Parts, _: list[bytes]) -> bytes:
    """A value of the header, which is then put together as it is."""
    data = parts.join()
    length = int.from_bytes(data[:8], "little")
    header, body = json.loads(data[8:8 + length]), data[8 + length:]
    change_value(rng, header)
    return frame(compact(header), body, lead=parts.lead)


def header_text(rng: Generator, parts: Parts, _: list[bytes]) -> bytes:
    """The text of the header."""
    data = parts.join()
    length = int.from_bytes(data[:8], "little")
    text = data[8:8 + length].decode("utf-8", "surrogatepass").rstrip(" ")
    pad = None if rng.random() < 0.7 else int(rng.integers(0, 20))
    return frame(changed_text(rng, text), data[8 + length:], pad, parts.lead)


def metadata_value(rng: Generator, parts: Parts, _: list[bytes]) -> None:
    """A value of the metadata."""
    metadata = json.loads(parts.text)
    change_value(rng, metadata)
    parts.text = compact(metadata)


def metadata_number(rng: Generator, parts: Parts, _: list[bytes]) -> None:
    """A number of the metadata, by little."""
    metadata = json.loads(parts.text)
    numbers = [path for path in paths(metadata) if type(at(metadata, path)) in (int, float)]
    path = pick(rng, numbers)
    old = at(metadata, path)
    at(metadata, path[:-1])[path[-1]] = pick(rng, (old + 1, old - 1, old * 2, -old, old + 0.5, old * 1000))
    parts.text = compact(metadata)


def metadata_text(rng: Generator, parts: Parts, _: list[bytes]) -> None:
    """The text of the metadata."""
    parts.text = changed_text(rng, parts.text)


def array_numbers(rng: Generator, parts: Parts, _: list[bytes]) -> None:
    """Numbers of an array: at a border, from elsewhere in it, or a step up or down."""
    name = pick(rng, list(parts.arrays))
    dtype, shape, data = parts.arrays[name]
    size, found = SIZES.get(dtype, 1), bytearray(data)
    count = len(found) // size
    for _step in range(int(rng.choice([1, 1, 2, 5])) if count else 0):
        place, other = (int(at) * size for at in rng.integers(0, count, 2))
        old = int.from_bytes(found[place:place + size], "little")
        new = pick(rng, (pick(rng, BORDERS), old + 1, old - 1, old ^ 1 << int(rng.integers(0, 8 * size)),
                         int.from_bytes(found[other:other + size], "little")))
        found[place:place + size] = (new % 256**size).to_bytes(size, "little")
    replace_array(parts, name, dtype, shape, bytes(found))


def array_length(rng: Generator, parts: Parts, _: list[bytes]) -> None:
    """An array with more or fewer entries along its first axis, and a shape that says so or does not."""
    name = pick(rng, list(parts.arrays))
    dtype, shape, data = parts.arrays[name]
    line = prod(shape[1:]) * SIZES.get(dtype, 1) if shape else len(data)
    rows = max(0, (shape[0] if shape else 1) + int(rng.choice([-2, -1, 1, 2, 1000])))
    longer = (data + data[-line:] * rows if line and rng.random() < 0.5 else data + bytes(line * rows))[:line * rows]
    told = [rows, *shape[1:]] if rng.random() < 0.8 else shape
    replace_array(parts, name, dtype, told, longer)


def array_kind(rng: Generator, parts: Parts, _: list[bytes]) -> None:
    """Another number type or shape for the same bytes."""
    name = pick(rng, list(parts.arrays))
    dtype, shape, data = parts.arrays[name]
    if rng.random() < 0.5:
        dtype = pick(rng, [*SIZES, "F8", "", "u32"])
    else:
        shape = pick(rng, ([*shape, 1], [1, *shape], shape[:-1], shape[::-1], [prod(shape)], [0], [-1],
                           [2**32, 2**32, 0]))
    replace_array(parts, name, dtype, shape, data)


def array_set(rng: Generator, parts: Parts, others: list[bytes]) -> None:
    """Which arrays there are, and in what order; one may come from another file."""
    names = list(parts.arrays)
    name, kind = pick(rng, names), int(rng.integers(0, 4))
    if kind == 0:
        del parts.arrays[name]
        parts.record(name)
    elif kind == 1:
        items = list(parts.arrays.items())
        i, j = rng.integers(0, len(items), 2)
        items[i], items[j] = items[j], items[i]
        parts.arrays = dict(items)
    elif kind == 2:
        new = pick(rng, (name + "/0", name.replace("1", "2", 1), "level/0/core", "x", "", pick(rng, names)))
        replace_array(parts, new, *parts.arrays[name])
    else:
        other = Parts.split(pick(rng, others))
        replace_array(parts, name, *other.arrays[name if name in other.arrays else pick(rng, list(other.arrays))])


def metadata_of_another(rng: Generator, parts: Parts, others: list[bytes]) -> None:
    """A field of the metadata as another file has it."""
    metadata, other = json.loads(parts.text), json.loads(Parts.split(pick(rng, others)).text)
    key = pick(rng, list(other))
    metadata[key] = other[key]
    parts.text = compact(metadata)


Change = Callable[[Generator, Parts, list[bytes]], bytes | None]
#: All changes, and how often each is made; those that return bytes are the last of a mutant.
CHANGES: tuple[Change, ...] = (
    array_numbers, metadata_value, metadata_number, array_length, array_kind, array_set, metadata_of_another,
    metadata_text, header_value, header_text, bytes_changed, length_changed,
)
WEIGHTS = np.array([30, 12, 12, 10, 6, 8, 4, 5, 6, 5, 3, 1]) / 102


def replace_array(parts: Parts, name: str, dtype: str, shape: list[int], data: bytes) -> None:
    """Another array of this name, with a record of its own."""
    parts.arrays[name] = (dtype, list(shape), data)
    parts.record(name)


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
