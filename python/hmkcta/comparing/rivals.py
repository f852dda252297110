"""Compare plans by their fits, where a sample does not tell which is best or the first misses its goal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import filterfalse
from math import inf, isfinite, prod

from ..goals import misses
from ..model import Model
from ..narrow import BITS
from ..plan import LevelSpec, Plan
from .alternatives import (
    ROUNDING_FROM,
    alternatives,
    below_rank_one,
    first_in_bytes,
    narrower,
    nodes_of_clusters,
    with_bits,
)
from .cluster_counts import FINEST, with_best_clusters, with_joined, with_other_clusters
from .finer import finer, has_large_steps, is_far_beyond, more_blocks, parted
from .follow import Task
from .followed import (
    Followed,
    best_of,
    fitted_with,
    fitting,
    further,
    is_behind,
    is_held,
    is_verbatim,
    is_worth,
    may_be,
)
from .second_levels import PACKED, ROUNDED, below_rounding, deeper, packed_below_bytes, whole_of, with_packed_below

#: SNR in dB above which plans of two levels are tried: one level of float16 numbers may not reach it.
NEARLY = 64.0
#: SNR in dB above which packed numbers are tried below a level of float16 ones.
PACKED_END = 60.0
#: Where a model of 16-bit numbers ends more than so many dB above an SNR goal, two levels of fewer bits are tried.
BEYOND = 3.0
#: These two levels are taken only if they need less than this share of its bytes.
LESS = 0.9
#: The same for nodes of its clusters to be tried. A rival that promises to take more times the bytes is not fitted.
FAR_BEHIND = (6.0, 3.0)
#: How many times at most the number of blocks is raised to fill a size: their tables take some of it each time.
FILLS = 3
#: How many times at most plans are chosen anew under a value transform, while they miss the SNR.
AGAIN = 3

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
    2. Of small arrays plans like the best (`alternatives`), the whole without blocks or clusters, plans of two levels
       where rounding leaves too much for one, more and fewer clusters of the data, and bytes in a first level. Of
       larger ones that memory holds the best plan, packed instead of float16 numbers, and plans of two levels where a
       size leads beyond 64 dB.
    3. Where the best ends far beyond its goal, or one rank more is a large step: the same plan with a `finer` choice of
       blocks, with merged modes parted and, for an SNR, the first of the others that are left.
    4. With `choose`, nodes for clusters along two axes, of arrays of up to 2^22 elements; and plans that are chosen
       anew by what the fit told, under a value transform and where packed numbers fall short (`_chosen_anew`).
    5. While an SNR is missed, one after another: packed numbers below a level of rank one, or below one of bytes,
       16-bit numbers, a second level, and the others that are left.
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
    few = is_worth(task) and not misses(model.snr, task.plan.snr) and has_large_steps(model.plan)
    if few or is_far_beyond(task.plan, model.snr, model.nbytes):
        nearer = _nearer(task, model, left)
        again = nearer.model is not model and is_worth(nearer.task)
        task, model = with_other_clusters(nearer, [FINEST], set()) if again else nearer
    if choose is not None:
        task, model = with_joined(Followed(task, model))
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
        return _in_other_ways(given, followed, others), followed
    if not is_held(task):
        return own, followed
    near = (plan for plan in narrower(task.plan, model.snr) if may_be(task, plan))
    two = below_rounding(given, []) if task.plan.snr is None and model.snr > NEARLY else ()
    return best_of([own, *further(task, near, own), *further(given, two, own)]), followed


def _in_other_ways(given: Task, followed: Sequence[Followed], others: Sequence[Plan]) -> Followed:
    """The best of all that was fitted, of plans of two levels, and of the same plans with more or fewer clusters.

    Packed numbers below a level of bytes are tried for an SNR beyond what one level keeps, or where 16-bit numbers end
    far above it; two levels of any numbers beyond 64 dB.
    """
    task, model = best_of(followed)
    wide, goal = task.plan.levels[-1].bits == max(BITS), task.plan.snr or model.snr
    if goal > PACKED or (wide and model.snr > goal + BEYOND):
        most, two = LESS * model.nbytes, further(task, packed_below_bytes(task, followed), Followed(task, model))
        task, model = best_of([Followed(task, model), *(each for each in two if each.model.nbytes < most)])
    if (task.plan.snr or model.snr) > PACKED_END:
        task, model = with_packed_below(Followed(task, model), followed)
    if (task.plan.snr or model.snr) > NEARLY:
        plans = dict.fromkeys(below_rounding(given, others))
        task, model = best_of([Followed(task, model), *further(given, plans, Followed(task, model))])
    best = with_best_clusters(Followed(task, model), followed)
    plans = first_in_bytes(best.task.plan, best.model.snr) if task.bits is None else ()
    return best_of([best, *further(best.task, plans, best)])


def _chosen_anew(given: Task, found: Followed, left: list[Plan], choose: Choose) -> tuple[Followed, list[Plan]]:
    """The best of what was found and of plans chosen anew where the fit tells more than the trial knew; and those left
    that were not fitted.

    Under a value transform errors are not alike everywhere, as the first choice took them to be: most are where values
    are large. So plans are chosen for as many dB of transformed values as the SNR takes by the two SNRs of what was
    found; for a size those of float16 numbers, as rounding counts for more, too. These also where packed numbers do not
    reach an SNR after all, though the first plan was chosen for them: they need other blocks, it may be.
    """
    (task, model), goal, bits = found, given.plan.snr, max(BITS)
    transformed = not given.source.value_transform.is_identity
    if transformed and goal is not None:
        return _aimed_anew(found, goal, left, choose) if misses(model.snr, goal) or is_worth(given) else (found, left)
    fall_short = not _is_packed(task.plan) or misses(model.snr, goal)
    doubtful = transformed if goal is None else given.plan.levels[-1].bits < bits and fall_short
    if not doubtful or given.bits is not None or not is_worth(given):
        return found, left
    plans = filterfalse(is_verbatim, choose("plan-2", bits=bits))
    return best_of([found, *further(task, plans, found)]), left


def _is_packed(plan: Plan) -> bool:
    """Whether one packed level does, alone or below ranks of one."""
    *above, last = plan.levels
    return last.bits < max(BITS) and all((rank or 1) == 1 for level in above for rank in level.ranks)


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
            spare[:0] = packed_below_bytes(task, followed)
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
    """Alternatives of the best with each number of bits, as which of these is better may hang on them; the whole,
    uncut; and nodes of the clusters of all."""
    plans, tried = dict[Plan, None](), {task.plan for task, _ in followed}
    for bits in BITS:
        if of_bits := [each for each in followed if each.task.plan.levels[-1].bits == bits]:
            task, model = best_of(of_bits)
            near = alternatives(task.plan, task.source.organisation(None), model.snr, model.nbytes)
            plans |= {plan: None for plan in near if may_be(task, plan) and plan not in tried}
    task, best = best_of(followed)
    whole = with_bits(whole_of(task), task.bits or min(BITS))
    if whole not in tried:
        plans[whole] = None
    for other, model in followed:
        if not is_behind(model, best, task.plan.snr, FAR_BEHIND):
            plans |= dict.fromkeys(nodes_of_clusters(other.plan))
    return fitting(task, plans, best)


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
