"""A goal is a root of the step alone: bytes and errors of a layout are smooth and monotone in D."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, inf, log
from typing import Generic, TypeVar

T = TypeVar("T")

#: Of a size at least this share is used (unless fewer bytes hold everything).
USED = 0.995
#: An SNR in dB is overshot by at most this.
OVERSHOT = 0.02
#: Coded at most so often; four to six suffice where bytes are smooth in D.
MOST_TRIES = 9
#: How far, in log D, one step of the search for a bracket goes.
LONGEST_STEP = 2.5


@dataclass(frozen=True)
class Tried(Generic[T]):
    """What a step D came to: by how much, as a logarithm, it is above the goal (<= 0: it meets it)."""

    step: float
    excess: float
    result: T


def meet(
    attempt: Callable[[float], tuple[float, T]], step: float, tolerance: float, slope: float, *,
    bounds: tuple[float, float] = (0.0, inf), tries: int = MOST_TRIES
) -> Tried[T]:
    """The step whose result meets a goal most closely, by secants of log excess over log D.

    Args:
        attempt: excess of a step and its result; the excess is monotone in D.
        step: D to begin with.
        tolerance: results that meet the goal and lie at most this far below it end the search.
        slope: what the excess changes by with log D, about, to begin with (negative: more D, fewer bytes).
        bounds: the least and the largest step that are tried.
        tries: most attempts.

    Returns:
        The closest that meets the goal; where none does the closest to it.

    >>> found = meet(lambda step: (log(100 / step) - log(40), step), 1.0, 0.01, -1.0)
    >>> 2.5 <= found.step < 2.53
    True
    """
    met: Tried[T] | None = None
    above: Tried[T] | None = None  # the closest that misses the goal
    last: tuple[float, float] | None = None  # log D and excess
    sides: list[bool] = []
    for _ in range(tries):
        excess, result = attempt(step)
        if last is not None and step != exp(last[0]):
            slope = _between((excess - last[1]) / (log(step) - last[0]), slope)
        last = log(step), excess
        if excess <= 0:
            met = Tried(step, excess, result) if met is None or excess >= met.excess else met
            if excess >= -tolerance:
                break
        elif above is None or excess <= above.excess:
            above = Tried(step, excess, result)
        sides.append(excess <= 0)
        twice = len(sides) > 1 and sides[-1] == sides[-2]
        aim = _next(step, excess, met, above, tolerance, slope, twice)
        before, step = step, min(max(aim, bounds[0]), bounds[1])
        if step == before:
            break
    found = met or above
    assert found is not None, "there is one try at least"
    return found


def _between(found: float, slope: float) -> float:
    """The slope as found, but by no more than a factor of 4 from the one before: bytes of coarse steps are noisy."""
    ratio = min(max(found / slope, 0.25), 4.0)
    return slope * ratio


def _next(step: float, excess: float, met: Tried[T] | None, above: Tried[T] | None, tolerance: float, slope: float,
          twice: bool) -> float:
    """Of a bracket the secant; where one end moved `twice`, half as much of the other (Illinois method)."""
    if met is not None and above is not None:
        aimed = -0.4 * tolerance
        low, high = met.excess - aimed, above.excess - aimed
        if twice:
            low, high = (low, high / 2) if excess <= 0 else (low / 2, high)
        share = high / (high - low) if high > low else 0.5
        share = min(max(share, 0.03), 0.97)
        return exp(log(above.step) + share * log(met.step / above.step))
    # No bracket yet: as far as the slope says, and a little beyond.
    change = -(excess + (0.01 if excess > 0 else -0.01)) / slope
    return step * exp(min(max(change, -LONGEST_STEP), LONGEST_STEP))
