"""Climbs over blocks: where they begin, and when they end."""

from __future__ import annotations

import numpy as np
import pytest

from hmkcta.candidates import Candidate
from hmkcta.fit import EFFORTS
from hmkcta.judging import CARES, Search
from hmkcta.progress import nobody
from hmkcta.source import prepare
from hmkcta.trial import Trial, trial_of
from hmkcta.tuning import _settled  # pyright: ignore[reportPrivateUsage]

PLAIN = (("axis0",), ("axis1",), ("axis2",))
MERGED = (("axis0", "axis1"), ("axis2",))
#: What blocks are worth, in dB: between those that a climb begins with and the best there is nothing for one round.
BLOCKS: dict[tuple[int, ...], float] = {(6, 6, 2): 34.0, (6, 6, 1): 34.2, (7, 6, 1): 35.4}


@pytest.mark.parametrize(("matrix", "grid"), [(35.0, (7, 6, 1)), (37.0, (1, 1, 1))])
def test_blocks_behind_a_matrix_are_climbed_to_the_end(
    monkeypatch: pytest.MonkeyPatch, matrix: float, grid: tuple[int, ...]
) -> None:
    """A matrix has nothing to climb; how far behind blocks begin says little, unless it is very far."""

    def worths(_: Trial, modes: object, blocks: tuple[int, ...], *__: object) -> list[tuple[float, Candidate]]:
        if modes == MERGED:
            return [(matrix if set(blocks) == {1} else 20.0, Candidate(MERGED, blocks, (0,)))]
        return [(BLOCKS.get(blocks, 33.8), Candidate(PLAIN, blocks, (), True))]

    monkeypatch.setattr(Trial, "worths", worths)
    array = np.random.default_rng(0).random((48, 48, 16))
    trial = trial_of(prepare(array, None, "identity", None), 4000, None, 4096, 0)
    search = Search(trial, trial, PLAIN, 1, CARES[EFFORTS["medium"]], 1 << 20, 0)
    begin = [Candidate(MERGED, (1, 1, 1), (0,)), Candidate(PLAIN, (6, 6, 2), (), True)]
    search.best([(each.organisation, each.grid) for each in begin], 1 << 12)
    assert _settled(search, begin, nobody, narrow=False)[1].grid == grid
