"""What following a plan will take, told before the work: memory, scratch space, time."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import prod
from pathlib import Path

from .fit import Effort
from .measure import SLAB as MEASURED
from .plan import LevelSpec, Plan
from .predict import FLAT, WORKING, is_streamed, memory_limit
from .streamed import SLAB
from .subdivision import CAP
from .workset import check_worksets, workset

#: Bytes for each element of a tensor in memory: its residual lasts, the rest is `WORKING`; a saved residual for goals.
_RESIDUAL, _SAVED = 4, 4
#: Bytes for each element of a slab that quality is measured on.
_MEASURING = 36
#: Bytes of the interpreter with everything loaded; the share of what a stage took that its heaps keep from the next.
_BASE, _KEPT = 56 * 2**20, 0.3
#: Copies of a slab that are made while it is read and worked on.
_SLAB_COPIES = 4
#: How much larger than the average the largest sub-tensors get for each mode of two, or of more clusters, where rows
#: have one cluster each; where they have more, subdivision has a cap.
_UNEVEN_TWO, _UNEVEN_MORE = 1.1, 1.8
#: Bytes that the heaps of threads keep while sub-tensors come and go.
_HEAPS = 40 * 2**20
#: Nanoseconds of one core for each element: to read, hash, look at and measure the source; to find a start; of a
#: sweep; of HOOI; to write a piece and read it. One core of a 2023 server.
_SOURCE_NS, _START_NS, _SWEEP_NS, _HOOI_NS, _PIECE_NS = 35.0, 25.0, 15.0, 10.0, 15.0


@dataclass(frozen=True)
class Forecast:
    """Bytes of memory at most, bytes of scratch space on disk, seconds; the latter for a server core, within a factor.

    >>> from hmkcta.plan import parse_plan
    >>> from hmkcta.fit import EFFORTS
    >>> modes = (("light",), ("view",), ("y",), ("x",))
    >>> plan = parse_plan("R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2 / R=2,2,3,3 C=3,3,4,4 K=2", modes)
    >>> cost = forecast(plan, (174, 58, 400, 380), EFFORTS["fast"], threads=2, memory=1_400_000_000)
    >>> cost.memory < 1_400_000_000, cost.scratch, cost.seconds < 300
    (True, 6135936000, True)
    """

    memory: int
    scratch: int
    seconds: float


def forecast(
    plan: Plan, sizes: Sequence[int], effort: Effort, threads: int, memory: int | None, *, held: int = 0,
    choosing: int = 0,
) -> Forecast:
    """The cost of a plan for a tensor of the given mode sizes, `memory` bytes allowed (None: half of what is free).

    `held` are the bytes of the source if it is in memory as a whole; `choosing` the most that the process took while it
    chose the plan, 0 if it is given.
    """
    limit, elements = memory_limit(plan, sizes, memory), prod(sizes)
    own, chosen = plan.levels[-1].own, max(0, choosing - held - _BASE)
    if not is_streamed(elements, limit):
        working = WORKING + (_SAVED if own else 0)
        measuring = _RESIDUAL * elements + _MEASURING * min(elements, MEASURED)
        most = held + _peak(chosen, working * elements, measuring)
        return Forecast(most, 0, _seconds(plan, sizes, effort, threads))
    cut = next((n for n, level in enumerate(plan.levels[:-1]) if level.cells > 1), None)
    wholes = plan.levels if cut is None else plan.levels[: cut + 1]
    fitted = max(workset(sizes, level, limit) for level in wholes)
    check_worksets(plan, sizes, limit, memory)
    if limit == elements:  # fitted in place
        return Forecast(held + _peak(chosen, FLAT * elements), 0, _seconds(plan, sizes, effort, threads))
    pieces = 0 if cut is None else min(limit, threads * _largest(elements, plan.levels[cut]))
    slabs = _SLAB_COPIES * 4 * SLAB * max(1, min(threads, limit // SLAB))
    scratch = 0 if cut is None else 4 * elements * (2 if own else 1)
    working = max(WORKING * fitted, slabs, 0 if cut is None else WORKING * pieces + _HEAPS)
    return Forecast(held + _peak(chosen, working), scratch, _seconds(plan, sizes, effort, threads, cut=cut))


def peak_memory() -> int:
    """Most resident bytes of this process so far; 0 where the system does not say."""
    with suppress(OSError, StopIteration):
        lines = Path("/proc/self/status").read_text().splitlines()
        return 1024 * int(next(line.split()[1] for line in lines if line.startswith("VmHWM")))
    with suppress(ImportError):
        import resource  # not on Windows

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
    return 0


def _peak(*stages: int) -> int:
    """Most bytes of a process that needs so many in one stage after another."""
    return _BASE + int(max(need + _KEPT * sum(stages[:number]) for number, need in enumerate(stages)))


def _largest(elements: int, level: LevelSpec) -> int:
    """Elements of the largest sub-tensors that a level is cut into."""
    modes = [(c, k) for c, k in zip(level.clusters, level.mixture, strict=True) if c > 1]
    uneven = prod(_UNEVEN_TWO if c == 2 else CAP if k > 1 else _UNEVEN_MORE for c, k in modes)
    return int(uneven * elements / level.cells)


def _seconds(plan: Plan, sizes: Sequence[int], effort: Effort, threads: int, cut: int | None = None) -> float:
    each = _SOURCE_NS + (0 if cut is None else _PIECE_NS * (1 + effort.backfits))
    for level in plan.levels:
        if level.cells == 1:
            each += _HOOI_NS * (1 + effort.hooi)
        else:
            each += _START_NS + _SWEEP_NS * effort.sweeps
        if len(plan.levels) > 1:
            each += effort.backfits * (_SWEEP_NS + 10)
    return each * 1e-9 * prod(sizes) / threads
