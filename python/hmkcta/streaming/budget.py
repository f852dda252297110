"""How much of a tensor is worked on at once: what memory holds, and no more than a level needs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import prod

from ..plan import AUTO, LevelSpec, Plan
from ..support.memory import available_memory, check_memory, memory_budget

#: Most elements of a tensor that is fitted in one piece: more elements fit it no better.
WORKSET = 1 << 26
#: Fewer elements than these (or than all there are) are too few to fit a level to.
SMALLEST = 1 << 20
#: Bytes for each element worked on: the tensor, its residual, and what is made on the way.
WORKING = 14
#: Bytes of the process itself.
PROCESS = 200 * 2**20
#: Bytes for each byte of a model's float16 numbers: these are held in float32, rounded, and packed.
MODEL = 4
#: Further ones while a node is fitted whose cells share elements: starts and sweeps keep the best beside what they try.
TRIED = 11
#: The same where cells share none.
TRIED_APART = 7
#: Bytes for each byte of the inner products M_n(c, c'), with what is made of them.
PRODUCTS = 2
#: Matrices of the size of H while the rows of a mode are solved for.
GRAMS = 3
#: Bytes of a node with its tables.
NODE = 2500
#: Bytes of a row with its features, where clusters are looked for.
ROW = 192
#: Bytes for each element of a tensor that is fitted in place, by sweeps alone.
FLAT = 5
#: Elements of the samples by which a goal's model is searched at the least, and bytes for each of them.
SEARCHED, EACH = 1 << 20, 40


def memory_limit(plan: Plan, sizes: Sequence[int], memory: int | None, budget: int | None = None) -> int:
    """How many elements are worked on at once as one tensor; a larger tensor is streamed.

    Args:
        plan: whose model takes memory, too.
        sizes: the mode sizes I_n.
        memory: bytes that are allowed; None: all that are free.
        budget: bytes to work in; None: `memory_budget`.

    Raises:
        HmkctaError: the memory given is less than even a streamed fit takes.
    """
    check_least_memory(prod(sizes), memory, choosing=False)
    beyond = _beyond(plan, sizes, memory)
    budget = memory_budget(memory) if budget is None else budget
    # Where half of what is free does not suffice, all of it may: then no fewer elements than are enough are worked on.
    enough = min(prod(sizes), SMALLEST, workset_limit(budget))
    limit = max(enough, workset_limit(budget - beyond))
    number, first = next(((n, level) for n, level in enumerate(plan.levels) if level.cells > 1), (0, plan.levels[0]))
    if prod(sizes) <= limit or _jointly(first, sizes, memory):
        return limit
    # Its cells are too many for joint rows: nothing but sweeps over a residual in memory.
    what = f"level {number + 1} ({first}), {first.cells} cells"
    least = PROCESS + FLAT * prod(sizes) + beyond
    check_memory(least, what, "raise --max-memory, or fewer clusters, more levels", memory)
    return prod(sizes)


def _beyond(plan: Plan, sizes: Sequence[int], memory: int | None) -> int:
    """Bytes that the model of a plan takes beyond what a process is reckoned with.

    Raises:
        HmkctaError: the memory given, or what is free, has no room for it beside the least of a tensor.
    """
    beyond = max(0, model_bytes(plan, sizes) - PROCESS // 2)
    least = PROCESS + WORKING * min(prod(sizes), SMALLEST) + beyond
    check_memory(least, "the model of this plan", "raise --max-memory, or fewer clusters, lower ranks", memory)
    return beyond


def room_beside(elements: int, memory: int | None) -> int:
    """Bytes for what the nodes that are fitted together take beside the tensor."""
    return memory_budget(memory) - PROCESS // 2 - WORKING * min(elements, workset_limit(memory))


def side_by_side(spec: LevelSpec, sizes: Sequence[int], threads: int, room: int) -> int:
    """How many nodes of these sizes are fitted side by side, by so many threads at most: as many as have room."""
    return max(1, min(threads, room // max(1, tried_bytes(spec, sizes))))


def model_bytes(plan: Plan, sizes: Sequence[int], threads: int = 1, room: int = 0) -> int:
    """Bytes that the model of a plan takes: of all levels, and of the nodes that are fitted together.

    >>> from hmkcta.plan import parse_plan
    >>> plan = parse_plan("R=8 / R=8 C=6,8,8,8 K=1", [("light",), ("view",), ("y",), ("x",)])
    >>> model_bytes(plan, (50, 50, 50, 50)) // 2**20
    278
    """
    held, most = 0, 0
    for spec, nodes, parts in nodes_of(plan, sizes):
        held += nodes * (NODE + MODEL * 2 * numbers(parts, spec))
        most = max(most, held + side_by_side(spec, parts, min(nodes, threads), room) * tried_bytes(spec, parts))
    return most


def tried_bytes(spec: LevelSpec, sizes: Sequence[int]) -> int:
    """Bytes that a node takes beside its model and its elements while it is fitted."""
    spec = spec.clamped(sizes)
    if not any(spec.ranks):  # nothing is tried
        return 0
    node = 2 * numbers(sizes, spec)
    if max(spec.mixture) > 1:
        # Where H does not fit it is H of one set of clusters, and what it comes of.
        products = max(clusters_alone(spec, n).products_bytes for n in range(spec.order)) if spec.search == "fast" \
            else spec.products_bytes
        return TRIED * node + PRODUCTS * products
    if spec.disjoint:
        return TRIED_APART * node // spec.cells
    parted = [size for size, count in zip(sizes, spec.clusters, strict=True) if count > 1]
    return TRIED_APART * node + ROW * max(parted, default=0)


def numbers(sizes: Sequence[int], level: LevelSpec) -> int:
    """Numbers of a level on a node of these sizes, of cores and bases; all ranks as high as they may be."""
    spec = level.clamped(sizes)
    parts = list(zip(sizes, spec.clusters, spec.mixture, spec.ranks, strict=True))
    bases = sum(size * k * (spec.cells // c) * rank for size, c, k, rank in parts if rank is not None)
    return bases + spec.cells * prod(size if rank is None else rank for size, _, _, rank in parts)


def nodes_of(plan: Plan, sizes: Sequence[int]) -> Iterator[tuple[LevelSpec, int, Sequence[int]]]:
    """Of every level what its nodes have rows for, how many they are, and their sizes, were they equal."""
    nodes = 1
    for level in plan.levels:
        spec = level.clamped(sizes)
        yield spec, nodes, sizes
        nodes, sizes = nodes * spec.cells, part_sizes(sizes, spec)


def part_sizes(sizes: Sequence[int], level: LevelSpec) -> tuple[int, ...]:
    """Sizes of the parts that a level's clusters cut a node into, were they equal."""
    return tuple(-(-size // count) for size, count in zip(sizes, level.clamped(sizes).clusters, strict=True))


def workset_limit(memory: int | None) -> int:
    """How many elements of a tensor that is fitted on worksets are worked on at once."""
    return max(1, min(WORKSET, (memory_budget(memory) - PROCESS) // WORKING))


def _jointly(level: LevelSpec, sizes: Sequence[int], memory: int | None) -> bool:
    """Whether rows that memory does not hold can be joint ones; those of cells that share no element need not be."""
    if max(level.mixture) > 1:
        return level.search != "fast"
    allowed = available_memory() if memory is None else memory
    return allowed is None or PROCESS // 2 + joint_bytes(sizes, level) <= allowed


def clusters_alone(spec: LevelSpec, n: int) -> LevelSpec:
    """The spec with no more clusters in mode n than a row is in."""
    clusters = tuple(k if m == n else c for m, (c, k) in enumerate(zip(spec.clusters, spec.mixture, strict=True)))
    return replace(spec, clusters=clusters, grid=())


def with_searches(plan: Plan, sizes: Sequence[int], room: int, memory: int | None) -> Plan:
    """The plan with joint searches in those levels, too, whose H and inner products have room in so many bytes.

    Raises:
        HmkctaError: a level is asked to be searched jointly, and the memory given, or what is free, has no room for it.
    """
    levels = list[LevelSpec]()
    for number, (level, (own, _, _)) in enumerate(zip(plan.levels, nodes_of(plan, sizes), strict=True), start=1):
        needed = PRODUCTS * own.products_bytes + GRAMS * 8 * own.columns**2 if max(own.mixture) > 1 else 0
        if level.asked in (AUTO, "fast"):
            widened = level.asked == AUTO and own.search == "fast" and needed <= room
            levels.append(replace(level, asked=own.joint_search) if widened else level)
        else:
            what = f"the {level.asked} search of level {number} ({level})"
            check_memory(PROCESS + needed, what, "raise --max-memory, or leave --search out", memory)
            levels.append(level)
    return replace(plan, levels=tuple(levels))


def joint_bytes(sizes: Sequence[int], level: LevelSpec, threads: int = 1) -> int:
    """Bytes that joint rows of a level take on a node of these sizes that is streamed.

    They are for `sides` of the mode that has most, of the slabs at work and in all, and for the inner products.
    """
    spec = level.clamped(sizes)
    if spec.disjoint or spec.search == "fast":
        return 0
    columns = [(size, spec.cells * rank) for size, rank in zip(sizes, spec.ranks, strict=True) if rank is not None]
    most = max((size * count for size, count in columns), default=0)
    return 8 * (3 + threads) * most + spec.products_bytes


def check_least_memory(elements: int, memory: int | None, *, choosing: bool) -> None:
    """Refuse to begin with less memory than any plan, or `choosing` a model for a goal, takes.

    Raises:
        HmkctaError: the memory given is less than even a streamed fit, or the smallest samples, take.
    """
    if memory is not None:
        least = PROCESS + (EACH * min(elements, SEARCHED) if choosing else WORKING * min(elements, SMALLEST))
        check_memory(least, "compressing this array", "allow more with max_memory or --max-memory", memory)


def is_streamed(elements: int, limit: int) -> bool:
    """Whether a tensor of so many elements is read from its source again and again rather than held."""
    return elements > min(limit, WORKSET)
