"""Plans like one that was followed, which only a fit can tell from it: some are better, no sample says for which data.

Blocks of a grid are neighbours; clusters of the data, as many, need not be. What float16 leaves of a large mean is more
than the rest is worth, unless a level of rank one takes the mean away first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

from ..axes import Organisation
from ..narrow import BITS
from ..plan import MOST_RANKS, LevelSpec, Plan
from .finer import is_far_beyond

#: From this SNR in dB on, the error of the numbers themselves, by their bits, is not small beside what a level leaves.
ROUNDING_FROM = {16: 55.0, 8: 55.0}
#: Between these SNRs in dB either 8 or 16 bits a number may make the smaller file.
EITHER = (60.0, 72.0)
#: Below a level of rank one the same holds up to so many dB.
EITHER_BELOW = 80.0
#: Bytes are tried in a first level of files of fewer dB: they leave it some 43.
BYTES_DO = 42.0
#: Blocks of a mode up to which clusters of the data take their place: finding more takes minutes.
FEW_CLUSTERS = 512
#: How many times as many nodes of clusters are tried as there were clusters in a node.
MORE_NODES = (1, 4, 16)
#: Cells of a plan's first level up to which nodes for clusters along two axes are tried.
FEW_NODES = 64


def alternatives(plan: Plan, plain: Organisation, snr: float, nbytes: int) -> Iterator[Plan]:
    """Plans for the same goal to compare a model with, of which `snr` dB and `nbytes` came; `plain` merges no axes.

    >>> from hmkcta import parse_plan
    >>> plain = (("y",), ("x",))
    >>> [str(each) for each in alternatives(parse_plan("R=1,1 grid=x:3 / R<=8,8", plain), plain, 40.0, 1000)]
    ['R=1,1 C=1,3 / R<=8,8', 'R=1,1 grid=x:3 / R<=8,8 bits=8']
    >>> [str(each) for each in alternatives(parse_plan("R<=8,*", plain), plain, 86.0, 1000)]
    ['R=1,* / R<=8,*', 'R=1,1 / R<=160,160']
    """
    first, *others = plan.levels
    if len(others) == 1 and others[0].own and first.grid and 1 < max(first.clusters) <= FEW_CLUSTERS:
        yield replace(plan, levels=(_of_data(first, first.clusters), *others))
        yield from gathered(plan)
    if first.bits == min(BITS) and EITHER[0] < _asked(plan, snr) < EITHER[1]:
        yield with_bits(plan, max(BITS))
    yield from narrower(plan, snr)
    if others or not first.own or all(rank is None for rank in first.ranks):
        return
    if snr > ROUNDING_FROM[first.bits]:
        yield from below_rank_one(plan, first.bits)
        whole = whole_plan(plan, plain)
        yield replace(whole, levels=(_of_rank_one(whole.levels[0]), *whole.levels))
    if first.cells == 1 and not first.grid and is_far_beyond(plan, snr, nbytes):
        for n in (n for n, rank in enumerate(first.ranks) if rank is not None):
            halves = tuple(2 if m == n else 1 for m in range(first.order))
            yield replace(plan, levels=(_of_data(first, halves),))


def narrower(plan: Plan, snr: float) -> Iterator[Plan]:
    """The plan with packed numbers instead of float16, where they may do, also below a level of rank one.

    >>> from hmkcta import parse_plan
    >>> [str(each) for each in narrower(parse_plan("R<=8,*", (("y",), ("x",))), 45.0)]
    ['R<=8,* bits=8', 'R=1,* / R<=8,* bits=8']
    """
    if plan.levels[-1].bits == min(BITS) or _asked(plan, snr) >= EITHER_BELOW:
        return
    if len(plan.levels) > 1 or _asked(plan, snr) < EITHER[1]:
        yield with_bits(plan, min(BITS))
    yield from below_rank_one(plan, min(BITS))


def _asked(plan: Plan, snr: float) -> float:
    """What numbers have to do, in dB: a rank may be a step far beyond it."""
    return snr if plan.snr is None else min(snr, plan.snr)


def below_rank_one(plan: Plan, bits: int) -> Iterator[Plan]:
    """The plan's one level of ranks of its own below a level of rank one; blocks stay, clusters of the data do not.

    >>> from hmkcta import parse_plan
    >>> [str(each) for each in below_rank_one(parse_plan("R<=8,* C=4,1", (("y",), ("x",))), 8)]
    ['R=1,* / R<=8,* bits=8']
    """
    first, *others = plan.levels
    if not others and first.own and any(first.ranks):
        below = first if first.grid else replace(first, clusters=(1,) * first.order)
        yield replace(plan, levels=(_of_rank_one(first), replace(below, bits=bits)))


def with_bits(plan: Plan, bits: int) -> Plan:
    """The plan with so many bits for a number of its last level, and at least as many above.

    >>> from hmkcta import parse_plan
    >>> str(with_bits(parse_plan("R=1 / R=2", (("y",), ("x",))), 8))
    'R=1,1 / R=2,2 bits=8'
    """
    above = (replace(level, bits=max(bits, level.bits)) for level in plan.levels[:-1])
    return replace(plan, levels=(*above, replace(plan.levels[-1], bits=bits)))


def first_in_bytes(plan: Plan, snr: float) -> Iterator[Plan]:
    """The plan, which came to so many dB, with bytes instead of float16 in its first level above a packed one.

    Where that level leaves little of them for the last one to do better: it may hold a quarter of all bytes.

    >>> from hmkcta import parse_plan
    >>> [str(each) for each in first_in_bytes(parse_plan("R=1 C=1,4 / R<=8 bits=8", (("y",), ("x",))), 30.0)]
    ['R=1,1 C=1,4 bits=8 / R<=8,8 bits=8']
    """
    first, *others = plan.levels
    if others and others[-1].bits < first.bits and not first.own and _asked(plan, snr) < BYTES_DO:
        yield replace(plan, levels=(replace(first, bits=min(BITS)), *others))


def nodes_of_clusters(plan: Plan) -> Iterator[Plan]:
    """For a plan of one level with clusters along one mode: plans that make nodes of such clusters, as many and more.

    The first level has rank one and the clusters; below it each cluster is a node with ranks of its own, or none where
    its rows are alike. The last plans, of as many and of more, also part the other modes into their axes.

    >>> from hmkcta import parse_plan
    >>> nodes = nodes_of_clusters(parse_plan("R<=8,* C=16,1", (("y",), ("x", "rgb"))))
    >>> [str(each) for each in nodes][1:4]
    ['R=1,* C=64,1 / R<=8,*', 'R=1,* C=256,1 / R<=8,*', 'R=1,1,1 C=16,1,1 / R<=8,160,160']
    """
    first, *others = plan.levels
    if others or not first.own or not _is_of_one_mode(first):
        return
    clustered = plan.organisation[first.clusters.index(first.cells)]
    counts = [min(first.cells * times, FEW_CLUSTERS) for times in MORE_NODES]
    for count in counts:
        yield _nodes(plan, plan.organisation, first.ranks, clustered, count)
    parts = [((mode,) if clusters > 1 else tuple((name,) for name in mode), rank)
             for mode, rank, clusters in zip(plan.organisation, first.ranks, first.clusters, strict=True)]
    modes = tuple(mode for part, _ in parts for mode in part)
    if len(modes) > first.order:
        ranks = tuple(rank if len(part) == 1 else MOST_RANKS for part, rank in parts for _ in part)
        yield from (_nodes(plan, modes, ranks, clustered, count) for count in counts[:2])


def with_clusters_times(plan: Plan, factor: float) -> Plan | None:
    """A plan of ranks of its own, for clusters of the data along one mode or for nodes of them, with so many times as
    many; else None.

    >>> from hmkcta import parse_plan
    >>> str(with_clusters_times(parse_plan("R<=8,* C=16,1", (("y",), ("x",))), 1.5))
    'R<=8,* C=24,1'
    """
    first, *others = plan.levels
    count = max(2, round(first.cells * factor))
    if not has_clusters(plan) or count == first.cells:
        return None
    return replace(plan, levels=(_of_data(first, _counted(first, count)), *others))


def has_clusters(plan: Plan) -> bool:
    """Whether it has ranks of its own for clusters of the data along one mode, or for nodes of them."""
    return not plan.levels[2:] and plan.levels[-1].own and _is_of_one_mode(plan.levels[0])


def _is_of_one_mode(level: LevelSpec) -> bool:
    """Whether its cells are clusters of the data along one mode."""
    return not level.grid and 1 < level.cells == max(level.clusters)


def _counted(level: LevelSpec, count: int) -> tuple[int, ...]:
    """So many clusters along the mode that has clusters."""
    return tuple(count if clusters > 1 else 1 for clusters in level.clusters)


def gathered(plan: Plan) -> Iterator[Plan]:
    """Nodes for clusters of the data along one mode, into which those that a grid cuts are merged: things of any shape.

    >>> from hmkcta import parse_plan
    >>> video = (("time",), ("y",), ("x",))
    >>> [str(each) for each in gathered(parse_plan("R=1 grid=y:4,x:6 / R<=8 cut<=x:2", video))]
    ['R=1,1 C=1,24 / R<=8,160']
    """
    first, below = plan.levels
    cut = [n for n, count in enumerate(first.clusters) if count > 1]
    if not 2 <= len(cut) < first.order or first.cells > FEW_CLUSTERS:
        return
    kept = [n for n in range(first.order) if n == cut[0] or n not in cut]
    merged = tuple(name for n in cut for name in plan.organisation[n])
    modes = tuple(merged if n == cut[0] else plan.organisation[n] for n in kept)
    yield _nodes(plan, modes, tuple(MOST_RANKS if n == cut[0] else below.ranks[n] for n in kept), merged, first.cells)


def joined(plan: Plan, plain: Organisation, count: int) -> Iterator[Plan]:
    """Plans whose nodes are so many clusters of the data along two merged axes, for each two axes.

    Clusters along two axes follow the outline of a thing, outside which all is alike. There are none for fewer than
    three axes, and where the plan's first level has more than 64 blocks already.

    >>> from hmkcta import parse_plan
    >>> volume = (("time",), ("y",), ("x",))
    >>> [str(each) for each in joined(parse_plan("R<=8", volume), volume, 4)][:2]
    ['R=1,1 C=4,1 / R<=160,160', 'R=1,1 C=4,1 / R<=160,160']
    """
    if len(plain) < 3 or (plan.levels[0].grid and plan.levels[0].cells > FEW_NODES):
        return
    for a, b in combinations(range(len(plain)), 2):
        merged = plain[a] + plain[b]
        modes = tuple(merged if n == a else mode for n, mode in enumerate(plain) if n != b)
        yield _nodes(plan, modes, (MOST_RANKS,) * len(modes), merged, count)


def _nodes(
    plan: Plan, modes: Organisation, ranks: tuple[int | None, ...], clustered: tuple[str, ...], count: int
) -> Plan:
    """The plan's goal with nodes, of up to these ranks, for so many clusters of the data along one of these modes."""
    below = LevelSpec.of_one_cell(ranks, plan.levels[-1].bits, plan.levels[-1].scheme)
    clusters = tuple(count if mode == clustered else 1 for mode in modes)
    return replace(plan, organisation=modes, levels=(_of_data(_of_rank_one(below), clusters), below))


def whole_plan(plan: Plan, plain: Organisation) -> Plan:
    """The plan of the same goal that merges no axes and cuts none: ranks of their own for the whole (HOSVD)."""
    whole = LevelSpec.of_one_cell((MOST_RANKS,) * len(plain), plan.levels[-1].bits, plan.levels[0].scheme)
    return replace(plan, organisation=plain, levels=(whole,))


def _of_data(level: LevelSpec, clusters: tuple[int, ...]) -> LevelSpec:
    """The level with clusters of the data, each row in one, in the place of blocks."""
    return replace(level, clusters=clusters, mixture=(1,) * level.order, grid=(), fewest=(), cuts=())


def _of_rank_one(level: LevelSpec) -> LevelSpec:
    """A level of one cell that has rank one wherever this one has ranks."""
    ones = (1,) * level.order
    return LevelSpec(tuple(None if rank is None else 1 for rank in level.ranks), ones, ones, level.scheme)
