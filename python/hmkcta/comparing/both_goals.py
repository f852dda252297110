"""Compare a model with those that the other goal leads to: of a size with plans for more dB, of an SNR with plans for
fewer bytes.

What is of low rank, or has few distinct values, is all but exact from some rank on. Then it is the rounding of numbers
that tells plans apart, and each goal looks at others: an SNR at second levels for what rounding leaves, a size at what
fills it.
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
from .follow import Task
from .followed import NOT_FOLLOWED, is_verbatim
from .rivals import Choose, follow_any, is_worth

#: Rounding tells plans apart from so many dB on, and up to what float32 holds.
FROM, UP_TO = 40.0, 118.0
#: The other goal is so many dB more, or so large a share of the bytes; and while it leads on, so often.
FURTHER, FEWER, STEPS = 6.0, 0.95, 4
#: It leads on no further from what exceeds an SNR by less than so many dB, or uses such a share of a size.
EXCESS, USED = 1.0, 0.96
#: Plans for more dB that are expected to take so many times a size are not followed.
BEYOND = 4
#: Elements up to which it takes seconds.
SMALL = 1 << 22


def follow_both(
    task: Task, others: Sequence[Plan], missed: Callable[[str], None], choose: Choose, ceiling: float | None
) -> Model:
    """What `follow_any` comes to for the task's goal, or for the other goal where that does better.

    Bytes need not be spent beyond `ceiling` dB, where there is one. What ends as the values themselves is left at that:
    a size of nearly as many bytes leads to plans of a cluster for every few rows, which take minutes.
    """
    model = follow_any(task, others, missed, choose)
    if not is_worth(task) or not are_compared(task.source) or is_verbatim(model.plan):
        return model
    if ceiling is not None and task.plan.snr is not None:  # it was chosen for a size, which the ceiling ended
        found = _followed(task, choose, "plan-of-ceiling", {"snr": ceiling})
        model = model if found is None or not _is_better(found, model, task.plan) else found
    for number in range(STEPS):
        other = _other_goal(task.plan, model, ceiling)
        found = None if other is None else _followed(task, choose, f"plan-of-other-goal-{number}", other)
        if found is None or not _is_better(found, model, task.plan):
            break
        model = found
        if _leaves_little(model, task.plan):
            break
    return model


def are_compared(source: Source) -> bool:
    """Whether its models, if plans are compared at all, are compared with those of the other goal: from some dB on."""
    return prod(source.shape) <= SMALL and source.value_transform.is_identity


def _other_goal(plan: Plan, model: Model, ceiling: float | None) -> dict[str, Any] | None:
    """The other goal to try from a model, as arguments of `choose`; None: it would tell nothing."""
    if model.snr < FROM:
        return None
    if plan.snr is not None:
        return {"snr": None, "size": int(FEWER * model.nbytes)} if model.snr >= plan.snr else None
    most = UP_TO if ceiling is None else ceiling
    return {"snr": min(model.snr + FURTHER, most), "size": None} if model.snr < most else None


def _followed(task: Task, choose: Choose, name: str, goal: dict[str, Any]) -> Model | None:
    """The model of plans that are chosen for a goal; None where there is none."""
    try:
        first, *others = choose(name, **goal)
        if (first.expected or 0) > BEYOND * (task.plan.size or inf):
            return None
        return follow_any(replace(task, plan=first), others, nobody)
    except HmkctaError as error:
        if error.reason not in NOT_FOLLOWED:
            raise
        return None


def _leaves_little(model: Model, plan: Plan) -> bool:
    """Whether a model that the other goal led to is so near the plan's that going on has never paid."""
    if plan.snr is not None:
        return model.snr < plan.snr + EXCESS
    return model.nbytes > USED * (plan.size or inf)


def _is_better(found: Model, model: Model, plan: Plan) -> bool:
    """Whether what was found for the other goal does more for the plan's."""
    if plan.snr is not None:
        return found.snr >= plan.snr and found.nbytes < model.nbytes
    return found.nbytes <= (plan.size or model.nbytes) and found.snr > model.snr
