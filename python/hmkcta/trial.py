"""What a candidate plan would reach, judged on a sample of its blocks by the energies of their HOSVD cores."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import combinations
from math import inf, log2, log10, prod

import numpy as np
from numpy.typing import NDArray

from .adaptive import summed, table_limits
from .allocation import Allocation, Spectrum, allocate, spectrum
from .axes import Axis, Organisation, mode_sizes, organise
from .hierarchy import squared_norm
from .hmkfile.metadata import axis_to_json, coords_array, coords_name
from .memberships import uniform_blocks
from .plan import LevelSpec
from .predict import header_bytes
from .source import Source
from .tucker import core_energies

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

#: Worse than any number of bytes, in octaves.
OUT_OF_REACH = 1000.0
#: Modes longer than this are never left undecomposed: their core would outgrow any basis.
LONGEST_UNDECOMPOSED = 128
#: Share of its rows that a mode's rank must take before leaving it undecomposed is tried.
NEARLY_FULL = 0.25


def axes_bytes(axes: Sequence[Axis]) -> int:
    """What the axes take in a file, with their coordinates."""
    described = json.dumps([axis_to_json(axis) for axis in axes], separators=(",", ":"))
    apart = sum(coords_array(axis).nbytes + 180 for axis in axes if coords_name(axis))
    return len(described) + described.count('"') + apart


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


@dataclass(frozen=True, eq=False)
class _Cut:
    """An organisation cut by a grid: sampled tensors, each with its squared norm and true mode sizes, whether they are
    thinned, their share of all elements, and the mode sizes and numbers of blocks of the whole."""

    organisation: Organisation
    grid: tuple[int, ...]
    tensors: list[tuple[F32, float, tuple[int, ...]]]
    thinned: bool
    share: float
    sizes: tuple[int, ...]
    clusters: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Trial:
    """The data and the goal: bytes (`size`) or `snr` in dB, within a decode cost; `energy` is the squared norm.

    Bytes are not spent beyond a `ceiling` in dB: what reaches it is worth the more, the fewer bytes it takes.
    """

    source: Source
    snr: float | None
    size: int | None
    ceiling: float | None
    decode_cost: int
    seed: int
    threads: int
    energy: float

    def worths(self, organisation: Organisation, grid: tuple[int, ...], sample: int) -> list[tuple[float, Candidate]]:
        """Every candidate with this organisation and grid: dB at the goal's bytes, or minus octaves of bytes."""
        cut = _cut(self, organisation, grid, sample)
        if not cut.tensors:
            return []
        found, kept = self._judged(cut, ())
        best, helpful = _best(found), list[int]()
        for n in _nearly_full(cut, kept):
            alone = self._judged(cut, (n,))[0]
            helpful += [n] if _best(alone) > best else []
            found += alone
        for pair in combinations(helpful, 2):
            if len(pair) < len(cut.sizes):
                found += self._judged(cut, pair)[0]
        return found

    def _judged(self, cut: _Cut, choice: tuple[int, ...]) -> tuple[list[tuple[float, Candidate]], F64]:
        """Candidates that leave the chosen modes undecomposed, and the share R_n / I_n that each mode keeps."""
        order, tables = len(cut.sizes), list(self._tables(cut, choice))
        about = axes_bytes(self.source.axes)
        flags = [n in choice for n in range(order)]
        energy = sum(energy for _, energy, _ in cut.tensors) / cut.share
        table = summed(tables) / cut.share
        whole = spectrum(table, energy, cut.sizes, flags, self.decode_cost, cut.clusters, hull=False)
        worth, chosen = self._worth([whole], 1.0, header_bytes(order, 1) + about)
        found = [(worth, Candidate(cut.organisation, cut.grid, choice, carried=False))]
        kept = whole.ranks[chosen.choice[0]] / np.array(cut.sizes)
        if prod(cut.clusters) > 1 and self.decode_cost > 1:
            nodes = [
                spectrum(table, energy, sizes, flags, self.decode_cost - 1)
                for table, (_, energy, sizes) in zip(tables, cut.tensors, strict=True)
            ]
            fixed = header_bytes(order, 2) + about + carrier_bytes(cut.sizes, cut.clusters, choice)
            found.append((self._worth(nodes, cut.share, fixed)[0], Candidate(cut.organisation, cut.grid, choice)))
        return found, kept

    def _tables(self, cut: _Cut, choice: tuple[int, ...]) -> Iterator[F64]:
        """Energies of the HOSVD cores of the cut's tensors; a mode left undecomposed takes no room in them."""

        def table(entry: tuple[F32, float, tuple[int, ...]]) -> F64:
            tensor, _, sizes = entry
            ranks = tuple(None if n in choice else size for n, size in enumerate(tensor.shape))
            ones = (1,) * tensor.ndim
            limits = table_limits(tensor.shape, LevelSpec(ranks, ones, ones), self.size or inf, sizes)
            return core_energies(tensor, limits, np.random.default_rng(self.seed))

        with ThreadPoolExecutor(self.threads) as pool:
            yield from pool.map(table, cut.tensors)

    def _worth(self, spectra: Sequence[Spectrum], share: float, fixed: float) -> tuple[float, Allocation]:
        energy = sum(float(s.error[0]) for s in spectra)
        if self.size is not None:
            chosen = allocate(spectra, nbytes=max(self.size - fixed, 0) * share)
            worth = decibels(energy, chosen.error)
            if self.ceiling is None or worth <= self.ceiling:
                return worth, chosen
            chosen = allocate(spectra, error=energy * 10 ** (-self.ceiling / 10))
            return self.ceiling + log2(self.size / (chosen.nbytes / share + fixed)), chosen
        assert self.snr is not None
        error = self.energy * 10 ** (-self.snr / 10) * share
        chosen = allocate(spectra, error=error)
        short = max(0.0, decibels(chosen.error, error))
        # Candidates that cannot reach the goal come after all that can, the nearest first.
        return -OUT_OF_REACH - short if short > 0.01 else -log2(chosen.nbytes / share + fixed), chosen


def decibels(signal: float, error: float) -> float:
    """10 log10(signal / error), bounded by what float32 can tell."""
    return 10 * log10(max(signal, 1e-300) / max(error, 1e-14 * signal, 1e-300))


def carrier_bytes(sizes: Sequence[int], clusters: Sequence[int], undecomposed: Sequence[int]) -> float:
    """What the first level costs that cuts the tensor into the grid's blocks: rank one everywhere."""
    cells = prod(clusters)
    stored = [n for n in range(len(sizes)) if n not in undecomposed]
    core = cells * prod(sizes[n] for n in undecomposed)
    basis = sum(sizes[n] * cells / clusters[n] for n in stored)
    return 2 * (core + basis) + 4 * cells + 8 * sum(sizes[n] for n in stored)


def _cut(trial: Trial, organisation: Organisation, grid: tuple[int, ...], sample: int) -> _Cut:
    """Sampled blocks of the grid as tensors of the organisation's modes; blocks of zeros are left out."""
    source, tensors, seen, thinned = trial.source, list[tuple[F32, float, tuple[int, ...]]](), 0, False
    for block in _sample_blocks(source, grid, sample, trial.seed):
        elements = prod(axis.size for axis in block.axes)
        seen += elements
        thinned |= block.values.size < elements
        tensor = np.ascontiguousarray(organise(block.values, block.thinned, organisation))
        energy = squared_norm(tensor)
        if energy > 0:
            tensors.append((tensor, energy, mode_sizes(block.axes, organisation)))
    counts = {axis.name: count for axis, count in zip(source.axes, grid, strict=True)}
    clusters = tuple(prod(counts[name] for name in mode) for mode in organisation)
    return _Cut(
        organisation, grid, tensors, thinned, seen / prod(source.shape), mode_sizes(source.axes, organisation), clusters
    )


def _best(found: Sequence[tuple[float, Candidate]]) -> float:
    return max(worth for worth, _ in found)


def _nearly_full(cut: _Cut, kept: F64) -> Iterator[int]:
    """Short modes without blocks that keep much of their rank: leaving them undecomposed may save their basis.

    Thinned blocks would make that look far better than it is: few numbers are left for each of the mode's rows.
    """
    if cut.thinned:
        return
    for n, (size, clusters) in enumerate(zip(cut.sizes, cut.clusters, strict=True)):
        if 1 < size <= LONGEST_UNDECOMPOSED and clusters == 1 and kept[n] >= NEARLY_FULL and len(cut.sizes) > 1:
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
