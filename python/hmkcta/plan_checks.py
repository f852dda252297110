"""Plans that no tensor of some mode sizes can be fitted by, or no file hold, are refused before anything is done."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod

from .errors import invalid
from .plan import HIGHEST_RANK, LevelSpec, Plan, clusters_of_grid

#: What no reader takes without being told to: levels, nodes, and multiply-adds for one element of a level.
MOST_LEVELS, MOST_NODES, MOST_LEVEL_COST = 16, 1_000_000, 2**20


def check_plan(plan: Plan, sizes: Sequence[int]) -> None:
    """Refuse a plan that a tensor of these mode sizes cannot be fitted by.

    Raises:
        HmkctaError: no levels, or levels of other modes; ranks or clusters beyond the first level's rows; R=* in some
            levels only; blocks along axes that there are not; more levels or nodes than are allowed.

    >>> from hmkcta.plan import parse_plan
    >>> check_plan(parse_plan("R=9", (("y",),)), (8,))
    Traceback (most recent call last):
        ...
    hmkcta.errors.HmkctaError: R of mode 1: found 9, allowed 1 to 8, or * for an undecomposed mode. \
[InvalidArgument/rank-too-large]
    """
    if not plan.levels:
        raise invalid("plan-levels", "levels of the plan", "none", "one or more")
    first = plan.levels[0]
    for number, level in enumerate(plan.levels, start=1):
        if level.order != len(sizes):
            raise invalid("plan-modes", f"level {number} of the plan", f"{level.order} modes",
                          f"{len(sizes)}, as its organisation has")
        if [r is None for r in level.ranks] != [r is None for r in first.ranks]:
            allowed = "* for the same modes in every level"
            raise invalid("undecomposed-differ", f"R of level {number}", str(level), allowed)
        _check_grid(plan, level, number)
        for n, (rank, size) in enumerate(zip(level.ranks, sizes, strict=True)):
            if rank is not None and min(rank, size) > HIGHEST_RANK:
                allowed = f"1 to {HIGHEST_RANK}, or * for an undecomposed mode"
                raise invalid("rank-too-large", f"R of mode {n + 1}, level {number}", rank, allowed)
    for n, (rank, clusters, size) in enumerate(zip(first.ranks, first.clusters, sizes, strict=True)):
        if rank is not None and rank > size:
            allowed = f"1 to {size}, or * for an undecomposed mode"
            raise invalid("rank-too-large", f"R of mode {n + 1}", rank, allowed)
        if clusters > size:
            allowed = f"1 to {size}, the number of its rows"
            raise invalid("more-clusters-than-rows", f"C of mode {n + 1}", clusters, allowed)
    _check_readable(plan, sizes)


def _check_grid(plan: Plan, level: LevelSpec, number: int) -> None:
    """Refuse blocks along axes that the plan does not know, and clusters that are not those of the grid."""
    axes = [name for mode in plan.organisation for name in mode]
    for axis, _ in level.grid:
        if axis not in axes:
            raise invalid("plan-grid", f"level {number}", axis, f"an axis of the plan: {', '.join(axes)}")
    if level.grid and level.clusters != clusters_of_grid(level.grid, plan.organisation):
        found, allowed = f"C={','.join(map(str, level.clusters))}", "as many clusters as its grid has blocks"
        raise invalid("plan-grid", f"level {number}", found, allowed)


def _check_readable(plan: Plan, sizes: Sequence[int]) -> None:
    """Refuse what would be fitted to a file that readers refuse, as far as the plan tells."""
    if len(plan.levels) > MOST_LEVELS:
        raise invalid("plan-levels", "levels of the plan", len(plan.levels), f"at most {MOST_LEVELS}")
    nodes = below = 1
    for number, level in enumerate(plan.levels, start=1):
        cost = level.clamped(sizes).decode_cost()
        if below == 1 and cost > MOST_LEVEL_COST:  # nodes further down may be too small for so many ranks
            raise invalid("level-cost", f"level {number}", f"{cost} multiply-adds for an element",
                          f"at most {MOST_LEVEL_COST}, as prod R_n K_n", "lower K or R")
        below = min(below * level.cells, prod(sizes))
        nodes += below if number < len(plan.levels) else 0
    if nodes > MOST_NODES:
        allowed = f"at most {MOST_NODES}"
        raise invalid("plan-nodes", "nodes of the plan", nodes, allowed, "lower C, or write fewer levels")
