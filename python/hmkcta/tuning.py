"""A plan for a goal, found by trial: organisation first, then blocks and undecomposed modes.

A candidate is an organisation of the axes into modes, a grid that cuts axes into equal blocks, and the modes left
undecomposed. Its worth is what the last level's choice of ranks (`allocation.py`) reaches on a sample of its blocks.
Matrix PCA (two modes, no grid), HOSVD (no grid) and bricks (a grid, nothing merged) are among the candidates.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import prod

import numpy as np

from .axes import Axis, Organisation
from .errors import invalid
from .filesize import planned_bytes
from .hierarchy import Progress, Run
from .plan import Plan
from .source import Source
from .trial import OUT_OF_REACH, Candidate, Trial, plan_of

#: Elements looked at for a candidate: to rank organisations, to rank grids, and to settle the blocks.
SURVEY, COMPARE, REFINE = (1 << 17, 1 << 19), 1 << 20, 1 << 23
#: Block edges never fall below this.
SMALLEST_EDGE = 4
#: Most blocks, and the gain in dB (or octaves of bytes) that a change of the grid must bring.
MOST_BLOCKS, WORTHWHILE = 4096, 0.01
#: How many organisations and candidates are looked at closer, and from how many the search climbs on.
ORGANISATIONS, FINALISTS, MATRICES, CLIMBS = (12, 4), 4, 2, 2

Ranked = list[tuple[float, Candidate]]


@dataclass
class Search:
    """Everything judged so far, each at the sample it was judged on; `plain` is the organisation that merges least."""

    trial: Trial
    plain: Organisation
    seen: dict[tuple[Organisation, tuple[int, ...], int], Ranked] = field(
        default_factory=dict[tuple[Organisation, tuple[int, ...], int], Ranked]
    )

    def best(self, organisation: Organisation, grid: tuple[int, ...], sample: int) -> tuple[float, Candidate]:
        """The best candidate with this organisation and grid."""
        key = (organisation, grid, min(sample, prod(self.trial.source.shape)))
        if key not in self.seen:
            self.seen[key] = self.trial.worths(*key)
        return max(self.seen[key], key=_worth, default=(0.0, Candidate(organisation, grid)))

    def matrices(self) -> list[Organisation]:
        """The best organisations in two modes, those of matrix PCA, by the survey."""
        found = {
            modes: max(worth for worth, _ in ranked)
            for (modes, grid, _), ranked in self.seen.items()
            if len(modes) == 2 and set(grid) == {1} and ranked
        }
        return sorted(found, key=lambda modes: -found[modes])[:MATRICES]


def tune(
    source: Source,
    run: Run,
    *,
    snr: float | None,
    size: int | None,
    ceiling: float | None,
    decode_cost: int,
    organisation: Organisation | None,
) -> Plan:
    """The best plan found for bytes (`size`) or for an SNR; with a `ceiling` in dB bytes are not spent beyond it."""
    slabs = (source.values((slice(i, i + 1),)) for i in range(source.shape[0]))
    energy = sum(float(np.square(slab, dtype=np.float64).sum()) for slab in slabs)
    choices = list(organisations(source.axes)) if organisation is None else [organisation]
    search = Search(Trial(source, snr, size, ceiling, decode_cost, run.seed, run.threads, energy), choices[0])
    finalists = _finalists(search, choices, run.progress)
    worth, best = _settled(search, [candidate for _, candidate in finalists], run.progress)
    if size is not None and worth <= -OUT_OF_REACH:
        least = planned_bytes(plan_of(source, best, None, None, 1), source, seed=run.seed)
        if ceiling is None:
            allowed = f"at least {least} bytes for an array of {prod(source.shape)} elements"
            raise invalid("size-too-small", "size", f"{size} bytes", allowed, "ask for more, or merge axes")
        size = least
    if ceiling is not None and finalists[0][0] > ceiling:
        snr, size = ceiling, None  # what fills the bytes beyond the ceiling reaches it with fewer
    return plan_of(source, best, snr, size, decode_cost)


def _finalists(search: Search, choices: Sequence[Organisation], progress: Progress) -> Ranked:
    """Organisations by a survey over few grids, then more grids for the best of them."""
    shape = search.trial.source.shape
    left = list(choices)
    for sample, most in zip(SURVEY, ORGANISATIONS, strict=True):
        survey: list[tuple[float, Organisation]] = []
        for number, modes in enumerate(left):
            survey.append((max(search.best(modes, grid, sample)[0] for grid in _few_grids(shape)), modes))
            progress("organisation", (number + 1) / len(left))
        left = [modes for _, modes in sorted(survey, key=lambda item: -item[0])[:most]]
        # A survey thins large blocks and so misjudges high ranks: nothing merged always stays in the race.
        left += [modes for modes in choices[:1] if modes not in left]
    ranked: Ranked = []
    grids = list(_many_grids(shape))
    for number, grid in enumerate(grids):
        ranked += [search.best(modes, grid, COMPARE) for modes in left]
        progress("blocks", (number + 1) / len(grids))
    ranked.sort(key=lambda item: -item[0])
    return ranked[:FINALISTS]


def _settled(search: Search, finalists: Sequence[Candidate], progress: Progress) -> tuple[float, Candidate]:
    """On a large sample, climb on from the best of the finalists.

    Large blocks were thinned so far, which says little about modes left undecomposed and flatters high ranks: few
    axes merged, and matrix PCA, get another chance.
    """
    shape = search.trial.source.shape
    whole = (1,) * len(shape)
    judged = [search.best(c.organisation, c.grid, REFINE) for c in finalists]
    judged += [search.best(search.plain, grid, REFINE) for grid in _few_grids(shape)]
    judged += [search.best(modes, whole, REFINE) for modes in search.matrices()]
    starts = sorted(dict(zip([(c.organisation, c.grid) for _, c in judged], judged, strict=True)).values(), key=_worth)
    climbed: Ranked = []
    for number, (_, candidate) in enumerate(starts[-CLIMBS:]):
        progress("finer choice of blocks", (number + 0.5) / CLIMBS)
        climbed.append(_climbed(search, candidate, REFINE))
    progress("finer choice of blocks", 1.0)
    return max(climbed, key=_worth)


def _worth(item: tuple[float, Candidate]) -> float:
    return item[0]


def _climbed(search: Search, start: Candidate, sample: int) -> tuple[float, Candidate]:
    """Change the blocks along one axis after the other while that helps."""
    worth, best = search.best(start.organisation, start.grid, sample)
    shape, idle, n = search.trial.source.shape, 0, 0
    while idle < len(shape):
        near = [search.best(start.organisation, grid, sample) for grid in _neighbours(best.grid, shape, n)]
        found = max(near, key=_worth, default=(worth, best))
        if found[0] > worth + WORTHWHILE:
            worth, best = found
            idle = 0
        else:
            idle += 1
        n = (n + 1) % len(shape)
    return worth, best


def _few_grids(shape: Sequence[int]) -> list[tuple[int, ...]]:
    """No blocks, and edges of about 64 and 32 along axes longer than 48."""
    grids = [tuple(round(size / edge) if size > 48 else 1 for size in shape) for edge in (64, 32)]
    return list(dict.fromkeys([(1,) * len(shape), *grids]))


def _many_grids(shape: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """The three longest axes cut alike, by one common edge; axes of middle length whole or cut in two."""
    longest = sorted(range(len(shape)), key=lambda n: -shape[n])[:3]
    long = [n for n in longest if shape[n] >= 24]
    middle = [n for n in range(len(shape)) if n not in long and shape[n] >= 24]
    edges = sorted({shape[n] / count for n in long[:1] for count in (1, 2, 3, 4, 6, 8, 12)})
    seen = {(1,) * len(shape)}
    yield (1,) * len(shape)
    for edge, cuts in product(edges, product((1, 2), repeat=len(middle))):
        grid = [1] * len(shape)
        for n in long:
            grid[n] = max(1, round(shape[n] / edge))
        for n, count in zip(middle, cuts, strict=True):
            grid[n] = count
        if tuple(grid) not in seen and edge >= SMALLEST_EDGE and prod(grid) <= MOST_BLOCKS:
            seen.add(tuple(grid))
            yield tuple(grid)


def _neighbours(grid: tuple[int, ...], shape: Sequence[int], n: int) -> Iterator[tuple[int, ...]]:
    """Grids with other numbers of blocks along axis n."""
    count = grid[n]
    for other in sorted({count + 1, count - 1, 2 * count, count // 2} - {0, count}):
        changed = (*grid[:n], other, *grid[n + 1 :])
        if (other < count or shape[n] / other >= SMALLEST_EDGE) and prod(changed) <= MOST_BLOCKS:
            yield changed


def organisations(axes: Sequence[Axis]) -> Iterator[Organisation]:
    """Every way to merge axes into modes; axes of size 1 ride with the first."""
    names = [axis.name for axis in axes if axis.size > 1]
    single = tuple(axis.name for axis in axes if axis.size == 1)
    for partition in _partitions(names):
        modes = sorted((sorted(mode, key=names.index) for mode in partition), key=lambda mode: names.index(mode[0]))
        organisation = [tuple(mode) for mode in modes] or [()]
        organisation[0] = single + organisation[0]
        if len(organisation) > 1 or len(names) < 2:
            yield tuple(organisation)


def _partitions(names: list[str]) -> Iterator[list[list[str]]]:
    if not names:
        yield []
        return
    for rest in _partitions(names[1:]):
        yield [[names[0]], *rest]
        for n, mode in enumerate(rest):
            yield [*rest[:n], [names[0], *mode], *rest[n + 1 :]]
