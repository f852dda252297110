"""Candidates for the plan of a goal: what they are as plans, and the bytes of their files beside the numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis, Organisation, mode_sizes
from ..filesize import planned_bytes
from ..plan import MOST_RANKS, MOST_RANKS_ALONE, LevelSpec, Plan, clusters_of_grid
from ..ranks.allocation import empty_node_bytes, node_bytes, row_bytes
from ..streaming.source import Source


@dataclass(frozen=True)
class Candidate:
    """A way to build the model.

    Attributes:
        organisation: of axes into modes.
        grid: number of blocks along each source axis.
        undecomposed: mode numbers.
        carried: the blocks, or the whole, are nodes with ranks of their own below a first level of rank one; else they
            are the cells of a single level, all of the same ranks.
        cuts: carried blocks may each be cut into so many, or a divisor of it, along each source axis; (): they are not.
        clusters: of the data along each mode, in the place of blocks, the cells of a single level; (): none.
        bits: of a number in the file; those of a first level of rank one are always 16.
    """

    organisation: Organisation
    grid: tuple[int, ...]
    undecomposed: tuple[int, ...] = ()
    carried: bool = True
    cuts: tuple[int, ...] = ()
    clusters: tuple[int, ...] = ()
    bits: int = 16

    @property
    def kind(self) -> tuple[Organisation, tuple[int, ...], bool]:
        """What candidates of a kind share, whatever their blocks."""
        return self.organisation, self.undecomposed, self.carried

    @property
    def blocks(self) -> tuple[Organisation, tuple[int, ...], bool]:
        """What candidates of the same blocks share, whatever their undecomposed modes."""
        return self.organisation, self.grid, self.carried


class Scored(NamedTuple):
    """A candidate and what it is `worth`: dB; of those that reach an SNR, that and the octaves of bytes it spares."""

    worth: float
    candidate: Candidate


def plan_of(source: Source, best: Candidate, snr: float | None, size: int | None, decode_cost: int) -> Plan:
    """The candidate as a plan: blocks are cells of one level, or nodes below a first level of rank one."""
    sizes = mode_sizes(source.axes, best.organisation)
    ones = (1,) * len(sizes)
    grid = tuple((axis.name, count) for axis, count in zip(source.axes, best.grid, strict=True) if count > 1)
    clusters = clusters_of(source.axes, best.grid, best.organisation)
    highest = MOST_RANKS_ALONE if len(sizes) - len(best.undecomposed) == 1 else MOST_RANKS
    most = tuple(None if n in best.undecomposed else min(i, decode_cost, highest) for n, i in enumerate(sizes))
    if not best.carried:
        cells = clusters if grid else best.clusters or ones
        own = LevelSpec(most, cells, ones, "most", grid, own=True, bits=best.bits)
        return Plan(best.organisation, (own,), snr, size)
    carrier = LevelSpec(tuple(None if rank is None else 1 for rank in most), clusters, ones, "most", grid)
    cuts = tuple((axis.name, count) for axis, count in zip(source.axes, best.cuts, strict=False) if count > 1)
    own = replace(LevelSpec.of_one_cell(most, best.bits), cuts=cuts)
    return Plan(best.organisation, (carrier, own), snr, size)


def clusters_of(axes: Sequence[Axis], counts: Sequence[int], organisation: Organisation) -> tuple[int, ...]:
    """Blocks along each mode, of the counts along each axis."""
    return clusters_of_grid([(axis.name, count) for axis, count in zip(axes, counts, strict=True)], organisation)


def bytes_beside(source: Source, candidate: Candidate, seed: int) -> float:
    """Bytes of the candidate's file besides what `choices_of` counts of its nodes, with a decode cost of one."""
    whole = planned_bytes(plan_of(source, candidate, None, None, 1), source, seed=seed)
    sizes, clusters, flags, ranks = _carrier(source.axes, candidate)
    if not candidate.carried:
        return whole - float(node_bytes(sizes, ranks, flags, clusters, candidate.bits))
    nodes, stored = prod(clusters), [n for n, flag in enumerate(flags) if not flag]
    rows = sum(sizes[n] * nodes // clusters[n] for n in stored)
    number = candidate.bits / 8
    empty = empty_node_bytes(len(ranks), len(stored), candidate.bits)
    widths = 0 if candidate.bits == 16 else len(stored)
    each = number * float(np.prod(ranks, dtype=np.float64)) + 4 + empty + widths
    return whole - nodes * each - (row_bytes(1, candidate.bits) + number) * rows


def _carrier(
    axes: Sequence[Axis], candidate: Candidate
) -> tuple[tuple[int, ...], tuple[int, ...], list[bool], NDArray[np.int32]]:
    """Mode sizes, clusters, which modes are undecomposed, and ranks of a level of rank one with these blocks."""
    sizes = mode_sizes(axes, candidate.organisation)
    flags = [n in candidate.undecomposed for n in range(len(sizes))]
    clusters = candidate.clusters or clusters_of(axes, candidate.grid, candidate.organisation)
    return sizes, clusters, flags, np.where(flags, sizes, 1).astype(np.int32)
