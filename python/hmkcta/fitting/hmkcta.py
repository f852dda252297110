"""HMK-CTA (paper, section 4): level by level subdivide, fit each node by MK-CTA, subtract; then refit all together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod

import numpy as np

from ..axes import mode_sizes
from ..filesize import metadata_of, undecomposed_in
from ..measure import measure_both
from ..metrics import snr_db
from ..model import Model
from ..packed import LevelQuality, Metadata, PackedLevel, bounds_of
from ..plan import AUTO, SCHEMES, LevelSpec, Plan
from ..plan_checks import check_plan
from ..streaming.budget import is_streamed, memory_limit, room_beside, with_searches
from ..streaming.source import Source
from ..streaming.streamed import Streamed
from ..support.memory import give_back_freed_memory, memory_budget
from .fit import EFFORTS
from .hierarchy import Hierarchy, ascend, backfit, descend, fit_nodes, grid_labels, restore, saved, thinned, whole
from .measure_streamed import measure_streamed
from .pack import pack_levels
from .run import Run
from .workset import check_worksets


@dataclass(frozen=True)
class FitRequest:
    """A plan to fit to a source.

    Attributes:
        source: the array.
        plan: levels, organisation and goal.
        kind: of data, as the file has it.
        run: effort, seed, threads, progress callbacks.
        memory: bytes to work in; None: half of what is free.
    """

    source: Source
    plan: Plan
    kind: str
    run: Run
    memory: int | None = None


def fit_plan(request: FitRequest) -> Model:
    """The model of a written plan, its quality measured on the stored numbers.

    With an SNR as goal no level is fitted beyond the one that reaches it. Numbers are float16.

    Raises:
        HmkctaError: the plan does not fit the tensor.
    """
    give_back_freed_memory()
    plan, source = request.plan, request.source
    run = replace(request.run, room=room_beside(prod(source.shape), request.memory))
    request = replace(request, run=run)
    sizes = mode_sizes(source.axes, plan.organisation)
    check_plan(plan, sizes)
    plan = with_searches(plan, sizes, run.journal.settled("limit-of-nodes", lambda: run.room or 0, int), request.memory)
    request = replace(request, plan=plan)
    tree = _begun(request)
    energy = tree.error if plan.snr is not None else 0.0
    rounds, met = run.effort.backfits if len(plan.levels) > 1 else 0, False
    for number, spec in enumerate(plan.levels):
        if number:
            _subdivide(tree, plan.levels[number - 1], spec, run)
            if not tree.levels[-1]:  # nothing is left to approximate
                ascend(tree)
                break
        labels = grid_labels(spec, source.axes, plan.organisation)
        deepest = number == len(plan.levels) - 1
        nodes = len(tree.levels[-1])
        own = replace(run, effort=run.effort.at(number + 1, len(plan.levels), prod(source.shape), nodes))
        fit_nodes(tree, [spec] * nodes, own, labels, last=deepest and rounds == 0)
        met = plan.snr is not None and _snr(request, tree, energy) >= plan.snr
        if met:
            break
    # Back-fitting lowers the error of transformed values, with which that of the values themselves may rise.
    kept = met and not source.value_transform.is_identity
    if rounds and len(tree.levels) > 1 and not kept:
        for number in range(rounds):
            backfit(tree, run, last=number == rounds - 1)
    model = _measured(request, tree)
    model.made_by = plan
    return model


def _begun(request: FitRequest) -> Hierarchy:
    """The hierarchy before any level, in memory or streamed."""
    source, plan, journal = request.source, request.plan, request.run.journal
    sizes = mode_sizes(source.axes, plan.organisation)
    budget = journal.settled("budget", lambda: memory_budget(request.memory), int)
    limit = journal.settled(f"limit-{journal.step()}", lambda: memory_limit(plan, sizes, request.memory, budget),
                            int)
    if is_streamed(prod(source.shape), limit):
        check_worksets(plan, sizes, limit, request.memory)
        return whole(Streamed(source, plan.organisation, request.run.threads, limit))
    return whole(source.tensor(plan.organisation))


def _subdivide(tree: Hierarchy, above: LevelSpec, below: LevelSpec, run: Run) -> None:
    """Subdivide (paper, section 4.2); by ``auto`` all schemes are tried with a fast fit of the level below."""
    scheme = above.scheme
    if scheme == AUTO:
        one_way = above.grid or above.cells == 1
        scheme = SCHEMES[0] if one_way else _best_scheme(thinned(tree, above), below, run)
    descend(tree, scheme, run, once=True)


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


def _snr(request: FitRequest, tree: Hierarchy, energy: float) -> float:
    """SNR in dB, in the domain of the source values."""
    transform = request.source.value_transform
    if transform.is_identity:
        return snr_db(energy, tree.error)
    if isinstance(tree.residual, Streamed):
        return measure_streamed(tree, tree.residual, request.run.progress)[0][-1].snr_db
    error = energy = 0.0
    unit = np.float64(request.source.unit)
    for values, left in zip(request.source.tensor(request.plan.organisation), tree.residual, strict=True):
        original = transform.inverse(unit * values)
        energy += float(np.square(original).sum())
        error += float(np.square(original - transform.inverse(unit * (values - left))).sum())
    return snr_db(energy, error)


def _metadata(
    request: FitRequest,
    tree: Hierarchy,
    levels: Sequence[PackedLevel],
    quality: Sequence[LevelQuality] | None = None,
    transformed: Sequence[LevelQuality] | None = None,
) -> Metadata:
    schemes = [tree.schemes[number] if number < len(tree.schemes) else "most" for number in range(len(levels))]
    tops = [bounds_of(level, scheme) for level, scheme in zip(levels, schemes, strict=True)]
    source, run = request.source, request.run
    metadata = metadata_of(source, request.plan.organisation, tops, request.kind, run.seed, quality, transformed)
    if run.device != "cpu":  # which rounds in its own way
        metadata = replace(metadata, writer=f"{metadata.writer}, {run.device}")
    return metadata


def _measured(request: FitRequest, tree: Hierarchy) -> Model:
    """The model with its quality, decoded from the stored numbers and compared with the source."""
    source = request.source
    levels = pack_levels(tree.levels, undecomposed_in(request.plan), source.unit)
    if isinstance(tree.residual, Streamed):
        quality, transformed = measure_streamed(tree, tree.residual, request.run.progress)
    else:
        model = Model(_metadata(request, tree, levels), levels)
        quality, transformed = measure_both(model, source.array, nan=source.nan, progress=request.run.progress)
    return Model(_metadata(request, tree, levels, quality, transformed), levels)
