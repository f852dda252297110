"""Array in, model out: the whole way of the data (paper, figure 3), by a given plan or one chosen for a goal."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._version import __version__
from .adaptive import Goal, fit_to_goal
from .axes import Axis
from .errors import invalid
from .fit import EFFORTS, Effort
from .hierarchy import (Hierarchy, Progress, ascend, backfit, descend, fit_nodes, grid_labels, squared_norm, whole)
from .hmkfile import encoded_size
from .measure import measure
from .memory import check_memory
from .model import Model
from .pack import bounds, pack_levels
from .packed import LevelQuality, Metadata
from .plan import SCHEMES, LevelSpec, Plan, parse_plan
from .source import Source, prepare
from .transform import from_json
from .tuning import tune

F32 = NDArray[np.float32]

#: Default goal: 1/100 of the float32 bytes, and no more than this SNR, beyond which eyes and 8-bit screens see nothing.
DEFAULT_RATIO, DEFAULT_SNR = 100, 50.0
#: The file is allowed this much more than the plan counts, for digits of the figures in its header.
HEADER_SLACK = 160


def _silent(stage: str, fraction: float) -> None:
    """Progress for nobody."""


@dataclass(frozen=True)
class Job:
    """Everything a fit needs beside data and plan."""

    source: Source
    effort: Effort
    scheme: str
    decode_cost: int
    seed: int
    threads: int
    progress: Progress
    kind: str


def choose_plan(
    array: Any, *, axes: Sequence[Axis] | Sequence[str] | None = None, snr: float | None = None, size: int | None = None,
    decode_cost: int = 4096, quality: str = "medium", organisation: str | None = None, scheme: str = "auto",
    transform: str = "identity", nan: float | None = None, seed: int = 0, threads: int | None = None,
    max_memory: int | None = None, progress: Progress | None = None,
) -> Plan:
    """The plan that `compress` would follow for a goal, found by trial on a sample.

    See `compress` for the arguments and what is raised.
    """
    job = _job(array, axes, transform, nan, quality, scheme, decode_cost, seed, threads, max_memory, progress, None)
    return _chosen(job, organisation, snr, size)


def compress(
    array: Any, plan: Plan | str | None = None, *, axes: Sequence[Axis] | Sequence[str] | None = None,
    snr: float | None = None, size: int | None = None, decode_cost: int = 4096, quality: str = "medium",
    organisation: str | None = None, scheme: str = "auto", transform: str = "identity", nan: float | None = None,
    kind: str | None = None, seed: int = 0, threads: int | None = None, max_memory: int | None = None,
    progress: Progress | None = None,
) -> Model:
    """Approximate an array by HMK-CTA.

    Args:
        array: real numbers of any dtype, order and layout, 1 to 8 modes; NumPy array or memory map.
        plan: levels as `parse_plan` reads them, or a `Plan`; None: chosen for the goal on a sample of the data.
        axes: names (``light``, or ``gloss:space`` with a role) or `Axis` objects, in array order.
        snr: least SNR in dB of the stored numbers. With explicit levels: no deeper than needed.
        size: most bytes of the whole file. Neither: 1/100 of the float32 bytes or 50 dB, whichever is less.
        decode_cost: most multiply-adds for one scattered element, for a chosen plan.
        quality: ``fast``, ``medium`` or ``thorough``: how long the fit tries.
        organisation: axes merged into modes, ``"light+rgb, view, y+x"``; None: chosen, or a mode for each axis.
        scheme: ``most``, ``least``, ``uniform`` or ``auto`` (the best of the three) subdivision of explicit levels.
        transform: value transform for high dynamic range, e.g. ``log1p``.
        nan: value to put for NaN and infinity; None: refuse them.
        kind: ``svbrdf``, ``lightfield``, ``volume`` or ``generic``; None: from the roles of the axes.
        seed: the same seed makes the same file.
        threads: how many; None: all cores.
        max_memory: bytes; None: what is free.
        progress: called with a stage's name and the fraction of it done.

    Returns:
        The model; `Model.save` writes the file.

    Raises:
        HmkctaError: an argument is out of range, the array holds NaN or infinity, or memory would not do.

    >>> ramp = np.add.outer(np.arange(32.0), np.arange(24.0))
    >>> model = compress(ramp, "R=2")
    >>> model.shape, model.snr > 60
    ((32, 24), True)
    """
    job = _job(array, axes, transform, nan, quality, scheme, decode_cost, seed, threads, max_memory, progress, kind)
    if isinstance(plan, str):
        modes = job.source.organisation(organisation)
        plan = replace(parse_plan(plan, modes, "most" if scheme == "auto" else scheme), snr=snr, size=size)
    elif plan is None:
        plan = _chosen(job, organisation, snr, size)
    return _fit(job, plan)


def _job(
    array: Any, axes: Any, transform: str, nan: float | None, quality: str, scheme: str, decode_cost: int, seed: int,
    threads: int | None, max_memory: int | None, progress: Progress | None, kind: str | None,
) -> Job:
    if quality not in EFFORTS:
        raise invalid("unknown-quality", "quality", quality, ", ".join(EFFORTS))
    if scheme not in (*SCHEMES, "auto"):
        raise invalid("unknown-scheme", "scheme", scheme, ", ".join((*SCHEMES, "auto")))
    if threads is not None and threads < 1:
        raise invalid("threads", "threads", threads, "1 or more")
    if decode_cost < 1:
        raise invalid("decode-cost", "decode_cost", decode_cost, "1 or more multiply-adds")
    source = prepare(array, axes, transform, nan)
    # The tensor, its residual, a saved residual and one node's working copies, in float32.
    check_memory(5 * 4 * prod(source.shape), "compressing this array", "raise --max-memory or compress a part", max_memory)
    return Job(source, EFFORTS[quality], scheme, decode_cost, seed, threads or os.cpu_count() or 1, progress or _silent,
               kind or source.kind)


def _chosen(job: Job, organisation: str | None, snr: float | None, size: int | None) -> Plan:
    if snr is not None and size is not None:
        raise invalid("two-goals", "goal", "snr and size", "one of them", "drop --snr or --size")
    ceiling = None
    if snr is None and size is None:
        size, ceiling = max(4 * prod(job.source.shape) // DEFAULT_RATIO, 4096), DEFAULT_SNR
    fixed = None if organisation is None else job.source.organisation(organisation)
    return tune(job.source, snr=snr, size=size, ceiling=ceiling, decode_cost=job.decode_cost, organisation=fixed,
                seed=job.seed, threads=job.threads, progress=job.progress)


def _fit(job: Job, plan: Plan) -> Model:
    tensor = job.source.tensor(plan.organisation)
    _check_plan(plan, tensor.shape)
    tree = whole(tensor.copy())
    energy = squared_norm(tensor)
    goal = Goal(plan.size, plan.snr, energy, lambda t: encoded_size(*_described(job, plan, t)) + HEADER_SLACK,
                lambda t: _snr(job, tensor, t, energy))
    for number, spec in enumerate(plan.levels):
        if number:
            _descend(job, plan.levels[number - 1], tree, spec)
        labels = grid_labels(spec, job.source.axes, plan.organisation)
        if spec.own:
            above = sum(level.decode_cost() for level in plan.levels[:number])
            fit_to_goal(tree, spec, goal, max(1, job.decode_cost - above), job.effort, job.seed, job.threads, job.progress,
                        labels)
        else:
            fit_nodes(tree, [spec] * len(tree.levels[-1]), job.effort, job.seed, job.threads, job.progress, labels)
            if plan.snr is not None and goal.snr_now(tree) >= plan.snr:
                break
    if not plan.levels[-1].own:
        for _ in range(job.effort.backfits if len(tree.levels) > 1 else 0):
            backfit(tree, 1, job.threads, job.progress)
    return _measured(job, plan, tree)


def _check_plan(plan: Plan, sizes: Sequence[int]) -> None:
    for number, level in enumerate(plan.levels, start=1):
        undecomposed = [r is None for r in level.ranks]
        if undecomposed != [r is None for r in plan.levels[0].ranks]:
            raise invalid("undecomposed-differ", f"R of level {number}", str(level), "* for the same modes in every level")
        if level.own and (number < len(plan.levels) or (plan.snr is None and plan.size is None)):
            raise invalid("own-ranks-place", f"level {number}", str(level), "R<= in the last level, together with a goal",
                          "add --snr or --size")
        for n, (rank, clusters, size) in enumerate(zip(level.ranks, level.clusters, sizes, strict=True)):
            if number == 1 and not level.own and rank is not None and rank > size:
                raise invalid("rank-too-large", f"R of mode {n + 1}", rank, f"1 to {size}, or * for an undecomposed mode")
            if number == 1 and clusters > size:
                raise invalid("more-clusters-than-rows", f"C of mode {n + 1}", clusters, f"1 to {size}, its rows")


def _descend(job: Job, above: LevelSpec, tree: Hierarchy, below: LevelSpec) -> None:
    """Subdivide; for ``auto`` all three schemes are tried with a fast fit of the level below."""
    free = max(above.mixture) > 1 or (max(above.clusters) > 1 and not above.grid)
    if job.scheme != "auto" or not free:
        descend(tree, above.scheme, job.threads, job.progress)
        return
    left: dict[str, float] = {}
    for scheme in SCHEMES:
        descend(tree, scheme, job.threads, job.progress)
        saved = tree.residual.copy()
        trial = replace(below, own=False)
        fit_nodes(tree, [trial] * len(tree.levels[-1]), EFFORTS["fast"], job.seed, job.threads, job.progress)
        left[scheme] = tree.error
        tree.residual[...] = saved
        tree.levels[-1] = []
        ascend(tree)
    descend(tree, min(left, key=lambda scheme: left[scheme]), job.threads, job.progress)


def _snr(job: Job, tensor: F32, tree: Hierarchy, energy: float) -> float:
    """SNR in dB, in the domain of the source values."""
    transform = from_json(job.source.transform)
    error = tree.error
    if transform.name != "identity":
        error = energy = 0.0
        for values, left in zip(tensor, tree.residual, strict=True):
            original = transform.inverse(values.astype(np.float64))
            energy += float(np.square(original).sum())
            error += float(np.square(original - transform.inverse(values.astype(np.float64) - left)).sum())
    return float("inf") if error == 0 else -float("inf") if energy == 0 else 10 * float(np.log10(energy / error))


def _described(job: Job, plan: Plan, tree: Hierarchy, quality: Sequence[LevelQuality] | None = None) -> tuple[Metadata, Any]:
    undecomposed = tuple(n for n, rank in enumerate(plan.levels[0].ranks) if rank is None)
    levels = pack_levels(tree.levels, undecomposed)
    schemes = [level.scheme for level in plan.levels]
    metadata = Metadata(
        source_dtype=job.source.dtype, axes=job.source.axes, organisation=plan.organisation,
        levels=tuple(bounds(level, scheme) for level, scheme in zip(levels, schemes, strict=False)),
        undecomposed=undecomposed, kind=job.kind, transform=job.source.transform,
        quality=tuple(quality or [LevelQuality(100 / 3, 1 / 3, 1 / 3)] * len(levels)),
        source=job.source.fingerprint, writer=f"hmkcta {__version__}", seed=job.seed,
    )
    return metadata, levels


def _measured(job: Job, plan: Plan, tree: Hierarchy) -> Model:
    """The model with its quality, decoded from the stored numbers and compared with the source."""
    metadata, levels = _described(job, plan, tree)
    source = job.source
    quality = measure(Model(metadata, levels), source.array, nan=source.nan, progress=job.progress)
    return Model(replace(metadata, quality=quality), levels)


