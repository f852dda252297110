"""Whom to tell how much is done."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
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
    """Counts plans that are fitted to be compared, so that stages say which of them is fitted.

    Of plans that are fitted side by side the oldest one tells. How many there will be hangs on what the first ones come
    to: said is how many are known so far.

    >>> plans = Compared()
    >>> plans.expect(2)
    >>> first, second = plans.begin(2)
    >>> plans.following(second, print)("level 1", 0.25)
    >>> plans.following(first, print)("level 1", 0.5)
    level 1, plan 1 of 2 0.5
    """

    def __init__(self) -> None:
        self._known = self._begun = self._ended = 0
        self._last = dict[int, Callable[[], object]]()

    def expect(self, plans: int) -> None:
        """So many more will be fitted."""
        self._known += plans

    def begin(self, plans: int) -> range:
        """Numbers, from 1 on, of so many plans, of which each has to `end` in this order."""
        first = self._begun + 1
        self._begun += plans
        return range(first, self._begun + 1)

    def end(self) -> None:
        """The oldest plan is fitted, or given up: what the next one told last is told now."""
        self._last.pop(self._ended, None)
        self._ended += 1
        self._last.get(self._ended + 1, nobody)()

    def following(self, number: int, progress: Progress) -> Progress:
        """Whom the fit of a plan tells; a plan that is the only one has no number."""
        which = f"{OF_PLAN}{number} of {self._known}" if self._known > 1 else ""

        def told(stage: str, done: float) -> None:
            self._last[number] = partial(progress, stage + which, done)
            if number == self._ended + 1:
                self._last[number]()

        return told


def nobody(*_: object) -> None:
    """Either, where nobody listens."""
