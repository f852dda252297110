"""Follow a plan: fit its levels one after another (paper, figure 3), refit them together, measure what is stored."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import inf, prod

import numpy as np

from ..axes import mode_sizes
from ..errors import invalid
from ..filesize import metadata_of, undecomposed_in
from ..fitting.fit import EFFORTS
from ..fitting.hierarchy import (
    Hierarchy,
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
from ..fitting.run import FirstLevels, Run
from ..fitting.workset import check_worksets
from ..hmkfile import encoded_size
from ..measure import measure_both
from ..measure_streamed import measure_streamed
from ..metrics import noise_at, snr_db
from ..model import Model
from ..pack import pack_levels
from ..packed import LevelQuality, Metadata, PackedLevel, bounds_of
from ..plan import AUTO, SCHEMES, LevelSpec, Plan
from ..plan_checks import check_plan
from ..ranks.adaptive import Goal, fit_to_goal
from ..streaming.budget import is_streamed, memory_limit, room_beside
from ..streaming.source import Source
from ..streaming.streamed import Streamed
from ..support.memory import give_back_freed_memory, memory_budget
from ..support.once import Once
from ..support.progress import Compared

#: Share of the error that an SNR allows below which ranks of a node need not be told apart by their errors.
UNTOLD = 0.02
#: How many first levels of one organisation, and of how many organisations, are kept for further plans.
FIRST_LEVELS, ORGANISATIONS = 8, 8


@dataclass(frozen=True)
class Task:
    """A plan to follow on a source, and all that was said beside it.

    Attributes:
        source: the array.
        plan: levels, organisation and goal.
        decode_cost: most multiply-adds for one scattered element, of ranks that are chosen.
        kind: of data, as the file has it.
        run: effort, seed, threads and who is told.
        memory: bytes to work in; None: half of what is free.
        bits: of each number, if they are given; None: as suits the goal.
        organised: whether the organisation is given, so that plans of another one are out.
        most: bytes for the SNR beyond which the plan is given up, as another one takes less.
        compared: counts the plans that are compared.
        first_levels: of all plans that are compared, by their organisation; None: there is one plan alone.
    """

    source: Source
    plan: Plan
    decode_cost: int
    kind: str
    run: Run
    memory: int | None = None
    bits: int | None = None
    organised: bool = False
    most: float = inf
    compared: Compared = field(default_factory=Compared)
    first_levels: Once[FirstLevels] | None = None


def follow(task: Task) -> Model:
    """The fitted model, its quality measured on the stored numbers.

    Raises:
        HmkctaError: the plan does not fit the tensor, or its goal is below what it can do.
    """
    give_back_freed_memory()
    plan, firsts = task.plan, task.first_levels
    run = replace(
        task.run, room=room_beside(prod(task.source.shape), task.memory),
        first_levels=firsts and firsts.get(plan.organisation, lambda: FirstLevels(FIRST_LEVELS)),
    )  # fmt: skip
    task = replace(task, run=run)
    check_plan(plan, mode_sizes(task.source.axes, plan.organisation))
    tree, goal = _begun(task)
    rounds, met = run.effort.backfits if len(plan.levels) > 1 and not plan.levels[-1].own else 0, False
    for number, spec in enumerate(plan.levels):
        if number:
            _descend(task, tree, plan.levels[number - 1], spec)
            if not tree.levels[-1]:  # nothing is left to approximate
                ascend(tree)
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
            met = plan.snr is not None and goal.snr_now(tree) >= plan.snr
            if met:
                break
    # Back-fitting lowers the error of transformed values, with which that of the values themselves may rise.
    kept = met and not task.source.value_transform.is_identity
    if rounds and len(tree.levels) > 1 and not kept:
        for number in range(rounds):
            backfit(tree, run, last=number == rounds - 1)
    return _measured(task, tree)


def limit_of(task: Task) -> int:
    """How many elements are worked on at once: of every plan by what was free as the first run of the call began."""
    return memory_limit(task.plan, mode_sizes(task.source.axes, task.plan.organisation), task.memory, budget_of(task))


def budget_of(task: Task) -> int:
    """Bytes to work in, as the first run of the call found them."""
    return task.run.journal.settled("budget", lambda: memory_budget(task.memory))


def _begun(task: Task) -> tuple[Hierarchy, Goal]:
    """The hierarchy before any level, in memory or streamed, and the plan's goal with how it is measured."""
    source, organisation, journal = task.source, task.plan.organisation, task.run.journal
    sizes = mode_sizes(source.axes, organisation)
    limit = journal.settled(f"limit-{journal.step()}", lambda: limit_of(task))
    if is_streamed(prod(source.shape), limit):
        check_worksets(task.plan, sizes, limit, task.memory)
        tree = whole(Streamed(source, organisation, task.run.threads, limit))
    else:
        tree = whole(source.tensor(organisation))
    # Only goals ask for it, and the tensor may have to be read for it.
    energy = 0.0 if task.plan.snr is None and task.plan.size is None else tree.error

    def file_bytes(tree: Hierarchy) -> int:
        levels = _packed(task, tree)
        return encoded_size(_metadata(task, tree, levels), levels)

    def snr_now(tree: Hierarchy) -> float:
        return _snr(task, tree, energy)

    snr = task.plan.snr
    plain = source.value_transform.is_identity  # else the SNR that ranks promise says little of the values'
    untold = UNTOLD * noise_at(snr, energy) if plain and snr is not None else 0.0
    most = task.most if plain else inf
    return tree, Goal(task.plan.size, snr, energy, file_bytes, snr_now, task.memory, untold, most)


def _descend(task: Task, tree: Hierarchy, above: LevelSpec, below: LevelSpec) -> None:
    """Subdivide; by ``auto`` all three schemes are tried with a fast fit of the level below, unless that chooses ranks.

    Where memory does not hold the tensor they are tried on every few rows of it.
    """
    run, scheme = task.run, above.scheme
    if scheme == AUTO:
        tried = not (above.grid or below.own or above.cells == 1)
        scheme = _best_scheme(thinned(tree, above), below, run) if tried else SCHEMES[0]
    descend(tree, scheme, run, once=not below.own)


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
    if transform.is_identity:
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


def _packed(task: Task, tree: Hierarchy) -> tuple[PackedLevel, ...]:
    """The levels as the file has them."""
    return pack_levels(tree.levels, undecomposed_in(task.plan), task.source.unit)


def _metadata(
    task: Task,
    tree: Hierarchy,
    levels: Sequence[PackedLevel],
    quality: Sequence[LevelQuality] | None = None,
    transformed: Sequence[LevelQuality] | None = None,
) -> Metadata:
    schemes = [tree.schemes[number] if number < len(tree.schemes) else "most" for number in range(len(levels))]
    tops = [bounds_of(level, scheme) for level, scheme in zip(levels, schemes, strict=True)]
    metadata = metadata_of(task.source, task.plan, tops, task.kind, task.run.seed, quality, transformed)
    if task.run.device != "cpu":  # which rounds in its own way
        metadata = replace(metadata, writer=f"{metadata.writer}, {task.run.device}")
    return metadata


def _measured(task: Task, tree: Hierarchy) -> Model:
    """The model with its quality, decoded from the stored numbers and compared with the source."""
    levels, source = _packed(task, tree), task.source
    if isinstance(tree.residual, Streamed):
        quality, transformed = measure_streamed(tree, tree.residual, task.run.progress)
    else:
        model = Model(_metadata(task, tree, levels), levels)
        quality, transformed = measure_both(model, source.array, nan=source.nan, progress=task.run.progress)
    measured = Model(_metadata(task, tree, levels, quality, transformed), levels)
    if task.plan.size is not None and measured.nbytes > task.plan.size:
        found, allowed = f"{task.plan.size} bytes", f"at least {measured.nbytes} bytes for this plan"
        raise invalid("size-too-small", "size", found, allowed, "end the plan with a level R<=.. that fills the size")
    return measured
