"""Plans whose ranks come in smaller steps: one node may be cut into a block more or less along some axes.

A rank of a node costs every row of its modes and every one of its cells. Where that is a large step, a goal lies
between two ranks, and the ranks of another number of blocks between those.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import isinf, prod

from ..axes import Axis
from ..grids import SMALLEST_EDGE
from ..plan import MOST_RANKS, LevelSpec, Plan

#: Elements of an array up to which a chosen plan is made finer at once: a rank is a large step there, and it takes a
#: second at the most.
SMALL = 1 << 18
#: Elements beyond which no plan is made finer: a rank is a small step, and to try takes long.
LARGE = 1 << 24
#: Axes along which numbers of blocks are tried.
MOST_AXES = 3
#: An SNR goal is far exceeded by more than so many dB.
ABOVE = 0.3
#: One rank more is a large step up from this one.
FEW_RANKS = 3
#: A size goal is far from used where less than this share of it is.
USED = 0.95


def finer(plan: Plan, axes: Sequence[Axis]) -> Plan | None:
    """The plan of one node with one block more or less along the axes that are cut most, or else the longest.

    None for plans of more nodes, of clusters of the data, of large arrays, and where there is nothing to cut.

    >>> from hmkcta import parse_plan
    >>> axes = [Axis("y", 40), Axis("x", 60)]
    >>> str(finer(parse_plan("R<=8,8 grid=x:3", [("y",), ("x",)]), axes))
    'R<=8,8 grid=x:2-4,y:1-2'
    """
    (level, *more), modes = plan.levels, plan.organisation
    if more or not level.own or level.cuts or level.fewest or (level.cells > 1 and not level.grid):
        return None
    if prod(axis.size for axis in axes) > LARGE:
        return None
    decomposed = {name for rank, mode in zip(level.ranks, modes, strict=True) if rank is not None for name in mode}
    counts = {axis.name: dict(level.grid).get(axis.name, 1) for axis in axes}
    cut = [axis for axis in axes if axis.name in decomposed]
    cut = [axis for axis in cut if (counts[axis.name] + 1) * SMALLEST_EDGE <= axis.size]
    cut = sorted(cut, key=lambda axis: (counts[axis.name], axis.size), reverse=True)[:MOST_AXES]
    if not cut:
        return None
    most = dict(level.grid) | {axis.name: counts[axis.name] + 1 for axis in cut}
    fewest = tuple((axis.name, max(1, counts[axis.name] - 1)) for axis in cut)
    return replace(plan, levels=(level.cut_into(tuple(most.items()), modes, fewest),))


def more_blocks(plan: Plan, axes: Sequence[Axis], times: float) -> Plan | None:
    """The plan of one node in so many times as many blocks, along the axis that is cut most.

    None for plans that `finer` has nothing for, without blocks, and where these are as short as may be.

    >>> from hmkcta import parse_plan
    >>> axes = [Axis("y", 40), Axis("x", 600)]
    >>> str(more_blocks(parse_plan("R<=8,8 grid=y:2,x:30", [("y",), ("x",)]), axes, 1.2))
    'R<=8,8 grid=y:2,x:36'
    """
    level = plan.levels[0]
    if not level.grid or finer(plan, axes) is None:
        return None
    name, count = max(level.grid, key=lambda each: each[1])
    most = next(axis.size for axis in axes if axis.name == name) // SMALLEST_EDGE
    more = min(int(times * count), most)
    grid = tuple((axis, more if axis == name else blocks) for axis, blocks in level.grid)
    return None if more <= count else replace(plan, levels=(level.cut_into(grid, plan.organisation),))


def parted(plan: Plan, axes: Sequence[Axis]) -> Iterator[Plan]:
    """The plan of one node with a merged mode parted into its axes, one mode at a time: a rank of one of these is a
    smaller step than a rank of all together.

    >>> from hmkcta import parse_plan
    >>> axes = [Axis("y", 40), Axis("x", 60), Axis("light", 9)]
    >>> [str(each) for each in parted(parse_plan("R<=8,*", [("y", "x"), ("light",)]), axes)]
    ['R<=40,60,9']
    """
    (level, *more), sizes = plan.levels, {axis.name: axis.size for axis in axes}
    is_one = level.cells == 1 or bool(level.fewest)  # of a choice of blocks one node may have come
    if more or not level.own or not is_one or prod(sizes.values()) > LARGE:
        return
    for n in (n for n, mode in enumerate(plan.organisation) if len(mode) > 1):
        apart = tuple((name,) for name in plan.organisation[n])
        modes = (*plan.organisation[:n], *apart, *plan.organisation[n + 1 :])
        ranks = [min(MOST_RANKS, prod(sizes[name] for name in mode)) for mode in modes]
        yield replace(plan, organisation=modes, levels=(LevelSpec.of_one_cell(ranks, level.bits),))


def is_far_beyond(plan: Plan, snr: float, nbytes: int) -> bool:
    """Whether a fit went far beyond the plan's goal: more dB, or fewer bytes."""
    if plan.snr is not None:
        return plan.snr + ABOVE < snr and not isinf(snr)
    return plan.size is not None and nbytes < USED * plan.size


def has_large_steps(fitted: Plan) -> bool:
    """Whether a rank of its one node is a large step, so that few bits or many had to make up for what was between two.

    >>> from hmkcta import parse_plan
    >>> modes = [("light",), ("y", "x")]
    >>> [has_large_steps(parse_plan(text, modes)) for text in ("R=*,2", "R=*,9", "R=2,2 C=4,4")]
    [True, False, False]
    """
    one = fitted.levels[0] if len(fitted.levels) == 1 else None  # of zeros nothing is stored, not even a level
    return one is not None and one.cells == 1 and 0 < max(rank or 0 for rank in one.ranks) <= FEW_RANKS
