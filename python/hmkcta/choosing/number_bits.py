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

#: Looks for the best candidate: in a search, of a fixed organisation or any, to the end of a race where that is enough.
Look = Callable[[Search, bool, float], tuple[float, Candidate]]


def searched_by_bits(search: Search, look: Look, bits: int | None, fixed: bool) -> tuple[Search, float, Candidate]:
    """The best candidate whose numbers have so many bits, of a fixed organisation or any.

    None: eight bits, or where what these leave tells, sixteen, which are looked at with the organisation of the best
    unless bytes hide which that is; sixteen where memory sets bounds, as the ranks that bytes afford take more of it
    to look at.
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
    told = fixed or found[2].carried or TELLING * 10 ** (-min(found[1], ceiling) / 10) > LEFT
    wide = replace(wide, plain=found[2].organisation) if told else wide
    other = wide, *look(wide, told, inf)
    if found[1] > other[1] and own.highest > enough:
        own = search.anew(own.goal)
        found = own, *look(own, fixed, inf)
    return max(found, other, key=lambda each: each[1])
