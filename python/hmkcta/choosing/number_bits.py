"""Whether a plan's numbers are packed or float16, by what a search comes to with each.

Packed ones (``bits=8``) have as many bits as they are worth, sixteen at the most, of which float16 keeps eleven: fewer
than float16 takes until their rounding shows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import inf

from .candidates import Candidate, Scored
from .clustered import clustered
from .judging import Search, worth_of

#: Below so many dB packed numbers leave next to nothing more than float16: that is not looked at.
PACKED_DO = 60.0
#: Where races with them end with more than so many dB, their rounding hides which blocks are best: the search goes on
#: from there only if float16 numbers come to less.
PACKED_HARDLY_DO = 64.0
#: For an SNR goal above so many dB only float16 numbers are looked at.
PACKED_FALL_SHORT = 72.0
#: Packed numbers that are worth so much more than float16 in the same blocks, in dB or octaves of bytes, are taken: no
#: other blocks make up for it.
SURELY_BETTER = 0.75

#: Looks for the best candidate and what it is worth: in a search, of the fixed organisation or of any; where races end
#: with more than so many dB, what they end with is the answer.
Look = Callable[[Search, bool, float], Scored]


def searched_by_bits(
    search: Search, look: Look, bits: int | None, fixed: bool, *, aimed: bool
) -> tuple[Search, Scored]:
    """The best candidate, with packed numbers or with float16, whichever is worth more.

    1. With `bits` given only those are looked at; for an SNR above 72 dB only float16. Else packed ones come first.
    2. If they come to less than 60 dB, or the SNR is less, they are taken.
    3. Else, if one of these is less than 64 dB, float16 is judged in the blocks, or with the clusters, that are best
       with packed numbers. Where it is possible there but worth 0.75 less, packed numbers are taken.
    4. Else float16 is searched: within the organisation that is best with packed numbers if step 3 found it worth less
       there, among all if not. The better of the two is taken; the other one is its rival, to be told from it by a fit.

    Args:
        search: of what, and how carefully.
        look: looks for the best candidate.
        bits: of each number; None: either.
        fixed: whether the organisation is given.
        aimed: whether the goal is an SNR.

    Returns:
        The search that found the candidate, with its rivals, and the candidate with what it is worth.
    """
    ceiling = inf if search.goal.ceiling is None else search.goal.ceiling
    first = bits or (16 if aimed and PACKED_FALL_SHORT < ceiling < inf else 8)
    enough = PACKED_HARDLY_DO if bits is None and first == 8 else inf
    own = search.anew(replace(search.goal, bits=first))
    found = look(own, fixed, enough)
    reached = min(found.worth, ceiling)
    if bits is not None or first == 16 or reached < PACKED_DO:
        return own, found
    wide = search.anew(replace(search.goal, bits=16))
    # What packed numbers end at far up, and blocks that float16 has no room for, tell nothing of the best with those.
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
    """What the search's numbers are worth in the blocks, or with the clusters, that are best with other numbers.

    Or without any, if that is more: data of low rank need no blocks where numbers are exact enough.
    """
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
