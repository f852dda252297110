"""Just reach an SNR by the last level: by ranks, and by the bits of their numbers."""

from __future__ import annotations

from math import inf, isfinite, isinf, log2, prod

from ..errors import invalid
from ..metrics import noise_at
from .allocation import Allocation, allocate, trimmed
from .last_level import LastLevel

#: How far above an SNR goal a fit may end, in dB.
OVERSHOOT = 0.25
#: How often a fit is repeated at most to land there.
ATTEMPTS = 16
#: The same where the values as they are would take fewer bytes.
FEW_ATTEMPTS = 3
#: How far above the goal a level of several nodes aims, in dB: its choices come in small steps.
MARGIN = 0.05
#: The least, where ranks fall short of an SNR.
FINEST_SHARE = 2e-3
#: How often a fit is repeated at most with fewer bits that still reach the SNR, how far above it is near enough, in dB,
#: and what share of the bytes is worth another fit, farther above the SNR as well.
SHARE_ATTEMPTS, NEAR, WORTH, HARDLY = 8, 0.06, 0.005, 2e-4
#: A plan is given up that promises more than so many times the bytes of another one: before the first fit, and after
#: it, when it is known how far promises are off.
PROMISED = 1.1, 1.02
#: The search ends where a promise that was too poor and one that was good enough are so near each other, in dB.
NARROW = 0.03
#: SNR in dB that choices promise, and that a fit of them reaches; between the next two lies any other.
Reached = tuple[float, float]
_NOTHING, _EVERYTHING = (-inf, -inf), (inf, inf)


def _aimed(snr: float, now: Reached, poor: Reached, good: Reached) -> float:
    """The promise in dB that should reach `snr`, from what the last one reached (`now`), and the nearest two around it.

    These are the best that was too poor and the poorest that was good enough, or infinite.
    """
    gained = now[1] - now[0]
    aim = snr - gained if isfinite(gained) else snr
    if poor[0] < aim < good[0] or not (isfinite(poor[1]) and isfinite(good[1])):
        return aim
    return poor[0] + (good[0] - poor[0]) * (snr - poor[1]) / (good[1] - poor[1])


def to_snr(level: LastLevel, snr: float) -> None:
    """Fit the level again and again until it just reaches `snr` dB, and keep the fit of fewest bytes that does.

    Choices of ranks promise an SNR, by the energies of HOSVD cores; a fit of them reaches another one. The first
    fit is of choices that promise `snr`. What it reached beyond its promise, or short of it, the next choices are
    taken to gain or lose as well, as they are near. Where that leads out of the interval between a promise that was
    too poor and one that was good enough, as it may under a value transform, the next one is interpolated between
    these two (`_aimed`).

    The search ends up to `OVERSHOOT` dB above the goal, where the two promises nearly meet, where the next choices
    were fitted before, or after `ATTEMPTS` fits. If none reached the goal, all ranks that there are are fitted.

    Raises:
        HmkctaError: reason ``size-too-small``: these choices take more bytes than another plan (`Goal.most`).
    """
    aim, best, tried, poor, good = snr, None, set[bytes](), _NOTHING, _EVERYTHING
    wasteful = level.ways[0][0].bits / 8 * sum(prod(node.sizes) for node in level.tree.levels[-1])
    for attempt in range(ATTEMPTS):
        error = max(noise_at(aim, level.goal.energy) - level.reckoned.elsewhere, 0.0)
        chosen = trimmed(level.spectra, allocate(level.spectra, error=error), error)
        if attempt == 0:
            level.reckoned.share = level.reckoned.share_of(chosen)
        if chosen.choice.tobytes() in tried:
            if best is not None:
                break
            aim += OVERSHOOT  # the next step of ranks is further away than the error was off
            continue
        _refuse_more(level, chosen, PROMISED[min(attempt, 1)])
        tried.add(chosen.choice.tobytes())
        level.fit(chosen)
        reached = level.goal.snr_now(level.tree)
        if reached >= snr and (best is None or chosen.nbytes < best.nbytes):
            best = chosen
        now = level.reckoned.snr(chosen), reached
        poor, good = (max(poor, now), good) if reached < snr else (poor, min(good, now))
        if snr <= reached <= snr + OVERSHOOT or good[0] - poor[0] < NARROW:
            break
        if attempt + 1 >= FEW_ATTEMPTS and chosen.nbytes > wasteful:  # the values themselves would take less
            break
        aim = _aimed(snr, now, poor, good) + (MARGIN if len(level.spectra) > 1 else 0.0)
    _just_reaching(level, snr, best or allocate(level.spectra, error=0.0))


def _just_reaching(level: LastLevel, snr: float, chosen: Allocation) -> None:
    """A fit of the choices, their columns with as few bits as still reach the SNR."""
    best = level.fit(chosen)
    reached = level.goal.snr_now(level.tree)
    if level.reckoned.packed and reached < snr and best.share > FINEST_SHARE:
        best = level.fit(chosen, FINEST_SHARE)  # these ranks, with more bits, may reach it
        reached = level.goal.snr_now(level.tree)
    good, poor = (best.share, reached), (inf, reached)
    for _ in range(SHARE_ATTEMPTS if level.reckoned.packed and snr + NEAR < reached < inf else 0):
        share = _share_for(snr + NEAR / 2, good, poor)
        most = share if isinf(poor[0]) else poor[0]
        saved = level.reckoned.numbers(chosen) / 16 * log2(max(most / best.share, 1.0)) / best.nbytes
        if share <= best.share or saved < (WORTH if good[1] <= snr + OVERSHOOT else HARDLY):
            break
        fitted = level.fit(chosen, share)
        reached = level.goal.snr_now(level.tree)
        if not reached >= snr:
            poor = share, reached
            continue
        best, good = fitted, (share, reached)
        if reached <= snr + NEAR:
            break
    level.fit(best.chosen, best.share)


def _share_for(snr: float, good: tuple[float, float], poor: tuple[float, float]) -> float:
    """The share left by rounding that should end at so many dB, after two that ended above and below: shares, and dB.

    With none below, as rounding adds to what the ranks leave; else between the two, not too near either.
    """
    if isinf(poor[0]):
        return noise_at(snr - good[1]) * (1 + good[0]) - 1
    part = min(max((good[1] - snr) / (good[1] - poor[1]), 0.1), 0.9)
    return good[0] * (poor[0] / good[0]) ** part


def _refuse_more(level: LastLevel, chosen: Allocation, sure: float) -> None:
    """Give up a plan that takes so many times the bytes of another: what is fitted would not be kept."""
    nbytes, most = level.reckoned.nbytes(chosen), level.goal.most
    if nbytes > sure * most:
        allowed = f"at most {most:.0f}, which another plan takes"
        raise invalid("size-too-small", "bytes for the SNR", int(nbytes), allowed)
