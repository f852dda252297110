"""A plan for a goal, found by trial: organisation first, then blocks and undecomposed modes.

A candidate is an organisation of the axes into modes, a grid that cuts axes into equal blocks, and the modes left
undecomposed. Its worth is what the last level's choice of ranks (`ranks.allocation`) reaches on a sample of its blocks.
Matrix PCA (two modes, no grid), HOSVD (no grid) and bricks (a grid, nothing merged) are among the candidates, and at
the end local PCA (`clustered.py`). For an SNR they are judged as for a size: by the bytes that the best of them takes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain, product
from math import inf, log10, prod

from ..axes import Organisation, folded, mode_sizes
from ..errors import invalid
from ..filesize import planned_bytes
from ..fitting.fit import EFFORTS
from ..fitting.run import Run
from ..goals import LEAST
from ..grids import SMALLEST_EDGE, changed, coarser, few_grids
from ..plan import Plan
from ..streaming.budget import is_streamed, sampled_together, workset_limit
from ..streaming.source import Source
from ..support.progress import Progress, share_of
from . import blocks
from .candidates import Candidate, Scored, plan_of
from .caps import Room, capped, check_room, room_of
from .climbing import WORTHWHILE, climbed
from .clustered import with_clusters
from .judging import CARES, Ranked, Search, worth_of
from .number_bits import searched_by_bits
from .organisations import moves, organisations
from .racing import FEW_AXES, finalists, near
from .trial import OUT_OF_REACH, VERBATIM, Trial, trial_of

# Worths are in dB, or octaves of bytes (`trial.Trial`).
#: By how much small samples may judge large blocks too low: what lies no further behind is looked at again.
LAGGING = 2.0
#: For so many of the best candidates that races end with blocks twice as long are tried, too.
COARSER = 2
#: A climb begins only from what is worth at most so much less than what climbs before it reached.
LATE = 0.3
#: Blocks are made twice as long, to be cut where that pays, only if at least so many remain.
FEWEST_BLOCKS = 4
#: No further axis is cut along once a block may be cut into so many parts.
MOST_CUTS = 8
#: A start of another kind than the best may be so many times as far behind it as `Care.far` allows of others.
OTHER = 2.5
#: For a size the values as float16, if they fit, are a rival of a plan that comes to more than their SNR less so many
#: dB.
ROUNDED = 12.0
#: For a size plans that come to more than float16's own SNR less so many dB are alike: they are judged anew ..
ALIKE = 10.0
#: .. by the bytes that they take to reach so many dB.
EXACT = 100.0
#: Candidates that are worth at most so much less than the best are fitted, too.
BESIDE = 1.5
#: Elements of an array up to which they are.
FITTED = 1 << 24
#: How many of them at one bit an element; with b bits this over sqrt(b), as fits of low ranks take less time.
AT_ONE_BIT = 2.5
#: The fewest and the most of them.
NEAR = (2, 8)
#: How many plans of other kinds follow the best one for an SNR, in case that its fit falls short.
SPARE = 2
#: Where all candidates are short of an SNR by more than so many dB, the bytes to judge them by are found anew.
SHORT = 0.5


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
    aim: float | None = None,
    samples: blocks.Samples | None = None,
) -> list[Plan]:
    """The best plan found for bytes (`size`) or for an SNR; with a `ceiling` in dB bytes are not spent beyond it. `aim`
    is what the SNR takes in dB of transformed values, if that is known; `samples` are the source's, if at hand.

    Others may follow that a fit may tell to be better: with clusters of the data or without, and those that are judged
    next to it; of large arrays, for an SNR, the best of other kinds, in case that the fit of the first does not keep
    what it promised.

    Raises:
        HmkctaError: the size is too small for the array, or `memory` bytes (None: half of what is free) for a search.
    """
    elements = prod(source.shape)
    room = room_of(elements, memory)
    check_room(source, organisation, room)
    plain = next(organisations(source.axes)) if organisation is None else organisation
    trial = trial_of(source, size, ceiling if snr is None else snr, decode_cost, run.seed, aim, samples)
    together = sampled_together(elements, memory, trial.ceiling)
    trial = replace(trial, room=2 * together, memory=room)
    care = CARES.get(run.effort, CARES[EFFORTS["medium"]])
    held = not is_streamed(elements, workset_limit(memory))
    search = Search(trial, trial, plain, run.threads, care, together, care.clustered if held else 0)
    look = partial(_searched, told=run.progress, narrow=snr is not None)
    search, (worth, best) = searched_by_bits(search, look, bits, organisation is not None, aimed=snr is not None)
    if trial.ceiling is None and worth > -10 * log10(VERBATIM) - ALIKE:
        together = sampled_together(elements, memory, EXACT)
        search = search.anew(replace(search.goal, ceiling=EXACT, room=2 * together))
        search.together = together
        worth, best = look(search, organisation is not None, inf)
    worth, best = _cut_further(search, Scored(worth, best), run.progress)
    if size is not None and worth <= -OUT_OF_REACH:
        least = planned_bytes(plan_of(source, best, None, None, 1), source, seed=run.seed)
        if ceiling is None:
            allowed = f"at least {least} bytes for an array of {elements} elements: {LEAST}"
            raise invalid("size-too-small", "size", f"{size} bytes", allowed, _more_room(source.shape))
        size = least
    if ceiling is not None and worth > (search.goal.ceiling or inf):
        snr, size = ceiling, None  # what fills the bytes beyond the ceiling reaches it with fewer
    verbatim = search.goal.verbatim(plain)
    may_be = bits in (None, verbatim.candidate.bits)
    found, best = best, verbatim.candidate if may_be and verbatim.worth > worth else best
    spare = [*search.rivals, *_near_best(search, best)]
    if snr is not None and not spare:
        spare = _spare(search, best)
    if may_be and (snr is not None or worth > verbatim.worth - ROUNDED > 0):
        spare.append(verbatim.candidate)
    if best == verbatim.candidate:
        spare = search.rivals if source.value_transform.is_identity else [found, *search.rivals]
    plans = _plans(search.goal, (best, *spare), snr, size, -inf if best == verbatim.candidate else worth)
    return _held(plans, source, room_of(elements, memory))  # anew, as what is free varies


def _plans(
    goal: Trial, candidates: Sequence[Candidate], snr: float | None, size: int | None, worth: float
) -> list[Plan]:
    """Plans of the candidates, and what the first, of this worth, is expected to take for an SNR."""
    first, *others = (plan_of(goal.source, each, snr, size, goal.decode_cost) for each in candidates)
    return [first if snr is None else replace(first, expected=goal.bytes_of(worth)), *others]


def _more_room(shape: Sequence[int]) -> str:
    """What to do where a size has no room for the rows of all modes, each of which takes a byte or two."""
    windows = folded(shape)
    merge = ", or merge axes" if sum(size > 1 for size in shape) > 2 else ""
    return "ask for more" + merge + ("" if windows is None else f", or make windows, {windows}")


def _searched(
    search: Search, fixed: bool, enough: float, told: Progress, *, narrow: bool
) -> Scored:
    """The best candidate, of a fixed organisation or any.

    Where races end with more than `enough`, what they end with.
    """
    def progress(stage: str, done: float) -> None:
        told(f"{stage}, {search.goal.bits}-bit numbers", done)

    shape = search.trial.source.shape
    if sum(length > 1 for length in shape) < 2:  # a vector has nothing to cut or to merge
        (search.highest, best), *_ = search.best([(search.plain, (1,) * len(shape))], search.care.refine)
        return Scored(search.highest, best)
    ended = finalists(search, fixed, progress, narrow=narrow)
    search.highest = ended[0].worth
    if search.highest > enough:
        return ended[0]
    if not fixed and (narrow or len(search.plain) > FEW_AXES):  # few samples were looked at, or not all organisations
        ended = [*ended, *_neighbours(search, ended)]
    return _found(search, ended, progress, narrow=narrow)


def _neighbours(search: Search, ended: Ranked) -> Ranked:
    """Organisations that differ from those that races ended with by one axis, whole and in the blocks of the best."""
    first, axes = ended[0].candidate, search.trial.source.axes
    others = chain.from_iterable(moves(modes, axes) for modes in dict.fromkeys(each.organisation for _, each in ended))
    grids = dict.fromkeys([(1,) * len(first.grid), first.grid])
    return [Scored(-inf, replace(first, organisation=modes, grid=grid)) for modes, grid in product(others, grids)]


def _held(plans: Sequence[Plan], source: Source, room: Room | None) -> list[Plan]:
    """The plans with caps that memory has room for; those that it has none for are left out."""
    capped_plans = (capped(plan, mode_sizes(source.axes, plan.organisation), room) for plan in plans)
    return [plan for plan in capped_plans if plan is not None] or [plans[0]]


def _found(search: Search, ended: Ranked, progress: Progress, *, narrow: bool) -> Scored:
    """The best candidate; to `narrow`, of those that reach the ceiling at the bytes of the best, or nearly."""
    found = _settled(search, [candidate for _, candidate in ended], progress, narrow=narrow)
    search.settled = search.trial.size
    if not narrow:
        return with_clusters(search, found)
    firsts = dict.fromkeys([found.candidate, *(candidate for _, candidate in _best_of_kinds(search)[: 2 + SPARE])])
    search.trial = search.goal
    judged = [
        search.best([(each.organisation, each.grid)], search.care.refine, kinds=(each.undecomposed,))[0]
        for each in firsts
    ]
    return with_clusters(search, max(judged, key=worth_of))


def _last_judged(search: Search, size: int) -> Ranked:
    """What was judged by so many bytes on the largest sample, the best first."""
    most = max(key.sample for key in search.seen if key.size == size)
    judged = [item for key, found in search.seen.items() if key.means == (most, size) for item in found]
    return sorted(judged, key=worth_of, reverse=True)


def _best_of_kinds(search: Search) -> Ranked:
    """The best candidate of every kind, of those judged by the goal's bytes on the largest sample."""
    kinds = dict[tuple[Organisation, tuple[int, ...], bool], Scored]()
    for item in _last_judged(search, search.trial.size):
        kinds.setdefault(item.candidate.kind, item)
    return list(kinds.values())


def _spare(search: Search, best: Candidate) -> list[Candidate]:
    """The best candidates that are of other kinds than the best and said to reach the goal."""
    kind = best.kind
    others = [
        each
        for worth, each in _best_of_kinds(search)
        if worth > (search.trial.ceiling or 0.0) and each.kind != kind
    ]
    return others[:SPARE]


def _near_best(search: Search, best: Candidate) -> list[Candidate]:
    """The next best candidates, if judged so near the best that only fits tell which is better.

    Of those that differ in undecomposed modes alone the better one.
    """
    if not search.settled or prod(search.goal.source.shape) > FITTED or search.care == CARES[EFFORTS["fast"]]:
        return []
    apart = dict[tuple[Organisation, tuple[int, ...], bool], Scored]()
    for item in _last_judged(search, search.settled):
        apart.setdefault(item.candidate.blocks, item)
    ahead = [each for _, each in near(list(apart.values()), BESIDE)]
    bits_each = 8 * search.settled / prod(search.goal.source.shape)
    few = max(NEAR[0], min(NEAR[1], round(AT_ONE_BIT / bits_each**0.5)))
    same = best.blocks
    return [each for each in ahead[: few + 1] if each.blocks != same][:few]


def _settled(
    search: Search, ended: Sequence[Candidate], progress: Progress, *, narrow: bool
) -> Scored:
    """On a large sample, climb on from the best of those that races ended with.

    Large blocks were thinned so far, which says little about modes left undecomposed and flatters high ranks: few
    axes merged, matrix PCA, and blocks of twice the edges get another chance.
    """
    shape = search.trial.source.shape
    whole = (1,) * len(shape)
    again = [(c.organisation, c.grid) for c in ended]
    again += [(c.organisation, coarser(c.grid, shape)) for c in ended[:COARSER]]
    again += [(search.plain, grid) for grid in few_grids(shape)[:2] if search.near(search.plain, LAGGING)]
    again += [(modes, whole) for modes in search.matrices()]
    again = list(dict.fromkeys(again))
    told = partial(progress, "finer choice of blocks")
    judged = search.best(again, search.care.refine, share_of(told, 0, 4))
    if narrow and max(map(worth_of, judged)) < (search.goal.ceiling or 0.0) - SHORT:
        search.narrow(judged, search.care.refine)
        judged = search.best(again, search.care.refine, share_of(told, 1, 4))
    best, starts = Scored(-inf, ended[0]), _starts(judged, search.care.far)
    for number, (worth, candidate) in enumerate(starts, start=1):
        whole = _is_whole(best.candidate)
        if worth > best.worth - (LAGGING if whole else LATE):
            reached = -inf if whole else best.worth
            best = max(best, climbed(search, candidate, search.care.refine, reached), key=worth_of)
        told(0.5 + 0.5 * number / len(starts))
    return best


def _is_whole(candidate: Candidate) -> bool:
    """Whether it has no blocks: its climb ends where it begins, and says little of how far others come."""
    return prod(candidate.grid) == 1


def _starts(judged: Ranked, far: float) -> Ranked:
    """The best candidate, the second, and the best of another kind, if not far behind: another kind climbs further."""
    ranked = sorted(judged, key=worth_of, reverse=True)
    worth, first = ranked[0]
    same = first.organisation, first.carried
    others = [item for item in ranked if (item.candidate.organisation, item.candidate.carried) != same]
    second = [item for item in ranked[1:2] if item.worth > worth - far]
    other = [item for item in others[:1] if item.worth > worth - (LAGGING if _is_whole(first) else OTHER * far)]
    return list(dict.fromkeys([ranked[0], *second, *other]))


def _cut_further(search: Search, best: Scored, progress: Progress) -> Scored:
    """Let each block be cut in two along axes where that helps, or in twos from blocks twice as long."""
    (worth, candidate), ceiling, gained = best, search.goal.ceiling or inf, False
    if not candidate.carried or _is_whole(candidate) or search.care.cuts == 0:
        return best
    now = replace(candidate, cuts=(1,) * len(candidate.grid))
    for n in reversed(range(len(candidate.grid))):
        pairs = [_on_whole_blocks(search, each, now) for each in _cut_along(search, now, n)]
        for cut, uncut in sorted(pairs, key=lambda pair: pair[1].worth - pair[0].worth)[:1]:
            gain = cut.worth - uncut.worth
            found = cut if gain > WORTHWHILE else uncut
            now, gained = found.candidate, gained or found is cut
            # Beyond the ceiling worth tells bytes, which whole blocks tell best; steps across it do not.
            told = min(worth, found.worth) > ceiling
            worth = found.worth if told else worth + gain * (found is cut)
        progress("blocks cut further", 1 - n / len(candidate.grid))
    return Scored(worth, now if gained else candidate)


def _on_whole_blocks(search: Search, cut: Candidate, uncut: Candidate) -> tuple[Scored, Scored]:
    """What both are worth on the same whole blocks, as thinned ones flatter those that are large."""
    whole = blocks.FEWEST * prod(search.trial.source.shape) // prod(cut.grid)
    sample = min(search.together, max(search.care.cuts, min(whole, search.care.refine)))
    judged = partial(search.trial.worth, sample=sample, around=cut.grid, workers=search.workers(sample))
    return Scored(judged(cut), cut), Scored(judged(uncut), uncut)


def _cut_along(search: Search, now: Candidate, n: int) -> Iterator[Candidate]:
    """The candidate whose blocks may each be cut in two along axis n, and that with blocks twice as long besides: of
    single indices pairs."""
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
