"""Goals between two ranks: numbers of blocks to choose from, and no more fits than it takes to know."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from hmkcta import HmkctaError, Model, choose_plan, compress, parse_plan
from hmkcta.axes import Axis
from hmkcta.comparing.finer import LARGE, finer, is_far_beyond
from hmkcta.fitting.hierarchy import fit_nodes
from hmkcta.plan import LevelSpec, Plan
from hmkcta.synthetic import volume
from hmkcta.synthetic.dataset import Dataset

MODES = (("y",), ("x",))
BRICKS, MERGED = "R<=160,16,28 grid=x:", "time+x, z, y"


@cache
def dataset() -> Dataset:
    return volume((16, 28, 28), frames=6)


def fitted(**options: Any) -> Model:
    return compress(dataset().values, axes=dataset().axes, threads=1, **options)


# The plan


def test_ranges_are_written_and_read_back() -> None:
    text = "R<=8,8 grid=y:1-2,x:3"
    (level,) = parse_plan(text, MODES).levels
    assert str(level) == text
    assert [way.grid for way in level.ways(MODES)] == [(("x", 3),), (("y", 2), ("x", 3))]
    assert all(not way.fewest for way in level.ways(MODES))


@pytest.mark.parametrize("plan", ["R<=8 grid=y:3-2", "R<=8 grid=y:0-2", "R=1 grid=y:2-3 / R<=8", "R<=8 cut<=y:1-2"])
def test_ranges_that_make_no_sense_are_refused(plan: str) -> None:
    with pytest.raises(HmkctaError) as caught:
        parse_plan(plan, MODES)
    assert caught.value.reason == "plan-grid"


def test_axes_that_are_cut_most_are_tried_otherwise() -> None:
    axes = [Axis(name, 20) for name in "abcd"] + [Axis("e", 7)]
    modes = (("a", "b"), ("c",), ("d",), ("e",))
    level = LevelSpec((8, None, 8, 8), (8, 1, 3, 1), (1,) * 4, grid=(("a", 4), ("b", 2), ("d", 3)), own=True)
    found = finer(Plan(modes, (level,), snr=30.0), axes)
    assert str(found) == "R<=8,*,8,8 grid=a:3-5,b:1-3,d:2-4"


@pytest.mark.parametrize("plan", ["R=1 grid=y:2 / R<=8", "R=4", "R<=8 C=3,1", "R<=8 cut<=y:4", "R<=*,*"])
def test_other_plans_are_left_alone(plan: str) -> None:
    level = parse_plan(plan, MODES)
    assert finer(level, [Axis("y", 40), Axis("x", 40)]) is None


def test_large_arrays_are_left_alone() -> None:
    plan = parse_plan("R<=8", MODES)
    assert finer(plan, [Axis("y", LARGE // 64), Axis("x", 64)]) is not None
    assert finer(plan, [Axis("y", LARGE // 64 + 1), Axis("x", 64)]) is None


@pytest.mark.parametrize(("snr", "coarse"), [(29.9, False), (30.2, False), (30.4, True), (np.inf, False)])
def test_a_goal_counts_as_hit_up_to_three_tenths_of_a_db(snr: float, coarse: bool) -> None:
    assert is_far_beyond(Plan(MODES, (), snr=30.0), snr, 1) is coarse


# The fit


@pytest.mark.parametrize("goal", [{"snr": 28.0}, {"size": 22_000}], ids=["snr", "size"])
def test_of_a_range_the_number_of_blocks_that_suits_the_goal_is_taken(goal: dict[str, Any]) -> None:
    chosen, *each = (fitted(plan=BRICKS + count, organisation=MERGED, **goal) for count in ("3-5", "3", "4", "5"))
    assert chosen.bounds[0].clusters in {model.bounds[0].clusters for model in each}
    if "snr" in goal:
        assert chosen.snr >= goal["snr"]
        assert chosen.nbytes == min(model.nbytes for model in each)
    else:
        assert chosen.nbytes <= goal["size"]
        assert chosen.snr >= max(model.snr for model in each) - 0.02


def test_no_fit_is_wasted_where_ranks_are_large_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """The choices promise what the fit comes to: one rank less falls short, which need not be tried."""
    fits: list[int] = []

    def counted(*arguments: Any) -> None:
        fits.append(1)
        fit_nodes(*arguments)

    monkeypatch.setattr("hmkcta.ranks.last_level.fit_nodes", counted)
    model = fitted(plan=BRICKS + "5", organisation=MERGED, snr=36.0)
    assert 36.5 < model.snr < 37
    assert len(fits) == 1


# The choice


def test_small_arrays_choose_among_numbers_of_blocks() -> None:
    """With the blocks that look best on their own, 28 dB take 24,044 bytes and come out as 28.57 dB."""
    plan = choose_plan(dataset().values, axes=dataset().axes, snr=28.0, bits=16, threads=1)
    assert plan.levels[0].fewest
    model = fitted(snr=28.0, bits=16)
    assert 28 <= model.snr <= 28.3
    assert model.nbytes < 23_000


@pytest.mark.parametrize("goal", [{"snr": 28.0}, {"size": 24_000}], ids=["snr", "size"])
def test_far_beyond_its_goal_a_plan_is_tried_with_other_blocks(
    goal: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hmkcta.encode.SMALL", 0)
    monkeypatch.setattr("hmkcta.comparing.finer.USED", 1.0)
    goal = goal | {"bits": 16, "quality": "fast"}  # which compares no rivals
    plain = fitted(plan=choose_plan(dataset().values, axes=dataset().axes, threads=1, **goal), quality="fast")
    model = fitted(**goal)
    if "snr" in goal:
        assert plain.snr > 28.5
        assert 28 <= model.snr <= 28.3
        assert model.nbytes < 0.95 * plain.nbytes
    else:
        assert model.nbytes <= goal["size"]
        assert model.snr > plain.snr + 0.1


def test_blocks_of_a_long_axis_are_made_more_to_fill_a_size() -> None:
    """A second rank of 156 blocks has no room, 41 blocks more of one have; so many more was no step of the trial."""
    rng = np.random.default_rng(3)
    walks = rng.standard_normal((5000, 60)).cumsum(0) * np.exp(-np.arange(60) / 6)
    series = walks @ np.linalg.qr(rng.standard_normal((60, 60)))[0]
    model = compress(series, axes="sample, channel", size=25_305, quality="fast", threads=1)
    assert 0.95 * 25_305 < model.nbytes <= 25_305
    assert model.snr > 29.8


def test_a_rival_too_large_for_the_goal_loses_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = choose_plan(dataset().values, axes=dataset().axes, size=24_000, threads=1)
    large = replace(parse_plan("R=*,*,*,*", (("time",), ("z",), ("y",), ("x",))), size=24_000)

    def tuned(*_: Any, **__: Any) -> list[Plan]:
        return [chosen, large]

    monkeypatch.setattr("hmkcta.encode.tune", tuned)
    with pytest.raises(HmkctaError, match="size-too-small"):
        fitted(plan=large)
    assert fitted(size=24_000).nbytes <= 24_000


def test_more_is_never_worse() -> None:
    bytes_of = [fitted(snr=snr, quality="fast").nbytes for snr in (20.0, 24.0, 28.0, 32.0)]
    snr_at = [fitted(size=size, quality="fast").snr for size in (12_000, 16_000, 20_000, 26_000)]
    assert bytes_of == sorted(bytes_of)
    assert snr_at == sorted(snr_at)


def test_a_rank_that_is_a_large_step_is_parted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rank of all texels together costs as many numbers; of rows and of columns a few, which take less to come to."""
    y, x = np.ogrid[0:1:40j, 0:1:44j]
    texels = 1.5 + np.sin(3 * x + 2 * y) + 0.5 * np.cos(4 * x * y)
    rng = np.random.default_rng(0)
    values = np.abs(rng.standard_normal((9, 10)))[..., None, None] * (texels + 0.1 * rng.standard_normal(texels.shape))
    modes = (("light", "view"), ("y", "x"))
    matrix = replace(parse_plan("R<=*,90 bits=8", modes), snr=15.0)

    def tuned(*_: Any, **__: Any) -> list[Plan]:
        return [matrix]

    monkeypatch.setattr("hmkcta.encode.tune", tuned)
    alone, parted = (compress(values, plan, axes="light,view,y,x", snr=15.0, threads=1) for plan in (matrix, None))
    assert 15 <= alone.snr < 15.3, "bits make up for what lies between two ranks"
    assert parted.plan.organisation[-2:] == (("y",), ("x",))
    assert parted.snr >= 15
    assert parted.nbytes < 0.97 * alone.nbytes


def test_an_organisation_that_is_given_is_kept() -> None:
    """Also where a rank is far beyond the goal, and where two levels are compared."""
    options: dict[str, Any] = {"axes": dataset().axes, "organisation": "time+z, y+x", "threads": 1}
    for snr in (10.0, 70.0):
        assert compress(dataset().values, snr=snr, **options).plan.organisation == (("time", "z"), ("y", "x"))
