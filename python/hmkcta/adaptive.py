"""The last level cut to a goal: every node has ranks of its own, so that bytes are filled and an SNR is just met."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite, prod

import numpy as np
from numpy.typing import NDArray

from .allocation import Allocation, Spectrum, allocate, merged, spectrum, trimmed
from .cells import zero_cells
from .disjoint import energies, summed
from .errors import invalid
from .fit import Labels
from .hierarchy import (
    Hierarchy,
    LabelsOf,
    Node,
    Run,
    backfit,
    fit_nodes,
    gather,
    in_parallel,
    level_within,
    restore,
    sampled,
    saved,
    streamed,
    within,
)
from .memberships import by_subspaces, start_candidates
from .memory import check_memory, format_bytes, give_back_freed_memory
from .metrics import snr_db, squared_norm
from .narrow import LEFT
from .plan import HIGHEST_RANK, LevelSpec
from .predict import MODEL, PROCESS
from .progress import Told, share_of
from .streamed import Streamed
from .tucker import core_energies

F32 = NDArray[np.float32]

#: Most entries of the table of choices of a node, and of one alone in its level.
TABLE_ENTRIES, LONE_ENTRIES = 60_000, 400_000
#: How far above an SNR goal a fit may end, in dB, how often a fit is repeated to land there, and how far above many
#: nodes, whose choices come in small steps, aim; where promises too poor and too good are so near each other it ends.
OVERSHOOT, ATTEMPTS, MARGIN, NARROW = 0.25, 16, 0.05, 0.03
#: The most that is reckoned with of an error that is allowed for what numbers of a byte leave.
MOST_ROUNDING = 0.3


@dataclass
class Goal:
    """What the last level is cut to: bytes of the whole file, or an SNR in dB; with how both are measured.

    Attributes:
        size: largest file size in bytes, or None.
        snr: least SNR in dB, or None.
        energy: squared norm of the tensor.
        file_bytes: exact size of the file that a hierarchy would make.
        snr_now: SNR in dB of a hierarchy in the domain of the source values.
        memory: bytes to work in, if they are given.
        untold: squared error that is little beside what the SNR allows.
    """

    size: int | None
    snr: float | None
    energy: float
    file_bytes: Callable[[Hierarchy], int]
    snr_now: Callable[[Hierarchy], float]
    memory: int | None = None
    untold: float = 0.0


def table_limits(
    sizes: Sequence[int],
    spec: LevelSpec,
    nbytes: float = inf,
    stored: Sequence[int] | None = None,
    entries: int = TABLE_ENTRIES,
) -> list[int | None]:
    """Ranks to examine of each mode: up to R, what the node has, what the table holds, and what `nbytes` can store.

    `stored` are the sizes that bytes are counted by, where the node is thinned.
    """
    limits: list[int | None] = []
    for n, rank in enumerate(spec.ranks):
        rest = int(min(prod(float(size) for m, size in enumerate(sizes) if m != n), 2.0**31))
        affordable = int(min(nbytes / (spec.bits / 8 * (stored or sizes)[n]), HIGHEST_RANK)) + 1
        limits.append(None if rank is None else min(rank, sizes[n], rest, HIGHEST_RANK, affordable))
    while prod(limit or 1 for limit in limits) > entries:
        longest = max(range(len(limits)), key=lambda n: limits[n] or 0)
        limits[longest] = max(1, (limits[longest] or 1) * 7 // 8)
    return limits


def node_spectrum(
    tensor: F32,
    spec: LevelSpec,
    decode_cost: int,
    seed: int,
    labels: Labels | None = None,
    *,
    alone: bool = False,
    nbytes: float = inf,
    untold: float = 0.0,
    sample_of: tuple[Sequence[int], float] | None = None,
) -> Spectrum | None:
    """The node's choices of ranks, its cells' being the same; None where there is nothing to store.

    `labels` are the disjoint memberships of its cells; a node that is `alone` in its level needs no convex choices.
    The tensor may be a `sample_of` a node of these sizes and this squared norm. Errors below `untold` may be left out.
    """
    own = squared_norm(tensor)
    if tensor.size == 0 or own == 0:
        return None
    full, energy = (tensor.shape, own) if sample_of is None else sample_of
    blocks = [tensor] if labels is None else cell_blocks(tensor, labels, spec.clusters)
    sizes = [max(block.shape[n] for block in blocks) for n in range(tensor.ndim)]
    stored = [-(-size * long // max(1, short)) for size, long, short in zip(sizes, full, tensor.shape, strict=True)]
    limits = table_limits(sizes, spec, nbytes, stored, LONE_ENTRIES if alone else TABLE_ENTRIES)
    # Shares of the sample's energy are taken for those of the node's: as errors they would miss what it has more of.
    enough = untold * own / energy / len(blocks)
    tables = (core_energies(block, limits, np.random.default_rng(seed), enough) for block in blocks if block.size)
    table = energy / own * summed(tables)
    undecomposed = [r is None for r in spec.ranks]
    return spectrum(
        table, energy, full, undecomposed, decode_cost, spec.clusters if labels else None, hull=not alone,
        bits=spec.bits,
    )


def outside_spectrum(
    outside: Streamed, number: int, spec: LevelSpec, labels: Labels, decode_cost: int, seed: int, told: Told,
    *, alone: bool, nbytes: float,
) -> Spectrum | None:
    """As `node_spectrum`, of a node whose blocks, which share no element, are read one by one."""

    def limits(sizes: Sequence[int]) -> list[int | None]:
        return table_limits(sizes, spec, nbytes, entries=LONE_ENTRIES if alone else TABLE_ENTRIES)

    table, energy = energies(outside, number, spec, labels, limits, seed, told)
    undecomposed = [r is None for r in spec.ranks]
    choices = spectrum(
        table, energy, outside.shape, undecomposed, decode_cost, spec.clusters, hull=not alone, bits=spec.bits
    )
    return choices if energy else None


def cell_blocks(tensor: F32, labels: Labels, clusters: Sequence[int]) -> list[F32]:
    """The disjoint sub-tensors of a node's cells."""
    blocks = [tensor]
    for n, (part, count) in enumerate(zip(labels, clusters, strict=True)):
        if count > 1:
            rows = [np.flatnonzero(part == c) for c in range(count)]
            blocks = [block.take(chosen, axis=n) for block in blocks for chosen in rows]
    return blocks


#: The stage before the fit.
EXAMINING = "ranks of each node"
#: A way to fit a node: ranks up to which, clusters, and the memberships that its cells start from.
Way = tuple[LevelSpec, LabelsOf]


def fit_to_goal(tree: Hierarchy, ways: Sequence[Way], goal: Goal, decode_cost: int, run: Run) -> None:
    """Fit the deepest level with node shapes of its own, again with corrected ranks until the goal is met."""
    nodes = tree.levels[-1]
    run.progress(EXAMINING, 0.0)  # finding the clusters to start from takes its time already
    ways = [each for spec, labels in ways for each in _starts(tree, spec, labels, run)]
    spectra = _examined(tree, ways, goal, decode_cost, run)
    further = _parted_anew(tree, ways, spectra[0], goal, run)
    if further:
        spectra[0] += _examined(tree, further, goal, decode_cost, run)[0]
        ways += further
    found = [(s, merged(own, hull=len(nodes) > 1)) for s, own in enumerate(spectra) if own]
    if found:
        level = _LastLevel(tree, found, ways, goal, run)
        level.to_size(goal.size) if goal.size is not None else level.to_snr(goal.snr or 0.0)


def _examined(
    tree: Hierarchy, ways: Sequence[Way], goal: Goal, decode_cost: int, run: Run
) -> list[list[Spectrum]]:
    """Of every node its choices in each way; none where there is nothing to store."""
    nodes = tree.levels[-1]
    spectra: list[list[Spectrum]] = [[] for _ in nodes]
    told = within(nodes, EXAMINING, run)

    def examine(s: int) -> None:
        for number, way in enumerate(ways):
            own = _spectrum_of(tree, nodes[s], way, goal, decode_cost, run.seed, share_of(told, number, len(ways)))
            spectra[s] += [] if own is None else [own]

    if ways:
        in_parallel(examine, nodes, EXAMINING, run, tree.residual)
    return spectra


def _parted_anew(
    tree: Hierarchy, ways: Sequence[Way], spectra: Sequence[Spectrum], goal: Goal, run: Run
) -> list[Way]:
    """The way that promises most, with the clusters of the data that its ranks make of it: known now, unlike before."""
    if isinstance(tree.residual, Streamed) or not spectra or ways[0][0].cells == 1 or ways[0][0].grid:
        return []
    choices = merged(spectra, hull=False)
    within = inf if goal.size is None else float(goal.size)
    beyond = 0.0 if goal.snr is None else goal.energy * 10 ** (-goal.snr / 10)
    affordable = np.flatnonzero((choices.nbytes <= within) & (choices.error >= beyond))
    best = affordable[np.argmin(choices.error[affordable])]
    if choices.nbytes[best] == choices.nbytes[0]:  # nothing is stored
        return []
    spec, _ = ways[int(choices.way[best])]
    told, rng = _with_ranks(spec, choices.ranks[best]), np.random.default_rng(run.seed)
    return [(spec, lambda _, found=found: found) for found in by_subspaces(tree.residual, told, rng)]


def _with_ranks(spec: LevelSpec, ranks: NDArray[np.int32]) -> LevelSpec:
    """The level with these ranks instead of those it may choose among."""
    given = tuple(None if most is None else int(rank) for rank, most in zip(ranks, spec.ranks, strict=True))
    return replace(spec, ranks=given, own=False)


def _spectrum_of(
    tree: Hierarchy, node: Node, way: Way, goal: Goal, decode_cost: int, seed: int, told: Told
) -> Spectrum | None:
    """A node's choices of ranks if it is fitted in this way; None where there is nothing to store."""
    (spec, labels), alone, nbytes = way, len(tree.levels[-1]) == 1, goal.size or inf
    part, outside = labels(node), streamed(tree, node)
    if outside is not None and part is not None and spec.disjoint:
        level = level_within(node, len(tree.levels))
        return outside_spectrum(outside, level, spec, part, decode_cost, seed, told, alone=alone, nbytes=nbytes)
    sample = sampled(tree, node, spec)
    if outside is None or sample is None:
        values, untold = gather(tree.residual, node), goal.untold / len(tree.levels[-1])
        return node_spectrum(values, spec, decode_cost, seed, part, alone=alone, nbytes=nbytes, untold=untold)
    tensor, steps = sample
    part = None if part is None else [own[::step] for own, step in zip(part, steps, strict=True)]
    energy = goal.energy if len(tree.levels) == 1 else outside.error
    whole = (node.sizes, energy)
    return node_spectrum(tensor, spec, decode_cost, seed, part, alone=alone, nbytes=nbytes, sample_of=whole)


def _starts(tree: Hierarchy, spec: LevelSpec, labels: LabelsOf, run: Run) -> list[Way]:
    """The way itself, or where its cells are clusters of the data one for each start that the effort allows.

    Raises:
        HmkctaError: clusters of a tensor that memory does not hold.
    """
    if spec.cells == 1 or spec.grid:
        return [(spec, labels)]
    if isinstance(tree.residual, Streamed):
        allowed = "R=.. with the clusters of an array that is not worked on in one piece"
        raise invalid("own-ranks-clusters", "level 1", str(spec), allowed, "give ranks, or raise --max-memory")
    starts = start_candidates(tree.residual, spec, run.effort.candidates, np.random.default_rng(run.seed))
    return [(spec, lambda _, found=found: found) for found in starts]


#: SNR in dB that choices promise, and that a fit of them reaches; between the next two lies any other.
Reached = tuple[float, float]
_NOTHING, _EVERYTHING = (-inf, -inf), (inf, inf)


def _aimed(snr: float, now: Reached, poor: Reached, good: Reached) -> float:
    """The promise that should reach `snr`: what has just been gained on one is gained again, or what lies between."""
    gained = now[1] - now[0]
    aim = snr - gained if isfinite(gained) else snr
    if poor[0] < aim < good[0] or not (isfinite(poor[1]) and isfinite(good[1])):
        return aim
    return poor[0] + (good[0] - poor[0]) * (snr - poor[1]) / (good[1] - poor[1])


#: Numbers of the nodes that have something to store, with their choices.
Found = Sequence[tuple[int, Spectrum]]


class _LastLevel:
    """The fit before the last level, and the choices of ranks from which each attempt starts afresh."""

    def __init__(self, tree: Hierarchy, found: Found, ways: Sequence[Way], goal: Goal, run: Run) -> None:
        self.tree, self.found, self.ways, self.goal, self.run = tree, found, ways, goal, run
        self.spectra = [choices for _, choices in found]
        self.residual = saved(tree)
        self.cells = [[node.cells for node in nodes] for nodes in tree.levels]
        #: What was fitted last.
        self.fitted = b""
        #: Squared error outside the nodes that have choices, and bytes beside what the choices count.
        own = sum(float(choices.error[0]) for choices in self.spectra)
        self.elsewhere = tree.error - own + self._rounding(own)
        self.beside = goal.file_bytes(tree) - allocate(self.spectra, nbytes=0.0).nbytes

    def _rounding(self, energy: float) -> float:
        """What bytes will leave of so much energy, but no more than a share of what an SNR allows."""
        allowed = inf if self.goal.snr is None else self.goal.energy * 10 ** (-self.goal.snr / 10)
        return min(energy * LEFT, MOST_ROUNDING * allowed) if self.ways[0][0].bits == 8 else 0.0

    def to_size(self, size: int) -> None:
        """As much as fits into a file of `size` bytes."""
        for budget in (size, 0.995 * size, 0.98 * size):
            self._fit(self._within(budget))
            if self.goal.file_bytes(self.tree) <= size:
                return

    def to_snr(self, snr: float) -> None:
        """The fewest bytes that were found to reach `snr`; the search ends where they exceed it by little.

        What a fit gains or loses against its choices' promise, the next choice, which is nearby, is taken to gain too.
        Where that leads out of what lies between a fit too poor and one too good, as with a value transform, it is
        looked for between those two.
        """
        aim, best, tried, poor, good = snr, None, set[bytes](), _NOTHING, _EVERYTHING
        for _ in range(ATTEMPTS):
            error = max(self.goal.energy * 10 ** (-aim / 10) - self.elsewhere, 0.0)
            chosen = trimmed(self.spectra, allocate(self.spectra, error=error), error)
            if chosen.choice.tobytes() in tried:
                if best is not None:
                    break
                aim += OVERSHOOT  # the next step of ranks is further away than the error was off
                continue
            tried.add(chosen.choice.tobytes())
            self._fit(chosen)
            reached = self.goal.snr_now(self.tree)
            if reached >= snr and (best is None or chosen.nbytes < best.nbytes):
                best = chosen
            now = self._promised(chosen), reached
            poor, good = (max(poor, now), good) if reached < snr else (poor, min(good, now))
            if snr <= reached <= snr + OVERSHOOT or good[0] - poor[0] < NARROW:
                break
            aim = _aimed(snr, now, poor, good) + (MARGIN if len(self.spectra) > 1 else 0.0)
        last = best or allocate(self.spectra, error=0.0)
        if last.choice.tobytes() != self.fitted:
            self._fit(last)

    def _promised(self, chosen: Allocation) -> float:
        """SNR in dB that the choices leave by their own errors, in the domain of the fit."""
        return snr_db(self.goal.energy, max(self.elsewhere + chosen.error, 0.0))

    def _fit(self, chosen: Allocation) -> None:
        self.fitted = chosen.choice.tobytes()
        if isinstance(self.tree.residual, Streamed):
            give_back_freed_memory()  # of the fit before, which lies where large arrays of this one do not
        if isinstance(self.tree.residual, Streamed) and self.goal.memory is not None:
            what = f"a model of {format_bytes(int(chosen.nbytes))}"
            hint = "raise --max-memory, or ask for a lower SNR or fewer bytes"
            check_memory(PROCESS // 2 + int(MODEL * chosen.nbytes), what, hint, self.goal.memory)
        restore(self.tree, self.residual)
        for nodes, before in zip(self.tree.levels, self.cells, strict=True):
            for node, cells in zip(nodes, before, strict=True):
                node.cells = cells
        nodes, labels = self.tree.levels[-1], dict[int, LabelsOf]()
        for (s, choices), choice in zip(self.found, chosen.choice, strict=True):
            labels[id(nodes[s])] = self.ways[int(choices.way[int(choice)])][1]

        def labels_of(node: Node) -> Labels | None:
            return labels[id(node)](node)

        fit_nodes(self.tree, self._specs(chosen), self.run, labels_of)
        for _ in range(self.run.effort.backfits if len(self.tree.levels) > 1 else 0):
            backfit(self.tree, self.run)

    def _specs(self, chosen: Allocation) -> list[LevelSpec | None]:
        """Each node's chosen way and ranks."""
        specs: list[LevelSpec | None] = [None] * len(self.tree.levels[-1])
        for (s, choices), choice in zip(self.found, chosen.choice, strict=True):
            if choice:
                specs[s] = _with_ranks(self.ways[int(choices.way[int(choice)])][0], choices.ranks[choice])
        return specs

    def _within(self, size: float) -> Allocation:
        """The allocation whose file, tables and header counted exactly, is at most `size` bytes."""
        fitting, exact = None, 0
        for _ in range(4):
            chosen = allocate(self.spectra, nbytes=size - self.beside)
            exact = self.goal.file_bytes(self._dressed(chosen))
            if exact <= size and (fitting is None or chosen.nbytes > fitting.nbytes):
                fitting = chosen
            self.beside = exact - chosen.nbytes
        if len(self.tree.levels) == 1 and (fitting is None or not fitting.choice.any()):
            # A file in which nothing is stored would be no answer: one with the least that can be, or none.
            least = Allocation(np.ones(len(self.spectra), np.intp), 0.0, 0.0)
            exact = self.goal.file_bytes(self._dressed(least))
            fitting = least if exact <= size else None
        if fitting is None:
            allowed = f"at least {exact} bytes for this plan and organisation"
            hint = "ask for more, merge axes or give a coarser plan"
            raise invalid("size-too-small", "size", f"{self.goal.size} bytes", allowed, hint)
        return fitting

    def _dressed(self, chosen: Allocation) -> Hierarchy:
        """The hierarchy as it will be shaped, its last level all zeros: enough to count bytes."""
        last = [
            replace(node, cells=None if spec is None else zero_cells(node.sizes, spec))
            for node, spec in zip(self.tree.levels[-1], self._specs(chosen), strict=True)
        ]
        return Hierarchy(self.tree.residual, [*self.tree.levels[:-1], last], self.tree.schemes)
