"""The search that peers share: layouts are predicted at a few steps, and the most promising are coded.

By duality max over D of [Lagrangian(D) - TRADE D^2 budget] bounds the squared error of a layout at a budget from below,
as predicted. Of the three layouts of least bound each is coded at the step that fills the budget.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import chain
from math import ceil, exp, log, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .layouts import F64, Layout
from .rates import TRADE

#: How many layouts are coded for a budget, and how often each.
CODED, TRIES = 3, 10
#: Shares of a budget that are aimed at, and with which a search for the step ends.
AIM, FULL = 0.997, 0.992


@dataclass(frozen=True)
class Coded:
    """A layout coded at a step.

    Attributes:
        bits: of all that is stored.
        error: squared error of the array as decoded.
        cost: multiply-adds of one element, of the dearest.
        ranks: in words.
    """

    bits: float
    error: float
    cost: int
    ranks: str

    @property
    def nbytes(self) -> int:
        """Bytes, rounded up."""
        return ceil(self.bits / 8)


#: Codes a layout at a step; None: it cannot.
Code = Callable[[float], Coded | None]


@dataclass(frozen=True)
class Found:
    """The best layout for a budget."""

    coded: Coded
    layout: Layout


@dataclass
class Search:
    """A method's task, and the layouts it has predicted.

    Attributes:
        budgets: bytes.
        steps: D at which layouts are predicted.
        decode_cost: most multiply-adds of one element.
        curves: predicted Lagrangians of each layout, at all steps.
    """

    budgets: Sequence[int]
    steps: F64
    decode_cost: int
    curves: dict[Layout, F64] = field(default_factory=dict[Layout, F64])

    @classmethod
    def of(cls, values: NDArray[Any], budgets: Sequence[int], decode_cost: int) -> Search:
        """A search with steps about the root mean square of an array."""
        rms = sqrt(float(np.square(values, dtype=np.float64).mean()))
        return cls(budgets, rms * np.geomspace(0.004, 16.0, 9), decode_cost)

    def bounds(self, layout: Layout, budget: int) -> F64:
        """Lower bounds of the squared error at a budget, by step."""
        return self.curves[layout] - TRADE * self.steps**2 * 8.0 * budget

    def best(self, count: int) -> list[list[Layout]]:
        """The `count` most promising layouts for each budget."""
        return [sorted(self.curves, key=lambda layout: self.bounds(layout, budget).max())[:count]
                for budget in self.budgets]

    def finish(self, build: Callable[[Layout], Code]) -> list[Found | None]:
        """The best of the most promising for each budget, coded."""
        chosen = self.best(CODED)
        found: list[Found | None] = [None] * len(self.budgets)
        for layout in dict.fromkeys(chain(*chosen)):
            code = build(layout)
            for i, budget in enumerate(self.budgets):
                if layout not in chosen[i]:
                    continue
                coded = meet(code, budget, float(self.steps[self.bounds(layout, budget).argmax()]))
                before = found[i]
                if coded and (before is None or coded.error < before.coded.error):
                    found[i] = Found(coded, layout)
        return found


def meet(code: Code, budget: int, step: float) -> Coded | None:
    """The best of `code(step)` within a budget in bytes: secants of log bits over log step in a bracket.

    >>> found = meet(lambda step: Coded(8000 / step, step, 1, ""), 500, 1.0)
    >>> found is not None and 496 <= found.nbytes <= 500
    True
    """
    best: Coded | None = None
    above: tuple[float, float] | None = None
    below: tuple[float, float] | None = None
    for turn in range(TRIES):
        coded = code(step)
        if coded is None:
            break
        excess = log(max(coded.bits, 1.0) / (8 * budget * AIM))
        if coded.bits > 8 * budget:
            above = log(step), excess
        else:
            below = log(step), excess
            best = coded if best is None or coded.error < best.error else best
            if coded.bits > FULL * 8 * budget:
                break
        if above and below:
            share = min(max(above[1] / (above[1] - below[1]), 0.05), 0.95)
            step = exp(above[0] + share * (below[0] - above[0]))
        else:
            step *= exp(min(max((1 + turn) * excess, -1.5), 1.5))
    return best
