"""Follow a plan: fit its levels one after another (paper, figure 3), refit them together, measure what is stored."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import prod

import numpy as np

from .adaptive import Goal, fit_to_goal
from .alternatives import alternatives, whole_plan, with_clusters_times
from .axes import mode_sizes
from .errors import HmkctaError, invalid
from .filesize import metadata_of, undecomposed_in
from .finer import LARGE, finer, is_coarse
from .fit import EFFORTS
from .hierarchy import (
    Hierarchy,
    Run,
    ascend,
    backfit,
    descend,
    fit_nodes,
    grid_labels,
    restore,
    saved,
    thinned,
    whole,
)
from .hmkfile import encoded_size
from .measure import measure_both
from .measure_streamed import measure_streamed
from .memory import give_back_freed_memory
from .metrics import snr_db
from .model import Model
from .pack import bounds, pack_levels
from .packed import LevelQuality, Metadata, PackedLevel
from .plan import SCHEMES, LevelSpec, Plan, check_plan
from .predict import is_streamed, memory_limit
from .source import Source
from .streamed import Streamed
from .workset import check_worksets

#: From so many dB on a second level is tried, below a first that ends at as many as float16 keeps of one.
NEARLY, ROUNDED = 64.0, 68.0
#: Elements up to which numbers of clusters are told apart by fits in all steps.
SMALL, STEPS = 1 << 22, (1.5, 1.25, 1.125)


@dataclass(frozen=True)
class Task:
    """A plan to follow on a source: subdivision scheme (``auto``: the best of three), decode cost, kind of data, most
    bytes of memory (None: half of what is free)."""

    source: Source
    plan: Plan
    scheme: str
    decode_cost: int
    kind: str
    run: Run
    memory: int | None = None


def follow(task: Task) -> Model:
    """The fitted model, its quality measured on the stored numbers.

    Raises:
        HmkctaError: the plan does not fit the tensor, or its goal is below what it can do.
    """
    give_back_freed_memory()
    plan, run = task.plan, task.run
    check_plan(plan, mode_sizes(task.source.axes, plan.organisation))
    tree, goal = _begun(task)
    rounds = run.effort.backfits if len(plan.levels) > 1 and not plan.levels[-1].own else 0
    for number, spec in enumerate(plan.levels):
        if number:
            _descend(task, tree, plan.levels[number - 1], spec)
            if not tree.levels[-1]:  # nothing is left to approximate
                tree.levels.pop()
                break
        axes = task.source.axes
        if spec.own:
            above = sum(level.decode_cost() for level in plan.levels[:number])
            ways = [(way, grid_labels(way, axes, plan.organisation)) for way in spec.ways(plan.organisation)]
            fit_to_goal(tree, ways, goal, max(1, task.decode_cost - above), run)
        else:
            labels = grid_labels(spec, axes, plan.organisation)
            deepest = number == len(plan.levels) - 1
            own = replace(run, effort=run.effort.at(number + 1, len(plan.levels)))
            fit_nodes(tree, [spec] * len(tree.levels[-1]), own, labels, last=deepest and rounds == 0)
            if plan.snr is not None and goal.snr_now(tree) >= plan.snr:
                break
    if len(tree.levels) > 1:
        for number in range(rounds):
            backfit(tree, run, last=number == rounds - 1)
    return _measured(task, tree)


def follow_any(task: Task, others: Sequence[Plan], missed: Callable[[str], None]) -> Model:
    """The model of the task's plan; where it misses its SNR, of the first further plan that does not, or the best.

    Further are the same plan with a level more, for what float16 or the ranks of one leave, and then the `others`;
    `missed` is told of every plan that missed. For a size the others are rivals, of which the best is kept. It is
    compared with its `alternatives`, where that takes no more than seconds, with more and fewer clusters of the data,
    and beyond what float16 keeps of one level with plans of two. Where ranks are such large steps that a model lies far
    beyond its goal, the same plan with a `finer` choice of blocks is tried, and for an SNR the first of the others.
    """
    # Of values that are transformed the trial knows the errors' size, not where they will be large.
    doubtful = task.plan.size is not None or task.source.value_transform.name != "identity"
    given = task
    task, model = _best([(task, follow(task)), *_further(task, others if doubtful else ())])
    if _is_worth(task):
        near = alternatives(task.plan, task.source.organisation(None), model.snr, model.nbytes)
        task, model = _best([(task, model), *_further(task, near)])
        if (task.plan.snr or model.snr) > NEARLY:
            task, model = _best([(task, model), *_further(given, _in_two(given))])
        task, model = _with_other_clusters(task, model)
    best = model
    if is_coarse(task.plan, model.snr, model.nbytes):
        task, model = _nearer(task, model, others)
        return _with_other_clusters(task, model)[1] if model is not best and _is_worth(task) else model
    further = list(others)
    if (deeper := _deeper(task, model)) is not None:
        further.insert(0, deeper)
    for plan in further:
        if task.plan.snr is None or best.snr >= task.plan.snr:
            break
        missed(f"a plan chosen for {task.plan.snr:g} dB came to {model.snr:.2f}: another is tried, {plan}")
        for _, model in _further(task, [plan]):
            best = max(best, model, key=lambda each: each.snr)
    return best if task.plan.snr is None else _unless_verbatim(task, best, others)


def _is_worth(task: Task) -> bool:
    """Whether other plans like it are fitted as well: where that takes seconds, unless it should be fast."""
    elements = prod(task.source.shape)
    sizes = mode_sizes(task.source.axes, task.plan.organisation)
    held = not is_streamed(elements, memory_limit(task.plan, sizes, task.memory))
    return held and elements <= LARGE and task.run.effort.candidates > EFFORTS["fast"].candidates


def _best(followed: Sequence[tuple[Task, Model]]) -> tuple[Task, Model]:
    """For a size the model of the highest SNR; for an SNR the smallest that reaches it, or the first if none does."""
    if (snr := followed[0][0].plan.snr) is None:
        return max(followed, key=lambda each: each[1].snr)
    return min((each for each in followed if each[1].snr >= snr), key=lambda each: each[1].nbytes, default=followed[0])


def _unless_verbatim(task: Task, best: Model, others: Sequence[Plan]) -> Model:
    """The model for an SNR, or the values as float16 if that takes fewer bytes and does as well."""
    if best.nbytes <= 2 * prod(task.source.shape) or _is_verbatim(best.plan):
        return best
    for _, model in _further(task, filter(_is_verbatim, others)):
        if model.nbytes < best.nbytes and model.snr >= min(best.snr, task.plan.snr or best.snr):
            return model
    return best


def _is_verbatim(plan: Plan) -> bool:
    """Whether it leaves the values as they are."""
    return len(plan.levels) == 1 and not any(plan.levels[0].ranks)


def _nearer(task: Task, model: Model, others: Sequence[Plan]) -> tuple[Task, Model]:
    """The best of a model beyond its goal and those of plans that may come nearer to it."""
    own = finer(task.plan, task.source.axes)
    plans = ([] if own is None else [own]) + list(others[: 1 if task.plan.snr is not None else 0])
    return _best([(task, model), *_further(task, plans)])


def _further(task: Task, plans: Iterable[Plan]) -> Iterator[tuple[Task, Model]]:
    """Models of further plans, except those that cannot be followed: there is a model already.

    The least file of such a plan is larger than the goal, or memory does not do.
    """
    for plan in plans:
        further = replace(task, plan=plan)
        try:
            model = follow(further)
        except HmkctaError as error:
            if error.reason not in ("size-too-small", "memory"):
                raise
            continue
        yield further, model


def _with_other_clusters(task: Task, model: Model) -> tuple[Task, Model]:
    """The best of more clusters of the data and of fewer, in steps that end small; of large arrays in these alone."""
    found, tried = (task, model), {task.plan}
    for step in STEPS if prod(task.source.shape) <= SMALL else STEPS[-1:]:
        before = None
        while found is not before:
            before, near = found, (with_clusters_times(found[0].plan, factor) for factor in (step, 1 / step))
            plans = [plan for plan in near if plan is not None and plan not in tried]
            tried.update(plans)
            found = _best([found, *_further(task, plans)])
    return found


def _in_two(task: Task) -> Iterator[Plan]:
    """The plan, and one that merges and cuts nothing, with a first level that ends at what float16 keeps, and a second
    for what that leaves.

    Where ranks do not reach that, the last of them gain little: then one that ends a dB before them, too.
    """
    for plan in dict.fromkeys((task.plan, whole_plan(task.plan, task.source.organisation(None)))):
        goal = replace(plan, size=None, snr=ROUNDED)
        firsts = list(_further(task, [goal]))
        firsts += _further(task, [replace(goal, snr=model.snr - 1) for _, model in firsts if model.snr < ROUNDED])
        deeper = [_deeper(*each) for each in firsts]
        yield from (replace(each, snr=task.plan.snr, size=task.plan.size) for each in deeper if each is not None)


def _deeper(task: Task, model: Model) -> Plan | None:
    """A plan of one level as it was fitted, and below it a second with ranks of its own; None where that cannot be."""
    (own, *more), top = task.plan.levels, model.bounds[0]
    own, found = next((way for way in own.ways(task.plan.organisation) if way.clusters == top.clusters), own), top.ranks
    if more or not own.own or model.decode_cost >= task.decode_cost or 0 in found:  # 0: nothing was stored
        return None
    ranks = tuple(None if most is None else rank for most, rank in zip(own.ranks, found, strict=True))
    below = replace(own, clusters=(1,) * own.order, grid=())
    return replace(task.plan, levels=(replace(own, ranks=ranks, own=False), below))


def _begun(task: Task) -> tuple[Hierarchy, Goal]:
    """The hierarchy before any level, in memory or streamed, and the plan's goal with how it is measured."""
    source, organisation = task.source, task.plan.organisation
    sizes = mode_sizes(source.axes, organisation)
    limit = task.run.journal.settled("limit", lambda: memory_limit(task.plan, sizes, task.memory))
    if is_streamed(prod(source.shape), limit):
        check_worksets(task.plan, sizes, limit, task.memory)
        tree = whole(Streamed(source, organisation, task.run.threads, limit))
    else:
        tree = whole(source.tensor(organisation))
    # Only goals ask for it, and the tensor may have to be read for it.
    energy = 0.0 if task.plan.snr is None and task.plan.size is None else tree.error

    def file_bytes(tree: Hierarchy) -> int:
        return encoded_size(*_described(task, tree))

    def snr_now(tree: Hierarchy) -> float:
        return _snr(task, tree, energy)

    return tree, Goal(task.plan.size, task.plan.snr, energy, file_bytes, snr_now, task.memory)


def _descend(task: Task, tree: Hierarchy, above: LevelSpec, below: LevelSpec) -> None:
    """Subdivide; for ``auto`` all three schemes are tried with a fast fit of the level below.

    Where memory does not hold the tensor they are tried on every few rows of it.
    """
    run = task.run
    if task.scheme != "auto" or above.grid or below.own or above.cells == 1:
        descend(tree, above.scheme, run)
        return
    descend(tree, _best_scheme(thinned(tree, above), below, run), run)


def _best_scheme(tree: Hierarchy, below: LevelSpec, run: Run) -> str:
    """The subdivision under which a fast fit of the level below leaves least."""
    left: dict[str, float] = {}
    before = saved(tree)
    for scheme in SCHEMES:
        descend(tree, scheme, run)
        fit_nodes(tree, [below] * len(tree.levels[-1]), replace(run, effort=EFFORTS["fast"]))
        left[scheme] = tree.error
        restore(tree, before)
        ascend(tree)
    return min(left, key=lambda scheme: left[scheme])


def _snr(task: Task, tree: Hierarchy, energy: float) -> float:
    """SNR in dB, in the domain of the source values."""
    transform = task.source.value_transform
    if transform.name == "identity":
        return snr_db(energy, tree.error)
    if isinstance(tree.residual, Streamed):
        return measure_streamed(tree, tree.residual, task.run.progress)[0][-1].snr_db
    error = energy = 0.0
    unit = np.float64(task.source.unit)
    for values, left in zip(task.source.tensor(task.plan.organisation), tree.residual, strict=True):
        original = transform.inverse(unit * values)
        energy += float(np.square(original).sum())
        error += float(np.square(original - transform.inverse(unit * (values - left))).sum())
    return snr_db(energy, error)


def _described(
    task: Task,
    tree: Hierarchy,
    quality: Sequence[LevelQuality] | None = None,
    transformed: Sequence[LevelQuality] | None = None,
) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    levels = pack_levels(tree.levels, undecomposed_in(task.plan), task.source.unit)
    schemes = [tree.schemes[number] if number < len(tree.schemes) else "most" for number in range(len(levels))]
    tops = [bounds(level, scheme) for level, scheme in zip(levels, schemes, strict=True)]
    metadata = metadata_of(task.source, task.plan, tops, task.kind, task.run.seed, quality, transformed)
    if task.run.device != "cpu":  # which rounds in its own way
        metadata = replace(metadata, writer=f"{metadata.writer}, {task.run.device}")
    return metadata, levels


def _measured(task: Task, tree: Hierarchy) -> Model:
    """The model with its quality, decoded from the stored numbers and compared with the source."""
    metadata, levels = _described(task, tree)
    model, source = Model(metadata, levels), task.source
    if isinstance(tree.residual, Streamed):
        quality, transformed = measure_streamed(tree, tree.residual, task.run.progress)
    else:
        quality, transformed = measure_both(model, source.array, nan=source.nan, progress=task.run.progress)
    measured = Model(_described(task, tree, quality, transformed)[0], levels)
    if task.plan.size is not None and measured.nbytes > task.plan.size:
        found, allowed = f"{task.plan.size} bytes", f"at least {measured.nbytes} bytes for this plan"
        raise invalid("size-too-small", "size", found, allowed, "end the plan with a level R<=.. that fills the size")
    return measured
