"""One level on a tensor that memory does not hold.

It is fitted on a *workset*, every few rows of the longest modes. The rows left out then are independent least squares
problems given everything else, and so are all rows of one mode: they are solved from projections of the whole tensor,
which are sums over its blocks and are read in one pass. An undecomposed mode has no rows to solve for; where cells
share no element (K = 1) their cores are the whole tensor's projections on their bases.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import count
from math import gcd, prod
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .. import backends as kernels
from ..arrays import F32, F64
from ..cells import Cells
from ..errors import invalid
from ..plan import LevelSpec, Plan
from ..streaming.blocks import Block, thinned_cells
from ..streaming.budget import PROCESS, WORKING, joint_bytes, part_sizes
from ..streaming.pieces import Rows
from ..streaming.streamed import Streamed
from ..support.memory import check_memory, give_back_freed_memory
from ..support.progress import Told, nobody
from ..support.slabs import slabs
from .fit import Effort, Labels, fit_level
from .projection import project_one
from .reassign import with_all_rows
from .search import all_products, choose_rows, project_model, right_sides

T = TypeVar("T", np.float32, np.float64)

#: Rows of a thinned mode for each cluster and each column of a basis: fewer would fit themselves.
FEWEST = 8
#: What to do about a sub-tensor that is too large to be subdivided.
SMALLER = "more clusters in the levels above, or raise --max-memory"
#: Elements by which spectra and subdivisions are judged.
SAMPLED = 1 << 23
#: Numbers of projections at a time, of slabs and of models in closed form, where modes are undecomposed.
PROJECTED = 1 << 22


def workset_steps(sizes: Sequence[int], spec: LevelSpec, limit: int) -> list[int]:
    """Steps that leave up to `limit` elements: of the two longest decomposed modes, of others where that is too few.

    Undecomposed modes come first where cells share no element: a pass makes up for what was left out.

    >>> workset_steps((174, 58, 400, 380), LevelSpec((2, 2, 3, 3), (4, 3, 4, 4), (2, 2, 2, 2)), 2**26)
    [1, 1, 5, 5]
    >>> workset_steps((10092, 152000), LevelSpec((30, None), (1, 1), (1, 1)), 2**26)
    [1, 23]
    """
    steps = [1] * len(sizes)
    decomposed = [n for n, rank in enumerate(spec.ranks) if rank is not None]
    opened = [n for n, rank in enumerate(spec.ranks) if rank is None] if max(spec.mixture) == 1 else []
    longest = sorted(decomposed, key=lambda n: -sizes[n])[:2]
    most = max((rank for rank in spec.ranks if rank is not None), default=1)

    def remaining(n: int) -> float:
        return sizes[n] / steps[n]

    def further(n: int) -> int:
        return next_step(steps[n], undecomposed=spec.ranks[n] is None)

    def thinnable(n: int) -> bool:
        return sizes[n] / further(n) >= FEWEST * max(spec.clusters[n], spec.ranks[n] or most)

    while _seen(sizes, steps) > limit:
        choices = ([n for n in modes if thinnable(n)] for modes in (opened, longest, decomposed))
        choice = next((modes for modes in choices if modes), None)
        if choice is None:
            break
        longest_one = max(choice, key=remaining)
        steps[longest_one] = further(longest_one)
    return steps


def next_step(step: int, *, undecomposed: bool) -> int:
    """The next larger step that a mode may be thinned by.

    An undecomposed mode is all that is seen of the axes merged in it: of colours, and of those of even length.
    """
    return next(more for more in count(step + 1) if not undecomposed or gcd(more, 6) == 1)


def workset(sizes: Sequence[int], level: LevelSpec, limit: int) -> int:
    """Elements of a node of these sizes that a level is fitted on; of its largest block, if its blocks are disjoint."""
    spec = level.clamped(sizes)
    if spec.search == "fast":
        return limit
    if spec.disjoint:
        sizes = part_sizes(sizes, spec)
        spec = spec.alone(sizes)
    return _seen(sizes, workset_steps(sizes, spec, limit))


def _seen(sizes: Sequence[int], steps: Sequence[int]) -> int:
    """Elements that steps leave."""
    return prod(-(-size // step) for size, step in zip(sizes, steps, strict=True))


def worksets(plan: Plan, sizes: Sequence[int], limit: int) -> list[int]:
    """The `workset` of every level, on nodes as large as equal parts of those above are."""
    found = list[int]()
    for level in plan.levels:
        found.append(workset(sizes, level, limit))
        sizes = part_sizes(sizes, level)
    return found


def fitting_bytes(sizes: Sequence[int], level: LevelSpec, limit: int) -> int:
    """Bytes that it takes to fit a level to the workset of a node of these sizes, once that is read.

    One cell (HOSVD) takes the workset twice, and twice what the first projection leaves of it. Cells that share no
    element take the workset and the largest of them; others the workset and its residual.
    """
    spec = level.clamped(sizes)
    steps = workset_steps(sizes, spec, limit)
    elements = _seen(sizes, steps)
    if spec.cells == 1:
        shares = [rank * step / size for rank, size, step in zip(spec.ranks, sizes, steps, strict=True) if rank]
        return int(4 * elements * (2 + 2 * min([1.0, *shares])))
    if max(spec.mixture) == 1:
        return int(4 * elements * (1 + 1 / spec.cells))
    return 8 * elements


def check_worksets(plan: Plan, sizes: Sequence[int], limit: int, memory: int | None) -> None:
    """Refuse a plan whose levels cannot be fitted on as little as memory holds.

    Raises:
        HmkctaError: one cannot.
    """
    cut = False
    for number, (level, most) in enumerate(zip(plan.levels, worksets(plan, sizes, limit), strict=True), start=1):
        what = f"level {number} ({level}) on {' x '.join(map(str, sizes))}"
        if cut and level.cells > 1 and prod(sizes) > limit and number < len(plan.levels):
            raise invalid("node-too-large", what, f"{prod(sizes)} elements to subdivide", f"up to {limit}", SMALLER)
        cut = cut or level.cells > 1
        if most > limit:
            hint = "raise --max-memory, lower R, or leave no long mode undecomposed"
            taken = fitting_bytes(sizes, level, limit) if level.cells == 1 else WORKING * most
            check_memory(PROCESS + taken, what, hint, memory)
        if prod(sizes) > limit:
            joint = PROCESS // 2 + joint_bytes(sizes, level)
            check_memory(joint, what, "raise --max-memory, lower R, or fewer clusters", memory)
        sizes = part_sizes(sizes, level)


def fit_streamed(
    residual: Streamed,
    number: int,
    spec: LevelSpec,
    effort: Effort,
    rng: np.random.Generator,
    labels: Labels | None,
    told: Told = nobody,
) -> Cells:
    """Cells of level `number` (from 0), whose node is the whole tensor; other arguments are as of `fit_level`.

    They are fitted on a workset. Then come, mode by mode, the rows that it left out; of several cells those of the
    other modes, on a denser part of the tensor; and the first ones again, on all rows of decomposed modes. Where cells
    share no element, undecomposed modes get cores for all their rows by projection.
    """
    spec = spec.clamped(residual.shape)
    steps = workset_steps(residual.shape, spec, residual.limit)
    turns = _turns(spec, steps)
    # Undecomposed modes have no rows to solve for; every row has cores of its own.
    cores = max(steps) > 1 and max(spec.mixture) == 1 and None in spec.ranks
    completing = 2 + sum(rank is not None for rank in spec.ranks) if cores else 0
    with residual.telling(told, 1 + len(turns) + completing):
        sample = residual.sample(steps, number)
        chosen = None if labels is None else [part[::step] for part, step in zip(labels, steps, strict=True)]
        cells = fit_level(sample, spec, effort, rng, chosen, overwrite=True)
        del sample
        give_back_freed_memory()
        for n, step in enumerate(steps):
            if step > 1 and spec.ranks[n] is not None:
                cells = with_all_rows(cells, n, residual.shape[n], step)
        for n, seen in turns:
            solve_rows(residual, number, cells, n, spec.search, seen)
        if cores:
            cells = completed(residual, number, cells)
            cells = completed(residual, number, refit_streamed(residual, number, cells))
    return cells


def _turns(spec: LevelSpec, steps: Sequence[int]) -> list[tuple[int, list[int]]]:
    """Modes whose rows are solved for after a fit to a tensor thinned by these steps, and by which steps it is then."""
    if max(steps) == 1:
        return []
    decomposed = [n for n, rank in enumerate(spec.ranks) if rank is not None]
    thinned = [n for n in decomposed if steps[n] > 1]
    opened = [step if rank is None else 1 for step, rank in zip(steps, spec.ranks, strict=True)]
    # The other modes have samples enough on a part.
    others = [n for n in decomposed if n not in thinned] if spec.cells > 1 else []
    part = [max(always, min(step, 2)) for always, step in zip(opened, steps, strict=True)]
    first = [(n, [1 if m == n else step for m, step in enumerate(steps)]) for n in thinned]
    return [*first, *((n, part) for n in others), *((n, opened) for n in thinned)]


def refit_streamed(residual: Streamed, number: int, cells: Cells) -> Cells:
    """All rows of every mode once more, mode by mode, memberships kept."""
    for n in range(cells.order):
        if not cells.undecomposed[n]:
            solve_rows(residual, number, cells, n, "fixed", [1] * cells.order)
    return cells


def completed(residual: Streamed, number: int, cells: Cells) -> Cells:
    """The cells with cores for all rows of undecomposed modes: the tensor projected on their bases."""
    n = cells.undecomposed.index(True)
    sizes = residual.shape
    members = [
        np.zeros((size, 1), np.uint16) if skip else own
        for size, own, skip in zip(sizes, cells.members, cells.undecomposed, strict=True)
    ]
    whole = Cells(sizes, cells.spec, members, cells.bases, cells.cores)
    whole.cores = np.zeros((cells.spec.cells, *whole.ranks), np.float32)
    y = projected(residual, number, whole, n)
    ranks = [whole.ranks[m] for m in range(cells.order) if m != n]
    whole.cores = np.ascontiguousarray(np.moveaxis(y.reshape(*y.shape[:2], *ranks), 1, n + 1), np.float32)
    return whole


def solve_rows(residual: Streamed, number: int, cells: Cells, n: int, search: str, steps: Sequence[int]) -> None:
    """Best rows of mode n given all else, on the tensor thinned by `steps`, as modes of the cells may be already."""
    full = [own == size for own, size in zip(cells.sizes, residual.shape, strict=True)]
    seen = thinned_cells(cells, [step if whole else 1 for step, whole in zip(steps, full, strict=True)])
    b = sides(residual, number, seen, n, steps)
    choose_rows(seen, all_products(seen), b, n, cells.spec.mixture[n], search)
    kernels.orthonormalise(seen, n)
    cells.members[n], cells.bases[n], cells.cores = seen.members[n], seen.bases[n], seen.cores


def sides(residual: Streamed, number: int, cells: Cells, n: int, steps: Sequence[int]) -> F64:
    """`right_sides` of the tensor less all levels but `number`, thinned as the cells are: `[PC, R_n, I_n]`.

    b is linear in the tensor: with t a block of what is read, and each of the `terms` a model and its weight w,

        b = sum over blocks of D^T t + sum over terms of w D^T model
    """

    def of_block(part: Cells, tensor: F32) -> F64:
        b_of_block = np.zeros((part.spec.cells, part.ranks[n], part.sizes[n]))
        for share in _in_stretches(part, n, partial(_y_of_elements, tensor, n)):
            b_of_block += share
        return b_of_block

    b = np.zeros((cells.spec.cells, cells.ranks[n], cells.sizes[n]))
    for rows, b_of_block in _over_blocks(residual, cells, steps, of_block):
        b[:, :, rows[n]] += b_of_block
    for weight, other in residual.terms(number):
        for b_of_model in _in_stretches(cells, n, partial(_y_of_model, thinned_cells(other, steps), n)):
            b += weight * b_of_model
    return b


def projected(residual: Streamed, number: int, cells: Cells, n: int) -> F64:
    """`project_cells` of the tensor less all levels but `number`: `[PC, I_n, prod R_m]`.

    As of b: Y_n = sum over blocks of their Y_n + sum over terms of w times that of the model.
    """
    order = [n, *[m for m in range(cells.order) if m != n]]
    kept = [m == n or cells.undecomposed[m] for m in order]  # modes that are not summed over
    sizes = [cells.sizes[m] if whole else cells.ranks[m] for m, whole in zip(order, kept, strict=True)]
    y = np.zeros([cells.spec.cells, *sizes])
    for rows, y_of_block in _over_blocks(residual, cells, [1] * cells.order, lambda some, t: project_one(some, t, n)):
        places = [rows[m] if whole else np.arange(cells.ranks[m]) for m, whole in zip(order, kept, strict=True)]
        y[np.ix_(np.arange(len(y)), *places)] += y_of_block.reshape([len(y_of_block), *map(len, places)])
    y = y.reshape(len(y), cells.sizes[n], -1)
    for weight, other in residual.terms(number):
        y += weight * project_model(cells, other, n)
    return y


def _y_of_elements(tensor: F32, n: int, some: Cells, rows: Rows) -> F32:
    return project_one(some, np.ascontiguousarray(tensor[tuple(slice(r[0], r[-1] + 1) for r in rows)]), n)


def _y_of_model(model: Cells, n: int, some: Cells, rows: Rows) -> F64:
    return project_model(some, model.part(rows), n)


def _in_stretches(cells: Cells, n: int, y: Callable[[Cells, Rows], NDArray[np.floating]]) -> Iterator[F64]:
    """`right_sides` of the cells' rows in one stretch after another, from their Y_n; together they are b."""
    for rows in _stretches(cells, n):
        some = cells.part(rows)
        yield right_sides(some, y(some, rows), n)


def _over_blocks(
    residual: Streamed, cells: Cells, steps: Sequence[int], use: Callable[[Cells, F32], NDArray[T]]
) -> Iterator[tuple[Rows, NDArray[T]]]:
    """What is made of the cells' rows of every block that is not empty and its elements, and which rows these are."""

    def work(block: Block) -> tuple[Rows, NDArray[T] | None]:
        if not block.tensor.size:
            return block.rows, None
        return block.rows, use(cells.part(block.rows), block.tensor)

    for rows, made in residual.each(work, residual.blocks(steps)):
        if made is not None:
            yield rows, made


def _stretches(cells: Cells, n: int) -> Iterator[Rows]:
    """All rows of every mode, of undecomposed ones so many at a time that projections stay small."""
    skipped = [m for m, skip in enumerate(cells.undecomposed) if skip]
    each = cells.spec.cells * cells.sizes[n] * prod(r for m, r in enumerate(cells.spec.ranks) if m != n and r)
    for part in slabs([cells.sizes[m] for m in skipped], max(1, PROJECTED // each)):
        spans = dict(zip(skipped, part, strict=False))  # the last modes are whole where a slab does not name them
        yield tuple([np.arange(size)[spans.get(m, slice(None))] for m, size in enumerate(cells.sizes)])
