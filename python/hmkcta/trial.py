"""What a candidate plan would reach, judged on a sample of its blocks by the energies of their HOSVD cores."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import combinations
from math import inf, log2, prod

import numpy as np
from numpy.typing import NDArray

from .adaptive import summed, table_limits
from .allocation import Allocation, Spectrum, allocate, empty_node_bytes, node_bytes, spectrum
from .axes import Axis, Organisation, mode_sizes, organise
from .filesize import planned_bytes
from .hierarchy import squared_norm
from .memberships import uniform_blocks
from .metrics import snr_db
from .plan import LevelSpec, Plan
from .source import Source
from .tucker import Core, full_core

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

#: Worse than any number of bytes, in octaves.
OUT_OF_REACH = 1000.0
#: Elements looked at together where all are.
SLAB = 1 << 20
#: Modes up to this length are left undecomposed on trial if their rank takes this share of their rows.
LONGEST_UNDECOMPOSED, NEARLY_FULL = 128, 0.25


@dataclass(frozen=True)
class Candidate:
    """A way to build the model.

    Attributes:
        organisation: of axes into modes.
        grid: number of blocks along each source axis.
        undecomposed: mode numbers.
        carried: the blocks are nodes with ranks of their own below a first level of rank one; else they are the
            cells of a single level, all of the same ranks.
    """

    organisation: Organisation
    grid: tuple[int, ...]
    undecomposed: tuple[int, ...] = ()
    carried: bool = True


@dataclass(frozen=True, eq=False)
class Block:
    """A block of the source: its values, thinned where it is large; its true axes and those of the thinned values."""

    values: NDArray[np.float32]
    axes: tuple[Axis, ...]
    thinned: tuple[Axis, ...]


@dataclass(eq=False)
class _Part:
    """A sampled tensor, its squared norm, its true mode sizes, and its core once that is known."""

    tensor: F32
    energy: float
    sizes: tuple[int, ...]
    core: Core | None = None


@dataclass(frozen=True, eq=False)
class _Cut:
    """An organisation cut by a grid: sampled tensors, whether they are thinned, their share of all elements, the mode
    sizes and numbers of blocks of the whole, and how many threads may work on it."""

    organisation: Organisation
    grid: tuple[int, ...]
    parts: list[_Part]
    thinned: bool
    share: float
    sizes: tuple[int, ...]
    clusters: tuple[int, ...]
    threads: int


@dataclass(frozen=True, eq=False)
class Trial:
    """The data and the goal: bytes (`size`) or a squared `error`, within a decode cost.

    Bytes are not spent beyond a `ceiling` in dB: what reaches it is worth the more, the fewer bytes it takes. Error and
    ceiling are of the transformed values.
    """

    source: Source
    error: float | None
    size: int | None
    ceiling: float | None
    decode_cost: int
    seed: int

    def worths(
        self, organisation: Organisation, grid: tuple[int, ...], sample: int, threads: int = 1
    ) -> list[tuple[float, Candidate]]:
        """Every candidate with this organisation and grid: dB at the goal's bytes, or minus octaves of bytes."""
        cut = _cut(self, organisation, grid, sample, threads)
        if not cut.parts:
            return []
        found, ranks = self._judged(cut, ())
        best, helpful = _best(found), list[int]()
        for n in _promising(cut, ranks):
            alone = self._judged(cut, (n,))[0]
            helpful += [n] if _best(alone) > best else []
            found += alone
        for pair in combinations(helpful, 2):
            if len(pair) < len(cut.sizes):
                found += self._judged(cut, pair)[0]
        return found

    def _judged(self, cut: _Cut, choice: tuple[int, ...]) -> tuple[list[tuple[float, Candidate]], list[int]]:
        """Candidates that leave the chosen modes undecomposed, and the ranks of the one without blocks."""
        order, tables = len(cut.sizes), self._tables(cut, choice)
        flags = [n in choice for n in range(order)]
        energy = sum(part.energy for part in cut.parts) / cut.share
        table = summed(tables) / cut.share
        whole = spectrum(table, energy, cut.sizes, flags, self.decode_cost, cut.clusters, hull=False)
        one = Candidate(cut.organisation, cut.grid, choice, carried=False)
        worth, chosen = self._worth([whole], 1.0, self._beside(one, cut), single=True)
        found = [(worth, one)]
        ranks = [max(1, int(rank)) for rank in whole.ranks[chosen.choice[0]]]
        if prod(cut.clusters) > 1 and self.decode_cost > 1:
            nodes = [
                spectrum(table, part.energy, part.sizes, flags, self.decode_cost - 1)
                for table, part in zip(tables, cut.parts, strict=True)
            ]
            many = Candidate(cut.organisation, cut.grid, choice)
            found.append((self._worth(nodes, cut.share, self._beside(many, cut))[0], many))
        return found, ranks

    def _beside(self, candidate: Candidate, cut: _Cut) -> float:
        """Bytes of the candidate's file besides what `spectrum` counts of its nodes: exactly, but for digits."""
        whole = planned_bytes(plan_of(self.source, candidate, None, None, 1), self.source, seed=self.seed)
        flags = [n in candidate.undecomposed for n in range(len(cut.sizes))]
        ranks = np.where(flags, cut.sizes, 1).astype(np.int32)
        if not candidate.carried:
            return whole - float(node_bytes(cut.sizes, ranks, flags, cut.clusters))
        nodes, stored = prod(cut.clusters), [n for n, flag in enumerate(flags) if not flag]
        rows = sum(cut.sizes[n] * nodes // cut.clusters[n] for n in stored)
        each = 2.0 * float(np.prod(ranks, dtype=np.float64)) + 4 + empty_node_bytes(len(ranks), len(stored))
        return whole - nodes * each - 4 * rows

    def _tables(self, cut: _Cut, choice: tuple[int, ...]) -> list[F64]:
        """Energies of the HOSVD cores of the cut's tensors, summed along the modes left undecomposed."""

        def table(part: _Part) -> F64:
            ranks = tuple(None if n in choice else size for n, size in enumerate(part.tensor.shape))
            ones = (1,) * part.tensor.ndim
            limits = table_limits(part.tensor.shape, LevelSpec(ranks, ones, ones), self.size or inf, part.sizes)
            if part.core is None:
                part.core = full_core(part.tensor, limits, np.random.default_rng(self.seed))
            whole = all(part.core.complete[n] for n in choice)
            core = part.core if whole else full_core(part.tensor, limits, np.random.default_rng(self.seed))
            return core.energies(limits)

        with ThreadPoolExecutor(cut.threads) as pool:
            return list(pool.map(table, cut.parts))

    def _worth(
        self, spectra: Sequence[Spectrum], share: float, fixed: float, *, single: bool = False
    ) -> tuple[float, Allocation]:
        energy = sum(float(s.error[0]) for s in spectra)
        if self.size is not None:
            chosen = allocate(spectra, nbytes=max(self.size - fixed, 0) * share)
            least = fixed + sum(float(s.nbytes[int(single)]) for s in spectra) / share
            if least > self.size:  # after all that fit, the smallest first
                return -OUT_OF_REACH - log2(least), chosen
            worth = decibels(energy, chosen.error)
            if self.ceiling is None or worth <= self.ceiling:
                return worth, chosen
            chosen = allocate(spectra, error=energy * 10 ** (-self.ceiling / 10))
            return self.ceiling + log2(self.size / (chosen.nbytes / share + fixed)), chosen
        assert self.error is not None
        error = self.error * share
        chosen = allocate(spectra, error=error)
        short = max(0.0, decibels(chosen.error, error))
        # Candidates that cannot reach the goal come after all that can, the nearest first.
        return -OUT_OF_REACH - short if short > 0.01 else -log2(chosen.nbytes / share + fixed), chosen


def trial_of(
    source: Source, snr: float | None, size: int | None, ceiling: float | None, decode_cost: int, seed: int
) -> Trial:
    """The trial of a goal whose dB are those of the source's values.

    A value transform stretches errors by its inverse's slope, so that as many dB of transformed values are others.
    """
    signal = energy = slopes = 0.0
    transform, unit = source.value_transform, np.float64(source.unit)
    for part in source.parts(SLAB):
        values = source.values(part).astype(np.float64)
        energy += float(np.square(values).sum())
        if transform.name != "identity":
            step = 1e-4
            higher, lower = (transform.inverse(unit * (values + by)) for by in (step, -step))
            slopes += float(np.square((higher - lower) / (2 * step)).sum())
            signal += float(np.square(transform.inverse(unit * values)).sum())
    # Squared errors of transformed values, times this, are those of the source's values.
    stretch = 1.0 if transform.name == "identity" else max(slopes / prod(source.shape), 1e-300)
    signal = energy if transform.name == "identity" else signal
    error = None if snr is None else signal / stretch * 10 ** (-snr / 10)
    higher_by = decibels(energy, signal / stretch) if energy else 0.0
    return Trial(source, error, size, None if ceiling is None else ceiling + higher_by, decode_cost, seed)


def decibels(signal: float, error: float) -> float:
    """SNR, bounded by what float32 can tell."""
    return snr_db(max(signal, 1e-300), max(error, 1e-14 * signal, 1e-300))


def _cut(trial: Trial, organisation: Organisation, grid: tuple[int, ...], sample: int, threads: int) -> _Cut:
    """Sampled blocks of the grid as tensors of the organisation's modes; blocks of zeros are left out."""
    source, parts, seen, thinned = trial.source, list[_Part](), 0, False
    for block in _sample_blocks(source, grid, sample, trial.seed):
        elements = prod(axis.size for axis in block.axes)
        seen += elements
        thinned |= block.values.size < elements
        tensor = np.ascontiguousarray(organise(block.values, block.thinned, organisation))
        energy = squared_norm(tensor)
        if energy > 0:
            parts.append(_Part(tensor, energy, mode_sizes(block.axes, organisation)))
    counts = {axis.name: count for axis, count in zip(source.axes, grid, strict=True)}
    clusters = tuple(prod(counts[name] for name in mode) for mode in organisation)
    sizes = mode_sizes(source.axes, organisation)
    return _Cut(organisation, grid, parts, thinned, seen / prod(source.shape), sizes, clusters, threads)


def _best(found: Sequence[tuple[float, Candidate]]) -> float:
    return max(worth for worth, _ in found)


def _promising(cut: _Cut, ranks: Sequence[int]) -> Iterator[int]:
    """Modes without blocks that may be better left undecomposed than given the ranks of an HOSVD.

    Short ones that keep much of their rank, which frees multiply-adds for other modes; and those whose rows times the
    other ranks are hardly more numbers than their basis takes: one mode of every matrix.
    """
    others = prod(ranks)
    for n, (size, clusters, rank) in enumerate(zip(cut.sizes, cut.clusters, ranks, strict=True)):
        if clusters > 1 or (size == 1 and len(cut.sizes) > 1):
            continue
        core, basis = size * (others // rank), size * (rank + 1)
        # Thinned blocks flatter it: few numbers are left for each of the mode's rows.
        short = not cut.thinned and size <= LONGEST_UNDECOMPOSED and rank >= NEARLY_FULL * size
        if (short and len(cut.sizes) > 1) or core <= basis + others:
            yield n


def _sample_blocks(source: Source, grid: tuple[int, ...], sample: int, seed: int) -> Iterator[Block]:
    """Blocks of the grid, spread by chance, until the sample is used up; a block beyond the sample is thinned."""
    rng = np.random.default_rng([seed, *grid])
    number, elements = prod(grid), prod(source.shape)
    # Few large blocks would be chance: at least four, thinned.
    wanted = int(min(number, max(4, round(sample * number / elements))))
    for flat in sorted(int(block) for block in rng.permutation(number)[:wanted]):
        place = _unravelled(flat, grid)
        rows = [
            np.flatnonzero(uniform_blocks(length, count) == index)
            for index, count, length in zip(place, grid, source.shape, strict=True)
        ]
        lengths = [len(r) for r in rows]
        steps = _thinning(lengths, 2 * sample // wanted)
        part = tuple(slice(int(r[0]), int(r[-1]) + 1, step) for r, step in zip(rows, steps, strict=True))
        values = source.values(part)
        yield Block(values, _resized(source.axes, lengths), _resized(source.axes, values.shape))


def _unravelled(flat: int, grid: Sequence[int]) -> list[int]:
    """Block indices along each axis of the flat-th block in C order."""
    place: list[int] = []
    for count in reversed(grid):
        flat, index = divmod(flat, count)
        place.insert(0, index)
    return place


def _thinning(lengths: Sequence[int], limit: int) -> list[int]:
    """Steps along each axis that leave about `limit` elements, the longest axes thinned first."""
    steps = [1] * len(lengths)
    while prod(-(-length // step) for length, step in zip(lengths, steps, strict=True)) > limit:
        steps[max(range(len(lengths)), key=lambda n: lengths[n] / steps[n])] += 1
    return steps


def _resized(axes: Sequence[Axis], sizes: Sequence[int]) -> tuple[Axis, ...]:
    return tuple(Axis(axis.name, int(size), axis.role) for axis, size in zip(axes, sizes, strict=True))


def plan_of(source: Source, best: Candidate, snr: float | None, size: int | None, decode_cost: int) -> Plan:
    """The candidate as a plan: blocks are cells of one level, or nodes below a first level of rank one."""
    sizes = mode_sizes(source.axes, best.organisation)
    ones = (1,) * len(sizes)
    grid = tuple((axis.name, count) for axis, count in zip(source.axes, best.grid, strict=True) if count > 1)
    counts = dict(grid)
    clusters = tuple(prod(counts.get(name, 1) for name in mode) for mode in best.organisation)
    most = tuple(None if n in best.undecomposed else min(i, decode_cost, 1024) for n, i in enumerate(sizes))
    if not grid:
        return Plan(best.organisation, (LevelSpec(most, ones, ones, own=True),), snr, size)
    if not best.carried:
        return Plan(best.organisation, (LevelSpec(most, clusters, ones, "most", grid, own=True),), snr, size)
    carrier = LevelSpec(tuple(None if rank is None else 1 for rank in most), clusters, ones, "most", grid)
    return Plan(best.organisation, (carrier, LevelSpec(most, ones, ones, own=True)), snr, size)
