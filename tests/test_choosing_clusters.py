"""Clusters of the data are found for a size as for an SNR: judged on rows that tell of all, and fitted where near."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hmkcta import choose_plan, compress, encode
from hmkcta.choosing import clustered as clusters
from hmkcta.choosing.clustered import clustered
from hmkcta.choosing.trial import trial_of
from hmkcta.choosing.tuning import tune
from hmkcta.plan import Plan
from hmkcta.streaming.source import prepare

pytestmark = pytest.mark.usefixtures("one_goal")

F32 = NDArray[np.float32]


@cache
def scrolled() -> F32:
    """80 frames of 128 x 160 pixels, each showing noise four rows further down: its rows come again in other frames."""
    page = np.random.default_rng(0).standard_normal((4 * 79 + 128, 160), np.float32)
    return np.stack([page[4 * n : 4 * n + 128] for n in range(80)])


@cache
def four_sheets() -> F32:
    """400 x 2000 numbers whose columns lie in four planes, in no order."""
    rng = np.random.default_rng(0)
    planes, of = rng.standard_normal((4, 400, 3)), rng.integers(4, size=2000)
    values: NDArray[np.float64] = np.einsum("ntk,nk->tn", planes[of], rng.standard_normal((2000, 3)) * [4, 1, 0.5])
    return (values + 0.02 * rng.standard_normal(values.shape)).astype(np.float32)


def test_what_moves_is_judged_by_rows_that_tell_of_all() -> None:
    """Every so many rows of every so many frames are the same few rows, of which clusters would leave nothing."""
    source = prepare(scrolled(), ["frame", "y", "x"], "identity", None)
    trial = trial_of(source, 160_000, None, 4096, 0)
    worths = {each.clusters: worth for worth, each in clustered(trial, (("frame", "y"), ("x",)))}
    model = compress(
        scrolled(), "R=3,* C=64,1", axes="frame, y, x", organisation="frame+y, x", quality="fast", threads=1
    )
    assert model.nbytes < 160_000 < model.nbytes + 64 * 2 * 160 + 2 * 10240
    assert worths[64, 1] < model.snr + 1


def test_a_look_at_few_rows_leaves_nothing_behind_for_a_closer_one() -> None:
    """Both are of as many rows, where there are two columns, and not of the same."""
    values, modes = np.random.default_rng(0).standard_normal((512, 1024, 2), np.float32), (("y", "x"), ("part",))
    source = prepare(values, ["y", "x", "part"], "identity", None)
    fresh, again = (trial_of(source, 3_000_000, None, 4096, 0) for _ in range(2))
    assert list(clustered(again, modes, few=True))
    assert list(clustered(again, modes)) == list(clustered(fresh, modes))


def test_few_clusters_are_found_where_many_are_hopeless() -> None:
    """The columns of 16 clusters take more bytes than there are, those of four what they should."""
    model = compress(four_sheets(), axes="t, n", size=36_000, threads=1)
    assert model.bounds[0].clusters == (1, 4)


def test_of_what_is_judged_alike_with_clusters_and_without_fits_tell_the_better(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """For a size; as if four clusters had been judged no better than what has none."""
    monkeypatch.setattr(clusters, "SURELY", 20.0)
    monkeypatch.setattr(clusters, "CLOSE", 20.0)
    model = compress(four_sheets(), axes="t, n", size=36_000, threads=1)
    assert model.bounds[0].clusters == (1, 4)


def test_for_an_snr_another_number_of_clusters_is_the_first_rival(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rank of the one may be a smaller step than of the other."""
    plans: list[Plan] = []

    def tuned(*given: Any, **options: Any) -> list[Plan]:
        plans.extend(tune(*given, **options))
        return plans

    monkeypatch.setattr(clusters, "CLOSE", 20.0)
    monkeypatch.setattr(encode, "tune", tuned)
    choose_plan(four_sheets(), axes="t, n", snr=25, threads=1)
    first, rival = [plan.levels[0].clusters for plan in plans[:2]]
    assert {first, rival} == {(1, 4), (1, 8)}


def test_matrices_are_found_that_are_far_behind_without_clusters() -> None:
    """Rows of pixels and views in twelve subspaces; the other matrices know nothing of these."""
    rng = np.random.default_rng(1)
    bases, of = rng.standard_normal((12, 3, 24)), rng.integers(12, size=2400)
    rows: NDArray[np.float64] = np.einsum("nk,nkl->nl", rng.standard_normal((2400, 3)), bases[of])
    values = (rows + 0.02 * rng.standard_normal(rows.shape)).astype(np.float32).T.reshape(24, 4, 30, 20)
    model = compress(values, axes="light, view, y, x", size=28_000, threads=1)
    assert model.metadata.organisation == (("light",), ("view", "y", "x"))
    assert max(model.bounds[0].clusters) > 1
    assert model.snr > 20


def highlights(light: int, view: int, texel: int) -> F32:
    """A material of narrow highlights about normals that lie scattered: light x view x texel x rgb."""
    rng = np.random.default_rng(0)

    def upper(count: int, spread: float) -> NDArray[np.float64]:
        """Directions about the pole."""
        slopes = np.concatenate([rng.normal(0, spread, (count, 2)), np.ones((count, 1))], axis=1)
        return slopes / np.linalg.norm(slopes, axis=1, keepdims=True)

    lights, views, normals = upper(light, 1.0), upper(view, 1.0), upper(texel, 0.3)
    halves = lights[:, None] + views
    cosines = np.maximum((halves / np.linalg.norm(halves, axis=-1, keepdims=True)) @ normals.T, 0)
    diffuse = np.maximum(lights @ normals.T, 0)[:, None, :, None] * [0.6, 0.4, 0.2]
    return (diffuse + 3 * cosines[..., None] ** 120).astype(np.float32)


def test_many_clusters_are_found_where_few_are_hopeless() -> None:
    """Spectra of 60 materials, each texel a multiple of one: 64 lines, of which 16 leave next to all."""
    rng = np.random.default_rng(1)
    materials = rng.integers(0, 60, (128, 128))
    spectra = rng.uniform(0, 1, (60, 31))[materials] * (1 + 0.15 * rng.standard_normal((128, 128, 1)))
    cube = (spectra.transpose(2, 0, 1) + rng.normal(0, 0.003, (31, 128, 128))).astype(np.float32)
    plan = choose_plan(cube, axes="band, y, x", size=40_000, threads=1)
    assert plan.levels[-1].clusters == (1, 64)
    assert plan.organisation == (("band",), ("y", "x"))


def test_clusters_of_peaky_data_are_found_for_an_snr_that_bytes_hardly_do() -> None:
    """Without them it takes 134 KB, whatever the blocks: highlights have few rows in common."""
    model = compress(highlights(16, 8, 256), axes="light, view, texel, rgb", snr=50.0, threads=1)
    assert model.snr >= 50
    assert model.nbytes < 60_000
