"""Blocks of a tensor, as they come out of a file: some of its rows, every few of them, how large their numbers are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from .. import backends as kernels
from ..arrays import F32
from ..cells import Cells
from .pieces import Norms, Rows
from .scratch import Scratch


@dataclass(frozen=True, eq=False)
class Block:
    """Some elements of the tensor: an outer product of rows."""

    rows: Rows
    tensor: F32


@dataclass(frozen=True, eq=False)
class Saved:
    """A state of a streamed residual; without `piece_norms` its pieces stay as they are."""

    models: list[Cells | None]
    subtracted: list[Cells | None] = field(default_factory=list["Cells | None"])
    piece_norms: list[Norms] | None = None
    residual_norms: list[Norms] = field(default_factory=list[Norms])
    scratch: Scratch | None = None


def norms_of(tensor: F32) -> Norms:
    """The sum of squares and the largest magnitude of a residual."""
    squares, largest, _ = kernels.magnitudes(tensor)
    return Norms(squares, largest)


def settled_by(block: Block, levels: Sequence[Cells | None]) -> list[Norms]:
    """Subtract the models of `levels` from a block, in place; its norms before the first of them, and after each."""
    seen = [norms_of(block.tensor)]
    for cells in levels:
        if cells is not None and block.tensor.size:
            kernels.accumulate(cells.part(block.rows), block.tensor, -1.0)
        seen.append(seen[-1] if cells is None else norms_of(block.tensor))
    return seen


def thinned_cells(cells: Cells, steps: Sequence[int] | None) -> Cells:
    """The cells of every steps-th row of each mode."""
    if steps is None or max(steps) == 1:
        return cells
    return cells.part([np.arange(0, size, step) for size, step in zip(cells.sizes, steps, strict=True)])


def thinned_block(block: Block, steps: Sequence[int] | None) -> Block:
    """Every steps-th row of the tensor, counted as rows of the tensor thinned so."""
    tensor, rows = block.tensor, list(block.rows)
    for n, step in enumerate(steps or ()):
        if step > 1:
            kept = np.flatnonzero(rows[n] % step == 0)
            tensor, rows[n] = tensor.take(kept, axis=n), rows[n][kept] // step
    return Block(tuple(rows), np.ascontiguousarray(tensor))
