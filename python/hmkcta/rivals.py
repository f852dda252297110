"""Compare plans by their fits, where a sample does not tell which is best or the first misses its goal."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from math import inf, prod

from .alternatives import (
    ROUNDING_FROM,
    alternatives,
    below_rank_one,
    narrower,
    nodes_of_clusters,
    whole_plan,
    with_bits,
    with_clusters_times,
)
from .axes import mode_sizes
from .errors import HmkctaError
from .filesize import planned_bytes
from .finer import LARGE, finer, is_coarse, parted
from .fit import EFFORTS
from .follow import Task, follow
from .model import Model
from .narrow import BITS
from .plan import Plan
from .predict import is_streamed, memory_limit

#: From so many dB on a second level is tried, below a first that ends at as many as float16 keeps of one, and at no
#: less than so many; up to so many also one of bytes.
NEARLY, ROUNDED, SHORT, BOTH = 64.0, 68.0, 40.0, 106.0
#: So many dB beyond its goal is far; so many bytes keep of most values; a second level must save a tenth.
BEYOND, OF_BYTES, LESS = 3.0, 36.0, 0.9
#: A model that lies so many dB behind another, or takes so many times its bytes, stays there whatever the number of
#: clusters; and if so many, also with nodes of them.
BEHIND, FAR_BEHIND = (1.5, 1.25), (6.0, 3.0)
#: Elements up to which numbers of clusters are told apart by fits in all steps, the first from each start.
SMALL, STEPS = 1 << 22, (1.5, 1.25, 1.125)

#: A task with a plan, and the model that it came to.
Followed = tuple[Task, Model]


def follow_any(task: Task, others: Sequence[Plan], missed: Callable[[str], None]) -> Model:
    """The model of the task's plan; where it misses its SNR, of the first further plan that does not, or the best.

    Further are the same plan with a level more, for what float16 or the ranks of one leave, and then the `others`;
    `missed` is told of every plan that missed. For a size, and where that takes no more than seconds, the others are
    rivals, of which the best is kept. It is then compared with its `alternatives`, with more and fewer clusters of the
    data, and beyond what float16 keeps of one level with plans of two. Where ranks are such large steps that a model
    lies far beyond its goal, the same plan with a `finer` choice of blocks is tried, and for an SNR the first of the
    others.
    """
    # Of values that are transformed the trial knows the errors' size, not where they will be large.
    doubtful = task.plan.size is not None or task.source.value_transform.name != "identity" or _is_worth(task)
    rivals = [plan for plan in others if task.plan.size is not None or not _is_verbatim(plan)] if doubtful else []
    if (task.plan.snr or 0.0) > ROUNDED:  # which one level hardly reaches
        rivals = [plan for plan in rivals if len(plan.levels) > 1]
    given, followed = task, [(task, follow(task)), *_further(task, rivals)]
    own = task, model = _best(followed)
    if _is_worth(task):
        followed += _further(task, _near(followed))
        task, model = _compared(given, own, followed, others)
    elif _is_held(task):
        near = (plan for plan in narrower(task.plan, model.snr) if _may_be(task, plan))
        two = _in_two(given, []) if task.plan.snr is None and model.snr > NEARLY else ()
        task, model = _best([(task, model), *_further(task, near), *_further(given, two)])
    best, others = model, [plan for plan in others if plan not in rivals]
    if is_coarse(task.plan, model.snr, model.nbytes):
        task, model = _nearer(task, model, others)
        again = model is not best and _is_worth(task)
        return _with_other_clusters(task, model, STEPS[-1:], set())[1] if again else model
    for plan in _spare(task, model, followed, others):
        if task.plan.snr is None or best.snr >= task.plan.snr:
            break
        missed(f"a plan chosen for {task.plan.snr:g} dB came to {model.snr:.2f}: another is tried, {plan}")
        for _, model in _further(task, [plan]):
            best = max(best, model, key=lambda each: each.snr)
    return best if task.plan.snr is None else _unless_verbatim(task, best, others)


def _compared(given: Task, own: Followed, followed: Sequence[Followed], others: Sequence[Plan]) -> Followed:
    """The best of what was followed, of plans of two levels where these may do better, and of other numbers of clusters
    from there and from the best of the trial's `own` on."""
    task, model = _best(followed)
    if task.plan.levels[-1].bits == BITS[0] and model.snr > (task.plan.snr or model.snr) + BEYOND:
        most, two = LESS * model.nbytes, _further(task, _two_of_bytes(followed, task))
        task, model = _best([(task, model), *(each for each in two if each[1].nbytes < most)])
    if (task.plan.snr or model.snr) > NEARLY:
        task, model = _best([(task, model), *_further(given, dict.fromkeys(_in_two(given, others)))])
    behind = model is own[1] or _is_behind(own[1], model, task.plan.snr, BEHIND)
    starts = [(task, model)] if behind else [own, (task, model)]
    first, *finer_steps = STEPS if prod(task.source.shape) <= SMALL else STEPS[-1:]
    tried = set[Plan]()
    task, model = _best([_with_other_clusters(*start, [first], tried) for start in starts])
    return _with_other_clusters(task, model, finer_steps, tried)


def _spare(task: Task, model: Model, followed: Sequence[Followed], others: Sequence[Plan]) -> list[Plan]:
    """Plans for an SNR that the model has missed, those of fewer bytes first."""
    spare, deeper = list(others), _deeper(task, model)
    if deeper is not None:
        spare.insert(0, deeper)
    if task.plan.levels[-1].bits < BITS[0]:
        spare[:0] = [with_bits(task.plan, BITS[0])] if task.bits is None else []
        if deeper is None and _is_worth(task) and model.snr < (task.plan.snr or model.snr):
            spare[:0] = _two_of_bytes(followed, task)
        spare[:0] = below_rank_one(task.plan, BITS[1]) if model.snr > ROUNDING_FROM[BITS[1]] else []
    return spare


def _near(followed: Sequence[Followed]) -> Sequence[Plan]:
    """Alternatives of the best with each number of bits, as which of these is better may hang on them; and nodes of the
    clusters of all."""
    plans, tried = dict[Plan, None](), {task.plan for task, _ in followed}
    for bits in BITS:
        if of_bits := [each for each in followed if each[0].plan.levels[-1].bits == bits]:
            task, model = _best(of_bits)
            near = alternatives(task.plan, task.source.organisation(None), model.snr, model.nbytes)
            plans |= {plan: None for plan in near if _may_be(task, plan) and plan not in tried}
    task, best = _best(followed)
    for other, model in followed:
        if not _is_behind(model, best, task.plan.snr, FAR_BEHIND):
            plans |= dict.fromkeys(nodes_of_clusters(other.plan))
    return [plan for plan in plans if _fits(task, plan, best)]


def _two_of_bytes(followed: Sequence[Followed], task: Task) -> list[Plan]:
    """For an SNR a plan of bytes with a level below it for what bytes leave of themselves.

    Its first level is that of the plan of bytes that came nearest, or else the last of the task's, alone.
    """
    (*above, last), goal = task.plan.levels, task.plan.snr
    if goal is None or not _may_be(task, with_bits(task.plan, BITS[1])):
        return []
    short = [each for each in followed if each[0].plan.levels[-1].bits == BITS[1] and each[1].snr < goal]
    deeper = [_deeper(*each) for each in sorted(short, key=lambda each: -each[1].snr)]
    if not any(deeper) and last.own and all(level.cells == 1 for level in above):
        alone = replace(task.plan, levels=(replace(last, bits=BITS[1]),), snr=min(goal, OF_BYTES))
        deeper = [_deeper(*each) for each in _further(task, [alone])]
    return [replace(plan, snr=goal) for plan in deeper if plan is not None][:1]


def _may_be(task: Task, plan: Plan) -> bool:
    """Whether numbers have the bits that are asked for."""
    return task.bits in (None, plan.levels[-1].bits)


def _is_worth(task: Task) -> bool:
    """Whether other plans like it are fitted as well: where that takes seconds, unless it should be fast."""
    return prod(task.source.shape) <= LARGE and _is_held(task)


def _is_held(task: Task) -> bool:
    """Whether memory holds the array, and plans are compared at all."""
    sizes = mode_sizes(task.source.axes, task.plan.organisation)
    streamed = is_streamed(prod(task.source.shape), memory_limit(task.plan, sizes, task.memory))
    return not streamed and task.run.effort.candidates > EFFORTS["fast"].candidates


def _best(followed: Sequence[Followed]) -> Followed:
    """For a size the model of the highest SNR; for an SNR the smallest that reaches it, or the nearest if none does."""
    snr, nearest = followed[0][0].plan.snr, max(followed, key=lambda each: each[1].snr)
    if snr is None:
        return nearest
    return min((each for each in followed if each[1].snr >= snr), key=lambda each: each[1].nbytes, default=nearest)


def _unless_verbatim(task: Task, best: Model, others: Sequence[Plan]) -> Model:
    """The model for an SNR, or the values as float16 if that takes fewer bytes and does as well."""
    if best.nbytes <= _verbatim_bytes(task, task.plan) or _is_verbatim(best.plan):
        return best
    for _, model in _further(task, filter(_is_verbatim, others)):
        if model.nbytes < best.nbytes and model.snr >= min(best.snr, task.plan.snr or best.snr):
            return model
    return best


def _is_verbatim(plan: Plan) -> bool:
    """Whether it leaves the values as they are."""
    return len(plan.levels) == 1 and not any(plan.levels[0].ranks)


def _verbatim_bytes(task: Task, plan: Plan) -> int:
    """What the values take at least as numbers of the plan's last level."""
    return plan.levels[-1].bits // 8 * prod(task.source.shape)


def _nearer(task: Task, model: Model, others: Sequence[Plan]) -> Followed:
    """The best of a model beyond its goal and those of plans that may come nearer to it."""
    own = finer(task.plan, task.source.axes)
    plans = [*([] if own is None else [own]), *parted(task.plan, task.source.axes)]
    next_best = others[:1] if task.plan.snr is not None else ()
    plans += [plan for plan in next_best if not _is_verbatim(plan) or model.nbytes > _verbatim_bytes(task, plan)]
    return _best([(task, model), *_further(task, plans)])


def _further(task: Task, plans: Iterable[Plan]) -> Iterator[Followed]:
    """Models of further plans, except those that cannot be followed: there is a model already.

    The least file of such a plan is larger than the goal, or memory does not do; or it is of another organisation than
    the one given.
    """
    for plan in plans:
        if task.organised and plan.organisation != task.plan.organisation:
            continue
        further = replace(task, plan=plan)
        try:
            model = follow(further)
        except HmkctaError as error:
            if error.reason not in ("size-too-small", "memory"):
                raise
            continue
        yield further, model


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
            found = _best([found, *_further(task, plans)])
    return found


def _is_behind(model: Model, best: Model, snr: float | None, far: tuple[float, float]) -> bool:
    """Whether it is so `far` from the best, for a size in dB, for an SNR in times its bytes."""
    return model.snr < best.snr - far[0] if snr is None else model.nbytes > far[1] * best.nbytes


def _fits(task: Task, plan: Plan, best: Model) -> bool:
    """Whether there are rows for its clusters, and before these are looked for room for ranks of one, in a size or the
    bytes of the best for an SNR."""
    sizes = mode_sizes(task.source.axes, plan.organisation)
    if any(clusters > size for clusters, size in zip(plan.levels[0].clusters, sizes, strict=True)):
        return False
    least = (replace(level, ranks=tuple(rank and 1 for rank in level.ranks), own=False) for level in plan.levels)
    snr, size = task.plan.snr, task.plan.size
    most = size if size is not None else best.nbytes if snr is None or best.snr >= snr else inf
    return planned_bytes(replace(plan, levels=tuple(least)), task.source) <= most


def _in_two(task: Task, others: Sequence[Plan]) -> Iterator[Plan]:
    """The plan, the others, and one that merges and cuts nothing, with a first level that ends at what float16 keeps,
    and a second for what that leaves.

    Where ranks do not reach that, the last of them gain little: then one that ends a dB before them, too. What ends
    far below is left: the second level would have too much to do.
    """
    whole = whole_plan(task.plan, task.source.organisation(None))
    for plan in dict.fromkeys(map(_in_one, (task.plan, *others, whole))):
        if len(plan.levels) > 1 or _is_verbatim(plan):
            continue
        goal = replace(plan, size=None, snr=ROUNDED)
        firsts = [each for each in _further(task, [goal]) if each[1].snr > SHORT]
        firsts += _further(task, [replace(goal, snr=model.snr - 1) for _, model in firsts if model.snr < ROUNDED])
        deeper = [plan for plan in (_deeper(*each) for each in firsts) if plan is not None]
        # Bytes do for what a level of float16 numbers leaves, and hold some 40 dB of it.
        narrow = [with_bits(each, min(BITS)) for each in deeper if (task.plan.snr or 0.0) < BOTH]
        both = [*(each for each in narrow if task.bits is None), *deeper]
        yield from (replace(each, snr=task.plan.snr, size=task.plan.size) for each in both)


def _in_one(plan: Plan) -> Plan:
    """The plan, or where its nodes are blocks below a level of rank one a level of these blocks, all of equal ranks."""
    first, *others = plan.levels
    if len(others) != 1 or not others[0].own or others[0].cuts or not first.grid:
        return plan
    return replace(plan, levels=(others[0].cut_into(first.grid, plan.organisation),))


def _deeper(task: Task, model: Model) -> Plan | None:
    """A plan of one level as it was fitted, and below it a second with ranks of its own; None where that cannot be."""
    (own, *more), top = task.plan.levels, model.bounds[0]
    own, found = next((way for way in own.ways(task.plan.organisation) if way.clusters == top.clusters), own), top.ranks
    if more or not own.own or model.decode_cost >= task.decode_cost or 0 in found:  # 0: nothing was stored
        return None
    ranks = tuple(None if most is None else rank for most, rank in zip(own.ranks, found, strict=True))
    below = replace(own, clusters=(1,) * own.order, grid=())
    return replace(task.plan, levels=(replace(own, ranks=ranks, own=False), below))
