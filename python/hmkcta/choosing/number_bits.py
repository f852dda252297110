"""Whether a plan's numbers have eight bits or sixteen, by what a search comes to with each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf

from ..narrow import LEFT
from .candidates import Candidate
from .judging import Search

#: Up to so many dB bytes leave next to nothing more than float16 numbers, and from so many on too much. Between them
#: both are looked at; where bytes end a race with more than so much, they are gone on with only if float16 numbers come
#: to less.
BYTES_DO, BYTES_HARDLY_DO, BYTES_FALL_SHORT = 38.0, 44.5, 52.0
#: Where rounding to bytes is more than so much of the error it hides which organisation is better.
TELLING = 0.8
#: Of the same blocks float16 numbers are an octave of bytes worse where rounding tells nothing; where they are so much
#: worse, in octaves or dB, no other blocks make up for it.
SURELY_WORSE = 0.75

#: Looks for the best candidate: in a search, of a fixed organisation or any, to the end of a race where that is enough.
Look = Callable[[Search, bool, float], tuple[float, Candidate]]


def searched_by_bits(search: Search, look: Look, bits: int | None, fixed: bool) -> tuple[Search, float, Candidate]:
    """The best candidate whose numbers have so many bits, of a fixed organisation or any.

    None: eight bits, or where what these leave tells, sixteen, which are looked at with the blocks of the best, then
    with its organisation unless bytes hide which that is; sixteen where memory sets bounds, as the ranks that bytes
    afford take more of it to look at.
    """
    if search.goal.memory is not None:
        bits = bits or 16
    ceiling = inf if search.goal.ceiling is None else search.goal.ceiling
    first = bits or (16 if BYTES_FALL_SHORT < ceiling < inf else 8)
    enough = BYTES_HARDLY_DO if bits is None and first == 8 else inf
    own = search.anew(replace(search.goal, bits=first))
    found = own, *look(own, fixed, enough)
    if bits is not None or first == 16 or min(found[1], ceiling) < BYTES_DO:
        return found
    wide = search.anew(replace(search.goal, bits=16))
    if _is_surely_worse(wide, found[1], found[2]):
        return found if own.highest <= enough else _to_the_end(own, look, fixed)
    told = fixed or found[2].carried or TELLING * 10 ** (-min(found[1], ceiling) / 10) > LEFT
    wide = replace(wide, plain=found[2].organisation) if told else wide
    other = wide, *look(wide, told, inf)
    if found[1] > other[1] and own.highest > enough:
        found = _to_the_end(own, look, fixed)
    return max(found, other, key=lambda each: each[1])


def _is_surely_worse(wide: Search, worth: float, best: Candidate) -> bool:
    """Whether float16 numbers, in the blocks that are best with bytes, are worth too little to look at others."""
    if not best.carried:
        return False
    (same, _), = wide.best([(best.organisation, best.grid)], wide.care.refine, kinds=(best.undecomposed,))
    return same < worth - SURELY_WORSE


def _to_the_end(own: Search, look: Look, fixed: bool) -> tuple[Search, float, Candidate]:
    """The best candidate of a search that was left where a race ended."""
    own = own.anew(own.goal)
    return own, *look(own, fixed, inf)
