"""All ranks of data that end at a rank, where fewer bits make up for more ranks."""

from __future__ import annotations

from math import inf, sqrt

from ..metrics import noise_at
from ..streaming.streamed import Streamed
from .allocation import Allocation, allocate
from .last_level import Fitted, LastLevel
from .reckoning import USED

#: Data end at ranks that leave no more than so many dB, which float32 tells; these are tried up to so many times the
#: bytes.
ENDS, SOON = 65.0, 3.0
#: Where data end, nearly as many bytes are needed for so many dB less.
BEFORE, ALIKE = 15.0, 1.15
#: How often all ranks are fitted at most.
ATTEMPTS = 6
#: By how many bits numbers get shorter at most at once, and what share of the energy is lost where bits are too few.
MOST_BITS, LOST = 8, 0.5
#: What rounding is to leave at first, as a share of what float32 leaves of all ranks: some 60 dB.
FIRST_SHARE = 1.0


def ends_of(level: LastLevel, nbytes: float) -> Allocation | None:
    """The ranks where data end, if they end within a few times as many bytes, as choices count them."""
    if not level.reckoned.packed or isinstance(level.tree.residual, Streamed):
        return None
    error = noise_at(ENDS, level.goal.energy)
    ends, before = (allocate(level.spectra, error=error * noise_at(-more)) for more in (0.0, BEFORE))
    are_there = ends.choice.any() and ends.error <= error and ends.nbytes <= ALIKE * before.nbytes
    return ends if are_there and ends.nbytes <= SOON * nbytes else None


def filled(level: LastLevel, ends: Allocation, size: int) -> Fitted | None:
    """All ranks, with as many bits as fill the size; None where the fewest that are tried do not fit.

    A bit more of each number leaves a quarter of the error: shares follow each other by that, between those that were
    too small for the size and those that fit.
    """
    best, share, low, high = None, FIRST_SHARE, 0.0, inf
    for _ in range(ATTEMPTS):
        fitted = level.fit(ends, share)
        if fitted.nbytes <= size:
            high, best = share, fitted if best is None or fitted.error < best.error else best
        else:
            low = share
        longer = level.reckoned.longer(ends, fitted.nbytes, size)
        nothing_left = fitted.nbytes > size and fitted.error > LOST * level.goal.energy
        if USED * size <= fitted.nbytes <= size or (longer < 0 and share <= FIRST_SHARE) or nothing_left:
            break
        share *= 4.0 ** min(longer, MOST_BITS)
        if not low < share < high:
            share = sqrt(low * high)
    return best
