"""Compare plans by their fits, where a sample does not tell which is best or the first misses its goal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import filterfalse
from math import inf, isfinite, prod

from ..axes import mode_sizes
from ..filesize import planned_bytes
from ..fitting.fit import EFFORTS
from ..goals import misses
from ..model import Model
from ..narrow import BITS
from ..plan import LevelSpec, Plan
from ..streaming.budget import is_streamed
from .alternatives import (
    EITHER,
    ROUNDING_FROM,
    alternatives,
    below_rank_one,
    joined,
    narrower,
    nodes_of_clusters,
    with_bits,
    with_clusters_times,
)
from .finer import LARGE, finer, is_far_beyond, more_blocks, parted
from .follow import Task, limit_of
from .followed import Followed, best_of, fitted_with, further, is_verbatim, may_be
from .second_levels import ROUNDED, below_bytes, below_rounding, deeper

#: SNR in dB above which plans of two levels are tried: one level of float16 numbers may not reach it.
NEARLY = 64.0
#: Where a model of 16-bit numbers ends more than so many dB above an SNR goal, two levels of bytes are tried.
BEYOND = 3.0
#: These two levels of bytes are taken only if they need less than this share of its bytes.
LESS = 0.9
#: How far a model may lie behind the best, in dB for a size and in times the bytes for an SNR, for a search of other
#: numbers of clusters to start from it as well.
BEHIND = (1.5, 1.25)
#: The same for nodes of its clusters to be tried. A rival that promises to take more times the bytes is not fitted.
FAR_BEHIND = (6.0, 3.0)
#: How many clusters along two axes are tried first: for the goal, and for an SNR at a size besides.
JOINED = (4, 12)
#: Share of a model's bytes at which nodes for clusters along two axes are first compared for an SNR.
SPARED = 0.9
#: More or fewer of them are tried from so many dB below the SNR on.
CATCHING_UP = 3.0
#: How many times at most the number of blocks is raised to fill a size: their tables take some of it each time.
FILLS = 3
#: Share of the nodes below a first level that are taken to store ranks of one, where a plan's least bytes are told:
#: nodes whose rows are alike store nothing.
FILLED = 0.5
#: How many times at most plans are chosen anew under a value transform, while they miss the SNR.
AGAIN = 3
#: Elements up to which the number of clusters is looked for in all `STEPS`; of larger arrays in the last one alone.
IN_ALL_STEPS = 1 << 22
#: Factors by which the number of clusters is raised and lowered, one after the other; the first one from every start.
STEPS = (1.5, 1.25, 1.125)

#: Plans chosen anew, under a name of their own, for what is said beside it: other arguments of `choose_plan`, or `aim`,
#: what the SNR takes in dB of transformed values.
Choose = Callable[..., list[Plan]]


def follow_any(
    task: Task, others: Sequence[Plan], missed: Callable[[str], None], choose: Choose | None = None
) -> Followed:
    """Fit the task's plan and others, and return the best with its model: `best_of` says which that is.

    These plans are fitted, in this order:

    1. The task's plan, and beside it the `others` that are rivals: for a size all of them; for an SNR, of small arrays
       (`is_worth`) and of transformed values, all but the verbatim ones.
    2. Of small arrays plans like the best (`alternatives`), plans of two levels where rounding leaves too much for one,
       and more and fewer clusters of the data. Of larger ones that memory holds the best plan with bytes instead of
       float16 numbers, and plans of two levels where a size leads beyond 64 dB.
    3. Where the best ends far beyond its goal, as one rank more is a large step: the same plan with a `finer` choice of
       blocks, with merged modes parted and, for an SNR, the first of the others that are left.
    4. With `choose`, nodes for clusters along two axes, of arrays of up to 2^22 elements; and plans that are chosen
       anew by what the fit told, under a value transform and where bytes fall short (`_chosen_anew`).
    5. While an SNR is missed, one after another: bytes below a level of rank one, two levels of bytes, 16-bit numbers,
       a second level, and the others that are left.
    6. The values themselves as bytes or float16 numbers, where that may do better.

    Args:
        task: the plan, its goal and its source.
        others: the next best plans of the choice, the best first.
        missed: told in a sentence of every plan that is tried because the SNR is missed.
        choose: chooses plans for other arguments; None: none are chosen anew.
    """
    rivals = _rivals(task, others)
    followed, given = fitted_with(task, rivals, FAR_BEHIND[1]), task
    (task, model), followed = _compared(task, followed, others)
    left = [plan for plan in others if plan not in rivals]
    if is_far_beyond(task.plan, model.snr, model.nbytes):
        nearer = _nearer(task, model, left)
        again = nearer.model is not model and is_worth(nearer.task)
        task, model = _with_other_clusters(*nearer, STEPS[-1:], set()) if again else nearer
    if choose is not None:
        task, model = _joined(Followed(task, model))
        (task, model), left = _chosen_anew(given, Followed(task, model), left, choose)
    missing = [] if task.plan.snr is None else _spare(task, model, followed, left)
    return _unless_verbatim(_unless_missed(Followed(task, model), missing, missed))


def _rivals(task: Task, others: Sequence[Plan]) -> list[Plan]:
    """Those of the others that are fitted whatever the task's plan comes to."""
    # Of values that are transformed the trial knows the errors' size, not where they will be large.
    doubtful = task.plan.size is not None or not task.source.value_transform.is_identity or is_worth(task)
    rivals = [plan for plan in others if task.plan.size is not None or not is_verbatim(plan)] if doubtful else []
    hardly = (task.plan.snr or 0.0) > ROUNDED[max(BITS)]  # reached by one level
    return [plan for plan in rivals if not hardly or len(plan.levels) > 1]


def _compared(given: Task, followed: list[Followed], others: Sequence[Plan]) -> tuple[Followed, list[Followed]]:
    """The best of what was followed and of plans that only fits tell from it; and all that was followed before that."""
    task, model = own = best_of(followed)
    if is_worth(task):
        followed = [*followed, *further(task, _near(followed), own)]
        return _in_other_ways(given, own, followed, others), followed
    if not _is_held(task):
        return own, followed
    near = (plan for plan in narrower(task.plan, model.snr) if may_be(task, plan))
    two = below_rounding(given, []) if task.plan.snr is None and model.snr > NEARLY else ()
    return best_of([own, *further(task, near, own), *further(given, two, own)]), followed


def _in_other_ways(given: Task, own: Followed, followed: Sequence[Followed], others: Sequence[Plan]) -> Followed:
    """The best of all that was fitted, of plans of two levels, and of the same plans with more or fewer clusters.

    Two levels of bytes are tried for an SNR beyond what one keeps, or where 16-bit numbers end far above it; two levels
    of any numbers beyond 64 dB. Numbers of clusters are looked for from the best on, and from the best of the plans of
    the trial (`own`) unless that is far behind.
    """
    task, model = best_of(followed)
    wide, goal = task.plan.levels[-1].bits == max(BITS), task.plan.snr or model.snr
    if goal > ROUNDED[min(BITS)] or (wide and model.snr > goal + BEYOND):
        most, two = LESS * model.nbytes, further(task, below_bytes(task, followed), Followed(task, model))
        task, model = best_of([Followed(task, model), *(each for each in two if each.model.nbytes < most)])
    if (task.plan.snr or model.snr) > NEARLY:
        plans = dict.fromkeys(below_rounding(given, others))
        task, model = best_of([Followed(task, model), *further(given, plans, Followed(task, model))])
    behind = model is own.model or _is_behind(own.model, model, task.plan.snr, BEHIND)
    starts = [Followed(task, model)] if behind else [own, Followed(task, model)]
    first, *finer_steps = STEPS if prod(task.source.shape) <= IN_ALL_STEPS else STEPS[-1:]
    tried = set[Plan]()
    task, model = best_of([_with_other_clusters(*start, [first], tried) for start in starts])
    return _with_other_clusters(task, model, finer_steps, tried)


def _chosen_anew(given: Task, found: Followed, left: list[Plan], choose: Choose) -> tuple[Followed, list[Plan]]:
    """The best of what was found and of plans chosen anew where the fit tells more than the trial knew; and those left
    that were not fitted.

    Under a value transform errors are not alike everywhere, as the first choice took them to be: most are where values
    are large. So plans are chosen for as many dB of transformed values as the SNR takes by the two SNRs of what was
    found; for a size those of float16 numbers, as rounding counts for more, too. These also where bytes, for which the
    first plan was chosen, do not reach an SNR after all: what is best for them need not be best for others.
    """
    (task, model), goal, bits = found, given.plan.snr, max(BITS)
    transformed = not given.source.value_transform.is_identity
    if transformed and goal is not None:
        return _aimed_anew(found, goal, left, choose) if misses(model.snr, goal) or is_worth(given) else (found, left)
    fall_short = task.plan.levels[-1].bits == bits or misses(model.snr, goal)
    doubtful = transformed if goal is None else given.plan.levels[-1].bits < bits and fall_short
    if not doubtful or given.bits is not None or not is_worth(given):
        return found, left
    plans = filterfalse(is_verbatim, choose("plan-2", bits=bits))
    return best_of([found, *further(task, plans, found)]), left


def _aimed_anew(found: Followed, goal: float, left: list[Plan], choose: Choose) -> tuple[Followed, list[Plan]]:
    """The best of what was found and of plans chosen for other dB of the transformed values, again while these miss.

    A fit tells both SNRs, of the transformed values and of the values themselves. The transformed one is raised, or
    lowered, by what the other one lacks of the goal, or has too much.
    """
    for number in range(2, 2 + AGAIN):
        task, model = found
        transformed = model.metadata.transformed_snr_db[-1]
        aim = inf if transformed is None else transformed + goal - model.snr
        if not isfinite(aim) or (number > 2 and not misses(model.snr, goal)):
            break
        plans = [*filterfalse(is_verbatim, choose(f"plan-{number}", aim=aim))]
        fitted = plans if is_worth(task) else plans[:1]
        left = [*(plan for plan in plans if plan not in fitted), *filter(is_verbatim, left)]
        found = best_of([found, *further(task, fitted, found)])
    return found, left


def _spare(task: Task, model: Model, followed: Sequence[Followed], others: Sequence[Plan]) -> list[Plan]:
    """Plans to try while an SNR is missed, those of fewer bytes first: see step 5 of `follow_any`."""
    spare, below = list(others), deeper(task, model)
    if below is not None:
        spare.insert(0, below)
    if task.plan.levels[-1].bits < max(BITS):
        spare[:0] = [with_bits(task.plan, max(BITS))] if task.bits is None else []
        if below is None and is_worth(task) and model.snr < (task.plan.snr or model.snr):
            spare[:0] = below_bytes(task, followed)
        spare[:0] = below_rank_one(task.plan, min(BITS)) if model.snr > ROUNDING_FROM[min(BITS)] else []
    return spare


def _unless_missed(best: Followed, spare: Sequence[Plan], missed: Callable[[str], None]) -> Followed:
    """The best, or where it misses its SNR the first of the spare plans that does not, or the nearest."""
    goal, last = best.task.plan.snr or 0.0, best
    for plan in spare:
        if best.model.snr >= goal:
            break
        missed(f"a plan chosen for {goal:g} dB came to {last.model.snr:.2f}: another is tried, {plan}")
        for last in further(best.task, [plan]):
            best = max(best, last, key=lambda each: each.model.snr)
    return best


def _near(followed: Sequence[Followed]) -> Sequence[Plan]:
    """Alternatives of the best with each number of bits, as which of these is better may hang on them; and nodes of the
    clusters of all."""
    plans, tried = dict[Plan, None](), {task.plan for task, _ in followed}
    for bits in BITS:
        if of_bits := [each for each in followed if each.task.plan.levels[-1].bits == bits]:
            task, model = best_of(of_bits)
            near = alternatives(task.plan, task.source.organisation(None), model.snr, model.nbytes)
            plans |= {plan: None for plan in near if may_be(task, plan) and plan not in tried}
    task, best = best_of(followed)
    for other, model in followed:
        if not _is_behind(model, best, task.plan.snr, FAR_BEHIND):
            plans |= dict.fromkeys(nodes_of_clusters(other.plan))
    return _fitting(task, plans, best)


def is_worth(task: Task) -> bool:
    """Whether other plans like it are fitted as well: where that takes seconds, unless it should be fast."""
    return prod(task.source.shape) <= LARGE and _is_held(task)


def _is_small(task: Task) -> bool:
    """Whether numbers of clusters are looked for in all steps."""
    return is_worth(task) and prod(task.source.shape) <= IN_ALL_STEPS


def _is_held(task: Task) -> bool:
    """Whether memory holds the array, and plans are compared at all."""
    compared = task.run.effort.candidates > EFFORTS["fast"].candidates
    return compared and not is_streamed(prod(task.source.shape), limit_of(task))


def _unless_verbatim(best: Followed) -> Followed:
    """The best, or the values as they are, as bytes or float16, where these do better."""
    task, found = best.task, best
    for bits in BITS:
        plan = replace(task.plan, levels=(LevelSpec.of_one_cell((None,) * len(task.plan.organisation), bits),))
        is_there = is_verbatim(best.model.plan) and best.model.plan.levels[-1].bits == bits
        tried = not is_there and may_be(task, plan) and (task.plan.snr is not None or is_worth(task))
        if tried and _verbatim_bytes(task, plan) < (task.plan.size or found.model.nbytes):
            found = best_of([found, *further(task, [plan])])
    return found


def _verbatim_bytes(task: Task, plan: Plan) -> int:
    """What the values take at least as numbers of the plan's last level."""
    return plan.levels[-1].bits // 8 * prod(task.source.shape)


def _nearer(task: Task, model: Model, others: Sequence[Plan]) -> Followed:
    """The best of a model beyond its goal and those of plans that may come nearer to it."""
    own = finer(task.plan, task.source.axes)
    plans = [*([] if own is None else [own]), *parted(task.plan, task.source.axes)]
    next_best = others[:1] if task.plan.snr is not None else ()
    plans += [plan for plan in next_best if not is_verbatim(plan) or model.nbytes > _verbatim_bytes(task, plan)]
    return best_of([_filled(task, model), *further(task, plans, Followed(task, model))])


def _joined(own: Followed) -> Followed:
    """The best of a model and of nodes for clusters along two axes at a time."""
    task = own.task
    if not _is_small(task) or misses(own.model.snr, task.plan.snr):
        return own
    few, more = (list(joined(task.plan, task.source.organisation(None), count)) for count in JOINED)
    found = best_of([own, *further(task, _fitting(task, few, own.model), own)])
    found = found if found is own else _with_other_clusters(*found, STEPS, set())
    return best_of([found, _in_fewer_bytes(own, more)])


def _in_fewer_bytes(own: Followed, begin: Sequence[Plan]) -> Followed:
    """For an SNR the best of a model and of what reaches it in fewer bytes, by numbers of clusters that suit these."""
    task, goal = own.task, own.task.plan.snr
    if goal is None or (least := _least_reaching(own, goal, begin)) is None:
        return own
    as_asked = replace(task, plan=replace(least.task.plan, snr=goal, size=None))
    return best_of([own, Followed(as_asked, least.model), *further(task, [as_asked.plan], own)])


def _least_reaching(own: Followed, goal: float, begin: Sequence[Plan]) -> Followed | None:
    """What reaches an SNR in the fewest bytes, of some plans to begin with and their like with more or fewer clusters.

    How many clusters there should be shows in dB at a size, where every few more help, long before it shows in the
    bytes that an SNR takes. So they are compared at a size, fewer bytes than there are now, until one reaches the SNR;
    then at half of it. None: not one does at the first size, or all are far from it with the clusters to begin with.
    """
    found, size = None, int(SPARED * own.model.nbytes)
    bits = min(BITS) if own.task.bits is None and goal < EITHER[0] else own.task.plan.levels[-1].bits
    while True:
        at_size = [replace(with_bits(plan, bits), snr=None, size=size) for plan in begin]
        if not (tried := [*further(own.task, _fitting(own.task, at_size, own.model))]):
            return found
        best = best_of(tried)
        if found is None and best.model.snr < goal - CATCHING_UP:
            return None
        if misses(best.model.snr, goal):
            best = _with_other_clusters(*best, STEPS, set())
        if misses(best.model.snr, goal):
            return found
        found, size, begin = best, size // 2, [best.task.plan]


def _filled(task: Task, model: Model) -> Followed:
    """With as many more blocks as a size has room for, where a rank more of all takes too much."""
    found, size = Followed(task, model), task.plan.size or 0
    for _ in range(FILLS):
        task, model = found
        plan = more_blocks(task.plan, task.source.axes, size / model.nbytes)
        if plan is None or not is_far_beyond(task.plan, model.snr, model.nbytes):
            break
        found = best_of([found, *further(task, [plan])])
        if found.model is model:
            break
    return found


def _with_other_clusters(task: Task, model: Model, steps: Sequence[float], tried: set[Plan]) -> Followed:
    """The best of more clusters of the data and of fewer, in such steps while that helps; none that was `tried`."""
    found = Followed(task, model)
    tried.add(task.plan)
    for step in steps:
        before = None
        while found is not before:
            before, near = found, (with_clusters_times(found.task.plan, factor) for factor in (step, 1 / step))
            plans = [plan for plan in near if plan is not None and plan not in tried and _fits(task, plan, found.model)]
            tried.update(plans)
            found = best_of([found, *further(task, plans, found)])
    return found


def _is_behind(model: Model, best: Model, snr: float | None, far: tuple[float, float]) -> bool:
    """Whether it is so `far` from the best, for a size in dB, for an SNR in times its bytes."""
    return model.snr < best.snr - far[0] if snr is None else model.nbytes > far[1] * best.nbytes


def _fitting(task: Task, plans: Iterable[Plan], best: Model) -> list[Plan]:
    """Those that there are rows and bytes for."""
    return [plan for plan in plans if _fits(task, plan, best)]


def _fits(task: Task, plan: Plan, best: Model) -> bool:
    """Whether there are rows for its clusters, and before these are looked for room for ranks of one, in a size or the
    bytes of the best for an SNR; below a first level, of ranks of one in a share of the nodes."""
    sizes = mode_sizes(task.source.axes, plan.organisation)
    if any(clusters > size for clusters, size in zip(plan.levels[0].clusters, sizes, strict=True)):
        return False
    first, *below = (
        replace(level.ways(plan.organisation)[0], ranks=tuple(rank and 1 for rank in level.ranks), own=False)
        for level in plan.levels
    )
    least = planned_bytes(replace(plan, levels=(first,)), task.source)
    if below:
        least += int(FILLED * (planned_bytes(replace(plan, levels=(first, *below)), task.source) - least))
    snr, size = task.plan.snr, task.plan.size
    return least <= (size if size is not None else best.nbytes if snr is None or best.snr >= snr else inf)
