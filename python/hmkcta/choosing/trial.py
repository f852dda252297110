"""What a candidate plan would reach, judged on a sample of its blocks by the energies of their HOSVD cores."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations, product
from math import inf, log2, log10, prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import Organisation, mode_sizes
from ..filesize import planned_bytes
from ..grids import divisors
from ..metrics import noise_at, snr_db
from ..parameters import LEFT
from ..plan import MOST_RANKS_ALONE
from ..ranks.allocation import Choices, best_of_one, choices_of, pareto, plausible, ration, stored_bits
from ..streaming.budget import is_precise
from ..streaming.source import Source
from ..support.executors import in_order
from .blocks import Blocks, Samples, organised, parts_of, samples_of, split
from .candidates import Candidate, Scored, bytes_beside, clusters_of, plan_of
from .caps import Ranks, Room, capped
from .cut import Cut
from .growth import Growth
from .spectra import Ladder, Values, captured, cores, energies, ladders

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
#: Sets of modes left undecomposed.
Kinds = tuple[tuple[int, ...], ...]
#: Bytes and error of a sample's blocks, for a `limit` of bytes or an `error`.
Spend = Callable[..., tuple[float, float]]

#: Worse than any number of bytes, in octaves.
OUT_OF_REACH = 1000.0
#: Elements looked at together where all are.
SLAB = 1 << 20
#: Elements of samples that are kept for the next candidates, where memory sets no bounds.
KEPT = 1 << 21
#: Modes up to this length are left undecomposed on trial if their rank takes this share of their rows.
LONGEST_UNDECOMPOSED, NEARLY_FULL = 128, 0.2
#: Of modes that are better left undecomposed, so many are tried in pairs.
TOGETHER = 3
#: A block takes no more than so many times its share of the bytes.
MOST_OF_ONE = 4
#: Highest rank looked at, of matrices and of tensors.
HIGHEST = (MOST_RANKS_ALONE, 64)
#: What float16 leaves, as a share of the energy, at the most; errors below it are not told apart, unless a goal asks.
VERBATIM = 1e-7
#: So many dB more energy than its share a sample may have.
LOUDER = 10.0
#: What float32 can tell; and of the error that a goal leaves, the share from which on ranks are not told apart.
FINEST, UNTOLD = 1e-14, 0.05
#: What numbers of so many bits leave by themselves, as a share of what their level is to hold, which is little where a
#: first level of rank one, of float16 numbers, takes most of the energy.
ROUNDING = {16: 0.0, 8: LEFT}
#: The same where no mode is decomposed, so that a number has a byte; and what bytes leave of the values, in dB.
BYTES, VERBATIM_8_BITS = 8e-5, 36.0
#: Bytes besides two float16 for each element, that no candidate worth a look takes.
ENOUGH = 1 << 16


@dataclass(frozen=True, eq=False)
class Trial:
    """The data and the goal, by which candidates are judged: what each is *worth*.

    That is the SNR in dB that it reaches with `size` bytes, up to the `ceiling`. What reaches the ceiling is worth that
    many dB, and one more for each time that its bytes could be halved (an octave): so an SNR is a goal, too.

    Attributes:
        source, samples, energy: the array, samples of its blocks, and its squared norm.
        size, bits: most bytes of the file, and bits of each number in it.
        ceiling: SNR in dB, of the transformed values, beyond which no bytes are spent; None: there is none.
        decode_cost: most multiply-adds for one element.
        room, memory: most elements of a sample, and what the fit may take (None: that sets no bounds).
    """

    source: Source
    size: int
    ceiling: float | None
    decode_cost: int
    seed: int
    samples: Samples
    energy: float
    room: float = inf
    memory: Room | None = None
    bits: int = 16
    #: What `_way` found before.
    _ways: dict[Any, tuple[F64, F64]] = field(init=False, default_factory=dict[Any, tuple[F64, F64]])

    @property
    def floor(self) -> float:
        """Errors below this share of the energy are not told apart: what reaches a goal is, by its bytes."""
        beyond = 0.0 if self.ceiling is None else self.ceiling + LOUDER
        return max(FINEST, min(VERBATIM, noise_at(beyond)))

    def bytes_of(self, worth: float) -> int | None:
        """Bytes that what is worth so much takes; None where it does not reach a ceiling."""
        if self.ceiling is None or worth < self.ceiling:
            return None
        return int(self.size * 2 ** (self.ceiling - worth))

    def worths(
        self, organisation: Organisation, grid: tuple[int, ...], sample: int, kinds: Kinds = ()
    ) -> list[Scored]:
        """Every candidate with this organisation and grid, and what it is worth, on about so many sampled elements.

        With `kinds` only those that leave one of these sets of modes undecomposed, if the grid cuts none of its modes.
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

    def verbatim(self, organisation: Organisation) -> Scored:
        """All values as float16: two bytes each for an SNR of about 73 dB, whatever they are; or a byte for 36 dB."""
        every = tuple(range(len(organisation)))
        bits = self.bits if self.ceiling is not None and self.ceiling <= VERBATIM_8_BITS else 16
        candidate = Candidate(organisation, (1,) * len(self.source.shape), every, carried=False, bits=bits)
        nbytes = planned_bytes(plan_of(self.source, candidate, None, None, 1), self.source, seed=self.seed)
        if nbytes > self.size:
            return Scored(-OUT_OF_REACH - log2(nbytes), candidate)
        if self._caps(candidate) is None or (self.memory is not None and not self.memory.holds(nbytes)):
            return Scored(_too_large(self.source.shape), candidate)
        reached = -10 * log10(VERBATIM) if bits == 16 else VERBATIM_8_BITS
        if self.ceiling is None or reached <= self.ceiling:
            return Scored(reached, candidate)
        return Scored(self.ceiling + log2(self.size / nbytes), candidate)

    def worth(self, candidate: Candidate, sample: int, around: tuple[int, ...], workers: int = 1) -> float:
        """What a carried candidate is worth whose blocks may each be cut further, as pays; by so many threads.

        The sample is of blocks of the grid `around`, of which its own are parts: candidates are compared on one.
        """
        organisation = candidate.organisation
        blocks = parts_of(self._blocks(around, sample), around, candidate.grid)
        cut = self._cut_of(organisation, candidate.grid, blocks)
        caps = self._caps(candidate)
        if caps is None:
            return _too_large(cut.edges)
        flags = tuple(n in candidate.undecomposed for n in range(len(cut.sizes)))
        key = (organisation, candidate.grid, flags, sample, around)
        ways = list(product(*map(divisors, candidate.cuts)))
        new = [way for way in ways if (key, way) not in self._ways]
        for way, made in zip(new, in_order(partial(self._way, cut, flags, caps), new, workers), strict=True):
            self._ways[key, way] = made
        found = [self._ways[key, way] for way in ways]
        errors = np.concatenate([left for left, _ in found], axis=1)
        nbytes = np.concatenate([own for _, own in found])
        order = np.argsort(nbytes, kind="stable")
        errors, nbytes, weights = errors[:, order], nbytes[order], cut.blocks.weights
        path, below = partial(ration, errors, nbytes, weights), _left_by_one(found[0][0], weights)
        return self._worth(path, cut, cut.blocks.overlap, candidate, float(nbytes[0] * weights.sum()), below)[0]

    def _way(self, cut: Cut, flags: tuple[bool, ...], caps: Ranks, way: Sequence[int]) -> tuple[F64, F64]:
        """For every choice of ranks the error left in each block, and its bytes, if all blocks are cut in this way."""
        axes, clusters = self.source.axes, clusters_of(self.source.axes, way, cut.organisation)
        parts = organised(split(cut.blocks.values, way), axes, cut.organisation)
        edges = tuple(-(-edge // count) for edge, count in zip(cut.edges, clusters, strict=True))
        limits = self._limits(parts.shape[1:], edges, prod(cut.clusters) * prod(clusters))
        chosen = [None if flag else limit for flag, limit in zip(flags, limits, strict=True)]
        core = cores(parts, chosen, self._precision)
        steps, meant = _steps(chosen, caps, len(parts), cut.growth_of(parts, core, way, edges))
        energy, table = energies(parts, self._precision), captured(core, steps)
        choices = choices_of(meant, cut.edges, flags, max(1, self.decode_cost - 1), clusters, self.stored_bits)
        together = (len(cut.batch), prod(way), -1)
        whole, tables = energy.reshape(together).sum(axis=(1, 2)), table.reshape(together).sum(axis=1)
        left = _left(whole, tables, choices, self.floor)
        # Parts of a block share a row where it is no multiple of theirs.
        left *= cut.energy.sum() / max(energy.sum(), 1e-300)
        kept = plausible(left)
        return left[:, kept], choices.nbytes[kept]

    def _cut(self, organisation: Organisation, grid: tuple[int, ...], sample: int) -> Cut:
        """Sampled blocks of the grid as tensors of the organisation's modes."""
        return self._cut_of(organisation, grid, self._blocks(grid, sample))

    def _blocks(self, grid: tuple[int, ...], sample: int) -> Blocks:
        kept = KEPT if self.memory is None else 0
        return self.samples.of(grid, sample, self.room, kept)

    def _cut_of(self, organisation: Organisation, grid: tuple[int, ...], blocks: Blocks) -> Cut:
        """Blocks as tensors of the organisation's modes."""
        axes = self.source.axes
        batch, sizes = organised(blocks.values, axes, organisation), mode_sizes(axes, organisation)
        rows = dict(zip((axis.name for axis in axes), blocks.edges, strict=True))
        clusters, edges = clusters_of(axes, grid, organisation), tuple(prod(rows[n] for n in m) for m in organisation)
        limits = self._limits(batch.shape[1:], edges, prod(grid))
        found = energies(batch, self._precision), limits, edges, sizes, clusters, self._precision, self._enough
        return Cut(axes, organisation, grid, blocks, batch, *found)

    def _limits(self, have: Sequence[int], edges: Sequence[int], blocks: int) -> tuple[int, ...]:
        """Highest rank of each mode of so many blocks: what there is, what the bytes can store, what may be decoded.

        A matrix has as many numbers of each row and of each column.
        """
        elements, numbers = prod(float(rows) for rows in have), 8 * self.size / self.stored_bits
        most = min(self.decode_cost, HIGHEST[len(have) > 2])
        own = sum(edges) / min(1.0, MOST_OF_ONE / blocks) if len(have) == 2 else 0
        return tuple(
            int(max(1, min(rows, elements // rows, most, numbers // max(edge, own) + 1)))
            for rows, edge in zip(have, edges, strict=True)
        )

    @property
    def stored_bits(self) -> float:
        """Bits of a number in the file, on average."""
        return stored_bits(self.bits, self.ceiling)

    @property
    def _precision(self) -> Any:
        """What cores and energies are found in."""
        return np.float64 if is_precise(self.ceiling) else np.float32

    @property
    def _enough(self) -> float:
        """Share of the energy whose ranks are beyond the goal, whatever other modes leave."""
        return 0.0 if self.ceiling is None or is_precise(self.ceiling) else UNTOLD * noise_at(self.ceiling)

    def _judged(self, cut: Cut, choice: tuple[int, ...]) -> tuple[list[Scored], list[int]]:
        """Candidates that leave the chosen modes undecomposed, and the ranks of the one without blocks."""
        order = len(cut.sizes)
        flags = tuple(n in choice for n in range(order))
        one = Candidate(cut.organisation, cut.grid, choice, carried=False, bits=self.bits)
        caps = self._caps(one)
        if caps is None:
            return [Scored(_too_large(cut.edges), one)], [1] * order
        limits = [None if flag else limit for flag, limit in zip(flags, cut.limits, strict=True)]
        steps, meant = _steps(limits, caps, len(cut.batch), cut.growth)
        table = captured(self._core(cut, flags), steps).reshape(len(cut.batch), -1)
        whole = choices_of(meant, cut.sizes, flags, self.decode_cost, cut.clusters, self.stored_bits)
        weights, nbytes = cut.blocks.weights, whole.nbytes
        left = _left((weights @ cut.energy)[None], (weights @ table)[None], whole, self.floor)[0]
        best = pareto(nbytes, left)
        path = partial(best_of_one, nbytes[best], left[best])
        worth, spent = self._worth(path, cut, 1.0, one, float(nbytes[1]))
        ranks = whole.ranks[best][max(1, int(np.searchsorted(nbytes[best], spent, side="right")) - 1)]
        found = [Scored(worth, one)]
        if self.decode_cost > 1 and (prod(cut.clusters) > 1 or (self.bits == 8 and not all(flags))):
            many = replace(one, carried=True)
            nodes = choices_of(meant, cut.edges, flags, self.decode_cost - 1, (1,) * order, self.stored_bits)
            left = _left(cut.energy, table, nodes, self.floor)
            below, least = _left_by_one(left, weights), float(nodes.nbytes[0] * weights.sum())
            path = partial(ration, left, nodes.nbytes, weights)
            if prod(cut.clusters) == 1:
                best = pareto(nodes.nbytes, left[0])
                path = partial(best_of_one, nodes.nbytes[best], left[0][best])
            found.append(Scored(self._worth(path, cut, cut.blocks.overlap, many, least, below)[0], many))
        return found, [int(rank) for rank in ranks]

    def _caps(self, candidate: Candidate) -> Ranks | None:
        """Ranks up to which memory lets the candidate be fitted, None for modes without a bound; None: it cannot be."""
        free = (None,) * len(candidate.organisation)
        if self.memory is None:
            return free
        plan = plan_of(self.source, candidate, None, None, self.decode_cost)
        held = capped(plan, mode_sizes(self.source.axes, candidate.organisation), self.memory)
        return free if held is plan else None if held is None else held.levels[-1].ranks

    def _core(self, cut: Cut, flags: Sequence[bool]) -> Values:
        """Cores with all energy along the modes left undecomposed."""
        had = zip(flags, cut.batch.shape[1:], cut.limits, strict=True)
        # The core of a matrix is diagonal: a rank of one of its modes has its energy at that rank of the other.
        if len(flags) == 2 or all(not flag or rows == limit for flag, rows, limit in had):
            return cut.core
        limits = [None if flag else limit for flag, limit in zip(flags, cut.limits, strict=True)]
        return cores(cut.batch, limits, self._precision, self._enough)

    def _worth(
        self, spend: Spend, cut: Cut, share: float, candidate: Candidate, least: float, below: float = 1.0
    ) -> tuple[float, float]:
        blocks, thinned = cut.blocks, prod(cut.batch.shape[1:]) / prod(cut.edges)
        energy = self.energy * blocks.seen * blocks.overlap * thinned
        return self.worth_and_bytes(spend, energy, share, candidate, least, below)

    def worth_and_bytes(
        self, spend: Spend, energy: float, share: float, candidate: Candidate, least: float, below: float = 1.0
    ) -> tuple[float, float]:
        """What bytes and error make a candidate worth, and the bytes spent on the blocks of the sample.

        Args:
            spend: bytes and error of these blocks, for a `limit` of bytes or an `error`.
            energy: their squared norm.
            share: what part of the whole they stand for.
            candidate: whose bytes are beside the blocks, and whose numbers are rounded.
            least: bytes of the sample's blocks at the least.
            below: share of the energy that the last level is to hold.
        """
        as_bytes = candidate.bits == 8 and len(candidate.undecomposed) == len(candidate.organisation)
        fixed, rounding = self.beside(candidate), below * (BYTES if as_bytes else ROUNDING[candidate.bits])
        if (needed := fixed + least / share) > self.size:  # after all that fit, the smallest first
            return -OUT_OF_REACH - log2(needed), least
        spent, error = spend(limit=(self.size - fixed) * share)
        worth = decibels(energy, error + rounding * energy)
        if self.ceiling is None or worth <= self.ceiling:
            return worth, spent
        spent, _ = spend(error=energy * (noise_at(self.ceiling) - rounding))
        return self.ceiling + log2(self.size / (spent / share + fixed)), spent

    def beside(self, candidate: Candidate) -> float:
        """Bytes of the candidate's file besides what `choices_of` counts of its nodes."""
        # Of each candidate, not of each kind: which of a kind came first, and so its digits, would depend on threads.
        return self.samples.once(candidate, partial(bytes_beside, self.source, candidate, self.seed))


def trial_of(
    source: Source, size: int | None, ceiling: float | None, decode_cost: int, seed: int, aim: float | None = None,
    samples: Samples | None = None,
) -> Trial:
    """The trial of a goal whose dB are those of the source's values; without a `size` all that anything may need.

    A value transform stretches errors by its inverse's slope, so that as many dB of transformed values are others: as
    many as the slopes say where errors are alike everywhere, or `aim`, which a fit told.
    """
    signal = energy = slopes = 0.0
    transform, unit = source.value_transform, np.float64(source.unit)
    plain = transform.is_identity or aim is not None  # no slopes are asked for
    for part in source.parts(SLAB):
        values = source.values(part).astype(np.float64)
        energy += float(np.square(values).sum())
        if not plain:
            higher, lower = (transform.inverse(unit * (values + by)) for by in (1e-4, -1e-4))
            slopes += float(np.square((higher - lower) / 2e-4).sum())
            signal += float(np.square(transform.inverse(unit * values)).sum())
    # Squared errors of transformed values, times this, are those of the source's values.
    stretch = 1.0 if plain else max(slopes / prod(source.shape), 1e-300)
    signal = energy if plain else signal
    higher_by = decibels(energy, signal / stretch) if energy else 0.0
    ceiling = aim if aim is not None or ceiling is None else ceiling + higher_by
    size = size or 4 * prod(source.shape) + ENOUGH
    return Trial(source, size, ceiling, decode_cost, seed, samples or samples_of(source), energy)


def decibels(signal: float, error: float) -> float:
    """SNR, bounded by what float32 can tell."""
    return snr_db(max(signal, 1e-300), max(error, FINEST * signal, 1e-300))


def _left_by_one(left: F64, weights: F64) -> float:
    """Share of the energy that the least ranks of all blocks leave: what follows a first level of these."""
    whole, one = weights @ left[:, 0], weights @ left[:, min(1, left.shape[1] - 1)]
    return float(one / max(whole, 1e-300))


def _left(energy: F64, table: F64, choices: Choices, floor: float) -> F64:
    """Squared error of each block by each choice, `[B, choices]`, the first of which is to store nothing."""
    whole = energy[:, None]
    return np.concatenate([whole, np.maximum(whole - table[:, choices.entry], floor * whole)], axis=1)


def _steps(
    limits: Sequence[int | None], caps: Ranks, blocks: int, growth: Growth | None
) -> tuple[list[Ladder | None], tuple[Ladder, ...]]:
    """Ranks to look at of each mode, None if undecomposed, and which they are of whole blocks: none beyond the caps."""
    most = [min(limit or 1, cap or limit or 1) for limit, cap in zip(limits, caps, strict=True)]
    kept = tuple(ladders(most, blocks))
    meant = kept if growth is None else growth.unthinned(kept)
    counts = [max(1, sum(cap is None or r <= cap for r in own)) for own, cap in zip(meant, caps, strict=True)]
    steps = [None if limit is None else own[:n] for limit, own, n in zip(limits, kept, counts, strict=True)]
    return steps, tuple(own[:n] for own, n in zip(meant, counts, strict=True))


def _too_large(sizes: Sequence[int]) -> float:
    """Worth of what memory does not hold: worse than what bytes do not suffice for, the worse the larger the blocks."""
    return -2 * OUT_OF_REACH - log2(prod(sizes))


def _best(found: Sequence[Scored]) -> float:
    return max(worth for worth, _ in found)


def _promising(cut: Cut, ranks: Sequence[int]) -> Iterator[int]:
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
