"""The residual of a tensor that memory does not hold.

Levels whose node is the whole tensor are fitted from the source, read slab by slab; their models are never subtracted
from anything stored, but taken into account in closed form (`terms`). Where the tensor is subdivided, each node has its
*piece*. It is collected from the source when its turn comes, and its residual written to a scratch file if others will
read that. A source that the system will not keep in its cache is reordered first: what the levels above leave is
written piece by piece, in one pass. From then on only pieces are read.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum, auto
from functools import partial
from itertools import chain, repeat
from math import prod
from operator import add
from threading import Lock, local
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .. import backends as kernels
from ..arrays import F32
from ..axes import Organisation, mode_sizes
from ..cells import Cells
from ..metrics import squared_norm
from ..support.executors import in_order
from ..support.memory import stays_cached
from ..support.progress import Told, nobody, share_of
from .blocks import Block, Saved, norms_of, settled_by, thinned_block, thinned_cells
from .pieces import ZERO, Norms, Piece, Rows, pieces_of, places_of, put, split
from .scratch import Scratch
from .slabbed import Slabbed
from .source import Source

T = TypeVar("T")

#: Elements of a slab: 16 MiB, which the allocator keeps instead of asking the system for zeroed pages each time.
SLAB = 1 << 22
#: Slabs, at the least, of a tensor that is thinned, of which so many elements come of larger ones.
FEWEST = 16
#: Bytes of a mapped source in memory at a time beside the piece that is collected.
SEEN = 1 << 22


class Place(Enum):
    """Where the tensor is read from."""

    #: The source, slab by slab: there are no pieces.
    SOURCE = auto()
    #: The source, and its pieces are yet to be collected from there, each when its turn comes.
    TO_COLLECT = auto()
    #: The scratch file, in which the pieces lie.
    SCRATCH = auto()


@dataclass(eq=False)
class Streamed:
    """A tensor in a source or in pieces, less `models`: the residual A^(l) (paper, section 4.2).

    Its elements are never all at hand. At every time

        what is read + sum of weight * model over `terms` = source - sum of `models`

    as what is read is the source less what has been `subtracted`: nothing, while it is the source itself.

    Attributes:
        source: where the tensor is read from.
        organisation: of its axes into modes.
        threads: how many read and work at once.
        limit: most elements that are worked on in memory as one tensor.
        models: for each level whose node is the whole tensor its model now; None: it has none.
        subtracted: those of them when the pieces were written; `models` may have changed since.
        place: where the tensor is read from.
        pieces: in C order of the parts they are of; none while `place` is the source.
        parts: what the pieces were cut by, for each mode the part of every row.
        scratch: the file that the pieces lie in, or will.
        written_back: False while nobody will read the pieces again: what becomes of them is not kept.
        residual_norms: of what no level, the first, the first two .. leave, so far as passes saw it.
    """

    source: Source
    organisation: Organisation
    threads: int
    limit: int
    models: list[Cells | None] = field(default_factory=list["Cells | None"])
    subtracted: list[Cells | None] = field(default_factory=list["Cells | None"])
    place: Place = Place.SOURCE
    pieces: list[Piece] = field(default_factory=list[Piece])
    parts: list[NDArray[np.intp]] = field(default_factory=list["NDArray[np.intp]"])
    scratch: Scratch | None = None
    written_back: bool = True
    residual_norms: list[Norms] = field(default_factory=list[Norms])
    _beginning: Lock = field(default_factory=Lock)
    _coming: Iterator[Told] = field(default_factory=lambda: repeat(nobody))
    _held: local = field(default_factory=local)

    @property
    def shape(self) -> tuple[int, ...]:
        """Mode sizes."""
        return mode_sizes(self.source.axes, self.organisation)

    def terms(self, without: int | None = None) -> list[tuple[float, Cells]]:
        """Pairs of a weight and a model to add to blocks as they are read, to get the tensor less all of `models`.

        For each model that has changed: 1 and what was subtracted from what is read, -1 and what should be now. The
        model of the level `without` (from 0) should not be subtracted at all.
        """
        before = [*self.subtracted, *[None] * (len(self.models) - len(self.subtracted))]
        changes: list[tuple[float, Cells]] = []
        for number, (now, then) in enumerate(zip(self.models, before, strict=True)):
            wanted = None if number == without else now
            if wanted is not then:
                changes += [(1.0, then)] if then is not None else []
                changes += [(-1.0, wanted)] if wanted is not None else []
        return changes

    @property
    def _scratch(self) -> Scratch:
        with self._beginning:
            if self.scratch is None:
                self.scratch = Scratch(sum(piece.elements for piece in self.pieces))
        return self.scratch

    def change(self, number: int, cells: Cells | None) -> None:
        """The cells of level `number` (from 0), whose node is the whole tensor, are these from now on."""
        self.models += [None] * (number + 1 - len(self.models))
        self.models[number] = cells
        self.residual_norms = []

    def blocks(self, steps: Sequence[int] | None = None) -> list[Callable[[], Block]]:
        """Readers of all blocks, thinned to every steps-th row of each mode."""
        if self.place is not Place.SCRATCH:
            slab = SLAB if steps is None else max(SLAB, min(SLAB * prod(steps), prod(self.shape) // FEWEST))
            return [partial(self._source_slab, part, steps) for part in self.source.parts(slab)]
        readers: list[Callable[[], Block]] = []
        for piece in (piece for piece in self.pieces if piece.elements):
            if piece.elements <= self.limit:
                readers.append(partial(self._piece, piece, steps))
            else:
                readers += [partial(self._slab, piece, part, steps) for part in self.slabbed(piece).parts]
        return readers

    def _piece(self, piece: Piece, steps: Sequence[int] | None) -> Block:
        return thinned_block(Block(piece.rows, self.read(piece)), steps)

    def _slab(self, piece: Piece, part: tuple[slice, ...], steps: Sequence[int] | None) -> Block:
        return thinned_block(self.slabbed(piece).above(part), steps)

    def _source_slab(self, part: tuple[slice, ...], steps: Sequence[int] | None) -> Block:
        rows, tensor = self.source.block(self.organisation, part, steps)
        return Block(tuple(rows), tensor)

    def read(self, piece: Piece) -> F32:
        """A piece as it lies in the scratch file, or in the source."""
        if self.place is Place.TO_COLLECT:
            return self.source.at(self.organisation, piece.rows, SEEN)
        return self._scratch.read(piece.start, piece.elements).reshape(piece.sizes)

    def slabbed(self, piece: Piece) -> Slabbed:
        """A piece that memory does not hold, in slabs of the scratch file."""
        return Slabbed(self._scratch, piece, SLAB)

    def expect(self, piece: Piece) -> None:
        """The piece will be read soon."""
        if self.place is Place.SCRATCH:
            self._scratch.expect(piece.start, piece.elements)

    def settled(self, block: Block, without: int | None = None, steps: Sequence[int] | None = None) -> F32:
        """The block, in place, with the terms added."""
        if block.tensor.size:
            for weight, cells in self.terms(without):
                kernels.accumulate(thinned_cells(cells, steps).part(block.rows), block.tensor, weight)
        return block.tensor

    def sample(self, steps: Sequence[int], without: int | None = None) -> F32:
        """Every steps-th row of each mode of the tensor less all of `models` but one, in one piece."""
        values = np.zeros([-(-size // step) for size, step in zip(self.shape, steps, strict=True)], np.float32)

        def copy(block: Block) -> None:
            if block.tensor.size:
                values[np.ix_(*block.rows)] = self.settled(block, without, steps)

        for _ in self.each(copy, self.blocks(steps)):
            pass
        return values

    def each(self, work: Callable[[Block], T], readers: Sequence[Callable[[], Block]]) -> Iterator[T]:
        """The results of working on every block, in order."""
        told, workers = next(self._coming), self.workers(SLAB)
        with kernels.threads(1 if workers == self.threads else self.threads, after=self.threads):
            for done, made in enumerate(in_order(lambda reader: work(reader()), readers, workers), start=1):
                yield made
                told(done / len(readers))

    @contextmanager
    def telling(self, told: Told, passes: int) -> Generator[None]:
        """Tell how much is done of so many passes over all blocks."""
        self._coming = chain((share_of(told, number, passes) for number in range(passes)), repeat(nobody))
        try:
            yield
        finally:
            self._coming = repeat(nobody)

    def workers(self, elements: int) -> int:
        """How many tensors of this size may be worked on at once."""
        return max(1, min(self.threads, self.limit // max(1, elements)))

    @property
    def error(self) -> float:
        """Squared norm of the tensor less all of `models`, and less what has been subtracted from pieces."""
        if self.place is Place.SCRATCH and not self.terms():
            return sum(piece.norms.squares for piece in self.pieces)
        return sum(self.each(lambda block: squared_norm(self.settled(block)), self.blocks()))

    def cut(
        self, parts: Sequence[NDArray[np.intp]], counts: Sequence[int], told: Told = nobody, *, once: bool = False
    ) -> list[Piece]:
        """A piece of what `models` leave for each combination of parts of rows, in C order.

        Pieces that are those already stay as they are. Those that are read but `once` as they are now may be collected
        from the source; others are written to a scratch file, which is `told`.
        """
        if self.pieces and all(map(np.array_equal, self.parts, parts)):
            return self.pieces
        pieces, fresh = pieces_of(parts, counts), once and self.place is not Place.SCRATCH
        at_hand = fresh and stays_cached(self.source.array.nbytes)
        self.residual_norms = []
        if at_hand and all(piece.elements <= self.limit for piece in pieces):
            self.place, self.subtracted = Place.TO_COLLECT, []
        else:
            told(0.0)
            with self.telling(told, 1):
                self.scratch = self._written(pieces, parts, counts, watched=fresh)
            self.place, self.subtracted = Place.SCRATCH, list(self.models)
        self.pieces, self.parts = pieces, list(parts)
        return self.pieces

    def in_blocks(self, parts: Sequence[NDArray[np.intp]], counts: Sequence[int], number: int) -> Streamed:
        """The tensor less all levels but `number`, which is to be fitted to such pieces one by one."""
        self.change(number, None)
        self.cut(parts, counts)
        return self

    def _written(
        self, pieces: Sequence[Piece], parts: Sequence[NDArray[np.intp]], counts: Sequence[int],
        without: int | None = None, *, watched: bool = False,
    ) -> Scratch:
        """The pieces in a new scratch file; if `watched`, the norms of what each level leaves are seen on the way."""
        places, scratch = [places_of(part) for part in parts], Scratch(sum(piece.elements for piece in pieces))

        def write(block: Block) -> tuple[list[tuple[int, Norms]], list[Norms]]:
            seen, found = settled_by(block, self.models) if watched else [], list[tuple[int, Norms]]()
            tensor = block.tensor if watched else self.settled(block, without)
            for child, sub, rows in split(tensor, block.rows, parts):
                number = int(np.ravel_multi_index(child, tuple(counts)))
                put(scratch, pieces[number], [place[r] for place, r in zip(places, rows, strict=True)], sub)
                found.append((number, norms_of(sub)))
            return found, seen

        for found, seen in self.each(write, self.blocks()):
            self.residual_norms = list(map(add, self.residual_norms, seen)) if self.residual_norms else seen
            for number, norms in found:
                pieces[number].norms += norms
        return scratch

    @contextmanager
    def holding(self, piece: Piece) -> Generator[None]:
        """Keep a piece in this thread's memory while nodes in it are worked on; written back if it has changed.

        A piece that memory does not hold stays where it is.
        """
        if piece.elements > self.limit:
            self._held.changed = False
            yield
            if self.terms() and not self._held.changed:
                slabbed = self.slabbed(piece)
                slabbed.rewrite(lambda part: self.settled(slabbed.above(part)), self.workers(SLAB))
            return
        block, fresh = Block(piece.rows, self.read(piece)), self.place is Place.TO_COLLECT
        if fresh:
            piece.norms_above = settled_by(block, self.models)
            piece.norms = piece.norms_above[-1]
        tensor, scratch = block.tensor if fresh else self.settled(block), self._scratch if self.written_back else None
        self._held.piece, self._held.tensor, self._held.changed = piece, tensor, not fresh and bool(self.terms())
        try:
            yield
            if scratch is not None and (fresh or self._held.changed) and piece.elements:
                scratch.write(piece.start, tensor)
            if self._held.changed:
                piece.norms = norms_of(tensor)
        finally:
            self._held.piece = self._held.tensor = None

    def gather(self, rows: Rows, piece: Piece | None, *, lent: bool) -> F32:
        """A node's sub-tensor out of the piece that this thread holds; a copy, or the piece itself if it is `lent`."""
        assert piece is not None
        assert self._held.piece is piece
        if len(rows[0]) and all(len(r) == size for r, size in zip(rows, piece.sizes, strict=True)):
            return self._held.tensor if lent else self._held.tensor.copy()
        return kernels.gather(self._held.tensor, self._within(rows, piece))

    def scatter(self, rows: Rows, piece: Piece | None, values: F32) -> None:
        """Put it back."""
        assert piece is not None
        assert self._held.piece is piece
        if values is not self._held.tensor:
            kernels.scatter(self._held.tensor, self._within(rows, piece), values)
        self.note_changed()

    def note_changed(self) -> None:
        """What this thread holds is not what it was."""
        self._held.changed = True

    def _within(self, rows: Rows, piece: Piece) -> list[NDArray[np.intp]]:
        return [np.searchsorted(all_, r) for all_, r in zip(piece.rows, rows, strict=True)]

    def settle(self) -> None:
        """All pieces have been held with the present terms: there are none any more."""
        if self.place is Place.TO_COLLECT:
            each = zip(*(piece.norms_above for piece in self.pieces), strict=True)
            self.residual_norms = [sum(norms, ZERO) for norms in each]
        self.subtracted, self.place = list(self.models), Place.SCRATCH
        if not self.written_back and self.scratch is not None:
            self.scratch.close()

    def fitted(self, depth: int) -> None:
        """All pieces are now less the level of this depth, too."""
        norms, known = sum((piece.norms for piece in self.pieces), ZERO), self.residual_norms
        self.residual_norms = [*known[:depth], norms] if len(known) >= depth else []

    def saved(self, *, pieces: bool) -> Saved:
        """All that changes, to go back to; what lies in `pieces`, if that will, is copied to a second scratch file."""
        if not pieces:
            return Saved(list(self.models))
        norms = [piece.norms for piece in self.pieces]
        scratch = self._scratch.copy() if self.place is Place.SCRATCH else None
        return Saved(list(self.models), list(self.subtracted), norms, list(self.residual_norms), scratch)

    def restore(self, saved: Saved) -> None:
        """Go back, with the pieces there were then; or as they are, where they were not saved."""
        self.models, self.residual_norms = list(saved.models), list(saved.residual_norms)
        if saved.piece_norms is not None:
            self.subtracted = list(saved.subtracted)
            self.place = Place.TO_COLLECT if saved.scratch is None else Place.SCRATCH
            for piece, norms in zip(self.pieces, saved.piece_norms, strict=True):
                piece.norms = norms
        if saved.scratch is not None:
            saved.scratch.copy_to(self._scratch)
