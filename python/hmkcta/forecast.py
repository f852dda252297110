"""What following a plan will take, told before the work: memory, scratch space, time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, prod

from .choosing.judging import CARES
from .comparing.finer import LARGE
from .fitting.disjoint import JUDGING
from .fitting.fit import EFFORTS, Effort
from .fitting.memberships import ROUNDS, ROWS, ROWS_EACH
from .fitting.subdivision import CAP
from .fitting.workset import check_worksets, fitting_bytes, projected_share, workset, worksets
from .measure import SLAB as MEASURED
from .measure_streamed import slab_within
from .plan import LevelSpec, Plan
from .streaming.budget import (
    FLAT,
    MODEL,
    ROW,
    TRIED_APART,
    WORKING,
    followed_together,
    is_streamed,
    joint_bytes,
    memory_limit,
    model_bytes,
    nodes_of,
    numbers,
    part_sizes,
    room_beside,
    sampled_together,
)
from .streaming.source import SLAB as CHECKED
from .streaming.streamed import SLAB
from .support.memory import memory_budget, stays_cached

#: Bytes for each element of a tensor in memory of its residual, which lasts; the rest of `WORKING` does not.
_RESIDUAL = 4
#: The same of a second residual, to which each attempt at a goal goes back.
_SAVED = 4
#: Bytes for each element of a slab that quality is measured on.
_MEASURING = 36
#: The same of a streamed tensor: the slab, what is left of it, and the parts of that.
_MEASURED_OUTSIDE = 12
#: Bytes of the interpreter with everything loaded.
_LOADED = 84 * 2**20
#: Those of them that are still taken when the work begins.
_BASE = 56 * 2**20
#: Share of the bytes of a stage that its heaps keep from the next one.
_KEPT = 0.3
#: Bytes for each element of a slab of the source that is checked.
_CHECKED = 17
#: The same of the slab after it, which is read meanwhile.
_NEXT = 6
#: Bytes for each element of a sample that plans are judged on: for a size, and for an SNR (float64, or many ranks).
_SAMPLED = (18, 32)
#: Share of these that each further thread takes: samples are seldom at their largest together.
_BESIDE = 0.6
#: Bytes for each element of a block that shares none with others: it is fitted in place.
_BLOCK = 8
#: The same of a workset of one cell.
_ALONE = 12
#: The same of a node beside its share of the residual, where others are fitted one after another.
_BELOW = 10
#: Copies of a slab that are made while it is read and worked on.
_SLAB_COPIES = 3.5
#: The same while it is cut into blocks.
_SLAB_CUT = 2.7
#: The same of its projections.
_SLAB_SEEN = 1
#: As many numbers for each byte that an SNR is expected to take has the largest model of others it is compared with.
_LARGER = 4
#: How much larger than the average the largest sub-tensors get by a mode of two clusters, K = 1; for K > 1 see `CAP`.
_UNEVEN_TWO = 1.1
#: The same by a mode of more clusters.
_UNEVEN_MORE = 1.8
#: Bytes that heaps keep while many plans are fitted one after another.
_HEAPS_COMPARED = 24 * 2**20
#: Bytes that the heaps of threads keep while sub-tensors come and go.
_HEAPS = 20 * 2**20
#: The same where nodes choose their ranks.
_HEAPS_OWN = 34 * 2**20
# Times are nanoseconds of one core of a 2023 server.
#: For each element: to read, hash and look at the source.
_SOURCE_NS = 20.0
#: For each element: to measure quality.
_MEASURE_NS = 15.0
#: For each element: to find a start.
_START_NS = 25.0
#: For each element: a sweep.
_SWEEP_NS = 15.0
#: For each element: a round of HOOI.
_HOOI_NS = 10.0
#: For each element: to have a piece, or to write it and read it.
_PIECE_NS = 10.0
#: For each row, cluster and start: k-means.
_ROW_NS = 215.0
#: For each element of each cell: a sweep of cells in turn.
_VISIT_NS = 6.5
#: For each number of H: a joint sweep.
_GRAM_NS = 80.0
#: For each number of a model: to find, refine and pack it.
_NUMBER_NS = 250.0
#: For each node: whatever is done beside work on its elements, which holds the interpreter.
_NODE_NS = 1.5e6
#: For each element: to look at what nodes leave that are cut in a further way.
_WAY_NS = 30.0
#: For each block of such a way: the same, which holds the interpreter.
_BLOCK_NS = 7.5e5
#: What each further thread does of the work of one.
_SECOND = 0.7
# How many times as long as the fit of a chosen plan takes, those take of others that it is compared with:
#: of arrays of more than `LARGE` elements,
_OTHERS_OF_LARGE = 2
#: of others, for a size, where the plan has several levels,
_OTHERS = 6
#: the same for an SNR,
_OTHERS_FOR_SNR = 12
#: and where it has one level, as then numbers of clusters are tried.
_OTHERS_OF_ONE_LEVEL = 20


@dataclass(frozen=True)
class Forecast:
    """Bytes of memory at most, bytes of scratch space on disk, seconds to follow a plan, and seconds to fit others that
    a chosen one is compared with. Seconds are for a server core, within a factor; those for others are a guess.

    >>> from hmkcta.plan import parse_plan
    >>> from hmkcta.fitting.fit import EFFORTS
    >>> modes = (("light",), ("view",), ("y",), ("x",))
    >>> plan = parse_plan("R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2 / R=2,2,3,3 C=3,3,4,4 K=2", modes)
    >>> cost = forecast(plan, (174, 58, 400, 380), EFFORTS["fast"], threads=2, memory=1_400_000_000)
    >>> cost.memory < 1_400_000_000, cost.seconds < 300
    (True, True)
    """

    memory: int
    scratch: int
    seconds: float
    comparing: float = 0.0


def forecast(
    plan: Plan, sizes: Sequence[int], effort: Effort, threads: int, memory: int | None, *, held: int = 0,
    choosing: int = 0, decode_cost: int = 4096, stored: int | None = None,
) -> Forecast:
    """The cost of a plan for a tensor of the given mode sizes, `memory` bytes allowed (None: half of what is free).

    `stored` are the bytes of the source (None: as many as float32 takes), `held` the same if it is in memory as a
    whole; `choosing` those that `choosing_bytes` tells, 0 if the plan is given; `decode_cost` bounds ranks of nodes'
    own. Memory is also for the model, unless an SNR decides how large that will be and no sample told.
    """
    limit, elements = memory_limit(plan, sizes, memory), prod(sizes)
    own_numbers = _own_numbers(plan, sizes, decode_cost)
    own_model = _own_bytes(plan, sizes, own_numbers)
    model = model_bytes(plan, sizes, threads, room_beside(elements, memory)) + own_model
    streamed = is_streamed(elements, limit)
    others = _others(plan, elements, effort) if choosing and not streamed else 0

    def found(peak: int, scratch: int = 0, cut: int | None = None) -> Forecast:
        seconds = _seconds(plan, sizes, effort, threads, limit, own_numbers, cut)
        comparing = others * seconds
        if choosing and effort == EFFORTS["thorough"]:  # which does all that `medium` does first
            comparing += (1 + others) * _seconds(plan, sizes, EFFORTS["medium"], threads, limit, own_numbers, cut)
        return Forecast(held + peak, scratch, seconds, comparing)

    own = plan.levels[-1].own
    if not streamed:
        compared = others > 0 and elements <= LARGE
        fit = int((_working(plan, threads) + (_SAVED if own else 0)) * elements)
        measuring = _RESIDUAL * elements + _MEASURING * min(elements, MEASURED)
        features = _parting_bytes(plan, sizes, compared=compared)
        theirs = model if plan.snr is None else max(model, _most_of_others(plan, elements))
        # One other is seldom followed to the end.
        side_by_side = followed_together(elements, threads, memory_budget(memory))
        fits = [side_by_side * (fit + theirs), fit + model] if compared and others > 1 else [fit + model]
        return found(_peak(choosing, *fits, measuring, beside=features + (_HEAPS_COMPARED if compared else 0)))
    check_worksets(plan, sizes, limit, memory)
    if limit == elements:  # fitted in place
        return found(_peak(choosing, FLAT * elements + model))
    cut = next((n for n, level in enumerate(plan.levels[:-1]) if level.cells > 1), None)
    measuring = _MEASURED_OUTSIDE * threads * min(slab_within(limit), elements)
    working = model + max(_outside(plan, sizes, limit, threads, cut), measuring)
    copies = _copies(plan, effort, cut, at_hand=stays_cached(4 * elements if stored is None else stored))
    # Its bytes are counted on a model of zeros before the fit, whose memory the heaps keep a share of.
    return found(_peak(choosing, own_model, working), 4 * elements * copies, cut)


def _copies(plan: Plan, effort: Effort, cut: int | None, *, at_hand: bool) -> int:
    """How many times the tensor is written to scratch files; pieces of a source that is `at_hand` are collected."""
    if cut is None:
        return int(any(level.disjoint or level.cuts for level in plan.levels))
    if plan.levels[-1].own:  # a state to go back to
        return 2
    collected = at_hand and not any(level.disjoint for level in plan.levels)
    return int(not collected or effort.backfits > 0 or cut < len(plan.levels) - 2)


def _others(plan: Plan, elements: int, effort: Effort) -> int:
    """How many times as long as its own fit those take of plans that a chosen one in memory is compared with."""
    if effort.candidates <= EFFORTS["fast"].candidates:
        return 0 if plan.size is None else 1
    if elements > LARGE:
        return _OTHERS_OF_LARGE
    if len(plan.levels) == 1:
        return _OTHERS_OF_ONE_LEVEL
    return _OTHERS if plan.snr is None else _OTHERS_FOR_SNR


def _most_of_others(plan: Plan, elements: int) -> int:
    """Bytes of the largest model of those that are compared for an SNR: of as many numbers as there are values, if no
    sample told what the plan takes."""
    return (2 * MODEL + 2 * TRIED_APART) * min(elements, _LARGER * (plan.expected or elements))


def _outside(plan: Plan, sizes: Sequence[int], limit: int, threads: int, cut: int | None) -> int:
    """Bytes for fitting the levels of a streamed tensor: on worksets, or on sub-tensors or blocks in memory."""
    most = _slabs(plan, sizes, limit, threads, cut)
    elements = prod(sizes)
    for number, (level, fitted) in enumerate(zip(plan.levels, worksets(plan, sizes, limit), strict=True)):
        below = cut is not None and number > cut
        together = fitted * max(1, min(threads, limit // max(1, fitted)))
        if level.disjoint and fitted <= limit:
            each = _BLOCK * max(together, JUDGING * fitted if level.own else 0)
        elif below:
            alone = fitting_bytes(sizes, level, limit) if level.cells == 1 else WORKING * fitted
            each = alone * together // max(1, fitted)
        elif level.disjoint:
            each = (_ALONE if level.cells == 1 else WORKING) * fitted
        else:
            each = fitting_bytes(sizes, level, limit)
        # Inner products are the model's.
        products = level.clamped(sizes).products_bytes
        joint = joint_bytes(sizes, level, threads) - products if prod(sizes) > limit else 0
        most = max(most, each + (0 if not below else _HEAPS_OWN if level.own else _HEAPS), joint)
        if number == cut and not level.grid:
            most = max(most, WORKING * min(limit, threads * _largest(elements, level)))
        sizes = part_sizes(sizes, level)
    return most


def _own_numbers(plan: Plan, sizes: Sequence[int], decode_cost: int) -> int:
    """Numbers of a last level whose nodes have ranks of their own, as many as its bytes hold; 0 where none are known.

    An SNR does not say how many it takes, but a sample may have told.
    """
    *above, (spec, nodes, parts) = nodes_of(plan, sizes)
    if not spec.own:
        return 0
    left = max(1, decode_cost - sum(level.decode_cost() for level, _, _ in above))
    whole = prod(size for size, rank in zip(parts, spec.ranks, strict=True) if rank is None)
    cores = prod(rank for rank in spec.ranks if rank is not None)
    most = numbers(parts, spec) - spec.cells * whole * max(0, cores - left)
    return min(nodes * most, 8 * (plan.size or plan.expected or 0) // spec.bits)


def _own_bytes(plan: Plan, sizes: Sequence[int], own_numbers: int) -> int:
    """Bytes of that level's model; what is tried beside it is of one node."""
    *_, (_, nodes, _) = nodes_of(plan, sizes)
    return 2 * MODEL * own_numbers + 2 * TRIED_APART * own_numbers // nodes


def _working(plan: Plan, threads: int) -> float:
    """Bytes for each element of a tensor in memory, of the level that takes most."""
    nodes, most = 1, 0.0
    for level in plan.levels:
        if nodes == 1:
            most = max(most, _BLOCK if level.disjoint and not level.own else WORKING)
        else:
            most = max(most, _RESIDUAL + _BELOW * min(1.0, threads / nodes))
        nodes *= level.cells
    return most


def _parting_bytes(plan: Plan, sizes: Sequence[int], *, compared: bool) -> int:
    """Bytes of features of rows, where a level has clusters of the data, or is `compared` with plans that do."""
    level = plan.levels[-1]
    if not level.own:
        return 0  # counted with its model
    if compared:
        return ROW * max(sizes)
    parted = [size for size, count in zip(sizes, level.clusters, strict=True) if count > 1 and not level.grid]
    return ROW * max(parted, default=0)


def _slabs(plan: Plan, sizes: Sequence[int], limit: int, threads: int, cut: int | None) -> int:
    """Bytes for the slabs of a streamed tensor that are at work together."""
    outside = plan.levels[: None if cut is None else cut + 1]
    copies: float = _SLAB_CUT
    if not outside[0].disjoint:
        copies = _SLAB_COPIES + _SLAB_SEEN * max(projected_share(sizes, level) for level in outside)
    slab = min(SLAB, prod(sizes))
    return int(4 * copies * slab * max(1, min(threads, limit // SLAB)))


def choosing_bytes(elements: int, effort: Effort, threads: int, memory: int | None, snr: float | None) -> int:
    """Most bytes that choosing a plan, for an SNR in dB or a size, takes beside the process and a source in memory.

    >>> 100e6 < choosing_bytes(1 << 23, EFFORTS["medium"], threads=2, memory=None, snr=40.0) < 300e6
    True
    """
    together = sampled_together(elements, memory, snr)
    sample = min(elements, together, CARES.get(effort, CARES[EFFORTS["medium"]]).refine)
    further = max(1, min(threads, together // (2 * sample))) - 1
    # Blocks are seldom thinned to less than twice what is asked for.
    sampled = _SAMPLED[snr is not None] * min(elements, 2 * sample)
    checked = _CHECKED * min(elements, CHECKED) + _NEXT * min(max(0, elements - CHECKED), CHECKED)
    return checked + int(sampled * (1 + _BESIDE * further))


def _peak(*stages: int, beside: int = 0) -> int:
    """Most bytes of a process that needs those of `stages` one after another, and `beside` for a moment besides."""
    most = max(need + _KEPT * sum(stages[:number]) for number, need in enumerate(stages))
    return max(_LOADED, _BASE + beside + int(most))


def _largest(elements: int, level: LevelSpec) -> int:
    """Elements of the largest sub-tensors that a level is cut into."""
    modes = [(c, k) for c, k in zip(level.clusters, level.mixture, strict=True) if c > 1]
    uneven = prod(_UNEVEN_TWO if c == 2 else CAP if k > 1 else _UNEVEN_MORE for c, k in modes)
    return int(uneven * elements / level.cells)


def _seconds(
    plan: Plan, sizes: Sequence[int], effort: Effort, threads: int, limit: int, own_numbers: int, cut: int | None
) -> float:
    elements, beside, each = prod(sizes), 0.0, _SOURCE_NS + (0 if cut is None else _PIECE_NS * (1 + effort.backfits))
    if cut is None or effort.backfits or plan.levels[-1].own:  # else it was seen what levels leave
        each += _MEASURE_NS
    own_numbers = own_numbers or elements  # no plan that is worth following has more
    alone, nodes = 0.0, 1
    for number, level in enumerate(plan.levels, start=1):
        own = effort.at(number, len(plan.levels))
        sweep = _HOOI_NS if level.cells == 1 else _SWEEP_NS
        if level.search == "fast":
            fit = _VISIT_NS * _visits(level, own.hooi)
        else:
            fit = sweep * (1 + own.hooi) if level.cells == 1 else _START_NS + sweep * own.sweeps
        if prod(sizes) > limit and not level.disjoint:  # on a workset, and two passes for all rows
            fit = fit * workset(sizes, level, limit) / prod(sizes) + 2 * sweep
        each += fit
        if level.cells > 1 and not level.grid and level.scheme != "uniform":  # k-means is of rows, not of elements
            rows = sum(_visited(size, count) * count for size, count in zip(sizes, level.clusters, strict=True))
            tried = own.candidates if max(level.mixture) == 1 else own.starts
            beside += _ROW_NS * max(1, tried - 1) * rows * elements / prod(sizes)
        beside += min(_NUMBER_NS * own_numbers if level.own else inf, nodes * _model_ns(level, sizes, own.sweeps))
        if len(plan.levels) > 1:
            each += effort.backfits * (_SWEEP_NS + 10)
        further = level.ways(plan.organisation)[1:]
        each += _WAY_NS * len(further)
        alone += nodes * (_NODE_NS + _BLOCK_NS * sum(way.cells for way in further))
        nodes = min(nodes * level.cells, elements)
        sizes = part_sizes(sizes, level)
    return 1e-9 * ((each * elements + beside) / (1 + _SECOND * (threads - 1)) + alone)


def _visited(size: int, clusters: int) -> int:
    """Rows that k-means takes all its rounds for, and a share of the others, which have one."""
    some = min(size, max(ROWS, ROWS_EACH * clusters))
    return 0 if clusters == 1 else some + (size - some) // (2 * ROUNDS)


def _model_ns(level: LevelSpec, sizes: Sequence[int], sweeps: int) -> float:
    """Nanoseconds for what the model of a node takes beside its elements."""
    spec = level.clamped(sizes)
    overlap = max(spec.mixture) > 1
    if overlap and spec.search != "fast":
        return _GRAM_NS * sweeps * spec.products_bytes / 8
    # Cells in turn begin anew for each cluster more, and their residual goes through the cache again and again.
    return _NUMBER_NS * numbers(sizes, spec) * (max(spec.mixture) ** 2 if overlap else 1)


def _visits(level: LevelSpec, sweeps: int) -> int:
    """How often an element is visited where cells are fitted in turn, and rows get one cluster more mode after mode."""
    visits = mixture = 1
    for most in level.mixture:
        for count in range(1, most):
            more = mixture // count * (count + 1)
            visits, mixture = visits + mixture + more, more
    return visits + sweeps * mixture
