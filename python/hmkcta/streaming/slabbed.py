"""A piece that memory does not hold: read from the scratch file, and written back to it, slab by slab."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import prod

import numpy as np

from ..arrays import F32
from ..support.executors import in_order
from ..support.slabs import slabs
from .blocks import Block, norms_of
from .pieces import ZERO, Norms, Piece
from .scratch import Scratch


@dataclass(frozen=True, eq=False)
class Slabbed:
    """A piece in a scratch file, in slabs.

    Attributes:
        scratch: where it lies.
        piece: which it is.
        most: elements of a slab.

    >>> piece = Piece((np.array([1, 4]), np.array([0, 2, 5])), 0)
    >>> with Scratch(6) as scratch:
    ...     scratch.write(0, np.arange(6, dtype=np.float32))
    ...     slabbed = Slabbed(scratch, piece, 3)
    ...     for part in slabbed.parts:
    ...         slabbed.above(part).rows[0].tolist(), slabbed.block(part).tensor.tolist()
    ([1], [[0.0, 1.0, 2.0]])
    ([4], [[3.0, 4.0, 5.0]])
    """

    scratch: Scratch
    piece: Piece
    most: int

    @property
    def parts(self) -> list[tuple[slice, ...]]:
        """The slabs: for each of the first modes which rows of the piece."""
        return list(slabs(self.piece.sizes, self.most))

    def block(self, part: tuple[slice, ...]) -> Block:
        """A slab, its rows numbered within the piece."""
        sizes = self.piece.sizes
        spans = [*part, *[slice(None)] * (len(sizes) - len(part))]
        rows = [np.arange(size)[span] for size, span in zip(sizes, spans, strict=True)]
        lengths = [len(r) for r in rows]
        return Block(tuple(rows), self.scratch.read(self._start(part), prod(lengths)).reshape(lengths))

    def above(self, part: tuple[slice, ...]) -> Block:
        """A slab, its rows numbered as in the whole tensor."""
        block = self.block(part)
        rows = tuple(all_[own] for all_, own in zip(self.piece.rows, block.rows, strict=True))
        return Block(rows, block.tensor)

    def rewrite(self, read: Callable[[tuple[slice, ...]], F32], workers: int) -> None:
        """Write instead of every slab what is made of it, by so many at once; the piece's norms are those of it all."""

        def write(part: tuple[slice, ...]) -> Norms:
            tensor = read(part)
            self.scratch.write(self._start(part), tensor)
            return norms_of(tensor)

        self.piece.norms = sum(in_order(write, self.parts, workers), ZERO)

    def _start(self, part: tuple[slice, ...]) -> int:
        """Number of a slab's first element in the scratch file."""
        strides = [prod(self.piece.sizes[n + 1 :]) for n in range(len(part))]
        return self.piece.start + sum(span.start * stride for span, stride in zip(part, strides, strict=True))
