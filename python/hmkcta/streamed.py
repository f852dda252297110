"""The residual of a tensor that memory does not hold.

Levels whose node is the whole tensor are fitted from the source, read slab by slab; their models are never subtracted
from anything stored, but taken into account in closed form (`terms`). Where the tensor is subdivided, what these levels
leave is written to a scratch file in the order of the nodes, each in one *piece*. From then on only pieces are read.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, product, repeat
from math import prod
from threading import local
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from . import backends as kernels
from .axes import Organisation, mode_sizes
from .cells import Cells
from .executors import in_order
from .grouping import rows_of_parts
from .metrics import squared_norm
from .pieces import Piece, Rows, places_of, put, split
from .progress import Told, nobody, share_of
from .scratch import Scratch
from .slabs import slabs
from .source import Source

F32 = NDArray[np.float32]
S = TypeVar("S")
T = TypeVar("T")

#: Elements of a slab: 16 MiB, which the allocator keeps instead of asking the system for zeroed pages each time.
SLAB = 1 << 22


@dataclass(frozen=True, eq=False)
class Block:
    """Some elements of the tensor: an outer product of rows."""

    rows: Rows
    tensor: F32


@dataclass(frozen=True, eq=False)
class Saved:
    """A state of a streamed residual."""

    wholes: list[Cells | None]
    stored: list[Cells | None] = field(default_factory=list["Cells | None"])
    energies: list[float] = field(default_factory=list[float])
    scratch: Scratch | None = None


@dataclass(eq=False)
class Streamed:
    """A tensor in a source or in pieces, less the models of `wholes`.

    Attributes:
        source: where the tensor is read from.
        organisation: of its axes into modes.
        threads: how many read and work at once.
        limit: most elements that are worked on in memory as one tensor.
        wholes: the cells of the levels whose node is the whole tensor, as they are now.
        stored: of those, the cells that what lies in the pieces was computed with.
        pieces: empty as long as the source is read.
        parts: what the pieces were cut by, for each mode the part of every row.
        lasting: False while nobody will read the pieces again: they are not written back, and gone afterwards.
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
    lasting: bool = True
    _coming: Iterator[Told] = field(default_factory=lambda: repeat(nobody))
    _held: local = field(default_factory=local)

    @property
    def shape(self) -> tuple[int, ...]:
        """Mode sizes."""
        return mode_sizes(self.source.axes, self.organisation)

    def terms(self, without: int | None = None) -> list[tuple[float, Cells]]:
        """What to add to the blocks as they are read, weights and models, to have the tensor less all of `wholes`.

        All but the one numbered `without`, where given.
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
        assert self.scratch is not None
        return self.scratch

    def change(self, number: int, cells: Cells | None) -> None:
        """The cells of level `number` (from 0), whose node is the whole tensor, are these from now on."""
        self.wholes += [None] * (number + 1 - len(self.wholes))
        self.wholes[number] = cells

    def blocks(self, steps: Sequence[int] | None = None) -> list[Callable[[], Block]]:
        """Readers of all blocks, thinned to every steps-th row of each mode."""
        readers: list[Callable[[], Block]] = []
        for piece in (piece for piece in self.pieces if piece.elements):
            large = self.large(piece)
            readers += [partial(self._piece, piece, steps)] if large is None else large.within(steps)
        if not self.pieces:
            readers += [partial(self._source_slab, part, steps) for part in self.source.parts(SLAB)]
        return readers

    def _piece(self, piece: Piece, steps: Sequence[int] | None) -> Block:
        return _thinned(Block(piece.rows, self.read(piece)), steps)

    def _source_slab(self, part: tuple[slice, ...], steps: Sequence[int] | None) -> Block:
        rows, tensor = self.source.block(self.organisation, part, steps)
        return Block(tuple(rows), tensor)

    def read(self, piece: Piece) -> F32:
        """A piece as it lies in the scratch file."""
        return self._scratch.read(piece.start, piece.elements).reshape(piece.sizes)

    def expect(self, piece: Piece) -> None:
        """The piece will be read soon."""
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
        told = next(self._coming)
        for done, made in enumerate(in_order(lambda reader: work(reader()), readers, self.workers(SLAB)), start=1):
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
        if self.pieces and not self.terms():
            return sum(piece.energy for piece in self.pieces)
        return sum(self.each(lambda block: squared_norm(self.settled(block)), self.blocks()))

    def cut(self, parts: Sequence[NDArray[np.intp]], counts: Sequence[int]) -> list[Piece]:
        """Write what `wholes` leave to a scratch file: a piece for each combination of parts of rows, in C order.

        Pieces that are those already stay as they are.
        """
        if not (self.pieces and all(map(np.array_equal, self.parts, parts))):
            self.scratch, self.pieces = self._written(parts, counts)
            self.parts, self.stored = list(parts), list(self.wholes)
        return self.pieces

    def in_blocks(self, parts: Sequence[NDArray[np.intp]], counts: Sequence[int], number: int) -> Streamed:
        """The tensor less all levels but `number`, which is to be fitted to such pieces one by one."""
        self.change(number, None)
        self.cut(parts, counts)
        return self

    def _written(
        self, parts: Sequence[NDArray[np.intp]], counts: Sequence[int], without: int | None = None
    ) -> tuple[Scratch, list[Piece]]:
        lists = [rows_of_parts(part, count) for part, count in zip(parts, counts, strict=True)]
        places = [places_of(part) for part in parts]
        pieces, start = list[Piece](), 0
        for rows in product(*lists):
            pieces.append(Piece(rows, start))
            start += pieces[-1].elements
        scratch = Scratch(start)

        def write(block: Block) -> list[tuple[int, float]]:
            tensor, found = self.settled(block, without), list[tuple[int, float]]()
            for child, sub, rows in split(tensor, block.rows, parts):
                number = int(np.ravel_multi_index(child, tuple(counts)))
                put(scratch, pieces[number], [place[r] for place, r in zip(places, rows, strict=True)], sub)
                found.append((number, squared_norm(sub)))
            return found

        for found in self.each(write, self.blocks()):
            for number, energy in found:
                pieces[number].energy += energy
        return scratch, pieces

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
        tensor = self.settled(Block(piece.rows, self.read(piece)))
        self._held.piece, self._held.tensor, self._held.changed = piece, tensor, bool(self.terms())
        try:
            yield
            if self._held.changed and piece.elements:
                if self.lasting:
                    self._scratch.write(piece.start, tensor)
                piece.energy = squared_norm(tensor)
        finally:
            self._held.piece = self._held.tensor = None

    def gather(self, rows: Rows, piece: Piece | None) -> F32:
        """A node's sub-tensor out of the piece that this thread holds; a copy."""
        assert piece is not None
        assert self._held.piece is piece
        if len(rows[0]) and all(len(r) == size for r, size in zip(rows, piece.sizes, strict=True)):
            return self._held.tensor.copy()
        return kernels.gather(self._held.tensor, self._within(rows, piece))

    def scatter(self, rows: Rows, piece: Piece | None, values: F32) -> None:
        """Put it back."""
        assert piece is not None
        assert self._held.piece is piece
        kernels.scatter(self._held.tensor, self._within(rows, piece), values)
        self.note_changed()

    def note_changed(self) -> None:
        """What this thread holds is not what it was."""
        self._held.changed = True

    def _within(self, rows: Rows, piece: Piece) -> list[NDArray[np.intp]]:
        return [np.searchsorted(all_, r) for all_, r in zip(piece.rows, rows, strict=True)]

    def settle(self) -> None:
        """All pieces have been held with the present terms: there are none any more."""
        self.stored = list(self.wholes)
        if not self.lasting:
            self._scratch.close()

    def saved(self, *, pieces: bool) -> Saved:
        """All that changes, to go back to; what lies in `pieces`, if that will, is copied to a second scratch file."""
        if not pieces or self.scratch is None:
            return Saved(list(self.wholes))
        energies = [piece.energy for piece in self.pieces]
        return Saved(list(self.wholes), list(self.stored), energies, self.scratch.copy())

    def restore(self, saved: Saved) -> None:
        """Go back, with the pieces there were then; or as they are, where they were not saved."""
        self.wholes = list(saved.wholes)
        if saved.scratch is not None:
            self.stored = list(saved.stored)
            for piece, energy in zip(self.pieces, saved.energies, strict=True):
                piece.energy = energy
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
        return super().error if self.terms() else self.of.energy

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
        cut.scratch, cut.pieces = self._written(parts, counts, number)
        return cut

    def _thinned_slab(self, part: tuple[slice, ...], steps: Sequence[int] | None) -> Block:
        return _thinned(self._slab(part), steps)

    def _slab_above(self, part: tuple[slice, ...], steps: Sequence[int] | None) -> Block:
        block = self._slab(part)
        rows = tuple(all_[own] for all_, own in zip(self.of.rows, block.rows, strict=True))
        return _thinned(Block(rows, block.tensor), steps)

    def change(self, number: int, cells: Cells | None) -> None:
        """The piece's cells are these from now on; the piece is rewritten."""
        super().change(number, cells)
        self.rewrite()

    def rewrite(self) -> None:
        """Store what is left now."""
        scratch = self._scratch

        def write(part: tuple[slice, ...]) -> float:
            block = self._slab(part)
            scratch.write(self._start(part), self.settled(block))
            return squared_norm(block.tensor)

        self.of.energy = sum(in_order(write, list(slabs(self.shape, SLAB)), self.workers(SLAB)))
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


def thinned_cells(cells: Cells, steps: Sequence[int] | None) -> Cells:
    """The cells of every steps-th row of each mode."""
    if steps is None or max(steps) == 1:
        return cells
    return cells.part([np.arange(0, size, step) for size, step in zip(cells.sizes, steps, strict=True)])


def _thinned(block: Block, steps: Sequence[int] | None) -> Block:
    """Every steps-th row of the tensor, counted as rows of the tensor thinned so."""
    tensor, rows = block.tensor, list(block.rows)
    for n, step in enumerate(steps or ()):
        if step > 1:
            kept = np.flatnonzero(rows[n] % step == 0)
            tensor, rows[n] = tensor.take(kept, axis=n), rows[n][kept] // step
    return Block(tuple(rows), np.ascontiguousarray(tensor))
