"""How many clusters of the data there should be, told by fits: more and fewer, along one mode or along two axes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from math import prod

from ..axes import Organisation
from ..goals import misses
from ..narrow import BITS
from ..plan import Plan
from .alternatives import EITHER, EITHER_BELOW, has_clusters, joined, with_bits, with_clusters_times
from .follow import Task
from .followed import Followed, best_of, fits, fitting, further, is_behind, is_worth

#: How many clusters along two axes are tried first: for the goal, and for an SNR at a size besides.
JOINED = (4, 12)
#: Share of a model's bytes at which numbers of clusters are first compared for an SNR.
SPARED = 0.9
#: More or fewer of them are tried from so many dB below the SNR on.
CATCHING_UP = 3.0
#: Clusters along two axes are not tried where a model takes more than this share of the values as float32.
DENSE = 0.2
#: Elements up to which the number of clusters is looked for in all `STEPS`; of larger arrays in the last one alone.
IN_ALL_STEPS = 1 << 22
#: Factors by which the number of clusters is raised and lowered, one after the other, and for each how far a model may
#: lie behind the best to be started from as well: in dB for a size, in times the bytes for an SNR.
FINEST = 1.125
STEPS = {1.5: (1.5, 1.25), 1.25: (0.75, 1.125), FINEST: (0.75, 1.125)}


def with_best_clusters(best: Followed, followed: Sequence[Followed]) -> Followed:
    """The best of what was followed, and of that with more clusters of the data and with fewer.

    They are looked for from the best of each organisation and number of levels that has clusters along one mode, unless
    that is far behind: with more clusters, or fewer, it may be ahead.
    """
    kinds, snr = dict[tuple[Organisation, int], list[Followed]](), best.task.plan.snr
    for each in (best, *followed):
        if has_clusters(each.task.plan):
            kinds.setdefault((each.task.plan.organisation, len(each.task.plan.levels)), []).append(each)
    starts, tried = [best_of(same) for same in kinds.values()], set[Plan]()
    for step in STEPS if prod(best.task.source.shape) <= IN_ALL_STEPS else [FINEST]:
        near = [start for start in starts if not is_behind(start.model, best.model, snr, STEPS[step])]
        near = [start for start in near if not _is_hopeless(start, best)]
        starts = [with_other_clusters(start, [step], tried) for start in near]
        best = best_of([best, *starts])
    return best


def _is_hopeless(start: Followed, best: Followed) -> bool:
    """Whether it is far from an SNR that the best reaches in fewer bytes: more clusters take more of them."""
    goal = best.task.plan.snr
    if goal is None or misses(best.model.snr, goal):
        return False
    return start.model.snr < goal - CATCHING_UP and best.model.nbytes < start.model.nbytes


def with_other_clusters(start: Followed, steps: Iterable[float], tried: set[Plan]) -> Followed:
    """The best of more clusters of the data and of fewer, in such steps while that helps; none that was `tried`."""
    task, found = start.task, start
    tried.add(task.plan)
    for step in steps:
        before = None
        while found is not before:
            before, near = found, (with_clusters_times(found.task.plan, factor) for factor in (step, 1 / step))
            plans = [plan for plan in near if plan is not None and plan not in tried and fits(task, plan, found.model)]
            tried.update(plans)
            found = best_of([found, *further(task, plans, found)])
    return found


def with_joined(own: Followed) -> Followed:
    """The best of a model and of nodes for clusters along two axes at a time."""
    task, plain = own.task, own.task.source.organisation(None)
    if not _is_small(task) or misses(own.model.snr, task.plan.snr) or _is_dense(own):
        return own
    few, more = (list(joined(task.plan, plain, count)) for count in JOINED)
    narrow = min(BITS) if task.bits is None and own.model.snr < EITHER_BELOW else task.plan.levels[-1].bits
    begun = [*further(task, fitting(task, (with_bits(plan, narrow) for plan in few), own.model), own)]
    best = best_of(begun or [own])
    is_near = task.plan.snr is None and best.model.snr > own.model.snr - CATCHING_UP
    if begun and (is_near or best_of([own, best]) is best):
        best = with_other_clusters(best, STEPS, set())
    return best_of([own, best, in_fewer_bytes(own, more)])


def in_fewer_bytes(own: Followed, begin: Sequence[Plan]) -> Followed:
    """For an SNR the best of a model and of what reaches it in fewer bytes, by numbers of clusters that suit these."""
    task, goal = own.task, own.task.plan.snr
    if goal is None or (least := _least_reaching(own, goal, begin)) is None:
        return own
    as_asked = replace(task, plan=replace(least.task.plan, snr=goal, size=None))
    return best_of([own, Followed(as_asked, least.model), *further(task, [as_asked.plan], own)])


def _least_reaching(own: Followed, goal: float, begin: Sequence[Plan]) -> Followed | None:
    """What reaches an SNR in the fewest bytes, of some plans to begin with and their like with more or fewer clusters.

    How many clusters there should be shows in dB at a size, where every few more help, long before it shows in the
    bytes that an SNR takes. So they are compared at a size, fewer bytes than there are now, until one reaches the SNR;
    then at half of it. None: not one does at the first size, or all are far from it with the clusters to begin with.
    """
    found, size = None, int(SPARED * own.model.nbytes)
    bits = min(BITS) if own.task.bits is None and goal < EITHER[0] else own.task.plan.levels[-1].bits
    while True:
        at_size = [replace(with_bits(plan, bits), snr=None, size=size) for plan in begin]
        if not (tried := [*further(own.task, fitting(own.task, at_size, own.model))]):
            return found
        best = best_of(tried)
        if found is None and best.model.snr < goal - CATCHING_UP:
            return None
        if misses(best.model.snr, goal):
            best = with_other_clusters(best, STEPS, set())
        if misses(best.model.snr, goal):
            return found
        found, size, begin = best, size // 2, [best.task.plan]


def _is_dense(own: Followed) -> bool:
    """Whether a model takes so much of the values that there is no outline of a thing outside which all is alike."""
    return own.model.nbytes > DENSE * 4 * prod(own.task.source.shape)


def _is_small(task: Task) -> bool:
    """Whether numbers of clusters are looked for in all steps."""
    return is_worth(task) and prod(task.source.shape) <= IN_ALL_STEPS
