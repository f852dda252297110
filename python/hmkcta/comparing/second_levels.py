"""Plans of two levels, where the numbers of one are not exact enough: a second level for what their rounding leaves.

The ranks of the first are those that it was fitted with for less, alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf, prod

from ..axes import mode_sizes
from ..model import Model
from ..narrow import BITS
from ..plan import LevelSpec, Plan
from .alternatives import whole_plan, with_bits
from .follow import Task
from .followed import Followed, best_of, further, is_verbatim, may_be

#: SNR in dB at which a first level of two ends, whose ranks are fixed, by the bits of its numbers: about what their
#: rounding lets one level keep. Packed numbers, of ranks that a goal chooses, keep more.
ROUNDED, PACKED = {16: 68.0, 8: 43.0}, 62.0
#: A first level that ends below so many dB gets no second one: that would have too much to do.
SHORT = 40.0
#: Below an SNR goal of so many dB, and for a size, the second level is tried with packed numbers as well.
BOTH = 106.0
#: SNR in dB at which a first level of bytes ends that is fitted alone: what bytes keep of most values.
OF_BYTES = 36.0
#: How many such first levels are fitted at most, and how many plans with such a first level come of a call.
FIRSTS = 2
#: How many dB packed numbers hold of what a level above leaves; for an SNR more and less are tried as well.
HELD = (28.0, 34.0, 22.0)
#: A level of float16 numbers above packed ones is worth having from so many dB on.
LEAST_ABOVE = 12.0
#: Of how many of the plans that were followed it is tried, such as differ in organisation or undecomposed modes; of
#: arrays of more than `FEW_ELEMENTS` of the best alone, once.
UNCUT, FEW_ELEMENTS = 5, 1 << 22


def whole_of(task: Task) -> Plan:
    """The plan that merges and cuts nothing, of ranks up to the lengths of its axes."""
    whole = whole_plan(task.plan, task.source.organisation(None))
    sizes = mode_sizes(task.source.axes, whole.organisation)
    return replace(whole, levels=tuple(level.clamped(sizes) for level in whole.levels))


def below_rounding(task: Task, others: Sequence[Plan]) -> Iterator[Plan]:
    """The task's plan, the others, and one that merges and cuts nothing, with a first level that ends at what its
    numbers keep, and a second for what that leaves. The first levels are fitted as plans are asked for.

    Where ranks do not reach that, the last of them gain little: then one that ends a dB before them, too. What ends
    far below is left: the second level would have too much to do.
    """
    for plan in dict.fromkeys(map(_in_one, (task.plan, *others, whole_of(task)))):
        if len(plan.levels) != 1 or is_verbatim(plan):
            continue
        enough = ROUNDED[plan.levels[-1].bits]
        goal = replace(plan, size=None, snr=enough)
        firsts = [each for each in further(task, [goal]) if each.model.snr > SHORT]
        firsts += further(task, [replace(goal, snr=model.snr - 1) for _, model in firsts if model.snr < enough])
        below = [plan for plan in (deeper(*each) for each in firsts) if plan is not None]
        # Packed numbers do for what a level leaves, and hold some 60 dB of it.
        narrow = [with_bits(each, min(BITS)) for each in below if (task.plan.snr or 0.0) < BOTH]
        both = dict.fromkeys([*(each for each in narrow if task.bits is None), *below])
        yield from (replace(each, snr=task.plan.snr, size=task.plan.size) for each in both)


def with_packed_below(best: Followed, followed: Sequence[Followed]) -> Followed:
    """The best of a model and of packed numbers below a float16 level, which ends so far before it as they hold.

    Packed numbers alone end where their own rounding outweighs what a rank more would gain, and float16 ones take more
    bytes. So float16 are the few numbers that hold most of the energy. Plans that were followed tell which modes have
    ranks; for a size the model that comes of it tells where the level above should end, as long as that helps.
    """
    task = best.task
    if task.bits is not None:
        return best
    open_ranks = (plan for plan in (each.task.plan for each in _best_first(followed)) if not is_verbatim(plan))
    plans = dict.fromkeys(_uncut(plan) for plan in open_ranks if plan.levels[-1].own)
    is_small = prod(task.source.shape) <= FEW_ELEMENTS
    for plan in [*plans][: UNCUT if is_small else 1]:
        helps = True
        while helps:
            found = best_of([best, *_packed_below(best, plan, HELD if is_small else HELD[:1])])
            helps, best = found is not best and task.plan.snr is None, found
    return best


def _packed_below(best: Followed, plan: Plan, held: Sequence[float]) -> Iterator[Followed]:
    """What comes of a plan of one level, ended so many dB before the goal or the best, and packed numbers below it."""
    task, goal = best.task, best.task.plan.snr
    ends = [best.model.snr - held[0]] if goal is None else [goal - each for each in held]
    above = further(task, [replace(plan, snr=end, size=None) for end in ends if LEAST_ABOVE <= end < inf])
    both = [with_bits(two, min(BITS)) for two in (deeper(*each) for each in above) if two is not None]
    yield from further(task, [replace(two, snr=goal, size=task.plan.size) for two in both], best)


def _best_first(followed: Sequence[Followed]) -> list[Followed]:
    """For a size those of the highest SNR first; for an SNR the smallest that reach it, before the others."""
    goal = followed[0].task.plan.snr
    if goal is None:
        return sorted(followed, key=lambda each: -each.model.snr)
    return sorted(followed, key=lambda each: (each.model.snr < goal, each.model.nbytes))


def _uncut(plan: Plan) -> Plan:
    """One level of float16 numbers with ranks of its own, for the modes that have ranks in the plan's last level."""
    last = plan.levels[-1]
    return replace(plan, levels=(LevelSpec.of_one_cell(last.ranks, max(BITS), last.scheme),))


def packed_below_bytes(task: Task, followed: Sequence[Followed]) -> list[Plan]:
    """For an SNR plans of a level of bytes, and a packed level below it for what bytes leave of themselves.

    Its first level is that of a packed plan that came near, or else the last, alone, of one that cuts nothing: the
    task's own plan, or one that was followed.
    """
    goal = task.plan.snr
    if goal is None or not may_be(task, with_bits(task.plan, min(BITS))):
        return []
    short = [each for each in followed if each.task.plan.levels[-1].bits == min(BITS)]
    short = [each for each in short if each.model.snr < min(goal, ROUNDED[min(BITS)])]
    below = [deeper(*each) for each in sorted(short, key=lambda each: -each.model.snr)]
    if not any(below):
        whole = (plan for plan in (task.plan, *(each.plan for each, _ in followed))
                 if plan.levels[-1].own and all(level.cells == 1 for level in plan.levels[:-1]))
        alone = dict.fromkeys(replace(plan, levels=(replace(plan.levels[-1], bits=min(BITS)),), snr=min(goal, OF_BYTES))
                              for plan in whole)
        below = [deeper(*each) for each in further(task, [*alone][:FIRSTS])]
    return [replace(plan, snr=goal) for plan in below if plan is not None][:FIRSTS]


def deeper(task: Task, model: Model) -> Plan | None:
    """A plan of one level as it was fitted, and below it a second with ranks of its own; None where that cannot be."""
    (own, *more), top = task.plan.levels, model.bounds[0]
    own, found = next((way for way in own.ways(task.plan.organisation) if way.clusters == top.clusters), own), top.ranks
    if more or not own.own or model.decode_cost >= task.decode_cost or 0 in found:  # 0: nothing was stored
        return None
    ranks = tuple(None if most is None else rank for most, rank in zip(own.ranks, found, strict=True))
    below = replace(own, clusters=(1,) * own.order, grid=())
    return replace(task.plan, levels=(replace(own, ranks=ranks, own=False), below))


def _in_one(plan: Plan) -> Plan:
    """The plan, or where its nodes are blocks below a level of rank one a level of these blocks, all of equal ranks."""
    first, *others = plan.levels
    if len(others) != 1 or not others[0].own or others[0].cuts or not first.grid:
        return plan
    return replace(plan, levels=(others[0].cut_into(first.grid, plan.organisation),))
