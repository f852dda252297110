"""A plan for a goal, found by trial: organisation first, then blocks and undecomposed modes.

A candidate is an organisation of the axes into modes, a grid that cuts axes into equal blocks, and the modes left
undecomposed. Its worth is what the last level's choice of ranks (`allocation.py`) reaches on a sample of its blocks.
Matrix PCA (two modes, no grid), HOSVD (no grid) and bricks (a grid, nothing merged) are among the candidates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations, product
from math import prod

from .axes import Axis, Organisation
from .errors import invalid
from .filesize import planned_bytes
from .fit import EFFORTS
from .grids import SMALLEST_EDGE, allowed, changed, few_grids, many_grids
from .hierarchy import Progress, Run
from .memory import check_memory, memory_budget
from .plan import Plan
from .predict import PROCESS
from .source import Source
from .trial import OUT_OF_REACH, Candidate, Kinds, Trial, plan_of, trial_of

#: Gain in dB, or octaves of bytes, that a change of the grid must bring.
WORTHWHILE = 0.01
#: Up to so many axes all organisations are tried; of more, the best so many are merged further.
FEW_AXES, BEAM = 5, 3
#: Elements of all the samples that are worked on at once, at most and, where memory is scarce, at the least; and bytes
#: of memory for each.
TOGETHER, FEWEST, EACH = 1 << 24, 1 << 20, 40
#: In dB or octaves of bytes: twice as many blocks are tried where one more loses no more than the first, and none again
#: where one loses more than the second; a second start is left where it is if it lies the last behind the first, once
#: that has climbed.
STEEP, HOPELESS = 0.05, 0.5
#: Modes are left undecomposed on trial again if that came so near before, in dB or octaves of bytes.
FAR = 3.0
#: Blocks that may be cut further are no fewer than these, and are cut into no more than so many parts.
FEWEST_BLOCKS, MOST_CUTS = 4, 8
#: Further plans for an SNR.
SPARE = 2


@dataclass(frozen=True)
class Care:
    """How much is looked at.

    Attributes:
        survey: elements looked at of each candidate to rank organisations, twice; the best `organisations` go on.
        compare: elements to rank grids; the best `finalists` go on, and as many `matrices`.
        refine: elements to settle the blocks, from the best; and from a second start that lies no more than `far`, in
            dB or octaves of bytes, behind what that led to. No climb begins another round after so many `steps`.
        cuts: elements to find axes along which blocks are cut further, each as pays; 0: none.
    """

    survey: tuple[int, int]
    organisations: tuple[int, int]
    compare: int
    finalists: int
    matrices: int
    refine: int
    far: float
    steps: int
    cuts: int


CARES = {
    EFFORTS["fast"]: Care((1 << 17, 1 << 19), (3, 1), 1 << 18, 1, 0, 1 << 22, 0.0, 4, 0),
    EFFORTS["medium"]: Care((1 << 16, 1 << 20), (6, 3), 1 << 18, 4, 1, 1 << 23, 0.3, 16, 1 << 20),
    EFFORTS["thorough"]: Care((1 << 17, 1 << 19), (12, 4), 1 << 20, 4, 2, 1 << 23, 1.0, 1000, 1 << 23),
}

Ranked = list[tuple[float, Candidate]]
Choice = tuple[Organisation, tuple[int, ...]]


def _silent(fraction: float) -> None:
    """Progress for nobody."""


@dataclass
class Search:
    """Everything judged so far, each at the sample it was judged on; `plain` is the organisation that merges least."""

    trial: Trial
    plain: Organisation
    threads: int
    care: Care
    together: int
    seen: dict[tuple[Organisation, tuple[int, ...], int], Ranked] = field(
        default_factory=dict[tuple[Organisation, tuple[int, ...], int], Ranked]
    )

    def best(
        self, choices: Sequence[Choice], sample: int, told: Callable[[float], None] = _silent, kinds: Kinds = ()
    ) -> Ranked:
        """The best candidate with each organisation and grid; `told` hears which share of them is judged.

        `kinds` are the sets of undecomposed modes to look at; none: those that came near the best of their organisation
        so far, or, at first and at last, all that promise something.
        """
        sample = min(sample, self.most)
        new = list(dict.fromkeys(choice for choice in choices if (*choice, sample) not in self.seen))
        workers = max(1, min(self.threads, len(new), self.together // sample))  # side by side as far as memory goes

        again = sample < min(self.care.refine, self.most)
        known = {modes: kinds or (self.kinds(modes) if again else ()) for modes, _ in new}

        def judge(choice: Choice) -> Ranked:
            return self.trial.worths(*choice, sample, known[choice[0]])

        with ThreadPoolExecutor(workers) as pool:
            try:
                for number, (choice, ranked) in enumerate(zip(new, pool.map(judge, new), strict=True), start=1):
                    self.seen[(*choice, sample)] = ranked
                    told(number / len(new))
            except BaseException:
                pool.shutdown(wait=True, cancel_futures=True)
                raise
        return [max(self.seen[(*choice, sample)], key=_worth, default=(0.0, Candidate(*choice))) for choice in choices]

    def kinds(self, modes: Organisation) -> Kinds:
        """Sets of undecomposed modes that came near the best with some grid and sample."""
        found = dict[tuple[int, ...], None]()
        for key in [key for key in self.seen if key[0] == modes and self.seen[key]]:
            ranked = self.seen[key]
            found |= {each.undecomposed: None for worth, each in ranked if worth > max(map(_worth, ranked)) - FAR}
        return tuple(found)

    @property
    def most(self) -> int:
        """Most elements of a sample."""
        return min(prod(self.trial.source.shape), self.together)

    def matrices(self) -> list[Organisation]:
        """The best organisations in two modes, those of matrix PCA, by the survey."""
        found = {
            modes: max(worth for worth, _ in ranked)
            for (modes, grid, _), ranked in self.seen.items()
            if len(modes) == 2 and set(grid) == {1} and ranked
        }
        return sorted(found, key=lambda modes: -found[modes])[: self.care.matrices]


def tune(
    source: Source,
    run: Run,
    *,
    snr: float | None,
    size: int | None,
    ceiling: float | None,
    decode_cost: int,
    organisation: Organisation | None,
    memory: int | None = None,
) -> list[Plan]:
    """The best plan found for bytes (`size`) or for an SNR; with a `ceiling` in dB bytes are not spent beyond it.

    For an SNR others follow, the best of other kinds, in case that a fit of the first does not keep what it promised.

    Raises:
        HmkctaError: the size is too small for the array, or `memory` bytes (None: half of what is free) for a search.
    """
    elements = prod(source.shape)
    hint = "give the levels by --plan, or raise --max-memory"
    check_memory(PROCESS + EACH * min(elements, FEWEST), "choosing a plan", hint, memory)
    together = min(TOGETHER, max(FEWEST, (memory_budget(memory) - PROCESS) // EACH))
    plain = next(organisations(source.axes)) if organisation is None else organisation
    trial = trial_of(source, snr, size, ceiling, decode_cost, run.seed)
    search = Search(trial, plain, run.threads, CARES.get(run.effort, CARES[EFFORTS["medium"]]), together)
    if sum(length > 1 for length in source.shape) < 2:  # a vector has nothing to cut or to merge
        highest = worth, best = search.best([(plain, (1,) * len(source.shape))], search.care.refine)[0]
    else:
        finalists = _finalists(search, organisation is not None, run.progress)
        highest = finalists[0]
        worth, best = _settled(search, [candidate for _, candidate in finalists], run.progress)
        gained, best = _cut_further(search, best, run.progress)
        worth += gained
    if size is not None and worth <= -OUT_OF_REACH:
        least = planned_bytes(plan_of(source, best, None, None, 1), source, seed=run.seed)
        if ceiling is None:
            allowed = f"at least {least} bytes for an array of {elements} elements"
            raise invalid("size-too-small", "size", f"{size} bytes", allowed, "ask for more, or merge axes")
        size = least
    if trial.ceiling is not None and highest[0] > trial.ceiling:
        snr, size = ceiling, None  # what fills the bytes beyond the ceiling reaches it with fewer
    verbatim = trial.verbatim(plain)
    if verbatim[0] > worth:
        best = verbatim[1]
    spare = [*_spare(search, best), verbatim[1]] if snr is not None and best != verbatim[1] else []
    return [plan_of(source, each, snr, size, decode_cost) for each in (best, *spare)]


def _spare(search: Search, best: Candidate) -> list[Candidate]:
    """The best candidates that are of other kinds than the best and said to reach the goal."""
    most = max(sample for *_, sample in search.seen)
    judged = [item for (*_, sample), found in search.seen.items() if sample == most for item in found]
    kinds = {(best.organisation, best.undecomposed, best.carried): best}
    for worth, each in sorted(judged, key=_worth, reverse=True):
        if worth > -OUT_OF_REACH:
            kinds.setdefault((each.organisation, each.undecomposed, each.carried), each)
    return list(kinds.values())[1 : 1 + SPARE]


def _finalists(search: Search, fixed: bool, progress: Progress) -> Ranked:
    """Organisations by a survey over few grids, then more grids for the best of them."""
    shape = search.trial.source.shape
    grids = few_grids(shape)
    left = [search.plain] if fixed else _merged(search, grids, progress)
    for turn, (sample, most) in enumerate(zip(search.care.survey, search.care.organisations, strict=True)):
        few = grids if turn else grids[1:2] or grids
        judged = search.best(list(product(left, few)), sample, partial(progress, "organisation"))
        worth = _by_organisation(left, judged)
        left = sorted(left, key=lambda modes: -worth[modes])[:most]
        # A survey thins large blocks and so misjudges high ranks: nothing merged always stays in the race.
        left += [search.plain] if search.plain not in left else []
    many = [(modes, grid) for grid in many_grids(shape) for modes in left]
    ranked = search.best(many, search.care.compare, partial(progress, "blocks"))
    ranked.sort(key=lambda item: -item[0])
    # Samples flatter large blocks and long modes: the best of every organisation gets a chance.
    firsts = {candidate.organisation: (worth, candidate) for worth, candidate in reversed(ranked)}
    return list(dict.fromkeys([*ranked[: search.care.finalists], *firsts.values()]))


def _merged(search: Search, few: Sequence[tuple[int, ...]], progress: Progress) -> list[Organisation]:
    """All organisations of few axes; of many, those that come of merging the best two modes again and again."""
    axes = search.trial.source.axes
    if sum(axis.size > 1 for axis in axes) <= FEW_AXES:
        return list(organisations(axes))
    found = best = [search.plain]
    for modes in range(len(search.plain), 2, -1):
        new = list(dict.fromkeys(merged for organisation in best for merged in _merges(organisation, axes)))
        judged = search.best(list(product(new, few)), search.care.survey[0])
        worth = _by_organisation(new, judged)
        best = sorted(new, key=lambda each: -worth[each])[:BEAM]
        found = found + new
        progress("organisation", (len(search.plain) - modes + 1) / len(search.plain))
    return found


def _by_organisation(left: Sequence[Organisation], judged: Ranked) -> dict[Organisation, float]:
    """What each organisation is worth with the best grid; `judged` has all grids of one after those of another."""
    grids = len(judged) // max(1, len(left))
    return {modes: max(map(_worth, judged[n * grids : (n + 1) * grids])) for n, modes in enumerate(left)}


def _settled(search: Search, finalists: Sequence[Candidate], progress: Progress) -> tuple[float, Candidate]:
    """On a large sample, climb on from the best of the finalists.

    Large blocks were thinned so far, which says little about modes left undecomposed and flatters high ranks: few
    axes merged, and matrix PCA, get another chance.
    """
    shape = search.trial.source.shape
    whole = (1,) * len(shape)
    again = [(c.organisation, c.grid) for c in finalists]
    again += [(search.plain, grid) for grid in few_grids(shape)]
    again += [(modes, whole) for modes in search.matrices()]
    again = list(dict.fromkeys(again))
    judged = search.best(again, search.care.refine, lambda share: progress("finer choice of blocks", share / 3))
    climbed: Ranked = []
    for number, (worth, candidate) in enumerate(sorted(judged, key=_worth)[:-3:-1], start=1):
        if not climbed or worth > climbed[0][0] - search.care.far:
            climbed.append(_climbed(search, candidate, search.care.refine))
        progress("finer choice of blocks", (1 + number) / 3)
    progress("finer choice of blocks", 1.0)
    return max(climbed, key=_worth)


def _worth(item: tuple[float, Candidate]) -> float:
    return item[0]


def _climbed(search: Search, start: Candidate, sample: int) -> tuple[float, Candidate]:
    """Change the blocks along one axis after the other while that helps."""
    now = search.best([(start.organisation, start.grid)], sample)[0]
    around = search.seen[start.organisation, start.grid, min(sample, search.most)]
    kinds = tuple(dict.fromkeys(each.undecomposed for worth, each in around if worth > now[0] - HOPELESS))
    idle, n, hopeless, before = 0, 0, set[tuple[int, int]](), len(search.seen)
    while idle < len(start.grid) and len(search.seen) - before < search.care.steps:
        found = max([now, *_around(search, now, n, sample, hopeless, kinds)], key=_worth)
        if found[0] > now[0] + WORTHWHILE:
            now, idle = found, 0
            hopeless -= {(n, 1), (n, -1)}
        else:
            idle += 1
        n = (n + 1) % len(start.grid)
    return now


def _cut_further(search: Search, best: Candidate, progress: Progress) -> tuple[float, Candidate]:
    """Let each block be cut in two along axes where that helps, or in twos from blocks twice as long; and the gain."""
    if not best.carried or search.care.cuts == 0:
        return 0.0, best
    now, gained, worth = replace(best, cuts=(1,) * len(best.grid)), 0.0, search.trial.worth
    for n in range(len(best.grid)):
        tried: Ranked = []
        for each in _cut_along(search, now, n):
            # Whole blocks, as thinned ones flatter those that are large; the same ones for both.
            whole = FEWEST_BLOCKS * prod(search.trial.source.shape) // prod(each.grid)
            sample = min(search.together, max(search.care.cuts, min(whole, search.care.refine)))
            tried.append((worth(each, sample, each.grid) - worth(now, sample, each.grid), each))
        gain, found = max(tried, key=_worth, default=(0.0, now))
        if gain > WORTHWHILE:
            now, gained = found, gained + gain
        progress("blocks cut further", (n + 1) / len(best.grid))
    return gained, now if gained else best


def _cut_along(search: Search, now: Candidate, n: int) -> Iterator[Candidate]:
    """The candidate whose blocks may each be cut in two along axis n, and that with blocks twice as long besides."""
    grid = now.grid
    if _undecomposed(search, now, n) or prod(now.cuts) >= MOST_CUTS:
        return
    if 2 * grid[n] * SMALLEST_EDGE <= search.trial.source.shape[n]:
        yield replace(now, cuts=changed(now.cuts, n, 2))
    if grid[n] % 2 == 0 and prod(grid) >= 2 * FEWEST_BLOCKS:
        yield replace(now, grid=changed(grid, n, grid[n] // 2), cuts=changed(now.cuts, n, 2))


def _undecomposed(search: Search, candidate: Candidate, n: int) -> bool:
    name = search.trial.source.axes[n].name
    return any(name in candidate.organisation[mode] for mode in candidate.undecomposed)


def _around(
    search: Search, now: tuple[float, Candidate], n: int, sample: int, hopeless: set[tuple[int, int]], kinds: Kinds
) -> Ranked:
    """Candidates with one block more or less along axis n; where that does little harm, twice or half as many.

    Directions that are `hopeless` are left out, and those that turn out so are added.
    """
    worth, (modes, grid) = now[0], (now[1].organisation, now[1].grid)
    shape, count = search.trial.source.shape, grid[n]
    steps = [step for step in (1, -1) if (n, step) not in hopeless and allowed(count + step, n, grid, shape)]
    found = search.best([(modes, changed(grid, n, count + step)) for step in steps], sample, kinds=kinds)
    hopeless |= {(n, step) for step, (reached, _) in zip(steps, found, strict=True) if reached < worth - HOPELESS}
    near = [step for step, (reached, _) in zip(steps, found, strict=True) if reached > worth - STEEP]
    further = [2 * count if step > 0 else count // 2 for step in near]
    many = [(modes, changed(grid, n, many)) for many in further if allowed(many, n, grid, shape)]
    return found + search.best(many, sample, kinds=kinds)


def organisations(axes: Sequence[Axis]) -> Iterator[Organisation]:
    """Every way to merge axes into modes, that which merges none first; axes of size 1 ride with the first mode."""
    names = [axis.name for axis in axes if axis.size > 1]
    for partition in _partitions(names):
        if len(partition) > 1 or len(names) < 2:
            yield _arranged(partition, axes)


def _arranged(partition: Sequence[Sequence[str]], axes: Sequence[Axis]) -> Organisation:
    """Axes in their order within a mode, and modes in the order of their first axes."""
    names = [axis.name for axis in axes if axis.size > 1]
    single = tuple(axis.name for axis in axes if axis.size == 1)
    modes = sorted((sorted(mode, key=names.index) for mode in partition), key=lambda mode: names.index(mode[0]))
    first, *others = [tuple(mode) for mode in modes] or [()]
    return (single + first, *others)


def _merges(organisation: Organisation, axes: Sequence[Axis]) -> Iterator[Organisation]:
    """The organisation with two of its modes made one."""
    single = {axis.name for axis in axes if axis.size == 1}
    modes = [[name for name in mode if name not in single] for mode in organisation]
    for a, b in combinations(range(len(modes)), 2):
        yield _arranged([modes[a] + modes[b], *(mode for n, mode in enumerate(modes) if n not in (a, b))], axes)


def _partitions(names: list[str]) -> Iterator[list[list[str]]]:
    if not names:
        yield []
        return
    for rest in _partitions(names[1:]):
        yield [[names[0]], *rest]
        for n, mode in enumerate(rest):
            yield [*rest[:n], [names[0], *mode], *rest[n + 1 :]]
