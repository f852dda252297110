"""Bytes of the file of a written plan before it is fitted: its numbers within bounds, its tables by estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, log2, prod

from .axes import Axis, mode_sizes
from .plan import LevelSpec, Plan

#: Bytes of a float16 number, and of the factor of a core.
NUMBER_BYTES, SCALE_BYTES = 2, 4
#: Bytes of a header: its fields, and what each axis, stage and node adds. 490 to 900 on data of two to five axes.
HEADER_BYTES, AXIS_BYTES, STAGE_BYTES, NODE_BYTES = 330, 45, 130, 2
#: A label takes about so many bits more than log2 of their number: that it differs from the one before, and adapting.
LABEL_BITS = 1.5


@dataclass(frozen=True)
class LevelSize:
    """What a level of a plan takes in the file.

    Attributes:
        nodes: most nodes.
        numbers: most core and basis numbers of all nodes.
        exact: whether `numbers` is exact, unless a node has nothing to approximate.
        table_bytes: estimated bytes of clusters, parts of rows and factors of cores.
        decode_cost: most multiply-adds for one scattered element.
    """

    nodes: int
    numbers: int
    exact: bool
    table_bytes: int
    decode_cost: int

    @property
    def number_bytes(self) -> int:
        """Most bytes of the numbers."""
        return NUMBER_BYTES * self.numbers


def level_sizes_of(plan: Plan, axes: Sequence[Axis]) -> list[LevelSize]:
    """What every level of a plan takes on an array with these axes.

    >>> from hmkcta.plan import parse_plan
    >>> axes = Axis("y", 8), Axis("x", 10)
    >>> [(size.numbers, size.exact) for size in level_sizes_of(parse_plan("R=2,3 / R=1 C=2", (("y",), ("x",))), axes)]
    [(52, True), (40, True)]
    """
    sizes = mode_sizes(axes, plan.organisation)
    lengths = {axis.name: axis.size for axis in axes}
    least, most = list(sizes), list(sizes)  # rows of any node
    parts = [1] * len(sizes)  # of every mode, by all levels above
    found: list[LevelSize] = []
    for number, level in enumerate(plan.levels, start=1):
        nodes = prod(parts)
        ranks = [rows if rank is None else min(rank, rows) for rank, rows in zip(level.ranks, most, strict=True)]
        every = [size * (nodes // part) for size, part in zip(sizes, parts, strict=True)]  # rows of all nodes
        exact = all(rank is None or rank <= rows for rank, rows in zip(level.ranks, least, strict=True)) and all(
            clusters <= rows for clusters, rows in zip(level.clusters, least, strict=True))
        tables = _table_bytes(level, nodes, every, last=number == len(plan.levels))
        cost = prod(rank * mixture for rank, mixture, given in zip(ranks, level.mixture, level.ranks, strict=True)
                    if given is not None)
        found.append(LevelSize(nodes, _numbers(level, ranks, nodes, every), exact, tables, cost))
        least, most = _part_rows(plan, level, lengths, least, most)
        parts = [part * clusters for part, clusters in zip(parts, level.clusters, strict=True)]
    return found


def header_bytes(plan: Plan, axes: Sequence[Axis]) -> int:
    """Estimated bytes of the frame, the header and coordinates."""
    coordinates = sum(0 if axis.coords is None else 8 * axis.coords.size for axis in axes)
    return HEADER_BYTES + AXIS_BYTES * len(axes) + STAGE_BYTES * len(plan.levels) + coordinates


def _numbers(level: LevelSpec, ranks: Sequence[int], nodes: int, every: Sequence[int]) -> int:
    """Most core and basis numbers of all nodes, which have `every` rows together in each mode."""
    bases = sum(rows * mixture * (level.cells // clusters) * rank
                for rows, clusters, mixture, rank, given
                in zip(every, level.clusters, level.mixture, ranks, level.ranks, strict=True) if given is not None)
    return bases + nodes * level.cells * prod(ranks)


def _table_bytes(level: LevelSpec, nodes: int, every: Sequence[int], *, last: bool) -> int:
    """Estimated bytes: labels of rows, as if no two neighbours were in the same clusters, and factors of cores."""
    bits = 0.0
    for rows, clusters, mixture in zip(every, level.clusters, level.mixture, strict=True):
        if clusters > 1:
            bits += rows * (mixture * log2(clusters) + LABEL_BITS)
            bits += 0 if last else rows * (log2(max(mixture, 2)) if mixture > 1 else 0)
    return ceil(bits / 8) + nodes * (NODE_BYTES + SCALE_BYTES * level.cells)


def _part_rows(
    plan: Plan, level: LevelSpec, lengths: dict[str, int], least: Sequence[int], most: Sequence[int]
) -> tuple[list[int], list[int]]:
    """The fewest and most rows of the parts of a level's nodes; a cluster may have one row, or all but some."""
    fewest = [rows if c == 1 else 1 for rows, c in zip(least, level.clusters, strict=True)]
    largest = [max(1, rows - c + 1) for rows, c in zip(most, level.clusters, strict=True)]
    if not level.disjoint:
        return fewest, largest
    counts = dict(level.grid)
    low = [prod(lengths[axis] // counts.get(axis, 1) for axis in mode) for mode in plan.organisation]
    high = [prod(-(-lengths[axis] // counts.get(axis, 1)) for axis in mode) for mode in plan.organisation]
    whole = list(least) == list(most)  # no level above has cut anything
    return (low if whole else fewest), [min(a, b) for a, b in zip(most, high, strict=True)]
