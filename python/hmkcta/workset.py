"""One level on a tensor that memory does not hold.

It is fitted on a *workset*, every few rows of the two longest modes. The rows left out then are independent least
squares problems given everything else, and so are all rows of one mode: they are solved from projections of the whole
tensor, which are sums over its blocks and are read in one pass (`projected`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import prod

import numpy as np
from numpy.typing import NDArray

from . import backends as kernels
from .cells import Cells
from .fit import Effort, Labels, fit_level
from .plan import LevelSpec
from .search import choose_rows, code, orthonormalise, project_model
from .streamed import Block, Streamed, thinned_cells

F64 = NDArray[np.float64]

#: Rows of a thinned mode for each cluster and each column of a basis: fewer would fit themselves.
FEWEST = 8


def thinning(sizes: Sequence[int], spec: LevelSpec, limit: int) -> list[int]:
    """Steps that leave up to `limit` elements: of the two longest decomposed modes, of others where that is too few.

    >>> thinning((174, 58, 400, 380), LevelSpec((2, 2, 3, 3), (4, 3, 4, 4), (2, 2, 2, 2)), 2**26)
    [1, 1, 5, 5]
    """
    steps = [1] * len(sizes)
    decomposed = [n for n, rank in enumerate(spec.ranks) if rank is not None]
    longest = sorted(decomposed, key=lambda n: -sizes[n])[:2]

    def left(n: int) -> float:
        return sizes[n] / steps[n]

    def thinnable(n: int) -> bool:
        return sizes[n] / (steps[n] + 1) >= FEWEST * max(spec.clusters[n], spec.ranks[n] or 1)

    while prod(-(-size // step) for size, step in zip(sizes, steps, strict=True)) > limit:
        choice = [n for n in longest if thinnable(n)] or [n for n in decomposed if thinnable(n)]
        if not choice:
            break
        steps[max(choice, key=left)] += 1
    return steps


def fit_streamed(
    residual: Streamed, number: int, spec: LevelSpec, effort: Effort, rng: np.random.Generator, labels: Labels | None
) -> Cells:
    """Cells of level `number` (from 0), whose node is the whole tensor; arguments as of `fit_level`."""
    spec = spec.clamped(residual.shape)
    steps = thinning(residual.shape, spec, residual.limit)
    sample = residual.sample(steps, number)
    chosen = None if labels is None else [part[::step] for part, step in zip(labels, steps, strict=True)]
    cells, _ = fit_level(sample, spec, effort, rng, chosen, own=True)
    del sample
    if max(steps) == 1:
        return cells
    thinned = [n for n, step in enumerate(steps) if step > 1]
    others = [n for n, rank in enumerate(spec.ranks) if rank is not None and n not in thinned]
    for n in thinned:
        cells = widened(cells, n, residual.shape[n], steps[n])
    for n in thinned:
        solve_rows(residual, number, cells, n, spec.search, [1 if m == n else step for m, step in enumerate(steps)])
    for n in others if spec.cells > 1 else []:  # these have samples enough on a part
        solve_rows(residual, number, cells, n, spec.search, [min(step, 2) for step in steps])
    for n in thinned:
        solve_rows(residual, number, cells, n, spec.search, [1] * spec.order)
    return cells


def refit_streamed(residual: Streamed, number: int, cells: Cells) -> Cells:
    """All rows of every mode once more, mode by mode, memberships kept."""
    for n in range(cells.order):
        if not cells.undecomposed[n]:
            solve_rows(residual, number, cells, n, "fixed", [1] * cells.order)
    return cells


def widened(cells: Cells, n: int, size: int, step: int) -> Cells:
    """The cells with all rows of mode n instead of every step-th: those between are like the one before."""
    source = np.arange(size) // step
    sizes = (*cells.sizes[:n], size, *cells.sizes[n + 1 :])
    members, bases = list(cells.members), list(cells.bases)
    members[n], bases[n] = members[n][source], bases[n][source]
    return replace(cells, sizes=sizes, members=members, bases=bases)


def solve_rows(residual: Streamed, number: int, cells: Cells, n: int, search: str, steps: Sequence[int]) -> None:
    """Best rows of mode n given all else, on the tensor thinned by `steps`."""
    seen = thinned_cells(cells, steps)
    coding = code(seen, projected(residual, number, seen, n, steps), n)
    choose_rows(seen, coding, n, cells.spec.mixture[n], search)
    orthonormalise(seen, n)
    cells.members[n], cells.bases[n], cells.cores = seen.members[n], seen.bases[n], seen.cores


def projected(residual: Streamed, number: int, cells: Cells, n: int, steps: Sequence[int]) -> F64:
    """`project_cells` of the tensor less all levels but `number`, thinned by `steps`: `[PC, I_n, prod R_m]`."""
    ranks = [cells.sizes[n] if m == n else rank for m, rank in enumerate(cells.ranks)]
    order = [n, *[m for m in range(cells.order) if m != n]]
    total = np.zeros([cells.spec.cells, *[ranks[m] for m in order]])
    along = [n, *[m for m in range(cells.order) if m != n and cells.undecomposed[m]]]  # modes that are not summed over

    def project(block: Block) -> tuple[Block, NDArray[np.float32] | None]:
        if not block.tensor.size:
            return block, None
        part = cells.part(block.rows)
        y = kernels.project_cells(part, block.tensor, n)
        shape = [len(block.rows[m]) if m in along else ranks[m] for m in order]
        return replace(block, tensor=block.tensor[:0]), y.reshape([len(y), *shape])

    for block, y in residual.each(project, residual.blocks(steps)):
        if y is not None:
            rows = [block.rows[m] if m in along else np.arange(ranks[m]) for m in order]
            total[np.ix_(np.arange(len(total)), *rows)] += y
    flat = total.reshape(len(total), cells.sizes[n], -1)
    for weight, other in residual.terms(number):
        flat += weight * project_model(cells, thinned_cells(other, steps), n)
    return flat
