"""Compare plans by their fits, where a sample does not tell which is best or the first misses its goal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import inf, prod

from .alternatives import (
    ROUNDING_FROM,
    alternatives,
    below_rank_one,
    narrower,
    nodes_of_clusters,
    with_bits,
    with_clusters_times,
)
from .axes import mode_sizes
from .filesize import planned_bytes
from .finer import LARGE, finer, is_far_beyond, more_blocks, parted
from .fit import EFFORTS
from .follow import Task
from .followed import Followed, best_of, fitted_with, further, is_verbatim, may_be
from .model import Model
from .narrow import BITS
from .plan import Plan
from .predict import is_streamed, memory_limit
from .second_levels import ROUNDED, below_bytes, below_rounding, deeper

#: From so many dB on a second level is tried; so many dB beyond its goal is far; a second level must save a tenth.
NEARLY, BEYOND, LESS = 64.0, 3.0, 0.9
#: A model that lies so many dB behind another, or takes so many times its bytes, stays there whatever the number of
#: clusters; and if so many, also with nodes of them.
BEHIND, FAR_BEHIND = (1.5, 1.25), (6.0, 3.0)
#: How often blocks are made more to fill a size: tables of blocks take some of it each time.
FILLS = 3
#: Of nodes, those of like rows take no rank: so many at least are taken to have one.
FILLED = 0.5
#: Elements up to which numbers of clusters are told apart by fits in all steps, the first from each start.
IN_ALL_STEPS, STEPS = 1 << 22, (1.5, 1.25, 1.125)


def follow_any(task: Task, others: Sequence[Plan], missed: Callable[[str], None]) -> Model:
    """The model of the task's plan; where it misses its SNR, of the first further plan that does not, or the best.

    Further are the same plan with a level more, for what float16 or the ranks of one leave, and then the `others`;
    `missed` is told of every plan that missed. For a size, and where that takes no more than seconds, the others are
    rivals, of which the best is kept. It is then compared with its `alternatives`, with more and fewer clusters of the
    data, and beyond what float16 keeps of one level with plans of two. Where ranks are such large steps that a model
    lies far beyond its goal, the same plan with a `finer` choice of blocks is tried, and for an SNR the first of the
    others.
    """
    rivals = _rivals(task, others)
    followed = fitted_with(task, rivals, FAR_BEHIND[1])
    (task, model), followed = _compared(task, followed, others)
    left = [plan for plan in others if plan not in rivals]
    if is_far_beyond(task.plan, model.snr, model.nbytes):
        nearer = _nearer(task, model, left)
        again = nearer[1] is not model and _is_worth(nearer[0])
        task, model = _with_other_clusters(*nearer, STEPS[-1:], set()) if again else nearer
    if task.plan.snr is None:
        return model
    best = _unless_missed(task, model, _spare(task, model, followed, left), missed)
    return _unless_verbatim(task, best, left)


def _rivals(task: Task, others: Sequence[Plan]) -> list[Plan]:
    """Those of the others that are fitted whatever the task's plan comes to."""
    # Of values that are transformed the trial knows the errors' size, not where they will be large.
    doubtful = task.plan.size is not None or task.source.value_transform.name != "identity" or _is_worth(task)
    rivals = [plan for plan in others if task.plan.size is not None or not is_verbatim(plan)] if doubtful else []
    hardly = (task.plan.snr or 0.0) > ROUNDED[max(BITS)]  # reached by one level
    return [plan for plan in rivals if not hardly or len(plan.levels) > 1]


def _compared(given: Task, followed: list[Followed], others: Sequence[Plan]) -> tuple[Followed, list[Followed]]:
    """The best of what was followed and of plans that only fits tell from it; and all that was followed before that."""
    own = task, model = best_of(followed)
    if _is_worth(task):
        followed = [*followed, *further(task, _near(followed), own)]
        return _in_other_ways(given, own, followed, others), followed
    if not _is_held(task):
        return own, followed
    near = (plan for plan in narrower(task.plan, model.snr) if may_be(task, plan))
    two = below_rounding(given, []) if task.plan.snr is None and model.snr > NEARLY else ()
    return best_of([own, *further(task, near, own), *further(given, two, own)]), followed


def _in_other_ways(given: Task, own: Followed, followed: Sequence[Followed], others: Sequence[Plan]) -> Followed:
    """The best of what was followed, of plans of two levels where these may do better, and of other numbers of clusters
    from there and from the best of the trial's `own` on."""
    task, model = best_of(followed)
    if task.plan.levels[-1].bits == max(BITS) and model.snr > (task.plan.snr or model.snr) + BEYOND:
        most, two = LESS * model.nbytes, further(task, below_bytes(task, followed), (task, model))
        task, model = best_of([(task, model), *(each for each in two if each[1].nbytes < most)])
    if (task.plan.snr or model.snr) > NEARLY:
        plans = dict.fromkeys(below_rounding(given, others))
        task, model = best_of([(task, model), *further(given, plans, (task, model))])
    behind = model is own[1] or _is_behind(own[1], model, task.plan.snr, BEHIND)
    starts = [(task, model)] if behind else [own, (task, model)]
    first, *finer_steps = STEPS if prod(task.source.shape) <= IN_ALL_STEPS else STEPS[-1:]
    tried = set[Plan]()
    task, model = best_of([_with_other_clusters(*start, [first], tried) for start in starts])
    return _with_other_clusters(task, model, finer_steps, tried)


def _spare(task: Task, model: Model, followed: Sequence[Followed], others: Sequence[Plan]) -> list[Plan]:
    """Plans for an SNR that the model has missed, those of fewer bytes first."""
    spare, below = list(others), deeper(task, model)
    if below is not None:
        spare.insert(0, below)
    if task.plan.levels[-1].bits < max(BITS):
        spare[:0] = [with_bits(task.plan, max(BITS))] if task.bits is None else []
        if below is None and _is_worth(task) and model.snr < (task.plan.snr or model.snr):
            spare[:0] = below_bytes(task, followed)
        spare[:0] = below_rank_one(task.plan, min(BITS)) if model.snr > ROUNDING_FROM[min(BITS)] else []
    return spare


def _unless_missed(task: Task, model: Model, spare: Sequence[Plan], missed: Callable[[str], None]) -> Model:
    """The model, or where it misses its SNR the first of the spare plans that does not, or the nearest."""
    goal, best = task.plan.snr or 0.0, model
    for plan in spare:
        if best.snr >= goal:
            break
        missed(f"a plan chosen for {goal:g} dB came to {model.snr:.2f}: another is tried, {plan}")
        for _, model in further(task, [plan]):
            best = max(best, model, key=lambda each: each.snr)
    return best


def _near(followed: Sequence[Followed]) -> Sequence[Plan]:
    """Alternatives of the best with each number of bits, as which of these is better may hang on them; and nodes of the
    clusters of all."""
    plans, tried = dict[Plan, None](), {task.plan for task, _ in followed}
    for bits in BITS:
        if of_bits := [each for each in followed if each[0].plan.levels[-1].bits == bits]:
            task, model = best_of(of_bits)
            near = alternatives(task.plan, task.source.organisation(None), model.snr, model.nbytes)
            plans |= {plan: None for plan in near if may_be(task, plan) and plan not in tried}
    task, best = best_of(followed)
    for other, model in followed:
        if not _is_behind(model, best, task.plan.snr, FAR_BEHIND):
            plans |= dict.fromkeys(nodes_of_clusters(other.plan))
    return [plan for plan in plans if _fits(task, plan, best)]


def _is_worth(task: Task) -> bool:
    """Whether other plans like it are fitted as well: where that takes seconds, unless it should be fast."""
    return prod(task.source.shape) <= LARGE and _is_held(task)


def _is_held(task: Task) -> bool:
    """Whether memory holds the array, and plans are compared at all."""
    sizes = mode_sizes(task.source.axes, task.plan.organisation)
    streamed = is_streamed(prod(task.source.shape), memory_limit(task.plan, sizes, task.memory))
    return not streamed and task.run.effort.candidates > EFFORTS["fast"].candidates


def _unless_verbatim(task: Task, best: Model, others: Sequence[Plan]) -> Model:
    """The model for an SNR, or the values as float16 if that takes fewer bytes and does as well."""
    if best.nbytes <= _verbatim_bytes(task, task.plan) or is_verbatim(best.plan):
        return best
    for _, model in further(task, filter(is_verbatim, others)):
        if model.nbytes < best.nbytes and model.snr >= min(best.snr, task.plan.snr or best.snr):
            return model
    return best


def _verbatim_bytes(task: Task, plan: Plan) -> int:
    """What the values take at least as numbers of the plan's last level."""
    return plan.levels[-1].bits // 8 * prod(task.source.shape)


def _nearer(task: Task, model: Model, others: Sequence[Plan]) -> Followed:
    """The best of a model beyond its goal and those of plans that may come nearer to it."""
    own = finer(task.plan, task.source.axes)
    plans = [*([] if own is None else [own]), *parted(task.plan, task.source.axes)]
    next_best = others[:1] if task.plan.snr is not None else ()
    plans += [plan for plan in next_best if not is_verbatim(plan) or model.nbytes > _verbatim_bytes(task, plan)]
    return best_of([_filled(task, model), *further(task, plans, (task, model))])


def _filled(task: Task, model: Model) -> Followed:
    """With as many more blocks as a size has room for, where a rank more of all takes too much."""
    found, size = (task, model), task.plan.size or 0
    for _ in range(FILLS):
        task, model = found
        plan = more_blocks(task.plan, task.source.axes, size / model.nbytes)
        if plan is None or not is_far_beyond(task.plan, model.snr, model.nbytes):
            break
        found = best_of([found, *further(task, [plan])])
        if found[1] is model:
            break
    return found


def _with_other_clusters(task: Task, model: Model, steps: Sequence[float], tried: set[Plan]) -> Followed:
    """The best of more clusters of the data and of fewer, in such steps while that helps; none that was `tried`."""
    found = task, model
    tried.add(task.plan)
    for step in steps:
        before = None
        while found is not before:
            before, near = found, (with_clusters_times(found[0].plan, factor) for factor in (step, 1 / step))
            plans = [plan for plan in near if plan is not None and plan not in tried and _fits(task, plan, found[1])]
            tried.update(plans)
            found = best_of([found, *further(task, plans, found)])
    return found


def _is_behind(model: Model, best: Model, snr: float | None, far: tuple[float, float]) -> bool:
    """Whether it is so `far` from the best, for a size in dB, for an SNR in times its bytes."""
    return model.snr < best.snr - far[0] if snr is None else model.nbytes > far[1] * best.nbytes


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
