"""Checks of stages: the largest shapes are those that the header says; numbers are finite and in range.

What shaders index by is checked where runs are decoded: nothing is left to the decoders.
"""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..packed import F16, U16, PackedLevel
from .limits import Limits, check_limit
from .reasons import fault
from .stages import Stage

_MAX_F32 = float(np.finfo(np.float32).max)
_F16_INFINITY = 0x7C00
_CHUNK = 1 << 20  # numbers looked at in one go, so that a check needs little memory beside the file


def check_largest(level: PackedLevel, stage: Stage, where: str) -> None:
    """Shaders and limits rely on what the header says."""
    found = level.shape.max(axis=0, initial=0).tolist()
    for i, stated in enumerate(stage.largest):
        if found[i] != stated:
            raise fault("level-bounds", f"{where}.largest[{i}]", stated, found[i])


def check_nodes(level: PackedLevel, stage: Stage, limits: Limits, where: str) -> None:
    """Ranks of decomposed modes, and what an element costs, node by node: a mode may be undecomposed in some alone."""
    mixture, ranks = level.shape[:, 1].astype(np.float64), level.shape[:, 2].astype(np.float64)
    decomposed = mixture > 0
    rank = np.where(decomposed, ranks, 0).max(axis=1, initial=0)
    cost = np.where(decomposed, mixture * ranks, 1).prod(axis=1)
    beyond = level.has_cells & ((rank > limits.rank) | (cost > limits.level_cost))
    if beyond.any():
        at = int(np.argmax(beyond))
        ends = np.cumsum([run.nodes for run in stage.runs])
        run = f"{where}.runs[{np.searchsorted(ends, at, side='right')}]"
        check_limit("rank-limit", run, int(rank[at]), limits.rank)
        own = level.shape[at, 1:].T.tolist()
        check_limit("level-cost-limit", run, prod(k * r for k, r in own if k), limits.level_cost)


def reach_of(level: PackedLevel, where: str) -> float:
    """A bound on all values of a stage, whose numbers must be finite.

    The largest scale times the largest core number times, for every mode, the largest K R of the nodes in which it is
    decomposed times the largest basis number; no factor below 1.
    """
    reach = max(1.0, _largest(level.core_scale, where) * _magnitude(level.core, where))
    for n, basis in enumerate(level.basis):
        mixture, ranks = level.shape[:, 1, n], level.shape[:, 2, n]
        terms = int(mixture.max(initial=0)) * int(ranks[mixture > 0].max(initial=0))
        reach *= max(1.0, terms * _magnitude(basis, where))
    return reach


def check_reach(reach: float, where: str) -> None:
    """No float32 decoder overflows: the sum of the bounds of the stages up to this one is within its range."""
    if reach > _MAX_F32:
        raise fault("value-range", where, f"values up to {reach:.3g}", f"values up to {_MAX_F32:.3g}")


def _largest(array: NDArray[Any], where: str) -> float:
    """The largest magnitude of numbers, all of which must be finite."""
    finite = np.isfinite(array)
    if not finite.all():
        at = int(np.argmin(finite))
        raise fault("not-finite", where, f"{array[at]} at {at}", "finite numbers")
    return float(np.abs(array).max(initial=0))


def _magnitude(array: F16, where: str) -> float:
    """The same of float16 numbers: without their sign bit they ascend as the integers with the same bits do."""
    bits: U16 = array.view(np.uint16)
    largest = 0
    for begin in range(0, bits.size, _CHUNK):
        largest = max(largest, int((bits[begin:begin + _CHUNK] & np.uint16(0x7FFF)).max()))
    if largest >= _F16_INFINITY:
        at = int(np.argmin(np.isfinite(array)))
        raise fault("not-finite", where, f"{array[at]} at {at}", "finite numbers")
    return float(np.array(largest, np.uint16).view(np.float16))
