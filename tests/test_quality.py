"""How good fits are: relations between subdivisions and efforts, least SNRs at a size for synthetic and real data."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hmkcta import Model, compress
from hmkcta.fitting.fit import EFFORTS
from hmkcta.fitting.hierarchy import backfit, descend, fit_nodes, whole
from hmkcta.fitting.run import Run
from hmkcta.plan import parse_plan
from hmkcta.synthetic import light_field, material, volume
from real_data import real_data

#: Like WH4 of the paper's table 2: HOSVD, then two levels of clusters, for a tensor 24 x 12 x 48 x 48.
WH4_LIKE = "R=4,4,6,6 / R=2,2,3,3 C=3,2,3,3 K=2 / R=1,1,2,2 C=2 K=2"
PAPERS_MODES = "light+rgb, view, y, x"


@cache
def wh4_like(scheme: str, quality: str, *, shuffled: bool, seed: int = 0) -> Model:
    """Of a material; shuffled: in an order of texels and directions that tells nothing."""
    data = material(lights=8, views=12, size=48)
    values = data.values
    if shuffled:
        rng = np.random.default_rng(1)
        values = values[np.ix_(*(rng.permutation(size) for size in values.shape[:4]))]
    settings: dict[str, Any] = {"organisation": PAPERS_MODES, "scheme": scheme, "quality": quality, "seed": seed}
    return compress(values, WH4_LIKE, axes=data.names, threads=1, **settings)


def mean_snr(scheme: str, *, shuffled: bool) -> float:
    """Of fast fits from five starts, each of which ends half a decibel higher or lower."""
    return float(np.mean([wh4_like(scheme, "fast", shuffled=shuffled, seed=seed).snr for seed in range(5)]))


def test_most_significant_beats_least_significant() -> None:
    """The paper's order of WH4 and WH5, at the same bytes."""
    most, least = (wh4_like(scheme, "fast", shuffled=False) for scheme in ("most", "least"))
    assert abs(most.nbytes - least.nbytes) < 200
    assert mean_snr("most", shuffled=False) > mean_snr("least", shuffled=False) + 0.2


def test_most_significant_is_best_where_order_tells_nothing() -> None:
    """The paper's order of WH4, WH5 and WH6."""
    most, least, uniform = (mean_snr(scheme, shuffled=True) for scheme in ("most", "least", "uniform"))
    assert most > least + 0.3
    assert most > uniform + 0.2


@pytest.mark.parametrize("shuffled", [False, True])
def test_the_automatic_scheme_is_the_best_one(shuffled: bool) -> None:
    best = max(wh4_like(scheme, "fast", shuffled=shuffled).snr for scheme in ("most", "least", "uniform"))
    assert wh4_like("auto", "fast", shuffled=shuffled).snr >= best - 0.05


def test_every_level_adds_several_db() -> None:
    """The paper's levels of WH4 are at 7.31, 16.26 and 27.04 dB."""
    steps = [quality.snr_db for quality in wh4_like("most", "fast", shuffled=False).quality]
    assert steps[0] > 10
    assert steps[1] > steps[0] + 4
    assert steps[2] > steps[1] + 3


def test_more_effort_is_better() -> None:
    data = light_field(views=3, size=32, frames=4)

    def fitted(quality: str) -> Model:
        plan = "R=2,2,4,4,* / R=1,1,2,2,* C=2,2,3,3,1 K=2 / R=1,1,1,1,* C=1,1,2,2,1 K=2"
        return compress(data.values, plan, axes=data.axes, scheme="most", quality=quality, threads=1)

    fast, medium, thorough = (fitted(quality) for quality in ("fast", "medium", "thorough"))
    assert abs(fast.nbytes - thorough.nbytes) < 0.02 * fast.nbytes
    assert thorough.snr >= medium.snr >= fast.snr - 0.1
    assert thorough.snr > fast.snr + 0.3


@pytest.mark.parametrize("text", ["R=3,2,4 / R=2,1,2 C=3,2,2 K=2 / R=1 C=2 K=2", "R=2,*,2 C=3,1,3 K=2 / R=1,*,1"])
def test_back_fitting_never_lowers_the_snr(text: str) -> None:
    """Round by round, on what is stored; the residual stays what the levels leave."""
    tensor = np.ascontiguousarray(volume((12, 24, 20), frames=1).values[0])
    plan = parse_plan(text, (("z",), ("y",), ("x",)))
    run = Run(EFFORTS["fast"], 0, 1, lambda _stage, _fraction: None)
    tree = whole(tensor.copy())
    for number, spec in enumerate(plan.levels):
        if number:
            descend(tree, "most", run)
        fit_nodes(tree, [spec] * len(tree.levels[-1]), run)
    errors = [tree.error]
    for _ in range(5):
        backfit(tree, run)
        errors.append(tree.error)
    assert all(after <= before for before, after in pairwise(errors))
    assert errors[-1] < 0.95 * errors[0]


def test_a_level_that_others_follow_is_fitted_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    """What it leaves they have to make up for; a large tensor's, that is, as small ones are fitted longer anyway."""
    monkeypatch.setattr("hmkcta.fitting.fit.MOST", 1)
    data = volume((16, 28, 28), frames=6)
    level = "R=2 C=1,3,3,3 K=1,2,2,2"

    def first(plan: str) -> float:
        model = compress(data.values, plan, axes=data.axes, scheme="most", quality="fast", threads=1)
        return model.at_level(1).snr

    assert first(f"{level} / R=1 C=1,2,2,2 K=1,2,2,2") > first(level) + 0.3


def test_efforts_are_ordered() -> None:
    for name in ("candidates", "sweeps", "hooi", "backfits"):
        values = [int(getattr(effort, name)) for effort in (EFFORTS["fast"], EFFORTS["medium"], EFFORTS["thorough"])]
        assert sorted(values) == values


# Least SNRs, some 0.3 dB below what was reached when they were written


SYNTHETIC: list[tuple[str, Any, int, float]] = [
    ("material", lambda: material(lights=6, views=6, size=32), 20000, 40.7),
    ("volume", lambda: volume((16, 28, 28), frames=6), 24000, 36.9),
    ("light field", lambda: light_field(views=4, size=32, frames=4), 20000, 36.9),
]


@pytest.mark.parametrize(("name", "make", "size", "least"), SYNTHETIC, ids=[row[0] for row in SYNTHETIC])
def test_snr_at_a_size(name: str, make: Any, size: int, least: float) -> None:
    data = make()
    model = compress(data.values, axes=data.axes, size=size, threads=1)
    assert model.nbytes <= size
    assert model.snr >= least, name


EXPLICIT = [
    ("WH4-like", WH4_LIKE, 214_500, 23.8),
    ("flat", "R=2,2,3,3 C=4,3,4,4 K=2", 93_000, 22.5),
    ("pca of texels", "R=6 grid=y:4,x:4", 95_000, 34.6),
]


@pytest.mark.parametrize(("name", "plan", "size", "least"), EXPLICIT, ids=[row[0] for row in EXPLICIT])
def test_snr_of_an_explicit_plan(name: str, plan: str, size: int, least: float) -> None:
    data = material(lights=8, views=12, size=48)
    modes = "light+rgb+view, y+x" if "grid" in plan else PAPERS_MODES
    model = compress(data.values, plan, axes=data.axes, organisation=modes, scheme="most", quality="fast", threads=1)
    assert model.nbytes <= size
    assert model.snr >= least, name


#: Real data at 1/100 of their float32 bytes and 8 KiB. The icon and the light field reach 31.8 and 20.1 dB; they are
#: left out for time.
SETS = [
    ("fmri_volume", ("time", "z", "y", "x"), 34.0),
    ("viscous_fingers_volume", ("time", "z", "y", "x"), 41.5),
]


@pytest.mark.parametrize(("name", "axes", "least"), SETS, ids=[row[0] for row in SETS])
def test_real_data_at_a_hundredth_of_their_bytes(name: str, axes: tuple[str, ...], least: float) -> None:
    with np.load(real_data(f"{name}.npz")) as archive:
        values = archive["values"]
    size = 4 * values.size // 100 + 8192
    model = compress(values, axes=axes, size=size)
    assert model.nbytes <= size
    assert model.snr >= least
