"""Goals that are compared with what the other goal leads to: data of low rank, or of few distinct values."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hmkcta import Model, compress
from hmkcta.choosing.blocks import Samples, samples_of
from hmkcta.comparing import both_goals
from hmkcta.hmkfile import encode
from hmkcta.streaming.source import Source
from test_goals_anew import Told


@cache
def kernel() -> NDArray[np.float64]:
    """Of low rank, but for little: 1 / (i + j + k + 1)."""
    i, j, k = np.ogrid[:40, :40, :40]
    return 1 / (i + j + k + 1)


@cache
def labels() -> NDArray[np.uint8]:
    """Twelve kinds of blocks, each marked by a one of its own."""
    place = np.add.outer(np.add.outer(np.arange(20) // 3, np.arange(24) // 4), np.arange(22) // 5)
    return np.eye(12, dtype=np.uint8)[place % 12]


def encoded(model: Model) -> bytes:
    return b"".join(map(bytes, encode(model.metadata, model.levels)))


def of_kernel(**options: Any) -> Model:
    return compress(kernel(), axes="z,y,x", **options)


def test_a_size_ends_no_lower_than_a_smaller_file_for_an_snr() -> None:
    """It ended at 51.8 dB, 80 took 4,619 bytes."""
    model = of_kernel(size=5020)
    assert model.nbytes <= 5020
    assert model.snr > 75


def test_an_snr_takes_no_more_than_a_size_that_ends_above_it() -> None:
    """It took 5,526 bytes; 4,750 come to 158 dB."""
    model = compress(labels(), axes="a,b,c,d", snr=55)
    assert model.snr >= 55
    assert model.nbytes < 4_800


def test_without_a_goal_a_file_takes_no_more_than_its_ceiling() -> None:
    """Numbers of ones took 3,724 bytes, where 50 dB take 1,462."""
    ones = np.ones((30, 30, 30), np.float32)
    model, asked = compress(ones, axes="z,y,x"), compress(ones, axes="z,y,x", snr=50)
    assert model.snr >= 50
    assert model.nbytes <= asked.nbytes


@pytest.mark.parametrize(("goal", "quality", "other"), [
    ({"size": 5020}, "medium", True), ({"size": 5020}, "fast", False), ({"snr": 20}, "medium", True),
])  # fmt: skip
def test_plans_are_chosen_for_the_other_goal_unless_it_should_be_fast(
    goal: dict[str, Any], quality: str, other: bool, tmp_path: Path
) -> None:
    journal = Told(tmp_path / "a")
    with journal:
        of_kernel(**goal, quality=quality, journal=journal)
    assert journal.names[0] == "plan"
    assert any("other" in name for name in journal.names[1:]) == other


def test_for_a_size_where_rounding_tells_nothing_none_is_chosen_for_an_snr(tmp_path: Path) -> None:
    journal = Told(tmp_path / "a")
    with journal:
        model = compress(np.random.default_rng(0).random((16, 16, 16)), size=4000, journal=journal)
    assert model.snr < both_goals.FROM
    assert journal.names == ["plan"]


def test_an_snr_takes_the_clusters_that_fewer_bytes_lead_to() -> None:
    """Balls of one density each took 12,287 bytes, by ranks of nodes."""
    rng, values = np.random.default_rng(1), np.zeros((20, 40, 40))
    z, y, x = np.meshgrid(*(np.linspace(-1, 1, size) for size in values.shape), indexing="ij")
    for _ in range(12):
        centre, radius = rng.uniform(-0.7, 0.7, 3), rng.uniform(0.15, 0.5)
        inside = (z - centre[0]) ** 2 + (y - centre[1]) ** 2 + (x - centre[2]) ** 2 < radius**2
        values[inside] = rng.uniform(0.2, 1)
    model = compress(values, axes="z,y,x", snr=26)
    assert model.snr >= 26
    assert model.nbytes < 11_200


@pytest.mark.parametrize(("used", "most"), [(0.0, 1), (1.0, 2)])
def test_the_other_goal_is_left_where_it_has_little_to_gain(
    used: float, most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once it was found better, it is tried again from a model that leaves more than that share of the size unused."""
    better = iter([True, False])
    monkeypatch.setattr(both_goals, "USED", used)
    monkeypatch.setattr(both_goals, "_is_better", lambda *_: next(better))  # pyright: ignore
    journal = Told(tmp_path / "a")
    with journal:
        of_kernel(size=4600, journal=journal)
    assert sum("other" in name for name in journal.names) == most


def test_what_choices_share_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    made = list[Samples]()

    def counted(source: Source) -> Samples:
        made.append(samples_of(source))
        return made[-1]

    for module in ("hmkcta.encode", "hmkcta.choosing.trial"):
        monkeypatch.setattr(f"{module}.samples_of", counted)
    together = encoded(of_kernel(size=5020))
    assert len(made) == 1
    monkeypatch.setattr("hmkcta.encode.SHARED", 0)
    assert encoded(of_kernel(size=5020)) == together
    assert len(made) > 2


def test_another_goal_is_resumed(tmp_path: Path) -> None:
    """Killed after all plans were chosen, it comes to the same bytes and chooses none of them again."""
    expected = encoded(of_kernel(size=4600))
    journal = Told(tmp_path / "a")

    def stop(stage: str, _: float) -> None:
        if journal.names and journal.names[-1] == "plan-of-other-goal-0" and stage.startswith("level"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), journal:
        of_kernel(size=4600, journal=journal, progress=stop)
    with Told(tmp_path / "a", resume=True) as again:
        assert encoded(of_kernel(size=4600, journal=again)) == expected


def test_the_values_themselves_are_left_at_that(monkeypatch: pytest.MonkeyPatch) -> None:
    """A size of nearly as many bytes leads to plans of hundreds of clusters, which took minutes."""

    def never(*_: Any) -> None:
        raise AssertionError("compared with another goal")

    monkeypatch.setattr(both_goals, "_followed", never)
    noise = np.random.default_rng(0).random((12, 13, 14))
    model = compress(noise, snr=40.0, decode_cost=1)
    assert not any(model.plan.levels[0].ranks)
    assert model.snr >= 40
