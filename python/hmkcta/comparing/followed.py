"""Models of plans that were followed for one goal: further ones, and the best."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from math import inf, prod
from typing import NamedTuple

from ..axes import mode_sizes
from ..errors import HmkctaError
from ..filesize import planned_bytes
from ..fitting.fit import EFFORTS
from ..model import Model
from ..plan import Plan
from ..streaming.budget import SIDE_BY_SIDE, followed_together, is_streamed
from ..support.executors import in_order
from .finer import LARGE
from .follow import Task, budget_of, follow, limit_of

#: Reasons why a plan cannot be followed, or none be chosen, that are none to end with: there is a model already.
NOT_FOLLOWED = ("size-too-small", "memory")
#: Share of the nodes below a first level that are taken to store ranks of one, where a plan's least bytes are told:
#: nodes whose rows are alike store nothing.
FILLED = 0.5


class Followed(NamedTuple):
    """A task with a plan, and the model that it came to."""

    task: Task
    model: Model


def fitted_with(task: Task, plans: Iterable[Plan], far: float) -> list[Followed]:
    """The task with the model of its own plan, and with those of further `plans`.

    Left out are plans that cannot be followed, as `further` says; and for an SNR that the best so far reaches those
    that promise to take more than `far` times its bytes.
    """
    plans = _suiting(task, plans)
    task.compared.expect(1 + len(plans))
    (number,) = task.compared.begin(1)
    own = Followed(task, _model(task, number))
    task.compared.end()
    return [own, *_each(task, plans, own, far)]


def further(task: Task, plans: Iterable[Plan], best: Followed | None = None) -> Iterator[Followed]:
    """The task with the models of further plans, in their order, but for those that cannot be followed.

    A plan is left out, as there is a model already, where its smallest file exceeds the size, where memory does not
    suffice, where its organisation is not the one that was given, and where it promises to take more bytes for the SNR
    than the `best`, if that is told, or than a model that is well before it.
    """
    plans = _suiting(task, plans)
    task.compared.expect(len(plans))
    yield from _each(task, plans, best)


def _suiting(task: Task, plans: Iterable[Plan]) -> list[Plan]:
    """Those of the organisation that is given, all of them before any is fitted: it is told how many there are."""
    return [plan for plan in plans if not task.organised or plan.organisation == task.plan.organisation]


def _model(task: Task, number: int) -> Model:
    """What the task's plan comes to, which has this number of all plans that are compared."""
    run = task.run
    told = task.compared.following(number, run.progress)
    return follow(replace(task, run=replace(run, progress=told, journal=run.journal.part(number))))


def _each(task: Task, plans: Sequence[Plan], best: Followed | None, far: float = 1.0) -> Iterator[Followed]:
    """Models of the plans that can be followed, and do not take `far` more times the bytes of the best by then.

    They are followed side by side. So that threads decide nothing, of those before a plan only such count for it as
    would be known by then whatever their number is.
    """
    workers = min(_side_by_side(task), max(1, len(plans)))
    beside = replace(task, run=replace(task.run, threads=max(1, task.run.threads // workers)))
    numbers, ended = task.compared.begin(len(plans)), list[Followed | None]()

    def followed(at: int) -> Followed | None:
        known = [best, *ended[: max(0, at - SIDE_BY_SIDE)]] if best is not None else []
        most = _bytes_to_reach(best_of([each for each in known if each is not None])) if known else inf
        try:
            model = _model(replace(beside, plan=plans[at], most=far * most), numbers[at])
        except HmkctaError as error:
            if error.reason not in NOT_FOLLOWED:
                raise
            return None
        return Followed(replace(task, plan=plans[at]), model)

    for found in in_order(followed, range(len(plans)), workers):
        task.compared.end()
        ended.append(found)
        if found is not None:
            yield found


def _side_by_side(task: Task) -> int:
    """How many plans are followed at once: of arrays so small that the steps of one hardly keep all threads busy."""
    if task.run.device != "cpu":
        return 1
    return followed_together(prod(task.source.shape), task.run.threads, budget_of(task))


def _bytes_to_reach(best: Followed) -> float:
    """What the best takes for the SNR that is asked for, if it reaches that."""
    return best.model.nbytes if best.model.snr >= (best.task.plan.snr or inf) else inf


def best_of(followed: Sequence[Followed]) -> Followed:
    """For a size the model of the highest SNR; for an SNR the smallest that reaches it, or the nearest if none does."""
    snr, nearest = followed[0].task.plan.snr, max(followed, key=lambda each: each.model.snr)
    if snr is None:
        return nearest
    reaching = (each for each in followed if each.model.snr >= snr)
    return min(reaching, key=lambda each: each.model.nbytes, default=nearest)


def may_be(task: Task, plan: Plan) -> bool:
    """Whether numbers have the bits that are asked for."""
    return task.bits in (None, plan.levels[-1].bits)


def is_verbatim(plan: Plan) -> bool:
    """Whether it leaves the values as they are."""
    return len(plan.levels) == 1 and not any(plan.levels[0].ranks)


def is_worth(task: Task) -> bool:
    """Whether other plans like it are fitted as well: where that takes seconds, unless it should be fast."""
    return prod(task.source.shape) <= LARGE and is_held(task)


def is_held(task: Task) -> bool:
    """Whether memory holds the array, and plans are compared at all."""
    compared = task.run.effort.candidates > EFFORTS["fast"].candidates
    return compared and not is_streamed(prod(task.source.shape), limit_of(task))


def is_behind(model: Model, best: Model, snr: float | None, far: tuple[float, float]) -> bool:
    """Whether it is so `far` from the best, for a size in dB, for an SNR in times its bytes."""
    return model.snr < best.snr - far[0] if snr is None else model.nbytes > far[1] * best.nbytes


def fitting(task: Task, plans: Iterable[Plan], best: Model) -> list[Plan]:
    """Those that there are rows and bytes for."""
    return [plan for plan in plans if fits(task, plan, best)]


def fits(task: Task, plan: Plan, best: Model) -> bool:
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
