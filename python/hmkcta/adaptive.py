"""The last level cut to a goal: every node has ranks of its own, so that bytes are filled and an SNR is just met."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from .allocation import Allocation, Spectrum, allocate, spectrum
from .cells import zero_cells
from .errors import HmkctaError, Kind
from .fit import Effort, Labels
from .hierarchy import Hierarchy, Node, Progress, backfit, fit_nodes, gather, in_parallel, squared_norm
from .plan import LevelSpec
from .tucker import core_energies

F32 = NDArray[np.float32]

#: Most ranks a mode is examined at, by the order of the tensor: the tables hold their product.
TABLE_LIMITS = {1: 4096, 2: 1024, 3: 160, 4: 48, 5: 20, 6: 12, 7: 8, 8: 6}
#: How far above an SNR goal a fit may end, in dB, and how often a fit is repeated to land there.
OVERSHOOT, ATTEMPTS = 0.2, 5


@dataclass
class Goal:
    """What the last level is cut to: bytes of the whole file, or an SNR in dB; with how both are measured.

    Attributes:
        size: largest file size in bytes, or None.
        snr: least SNR in dB, or None.
        energy: squared norm of the tensor.
        file_bytes: exact size of the file that a hierarchy would make.
        snr_now: SNR in dB of a hierarchy in the domain of the source values.
    """

    size: int | None
    snr: float | None
    energy: float
    file_bytes: Callable[[Hierarchy], int]
    snr_now: Callable[[Hierarchy], float]


def table_limits(sizes: Sequence[int], spec: LevelSpec) -> list[int | None]:
    """Ranks to examine of each mode: up to R, what the node has, and what the table holds."""
    most = TABLE_LIMITS[len(sizes)]
    limits: list[int | None] = []
    for n, rank in enumerate(spec.ranks):
        rest = int(min(np.prod([float(s) for m, s in enumerate(sizes) if m != n]), 2.0**31))
        limits.append(None if rank is None else min(rank, sizes[n], rest, most))
    return limits


def node_spectrum(
    tensor: F32, spec: LevelSpec, decode_cost: int, seed: int, labels: Labels | None = None, *, alone: bool = False
) -> Spectrum | None:
    """The node's choices of ranks, its cells' being the same; None where there is nothing to store.

    `labels` are the disjoint memberships of its cells; a node that is `alone` in its level needs no convex choices.
    """
    energy = squared_norm(tensor)
    if tensor.size == 0 or energy == 0:
        return None
    blocks = [tensor] if labels is None else cell_blocks(tensor, labels, spec.clusters)
    sizes = [max(block.shape[n] for block in blocks) for n in range(tensor.ndim)]
    limits = table_limits(sizes, spec)
    table = summed(core_energies(block, limits, np.random.default_rng(seed)) for block in blocks if block.size)
    undecomposed = [r is None for r in spec.ranks]
    return spectrum(table, energy, tensor.shape, undecomposed, decode_cost, spec.clusters if labels else None, hull=not alone)


def cell_blocks(tensor: F32, labels: Labels, clusters: Sequence[int]) -> list[F32]:
    """The disjoint sub-tensors of a node's cells."""
    rows = [[np.flatnonzero(part == c) for c in range(count)] for part, count in zip(labels, clusters, strict=True)]
    return [np.ascontiguousarray(tensor[np.ix_(*chosen)]) for chosen in product(*rows)]


def summed(tables: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Sum of cumulative energy tables of different extents; beyond its extent a table stays at its last value."""
    parts = list(tables)
    shape = tuple(max(part.shape[n] for part in parts) for n in range(parts[0].ndim))
    return sum(np.pad(part, [(0, most - size) for most, size in zip(shape, part.shape, strict=True)], mode="edge")
               for part in parts) + np.zeros(shape)


def fit_to_goal(
    tree: Hierarchy, spec: LevelSpec, goal: Goal, decode_cost: int, effort: Effort, seed: int, threads: int,
    progress: Progress, labels: Callable[[Node], Labels | None] = lambda _: None,
) -> None:
    """Fit the deepest level with node shapes of its own, again with corrected ranks until the goal is met."""
    nodes = tree.levels[-1]
    state = _Saved(tree)
    spectra: list[Spectrum | None] = [None] * len(nodes)

    def examine(s: int) -> None:
        tensor = gather(tree.residual, nodes[s])
        spectra[s] = node_spectrum(tensor, spec, decode_cost, seed, labels(nodes[s]), alone=len(nodes) == 1)

    in_parallel(examine, nodes, threads, "ranks of each node", progress)
    found = [(s, choices) for s, choices in enumerate(spectra) if choices is not None]
    fixed = tree.error - sum(float(choices.error[0]) for _, choices in found)
    if not found:
        return
    goal_error = goal.energy * 10 ** (-(goal.snr or 0.0) / 10)
    budget = float(goal.size or 0)
    for attempt in range(ATTEMPTS):
        if goal.size is not None:
            chosen = _within_bytes(tree, found, spec, goal, budget)
        else:
            chosen = allocate([c for _, c in found], error=max(goal_error - fixed, 0.0))
        if attempt:
            state.restore(tree)
        fit_nodes(tree, _specs(len(nodes), found, chosen, spec), effort, seed, threads, progress, labels)
        for _ in range(effort.backfits):
            backfit(tree, 1, threads, progress)
        if goal.snr is None:
            if goal.file_bytes(tree) <= (goal.size or 0):
                return
            budget *= 0.99
            continue
        over = goal.snr_now(tree) - goal.snr
        exhausted = bool((chosen.choice == [len(c.error) - 1 for _, c in found]).all())
        if 0 <= over <= OVERSHOOT or (over < 0 and exhausted) or (over > 0 and not chosen.choice.any()):
            return
        # Land a little above: HOOI and back-fitting gain about as much at the next, nearby, choice of ranks.
        goal_error *= 10 ** ((over - 0.4 * OVERSHOOT) / 10)


class _Saved:
    """The fit before the last level, to start the next attempt from."""

    def __init__(self, tree: Hierarchy) -> None:
        self.residual = tree.residual.copy()
        self.cells = [[node.cells for node in nodes] for nodes in tree.levels]

    def restore(self, tree: Hierarchy) -> None:
        tree.residual[...] = self.residual
        for nodes, saved in zip(tree.levels, self.cells, strict=True):
            for node, cells in zip(nodes, saved, strict=True):
                node.cells = cells


def _specs(
    count: int, found: Sequence[tuple[int, Spectrum]], chosen: Allocation, spec: LevelSpec
) -> list[LevelSpec | None]:
    """Each node's chosen ranks."""
    specs: list[LevelSpec | None] = [None] * count
    for (s, choices), choice in zip(found, chosen.choice, strict=True):
        if choice:
            ranks = tuple(None if r is None else int(v) for r, v in zip(spec.ranks, choices.ranks[choice], strict=True))
            specs[s] = replace(spec, ranks=ranks, own=False)
    return specs


def _within_bytes(
    tree: Hierarchy, found: Sequence[tuple[int, Spectrum]], spec: LevelSpec, goal: Goal, size: float
) -> Allocation:
    """The allocation whose file, tables and header counted exactly, is at most `size` bytes."""
    spectra = [choices for _, choices in found]
    fixed = goal.file_bytes(tree) - allocate(spectra, nbytes=0.0).nbytes
    fitting = None
    for _ in range(4):
        chosen = allocate(spectra, nbytes=size - fixed)
        exact = goal.file_bytes(_dressed(tree, _specs(len(tree.levels[-1]), found, chosen, spec)))
        if exact <= size and (fitting is None or chosen.nbytes > fitting.nbytes):
            fitting = chosen
        fixed += exact - (chosen.nbytes + fixed)  # what the count of tables and header was off by
    if fitting is None:
        raise HmkctaError(Kind.INVALID_ARGUMENT, "size-too-small", "size", found=f"{int(size)} bytes",
                          allowed=f"at least {exact} bytes for this plan", hint="ask for more bytes or give a coarser --plan")
    return fitting


def _dressed(tree: Hierarchy, specs: Sequence[LevelSpec | None]) -> Hierarchy:
    """The hierarchy as it will be shaped, its last level all zeros: enough to count bytes."""
    last = [replace(node, cells=None if spec is None else zero_cells(node.sizes, spec))
            for node, spec in zip(tree.levels[-1], specs, strict=True)]
    return Hierarchy(tree.residual, [*tree.levels[:-1], last])
