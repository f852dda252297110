"""Climbs over blocks: where they begin, and when they end."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cli_tools import smooth
from hmkcta import choose_plan, compress
from hmkcta.choosing.candidates import Candidate, Scored
from hmkcta.choosing.climbing import climbed
from hmkcta.choosing.judging import CARES, Search
from hmkcta.choosing.trial import Trial, trial_of
from hmkcta.choosing.tuning import _cut_further, _settled  # pyright: ignore[reportPrivateUsage]
from hmkcta.fitting.fit import EFFORTS
from hmkcta.streaming.source import prepare
from hmkcta.support.progress import nobody

PLAIN = (("axis0",), ("axis1",), ("axis2",))
MERGED = (("axis0", "axis1"), ("axis2",))
#: What blocks are worth, in dB: between those that a climb begins with and the best there is nothing for one round.
BLOCKS: dict[tuple[int, ...], float] = {(6, 6, 2): 34.0, (6, 6, 1): 34.2, (7, 6, 1): 35.4}


@pytest.mark.parametrize(("matrix", "grid"), [(35.0, (7, 6, 1)), (37.0, (1, 1, 1))])
def test_blocks_behind_a_matrix_are_climbed_to_the_end(
    monkeypatch: pytest.MonkeyPatch, matrix: float, grid: tuple[int, ...]
) -> None:
    """A matrix has nothing to climb; how far behind blocks begin says little, unless it is very far."""

    search = _search(monkeypatch, BLOCKS, matrix)
    begin = [Candidate(MERGED, (1, 1, 1), (0,)), Candidate(PLAIN, (6, 6, 2), (), True)]
    search.best([(each.organisation, each.grid) for each in begin], 1 << 12)
    assert _settled(search, begin, nobody, narrow=False)[1].grid == grid


def test_a_climb_exchanges_blocks_of_two_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    search = _search(monkeypatch, {(3, 2, 3): 34.0, (3, 3, 2): 35.0, (3, 4, 2): 35.5, (3, 3, 3): 33.0}, 20.0)
    assert climbed(search, Candidate(PLAIN, (3, 2, 3), (), True), 1 << 12, 0.0).candidate.grid == (3, 4, 2)


@pytest.mark.usefixtures("one_goal")
def test_waves_are_cut_as_waves_like_it() -> None:
    """Along each axis for itself blocks of (3, 2, 3) are the best: 31.3 dB."""
    y, x = np.mgrid[:112, :112]
    waves = np.zeros((90, 112, 112))
    for row, column, start in ((20, 30, 0), (70, 80, 15), (90, 20, 30)):
        far = np.hypot(y - row, x - column)
        for frame in range(start + 1, 90):
            phase = far - 1.1 * (frame - start)
            waves[frame] += np.cos(0.7 * phase) * np.exp(-0.5 * (phase / 5) ** 2) / np.sqrt(far + 3)
    model = compress(waves, size=158_720, threads=1)
    assert model.snr > 33.3


def test_bytes_for_an_snr_are_told_by_whole_blocks_and_not_by_a_step_across_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to the SNR worth is in dB, beyond it in octaves of bytes."""
    search = _search(monkeypatch, {(1, 1, 1): 0.0}, 20.0, ceiling=30.0)

    def worth(_: Trial, candidate: Candidate, **__: object) -> float:
        return 33.0 if candidate.cuts == (2, 1, 1) else 29.0

    monkeypatch.setattr(Trial, "worth", worth)
    thinned = Scored(30.5, Candidate(PLAIN, (4, 4, 2), (), True))
    assert _cut_further(search, thinned, nobody) == (33.0, Candidate(PLAIN, (4, 4, 2), (), True, (2, 1, 1)))


def _search(
    monkeypatch: pytest.MonkeyPatch, blocks: dict[tuple[int, ...], float], matrix: float, ceiling: float | None = None
) -> Search:
    """In which a matrix and some blocks are worth so much, and whatever else little."""

    def worths(_: Trial, modes: object, grid: tuple[int, ...], *__: object) -> list[Scored]:
        if modes == MERGED:
            return [Scored(matrix if set(grid) == {1} else 20.0, Candidate(MERGED, grid, (0,)))]
        return [Scored(blocks.get(grid, min(blocks.values()) - 0.2), Candidate(PLAIN, grid, (), True))]

    monkeypatch.setattr(Trial, "worths", worths)
    array = np.random.default_rng(0).random((48, 48, 16))
    trial = trial_of(prepare(array, None, "identity", None), 4000, ceiling, 4096, 0)
    return Search(trial, trial, PLAIN, 1, CARES[EFFORTS["thorough"]], 1 << 20, 0)


@pytest.mark.parametrize("goal", [{"size": 3000}, {"snr": 40.0}], ids=["size", "SNR"])
def test_what_is_done_of_a_stage_of_the_choice_never_falls(goal: dict[str, Any]) -> None:
    """But where numbers of one kind are looked at twice."""
    told = list[tuple[str, float]]()
    values = smooth(20, 30, 40) + 0.01 * np.random.default_rng(0).standard_normal((20, 30, 40))
    choose_plan(values, progress=lambda stage, done: told.append((stage, done)), threads=1, **goal)
    stages = {stage for stage, _ in told}
    assert {"organisation, 8-bit numbers", "blocks, 8-bit numbers"} <= stages
    for stage in stages:
        shares = [done for each, done in told if each == stage]
        assert shares == sorted(shares)
        assert 0 <= shares[-1] <= 1
