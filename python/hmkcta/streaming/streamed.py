"""The residual of a tensor that memory does not hold.

Levels whose node is the whole tensor are fitted from the source, read slab by slab; their models are never subtracted
from anything stored, but taken into account in closed form (`terms`). Where the tensor is subdivided, each node has its
*piece*. It is collected from the source when its turn comes, and what is left of it written to a scratch file if others
will read that. A source that the system will not keep in its cache is reordered first: what the levels above leave is
written piece by piece, in one pass. From then on only pieces are read.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, repeat
from math import prod
from operator import add
from threading import Lock, local
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .. import backends as kernels
from ..axes import Organisation, mode_sizes
from ..cells import Cells
from ..metrics import squared_norm
from ..support.executors import in_order
from ..support.memory import stays_cached
from ..support.progress import Told, nobody, share_of
from ..support.slabs import slabs
from .blocks import Block, Saved, left_of, settled_by, thinned_block, thinned_cells
from .pieces import NOTHING, Left, Piece, Rows, pieces_of, places_of, put, split
from .scratch import Scratch
from .source import Source

F32 = NDArray[np.float32]
T = TypeVar("T")

#: Elements of a slab: 16 MiB, which the allocator keeps instead of asking the system for zeroed pages each time.
SLAB = 1 << 22
#: Slabs, at the least, of a tensor that is thinned, of which so many elements come of larger ones.
FEWEST = 16
#: Bytes of a mapped source in memory at a time beside the piece that is collected.
SEEN = 1 << 22


@dataclass(eq=False)
class Streamed:
    """A tensor in a source or in pieces, less the models of `wholes`.

    Attributes:
        source: where the tensor is read from.
        organisation: of its axes into modes.
        threads: how many read and work at once.
        limit: most elements that are worked on in memory as one tensor.
        wholes: for each level whose node is the whole tensor its model now; None: it has none.
        stored: the models that were subtracted when the pieces were written, which `wholes` may differ from since.
        pieces: empty as long as the source is read.
        parts: what the pieces were cut by, for each mode the part of every row.
        in_source: whether the pieces are still to be collected from the source.
        lasting: False while nobody will read the pieces again: they are not written back, and gone afterwards.
        known: the energy and largest magnitude left by no level, the first, the first two .., so far as passes saw it.
    """

    source: Source
    organisation: Organisation
    threads: int
    limit: int
    wholes: list[Cells | None] = field(default_factory=list["Cells | None"])
    stored: list[Cells | None] = field(default_factory=list["Cells | None"])
    pieces: list[Piece] = field(default_factory=list[Piece])
    parts: list[NDArray[np.intp]] = field(default_factory=list["NDArray[np.intp]"])
    scratch: Scratch | None = None
    in_source: bool = False
    lasting: bool = True
    known: list[Left] = field(default_factory=list[Left])
    _beginning: Lock = field(default_factory=Lock)
    _coming: Iterator[Told] = field(default_factory=lambda: repeat(nobody))
    _held: local = field(default_factory=local)

    @property
    def shape(self) -> tuple[int, ...]:
        """Mode sizes."""
        return mode_sizes(self.source.axes, self.organisation)

    def terms(self, without: int | None = None) -> list[tuple[float, Cells]]:
        """Pairs of a weight and a model to add to blocks as they are read, to get the tensor less all of `wholes`.

        For each model that has changed: 1 and what was subtracted from what is read (`stored`), -1 and what should be
        now. The model of the level `without` (from 0) should not be subtracted at all.
        """
        stored = [*self.stored, *[None] * (len(self.wholes) - len(self.stored))]
        changes: list[tuple[float, Cells]] = []
        for number, (now, then) in enumerate(zip(self.wholes, stored, strict=True)):
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
        self.wholes += [None] * (number + 1 - len(self.wholes))
        self.wholes[number] = cells
        self.known = []

    def blocks(self, steps: Sequence[int] | None = None) -> list[Callable[[], Block]]:
        """Readers of all blocks, thinned to every steps-th row of each mode."""
        if not self.pieces or self.in_source:
            slab = SLAB if steps is None else max(SLAB, min(SLAB * prod(steps), prod(self.shape) // FEWEST))
            return [partial(self._source_slab, part, steps) for part in self.source.parts(slab)]
        readers: list[Callable[[], Block]] = []
        for piece in (piece for piece in self.pieces if piece.elements):
            large = self.large(piece)
            readers += [partial(self._piece, piece, steps)] if large is None else large.within(steps)
        return readers

    def _piece(self, piece: Piece, steps: Sequence[int] | None) -> Block:
        return thinned_block(Block(piece.rows, self.read(piece)), steps)

    def _source_slab(self, part: tuple[slice, ...], steps: Sequence[int] | None) -> Block:
        rows, tensor = self.source.block(self.organisation, part, steps)
        return Block(tuple(rows), tensor)

    def read(self, piece: Piece) -> F32:
        """A piece as it lies in the scratch file, or in the source."""
        if self.in_source:
            return self.source.at(self.organisation, piece.rows, SEEN)
        return self._scratch.read(piece.start, piece.elements).reshape(piece.sizes)

    def expect(self, piece: Piece) -> None:
        """The piece will be read soon."""
        if not self.in_source:
            self._scratch.expect(piece.start, piece.elements)

    def settled(self, block: Block, without: int | None = None, steps: Sequence[int] | None = None) -> F32:
        """The block, in place, with the terms added."""
        if block.tensor.size:
            for weight, cells in self.terms(without):
                kernels.accumulate(thinned_cells(cells, steps).part(block.rows), block.tensor, weight)
        return block.tensor

    def sample(self, steps: Sequence[int], without: int | None = None) -> F32:
        """Every steps-th row of each mode of the tensor less all of `wholes` but one, in one piece."""
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
        """Squared norm of the tensor less all of `wholes`, and less what has been subtracted from pieces."""
        if self.pieces and not self.in_source and not self.terms():
            return sum(piece.left.squares for piece in self.pieces)
        return sum(self.each(lambda block: squared_norm(self.settled(block)), self.blocks()))

    def cut(
        self, parts: Sequence[NDArray[np.intp]], counts: Sequence[int], told: Told = nobody, *, once: bool = False
    ) -> list[Piece]:
        """A piece of what `wholes` leave for each combination of parts of rows, in C order.

        Pieces that are those already stay as they are. Those that are read but `once` as they are now may be collected
        from the source; others are written to a scratch file, which is `told`.
        """
        if self.pieces and all(map(np.array_equal, self.parts, parts)):
            return self.pieces
        pieces, fresh = pieces_of(parts, counts), once and (not self.pieces or self.in_source)
        at_hand = fresh and stays_cached(self.source.array.nbytes)
        self.in_source = at_hand and all(piece.elements <= self.limit for piece in pieces)
        self.known = []
        if not self.in_source:
            told(0.0)
            with self.telling(told, 1):
                self.scratch = self._written(pieces, parts, counts, watched=fresh)
        self.pieces, self.parts, self.stored = pieces, list(parts), [] if self.in_source else list(self.wholes)
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
        """The pieces in a new scratch file; if `watched`, what each level leaves is seen on the way, and `known`."""
        places, scratch = [places_of(part) for part in parts], Scratch(sum(piece.elements for piece in pieces))

        def write(block: Block) -> tuple[list[tuple[int, Left]], list[Left]]:
            seen, found = settled_by(block, self.wholes) if watched else [], list[tuple[int, Left]]()
            tensor = block.tensor if watched else self.settled(block, without)
            for child, sub, rows in split(tensor, block.rows, parts):
                number = int(np.ravel_multi_index(child, tuple(counts)))
                put(scratch, pieces[number], [place[r] for place, r in zip(places, rows, strict=True)], sub)
                found.append((number, left_of(sub)))
            return found, seen

        for found, seen in self.each(write, self.blocks()):
            self.known = list(map(add, self.known, seen)) if self.known else seen
            for number, left in found:
                pieces[number].left += left
        return scratch

    @contextmanager
    def holding(self, piece: Piece) -> Generator[None]:
        """Keep a piece in this thread's memory while nodes in it are worked on; written back if it has changed.

        A large piece is left where it is.
        """
        if (large := self.large(piece)) is not None:
            self._held.changed = False
            yield
            if self.terms() and not self._held.changed:
                large.rewrite()
            return
        block, fresh = Block(piece.rows, self.read(piece)), self.in_source
        if fresh:
            piece.above = settled_by(block, self.wholes)
            piece.left = piece.above[-1]
        tensor, scratch = block.tensor if fresh else self.settled(block), self._scratch if self.lasting else None
        self._held.piece, self._held.tensor, self._held.changed = piece, tensor, not fresh and bool(self.terms())
        try:
            yield
            if scratch is not None and (fresh or self._held.changed) and piece.elements:
                scratch.write(piece.start, tensor)
            if self._held.changed:
                piece.left = left_of(tensor)
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
        if self.in_source:
            self.known = [sum(lefts, NOTHING) for lefts in zip(*(piece.above for piece in self.pieces), strict=True)]
        self.stored, self.in_source = list(self.wholes), False
        if not self.lasting and self.scratch is not None:
            self.scratch.close()

    def fitted(self, depth: int) -> None:
        """All pieces are now less the level of this depth, too."""
        left = sum((piece.left for piece in self.pieces), NOTHING)
        self.known = [*self.known[:depth], left] if len(self.known) >= depth else []

    def saved(self, *, pieces: bool) -> Saved:
        """All that changes, to go back to; what lies in `pieces`, if that will, is copied to a second scratch file."""
        if not pieces:
            return Saved(list(self.wholes))
        left, scratch = [piece.left for piece in self.pieces], None if self.in_source else self._scratch.copy()
        return Saved(list(self.wholes), list(self.stored), left, list(self.known), scratch)

    def restore(self, saved: Saved) -> None:
        """Go back, with the pieces there were then; or as they are, where they were not saved."""
        self.wholes, self.known = list(saved.wholes), list(saved.known)
        if saved.left is not None:
            self.stored, self.in_source = list(saved.stored), saved.scratch is None
            for piece, left in zip(self.pieces, saved.left, strict=True):
                piece.left = left
        if saved.scratch is not None:
            saved.scratch.copy_to(self._scratch)

    def large(self, piece: Piece) -> Large | None:
        """The piece as a streamed tensor of its own, if memory does not hold it."""
        if piece.elements <= self.limit:
            return None
        return Large(
            self.source, self.organisation, self.threads, self.limit, scratch=self.scratch, of=piece, above=self
        )


@dataclass(eq=False)
class Large(Streamed):
    """A piece that memory does not hold; what is fitted to it, as level 0, is subtracted from it at once."""

    of: Piece = field(kw_only=True)
    above: Streamed = field(kw_only=True)

    @property
    def shape(self) -> tuple[int, ...]:
        """Mode sizes of the piece."""
        return self.of.sizes

    @property
    def error(self) -> float:
        """Squared norm of what is left of the piece, which is known unless levels above have changed since."""
        return super().error if self.terms() else self.of.left.squares

    def terms(self, without: int | None = None) -> list[tuple[float, Cells]]:
        """Also what levels above have changed by since the piece was written."""
        return super().terms(without) + [(weight, cells.part(self.of.rows)) for weight, cells in self.above.terms()]

    def blocks(self, steps: Sequence[int] | None = None) -> list[Callable[[], Block]]:
        """Readers of slabs of the piece."""
        return [partial(self._thinned_slab, part, steps) for part in slabs(self.shape, SLAB)]

    def within(self, steps: Sequence[int] | None) -> list[Callable[[], Block]]:
        """Readers of its slabs as blocks of the tensor above."""
        return [partial(self._slab_above, part, steps) for part in slabs(self.shape, SLAB)]

    def in_blocks(self, parts: Sequence[NDArray[np.intp]], counts: Sequence[int], number: int) -> Streamed:
        """Its pieces in a scratch file of their own."""
        cut = Streamed(self.source, self.organisation, self.threads, self.limit)
        cut.pieces = pieces_of(parts, counts)
        cut.scratch = self._written(cut.pieces, parts, counts, number)
        return cut

    def _thinned_slab(self, part: tuple[slice, ...], steps: Sequence[int] | None) -> Block:
        return thinned_block(self._slab(part), steps)

    def _slab_above(self, part: tuple[slice, ...], steps: Sequence[int] | None) -> Block:
        block = self._slab(part)
        rows = tuple(all_[own] for all_, own in zip(self.of.rows, block.rows, strict=True))
        return thinned_block(Block(rows, block.tensor), steps)

    def change(self, number: int, cells: Cells | None) -> None:
        """The piece's cells are these from now on; the piece is rewritten."""
        super().change(number, cells)
        self.rewrite()

    def rewrite(self) -> None:
        """Store what is left now."""
        scratch = self._scratch

        def write(part: tuple[slice, ...]) -> Left:
            block = self._slab(part)
            scratch.write(self._start(part), self.settled(block))
            return left_of(block.tensor)

        self.of.left = sum(in_order(write, list(slabs(self.shape, SLAB)), self.workers(SLAB)), NOTHING)
        self.above.note_changed()
        self.settle()

    def _slab(self, part: tuple[slice, ...]) -> Block:
        spans = [*part, *[slice(None)] * (len(self.shape) - len(part))]
        rows = [np.arange(size)[span] for size, span in zip(self.shape, spans, strict=True)]
        sizes = [len(r) for r in rows]
        return Block(tuple(rows), self._scratch.read(self._start(part), prod(sizes)).reshape(sizes))

    def _start(self, part: tuple[slice, ...]) -> int:
        strides = [prod(self.shape[n + 1 :]) for n in range(len(part))]
        return self.of.start + sum(span.start * stride for span, stride in zip(part, strides, strict=True))
