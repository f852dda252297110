"""A level of blocks that share no element, on a tensor that memory does not hold.

No row is in two of them, so each is fitted by itself, on all its elements, as a fit in memory finds it. Memory is for a
few blocks at once; joint rows would take numbers for every row and every cell. The blocks lie in a scratch file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .. import backends as kernels
from ..arrays import F32
from ..cells import Cells, empty_cells
from ..plan import LevelSpec
from ..streaming.blocks import Block
from ..streaming.large import large
from ..streaming.pieces import Piece
from ..streaming.streamed import Streamed
from ..support.executors import Queue, repeatedly
from ..support.progress import Told
from .fit import COLD, WARM, Effort, Labels
from .workset import fit_streamed, refit_streamed


def fit_outside(
    residual: Streamed,
    number: int,
    spec: LevelSpec,
    effort: Effort,
    rng: np.random.Generator,
    labels: Labels | None,
    told: Told,
) -> Cells:
    """Cells of level `number` (from 0), whose node is the whole tensor; arguments as of `fit_level`."""
    spec = spec.clamped(residual.shape)
    if labels is None or not spec.disjoint:
        return fit_streamed(residual, number, spec, effort, rng, labels, told)
    cells = empty_cells(residual.shape, spec, [part[:, None].astype(np.uint16) for part in labels], rng)
    seeds = rng.integers(2**63, size=spec.cells)

    def fitted(c: int, cell: Cells, tensor: F32 | Streamed) -> Cells:
        if isinstance(tensor, Streamed):
            return fit_streamed(tensor, 0, cell.spec, effort, np.random.default_rng(seeds[c]), None)
        kernels.fit_cells(cell, tensor, 1, COLD)
        kernels.fit_cells(cell, tensor, effort.hooi, WARM)
        return cell

    _each_cell(residual, number, cells, labels, fitted, told)
    return cells


def refit_outside(residual: Streamed, number: int, cells: Cells, told: Told) -> Cells:
    """Back-fitting of the cells of level `number`, memberships kept."""
    if not cells.spec.disjoint:
        with residual.telling(told, cells.order - sum(cells.undecomposed)):
            return refit_streamed(residual, number, cells)

    def refitted(_: int, cell: Cells, tensor: F32 | Streamed) -> Cells:
        if isinstance(tensor, Streamed):
            return refit_streamed(tensor, 0, cell)
        kernels.accumulate(cell, tensor, -1.0)
        kernels.fit_cells(cell, tensor, 1, WARM)
        return cell

    _each_cell(residual, number, cells, _labels(cells), refitted, told)
    return cells


def cut_as_fitted(residual: Streamed, number: int, cells: Cells) -> None:
    """Cut the scratch file as fitting these cells of level `number` does: what comes after reads it in that order."""
    if cells.spec.disjoint:
        residual.in_blocks(_labels(cells), cells.spec.clusters, number)


def _each_cell(
    residual: Streamed, number: int, cells: Cells, labels: Labels,
    work: Callable[[int, Cells, F32 | Streamed], Cells], told: Told,
) -> None:
    """Put in its place what the work makes of every cell and its tensor, which is less all levels but `number`."""
    cut = residual.in_blocks(labels, cells.spec.clusters, number)
    sizes = [piece.elements for piece in cut.pieces]
    queue = Queue(sizes, cut.limit)

    def next_cell() -> int:
        with queue.next() as c:
            piece = cut.pieces[c]
            if piece.elements:
                tensor = large(cut, piece)
                if tensor is None:
                    tensor = cut.settled(Block(piece.rows, cut.read(piece)))
                _put(cells, c, piece, work(c, _taken(cells, c, piece), tensor))
            return sizes[c]

    each = 1 if len(sizes) >= residual.threads else residual.threads
    with kernels.threads(each, after=residual.threads):
        repeatedly(next_cell, len(sizes), residual.threads, lambda done: told(done / sum(sizes)))


def _labels(cells: Cells) -> Labels:
    return [members[:, 0].astype(np.intp) for members in cells.members]


def _slots(cells: Cells, c: int, piece: Piece) -> Iterator[tuple[int, tuple[NDArray[np.intp], int, int]]]:
    """Of each decomposed mode the places of cell c in its bases: rows, cluster subset, the other modes' clusters."""
    at, clusters = np.unravel_index(c, cells.spec.clusters), cells.spec.clusters
    for n, skip in enumerate(cells.undecomposed):
        if not skip:
            others = [m for m in range(cells.order) if m != n]
            place = int(np.ravel_multi_index([at[m] for m in others], [clusters[m] for m in others])) if others else 0
            yield n, (piece.rows[n], 0, place)


def _taken(cells: Cells, c: int, piece: Piece) -> Cells:
    """A copy of cell c as the only one of a node."""
    ranks = [None if skip else rank for skip, rank in zip(cells.undecomposed, cells.ranks, strict=True)]
    spec = replace(cells.spec.alone(piece.sizes), ranks=tuple(ranks))
    members = [np.zeros((size, 1), np.uint16) for size in piece.sizes]
    bases = [np.zeros(0, np.float32) for _ in piece.sizes]
    for n, slot in _slots(cells, c, piece):
        bases[n] = cells.bases[n][slot][:, None, None]
    return Cells(piece.sizes, spec, members, bases, cells.cores[c : c + 1].copy())


def _put(cells: Cells, c: int, piece: Piece, cell: Cells) -> None:
    for n, slot in _slots(cells, c, piece):
        columns = cell.bases[n][:, 0, 0]
        cells.bases[n][slot] = 0.0
        cells.bases[n][(*slot, slice(columns.shape[1]))] = columns
    cells.cores[c] = 0.0
    cells.cores[(c, *map(slice, cell.cores.shape[1:]))] = cell.cores[0]
