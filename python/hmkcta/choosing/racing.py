"""Which organisations of the axes, with which blocks, are worth a closer look: a survey of all, and races of the best.

Of each organisation grids that cut axes into twice or half as many blocks are tried, on samples of the data.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import product
from math import inf

from ..axes import Organisation
from ..grids import allowed, changed, few_grids, fewer, more, single_grids, uncut_grids
from ..support.progress import Progress, Told, share_of
from .candidates import Scored
from .climbing import SURELY_WORSE, WORTHWHILE
from .judging import Choice, Ranked, Search, worth_of
from .organisations import merges, organisations

# Worths are in dB, or octaves of bytes (`trial.Trial`).
#: Axes up to which all organisations are tried.
FEW_AXES = 5
#: Of more axes two modes are merged again and again: so many of the best organisations are merged further each time.
BEAM = 3
#: Organisations beyond which only some are looked at with all grids ..
MANY = 20
#: .. those that with one grid are worth at most so much less than the best.
HOPELESS = 4.0
#: The grids of a survey go on that are worth at most so much less than the best one of their organisation.
ASIDE = 1.0
#: An organisation also goes on with other modes undecomposed if that is worth at most so much less.
OTHERWISE = 1.5
#: In how many ways it goes on at most.
KINDS = 2
#: In a race: how far behind the best a candidate is left, and which loss along an axis counts as final.
TRUSTED = (2.0, 1.5)
#: The same while the bytes that an SNR takes come from the survey alone.
DOUBTED = (inf, SURELY_WORSE)


def finalists(search: Search, fixed: bool, progress: Progress, *, narrow: bool) -> Ranked:
    """Organisations by a survey over few grids, then what races of the best of them end with, on samples that grow."""
    shape, care = search.trial.source.shape, search.care
    grids = few_grids(shape)
    choices = [] if fixed else _surveyed(search, grids, progress, narrow=narrow)
    choices += product([search.plain], [*grids, *uncut_grids(shape), *single_grids(shape)])
    found = list[Scored]()
    if narrow:
        search.narrow(search.best(choices, care.survey), care.compare[0])
    for number, sample in enumerate(care.compare):
        told = share_of(partial(progress, "blocks"), number, len(care.compare))
        margins = DOUBTED if narrow and not found else TRUSTED
        judged = search.best(choices, sample, share_of(told, 0, 2))
        racing = racing_of(judged + search.every(choices, sample))
        racing = near(racing, margins[0])[: care.organisations]
        ended = near(_raced(search, racing, sample, margins, share_of(told, 1, 2)), margins[0])[: care.finalists]
        choices = [*product([search.plain], grids), *((each.organisation, each.grid) for _, each in racing + ended)]
        found = ended + found
        if narrow:
            search.narrow(ended, sample)
    return found


def near(ranked: Ranked, far: float) -> Ranked:
    """Those that are not `far` behind the best, which comes first."""
    return [item for item in ranked if item.worth > ranked[0].worth - far]


def _surveyed(
    search: Search, grids: Sequence[tuple[int, ...]], progress: Progress, *, narrow: bool
) -> list[Choice]:
    """The best organisations of all, by some grids: each uncut, and with the grids that did best for it."""
    if narrow:
        search.narrow(search.best([(search.plain, grid) for grid in grids], search.care.survey), search.care.survey)
    told = partial(progress, "organisation")
    every, cut = _merged(search, grids, share_of(told, 0, 2)), grids[1:] or grids
    hopeful = every if len(every) <= MANY else _hopeful(search, every, cut[len(cut) // 2])
    judged = search.best(list(product(hopeful, cut)), search.care.survey, share_of(told, 1, 2))
    worth = _by_organisation(hopeful, judged)
    # A survey thins large blocks and so misjudges high ranks: the best of every number of modes stays in the race.
    ranked = sorted(hopeful, key=lambda modes: -worth[modes])
    firsts = {len(modes): modes for modes in reversed(ranked)}
    choices = list[Choice]()
    for modes in dict.fromkeys([*ranked[: search.care.organisations], *firsts.values()]):
        own = [(reached, each) for reached, each in judged if each.organisation == modes]
        choices += [(modes, grids[0]), *((modes, each.grid) for reached, each in own if reached > worth[modes] - ASIDE)]
    return choices


def _hopeful(search: Search, every: Sequence[Organisation], grid: tuple[int, ...]) -> list[Organisation]:
    """The organisations that do not lie hopelessly behind with one grid; and the best of every number of modes."""
    judged = sorted(search.best([(modes, grid) for modes in every], search.care.survey), key=worth_of, reverse=True)
    firsts = {len(each.organisation): each.organisation for _, each in reversed(judged)}
    ahead = (each.organisation for worth, each in judged if worth > judged[0].worth - HOPELESS)
    return list(dict.fromkeys([*ahead, *firsts.values()]))


def racing_of(judged: Ranked) -> Ranked:
    """The best of every organisation, and of it with other modes undecomposed if near: that likes other blocks."""
    kinds = dict[Organisation, dict[tuple[int, ...], Scored]]()
    for item in sorted(judged, key=worth_of, reverse=True):
        own = kinds.setdefault(item.candidate.organisation, {})
        if not own or (len(own) < KINDS and item.worth > next(iter(own.values())).worth - OTHERWISE):
            own.setdefault(item.candidate.undecomposed, item)
    return sorted((item for own in kinds.values() for item in own.values()), key=worth_of, reverse=True)


def _raced(search: Search, racing: Ranked, sample: int, margins: tuple[float, float], told: Told) -> Ranked:
    """The organisations' grids cut twice or half as often along each axis in turn, while that helps; the best first.

    In every round fewer go on.
    """
    ended, (far, worse) = list[Scored](), margins
    while racing:
        before = racing
        for n in range(len(search.trial.source.shape)):
            racing = _stepped(search, racing, n, sample, worse)
        gained = [now.worth > then.worth + WORTHWHILE for now, then in zip(racing, before, strict=True)]
        best = max(map(worth_of, racing))
        ended += [now for now, on in zip(racing, gained, strict=True) if not on]
        racing = sorted((now for now, on in zip(racing, gained, strict=True) if on), key=worth_of, reverse=True)
        left = min((len(before) + 1) // 2, sum(worth > best - far for worth, _ in racing))
        ended, racing = ended + racing[left:], racing[:left]
        told(len(ended) / (len(ended) + len(racing)))
    return list(dict.fromkeys(sorted(ended, key=worth_of, reverse=True)))


def _stepped(search: Search, racing: Ranked, n: int, sample: int, worse: float) -> Ranked:
    """Each candidate, or what is better with twice or half as many blocks along axis n."""
    tried: list[tuple[int, bool, Choice]] = []
    shape = search.trial.source.shape
    for (number, (_, each)), step in product(enumerate(racing), (more, fewer)):
        count = step(each.grid[n], shape[n])
        lost = search.losses.get((each.organisation, each.undecomposed, n, step is more), 0.0)
        if lost < worse and allowed(count, n, each.grid, shape):
            tried.append((number, step is more, (each.organisation, changed(each.grid, n, count))))
    found = list(racing)
    for (number, is_more, _), item in zip(tried, search.best([choice for *_, choice in tried], sample), strict=True):
        if item.candidate.grid[n] < shape[n]:  # what single indices lose tells nothing of blocks
            way = (item.candidate.organisation, racing[number].candidate.undecomposed, n, is_more)
            search.losses[way] = max(search.losses.get(way, 0.0), racing[number].worth - item.worth)
        found[number] = max(found[number], item, key=worth_of)
    return found


def _merged(search: Search, few: Sequence[tuple[int, ...]], told: Told) -> list[Organisation]:
    """All organisations of few axes; of many, those that come of merging the best two modes again and again."""
    axes = search.trial.source.axes
    if sum(axis.size > 1 for axis in axes) <= FEW_AXES:
        return list(organisations(axes))
    found = best = [search.plain]
    for modes in range(len(search.plain), 2, -1):
        new = list(dict.fromkeys(merged for organisation in best for merged in merges(organisation, axes)))
        judged = search.best(list(product(new, few)), search.care.survey)
        worth = _by_organisation(new, judged)
        best = sorted(new, key=lambda each: -worth[each])[:BEAM]
        found = found + new
        told((len(search.plain) - modes + 1) / len(search.plain))
    return found


def _by_organisation(left: Sequence[Organisation], judged: Ranked) -> dict[Organisation, float]:
    """What each organisation is worth with the best grid; `judged` has all grids of one after those of another."""
    grids = len(judged) // max(1, len(left))
    return {modes: max(map(worth_of, judged[n * grids : (n + 1) * grids])) for n, modes in enumerate(left)}
