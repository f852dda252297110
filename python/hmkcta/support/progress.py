"""Whom to tell how much is done."""

from __future__ import annotations

from collections.abc import Callable

#: Called with a stage's name and the fraction of it that is done.
Progress = Callable[[str, float], None]
#: Called with the bytes of the best file found so far, and its SNR in dB.
Best = Callable[[int, float], None]
#: Called with the fraction that is done of whatever it was handed to.
Told = Callable[[float], None]


def share_of(told: Told, number: int, count: int) -> Told:
    """Whom to tell how much of part `number` of `count` is done.

    >>> share_of(print, 1, 4)(0.5)
    0.375
    """
    return lambda done: told((number + done) / count)


def nobody(*_: object) -> None:
    """Either, where nobody listens."""
