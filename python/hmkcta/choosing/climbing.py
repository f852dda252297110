"""From one grid to a better one: a block more or less along an axis, or along two axes at once, while that helps."""

from __future__ import annotations

from itertools import permutations

from ..grids import allowed, changed, fewer, more
from .candidates import Candidate, Scored
from .judging import Choice, Judged, Ranked, Search, worth_of
from .trial import Kinds

#: Gain in dB, or octaves of bytes, that a change of the grid must bring.
WORTHWHILE = 0.01
#: Twice (or half) as many blocks are tried along an axis where one block more (or less) loses no more than this.
STEEP = 0.05
#: Where it loses more than this that way along the axis is not gone again; sets of undecomposed modes that lose more
#: are left out of a climb.
HOPELESS = 0.5
#: A way along an axis that lost so much in a race is gone in no climb after it.
SURELY_WORSE = 5.0
#: A climb ends that is so far behind after its first round.
BEHIND = 0.05


def climbed(search: Search, start: Candidate, sample: int, reached: float) -> Scored:
    """Change the blocks along one axis after the other while that helps, and along two at once where it no longer does.

    Unless far behind what others `reached`.
    """
    now = search.best([(start.organisation, start.grid)], sample)[0]
    around = search.seen[Judged(start.organisation, start.grid, min(sample, search.most), search.trial.size)]
    kinds = tuple(dict.fromkeys(each.undecomposed for worth, each in around if worth > now.worth - HOPELESS))
    idle, n, before = 0, 0, len(search.seen)
    own = (start.organisation, start.undecomposed)
    lost = {(axis, 1 if is_more else -1): loss
            for (*kind, axis, is_more), loss in search.losses.items() if tuple(kind) == own}
    hopeless = {way for way, loss in lost.items() if loss > SURELY_WORSE}
    while idle <= len(start.grid) and len(search.seen) - before < search.care.steps:
        if idle < len(start.grid):
            tried = _around(search, now, n, sample, hopeless, kinds)
        else:
            tried = _exchanged(search, now.candidate, sample, kinds)
            hopeless.clear()
        found = max([now, *tried], key=worth_of)
        if found.worth > now.worth + WORTHWHILE:
            now, idle = found, 0
            hopeless -= {(n, 1), (n, -1)}
        else:
            idle += 1
        n = (n + 1) % len(start.grid)
        if n == 0 and now.worth < reached - BEHIND:
            break
    return now


def _around(
    search: Search, now: Scored, n: int, sample: int, hopeless: set[tuple[int, int]], kinds: Kinds
) -> Ranked:
    """Candidates with one block more or less along axis n; where that does little harm, twice or half as many.

    Directions that are `hopeless` are left out, and those that turn out so are added.
    """
    modes, grid = now.candidate.organisation, now.candidate.grid
    shape, count = search.trial.source.shape, grid[n]
    next_to = {1: more(count, shape[n], 1), -1: fewer(count, shape[n], 1)}
    steps = [step for step, next_count in next_to.items()
             if (n, step) not in hopeless and allowed(next_count, n, grid, shape)]
    found = search.best([(modes, changed(grid, n, next_to[step])) for step in steps], sample, kinds=kinds)
    hopeless |= {(n, step) for step, (reached, _) in zip(steps, found, strict=True) if reached < now.worth - HOPELESS}
    near = [step for step, (reached, _) in zip(steps, found, strict=True) if reached > now.worth - STEEP]
    further = [more(count, shape[n]) if step > 0 else fewer(count, shape[n]) for step in near]
    many = [(modes, changed(grid, n, many)) for many in further if allowed(many, n, grid, shape)]
    return found + search.best(many, sample, kinds=kinds)


def _exchanged(search: Search, now: Candidate, sample: int, kinds: Kinds) -> Ranked:
    """Candidates with one block more along an axis for one less along another."""
    choices, shape = list[Choice](), search.trial.source.shape
    for m, n in permutations((n for n, count in enumerate(now.grid) if count > 1), 2):
        grid = changed(now.grid, m, fewer(now.grid[m], shape[m], 1))
        if allowed(count := more(grid[n], shape[n], 1), n, grid, shape):
            choices.append((now.organisation, changed(grid, n, count)))
    return search.best(choices, sample, kinds=kinds)
