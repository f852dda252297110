"""What the header says of the stages: how much their runs hold, which bounds all that is made of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from ..packed import LevelBounds
from ..plan import SCHEMES
from .fields import Json, as_integer, as_list, as_number, as_object, as_text
from .limits import Limits, check_limit
from .reasons import fault

MAX_U32 = 2**32 - 1
#: What stands for a stage that follows no scheme of subdivision.
NO_SCHEME = "none"


@dataclass(frozen=True)
class Run:
    """Nodes, code bytes, cells, core numbers, and basis numbers by mode of one run."""

    nodes: int
    coded: int
    cells: int
    core: int
    basis: tuple[int, ...]

    @property
    def counts(self) -> list[int]:
        """All of it, in the order of the header."""
        return [self.nodes, self.coded, self.cells, self.core, *self.basis]

    def stored(self, half: bool) -> int:
        """Bytes of its section without the checksum; `half`: whether float16 numbers follow the code."""
        return self.coded + (4 * self.cells + 2 * (self.core + sum(self.basis)) if half else 0)


@dataclass(frozen=True)
class Stage:
    """A stage as the header has it: `step` of coded numbers, `half` for float16 ones, `rows` of all nodes by mode."""

    nodes: int
    bounds: LevelBounds
    step: float | None
    half: bool
    rows: tuple[int, ...]
    runs: tuple[Run, ...]

    def total(self, count: Callable[[Run], int]) -> int:
        """The sum of something over the runs."""
        return sum(map(count, self.runs))

    @property
    def largest(self) -> list[list[int]]:
        """C, K and R."""
        return [list(self.bounds.clusters), list(self.bounds.mixture), list(self.bounds.ranks)]

    @property
    def lengths(self) -> list[int]:
        """Bytes of its sections without checksums."""
        return [run.stored(self.half) for run in self.runs]


def stage_to_json(stage: Stage) -> dict[str, Any]:
    """The stage's object in the header; a step in the fewest digits that tell float32 numbers apart."""
    numbers: dict[str, Any] = {"bits": 16} if stage.half else {}
    if stage.step is not None:
        numbers = {"step": float(str(np.float32(stage.step)))}
    scheme = {} if stage.bounds.scheme == NO_SCHEME else {"scheme": stage.bounds.scheme}
    return {
        "nodes": stage.nodes,
        **numbers,
        **scheme,
        "largest": stage.largest,
        "rows": list(stage.rows),
        "runs": [run.counts for run in stage.runs],
    }


def parse_stages(value: Json, where: str, sizes: Sequence[int], size: int, limits: Limits) -> tuple[Stage, ...]:
    """Check the stages of a file of `size` bytes, whose modes have these sizes."""
    items = as_list(value, where)
    check_limit("levels-limit", where, len(items), limits.levels)
    stages = [_stage(item, f"{where}[{t}]", sizes, limits) for t, item in enumerate(items)]
    if not stages or stages[-1].bounds.is_cut:
        found = "a last stage without numbers" if stages else "no stages"
        raise fault("field-value", where, found, "a last stage with numbers")
    root = stages[0]
    if root.nodes != 1:
        raise fault("field-value", f"{where}[0].nodes", root.nodes, "1, the root")
    if root.rows != tuple(sizes):
        raise fault("row-count", f"{where}[0].rows", list(root.rows), f"{list(sizes)}, the sizes of the modes")
    check_limit("nodes-limit", where, sum(stage.nodes for stage in stages), limits.nodes)
    widened = sum(_widened_bytes(stage, last=stage is stages[-1]) for stage in stages)
    if widened > limits.widened + 64 * size:
        most = widened - 64 * size
        raise fault(
            "widened-limit",
            where,
            f"{-(-widened >> 20) or 1} MiB of memory",
            f"at most {(limits.widened + 64 * size) >> 20} MiB for a file of {size} bytes",
            f"if you trust the file, hmkcta.open(path, limits=hmkcta.Limits(widened={most}))",
        )
    return tuple(stages)


def _stage(value: Json, where: str, sizes: Sequence[int], limits: Limits) -> Stage:
    fields = as_object(value, where, ("nodes", "largest", "rows", "runs"), ("step", "bits", "scheme"))

    def counts(item: Json, path: str) -> tuple[int, ...]:
        return tuple(as_integer(each, path, 0, MAX_U32) for each in as_list(item, path, len(sizes)))

    largest = [counts(item, f"{where}.largest") for item in as_list(fields["largest"], f"{where}.largest", 3)]
    nodes = as_integer(fields["nodes"], f"{where}.nodes", 0, MAX_U32)
    step = _step(fields["step"], f"{where}.step") if "step" in fields else None
    half = "bits" in fields and as_integer(fields["bits"], f"{where}.bits", 16, 16) == 16
    scheme = as_text(fields.get("scheme", NO_SCHEME), f"{where}.scheme", (NO_SCHEME, *SCHEMES))
    rows = counts(fields["rows"], f"{where}.rows")
    runs = tuple(
        _run(item, f"{where}.runs[{i}]", len(sizes)) for i, item in enumerate(as_list(fields["runs"], f"{where}.runs"))
    )
    bounds = LevelBounds(largest[0], largest[1], largest[2], scheme)
    stage = Stage(nodes, bounds, step, half, rows, runs)
    _check_bounds(stage, where, sizes, limits)
    _check_totals(stage, where)
    return stage


def _step(value: Json, where: str) -> float:
    with np.errstate(over="ignore"):
        step = float(np.float32(as_number(value, where, 0.0)))
    if step == 0 or not isfinite(step):
        raise fault("field-value", where, value, "a float32 number above 0")
    return step


def _run(value: Json, where: str, order: int) -> Run:
    nodes, coded, cells, core, *basis = (
        as_integer(item, where, 0, MAX_U32) for item in as_list(value, where, 4 + order)
    )
    return Run(nodes, coded, cells, core, tuple(basis))


def _check_bounds(stage: Stage, where: str, sizes: Sequence[int], limits: Limits) -> None:
    """Limits of a stage; its nodes are held against these bounds later, and what holds in decomposed modes alone is
    checked then."""
    bounds, path = stage.bounds, f"{where}.largest"
    if stage.step is not None and stage.half:
        raise fault("field-value", f"{where}.bits", "bits and a step", "one of them")
    has_numbers = stage.step is not None or stage.half
    if has_numbers == bounds.is_cut or (not has_numbers and any(bounds.mixture)):
        raise fault("field-value", path, stage.largest, "C > 0 = K = R if and only if there is neither step nor bits")
    for n, size in enumerate(sizes):
        check_limit("clusters-limit", path, bounds.clusters[n], limits.clusters)
        check_limit("mixture-limit", path, bounds.mixture[n], limits.mixture)
        # A mode may be undecomposed in some nodes and decomposed in others.
        most = size if bounds.mixture[n] == 0 else max(size, limits.rank)
        check_limit("rank-limit", path, bounds.ranks[n], most)


def _check_totals(stage: Stage, where: str) -> None:
    """What the runs hold together must be what the stage does, and few enough to be counted."""
    nodes = stage.total(lambda run: run.nodes)
    if nodes != stage.nodes or any(run.nodes == 0 for run in stage.runs):
        raise fault("field-value", f"{where}.runs", f"{nodes} nodes", f"{stage.nodes}, one at least in each run")
    most = 0 if stage.bounds.is_cut else MAX_U32
    for at in range(2, 4 + len(stage.rows)):
        found = sum(run.counts[at] for run in stage.runs)
        if found > most:
            raise fault("field-value", f"{where}.runs", f"{found} cells or numbers", f"at most {most}")


def _widened_bytes(stage: Stage, *, last: bool) -> int:
    """Bytes of the arrays of a stage."""
    order = len(stage.rows)
    basis = [sum(run.basis[n] for run in stage.runs) for n in range(order)]
    members = [min(count, rows * k) for count, rows, k in zip(basis, stage.rows, stage.bounds.mixture, strict=True)]
    numbers = stage.total(lambda run: run.core) + sum(basis) + sum(members)
    cells = stage.total(lambda run: run.cells)
    return 4 * stage.nodes * (3 + 8 * order) + 4 * cells + 2 * numbers + (0 if last else 6 * sum(stage.rows))
