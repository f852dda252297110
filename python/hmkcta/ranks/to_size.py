"""Fill a size by the last level: by ranks, and by the bits of their numbers."""

from __future__ import annotations

import numpy as np

from ..errors import HmkctaError
from .allocation import Allocation, allocate
from .ends import ends_of, filled
from .last_level import Fitted, LastLevel
from .reckoning import AIMED, SHARES, USED

#: Files below so many bytes may do better without tables of parameters.
SMALL_FILE = 3 << 10
#: By how many bits all columns are changed at most at once.
MOST_BITS = 2
#: How often a fit to a size is repeated at most.
ATTEMPTS = 5
#: How many times the bytes of what was fitted the next higher ranks take at most, how often these are fitted with fewer
#: bits, and up to what share.
FURTHER_RANKS, MORE_ATTEMPTS, MOST_SHARE = (1.05, 1.1, 1.2, 1.4, 1.7, 2.0), 3, 40.0


def to_size(level: LastLevel, size: int) -> None:
    """As much as fits into a file of `size` bytes; a little less is tried where the file turns out larger."""
    if level.reckoned.packed:
        _to_size_of_columns(level, size)
        return
    for budget in (size, 0.995 * size, 0.98 * size):
        if level.fit(level.within(budget)).nbytes <= size:
            return


def _to_size_of_columns(level: LastLevel, size: int) -> None:
    """The same where columns have bits of their own, of which a fit tells how many they are.

    Higher ranks in fewer bits are tried where the size is not used, and all that there are where data end: there they
    are worth more than bits.
    """
    best = _filled(level, size)
    if best is not None and best.nbytes < USED * size:
        best = _with_more_ranks(level, size, best)
    ends = ends_of(level, size - level.reckoned.beside)
    other = None if ends is None else filled(level, ends, size)
    if other is not None and (best is None or other.error < best.error):
        best = other
    if best is None:
        level.fit(level.within(size), 0.0)
        return
    level.fit(best.chosen, best.share)
    if size < SMALL_FILE:
        _unless_bytes_do(level, size, best)


def _filled(level: LastLevel, size: int) -> Fitted | None:
    """The fit of most bytes that a size has room for, or none.

    Ranks are chosen again by what a fit told. Where it leads to ranks that were fitted before, all columns get more
    bits, or fewer.
    """
    reckoned, best, tried = level.reckoned, None, set[tuple[bytes, float]]()
    chosen = reckoned.filling(size)
    usual = reckoned.share = reckoned.share_of(chosen)
    for _ in range(ATTEMPTS):
        if (chosen.choice.tobytes(), reckoned.share) in tried or not _stores(level, chosen):
            break
        tried.add((chosen.choice.tobytes(), reckoned.share))
        fitted = level.fit(chosen)
        if fitted.nbytes <= size and (best is None or fitted.nbytes > best.nbytes):
            best = fitted
        if USED * size <= fitted.nbytes <= size:
            break
        other = reckoned.filling(AIMED * size)
        if reckoned.share == usual and (other.choice.tobytes(), usual) not in tried:
            chosen = other
            continue
        fewer = reckoned.longer(chosen, fitted.nbytes, size)
        reckoned.share = min(max(reckoned.share * 4.0 ** min(fewer, MOST_BITS), SHARES[0]), SHARES[1])
    return best


def _with_more_ranks(level: LastLevel, size: int, best: Fitted) -> Fitted:
    """What was fitted, or the next higher ranks with as few bits as fit, if these leave less."""
    level.reckoned.share = best.share
    more = (allocate(level.spectra, nbytes=times * best.chosen.nbytes) for times in FURTHER_RANKS)
    further = next((each for each in more if not np.array_equal(each.choice, best.chosen.choice)), None)
    if further is None:
        return best
    share, taken = best.share, level.reckoned.nbytes(further)
    for _ in range(MORE_ATTEMPTS):
        share *= 4.0 ** min(level.reckoned.longer(further, taken, size), MOST_BITS)
        if not SHARES[0] < share < MOST_SHARE:
            break
        fitted = level.fit(further, share)
        taken = fitted.nbytes
        if taken <= size and fitted.error < best.error:
            best = fitted
        if USED * size <= taken <= size:
            break
    return best


def _unless_bytes_do(level: LastLevel, size: int, best: Fitted) -> None:
    """What was fitted, or a byte for each number, where that leaves less: parameters take some bytes, too."""
    try:
        others = level.within(size)
    except HmkctaError:
        return
    fitted = level.fit(others, 0.0)
    if fitted.error >= best.error or fitted.nbytes > size:
        level.fit(best.chosen, best.share)


def _stores(level: LastLevel, chosen: Allocation) -> bool:
    """Whether there will be anything in the file."""
    return len(level.tree.levels) > 1 or bool(chosen.choice.any())
