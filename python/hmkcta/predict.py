"""What a plan will cost, told before the work: bytes of the file and memory."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod

from .memory import check_memory, memory_budget
from .plan import LevelSpec, Plan

#: Most elements of a tensor that is fitted in one piece: more elements fit it no better.
WORKSET = 1 << 26
#: Fewer elements than these (or than all there are) are too few to fit a level to.
SMALLEST = 1 << 20
#: Bytes for each of them: the tensor, its residual, and what is made on the way; and bytes of the process itself.
WORKING, PROCESS = 14, 200 * 2**20
#: Bytes for each element of a tensor that is fitted in place, by sweeps alone.
FLAT = 5
#: Bytes of the header kept free for digits that are not known before the fit, and of an axis without coordinates.
HEADER_SLACK, PLAIN_AXIS = 160, 81
#: Bytes of tables: of a node besides its rows and cells, of a node for each mode, of a cell.
_NODE, _NODE_MODE, _CELL = 12, 24, 4
#: Bytes of tables for each row a node owns: a cluster number, and where it goes at the next level.
_CLUSTER, _PART_LOCAL = 2, 6


def memory_limit(plan: Plan, sizes: Sequence[int], memory: int | None) -> int:
    """How many elements are worked on at once as one tensor; a larger tensor is streamed.

    Raises:
        HmkctaError: the memory given is less than even a streamed fit takes.
    """
    if memory is not None:
        least = PROCESS + WORKING * min(prod(sizes), SMALLEST)
        check_memory(least, "compressing this array", "allow more with --max-memory", memory)
    limit = max(1, min(WORKSET, (memory_budget(memory) - PROCESS) // WORKING))
    first = next((level for level in plan.levels if level.cells > 1), plan.levels[0])
    if prod(sizes) <= limit or first.search != "fast":
        return limit
    # Its cells are too many for joint rows: nothing but sweeps over a residual in memory.
    check_memory(PROCESS + FLAT * prod(sizes), f"a level of {first.cells} cells", "fewer clusters, more levels", memory)
    return prod(sizes)


def is_streamed(elements: int, limit: int) -> bool:
    """Whether a tensor of so many elements is read from its source again and again rather than held."""
    return elements > min(limit, WORKSET)


def predicted_bytes(plan: Plan, sizes: Sequence[int]) -> int | None:
    """Bytes of the file; None where they follow from the data, as ranks of each node's own do for an SNR.

    Counts every node and cell as if it carried something, so files come out at or below it.

    >>> from hmkcta.plan import parse_plan
    >>> modes = (("light",), ("view",), ("y",), ("x",))
    >>> predicted_bytes(parse_plan("R=4,4,6,6", modes), (72, 24, 96, 96)) // 1024
    9
    """
    if plan.levels[-1].own and plan.size is None:
        return None
    order, further = len(sizes), len(plan.levels) - 1
    total = float(header_bytes(order, 1 + further) + PLAIN_AXIS * sum(len(mode) for mode in plan.organisation))
    nodes, rows = 1, [float(size) for size in sizes]  # rows of each mode that a node owns, on average
    for number, level in enumerate(plan.levels, start=1):
        if level.own:
            break
        spec = level.clamped([max(1, round(size)) for size in rows])
        total += nodes * level_bytes(spec, rows, last=number == len(plan.levels))
        nodes *= spec.cells
        rows = [size / count for size, count in zip(rows, spec.clusters, strict=True)]
    return round(total) if plan.size is None else plan.size


def header_bytes(order: int, levels: int) -> int:
    """What the header of a file takes besides its axes: names, shapes and checksums of every array.

    Measured on files with `order` modes, none of them undecomposed.
    """
    return HEADER_SLACK + 1320 + 800 * order + (levels - 1) * (940 + 1130 * order)


def level_bytes(spec: LevelSpec, rows: Sequence[float], *, last: bool) -> float:
    """Bytes of one node that owns so many rows of each mode."""
    decomposed = [(size, k, c, r) for size, k, c, r in
                  zip(rows, spec.mixture, spec.clusters, spec.ranks, strict=True) if r is not None]
    core = prod(size if r is None else r for size, r in zip(rows, spec.ranks, strict=True))
    numbers = spec.cells * core + sum(size * k * (spec.cells // c) * r for size, k, c, r in decomposed)
    tables = _NODE + _NODE_MODE * len(rows) + _CELL * spec.cells
    tables += sum(size * (_CLUSTER * k + (0 if last else _PART_LOCAL)) for size, k, _, _ in decomposed)
    return 2 * numbers + tables
