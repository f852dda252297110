"""HMK-CTA (paper, section 4): levels of MK-CTA on residuals, nodes fitted independently, back-fitting across levels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import product
from math import prod

import numpy as np
from numpy.typing import NDArray

from . import backends as kernels
from .axes import Axis, Organisation
from .cells import Cells
from .fit import WARM, Effort, Labels, fit_level
from .journal import NoJournal
from .memberships import uniform_blocks
from .plan import LevelSpec
from .subdivision import subdivide

F32 = NDArray[np.float32]
Rows = tuple[NDArray[np.intp], ...]
#: Called with a stage's name and the fraction of it that is done.
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Run:
    """What every step of a fit shares: how long to try, where chance starts, threads, whom to tell, what is done."""

    effort: Effort
    seed: int
    threads: int
    progress: Progress
    journal: NoJournal = field(default_factory=NoJournal)


@dataclass(eq=False)
class Node:
    """A sub-tensor of a level: its rows of every mode, what was fitted to it, and where its rows go next.

    Attributes:
        rows: index list of each mode, into the whole tensor.
        cells: the fitted cells as they will be stored (float16 numbers); None: the node adds nothing and is a leaf.
        parts: for each mode the part of every row at the next level; None: a leaf.
        children: one for each combination of parts, in C order.
    """

    rows: Rows
    cells: Cells | None = None
    parts: list[NDArray[np.intp]] | None = None
    children: list[Node] = field(default_factory=list["Node"])

    @property
    def sizes(self) -> tuple[int, ...]:
        """Mode sizes of the sub-tensor."""
        return tuple(len(rows) for rows in self.rows)

    @property
    def elements(self) -> int:
        """How many elements it has."""
        return prod(self.sizes)


@dataclass(eq=False)
class Hierarchy:
    """Nodes by level, and the tensor minus all of them: `residual` is kept up to date by every step.

    `schemes` says how each level but the last was subdivided.
    """

    residual: F32
    levels: list[list[Node]]
    schemes: list[str] = field(default_factory=list[str])

    @property
    def error(self) -> float:
        """Squared error of everything fitted so far, float64."""
        return squared_norm(self.residual)


#: The disjoint memberships a node's cells start from; None: found by trial.
LabelsOf = Callable[[Node], Labels | None]


def squared_norm(tensor: F32) -> float:
    """Sum of squares in float64, slab by slab."""
    total = 0.0
    for i in range(tensor.shape[0]):
        total += float(np.square(tensor[i : i + 1], dtype=np.float64).sum())
    return total


def whole(tensor: F32) -> Hierarchy:
    """The hierarchy before any level: one node that owns every row."""
    rows: Rows = tuple([np.arange(size, dtype=np.intp) for size in tensor.shape])
    return Hierarchy(tensor, [[Node(rows)]])


def gather(tensor: F32, node: Node) -> F32:
    """The node's sub-tensor in one piece."""
    if node.sizes == tensor.shape:
        return tensor.copy()
    return np.ascontiguousarray(tensor[np.ix_(*node.rows)])


def scatter(tensor: F32, node: Node, values: F32) -> None:
    """Put the node's sub-tensor back."""
    if node.sizes == tensor.shape:
        tensor[...] = values
    else:
        tensor[np.ix_(*node.rows)] = values


def in_parallel(work: Callable[[int], None], nodes: Sequence[Node], stage: str, run: Run) -> None:
    """Do the work for every node, largest first; nodes share no element, so their order changes nothing."""
    order = sorted(range(len(nodes)), key=lambda s: -nodes[s].elements)
    total, done = max(1, sum(node.elements for node in nodes)), 0
    run.progress(stage, 0.0)
    with ThreadPoolExecutor(max_workers=run.threads) as pool:
        futures = [(s, pool.submit(work, s)) for s in order]
        try:
            for s, future in futures:
                future.result()
                done += nodes[s].elements
                run.progress(stage, done / total)
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def fit_nodes(tree: Hierarchy, specs: Sequence[LevelSpec | None], run: Run, labels: LabelsOf = lambda _: None) -> None:
    """Fit the deepest level, each node by its own spec (None: it stays empty), from given disjoint memberships."""
    nodes, depth, step = tree.levels[-1], len(tree.levels), run.journal.step()

    def work(s: int) -> None:
        node, spec = nodes[s], specs[s]
        if spec is None or node.elements == 0:
            return
        tensor = gather(tree.residual, node)
        finished = run.journal.recall(step, s, node.sizes, spec)
        if finished is None:
            if not tensor.any():
                return
            cells, _ = fit_level(tensor, spec, run.effort, np.random.default_rng([run.seed, depth, s]), labels(node))
            node.cells = cells.rounded()
            run.journal.keep(step, s, node.cells)
        else:
            node.cells = finished.cells
        scatter(tree.residual, node, _exchanged(tensor, None, node.cells))

    in_parallel(work, nodes, f"level {depth}", run)


def _exchanged(residual: F32, old: Cells | None, new: Cells | None) -> F32:
    """The residual, in place, with other cells: a function of the stored numbers alone, however they were found.

    So what rounding adds the next level absorbs, and cells read from a journal leave what fitted ones left.
    """
    if old is not None:
        kernels.accumulate(old, residual, 1.0)
    if new is not None:
        kernels.accumulate(new, residual, -1.0)
    return residual


def descend(tree: Hierarchy, scheme: str, run: Run) -> None:
    """Subdivide every node of the deepest level: its children become the next level, not yet fitted."""
    nodes = tree.levels[-1]

    def work(s: int) -> None:
        node = nodes[s]
        if node.cells is None:
            return
        tensor = gather(tree.residual, node)
        kernels.accumulate(node.cells, tensor, 1.0)
        node.parts = subdivide(node.cells, tensor, scheme)
        node.children = list(_children(node, node.cells.spec.clusters))

    in_parallel(work, nodes, "subdivision", run)
    tree.levels.append([child for node in nodes for child in node.children])
    tree.schemes.append(scheme)


def _children(node: Node, clusters: Sequence[int]) -> Iterator[Node]:
    assert node.parts is not None
    lists = [
        [rows[part == c] for c in range(count)]
        for rows, part, count in zip(node.rows, node.parts, clusters, strict=True)
    ]
    return (Node(tuple(rows)) for rows in product(*lists))


def ascend(tree: Hierarchy) -> None:
    """Take the deepest level away again, its part of the model back into the residual."""
    tree.schemes.pop()
    for node in tree.levels.pop():
        if node.cells is not None:
            tensor = gather(tree.residual, node)
            kernels.accumulate(node.cells, tensor, 1.0)
            scatter(tree.residual, node, tensor)
    for node in tree.levels[-1]:
        node.parts, node.children = None, []


def backfit(tree: Hierarchy, run: Run, sweeps: int = 1) -> None:
    """Refit every level in turn to what all the others leave; memberships stay."""
    for number, nodes in enumerate(tree.levels, start=1):
        step = run.journal.step()

        def work(s: int, nodes: list[Node] = nodes, step: int = step) -> None:
            node = nodes[s]
            old = node.cells
            if old is None:
                return
            finished = run.journal.recall(step, s, node.sizes, old.spec)
            cells = _refitted(old, gather(tree.residual, node), sweeps) if finished is None else finished.cells
            if finished is None:
                run.journal.keep(step, s, cells)
            if cells is not None:
                node.cells = cells
                scatter(tree.residual, node, _exchanged(gather(tree.residual, node), old, cells))

        in_parallel(work, nodes, f"back-fitting level {number}", run)


def _refitted(old: Cells, residual: F32, sweeps: int) -> Cells | None:
    """Rounded cells that leave less than the old ones, which leave `residual` (used up); None: there are none."""
    before = squared_norm(residual)
    cells = Cells(old.sizes, old.spec, old.members, [b.copy() for b in old.bases], old.cores.copy())
    kernels.fit_cells(cells, residual, sweeps, WARM)
    rounded = cells.rounded()
    # So close to the optimum that rounding outweighs the gain?
    return rounded if squared_norm(_exchanged(residual, cells, rounded)) <= before else None


def grid_labels(spec: LevelSpec, axes: Sequence[Axis], organisation: Organisation) -> LabelsOf:
    """Disjoint memberships by equal blocks along the axes of the spec's grid; None for a spec without one."""
    counts, size = dict(spec.grid), {axis.name: axis.size for axis in axes}

    def labels(node: Node) -> Labels | None:
        if not counts:
            return None
        modes = zip(node.rows, organisation, strict=True)
        return [_block_numbers(rows, [(size[name], counts.get(name, 1)) for name in mode]) for rows, mode in modes]

    return labels


def _block_numbers(rows: NDArray[np.intp], axes: Sequence[tuple[int, int]]) -> NDArray[np.intp]:
    """Flattened block number of each row of a (merged) mode whose axes have the given sizes and block counts."""
    number = np.zeros(len(rows), np.intp)
    for index, (_, count) in zip(np.unravel_index(rows, [size for size, _ in axes]), axes, strict=True):
        distinct, position = np.unique(index, return_inverse=True)
        number = number * count + uniform_blocks(len(distinct), min(count, len(distinct)))[position]
    return number
