"""A layout coded: all blocks at a step D, as whole numbers in node order, with their bytes and what they leave."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32
from ..support.executors import in_order
from ..support.extension import native
from ..support.memory import give_back_freed_memory
from .blocks import Region, Slices, as_tensor, by_shape, grid_block, regions, sample
from .clusters import Parting
from .hosvd import BlockBatch, Undecomposed
from .judging import Choice, choose
from .kernels import I32, U8, U32, code_blocks
from .layout import Layout, Modes
from .values import Values

#: An array is coded as at least so many parts, that threads share.
SHARES = 4
#: Numbers that are put in order at once.
REORDERED = 1 << 18

Batch = tuple[NDArray[np.intp], BlockBatch]


@dataclass(frozen=True, eq=False)
class CodedBlocks:
    """The blocks of a layout at a step: a stage of the file, one node a block.

    Attributes:
        step: D.
        shape: C, K and R of each node, `[S, 3, N]`: K = 0 where a mode is undecomposed, all zero where nothing is
            stored.
        exponents: k of all columns, mode by mode, node by node.
        bases: whole numbers of the bases, likewise; per node `[rows, R_n]`.
        core: whole numbers of the cores; per node `[R_1, .., R_N]`.
        error: squared error of the array as decoded.
    """

    step: float
    shape: NDArray[np.uint32]
    exponents: tuple[U8, ...]
    bases: tuple[I32, ...]
    core: I32
    error: float


class LayoutCoder:
    """Codes an array's blocks at any step; of an array in memory their HOSVDs are found once."""

    def __init__(
        self, values: Values, layout: Layout, sets: Sequence[Undecomposed], decode_cost: float, *, threads: int = 1,
        filled: bool = False, parting: Parting | None = None
    ) -> None:
        """Nothing is coded yet.

        Args:
            values: the array.
            layout: of its blocks.
            sets: of modes that blocks may leave undecomposed.
            decode_cost: bound on the multiply-adds of one element.
            threads: how many work at once; what comes out does not depend on it.
            filled: every block stores something, as only such blocks have a level below.
            parting: whose `values` these are, where rows are in the order of clusters.
        """
        self.parting = parting
        self.values, self.layout, self.sets, self.decode_cost = values, layout, tuple(sets), decode_cost
        self.precise, self.threads, self.filled = False, threads, filled
        self.count = prod(layout.blocks(values.shape))
        self._held: list[list[Batch]] | None = None

    def code(self, step: float) -> CodedBlocks:
        """All blocks at a step D."""
        step = float(np.float32(step))
        self._prepare(step)
        return _joined(list(self._coded(step)), self.count, len(self.layout.modes), step)

    def _prepare(self, step: float) -> None:
        """Let go of HOSVDs that are not precise enough for a step."""
        if not self.precise and self.values.precise(step):
            self.precise, self._held = True, None

    def _coded(self, step: float) -> Iterator[_Piece]:
        def pieces(batches: Sequence[Batch]) -> list[_Piece]:
            return [piece for batch in batches for piece in self._code_batch(*batch, step)]

        together = min(self.values.together, self.values.size // SHARES) // self.threads
        parts = regions(self.values.shape, self.layout, together)
        if not self.values.in_memory:
            for found in in_order(lambda region: pieces(self._batches(region)), parts, self.threads):
                yield from found
                give_back_freed_memory()
            return
        if self._held is None:
            self._held = list(in_order(self._batches, parts, self.threads))
        for found in in_order(pieces, self._held, self.threads):
            yield from found

    def _batches(self, region: Region) -> list[Batch]:
        """Numbers and HOSVDs of the blocks of a region, those of one shape together."""
        part, numbers, blocks = self.values.read(region.part), region.numbers, region.blocks
        found: list[Batch] = []
        for places in by_shape(blocks).values():
            tensors = as_tensor(np.stack([part[blocks[place]] for place in places]), self.layout.modes)
            found.append((numbers[places], BlockBatch(tensors, precise=self.precise, keeps=True)))
        return found

    def _code_batch(self, numbers: NDArray[np.intp], batch: BlockBatch, step: float) -> list[_Piece]:
        sets = self.sets if all(n in s for s in self.sets for n in _forced(batch)) else (_forced(batch),)
        choice = choose(batch, sets, step, self.decode_cost)
        if self.filled:
            _fill(choice, batch.sizes)
        return [_piece(numbers, batch, choice, k, step) for k in np.unique(choice.chosen).tolist()]

    def bytes_of(self, coded: CodedBlocks) -> int:
        """Bytes of the code in the file, tables included, header not."""
        stages = self.stages(coded)
        return sum(native.count_stage(stage, places) for stage, places in stages)

    def sampled(self, step: float, elements: int) -> tuple[float, float]:
        """Bits of the code of the whole array and its squared error, by about so many elements of it and all labels."""
        self._prepare(step)
        shape, size = self.values.shape, max(1, self.values.size // self.count)
        picked = sample(self.count, size, elements, self.values.detail_of(self.layout, step))
        blocks = [grid_block(shape, self.layout, number) for number in picked.tolist()]
        coded = _joined([piece for batch in self._some(blocks) for piece in self._code_batch(*batch, step)],
                        len(blocks), len(self.layout.modes), step)
        places = _places(blocks, self.layout.modes)
        stage = _cells(coded, places["rows"].reshape(len(blocks), -1), last=True)
        share = sum(prod(_lengths_of(block)) for block in blocks) / self.values.size
        labels = 0.0 if self.parting is None else self.parting.label_bits
        return 8 * native.count_stage(stage, places) / share + labels, coded.error / share

    def _some(self, blocks: Sequence[Slices]) -> Iterator[Batch]:
        """Blocks of one shape with their HOSVDs, as many at a time as memory is shared out for."""
        for places in by_shape(blocks).values():
            together = max(1, self.values.together // self.threads // prod(_lengths_of(blocks[int(places[0])])))
            for first in range(0, len(places), together):
                own = places[first : first + together]
                tensors = as_tensor(np.stack([self.values[blocks[b]] for b in own.tolist()]), self.layout.modes)
                yield own, BlockBatch(tensors, precise=self.precise, keeps=True)

    def stages(self, *levels: CodedBlocks) -> list[tuple[dict[str, Any], dict[str, Any]]]:
        """What the native coder takes of each stage: a grid where there are several blocks, and levels of blocks."""
        found, places = list[tuple[dict[str, Any], dict[str, Any]]](), self._root()
        if self.count > 1:
            grid = self._cut_stage()
            found.append((grid, places))
            places = native.next_stage(grid["shape"], grid["children"], grid["part"], places)
        for level in levels:
            stage = _cells(level, places["rows"].reshape(self.count, -1), last=level is levels[-1])
            found.append((stage, places))
            if level is not levels[-1]:
                places = native.next_stage(stage["shape"], stage["children"], stage["part"], places)
        return found

    def _root(self) -> dict[str, Any]:
        """Where the root lies: the array as it is."""
        shape, modes = self.values.shape, self.layout.modes
        if self.parting is not None:
            shape, modes = self.parting.shape, self.parting.modes
        return _places([tuple(slice(0, size) for size in shape)], modes)

    def _cut_stage(self) -> dict[str, Any]:
        """The stage of one node that the grid cuts, or the clusters of rows."""
        shape, layout, order = self.values.shape, self.layout, len(self.layout.modes)
        labels = {} if self.parting is None else self.parting.labels
        parts = [labels[n].astype(np.uint16) if n in labels else grid_parts(shape, layout, n) for n in range(order)]
        table, counts = np.zeros((1, 3, order), np.uint32), layout.blocks(shape)
        table[0, 0] = [prod(counts[axis] for axis in mode) for mode in layout.modes]
        none = [np.zeros(0, np.uint16)] * order
        return {"last": False, "coded": False, "shape": table.ravel(), "part": parts, "cluster": none,
                "children": np.array([prod(counts)], np.uint32), "column": [np.zeros(0, np.uint8)] * order,
                "core": np.zeros(0, np.int32), "basis": [np.zeros(0, np.int32)] * order}


def _forced(batch: BlockBatch) -> Undecomposed:
    return tuple(n for n, basis in enumerate(batch.bases) if basis is None)


@dataclass(frozen=True, eq=False)
class _Piece:
    """Blocks of a batch that leave the same modes undecomposed: their numbers, sizes, ranks and whole numbers."""

    numbers: NDArray[np.intp]
    sizes: tuple[int, ...]
    undecomposed: Undecomposed
    ranks: U32
    exponents: tuple[U8, ...]
    bases: tuple[I32, ...]
    core: I32
    error: float


def _piece(numbers: NDArray[np.intp], batch: BlockBatch, choice: Choice, k: int, step: float) -> _Piece:
    undecomposed = choice.sets[k]
    at = np.flatnonzero(choice.chosen == k)
    bases = [None if n in undecomposed else _of(basis, at) for n, basis in enumerate(batch.bases)]
    found = code_blocks(batch.values[at], batch.cores(undecomposed, at), bases, choice.ranks[at], step)
    return _Piece(numbers[at], batch.sizes, undecomposed, choice.ranks[at], found.exponents, found.bases, found.core,
                  float(found.errors.sum()))


def _fill(choice: Choice, sizes: Sequence[int]) -> None:
    """Give blocks that store nothing one column in each decomposed mode."""
    nothing = choice.ranks[:, 0] == 0
    for k, undecomposed in enumerate(choice.sets):
        one = [size if n in undecomposed else 1 for n, size in enumerate(sizes)]
        choice.ranks[nothing & (choice.chosen == k)] = one


def _of(basis: F32 | None, at: NDArray[np.intp]) -> F32:
    assert basis is not None, "a mode without a basis is undecomposed"
    return basis[at]


def _joined(pieces: Sequence[_Piece], count: int, order: int, step: float) -> CodedBlocks:
    """The pieces in the order of the nodes."""
    shape = np.zeros((count, 3, order), np.uint32)
    numbers = np.concatenate([piece.numbers for piece in pieces])
    for piece in pieces:
        stored = piece.ranks[:, 0] > 0
        mixture = np.array([n not in piece.undecomposed for n in range(order)], np.uint32)
        shape[piece.numbers, 0] = stored[:, None]
        shape[piece.numbers, 1] = stored[:, None] * mixture
        shape[piece.numbers, 2] = piece.ranks
    ranks = np.concatenate([piece.ranks.astype(np.int64) for piece in pieces])
    columns = [ranks[:, n] * np.repeat([n not in piece.undecomposed for piece in pieces], _lengths(pieces))
               for n in range(order)]
    rows = [np.repeat([piece.sizes[n] for piece in pieces], _lengths(pieces)) for n in range(order)]
    return CodedBlocks(
        step,
        shape,
        tuple(_reordered([p.exponents[n] for p in pieces], numbers, columns[n]) for n in range(order)),
        tuple(_reordered([p.bases[n] for p in pieces], numbers, columns[n] * rows[n]) for n in range(order)),
        _reordered([p.core for p in pieces], numbers, ranks.prod(axis=1)),
        sum(piece.error for piece in pieces),
    )


def _lengths(pieces: Sequence[_Piece]) -> list[int]:
    return [len(piece.numbers) for piece in pieces]


def _reordered(arrays: Sequence[NDArray[Any]], numbers: NDArray[np.intp], lengths: NDArray[np.int64]) -> NDArray[Any]:
    """Ragged parts of `lengths`, which belong to the nodes `numbers`, in the order of the nodes."""
    flat, order = np.concatenate(arrays), np.argsort(numbers, kind="stable")
    starts, wanted = (np.cumsum(lengths) - lengths)[order], lengths[order]
    ends = np.cumsum(wanted)
    found = np.empty_like(flat)
    first = 0
    while first < len(order):  # few at a time, as indices take more memory than what they order
        done = int(ends[first] - wanted[first])
        last = max(first + 1, int(np.searchsorted(ends, done + REORDERED)))
        end, own = int(ends[last - 1]), slice(first, last)
        shifts = starts[own] - (ends[own] - wanted[own])
        found[done:end] = flat[np.repeat(shifts, wanted[own]) + np.arange(done, end)]
        first = last
    return found


def _lengths_of(block: Slices) -> list[int]:
    return [part.stop - part.start for part in block]


def _places(blocks: Sequence[Slices], modes: Modes) -> dict[str, Any]:
    """Rows and extents of blocks that are nodes of a stage."""
    extents = [[[block[axis].stop - block[axis].start for axis in mode] for mode in modes] for block in blocks]
    flat = [own for block in extents for own in block]
    return {"rows": np.array([prod(own) for own in flat], np.uint32),
            "extents": np.array([size for own in flat for size in own], np.uint32),
            "ends": np.array([0, *accumulate(map(len, flat))], np.uint32)}


def grid_parts(shape: Sequence[int], layout: Layout, mode: int) -> NDArray[np.uint16]:
    """The block, along a mode, of each of its rows."""
    part = np.zeros(1, np.int64)
    for axis in layout.modes[mode]:
        own = np.zeros(shape[axis], np.int64)
        spans = layout.spans(shape, axis)
        for number, block in enumerate(spans):
            own[block] = number
        part = (part[:, None] * len(spans) + own).reshape(-1)
    return part.astype(np.uint16)


def _cells(coded: CodedBlocks, rows: NDArray[np.uint32], *, last: bool) -> dict[str, Any]:
    """A stage of one node a block, `rows` `[S, N]`, each with the whole of it as its child unless it is the last."""
    parts = [] if last else [np.zeros(int(own), np.uint16) for own in rows.astype(np.int64).sum(axis=0)]
    decomposed = coded.shape[:, 1] > 0
    cluster = [np.zeros(int((rows[:, n] * decomposed[:, n]).sum()), np.uint16) for n in range(rows.shape[1])]
    children = np.full(len(rows), not last, np.uint32)
    return {"last": last, "coded": True, "shape": coded.shape.ravel(), "children": children, "cluster": cluster,
            "part": parts, "column": list(coded.exponents), "core": coded.core, "basis": list(coded.bases)}
