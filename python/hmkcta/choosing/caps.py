"""Caps of a chosen plan's ranks (R<=..): as high as memory lets its levels be fitted, told by arithmetic alone.

A mode is thinned to some rows for each of its ranks and no further, so that caps decide how small a workset can be.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import prod

from ..axes import Organisation, mode_sizes
from ..fitting.workset import FEWEST, next_step, workset, workset_steps
from ..grids import few_grids
from ..plan import LevelSpec, Plan
from ..streaming.budget import FLAT, MODEL, PROCESS, WORKING, is_streamed, joint_bytes, part_sizes, workset_limit
from ..streaming.source import Source
from ..support.memory import available_memory, check_memory, memory_budget
from .candidates import clusters_of
from .organisations import organisations

#: R of every mode; None: undecomposed.
Ranks = tuple[int | None, ...]


@dataclass(frozen=True)
class Room:
    """The memory for the levels of a plan on a tensor that is streamed.

    Attributes:
        elements: of the tensor.
        limit: elements that are worked on at once.
        allowed: bytes beyond which a plan is refused: all that is free, or what was given.
        wanted: bytes that caps of ranks are lowered to, where a plan would need more than `allowed`.
    """

    elements: int
    limit: int
    allowed: int
    wanted: int

    def needed(self, sizes: Sequence[int], ranks: Ranks) -> int:
        """Bytes that are asked for before a level of one cell is fitted to a node of these sizes; 0: few enough."""
        if prod(sizes) <= self.limit:
            return 0
        level = LevelSpec.of_one_cell(ranks)
        fitted, joint = workset(sizes, level, self.limit), _joint(sizes, ranks)
        most = max(joint, PROCESS + WORKING * fitted if fitted > self.limit else 0)
        whole = prod(sizes) == self.elements
        # Sweeps alone take the place of joint rows of the whole tensor.
        return min(most, PROCESS + FLAT * self.elements) if whole and joint > self.allowed else most

    def holds(self, nbytes: int) -> bool:
        """Whether a model of so many bytes can be made."""
        return PROCESS // 2 + MODEL * nbytes <= self.allowed

    def caps(self, sizes: Sequence[int], ranks: Ranks) -> Ranks | None:
        """The ranks, lowered as far as a level needs to be fitted to a node of these sizes; None: no rank is so low.

        >>> mib = 2**20
        >>> Room(512 * 512 * 200, 20 * mib, 480 * mib, 480 * mib).caps((512, 512, 200), (160, 160, 160))
        (32, 32, 160)
        """
        return _caps(self, tuple(sizes), ranks)


def room_of(elements: int, memory: int | None) -> Room | None:
    """The room that `memory` bytes (None: half of what is free) leave; None where it sets no bounds to a plan.

    What is refused is what exceeds all that is free. Caps are lowered to half of it, as what is free varies.
    """
    limit, allowed = workset_limit(memory), available_memory() if memory is None else memory
    if allowed is None or not is_streamed(elements, limit):
        return None
    return Room(elements, limit, allowed, memory_budget(memory))


def capped(plan: Plan, sizes: Sequence[int], room: Room | None) -> Plan | None:
    """A chosen plan with caps as low as the room needs them; None: nothing is so low."""
    last = plan.levels[-1]
    if room is None or (last.cells > 1 and not last.grid):
        return plan
    for level in plan.levels:
        sizes = part_sizes(sizes, level)
    ranks = room.caps(sizes, last.ranks)
    if ranks is None:
        return None
    return plan if ranks == last.ranks else replace(plan, levels=(*plan.levels[:-1], replace(last, ranks=ranks)))


def check_room(source: Source, fixed: Organisation | None, room: Room | None) -> None:
    """Refuse to search where no plan that a search begins with could be followed.

    Raises:
        HmkctaError: even ranks of one take more memory than there is.
    """
    if room is None:
        return
    least: int | None = None
    for found in _least(source, fixed, room):
        if found <= room.allowed:
            return
        least = found if least is None else min(least, found)
    hint = "raise --max-memory" + ("" if fixed is None else ", or leave --organisation out")
    check_memory(least or 0, f"any plan for {' x '.join(map(str, source.shape))} elements", hint, room.allowed)


def _least(source: Source, fixed: Organisation | None, room: Room) -> Iterator[int]:
    """Bytes that ranks of one take with every organisation and each of some grids."""
    for modes in organisations(source.axes) if fixed is None else [fixed]:
        whole = mode_sizes(source.axes, modes)
        for grid in reversed(few_grids(source.shape)):
            counts = clusters_of(source.axes, grid, modes)
            sizes = [-(-size // count) for size, count in zip(whole, counts, strict=True)]
            yield room.needed(sizes, (1,) * len(sizes))


@lru_cache(maxsize=1 << 12)
def _caps(room: Room, sizes: tuple[int, ...], ranks: Ranks) -> Ranks | None:
    found: Ranks | None = ranks
    if room.needed(sizes, ranks) <= room.allowed:
        return ranks
    while found is not None and room.needed(sizes, found) > room.wanted:
        found = (_fewer_columns if _joint(sizes, found) > room.wanted else _fewer_rows)(sizes, found, room.limit)
    return found


def _joint(sizes: Sequence[int], ranks: Ranks) -> int:
    return PROCESS // 2 + joint_bytes(sizes, LevelSpec.of_one_cell(ranks))


def _fewer_columns(sizes: Sequence[int], ranks: Ranks, _: int) -> Ranks | None:
    """A lower cap for the mode whose bases are largest."""
    own = LevelSpec.of_one_cell(ranks).clamped(sizes).ranks
    n = max(range(len(sizes)), key=lambda n: sizes[n] * (own[n] or 0))
    rank = own[n] or 1
    return None if rank == 1 else (*ranks[:n], rank * 7 // 8, *ranks[n + 1 :])


def _fewer_rows(sizes: Sequence[int], ranks: Ranks, limit: int) -> Ranks | None:
    """Lower caps that let one mode be thinned further, of all modes that whose caps stay highest.

    How far an undecomposed mode is thinned goes by the highest cap of the others.
    """
    steps, ways = workset_steps(sizes, LevelSpec.of_one_cell(ranks).clamped(sizes), limit), list[tuple[int, int, int]]()
    for n, (size, step, rank) in enumerate(zip(sizes, steps, ranks, strict=True)):
        ways.append((size // (FEWEST * next_step(step, undecomposed=rank is None)), size, n))
    cap, _, chosen = max(ways)
    lowered = (chosen,) if ranks[chosen] is not None else range(len(ranks))
    if cap < 1 or not any(ranks):
        return None
    return tuple(min(rank, cap) if rank is not None and n in lowered else rank for n, rank in enumerate(ranks))
