"""Pieces of a scratch file: sub-tensors in the order in which their elements lie in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import prod

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32
from ..support.grouping import rows_of_parts
from .scratch import Scratch

Rows = tuple[NDArray[np.intp], ...]


@dataclass(eq=False)
class SubTensor:
    """What has some rows of every mode, by their numbers in the whole tensor."""

    rows: Rows

    @property
    def sizes(self) -> tuple[int, ...]:
        """Mode sizes."""
        return tuple(len(rows) for rows in self.rows)

    @property
    def elements(self) -> int:
        """How many elements it has."""
        return prod(self.sizes)


@dataclass(frozen=True)
class Norms:
    """Of a residual, in multiples of the `unit` that a source divides by: the sum of squares, the largest magnitude."""

    squares: float = 0.0
    largest: float = 0.0

    def __add__(self, other: Norms) -> Norms:
        return Norms(self.squares + other.squares, max(self.largest, other.largest))


ZERO = Norms()


@dataclass(eq=False)
class Piece(SubTensor):
    """A node's sub-tensor in the scratch file.

    Attributes:
        start: number of its first element there.
        norms_above: of what no level, the first, the first two .. of those above leave of it.
        norms: of its residual now.
    """

    start: int
    norms_above: list[Norms] = field(default_factory=list["Norms"])
    norms: Norms = ZERO


def places_of(part: NDArray[np.intp]) -> NDArray[np.intp]:
    """For each row its position among the rows of its part.

    >>> places_of(np.array([1, 0, 1, 1])).tolist()
    [0, 0, 1, 2]
    """
    place = np.empty(len(part), np.intp)
    for rows in rows_of_parts(part):
        place[rows] = np.arange(len(rows))
    return place


def split(
    tensor: F32, rows: Rows, parts: Sequence[NDArray[np.intp]], n: int = 0, done: tuple[int, ...] = ()
) -> Iterator[tuple[tuple[int, ...], F32, Rows]]:
    """The block's elements of every combination of parts, with their rows."""
    if n == tensor.ndim:
        yield done, tensor, rows
        return
    labels = parts[n][rows[n]]
    for c, at in enumerate(rows_of_parts(labels)):
        if len(at):
            chosen = (*rows[:n], rows[n][at], *rows[n + 1 :])
            sub = tensor if len(at) == len(labels) else tensor.take(at, axis=n)
            yield from split(sub, chosen, parts, n + 1, (*done, c))


def pieces_of(parts: Sequence[NDArray[np.intp]], counts: Sequence[int]) -> list[Piece]:
    """A piece for each combination of parts of rows, in C order, one after the other."""
    lists = [rows_of_parts(part, count) for part, count in zip(parts, counts, strict=True)]
    pieces, start = list[Piece](), 0
    for rows in product(*lists):
        pieces.append(Piece(rows, start))
        start += pieces[-1].elements
    return pieces


def put(scratch: Scratch, piece: Piece, places: Sequence[NDArray[np.intp]], values: F32) -> None:
    """Write a block into a piece: in runs of elements that lie side by side in both.

    Here it is the last two rows of both matrices of a piece of 2 x 3 x 4 elements. They lie side by side: two runs of
    eight numbers are written.

    >>> piece = Piece((np.arange(2), np.arange(3), np.arange(4)), 0)
    >>> with Scratch(24) as scratch:
    ...     places = [np.array([0, 1]), np.array([1, 2]), np.arange(4)]
    ...     put(scratch, piece, places, np.ones((2, 2, 4), np.float32))
    ...     scratch.read(0, 24).reshape(2, 3, 4).sum(axis=2).tolist()
    [[0.0, 4.0, 4.0], [0.0, 4.0, 4.0]]
    """
    starts, length = _runs(piece.sizes, places)
    for start, numbers in zip(starts, values.reshape(-1, length), strict=True):
        scratch.write(piece.start + int(start), numbers)


def _runs(sizes: Sequence[int], places: Sequence[NDArray[np.intp]]) -> tuple[NDArray[np.intp], int]:
    """Where in a piece of these sizes runs begin that make up the block of these places, and how long they all are.

    >>> _runs((2, 3, 4), [np.array([0, 1]), np.array([1, 2]), np.arange(4)])
    (array([ 4, 16]), 8)
    """
    first_whole_mode = len(sizes)  # from which on all modes are whole
    while first_whole_mode > 1 and len(places[first_whole_mode - 1]) == sizes[first_whole_mode - 1]:
        first_whole_mode -= 1
    before = places[first_whole_mode - 1]
    # Neighbours of the mode before those that are whole lie side by side, too.
    inner = first_whole_mode - 1 if len(before) == int(before[-1] - before[0]) + 1 else first_whole_mode
    strides = [prod(sizes[n + 1 :]) for n in range(len(sizes))]
    first = sum(int(place[0]) * stride for place, stride in zip(places[inner:], strides[inner:], strict=True))
    starts = np.full((), first, np.intp)
    for place, stride in zip(places[:inner], strides, strict=False):
        starts = np.add.outer(starts, place * stride)
    return starts.reshape(-1), prod(len(place) for place in places[inner:])
