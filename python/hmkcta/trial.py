"""What a candidate plan would reach, judged on a sample of its blocks by the energies of their HOSVD cores."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import combinations
from math import inf, log2, log10, prod

import numpy as np
from numpy.typing import NDArray

from .adaptive import summed, table_limits
from .allocation import Spectrum, allocate, spectrum
from .axes import Axis, Organisation, mode_sizes, organise
from .memberships import uniform_blocks
from .plan import LevelSpec
from .source import Source
from .tucker import core_energies

F64 = NDArray[np.float64]

#: Worse than any number of bytes, in octaves.
OUT_OF_REACH = 1000.0
#: Modes longer than this are never left undecomposed: their core would outgrow any basis.
LONGEST_UNDECOMPOSED = 128


def header_bytes(order: int, levels: int) -> int:
    """About what the header of a file takes: names, shapes and checksums of every array."""
    return 1500 + 900 * order + (levels - 1) * (1300 + 1050 * order)


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
class Trial:
    """The data and the goal: bytes (`size`) or `snr` in dB, within a decode cost; `energy` is the squared norm."""

    source: Source
    snr: float | None
    size: int | None
    decode_cost: int
    seed: int
    threads: int
    energy: float

    def worths(self, organisation: Organisation, grid: tuple[int, ...], sample: int) -> list[tuple[float, Candidate]]:
        """Every candidate with this organisation and grid: dB at the goal's bytes, or minus octaves of bytes."""
        blocks = list(_sample_blocks(self.source, grid, sample, self.seed))
        share = sum(prod(axis.size for axis in block.axes) for block in blocks) / prod(self.source.shape)
        with ThreadPoolExecutor(self.threads) as pool:
            examined = pool.map(partial(self._table, organisation), blocks)
            tables = [entry for entry in examined if entry[1] > 0]
        counts = {axis.name: count for axis, count in zip(self.source.axes, grid, strict=True)}
        clusters = tuple(prod(counts[name] for name in mode) for mode in organisation)
        sizes = mode_sizes(self.source.axes, organisation)
        found: list[tuple[float, Candidate]] = []
        for choice in _undecomposed_choices(sizes):
            if any(clusters[n] > 1 for n in choice) or not tables:
                continue
            if prod(clusters) > 1 and self.decode_cost > 1:
                nodes = [_spectrum(*entry, choice, self.decode_cost - 1) for entry in tables]
                fixed = header_bytes(len(sizes), 2) + carrier_bytes(sizes, clusters, choice)
                found.append((self._worth(nodes, share, fixed), Candidate(organisation, grid, choice)))
            whole = _spectrum(
                summed(t for t, _, _ in tables) / share,
                sum(e for _, e, _ in tables) / share,
                sizes,
                choice,
                self.decode_cost,
                clusters,
            )
            found.append(
                (
                    self._worth([whole], 1.0, header_bytes(len(sizes), 1)),
                    Candidate(organisation, grid, choice, carried=False),
                )
            )
        return found

    def _table(self, organisation: Organisation, block: Block) -> tuple[F64, float, tuple[int, ...]]:
        tensor = np.ascontiguousarray(organise(block.values, block.thinned, organisation))
        spec = LevelSpec(tuple(tensor.shape), (1,) * tensor.ndim, (1,) * tensor.ndim)
        sizes = mode_sizes(block.axes, organisation)
        limits = table_limits(tensor.shape, spec, self.size or inf, sizes)
        table = core_energies(tensor, limits, np.random.default_rng(self.seed))
        energy = float(np.square(tensor, dtype=np.float64).sum())
        return table, energy, sizes

    def _worth(self, spectra: Sequence[Spectrum], share: float, fixed: float) -> float:
        energy = sum(float(s.error[0]) for s in spectra)
        if self.size is not None:
            return decibels(energy, allocate(spectra, nbytes=max(self.size - fixed, 0) * share).error)
        assert self.snr is not None
        error = self.energy * 10 ** (-self.snr / 10) * share
        chosen = allocate(spectra, error=error)
        short = max(0.0, decibels(chosen.error, error))
        # Candidates that cannot reach the goal come after all that can, the nearest first.
        return -OUT_OF_REACH - short if short > 0.01 else -log2(chosen.nbytes / share + fixed)


def decibels(signal: float, error: float) -> float:
    """10 log10(signal / error), bounded by what float32 can tell."""
    return 10 * log10(max(signal, 1e-300) / max(error, 1e-14 * signal, 1e-300))


def _spectrum(
    table: F64,
    energy: float,
    sizes: tuple[int, ...],
    undecomposed: tuple[int, ...],
    decode_cost: int,
    clusters: tuple[int, ...] | None = None,
) -> Spectrum:
    """The choices of ranks, bytes counted at the true sizes."""
    for n in undecomposed:
        table = table.take([-1], axis=n)
    flags = [n in undecomposed for n in range(len(sizes))]
    return spectrum(table, energy, sizes, flags, max(1, decode_cost), clusters, hull=clusters is None)


def carrier_bytes(sizes: Sequence[int], clusters: Sequence[int], undecomposed: Sequence[int]) -> float:
    """What the first level costs that cuts the tensor into the grid's blocks: rank one everywhere."""
    cells = prod(clusters)
    stored = [n for n in range(len(sizes)) if n not in undecomposed]
    core = cells * prod(sizes[n] for n in undecomposed)
    basis = sum(sizes[n] * cells / clusters[n] for n in stored)
    return 2 * (core + basis) + 4 * cells + 8 * sum(sizes[n] for n in stored)


@lru_cache
def _undecomposed_choices(sizes: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Up to two short modes, and never all."""
    short = [n for n, size in enumerate(sizes) if 1 < size <= LONGEST_UNDECOMPOSED]
    return [choice for count in range(min(2, len(sizes) - 1) + 1) for choice in combinations(short, count)]


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
