"""Whom to tell how much is done."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

#: Called with a stage's name and the fraction of it that is done.
Progress = Callable[[str, float], None]
#: Called with the fraction that is done of whatever it was handed to.
Told = Callable[[float], None]


def share_of(told: Told, number: int, count: int) -> Told:
    """Whom to tell how much of part `number` of `count` is done.

    >>> share_of(print, 1, 4)(0.5)
    0.375
    """
    return lambda done: told((number + done) / count)


#: Between a stage's name and which of the compared plans it is of.
OF_PLAN = ", plan "


@final
class Compared:
    """Counts plans that are fitted one after another to be compared, so that stages say which of them is fitted.

    How many there will be hangs on what the first ones come to: said is how many are known so far.

    >>> plans = Compared()
    >>> plans.expect(2)
    >>> plans.following(print)("level 1", 0.5)
    level 1, plan 1 of 2 0.5
    """

    def __init__(self) -> None:
        self._known = self._begun = 0

    def expect(self, plans: int) -> None:
        """So many more will be fitted."""
        self._known += plans

    def following(self, progress: Progress) -> Progress:
        """Whom the fit of the next plan tells; a plan that is the only one has no number."""
        self._begun += 1
        if self._known == 1:
            return progress
        which = f"{OF_PLAN}{self._begun} of {self._known}"
        return lambda stage, done: progress(stage + which, done)


def nobody(*_: object) -> None:
    """Either, where nobody listens."""
