"""Whatever plan is written for whatever array: a file whose SNR is what decoding it shows, or a sentence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dense_reference import energy, snr
from hmkcta import HmkctaError, compress
from hmkcta.streaming import budget

#: Beyond so many dB float32, in which a model is decoded, rounds visibly.
ROUNDED = 110.0


@dataclass(frozen=True)
class Wanted:
    """A shape, how its axes are merged, a plan and a goal."""

    shape: tuple[int, ...]
    organisation: str
    plan: str
    goal: dict[str, Any]
    seed: int


@st.composite
def wanted(draw: st.DrawFn) -> Wanted:
    """Levels of clusters and grids, of merged and undecomposed modes."""
    shape = tuple(draw(st.lists(st.sampled_from([1, 2, 3, 5, 8, 12]), min_size=1, max_size=4)))
    modes: list[list[str]] = []
    for name in draw(st.permutations([f"a{n}" for n in range(len(shape))])):
        if modes and draw(st.booleans()):
            modes[-1].append(name)
        else:
            modes.append([name])
    kept = [draw(st.integers(0, 5)) == 0 for _ in modes]
    levels = draw(st.integers(1, 3))
    plan = " / ".join(draw(level(modes, kept)) for _ in range(levels))
    goals: list[dict[str, Any]] = [{}, {"snr": 20.0}, {"snr": 60.0}, {"size": 900}, {"size": 4000}]
    goal = draw(st.sampled_from(goals))
    return Wanted(shape, ", ".join(map("+".join, modes)), plan, goal, draw(st.integers(0, 9)))


@st.composite
def level(draw: st.DrawFn, modes: list[list[str]], kept: list[bool]) -> str:
    ranks = ",".join("*" if skip else str(draw(st.integers(1, 3))) for skip in kept)
    axes = [name for mode, skip in zip(modes, kept, strict=True) if not skip for name in mode]
    grid = ",".join(f"{name}:{draw(st.integers(1, 4))}" for name in axes[: draw(st.integers(1, 3))])
    clusters = ",".join("1" if skip else str(draw(st.integers(1, 2))) for skip in kept)
    cells = draw(st.sampled_from(["", f" C={clusters}", f" C={clusters} K=2" if "2" in clusters else "",
                                  *([f" grid={grid}"] if axes else [])]))
    return f"R={ranks}{cells}"


@pytest.mark.filterwarnings("ignore::hmkcta.GoalMissed")
@pytest.mark.parametrize("workset", [budget.WORKSET, 100])
@settings(max_examples=120, deadline=None)
@given(wanted())
def test_any_plan_is_followed_or_refused(workset: int, wanted: Wanted) -> None:
    rng = np.random.default_rng(wanted.seed)
    values = np.where(rng.random(wanted.shape) < 0.7, rng.standard_normal(wanted.shape), 0).astype(np.float32)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(budget, "WORKSET", workset)
        patch.setattr(budget, "SMALLEST", min(workset, budget.SMALLEST))
        try:
            model = compress(values, wanted.plan, axes=[f"a{n}" for n in range(values.ndim)], threads=1,
                             organisation=wanted.organisation, quality="fast", seed=wanted.seed, **wanted.goal)
        except HmkctaError:
            return
    assert model.nbytes <= wanted.goal.get("size", model.nbytes)
    if values.any() and (error := energy(values - np.asarray(model))):
        assert min(snr(values, error), ROUNDED) == pytest.approx(min(model.snr, ROUNDED), abs=0.05)
