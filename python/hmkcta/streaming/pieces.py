"""Pieces of a scratch file: sub-tensors in the order in which their elements lie in it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import prod

import numpy as np
from numpy.typing import NDArray

from ..support.grouping import rows_of_parts
from .scratch import Scratch

F32 = NDArray[np.float32]
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
    """Write a block into a piece: in runs of elements that lie side by side in both."""
    sizes, inner = piece.sizes, values.ndim - 1
    while inner > 0 and len(places[inner]) == sizes[inner]:
        inner -= 1
    if len(places[inner]) == int(places[inner][-1] - places[inner][0]) + 1:  # neighbours of the first mode not whole
        inner -= 1
    outer = places[: inner + 1]
    run = values.reshape(prod(len(p) for p in outer), -1)
    strides = [prod(sizes[n + 1 :]) for n in range(len(sizes))]
    first = sum(int(p[0]) * s for p, s in zip(places[inner + 1 :], strides[inner + 1 :], strict=True))
    offsets = np.zeros((), np.intp)
    for place, stride in zip(outer, strides, strict=False):
        offsets = np.add.outer(offsets, place * stride)
    for offset, numbers in zip(offsets.reshape(-1), run, strict=True):
        scratch.write(piece.start + first + int(offset), numbers)
