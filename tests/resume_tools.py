"""What tests of resuming fit, and how they stop it."""

from __future__ import annotations

from hmkcta.synthetic import material

DATA = material(lights=4, views=6, size=24, seed=2)
LEVELS = "R=3,2,4,4 / R=2,1,2,2 C=3,2,2,2 K=2 / R=1 C=2,1,2,2 K=2"
MODES = "light+rgb, view, y, x"


class Stop(Exception):
    """What ends a run in these tests."""


class After:
    """Progress that ends the run when it is called for the n-th time."""

    def __init__(self, calls: int) -> None:
        self.left = calls

    def __call__(self, *_: object) -> None:
        self.left -= 1
        if self.left < 0:
            raise Stop
