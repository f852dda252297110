"""Ranks for a goal, of a tensor that memory does not hold: examined on every few rows, reached on all of them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hmkcta.axes import Axis
from streaming_tools import fitted

pytestmark = pytest.mark.usefixtures("small_slabs")


def uneven(weight: float) -> Any:
    """Values `[12, 14, 900]` of ranks that fall off, the rows that a sample keeps of another weight than the others."""
    rng, shape = np.random.default_rng(0), (12, 14, 900)
    factors = [rng.standard_normal((40, size)) for size in shape]
    values = np.einsum("k,kt,ky,kx->tyx", 0.7 ** np.arange(40), *factors)
    values[:, :, ::5] *= weight
    return SimpleNamespace(values=values.astype(np.float32), axes=list(map(Axis, "tyx", shape)))


@pytest.mark.parametrize("plan", ["R<=12,14,*", "R<=12,14,* grid=y:2"])
@pytest.mark.parametrize("weight", [0.5, 1.5])
def test_a_sample_of_another_energy_than_the_whole_does_not_mislead(
    monkeypatch: pytest.MonkeyPatch, plan: str, weight: float
) -> None:
    """What the whole has more of would look like error that no rank takes away, what it has less of like none."""
    data, goal = uneven(weight), {"organisation": None, "snr": 30.0}
    inside, outside = (fitted(data, monkeypatch, data.values.size // share, plan, **goal) for share in (1, 5))
    assert outside.snr >= 30
    assert outside.snr == pytest.approx(inside.snr, abs=0.1)
    assert outside.nbytes == pytest.approx(inside.nbytes, rel=0.02)
