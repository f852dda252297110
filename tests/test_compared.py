"""Progress while plans are compared by their fits: which of them is fitted, of how many."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hmkcta
from cli_tools import report, run, saved, smooth
from hmkcta import Model
from hmkcta.cells import Cells
from hmkcta.comparing import follow
from hmkcta.comparing.followed import fitted_with, further
from hmkcta.fitting.fit import EFFORTS, fit_level
from hmkcta.fitting.run import FirstLevels, Run
from hmkcta.hmkfile import encode
from hmkcta.plan import LevelSpec, Plan, parse_plan
from hmkcta.streaming.source import prepare
from hmkcta.support.once import Once
from hmkcta.support.progress import OF_PLAN, Compared, nobody

MODES = (("z",), ("y",), ("x",))
#: Stages of choosing a plan, for the other goal once more.
CHOOSING = ("organisation", "blocks", "finer choice of blocks")


def told_while(monkeypatch: pytest.MonkeyPatch, **goal: Any) -> tuple[list[tuple[str, Plan | None]], list[Plan]]:
    """The stages of a fit with the plan that was followed meanwhile, and all plans that were."""
    followed: list[Plan] = []
    told: list[tuple[str, Plan | None]] = []

    def noted(task: follow.Task) -> Model:
        followed.append(task.plan)
        return follow.follow(task)

    monkeypatch.setattr("hmkcta.comparing.followed.follow", noted)
    hmkcta.compress(smooth(12, 14, 16), axes="z, y, x", threads=1,
                    progress=lambda stage, _: told.append((stage, followed[-1] if followed else None)), **goal)
    return told, followed


@pytest.mark.parametrize("goal", [{"size": 3000}, {"snr": 40.0}, {"snr": 70.0}], ids=str)
def test_every_stage_of_a_fit_says_of_which_plan_it_is(goal: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    told, followed = told_while(monkeypatch, **goal)
    assert len(followed) > 2
    seen: list[tuple[int, int]] = []
    for stage, plan in told:
        _, _, which = stage.partition(OF_PLAN)
        if plan is None or not which:
            assert not which, "a plan is being chosen"
            assert len(seen) == 0 or stage.startswith(CHOOSING), "no other was known than the first"
        else:
            number, known = map(int, which.split(" of "))
            assert followed[number - 1] == plan
            seen.append((number, known))
    assert {1, *(number for number, _ in seen)} == set(range(1, len(followed) + 1))
    assert all(number <= known for number, known in seen)
    assert seen == sorted(seen)
    assert seen == sorted(seen, key=lambda each: each[1]), "neither number falls"
    assert {stage.partition(OF_PLAN)[0] for stage, plan in told if plan} >= {"level 1", "measuring"}


@pytest.mark.parametrize("goal", [{"size": 2000}, {"snr": 40.0}], ids=str)
def test_thorough_fits_all_that_medium_does(goal: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """More care is judged by samples as well: a wind field of 118 KB ended 2.7 dB below `medium`."""
    _, medium = told_while(monkeypatch, **goal)
    _, thorough = told_while(monkeypatch, quality="thorough", **goal)
    assert thorough[: len(medium)] == medium
    assert len(thorough) > len(medium)


def test_what_takes_more_bytes_than_another_plan_is_not_fitted() -> None:
    """What takes up to `far` times as many is, and what only misses the SNR."""
    waves = smooth(12, 14, 16)
    source = prepare(waves, ["z", "y", "x"], None, None, 1)
    narrow, plan, large, short = (replace(parse_plan(text, MODES), snr=40.0) for text in
                                  ("R<=12,14,16 bits=8", "R<=12,14,16", "R<=*,*,16", "R<=*,1,16"))
    told: list[str] = []
    run = Run(EFFORTS["fast"], 0, 1, lambda stage, _: told.append(stage))
    task = follow.Task(source, narrow, 4096, "generic", run)
    own, *others = fitted_with(task, [plan, large, short], far=2.5)
    assert [of.plan for of, _ in others] == [plan, short]
    assert own[1].nbytes < others[0][1].nbytes < 2.5 * own[1].nbytes
    assert others[1][1].snr < 40
    told.clear()
    assert not list(further(task, [plan, large], own))
    assert "level 1" not in {stage.partition(OF_PLAN)[0] for stage in told}
    assert [of.plan for of, _ in further(task, [plan, large])] == [plan, large]


def test_the_plan_that_was_best_makes_the_same_file_at_once(tmp_path: Path) -> None:
    source = saved(tmp_path / "a.npy", smooth(12, 14, 16))
    words = ("compress", source, "--axes", "z,y,x", "--size", 2500, "--threads", 1)
    told = report(*words, "-o", tmp_path / "a.hmk")
    plan = ("--organisation", told["organisation"], "--plan", told["plan"])
    again = report(*words, "-o", tmp_path / "b.hmk", *plan)
    assert told["plans_tried"] > again["plans_tried"]
    assert (tmp_path / "a.hmk").read_bytes() == (tmp_path / "b.hmk").read_bytes()
    assert f"plan: {shlex.join(plan)}" in run(*words, "-o", tmp_path / "c.hmk").stdout


def test_a_plan_that_is_given_has_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    told, _ = told_while(monkeypatch, plan="R=2 C=2,1,1 / R=2")
    assert {"level 1", "level 2", "measuring"} <= {stage for stage, _ in told}
    assert not any(OF_PLAN in stage for stage, _ in told)


def test_the_only_plan_has_no_number_until_others_are_known(capsys: pytest.CaptureFixture[str]) -> None:
    plans = Compared()
    plans.expect(1)
    plans.following(plans.begin(1)[0], print)("level 1", 0.5)
    plans.end()
    plans.expect(3)
    plans.following(plans.begin(1)[0], print)("level 1", 0.5)
    assert capsys.readouterr().out == "level 1 0.5\nlevel 1, plan 2 of 4 0.5\n"


def test_of_plans_side_by_side_the_oldest_tells_and_then_what_the_next_one_said_last(
    capsys: pytest.CaptureFixture[str],
) -> None:
    plans = Compared()
    plans.expect(3)
    first, second, third = (plans.following(number, print) for number in plans.begin(3))
    second("level 1", 0.25)
    first("level 1", 0.5)
    second("level 2", 0.75)
    plans.end()
    plans.end()
    third("level 1", 1.0)
    said = ["level 1, plan 1 of 3 0.5", "level 2, plan 2 of 3 0.75", "level 1, plan 3 of 3 1.0"]
    assert capsys.readouterr().out.splitlines() == said


RANKS = [parse_plan(text, MODES) for text in ("R=1", "R=2", "R=3", "R=4")]


def task_on_two_threads() -> follow.Task:
    run = Run(EFFORTS["medium"], seed=0, threads=2, progress=nobody)
    return follow.Task(prepare(smooth(12, 14, 16), "z, y, x", None, None, 1), RANKS[0], 4096, "volume", run)


def test_plans_are_followed_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two threads meet; one alone would wait in vain."""
    meeting = Barrier(2)

    def met(task: follow.Task) -> Model:
        meeting.wait(timeout=30)
        return follow.follow(task)

    monkeypatch.setattr("hmkcta.comparing.followed.follow", met)
    assert [of.plan for of, _ in further(task_on_two_threads(), RANKS)] == RANKS


def test_a_plan_that_fails_beside_others_ends_them_all(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(task: follow.Task) -> Model:
        if task.plan == RANKS[1]:
            raise ZeroDivisionError
        return follow.follow(task)

    monkeypatch.setattr("hmkcta.comparing.followed.follow", failing)
    models = further(task_on_two_threads(), RANKS)
    assert next(models).task.plan == RANKS[0]
    with pytest.raises(ZeroDivisionError):
        next(models)


def test_plans_that_begin_alike_share_their_first_level(monkeypatch: pytest.MonkeyPatch) -> None:
    fitted = list[LevelSpec]()

    def noted(tensor: NDArray[np.float32], spec: LevelSpec, *others: Any) -> Cells:
        fitted.append(spec)
        return fit_level(tensor, spec, *others)

    monkeypatch.setattr("hmkcta.fitting.hierarchy.fit_level", noted)
    texts = ("R=1 C=3,1,1 / R<=4", "R=1 C=3,1,1 / R<=4 bits=8")
    plans = [replace(parse_plan(text, MODES), size=9000) for text in texts]
    alone = task_on_two_threads()
    together = [replace(alone, first_levels=firsts) for firsts in (None, Once[FirstLevels](1))]
    files, first_levels = list[list[bytes]](), list[int]()
    for task in together:
        fitted.clear()
        files.append([b"".join(encode(model.metadata, model.levels)) for _, model in further(task, plans)])
        first_levels.append(sum(spec.cells == 3 for spec in fitted))
    assert files[0] == files[1]
    assert first_levels == [2, 1]


def test_the_command_line_adds_the_times_of_all_plans_and_counts_them(tmp_path: Path) -> None:
    source = saved(tmp_path / "a.npy", smooth(12, 14, 16))
    words = ("compress", source, "-o", tmp_path / "a.hmk", "--size", 3000, "--overwrite")
    found = report(*words)
    assert found["plans_tried"] > 2
    said = run(*words, "--verbose").stderr
    assert "  level 1: " in said
    assert OF_PLAN not in said
    assert report(*words[:4], "--plan", "R=2", "--overwrite")["plans_tried"] == 1
