"""HMK-CTA (paper, section 4): levels of MK-CTA on residuals, nodes fitted independently, back-fitting across levels."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby, product

import numpy as np
from numpy.typing import NDArray

from .. import backends as kernels
from ..arrays import F32
from ..axes import Axis, Organisation
from ..cells import Cells
from ..errors import invalid
from ..metrics import squared_norm
from ..plan import LevelSpec
from ..streaming.blocks import Saved, thinned_cells
from ..streaming.large import Large, large
from ..streaming.pieces import Piece, Rows, SubTensor
from ..streaming.streamed import Streamed
from ..support.executors import Queue, repeatedly
from ..support.grouping import rows_of_parts
from ..support.progress import Told
from .disjoint import cut_as_fitted, fit_outside, refit_outside
from .fit import Labels, fit_level, refit_level
from .memberships import grid_blocks
from .run import Run
from .subdivision import subdivide
from .workset import SAMPLED, SMALLER, workset_steps


@dataclass(eq=False)
class Node(SubTensor):
    """A sub-tensor of a level: its rows of every mode, what was fitted to it, and where its rows go next.

    Attributes:
        cells: the fitted cells as they will be stored (float16 numbers); None: the node adds nothing and is a leaf.
        parts: for each mode the part of every row at the next level; None: a leaf.
        children: one for each combination of parts, in C order.
        piece: the piece of the scratch file that holds its elements; None: they are in memory, or it is the whole.
    """

    cells: Cells | None = None
    parts: list[NDArray[np.intp]] | None = None
    children: list[Node] = field(default_factory=list["Node"])
    piece: Piece | None = None


@dataclass(eq=False)
class Hierarchy:
    """Nodes by level, and the tensor minus all of them: `residual` is kept up to date by every step.

    `schemes` says how each level but the last was subdivided. A `Streamed` residual is not in memory.
    """

    residual: F32 | Streamed
    levels: list[list[Node]]
    schemes: list[str] = field(default_factory=list[str])

    @property
    def error(self) -> float:
        """Squared error of everything fitted so far, float64."""
        return self.residual.error if isinstance(self.residual, Streamed) else squared_norm(self.residual)


#: So many nodes for each thread keep it busy: kernels do not share out a node's work then, which would be slower.
MANY = 8

#: The disjoint memberships a node's cells start from; None: found by trial.
LabelsOf = Callable[[Node], Labels | None]


def whole(tensor: F32 | Streamed) -> Hierarchy:
    """The hierarchy before any level: one node that owns every row."""
    rows: Rows = tuple([np.arange(size, dtype=np.intp) for size in tensor.shape])
    return Hierarchy(tensor, [[Node(rows)]])


def gather(tensor: F32 | Streamed, node: Node, *, lent: bool = False) -> F32:
    """The node's sub-tensor in one piece; a piece itself where that may be `lent`, and is the node's."""
    if isinstance(tensor, Streamed):
        return tensor.gather(node.rows, node.piece, lent=lent)
    if node.sizes == tensor.shape:
        return tensor.copy()
    return kernels.gather(tensor, node.rows)


def scatter(tensor: F32 | Streamed, node: Node, values: F32) -> None:
    """Put the node's sub-tensor back."""
    if isinstance(tensor, Streamed):
        tensor.scatter(node.rows, node.piece, values)
    elif node.sizes == tensor.shape:
        tensor[...] = values
    else:
        kernels.scatter(tensor, node.rows, values)


def saved(tree: Hierarchy) -> F32 | Saved:
    """The residual as it is, to `restore` it."""
    if not isinstance(tree.residual, Streamed):
        return tree.residual.copy()
    return tree.residual.saved(pieces=any(node.piece is not None for node in tree.levels[-1]))


def restore(tree: Hierarchy, before: F32 | Saved) -> None:
    """Put a saved residual back; the nodes are left alone."""
    if isinstance(before, Saved):
        assert isinstance(tree.residual, Streamed)
        tree.residual.restore(before)
    else:
        assert not isinstance(tree.residual, Streamed)
        tree.residual[...] = before


def in_parallel(
    work: Callable[[int], None], nodes: Sequence[Node], stage: str, run: Run, residual: F32 | Streamed | None = None,
    workers: int | None = None,
) -> None:
    """Do the work for every node, largest first; nodes share no element, so their order changes nothing.

    There are so many `workers`, if not one for each thread. Nodes in one piece of a streamed residual are worked on one
    after another while the piece is in memory.
    """
    outside = residual if isinstance(residual, Streamed) else None
    grouped = groupby(range(len(nodes)), key=lambda s: s if outside is None else id(nodes[s].piece))
    groups = [list(group) for _, group in grouped]
    sizes = [sum(nodes[s].elements for s in group) for group in groups]
    total = max(1, sum(sizes))
    queue = Queue(sizes, total if outside is None else outside.limit)

    def together() -> int:
        with queue.next() as number:
            piece, soon = nodes[groups[number][0]].piece, queue.following
            if outside is not None and soon is not None and (following := nodes[groups[soon][0]].piece) is not None:
                outside.expect(following)
            with nullcontext() if outside is None or piece is None else outside.holding(piece):
                for s in groups[number]:
                    work(s)
            return sizes[number]

    run.progress(stage, 0.0)
    workers = run.threads if workers is None else workers
    each = 1 if len(groups) >= MANY * run.threads and workers == run.threads else run.threads
    with kernels.threads(each, after=run.threads):
        repeatedly(together, len(groups), workers, lambda done: run.progress(stage, done / total))
    if outside is not None and any(node.piece is not None for node in nodes):
        outside.settle()


def told_within(nodes: Sequence[Node], stage: str, run: Run) -> Told:
    """Whom to tell how much of a node is done: where it is the only one, that is how much of the stage is."""
    return partial(run.progress, stage) if len(nodes) == 1 else lambda _: None


def streamed_for(tree: Hierarchy, node: Node) -> Streamed | None:
    """The node's tensor, where it is not in memory: the whole one, or a piece that is too large."""
    residual = tree.residual
    if not isinstance(residual, Streamed):
        return None
    return residual if node.piece is None else large(residual, node.piece)


def level_within(node: Node, depth: int) -> int:
    """Number (from 0) of a level of this depth among those of the tensor that is `streamed_for` for the node."""
    return 0 if node.piece else depth - 1


def fit_nodes(
    tree: Hierarchy, specs: Sequence[LevelSpec | None], run: Run, labels: LabelsOf = lambda _: None, *,
    last: bool = False,
) -> None:
    """Fit the deepest level, each node by its own spec (None: it stays empty), from given disjoint memberships.

    `last`: nothing reads the residual afterwards, so that of a streamed one only its norm is kept.
    """
    _set_written_back(tree, not last)
    nodes, depth, step = tree.levels[-1], len(tree.levels), run.journal.step()
    told = told_within(nodes, f"level {depth}", run)

    def work(s: int) -> None:
        node, spec = nodes[s], specs[s]
        if spec is None or node.elements == 0:
            return
        rng = np.random.default_rng([run.seed, depth, s])

        def fitted(outside: Streamed | None, level: int) -> tuple[Cells | None, F32 | None]:
            if outside is not None:
                cells = fit_outside(outside, level, spec, run.effort, rng, labels(node), told)
                return cells.rounded(), None
            tensor = gather(tree.residual, node, lent=True)

            if not tensor.any():
                return None, tensor
            return fit_level(tensor, spec, run.effort, rng, labels(node)).rounded(), tensor

        _renew(tree, run, (step, depth, s), spec, fitted)

    in_parallel(work, nodes, f"level {depth}", run, tree.residual, run.side_by_side(specs, nodes))
    if isinstance(tree.residual, Streamed) and any(node.piece is not None for node in nodes):
        tree.residual.fitted(depth)


def _renew(
    tree: Hierarchy, run: Run, at: tuple[int, int, int], spec: LevelSpec,
    fitted: Callable[[Streamed | None, int], tuple[Cells | None, F32 | None]],
) -> None:
    """Give a node the cells that the journal has of this step, or else those that are `fitted` now, which it keeps.

    `at` are the step, the node's depth and its number in the level. What fits is given the tensor and the level there,
    where memory does not hold the node; of it come the cells, None where the node keeps those that it had, and the
    node's residual, if it was gathered and is as it was.
    """
    step, depth, s = at
    node = tree.levels[depth - 1][s]
    old, outside, level = node.cells, streamed_for(tree, node), level_within(node, depth)
    if isinstance(outside, Large) and old is not None:
        outside.already_less(old)
    finished = run.journal.recall(step, s, node.sizes, spec)
    cells, residual = fitted(outside, level) if finished is None else (finished.cells, None)
    if finished is None:
        run.journal.keep(step, s, cells)
    elif outside is not None and node.piece is None and cells is not None:
        cut_as_fitted(outside, level, cells)
    if cells is None:
        return
    node.cells = cells
    if outside is not None:
        outside.change(level, cells)
    else:
        residual = gather(tree.residual, node, lent=True) if residual is None else residual
        scatter(tree.residual, node, _exchanged(residual, old, cells))


def _exchanged(residual: F32, old: Cells | None, new: Cells | None) -> F32:
    """The residual, in place, with `new` cells instead of `old`, by their rounded numbers alone: the next level absorbs
    what rounding adds, and cells read from a journal leave what fitted ones left."""
    if old is not None:
        kernels.accumulate(old, residual, 1.0)
    if new is not None:
        kernels.accumulate(new, residual, -1.0)
    return residual


def thinned(tree: Hierarchy, spec: LevelSpec) -> Hierarchy:
    """The tree's first node that memory does not hold, thinned to a small hierarchy in memory; without one the tree."""
    for node in tree.levels[-1]:
        outside = streamed_for(tree, node)
        if outside is not None and node.cells is not None:
            steps = workset_steps(outside.shape, spec, min(outside.limit, SAMPLED))
            cells = thinned_cells(node.cells, steps)
            small = whole(outside.sample(steps))
            small.levels[0][0].cells = cells
            return small
    return tree


def descend(tree: Hierarchy, scheme: str, run: Run, *, once: bool = False) -> None:
    """Subdivide every node of the deepest level (paper, section 4.2); the children are the next level, not yet fitted.

    `once`: the next level will read the residual as it is now only once, so that it need not be written to a file.
    """
    nodes = tree.levels[-1]

    def work(s: int) -> None:
        node = nodes[s]
        if node.cells is None:
            return
        tensor = None if streamed_for(tree, node) else gather(tree.residual, node)
        if tensor is not None:
            kernels.accumulate(node.cells, tensor, 1.0)
        node.parts = subdivide(node.cells, tensor, scheme)
        node.children = list(_children(node, node.cells.spec.clusters))

    in_parallel(work, nodes, "subdivision", run, tree.residual, run.side_by_side(_specs(nodes), nodes))
    for node in nodes:
        outside = streamed_for(tree, node)
        if outside is not None and node.cells is not None and node.cells.spec.cells > 1:
            if node.piece is not None:
                found, allowed = f"a sub-tensor of {node.elements} elements to subdivide", f"up to {outside.limit}"
                raise invalid("node-too-large", "plan", found, allowed, SMALLER)
            assert node.parts is not None
            pieces = outside.cut(node.parts, node.cells.spec.clusters, partial(run.progress, "reordering"), once=once)
            for child, piece in zip(node.children, pieces, strict=True):
                child.piece = piece
    tree.levels.append([child for node in nodes for child in node.children])
    tree.schemes.append(scheme)


def _children(node: Node, clusters: Sequence[int]) -> Iterator[Node]:
    assert node.parts is not None
    lists = [
        [rows[at] for at in rows_of_parts(part, count)]
        for rows, part, count in zip(node.rows, node.parts, clusters, strict=True)
    ]
    return (Node(tuple(rows), piece=node.piece) for rows in product(*lists))


def ascend(tree: Hierarchy) -> None:
    """Take the deepest level away again; the residual, to which it may have been fitted, is the caller's to restore."""
    tree.schemes.pop()
    tree.levels.pop()
    for node in tree.levels[-1]:
        node.parts, node.children = None, []


def _specs(nodes: Sequence[Node]) -> Iterator[LevelSpec]:
    return (node.cells.spec for node in nodes if node.cells is not None)


def _set_written_back(tree: Hierarchy, written_back: bool) -> None:
    """Whether the residual is read again after this step."""
    if isinstance(tree.residual, Streamed):
        tree.residual.written_back = written_back


def backfit(tree: Hierarchy, run: Run, *, last: bool = False) -> None:
    """Refit every level in turn to what all the others leave; memberships stay. `last`: as of `fit_nodes`."""
    if isinstance(tree.residual, Streamed):
        tree.residual.residual_norms = []
    for number, nodes in enumerate(tree.levels, start=1):
        _set_written_back(tree, not (last and number == len(tree.levels)))
        step, told = run.journal.step(), told_within(nodes, f"back-fitting level {number}", run)

        def work(s: int, nodes: list[Node] = nodes, step: int = step, number: int = number, told: Told = told) -> None:
            node, old = nodes[s], nodes[s].cells
            if old is None:
                return

            def refitted(outside: Streamed | None, level: int) -> tuple[Cells | None, None]:
                if outside is not None:
                    return refit_outside(outside, level, old.copy(), told).rounded(), None
                return _refitted(old, gather(tree.residual, node)), None

            _renew(tree, run, (step, number, s), old.spec, refitted)

        workers = run.side_by_side(_specs(nodes), nodes)
        in_parallel(work, nodes, f"back-fitting level {number}", run, tree.residual, workers)


def _refitted(old: Cells, residual: F32) -> Cells | None:
    """Rounded cells that leave less than `old`, which leaves `residual` (used up); None if rounding outweighs that."""
    before = squared_norm(residual)
    cells = old.copy()
    refit_level(cells, residual)
    rounded = cells.rounded()
    return rounded if squared_norm(_exchanged(residual, cells, rounded)) <= before else None


def grid_labels(spec: LevelSpec, axes: Sequence[Axis], organisation: Organisation) -> LabelsOf:
    """Disjoint memberships by equal blocks along the axes of the spec's grid; None for a spec without one."""
    counts, size = dict(spec.grid), {axis.name: axis.size for axis in axes}

    def labels(node: Node) -> Labels | None:
        if not counts:
            return None
        modes = zip(node.rows, organisation, strict=True)
        return [grid_blocks(rows, [(size[name], counts.get(name, 1)) for name in mode]) for rows, mode in modes]

    return labels
