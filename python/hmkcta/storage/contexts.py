"""Whole numbers, labels and magnitudes told by decisions, and the classes these depend on."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

from .range_coder import CodeError, Coder

#: The largest magnitude of a stored whole number, and the largest k of a column.
MOST_MAGNITUDE, MOST_K = 2**24 - 1, 63
MOST_ONES = 14
#: Classes of neighbours by their sum in steps.
NEIGHBOUR = (0, 1, 2, 2, 3, 3, 4, 4, 5, 5, 5, 6)


def code_integer(coder: Coder, name: Hashable, value: int = 0) -> int:
    """A whole number up to 2^32 - 2: its length in ones and a zero, then the bits below the leading one."""
    wide, length = value + 1, 0
    while coder.bit((name, "length", length), int(wide >> (length + 1) > 0)):
        length += 1
        if length > 31:
            raise CodeError("code-range")
    if length == 0:
        return 0
    first = coder.bit((name, "first", length), wide >> (length - 1) & 1)
    known = 2 | first
    if length > 1:
        second = coder.bit((name, "second", length, first), wide >> (length - 2) & 1)
        known = (known << 1 | second) << (length - 2) | coder.raw(length - 2, wide)
    return known - 1


def code_label(coder: Coder, name: Hashable, count: int, value: int = 0) -> int:
    """A label below `count`, at least 2: its eight highest bits by a tree, others raw."""
    bits = (count - 1).bit_length()
    low = max(0, bits - 8)
    node = 1
    for at in reversed(range(low, bits)):
        node = node << 1 | coder.bit((name, node), value >> at & 1)
    label = (node - (1 << (bits - low))) << low | coder.raw(low, value)
    if label >= count:
        raise CodeError("cluster-range")
    return label


def size_of(t: int, classes: int, zero: int) -> tuple[int, int]:
    """The class of an expected size of t half octaves, and how many low bits of such numbers are raw."""
    return min(max(t + zero, 0), classes - 1), min(max(0, (t >> 1) - 3), 20)


def code_magnitude(coder: Coder, name: str, size: tuple[int, int], around: Sequence[int], value: int = 0) -> int:
    """A magnitude by its class and neighbours: steps in ones and a zero, then the raw bits of a step."""
    kind, shift = size
    neighbours = NEIGHBOUR[min(sum(map(abs, around)) >> shift, 11)]
    steps, wanted = 0, abs(value) >> shift
    while steps < MOST_ONES and coder.bit((name, kind, neighbours, steps), int(wanted > steps)):
        steps += 1
    if steps == MOST_ONES:
        steps += _code_escape(coder, name, wanted - steps)
        if steps > MOST_MAGNITUDE >> shift:
            raise CodeError("code-range")
    return steps << shift | coder.raw(shift, abs(value))


def _code_escape(coder: Coder, name: str, value: int) -> int:
    """A whole number by its length in ones and a zero, and the bits below its leading one."""
    length = 0
    while coder.bit((name, "escape", length), int(value.bit_length() > length)):
        length += 1
        if length > 24:
            raise CodeError("code-range")
    return 1 << (length - 1) | coder.raw(length - 1, value) if length else 0
