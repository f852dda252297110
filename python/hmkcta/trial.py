"""What a candidate plan would reach, judged on a sample of its blocks by the energies of their HOSVD cores."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations, product
from math import log2, log10, prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .allocation import Choices, best_of_one, choices_of, empty_node_bytes, node_bytes, pareto, plausible, ration
from .axes import Axis, Organisation, mode_sizes
from .blocks import Blocks, finer, halved, organised, sampled_blocks, split
from .filesize import planned_bytes
from .growth import Growth, growth_of
from .metrics import snr_db
from .plan import MOST_RANKS, LevelSpec, Plan
from .source import Source
from .spectra import captured, cores, energies, ladders

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Sets of modes left undecomposed.
Kinds = tuple[tuple[int, ...], ...]

#: Worse than any number of bytes, in octaves.
OUT_OF_REACH = 1000.0
#: Elements looked at together where all are, and of a source that is held in memory.
SLAB, HELD = 1 << 20, 1 << 23
#: Modes up to this length are left undecomposed on trial if their rank takes this share of their rows.
LONGEST_UNDECOMPOSED, NEARLY_FULL = 128, 0.2
#: Of modes that are better left undecomposed, so many are tried in pairs.
TOGETHER = 3
#: Highest rank looked at, of matrices and of tensors.
HIGHEST = (MOST_RANKS, 64)
#: What float16 leaves, as a share of the energy, at the most; errors below it are not told apart.
VERBATIM = 1e-7
#: Beyond so many dB Gram matrices are summed in float64.
PRECISE = 50.0
#: Bytes besides two float16 for each element, that no candidate worth a look takes.
ENOUGH = 1 << 16


@dataclass(frozen=True)
class Candidate:
    """A way to build the model.

    Attributes:
        organisation: of axes into modes.
        grid: number of blocks along each source axis.
        undecomposed: mode numbers.
        carried: the blocks are nodes with ranks of their own below a first level of rank one; else they are the
            cells of a single level, all of the same ranks.
        cuts: carried blocks may each be cut into so many, or a divisor of it, along each source axis; (): they are not.
        clusters: of the data along each mode, in the place of blocks, the cells of a single level; (): none.
    """

    organisation: Organisation
    grid: tuple[int, ...]
    undecomposed: tuple[int, ...] = ()
    carried: bool = True
    cuts: tuple[int, ...] = ()
    clusters: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class _Cut:
    """An organisation of axes cut by a grid.

    Attributes:
        batch: the sampled blocks as tensors, `[B, modes]`; with `energy`, their squared norms.
        edges: mode sizes of a block before thinning.
        sizes: mode sizes of the whole.
        clusters: numbers of blocks along each mode.
        precision: what Gram matrices are summed in.
    """

    axes: Sequence[Axis]
    organisation: Organisation
    grid: tuple[int, ...]
    blocks: Blocks
    batch: F32
    energy: F64
    limits: tuple[int, ...]
    edges: tuple[int, ...]
    sizes: tuple[int, ...]
    clusters: tuple[int, ...]
    precision: Any

    @cached_property
    def core(self) -> F32:
        """Their truncated HOSVD cores, no mode shorter than its entry of `limits`."""
        return cores(self.batch, self.limits, self.precision)

    @cached_property
    def growth(self) -> Growth | None:
        """What ranks of whole blocks are told by; None where no rows were left out."""
        return self.growth_of(self.batch, self.core, (1,) * len(self.grid), self.edges)

    def growth_of(self, parts: F32, core: F32, way: Sequence[int], edges: Sequence[int]) -> Growth | None:
        """The same of the blocks cut into so many `parts` along each axis, by their cores and rows."""
        if not self.blocks.thinned:
            return None
        fewer = organised(split(halved(self.blocks), way), self.axes, self.organisation)
        return growth_of(parts, core, fewer, edges, self.precision)


@dataclass(frozen=True, eq=False)
class Trial:
    """The data and the goal: as many dB as `size` bytes and a decode cost allow.

    Bytes are not spent beyond a `ceiling` in dB of the transformed values, which is how an SNR is a goal: what reaches
    it is worth the more, the fewer bytes it takes, an octave as much as a dB. `values` are the source's, if held.
    """

    source: Source
    values: F32 | None
    size: int
    ceiling: float | None
    decode_cost: int
    seed: int

    @cached_property
    def _ways(self) -> dict[Any, tuple[F64, F64]]:
        """What `_way` found before."""
        return {}

    def worths(
        self, organisation: Organisation, grid: tuple[int, ...], sample: int, kinds: Kinds = ()
    ) -> list[tuple[float, Candidate]]:
        """Every candidate with this organisation and grid: dB, and octaves of bytes beyond the ceiling.

        Of `kinds`, if any, only those that leave one of these sets of modes undecomposed.
        """
        cut = self._cut(organisation, grid, sample)
        if not cut.energy.any():
            return []
        possible = [kind for kind in kinds if all(cut.clusters[n] == 1 for n in kind)]
        if possible:
            return [each for kind in possible for each in self._judged(cut, kind)[0]]
        found, ranks = self._judged(cut, ())
        best, alone = _best(found), {n: self._judged(cut, (n,))[0] for n in _promising(cut, ranks)}
        helpful = sorted((n for n in alone if _best(alone[n]) > best), key=lambda n: -_best(alone[n]))[:TOGETHER]
        pairs = [pair for pair in combinations(sorted(helpful), 2) if len(pair) < len(cut.sizes)]
        for judged in (*alone.values(), *(self._judged(cut, pair)[0] for pair in pairs)):
            found += judged
        return found

    def verbatim(self, organisation: Organisation) -> tuple[float, Candidate]:
        """All values as float16: two bytes each for an SNR of about 73 dB, whatever they are."""
        every = tuple(range(len(organisation)))
        candidate = Candidate(organisation, (1,) * len(self.source.shape), every, carried=False)
        nbytes = planned_bytes(plan_of(self.source, candidate, None, None, 1), self.source, seed=self.seed)
        if nbytes > self.size:
            return -OUT_OF_REACH - log2(nbytes), candidate
        reached = -10 * log10(VERBATIM)
        if self.ceiling is None or reached <= self.ceiling:
            return reached, candidate
        return self.ceiling + log2(self.size / nbytes), candidate

    def worth(self, candidate: Candidate, sample: int, around: tuple[int, ...]) -> float:
        """What a carried candidate is worth whose blocks may be cut further, each as pays.

        The sample is of blocks of the grid `around`, of which its own are parts: candidates are compared on one.
        """
        organisation = candidate.organisation
        blocks = sampled_blocks(self.source, self.values, around, sample, self.seed)
        cut = self._cut_of(organisation, candidate.grid, finer(blocks, around, candidate.grid))
        flags = tuple(n in candidate.undecomposed for n in range(len(cut.sizes)))
        found: list[tuple[F64, F64]] = []
        for way in product(*map(_divisors, candidate.cuts)):
            key = (organisation, candidate.grid, flags, way, sample, around)
            if key not in self._ways:
                self._ways[key] = self._way(cut, flags, way)
            found.append(self._ways[key])
        errors = np.concatenate([left for left, _ in found], axis=1)
        nbytes = np.concatenate([own for _, own in found])
        order = np.argsort(nbytes, kind="stable")
        path = partial(ration, errors[:, order], nbytes[order])
        least = float(nbytes.min()) * len(errors)
        return self._worth(path, cut, cut.blocks.elements, candidate, least)[0]

    def _way(self, cut: _Cut, flags: tuple[bool, ...], way: Sequence[int]) -> tuple[F64, F64]:
        """Error that each block is left with and bytes, at every choice of ranks, if all are cut in the same way."""
        axes, clusters = self.source.axes, _clusters(self.source.axes, way, cut.organisation)
        parts = organised(split(cut.blocks.values, way), axes, cut.organisation)
        edges = tuple(-(-edge // count) for edge, count in zip(cut.edges, clusters, strict=True))
        limits = self._limits(parts.shape[1:], edges)
        ladder = tuple(ladders([1 if flag else limit for flag, limit in zip(flags, limits, strict=True)], len(parts)))
        chosen = [None if flag else limit for flag, limit in zip(flags, limits, strict=True)]
        steps = [None if flag else own for flag, own in zip(flags, ladder, strict=True)]
        core = cores(parts, chosen, self._precision)
        energy, table, growth = energies(parts), captured(core, steps), cut.growth_of(parts, core, way, edges)
        meant = ladder if growth is None else growth.unthinned(ladder)
        choices = choices_of(meant, cut.edges, flags, max(1, self.decode_cost - 1), clusters)
        together = (len(cut.batch), prod(way), -1)
        left = _left(energy.reshape(together).sum(axis=(1, 2)), table.reshape(together).sum(axis=1), choices)
        # Parts of a block share a row where it is no multiple of theirs.
        left *= cut.energy.sum() / max(energy.sum(), 1e-300)
        kept = plausible(left)
        return left[:, kept], choices.nbytes[kept]

    def _cut(self, organisation: Organisation, grid: tuple[int, ...], sample: int) -> _Cut:
        """Sampled blocks of the grid as tensors of the organisation's modes."""
        return self._cut_of(organisation, grid, sampled_blocks(self.source, self.values, grid, sample, self.seed))

    def _cut_of(self, organisation: Organisation, grid: tuple[int, ...], blocks: Blocks) -> _Cut:
        """Blocks as tensors of the organisation's modes."""
        axes = self.source.axes
        batch = organised(blocks.values, axes, organisation)
        clusters = _clusters(axes, grid, organisation)
        sizes = mode_sizes(axes, organisation)
        rows = dict(zip((axis.name for axis in axes), blocks.edges, strict=True))
        edges = tuple(prod(rows[name] for name in mode) for mode in organisation)
        limits = self._limits(batch.shape[1:], edges)
        return _Cut(
            axes, organisation, grid, blocks, batch, energies(batch), limits, edges, sizes, clusters, self._precision
        )

    def _limits(self, have: Sequence[int], edges: Sequence[int]) -> tuple[int, ...]:
        """Highest rank of each mode: what there is, what the bytes can store, what may be decoded."""
        elements = prod(float(rows) for rows in have)
        most = min(self.decode_cost, HIGHEST[len(have) > 2])
        return tuple(
            int(max(1, min(rows, elements // rows, most, self.size // (2 * edge) + 1)))
            for rows, edge in zip(have, edges, strict=True)
        )

    @property
    def _precision(self) -> Any:
        """What Gram matrices are summed in: a high SNR asks small singular values to be told apart."""
        return np.float64 if self.ceiling is not None and self.ceiling > PRECISE else np.float32

    def _judged(self, cut: _Cut, choice: tuple[int, ...]) -> tuple[list[tuple[float, Candidate]], list[int]]:
        """Candidates that leave the chosen modes undecomposed, and the ranks of the one without blocks."""
        order = len(cut.sizes)
        flags = tuple(n in choice for n in range(order))
        most = [1 if flag else limit for flag, limit in zip(flags, cut.limits, strict=True)]
        kept = tuple(ladders(most, len(cut.batch)))
        steps = [None if flag else own for flag, own in zip(flags, kept, strict=True)]
        table = captured(self._core(cut, flags), steps).reshape(len(cut.batch), -1)
        one = Candidate(cut.organisation, cut.grid, choice, carried=False)
        meant = kept if cut.growth is None else cut.growth.unthinned(kept)
        whole = choices_of(meant, cut.sizes, flags, self.decode_cost, cut.clusters)
        left = _left(cut.energy.sum(keepdims=True), table.sum(axis=0, keepdims=True), whole)[0]
        nbytes = whole.nbytes * cut.blocks.share
        best = pareto(nbytes, left)
        path = partial(best_of_one, nbytes[best], left[best])
        worth, spent = self._worth(path, cut, cut.blocks.share, one, float(nbytes[1]))
        ranks = whole.ranks[best][max(1, int(np.searchsorted(nbytes[best], spent, side="right")) - 1)]
        found = [(worth, one)]
        if prod(cut.clusters) > 1 and self.decode_cost > 1:
            many = replace(one, carried=True)
            nodes = choices_of(meant, cut.edges, flags, self.decode_cost - 1, (1,) * order)
            path = partial(ration, _left(cut.energy, table, nodes), nodes.nbytes)
            least = float(nodes.nbytes[0]) * len(table)
            found.append((self._worth(path, cut, cut.blocks.elements, many, least)[0], many))
        return found, [int(rank) for rank in ranks]

    def _core(self, cut: _Cut, flags: Sequence[bool]) -> F32:
        """Cores with all energy along the modes left undecomposed."""
        had = zip(flags, cut.batch.shape[1:], cut.limits, strict=True)
        if all(not flag or rows == limit for flag, rows, limit in had):
            return cut.core
        limits = [None if flag else limit for flag, limit in zip(flags, cut.limits, strict=True)]
        return cores(cut.batch, limits, self._precision)

    def _worth(
        self, spend: Callable[..., tuple[float, float]], cut: _Cut, share: float, candidate: Candidate, least: float
    ) -> tuple[float, float]:
        fixed = self.beside(candidate, cut.sizes, cut.clusters)
        return self.worth_of(spend, float(cut.energy.sum()), share, fixed, least)

    def worth_of(
        self, spend: Callable[..., tuple[float, float]], energy: float, share: float, fixed: float, least: float
    ) -> tuple[float, float]:
        """What bytes and error make a candidate worth, and the bytes spent on the blocks of the sample.

        Args:
            spend: bytes and error of these blocks, for a `limit` of bytes or an `error`.
            energy: their squared norm.
            share: what part of the whole they stand for.
            fixed: bytes of the whole beside the blocks.
            least: bytes of the sample's blocks at the least.
        """
        if (needed := fixed + least / share) > self.size:  # after all that fit, the smallest first
            return -OUT_OF_REACH - log2(needed), least
        spent, error = spend(limit=(self.size - fixed) * share)
        worth = decibels(energy, error)
        if self.ceiling is None or worth <= self.ceiling:
            return worth, spent
        spent, _ = spend(error=energy * 10 ** (-self.ceiling / 10))
        return self.ceiling + log2(self.size / (spent / share + fixed)), spent

    def beside(self, candidate: Candidate, sizes: Sequence[int], clusters: Sequence[int]) -> float:
        """Bytes of the candidate's file besides what `choices_of` counts of its nodes: exactly, but for digits."""
        whole = planned_bytes(plan_of(self.source, candidate, None, None, 1), self.source, seed=self.seed)
        flags = [n in candidate.undecomposed for n in range(len(sizes))]
        ranks = np.where(flags, sizes, 1).astype(np.int32)
        if not candidate.carried:
            return whole - float(node_bytes(sizes, ranks, flags, clusters))
        nodes, stored = prod(clusters), [n for n, flag in enumerate(flags) if not flag]
        rows = sum(sizes[n] * nodes // clusters[n] for n in stored)
        each = 2.0 * float(np.prod(ranks, dtype=np.float64)) + 4 + empty_node_bytes(len(ranks), len(stored))
        return whole - nodes * each - 4 * rows


def trial_of(
    source: Source, size: int | None, ceiling: float | None, decode_cost: int, seed: int
) -> Trial:
    """The trial of a goal whose dB are those of the source's values; without a `size` all that anything may need.

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
    higher_by = decibels(energy, signal / stretch) if energy else 0.0
    ceiling = None if ceiling is None else ceiling + higher_by
    held = source.values() if prod(source.shape) <= HELD else None
    return Trial(source, held, size or 4 * prod(source.shape) + ENOUGH, ceiling, decode_cost, seed)


def decibels(signal: float, error: float) -> float:
    """SNR, bounded by what float32 can tell."""
    return snr_db(max(signal, 1e-300), max(error, 1e-14 * signal, 1e-300))


def _left(energy: F64, table: F64, choices: Choices) -> F64:
    """Squared error of each block by each choice, `[B, choices]`, the first of which is to store nothing."""
    whole = energy[:, None]
    return np.concatenate([whole, np.maximum(whole - table[:, choices.entry], VERBATIM * whole)], axis=1)


def _clusters(axes: Sequence[Axis], counts: Sequence[int], organisation: Organisation) -> tuple[int, ...]:
    """Blocks along each mode, of the counts along each axis."""
    of = {axis.name: count for axis, count in zip(axes, counts, strict=True)}
    return tuple(prod(of[name] for name in mode) for mode in organisation)


def _divisors(most: int) -> list[int]:
    return [count for count in range(1, most + 1) if most % count == 0]


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
        short = size <= LONGEST_UNDECOMPOSED and rank >= NEARLY_FULL * size
        if (short and len(cut.sizes) > 1) or core <= basis + others:
            yield n


def plan_of(source: Source, best: Candidate, snr: float | None, size: int | None, decode_cost: int) -> Plan:
    """The candidate as a plan: blocks are cells of one level, or nodes below a first level of rank one."""
    sizes = mode_sizes(source.axes, best.organisation)
    ones = (1,) * len(sizes)
    grid = tuple((axis.name, count) for axis, count in zip(source.axes, best.grid, strict=True) if count > 1)
    clusters = _clusters(source.axes, best.grid, best.organisation)
    most = tuple(None if n in best.undecomposed else min(i, decode_cost, MOST_RANKS) for n, i in enumerate(sizes))
    if not grid:
        return Plan(best.organisation, (LevelSpec(most, best.clusters or ones, ones, own=True),), snr, size)
    if not best.carried:
        return Plan(best.organisation, (LevelSpec(most, clusters, ones, "most", grid, own=True),), snr, size)
    carrier = LevelSpec(tuple(None if rank is None else 1 for rank in most), clusters, ones, "most", grid)
    cuts = tuple((axis.name, count) for axis, count in zip(source.axes, best.cuts, strict=False) if count > 1)
    return Plan(best.organisation, (carrier, LevelSpec(most, ones, ones, own=True, cuts=cuts)), snr, size)
