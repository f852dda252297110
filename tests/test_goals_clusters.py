"""Goals met by clusters of the data: materials whose pixels lie scattered, which no block brings together."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dense_reference import energy, snr
from hmkcta import compress
from hmkcta.axes import name_axes
from hmkcta.choosing.clustered import clustered
from hmkcta.choosing.trial import trial_of
from hmkcta.cli.notes import notes
from hmkcta.errors import HmkctaError
from hmkcta.fitting.memberships import start_candidates
from hmkcta.ranks import adaptive
from hmkcta.streaming.source import prepare

pytestmark = pytest.mark.usefixtures("one_goal")

PIXELS = "y+x, band"


@cache
def scattered() -> NDArray[np.float32]:
    """48 x 48 pixels of 16 materials at random places, the spectra of each in a plane of its own, and some noise."""
    rng = np.random.default_rng(0)
    planes = rng.standard_normal((16, 3, 40))
    weights = np.concatenate([4 + rng.random((48, 48, 1)), rng.standard_normal((48, 48, 2))], axis=2)
    pixels: NDArray[np.float64] = np.einsum("yxk,yxkb->yxb", weights, planes[rng.integers(16, size=(48, 48))])
    return (pixels + 0.02 * rng.standard_normal(pixels.shape)).astype(np.float32)


def test_scattered_materials_get_clusters_of_the_data() -> None:
    """16 times three columns, where matrices take more ranks than there are materials."""
    model = compress(scattered(), axes="y, x, band", snr=30.0, threads=1)
    matrix = compress(scattered(), "R<=40,*", axes="y, x, band", organisation=PIXELS, snr=30.0, threads=1)
    assert model.snr >= 30
    assert model.bounds[0].clusters[0] > 1
    assert model.metadata.organisation[0] != ("y",)
    assert model.nbytes < 0.5 * matrix.nbytes


def test_a_fast_choice_finds_clusters_too() -> None:
    """Without them it ends at 6 dB."""
    model = compress(scattered(), axes="y, x, band", size=24_000, quality="fast", threads=1)
    assert model.bounds[0].clusters[0] > 1
    assert model.snr > 40


@pytest.mark.parametrize("goal", [{"snr": 30.0}, {"size": 30_000}], ids=["snr", "size"])
def test_one_level_of_clusters_is_cut_to_a_goal(goal: dict[str, Any]) -> None:
    """Of equal ranks, and what is measured is what was stored."""
    values = scattered()
    model = compress(values, "R<=12,* C=16,1", axes="y, x, band", organisation=PIXELS, threads=1, **goal)
    assert model.bounds[0].clusters == (16, 1)
    assert model.snr == pytest.approx(snr(values, energy(values - np.asarray(model, np.float64))), abs=1e-3)
    if "snr" in goal:
        fixed = compress(values, "R=3,* C=16,1", axes="y, x, band", organisation=PIXELS, threads=1)
        assert model.snr >= 30
        assert model.nbytes <= fixed.nbytes
    else:
        assert 0.8 * goal["size"] < model.nbytes <= goal["size"]


def test_the_stage_is_announced_before_its_clusters_are_looked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Or what was finished before would be shown all the while."""
    told: list[str] = []

    def finding(*given: Any, **options: Any) -> Any:
        told.append("clusters")
        return start_candidates(*given, **options)

    monkeypatch.setattr(adaptive, "start_candidates", finding)
    compress(scattered(), "R<=3,* C=4,1", axes="y, x, band", organisation=PIXELS, threads=1, size=30_000,
             quality="fast", progress=lambda stage, _: told.append(stage))
    assert told.index(adaptive.EXAMINING) < told.index("clusters")


def test_clusters_are_judged_near_what_they_reach() -> None:
    source = prepare(scattered(), ["y", "x", "band"], "identity", None)
    trial = trial_of(source, 30_000, None, 4096, 0)
    worths = {each.clusters: worth for worth, each in clustered(trial, (("y", "x"), ("band",)))}
    model = compress(scattered(), "R<=12,* C=16,1", axes="y, x, band", organisation=PIXELS, size=30_000, threads=1)
    assert worths[16, 1] == pytest.approx(model.snr, abs=2.5)
    assert max(worths, key=lambda clusters: worths[clusters]) == (16, 1)


def test_a_file_larger_than_its_source_is_told_what_helps() -> None:
    """Whoever gave a goal, and no plan, has no R to make smaller."""
    noise = np.random.default_rng(0).integers(0, 255, (40, 50, 60)).astype(np.uint8)
    model = compress(noise, snr=60.0, threads=1, quality="fast")
    assert "less, by --snr" in notes(model, noise, planned=False)[0]
    assert "smaller R" in notes(model, noise)[0]


def _none(*_: Any) -> list[Any]:
    return []


def test_bytes_do_in_a_first_level(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of many cells, whose numbers would take a quarter of the file as float16."""
    options: dict[str, Any] = {"axes": "y, x, band", "size": 15_000, "threads": 1}
    model = compress(scattered(), **options)
    assert [level.bits for level in model.levels] == [8, 8]
    monkeypatch.setattr("hmkcta.comparing.rivals.first_in_bytes", _none)
    assert compress(scattered(), **options).snr < model.snr - 0.3



@cache
def balls() -> NDArray[np.float32]:
    """40 x 40 x 40 numbers that are alike in 20 balls, in what lies around them, and outside; and some noise."""
    rng = np.random.default_rng(1)
    z, y, x = np.mgrid[-1:1:40j, -1:1:40j, -1:1:40j]
    values = np.where(x**2 / 0.8 + y**2 / 0.7 + z**2 / 0.9 < 1, 1.0, 0.0)
    for _ in range(20):
        (c, d, e), r = rng.uniform(-0.6, 0.6, 3), rng.uniform(0.05, 0.25)
        values[(x - c) ** 2 + (y - d) ** 2 + (z - e) ** 2 < r**2] = rng.uniform(2, 5)
    return (values + 0.01 * rng.standard_normal(values.shape)).astype(np.float32)


def test_what_has_sharp_edges_gets_clusters() -> None:
    """As most lines are alike; blocks take more than twice as much."""
    model = compress(balls(), snr=27.0, threads=1)
    assert 27 <= model.snr < 27.3
    assert model.nbytes < 13_000
    assert max(model.bounds[0].clusters) > 16


@cache
def sensors() -> NDArray[np.float32]:
    """Four signals of 30,000 samples that follow one another in many ways, and noise."""
    time = np.linspace(0, 60, 30_000)
    signals = np.stack([np.sin(time), np.cos(1.7 * time), np.sin(time**2 / 30), np.exp(-(((time - 20) / 5) ** 2))], 1)
    return (signals + 0.02 * np.random.default_rng(0).standard_normal(signals.shape)).astype(np.float32)


def test_of_few_columns_clusters_are_found_between_the_ranks() -> None:
    """All four columns take four bytes a row and reach 45 dB; clusters of rank two take three, of rank one two."""
    model = compress(sensors(), snr=20.0, threads=1)
    assert 20 <= model.snr < 20.3
    assert model.nbytes < 0.8 * sensors().size


def test_what_is_longer_than_all_else_is_told_to_make_windows() -> None:
    model = compress(sensors(), snr=20.0, threads=1)
    assert "array.reshape(200, 150, 4)" in notes(model, sensors())[0]
    windows = sensors().reshape(200, 150, 4)
    folded = compress(windows, snr=20.0, threads=1)
    assert folded.nbytes < 0.7 * model.nbytes
    assert notes(folded, windows) == []
    with pytest.raises(HmkctaError, match=r"array\.reshape\(200, 150, 4\)"):
        compress(sensors(), size=10_000)


@pytest.mark.parametrize(("name", "role"), [("lat", "space"), ("longitude", "space"), ("band", "channel")])
def test_names_of_maps_and_spectra_have_roles(name: str, role: str) -> None:
    assert name_axes((4,), [name])[0].role == role


def test_clusters_are_those_that_the_ranks_were_judged_with() -> None:
    """800 rows in eight subspaces of three dimensions, parted anew once ranks are known: the best is fitted."""
    rng = np.random.default_rng(0)
    subspace = rng.integers(0, 8, 800)
    bases = rng.standard_normal((8, 3, 30))
    rows: NDArray[np.float64] = np.einsum("id,idc->ic", rng.standard_normal((800, 3)), bases[subspace])
    rows += 0.05 * rng.standard_normal(rows.shape)
    found = [compress(rows, "R<=16,* C=8,1", size=size, threads=1).snr for size in (9_000, 10_000, 11_000)]
    assert found[0] > 6
    assert found[1] > 6
    assert found[2] > 31
