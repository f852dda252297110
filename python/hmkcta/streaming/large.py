"""A piece that memory does not hold, as a streamed tensor of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ..cells import Cells
from .blocks import Block, thinned_block
from .pieces import Piece, pieces_of
from .streamed import Place, Streamed


def large(residual: Streamed, piece: Piece) -> Large | None:
    """The piece of a residual as a streamed tensor of its own, if memory does not hold it."""
    if piece.elements <= residual.limit:
        return None
    return Large(
        residual.source, residual.organisation, residual.threads, residual.limit,
        place=Place.SCRATCH, scratch=residual.scratch, of=piece, above=residual,
    )  # fmt: skip


@dataclass(eq=False)
class Large(Streamed):
    """A piece that memory does not hold; what is fitted to it, as level 0, is subtracted from it at once.

    Attributes:
        of: the piece.
        above: the residual that it is a piece of.
    """

    of: Piece = field(kw_only=True)
    above: Streamed = field(kw_only=True)

    @property
    def shape(self) -> tuple[int, ...]:
        """Mode sizes of the piece."""
        return self.of.sizes

    @property
    def error(self) -> float:
        """Squared norm of the piece's residual, which is known unless levels above have changed since."""
        return super().error if self.terms() else self.of.norms.squares

    def terms(self, without: int | None = None) -> list[tuple[float, Cells]]:
        """Also what levels above have changed by since the piece was written."""
        return super().terms(without) + [(weight, cells.part(self.of.rows)) for weight, cells in self.above.terms()]

    def blocks(self, steps: Sequence[int] | None = None) -> list[Callable[[], Block]]:
        """Readers of slabs of the piece."""
        return [partial(self._thinned_slab, part, steps) for part in self.above.slabbed(self.of).parts]

    def in_blocks(self, parts: Sequence[NDArray[np.intp]], counts: Sequence[int], number: int) -> Streamed:
        """Its pieces in a scratch file of their own."""
        pieces = pieces_of(parts, counts)
        scratch = self._written(pieces, parts, counts, number)
        cut = Streamed(self.source, self.organisation, self.threads, self.limit, place=Place.SCRATCH, scratch=scratch)
        cut.pieces = pieces
        return cut

    def already_less(self, cells: Cells) -> None:
        """These cells of the piece's are among what has been subtracted from it."""
        self.models, self.subtracted = [cells], [cells]

    def change(self, number: int, cells: Cells | None) -> None:
        """The piece's cells are these from now on; the piece is rewritten."""
        super().change(number, cells)
        slabbed = self.above.slabbed(self.of)
        slabbed.rewrite(lambda part: self.settled(slabbed.block(part)), self.workers(slabbed.most))
        self.above.note_changed()
        self.settle()

    def _thinned_slab(self, part: tuple[slice, ...], steps: Sequence[int] | None) -> Block:
        return thinned_block(self.above.slabbed(self.of).block(part), steps)
