"""Ranks of each node are examined side by side where memory allows it, and come out alike whatever the threads."""

from __future__ import annotations

from typing import Any

import pytest

from hmkcta import compress
from hmkcta.ranks import examining
from streaming_tools import MODES, fitted

pytestmark = pytest.mark.usefixtures("small_slabs")


class Told:
    """Progress, which must not go back within a stage."""

    def __init__(self) -> None:
        self.last: tuple[str, float] = ("", 0.0)

    def __call__(self, stage: str, fraction: float) -> None:
        assert stage != self.last[0] or fraction >= self.last[1] or fraction == 0.0
        self.last = (stage, fraction)


@pytest.fixture(autouse=True)
def _many_cores(monkeypatch: pytest.MonkeyPatch) -> None:  # pyright: ignore[reportUnusedFunction] (pytest uses it)
    def as_many(wanted: int) -> int:
        return wanted

    monkeypatch.setattr("hmkcta.encode.thread_count", as_many)


@pytest.mark.parametrize(("plan", "share"), [
    ("R<=8 grid=y:2-4", 0.33), ("R<=8 grid=y:2-3,x:2-3", 0.33), ("R=1 grid=y:2 / R<=8 cut<=x:2", 0.6),
    ("R=1 C=1,1,2,1 / R<=8 cut<=x:2", 0.6),
])  # fmt: skip
def test_ways_of_what_memory_does_not_hold(
    plan: str, share: float, cloth: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    held, goal = int(share * cloth.values.size), {"snr": 14.5}
    models = [fitted(cloth, monkeypatch, held, plan, threads=n, progress=Told(), **goal) for n in (1, 4)]
    assert (models[0].snr, models[0].nbytes) == (models[1].snr, models[1].nbytes)
    assert models[0].snr >= 14.5


@pytest.mark.parametrize("plan", ["R<=8 grid=y:1-4,x:1-2", "R<=8 C=2,1,3,1", "R=1 grid=y:2 / R<=8 cut<=x:2"])
def test_ways_of_what_memory_holds(plan: str, cloth: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    settings: dict[str, Any] = {"axes": cloth.axes, "organisation": MODES, "quality": "fast", "snr": 18.0}
    beside: list[int] = []
    in_order = examining.in_order

    def noted(work: Any, items: Any, workers: int) -> Any:
        beside.append(min(workers, len(items)))
        return in_order(work, items, workers)

    monkeypatch.setattr(examining, "in_order", noted)
    models = [compress(cloth.values, plan, threads=n, progress=Told(), **settings) for n in (1, 5)]
    assert (models[0].snr, models[0].nbytes) == (models[1].snr, models[1].nbytes)
    assert max(beside) > 1
    beside.clear()
    compress(cloth.values, plan, threads=5, max_memory=10**9, **settings)
    assert max(beside) == 1, "memory that is given is not for more at once"
