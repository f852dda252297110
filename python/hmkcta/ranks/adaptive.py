"""The last level cut to a goal: every node has ranks of its own, so that bytes are filled and an SNR is just met."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf, isfinite, log2, prod

import numpy as np
from numpy.typing import NDArray

from ..cells import zero_cells
from ..errors import HmkctaError, invalid
from ..fitting.fit import Labels
from ..fitting.hierarchy import (
    Hierarchy,
    LabelsOf,
    Node,
    Run,
    backfit,
    fit_nodes,
    restore,
    saved,
)
from ..fitting.memberships import by_subspaces, start_candidates
from ..goals import LEAST
from ..metrics import noise_at
from ..parameters import LEFT
from ..plan import LevelSpec
from ..streaming.budget import MODEL, PROCESS
from ..streaming.streamed import Streamed
from ..support.memory import check_memory, format_bytes, give_back_freed_memory
from .allocation import Allocation, Spectrum, allocate, merged, stored_bits, trimmed
from .examining import EXAMINING, Goal, Way, examined
from .reckoning import SHARE, SHARES, Found, Reckoning

F32 = NDArray[np.float32]

#: How far above an SNR goal a fit may end, in dB.
OVERSHOOT = 0.25
#: How often a fit is repeated at most to land there.
ATTEMPTS = 16
#: The same where the values as they are would take fewer bytes.
FEW_ATTEMPTS = 3
#: How far above the goal a level of several nodes aims, in dB: its choices come in small steps.
MARGIN = 0.05
#: Files below so many bytes may do better without tables of parameters.
SMALL_FILE = 3 << 10
#: The least, where ranks fall short of an SNR.
FINEST_SHARE = 2e-3
#: How often a fit is repeated at most with fewer bits that still reach the SNR, how far above it is near enough, in dB,
#: and what share of the bytes is worth another fit.
SHARE_ATTEMPTS, NEAR, WORTH = 6, 0.06, 0.005
#: By how many bits all columns are changed at most at once.
MOST_BITS = 2
#: How often a fit to a size is repeated at most, the share of it that is enough, and that is aimed at.
SIZE_ATTEMPTS, USED, AIMED = 5, 0.98, 0.99
#: How many times the bytes of what was fitted the next higher ranks take at most, how often these are fitted with fewer
#: bits, and up to what share.
FURTHER_RANKS, MORE_ATTEMPTS, MOST_SHARE = (1.05, 1.1, 1.2, 1.4, 1.7, 2.0), 3, 40.0
#: A plan is given up that promises more than so many times the bytes of another one: before the first fit, and after
#: it, when it is known how far promises are off.
PROMISED = 1.1, 1.02
#: The search ends where a promise that was too poor and one that was good enough are so near each other, in dB.
NARROW = 0.03
#: Share of the error that an SNR allows that the rounding of packed numbers is reckoned to take at most.
MOST_ROUNDING = 0.3


def fit_to_goal(tree: Hierarchy, ways: Sequence[Way], goal: Goal, decode_cost: int, run: Run) -> None:
    """Fit the deepest level with node shapes of its own, again with corrected ranks until the goal is met."""
    nodes = tree.levels[-1]
    run.progress(EXAMINING, 0.0)  # finding the clusters to start from takes its time already
    ways = [each for spec, labels in ways for each in _starts(tree, spec, labels, run)]
    spectra = examined(tree, ways, goal, decode_cost, run)
    further = _parted_anew(tree, ways, spectra[0], goal, run)
    if further:
        spectra[0] += examined(tree, further, goal, decode_cost, run, first=len(ways))[0]
        ways += further
    found = [(s, merged(own, hull=len(nodes) > 1)) for s, own in enumerate(spectra) if own]
    if found:
        level = _LastLevel(tree, found, ways, goal, run)
        level.to_size(goal.size) if goal.size is not None else level.to_snr(goal.snr or 0.0)


def _parted_anew(
    tree: Hierarchy, ways: Sequence[Way], spectra: Sequence[Spectrum], goal: Goal, run: Run
) -> list[Way]:
    """The way that promises most, with its clusters found anew by K-subspaces of the ranks it would have.

    Before the ways were examined these ranks were not known. None for blocks, single cells, and streamed tensors.
    """
    if isinstance(tree.residual, Streamed) or not spectra or ways[0][0].cells == 1 or ways[0][0].grid:
        return []
    choices = merged(spectra, hull=False)
    within = inf if goal.size is None else float(goal.size)
    beyond = 0.0 if goal.snr is None else noise_at(goal.snr, goal.energy)
    affordable = np.flatnonzero((choices.nbytes <= within) & (choices.error >= beyond))
    if not len(affordable):
        return []
    best = affordable[np.argmin(choices.error[affordable])]
    if choices.nbytes[best] == choices.nbytes[0]:  # nothing is stored
        return []
    spec, _ = ways[int(choices.way[best])]
    told, rng = _with_ranks(spec, choices.ranks[best]), np.random.default_rng(run.seed)
    return [(spec, lambda _, found=found: found) for found in by_subspaces(tree.residual, told, rng)]


def _with_ranks(spec: LevelSpec, ranks: NDArray[np.int32], share: float = 0.0) -> LevelSpec:
    """The level with these ranks instead of those it may choose among, and so much left by rounding (`own_bits`)."""
    given = tuple(None if most is None else int(rank) for rank, most in zip(ranks, spec.ranks, strict=True))
    return replace(spec, ranks=given, own=False, own_bits=share)


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
    """The promise in dB that should reach `snr`, from what the last one reached (`now`), and the nearest two around it.

    These are the best that was too poor and the poorest that was good enough, or infinite.
    """
    gained = now[1] - now[0]
    aim = snr - gained if isfinite(gained) else snr
    if poor[0] < aim < good[0] or not (isfinite(poor[1]) and isfinite(good[1])):
        return aim
    return poor[0] + (good[0] - poor[0]) * (snr - poor[1]) / (good[1] - poor[1])


#: Choices that were fitted, what they took in bytes, and the share of the error that rounding was to leave.
Fitted = tuple[Allocation, int, float]


class _LastLevel:
    """The fit before the last level, and the choices of ranks from which each attempt starts afresh."""

    def __init__(self, tree: Hierarchy, found: Found, ways: Sequence[Way], goal: Goal, run: Run) -> None:
        self.tree, self.found, self.ways, self.goal, self.run = tree, found, ways, goal, run
        self.spectra = [choices for _, choices in found]
        self.residual = saved(tree)
        self.cells = [[node.cells for node in nodes] for nodes in tree.levels]
        #: What was fitted last.
        self.fitted: tuple[bytes, float] = b"", 0.0
        #: Squared error outside the nodes that have choices, and bytes beside what the choices count.
        own = sum(float(choices.error[0]) for choices in self.spectra)
        packed, beside = ways[0][0].bits == 8, goal.file_bytes(tree) - allocate(self.spectra, nbytes=0.0).nbytes
        self.reckoned = Reckoning(
            tree.levels[-1], found, ways, goal.energy, tree.error - own, beside, stored_bits(ways[0][0].bits, goal.snr),
            packed, SHARE if packed else 0.0,
        )  # fmt: skip
        self.reckoned.elsewhere += self._rounding(own) if packed else 0.0

    def _rounding(self, energy: float) -> float:
        """What packed numbers will leave of so much energy, but no more than a share of what an SNR allows."""
        allowed = inf if self.goal.snr is None else noise_at(self.goal.snr, self.goal.energy)
        of_columns = 0.0 if self.goal.snr is None else SHARE / (1 + SHARE) * allowed
        return min(energy * LEFT, MOST_ROUNDING * allowed) + of_columns

    def to_size(self, size: int) -> None:
        """As much as fits into a file of `size` bytes; a little less is tried where the file turns out larger."""
        if self.reckoned.packed:
            self._to_size_of_columns(size)
            return
        for budget in (size, 0.995 * size, 0.98 * size):
            self._fit(self._within(budget))
            if self.goal.file_bytes(self.tree) <= size:
                return

    def _to_size_of_columns(self, size: int) -> None:
        """The same where columns have bits of their own, of which a fit tells how many they are.

        Ranks are chosen again by what that told. Where it leads to ranks that were fitted before, all columns get more
        bits, or fewer.
        """
        best, left, tried, chosen = None, inf, set[tuple[bytes, float]](), self.reckoned.filling(size)
        usual = self.reckoned.share = self.reckoned.share_of(chosen)
        for _ in range(SIZE_ATTEMPTS):
            if (chosen.choice.tobytes(), self.reckoned.share) in tried or not self._stores(chosen):
                break
            tried.add((chosen.choice.tobytes(), self.reckoned.share))
            self._fit(chosen)
            taken = self.goal.file_bytes(self.tree)
            if taken <= size and (best is None or taken > best[1]):
                best, left = (chosen, taken, self.reckoned.share), self.tree.error
            if USED * size <= taken <= size:
                break
            other = self.reckoned.filling(AIMED * size)
            if self.reckoned.share == usual and (other.choice.tobytes(), usual) not in tried:
                chosen = other
                continue
            fewer = 8 * (taken - AIMED * size) / max(self.reckoned.numbers(chosen), 1)  # bits of each number
            self.reckoned.share = min(max(self.reckoned.share * 4.0 ** min(fewer, MOST_BITS), SHARES[0]), SHARES[1])
        if best is not None and best[1] < USED * size:
            best = self._with_more_ranks(size, best, left)
        chosen, _, self.reckoned.share = best or (self._within(size), 0, 0.0)
        if self.fitted != (chosen.choice.tobytes(), self.reckoned.share):
            self._fit(chosen)
        if best is not None and size < SMALL_FILE:
            self._unless_bytes_do(size, chosen, self.reckoned.share)

    def _with_more_ranks(self, size: int, best: Fitted, left: float) -> Fitted:
        """What was fitted, its bytes and share, or the next higher ranks with as few bits as fit, if these leave less.

        Where data end at a rank, all its ranks are worth more than bits.
        """
        chosen, _, self.reckoned.share = best
        more = (allocate(self.spectra, nbytes=times * chosen.nbytes) for times in FURTHER_RANKS)
        further = next((each for each in more if not np.array_equal(each.choice, chosen.choice)), chosen)
        taken, numbers = self.reckoned.nbytes(further), max(self.reckoned.numbers(further), 1)
        for _ in range(MORE_ATTEMPTS if further is not chosen else 0):
            self.reckoned.share *= 4.0 ** (8 * (taken - AIMED * size) / numbers)
            if not SHARES[0] < self.reckoned.share < MOST_SHARE:
                break
            self._fit(further)
            taken = self.goal.file_bytes(self.tree)
            if taken <= size and self.tree.error < left:
                best, left = (further, taken, self.reckoned.share), self.tree.error
            if USED * size <= taken <= size:
                break
        return best

    def _unless_bytes_do(self, size: int, chosen: Allocation, share: float) -> None:
        """What is fitted, or a byte for each number, where that leaves less: parameters take some bytes, too."""
        left = self.tree.error
        try:
            others = self._within(size)
        except HmkctaError:
            return
        self.reckoned.share = 0.0
        self._fit(others)
        if self.tree.error >= left or self.goal.file_bytes(self.tree) > size:
            self.reckoned.share = share
            self._fit(chosen)

    def _stores(self, chosen: Allocation) -> bool:
        """Whether there will be anything in the file."""
        return len(self.tree.levels) > 1 or bool(chosen.choice.any())

    def to_snr(self, snr: float) -> None:
        """Fit the level again and again until it just reaches `snr` dB, and keep the fit of fewest bytes that does.

        Choices of ranks promise an SNR, by the energies of HOSVD cores; a fit of them reaches another one. The first
        fit is of choices that promise `snr`. What it reached beyond its promise, or short of it, the next choices are
        taken to gain or lose as well, as they are near. Where that leads out of the interval between a promise that was
        too poor and one that was good enough, as it may under a value transform, the next one is interpolated between
        these two (`_aimed`).

        The search ends up to `OVERSHOOT` dB above the goal, where the two promises nearly meet, where the next choices
        were fitted before, or after `ATTEMPTS` fits. If none reached the goal, all ranks that there are are fitted.

        Raises:
            HmkctaError: reason ``size-too-small``: these choices take more bytes than another plan (`Goal.most`).
        """
        aim, best, tried, poor, good = snr, None, set[bytes](), _NOTHING, _EVERYTHING
        wasteful = self.ways[0][0].bits / 8 * sum(prod(node.sizes) for node in self.tree.levels[-1])
        for attempt in range(ATTEMPTS):
            error = max(noise_at(aim, self.goal.energy) - self.reckoned.elsewhere, 0.0)
            chosen = trimmed(self.spectra, allocate(self.spectra, error=error), error)
            if attempt == 0:
                self.reckoned.share = self.reckoned.share_of(chosen)
            if chosen.choice.tobytes() in tried:
                if best is not None:
                    break
                aim += OVERSHOOT  # the next step of ranks is further away than the error was off
                continue
            self._refuse_more(chosen, PROMISED[min(attempt, 1)])
            tried.add(chosen.choice.tobytes())
            self._fit(chosen)
            reached = self.goal.snr_now(self.tree)
            if reached >= snr and (best is None or chosen.nbytes < best.nbytes):
                best = chosen
            now = self.reckoned.snr(chosen), reached
            poor, good = (max(poor, now), good) if reached < snr else (poor, min(good, now))
            if snr <= reached <= snr + OVERSHOOT or good[0] - poor[0] < NARROW:
                break
            if attempt + 1 >= FEW_ATTEMPTS and chosen.nbytes > wasteful:  # the values themselves would take less
                break
            aim = _aimed(snr, now, poor, good) + (MARGIN if len(self.spectra) > 1 else 0.0)
        last = best or allocate(self.spectra, error=0.0)
        self._just_reaching(snr, last)

    def _just_reaching(self, snr: float, last: Allocation) -> None:
        """The last fit, its columns with as few bits as still reach the SNR."""
        if self.fitted != (last.choice.tobytes(), self.reckoned.share):
            self._fit(last)
        reached = self.goal.snr_now(self.tree)
        if self.reckoned.packed and reached < snr and self.reckoned.share > FINEST_SHARE:
            self.reckoned.share = FINEST_SHARE  # these ranks, with more bits, may reach it
            self._fit(last)
            reached = self.goal.snr_now(self.tree)
        best, short = self.reckoned.share, inf
        for _ in range(SHARE_ATTEMPTS if self.reckoned.packed and snr + NEAR < reached < inf else 0):
            left = noise_at(snr + NEAR / 2 - reached) * (1 + self.reckoned.share)
            share = min(left - 1, (best * short) ** 0.5)
            saved = self.reckoned.numbers(last) / 16 * log2(max(share / best, 1.0))
            if share <= best or saved < WORTH * self.goal.file_bytes(self.tree):
                break
            self.reckoned.share = share
            self._fit(last)
            reached = self.goal.snr_now(self.tree)
            best, short = (share, short) if reached >= snr else (best, share)
            if snr <= reached <= snr + NEAR:
                break
        if self.reckoned.share != best:
            self.reckoned.share = best
            self._fit(last)

    def _refuse_more(self, chosen: Allocation, sure: float) -> None:
        """Give up a plan that takes so many times the bytes of another: what is fitted would not be kept."""
        nbytes, most = self.reckoned.nbytes(chosen), self.goal.most
        if nbytes > sure * most:
            allowed = f"at most {most:.0f}, which another plan takes"
            raise invalid("size-too-small", "bytes for the SNR", int(nbytes), allowed)

    def _fit(self, chosen: Allocation) -> None:
        self.fitted = chosen.choice.tobytes(), self.reckoned.share
        if isinstance(self.tree.residual, Streamed):
            give_back_freed_memory()  # of the fit before, which lies where large arrays of this one do not
        if isinstance(self.tree.residual, Streamed) and self.goal.memory is not None:
            what = f"a model of {format_bytes(int(chosen.nbytes))}"
            hint = "raise --max-memory, or ask for a lower SNR or fewer bytes"
            wide = max(chosen.nbytes, 2 * self.reckoned.numbers(chosen))  # float16, whatever the file has
            check_memory(PROCESS // 2 + int(MODEL * wide), what, hint, self.goal.memory)
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
        self.reckoned.learn(chosen, self.goal.file_bytes(self.tree))

    def _specs(self, chosen: Allocation) -> list[LevelSpec | None]:
        """Each node's chosen way and ranks."""
        specs: list[LevelSpec | None] = [None] * len(self.tree.levels[-1])
        for (s, choices), choice in zip(self.found, chosen.choice, strict=True):
            if choice:
                spec, _ = self.ways[int(choices.way[int(choice)])]
                specs[s] = _with_ranks(spec, choices.ranks[choice], self.reckoned.share)
        return specs

    def _within(self, size: float) -> Allocation:
        """The allocation whose file, tables and header counted exactly, is at most `size` bytes."""
        fitting, exact = None, 0
        for _ in range(4):
            chosen = allocate(self.spectra, nbytes=size - self.reckoned.beside)
            exact = self.goal.file_bytes(self._dressed(chosen))
            if exact <= size and (fitting is None or chosen.nbytes > fitting.nbytes):
                fitting = chosen
            self.reckoned.beside = exact - chosen.nbytes
        if len(self.tree.levels) == 1 and (fitting is None or not fitting.choice.any()):
            # A file in which nothing is stored would be no answer: one with the least that can be, or none.
            least = Allocation(np.ones(len(self.spectra), np.intp), 0.0, 0.0)
            exact = self.goal.file_bytes(self._dressed(least))
            fitting = least if exact <= size else None
        if fitting is None:
            allowed = f"at least {exact} bytes for this plan and organisation: {LEAST}"
            hint = "ask for more, merge axes or give a coarser plan"
            raise invalid("size-too-small", "size", f"{self.goal.size} bytes", allowed, hint)
        return fitting

    def _dressed(self, chosen: Allocation) -> Hierarchy:
        """The hierarchy as it will be shaped, its last level all zeros: enough to count bytes, at most."""
        last = [
            replace(node, cells=None if spec is None else zero_cells(node.sizes, replace(spec, own_bits=0.0)))
            for node, spec in zip(self.tree.levels[-1], self._specs(chosen), strict=True)
        ]
        return Hierarchy(self.tree.residual, [*self.tree.levels[:-1], last], self.tree.schemes)
