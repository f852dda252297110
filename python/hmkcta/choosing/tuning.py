"""A plan for a goal, found by trial: organisation first, then blocks and undecomposed modes.

A candidate is an organisation of the axes into modes, a grid that cuts axes into equal blocks, and the modes left
undecomposed. Its worth is what the last level's choice of ranks (`allocation.py`) reaches on a sample of its blocks.
Matrix PCA (two modes, no grid), HOSVD (no grid) and bricks (a grid, nothing merged) are among the candidates, and at
the end local PCA (`clustered.py`). For an SNR they are judged as for a size: by the bytes that the best of them takes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from math import inf, log10, prod

from ..axes import Organisation, mode_sizes
from ..errors import invalid
from ..filesize import planned_bytes
from ..fit import EFFORTS
from ..grids import SMALLEST_EDGE, allowed, changed, few_grids, uncut_grids
from ..hierarchy import Run
from ..plan import Plan
from ..predict import is_streamed, sampled_together, workset_limit
from ..progress import Progress, share_of
from ..source import Source
from . import blocks
from .candidates import Candidate, plan_of
from .caps import Room, capped, check_room, room_of
from .climbing import SURELY_WORSE, WORTHWHILE, climbed
from .clustered import with_clusters
from .judging import CARES, Choice, Ranked, Search, worth_of
from .number_bits import of_bits
from .organisations import merges, organisations
from .trial import OUT_OF_REACH, VERBATIM, trial_of

#: Up to so many axes all organisations are tried; of more, the best so many are merged further.
FEW_AXES, BEAM = 5, 3
#: With other modes undecomposed an organisation may lie so far behind its best, in so many ways.
OTHERWISE, KINDS = 1.5, 2
#: Small samples tell up to so much too little of large blocks: what lies further behind is left. A way along an axis
#: that lost so much is not gone again in a race.
LAGGING, WORSE = 2.0, 1.5
#: How far behind is left, and which loss is final, in a race; and where bytes for an SNR come from a survey alone.
TRUSTED, DOUBTED = (LAGGING, WORSE), (inf, SURELY_WORSE)
#: No climb begins so far behind what those before it reached.
LATE = 0.3
#: Blocks that may be cut further are no fewer than these, and are cut into no more than so many parts.
FEWEST_BLOCKS, MOST_CUTS = 4, 8
#: A start of another kind may lie so many times as far behind.
OTHER = 2.5
#: The values as float16, if they fit, are a rival for a size of what comes so near their SNR in dB, or beyond it.
ROUNDED = 12.0
#: Within so many dB of float16's own error plans for a size are alike: then by the bytes that they take to so many dB.
ALIKE, EXACT = 1.0, 100.0
#: For a size so many candidates that are judged so near the best are fitted, too, of arrays of so many elements.
NEAR, BESIDE, FITTED = 2, 0.5, 1 << 24
#: Further plans for an SNR; where all are short of it by so many dB, the bytes to judge by are found anew.
SPARE, SHORT = 2, 0.5


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
    bits: int | None = None,
) -> list[Plan]:
    """The best plan found for bytes (`size`) or for an SNR; with a `ceiling` in dB bytes are not spent beyond it.

    Others may follow that a fit may tell to be better: with clusters of the data or without, and for a size those that
    are judged next to it; for an SNR the best of other kinds, in case that the fit of the first does not keep what it
    promised.

    Raises:
        HmkctaError: the size is too small for the array, or `memory` bytes (None: half of what is free) for a search.
    """
    elements = prod(source.shape)
    together, room = sampled_together(elements, memory), room_of(elements, memory)
    check_room(source, organisation, room)
    plain = next(organisations(source.axes)) if organisation is None else organisation
    trial = trial_of(source, size, ceiling if snr is None else snr, decode_cost, run.seed)
    trial = replace(trial, room=2 * together, memory=room)
    care = CARES.get(run.effort, CARES[EFFORTS["medium"]])
    held = not is_streamed(elements, workset_limit(memory))
    search = Search(trial, trial, plain, run.threads, care, together, care.matrices // 2 if held else 0)
    look = partial(_searched, progress=run.progress, narrow=snr is not None)
    search, worth, best = of_bits(search, look, bits, organisation is not None)
    if trial.ceiling is None and worth > -10 * log10(VERBATIM) - ALIKE:
        search = search.anew(replace(search.goal, ceiling=EXACT))
        worth, best = look(search, organisation is not None, inf)
    if size is not None and worth <= -OUT_OF_REACH:
        least = planned_bytes(plan_of(source, best, None, None, 1), source, seed=run.seed)
        if ceiling is None:
            allowed = f"at least {least} bytes for an array of {elements} elements"
            raise invalid("size-too-small", "size", f"{size} bytes", allowed, "ask for more, or merge axes")
        size = least
    if search.highest > (ceiling or inf):
        snr, size = snr or ceiling, None  # what fills the bytes beyond the ceiling reaches it with fewer
    verbatim = search.goal.verbatim(plain)
    may_be = bits in (None, verbatim[1].bits)
    found, best = best, verbatim[1] if may_be and verbatim[0] > worth else best
    spare = [*search.rivals, *(_spare(search, best) if snr is not None else _near_best(search, best))]
    if may_be and (snr is not None or worth > verbatim[0] - ROUNDED > 0):
        spare.append(verbatim[1])
    if best == verbatim[1]:
        spare = [] if source.value_transform.name == "identity" else [found, *search.rivals]
    plans = [plan_of(source, each, snr, size, decode_cost) for each in (best, *spare)]
    return _held(plans, source, room_of(elements, memory))  # anew, as what is free varies


def _searched(
    search: Search, fixed: bool, enough: float, progress: Progress, *, narrow: bool
) -> tuple[float, Candidate]:
    """The best candidate, of a fixed organisation or any, its blocks cut further where that helps.

    Where races end with more than `enough`, what they end with.
    """
    shape = search.trial.source.shape
    if sum(length > 1 for length in shape) < 2:  # a vector has nothing to cut or to merge
        (search.highest, best), *_ = search.best([(search.plain, (1,) * len(shape))], search.care.refine)
        return search.highest, best
    finalists = _finalists(search, fixed, progress, narrow=narrow)
    search.highest = finalists[0][0]
    if search.highest > enough:
        return finalists[0]
    worth, best = _found(search, finalists, progress, narrow=narrow)
    gained, best = _cut_further(search, best, progress)
    return worth + gained, best


def _held(plans: Sequence[Plan], source: Source, room: Room | None) -> list[Plan]:
    """The plans with caps that memory has room for; those that it has none for are left out."""
    capped_plans = (capped(plan, mode_sizes(source.axes, plan.organisation), room) for plan in plans)
    return [plan for plan in capped_plans if plan is not None] or [plans[0]]


def _found(search: Search, finalists: Ranked, progress: Progress, *, narrow: bool) -> tuple[float, Candidate]:
    """The best candidate; to `narrow`, of those that reach the ceiling at the bytes of the best, or nearly."""
    found = _settled(search, [candidate for _, candidate in finalists], progress, narrow=narrow)
    if not narrow:
        return with_clusters(search, found)
    firsts = dict.fromkeys([found[1], *(candidate for _, candidate in _kinds(search)[: 2 + SPARE])])
    search.trial = search.goal
    judged = [
        search.best([(each.organisation, each.grid)], search.care.refine, kinds=(each.undecomposed,))[0]
        for each in firsts
    ]
    return with_clusters(search, max(judged, key=worth_of))


def _kinds(search: Search) -> Ranked:
    """The best candidate of every kind, of those judged by the goal's bytes on the largest sample."""
    most = max(sample for *_, sample, size in search.seen if size == search.trial.size)
    judged = [
        item
        for (*_, sample, size), found in search.seen.items()
        if (sample, size) == (most, search.trial.size)
        for item in found
    ]
    kinds = dict[tuple[Organisation, tuple[int, ...], bool], tuple[float, Candidate]]()
    for worth, each in sorted(judged, key=worth_of, reverse=True):
        kinds.setdefault((each.organisation, each.undecomposed, each.carried), (worth, each))
    return list(kinds.values())


def _spare(search: Search, best: Candidate) -> list[Candidate]:
    """The best candidates that are of other kinds than the best and said to reach the goal."""
    kind = (best.organisation, best.undecomposed, best.carried)
    others = [
        each
        for worth, each in _kinds(search)
        if worth > (search.trial.ceiling or 0.0) and (each.organisation, each.undecomposed, each.carried) != kind
    ]
    return others[:SPARE]


def _near_best(search: Search, best: Candidate) -> list[Candidate]:
    """For a size the next best candidates, if judged so near the best that only fits tell which is better."""
    if prod(search.trial.source.shape) > FITTED or search.care == CARES[EFFORTS["fast"]]:
        return []
    most = max(sample for *_, sample, size in search.seen if size == search.trial.size)
    judged = [item for key, found in search.seen.items() if key[2:] == (most, search.trial.size) for item in found]
    ranked = sorted(judged, key=worth_of, reverse=True)
    near = [item for item in ranked[: 1 + NEAR] if item[0] > ranked[0][0] - BESIDE]
    return [each for _, each in near if each != replace(best, cuts=())][:NEAR]


def _finalists(search: Search, fixed: bool, progress: Progress, *, narrow: bool) -> Ranked:
    """Organisations by a survey over few grids, then what races of the best of them end with, on samples that grow."""
    grids, care = few_grids(search.trial.source.shape), search.care
    left = [search.plain] if fixed else _surveyed(search, grids, progress, narrow=narrow)
    choices = [*product(left, grids), *((search.plain, grid) for grid in uncut_grids(search.trial.source.shape))]
    found = list[tuple[float, Candidate]]()
    if narrow:
        search.narrow(search.best(choices, care.survey), care.compare[0])
    for sample in care.compare:
        margins = DOUBTED if narrow and not found else TRUSTED
        judged = search.best(choices, sample, partial(progress, "blocks"))
        racing = _racing(judged + search.every(choices, sample))
        choices = [*product([search.plain], grids), *((each.organisation, each.grid) for _, each in racing)]
        racing = _near(racing, margins[0])[: care.organisations]
        ended = _near(_raced(search, racing, sample, margins, progress), margins[0])[: care.finalists]
        choices += [(each.organisation, each.grid) for _, each in ended]
        found = ended + found
        if narrow:
            search.narrow(ended, sample)
    return found


def _near(ranked: Ranked, far: float) -> Ranked:
    """Those that are not `far` behind the best, which comes first."""
    return [item for item in ranked if item[0] > ranked[0][0] - far]


def _surveyed(
    search: Search, grids: Sequence[tuple[int, ...]], progress: Progress, *, narrow: bool
) -> list[Organisation]:
    """The best organisations of all, by some grids."""
    if narrow:
        search.narrow(search.best([(search.plain, grid) for grid in grids], search.care.survey), search.care.survey)
    every = _merged(search, grids, progress)
    choices = list(product(every, grids[1:] or grids))
    worth = _by_organisation(every, search.best(choices, search.care.survey, partial(progress, "organisation")))
    # A survey thins large blocks and so misjudges high ranks: the best of every number of modes stays in the race.
    ranked = sorted(every, key=lambda modes: -worth[modes])
    firsts = {len(modes): modes for modes in reversed(ranked)}
    return list(dict.fromkeys([*ranked[: search.care.organisations], *firsts.values(), search.plain]))


def _racing(judged: Ranked) -> Ranked:
    """The best of every organisation, and of it with other modes undecomposed if near: that likes other blocks."""
    kinds = dict[Organisation, dict[tuple[int, ...], tuple[float, Candidate]]]()
    for worth, each in sorted(judged, key=worth_of, reverse=True):
        own = kinds.setdefault(each.organisation, {})
        if not own or (len(own) < KINDS and worth > next(iter(own.values()))[0] - OTHERWISE):
            own.setdefault(each.undecomposed, (worth, each))
    return sorted((item for own in kinds.values() for item in own.values()), key=worth_of, reverse=True)


def _raced(search: Search, racing: Ranked, sample: int, margins: tuple[float, float], progress: Progress) -> Ranked:
    """The organisations' grids cut twice or half as often along each axis in turn, while that helps; the best first.

    In every round fewer go on.
    """
    ended, (far, worse) = list[tuple[float, Candidate]](), margins
    while racing:
        before = racing
        for n in range(len(search.trial.source.shape)):
            racing = _stepped(search, racing, n, sample, worse)
        gained = [now[0] > then[0] + WORTHWHILE for now, then in zip(racing, before, strict=True)]
        best = max(map(worth_of, racing))
        ended += [now for now, on in zip(racing, gained, strict=True) if not on]
        racing = sorted((now for now, on in zip(racing, gained, strict=True) if on), key=worth_of, reverse=True)
        fewer = min((len(before) + 1) // 2, sum(worth > best - far for worth, _ in racing))
        ended, racing = ended + racing[fewer:], racing[:fewer]
        progress("blocks", len(ended) / (len(ended) + len(racing)))
    return list(dict.fromkeys(sorted(ended, key=worth_of, reverse=True)))


def _stepped(search: Search, racing: Ranked, n: int, sample: int, worse: float) -> Ranked:
    """Each candidate, or what is better with twice or half as many blocks along axis n."""
    tried: list[tuple[int, bool, Choice]] = []
    for (number, (_, each)), more in product(enumerate(racing), (True, False)):
        count = 2 * each.grid[n] if more else each.grid[n] // 2
        lost = search.losses.get((each.organisation, each.undecomposed, n, more), 0.0)
        if lost < worse and allowed(count, n, each.grid, search.trial.source.shape):
            tried.append((number, more, (each.organisation, changed(each.grid, n, count))))
    found = list(racing)
    for (number, more, _), item in zip(tried, search.best([choice for *_, choice in tried], sample), strict=True):
        way = (item[1].organisation, racing[number][1].undecomposed, n, more)
        search.losses[way] = max(search.losses.get(way, 0.0), racing[number][0] - item[0])
        found[number] = max(found[number], item, key=worth_of)
    return found


def _merged(search: Search, few: Sequence[tuple[int, ...]], progress: Progress) -> list[Organisation]:
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
        progress("organisation", (len(search.plain) - modes + 1) / len(search.plain))
    return found


def _by_organisation(left: Sequence[Organisation], judged: Ranked) -> dict[Organisation, float]:
    """What each organisation is worth with the best grid; `judged` has all grids of one after those of another."""
    grids = len(judged) // max(1, len(left))
    return {modes: max(map(worth_of, judged[n * grids : (n + 1) * grids])) for n, modes in enumerate(left)}


def _settled(
    search: Search, finalists: Sequence[Candidate], progress: Progress, *, narrow: bool
) -> tuple[float, Candidate]:
    """On a large sample, climb on from the best of the finalists.

    Large blocks were thinned so far, which says little about modes left undecomposed and flatters high ranks: few
    axes merged, and matrix PCA, get another chance.
    """
    shape = search.trial.source.shape
    whole = (1,) * len(shape)
    again = [(c.organisation, c.grid) for c in finalists]
    again += [(search.plain, grid) for grid in few_grids(shape)[:2] if search.near(search.plain, LAGGING)]
    again += [(modes, whole) for modes in search.matrices()]
    again = list(dict.fromkeys(again))
    told = share_of(partial(progress, "finer choice of blocks"), 0, 3)
    judged = search.best(again, search.care.refine, told)
    if narrow and max(map(worth_of, judged)) < (search.goal.ceiling or 0.0) - SHORT:
        search.narrow(judged, search.care.refine)
        judged = search.best(again, search.care.refine, told)
    best, starts = (-inf, finalists[0]), _starts(judged, search.care.far)
    for number, (worth, candidate) in enumerate(starts, start=1):
        whole = _is_whole(best[1])
        if worth > best[0] - (LAGGING if whole else LATE):
            reached = -inf if whole else best[0]
            best = max(best, climbed(search, candidate, search.care.refine, reached), key=worth_of)
        progress("finer choice of blocks", 1 / 3 + 2 * number / (3 * len(starts)))
    return best


def _is_whole(candidate: Candidate) -> bool:
    """Whether it has no blocks: its climb ends where it begins, and says little of how far others come."""
    return prod(candidate.grid) == 1


def _starts(judged: Ranked, far: float) -> Ranked:
    """The best candidate, the second, and the best of another kind, if not far behind: another kind climbs further."""
    ranked = sorted(judged, key=worth_of, reverse=True)
    worth, first = ranked[0]
    others = [item for item in ranked if (item[1].organisation, item[1].carried) != (first.organisation, first.carried)]
    second = [item for item in ranked[1:2] if item[0] > worth - far]
    other = [item for item in others[:1] if item[0] > worth - (LAGGING if _is_whole(first) else OTHER * far)]
    return list(dict.fromkeys([ranked[0], *second, *other]))


def _cut_further(search: Search, best: Candidate, progress: Progress) -> tuple[float, Candidate]:
    """Let each block be cut in two along axes where that helps, or in twos from blocks twice as long; and the gain."""
    if not best.carried or search.care.cuts == 0:
        return 0.0, best
    now, gained, worth = replace(best, cuts=(1,) * len(best.grid)), 0.0, search.trial.worth
    for n in reversed(range(len(best.grid))):
        tried: Ranked = []
        for each in _cut_along(search, now, n):
            # Whole blocks, as thinned ones flatter those that are large; the same ones for both.
            whole = blocks.FEWEST * prod(search.trial.source.shape) // prod(each.grid)
            sample = min(search.together, max(search.care.cuts, min(whole, search.care.refine)))
            tried.append((worth(each, sample, each.grid) - worth(now, sample, each.grid), each))
        gain, found = max(tried, key=worth_of, default=(0.0, now))
        if gain > WORTHWHILE:
            now, gained = found, gained + gain
        progress("blocks cut further", 1 - n / len(best.grid))
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
