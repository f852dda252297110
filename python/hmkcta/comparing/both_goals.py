"""Try the other goal, too: after a fit for a size plans for a higher SNR, after one for an SNR plans for fewer bytes.

The choice for an SNR and the choice for a size do not look at the same plans: the first one tries a second level for
what the rounding of stored numbers leaves, the other one what fills the bytes, by numbers of clusters that show in dB
long before they show in bytes. So a plan for one goal may be the best for the other, and is taken if it does more for
the goal that was asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import inf, prod
from typing import Any

from ..errors import HmkctaError
from ..model import Model
from ..plan import Plan
from ..streaming.source import Source
from ..support.progress import nobody
from .alternatives import has_clusters
from .cluster_counts import in_fewer_bytes
from .follow import Task
from .followed import NOT_FOLLOWED, Followed, best_of, further, is_verbatim, is_worth
from .rivals import Choose, follow_any

#: After a fit for a size the other goal is tried from so many dB on: below, rounding does not tell plans apart.
FROM = 40.0
#: Highest SNR in dB that is tried as the other goal: about what float32 holds.
UP_TO = 118.0
#: After a fit for a size the other goal is an SNR so many dB above what it reached.
FURTHER = 6.0
#: After a fit for an SNR the other goal is a size of this share of its bytes.
FEWER = 0.95
#: How many times at most the other goal is tried, each time from the better model.
STEPS = 4
#: After a fit for an SNR it is tried again while that has spared more than so much of the bytes.
SPARED = 0.05
#: After a fit for a size it is tried no more from a model that uses more than this share of it.
USED = 0.96
#: Plans for more dB that are expected to take more than so many times the size are not fitted.
BEYOND = 4
#: Elements up to which the other goal is tried: these fits take seconds.
SMALL = 1 << 22


def follow_both(
    task: Task, others: Sequence[Plan], missed: Callable[[str], None], choose: Choose, ceiling: float | None
) -> Followed:
    """What `follow_any` comes to for the task's goal, or for the other goal where that does better.

    Bytes need not be spent beyond `ceiling` dB, where there is one. What ends as the values themselves is left at that:
    a size of nearly as many bytes leads to plans of a cluster for every few rows, which take minutes.
    """
    best, asked = follow_any(task, others, missed, choose), task.plan
    if not is_worth(task) or not are_compared(task.source) or is_verbatim(best.model.plan):
        return best
    if ceiling is not None and asked.snr is not None:  # it was chosen for a size, which the ceiling ended
        found = _followed(task, choose, "plan-of-ceiling", {"snr": ceiling})
        best = found if found is not None and _is_better(found.model, best.model, asked) else best
    for number in range(STEPS):
        before, other = best, _other_goal(asked, best.model, ceiling)
        found = None if other is None else _followed(task, choose, f"plan-of-other-goal-{number}", other)
        found = None if found is None else _as_asked(found, asked, best, ceiling)
        if found is None or not _is_better(found.model, best.model, asked):
            break
        best = found
        if _leaves_little(best.model, before.model, asked):
            break
    return best


def _as_asked(found: Followed, asked: Plan, best: Followed, ceiling: float | None) -> Followed:
    """What was found for the other goal, or its plan by the goal asked for, unless that takes more bytes for the SNR
    than the best; for an SNR with the clusters that suit these bytes."""
    within = found.model.nbytes <= (asked.size or 0)
    if within and ceiling is not None and found.model.snr >= ceiling:
        return found
    as_asked = replace(found.task, plan=replace(found.task.plan, snr=asked.snr, size=asked.size))
    again = [*further(as_asked, [as_asked.plan], best)]
    if asked.snr is None:
        return best_of([found if within else best, *again])
    reached = best_of([Followed(as_asked, found.model), *again])
    plan = reached.task.plan
    return in_fewer_bytes(reached, [plan] if has_clusters(plan) else [])


def are_compared(source: Source) -> bool:
    """Whether its models, if plans are compared at all, are compared with those of the other goal: from some dB on."""
    return prod(source.shape) <= SMALL and source.value_transform.is_identity


def _other_goal(plan: Plan, model: Model, ceiling: float | None) -> dict[str, Any] | None:
    """The other goal to try from a model, as arguments of `choose`; None: it would tell nothing."""
    if plan.snr is not None:
        return {"snr": None, "size": int(FEWER * model.nbytes)} if model.snr >= plan.snr else None
    most = UP_TO if ceiling is None else ceiling
    return {"snr": min(model.snr + FURTHER, most), "size": None} if FROM <= model.snr < most else None


def _followed(task: Task, choose: Choose, name: str, goal: dict[str, Any]) -> Followed | None:
    """What plans come to that are chosen for a goal; None where there is none."""
    try:
        first, *others = choose(name, **goal)
        if (first.expected or 0) > BEYOND * (task.plan.size or inf):
            return None
        return follow_any(replace(task, plan=first), others, nobody)
    except HmkctaError as error:
        if error.reason not in NOT_FOLLOWED:
            raise
        return None


def _leaves_little(model: Model, before: Model, plan: Plan) -> bool:
    """Whether the other goal led to a model so near the plan's, or the one before, that going on has never paid."""
    if plan.snr is not None:
        return model.nbytes > (1 - SPARED) * before.nbytes
    return model.nbytes > USED * (plan.size or inf)


def _is_better(found: Model, model: Model, plan: Plan) -> bool:
    """Whether what was found for the other goal does more for the plan's."""
    if plan.snr is not None:
        return found.snr >= plan.snr and found.nbytes < model.nbytes
    return found.nbytes <= (plan.size or model.nbytes) and found.snr > model.snr
