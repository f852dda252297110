"""Whether a plan's numbers have eight bits or sixteen, by what a search comes to with each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf

from .candidates import Candidate, Scored
from .clustered import clustered
from .judging import Search, worth_of

#: Up to so many dB bytes leave next to nothing more than float16 numbers, and from so many on too much. Between them
#: both are looked at; where bytes end a race with more than so much, what they leave hides which blocks are best, and
#: they are gone on with only if float16 numbers come to less.
BYTES_DO, BYTES_HARDLY_DO, BYTES_FALL_SHORT = 38.0, 44.5, 52.0
#: In the same blocks bytes are an octave better than float16 numbers where rounding tells nothing; where they are so
#: much better, in octaves or dB, no other blocks make up for it.
SURELY_BETTER = 0.75

#: Looks for the best candidate: in a search, of a fixed organisation or any, to the end of a race where that is enough.
Look = Callable[[Search, bool, float], Scored]


def searched_by_bits(
    search: Search, look: Look, bits: int | None, fixed: bool, *, aimed: bool
) -> tuple[Search, Scored]:
    """The best candidate whose numbers have so many bits, of a fixed organisation or any.

    None: eight bits, or where what these leave tells, sixteen. These are looked at in the blocks of the best, and if
    not much worse there with its organisation; where they are better, or what bytes leave hides which is best, with
    all. The best with the other bits is then a rival. Sixteen alone where an SNR that is `aimed` at is beyond bytes.
    """
    ceiling = inf if search.goal.ceiling is None else search.goal.ceiling
    first = bits or (16 if aimed and BYTES_FALL_SHORT < ceiling < inf else 8)
    enough = BYTES_HARDLY_DO if bits is None and first == 8 else inf
    own = search.anew(replace(search.goal, bits=first))
    found = look(own, fixed, enough)
    reached = min(found.worth, ceiling)
    if bits is not None or first == 16 or reached < BYTES_DO:
        return own, found
    wide = search.anew(replace(search.goal, bits=16))
    # What bytes end at far up, and blocks that sixteen bits have no room for, tell nothing of the best with those.
    same = _worth_of_same(wide.anew(wide.goal), found.candidate) if reached < enough else -inf
    if 0.0 < same < found.worth - SURELY_BETTER:
        return (own, found) if own.highest <= enough else _to_the_end(own, look, fixed)
    alike = fixed or 0.0 < same < found.worth
    wide = replace(wide, plain=found.candidate.organisation) if alike else wide
    other = look(wide, alike, inf)
    if found.worth > other.worth and own.highest > enough:
        own, found = _to_the_end(own, look, fixed)
    if other.worth > found.worth:
        own, found, other = wide, other, found
    own.rivals.append(other.candidate)  # a trial knows of rounding how large it is, not where
    return own, found


def _worth_of_same(search: Search, best: Candidate) -> float:
    """What a search's numbers are worth in the blocks, or with clusters, that are best with others, or with none: what
    has exact ranks needs no blocks where numbers are as exact."""
    whole = [(best.organisation, (1,) * len(best.grid))]
    worth = worth_of(search.best(whole, search.care.refine)[0])
    if best.clusters:
        return max(worth, *map(worth_of, clustered(search.goal, best.organisation)))
    blocks = [(best.organisation, best.grid)]
    return max(worth, worth_of(search.best(blocks, search.care.refine, kinds=(best.undecomposed,))[0]))


def _to_the_end(own: Search, look: Look, fixed: bool) -> tuple[Search, Scored]:
    """The best candidate of a search that was left where a race ended."""
    own = own.anew(own.goal)
    return own, look(own, fixed, inf)
