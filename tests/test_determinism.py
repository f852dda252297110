"""One seed makes one file, whatever the number of threads; sizes that are told are those on disk."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import Any, cast

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits  # pyright: ignore[reportMissingTypeStubs] (it has none)

from fit_tools import file_of
from hmkcta import Model, compress
from hmkcta import open as open_model
from hmkcta.synthetic import light_field, material

DATA = material(lights=4, views=6, size=24, seed=2)
LAYERS = light_field(views=3, size=24, frames=3, seed=2)
HMK = "R=3,2,4,4 / R=2,1,2,2 C=3,2,2,2 K=2 / R=1 C=2,1,2,2 K=2"

#: Fits of every kind: flat, levels with each search and scheme, blocks, goals.
CASES: dict[str, dict[str, Any]] = {
    "hosvd": {"plan": "R=4,2,5,5"},
    "levels": {"plan": HMK, "quality": "fast"},
    "levels, scheme chosen": {"plan": HMK, "scheme": "auto", "quality": "fast"},
    "many clusters": {"plan": "R=1 C=12,1,12,12 K=2,1,2,2", "quality": "fast"},
    "greedy": {"plan": "R=1 C=9,1,1,2 K=4,1,1,1", "quality": "fast"},
    "blocks": {"plan": "R=3 grid=y:2,x:2"},
    "blocks, snr": {"plan": "R=1 grid=y:2,x:2 / R=4 / R=8", "snr": 20.0},
    "clusters": {"plan": "R=2 C=2,1,3,1"},
    "size": {"size": 20000, "quality": "fast"},
}


def fitted(**options: Any) -> Model:
    return compress(DATA.values, axes=DATA.axes, organisation="light+rgb, view, y, x", **options)


@pytest.mark.parametrize("name", CASES)
def test_the_same_seed_makes_the_same_file(name: str, tmp_path: Path) -> None:
    options = CASES[name]
    once = file_of(fitted(seed=7, threads=1, **options), tmp_path)
    assert file_of(fitted(seed=7, threads=2, **options), tmp_path) == once
    if name == "levels":
        assert file_of(fitted(seed=7, threads=1, **options), tmp_path) == once


@pytest.mark.parametrize("goal", [{"snr": 25.0}, {"size": 16000}], ids=["snr", "size"])
def test_a_chosen_plan_does_not_depend_on_threads(goal: dict[str, Any], tmp_path: Path) -> None:
    options: dict[str, Any] = {"axes": LAYERS.axes, "seed": 3, **goal}
    files = [file_of(compress(LAYERS.values, threads=threads, **options), tmp_path) for threads in (1, 2)]
    assert files[0] == files[1]


def test_the_layout_and_byte_order_of_the_source_do_not_matter(tmp_path: Path) -> None:
    """The same values make the same numbers and figures."""
    reference = file_of(compress(DATA.values, "R=3,1,2,2,2 / R=1 C=2,1,2,2,1", axes=DATA.axes, threads=1), tmp_path)
    for array in (np.asfortranarray(DATA.values), DATA.values.astype(">f4"), DATA.values[:, ::-1][:, ::-1]):
        model = compress(array, "R=3,1,2,2,2 / R=1 C=2,1,2,2,1", axes=DATA.axes, threads=1)
        assert file_of(model, tmp_path) == reference


def test_another_seed_is_another_try() -> None:
    """Seeds are recorded, and they are used."""
    models = [fitted(plan=HMK, seed=seed, threads=1, quality="fast") for seed in range(3)]
    assert [model.metadata.seed for model in models] == [0, 1, 2]
    assert len({model.snr for model in models}) > 1
    assert max(model.snr for model in models) - min(model.snr for model in models) < 3


@pytest.mark.parametrize("name", CASES)
def test_the_file_is_as_large_as_the_model_says(name: str, tmp_path: Path) -> None:
    model = fitted(threads=1, **CASES[name])
    for level in range(1, len(model.levels) + 1):
        coarse = model.at_level(level)
        path = tmp_path / f"{level}.hmk"
        coarse.save(path)
        assert path.stat().st_size == coarse.nbytes
        back = open_model(path)
        assert back.nbytes == coarse.nbytes
        assert np.array_equal(np.asarray(back), np.asarray(coarse))


def blas_threads() -> set[int]:
    libraries = cast("list[dict[str, Any]]", threadpool_info())
    return {library["num_threads"] for library in libraries if library["user_api"] == "blas"}


def test_calls_that_overlap_leave_blas_as_it_was() -> None:
    """Its number of threads is the process's: it is one for as long as any call fits, and then what it was."""
    begun, ended = Event(), Event()
    inside: list[set[int]] = []
    second: list[Future[Model]] = []

    def later(*_: object) -> None:
        begun.set()
        assert ended.wait(60)
        inside.append(blas_threads())

    with threadpool_limits(2, "blas"), ThreadPoolExecutor(1) as pool:
        before = blas_threads()

        def earlier(*_: object) -> None:
            second[:] = second or [pool.submit(fitted, plan="R=1", progress=later)]
            assert begun.wait(60)

        fitted(plan="R=1", progress=earlier)
        ended.set()
        second[0].result()
        assert (inside[0], blas_threads()) == ({1}, before)


def test_what_blas_flags_is_not_warned_of() -> None:
    """OpenBLAS computes on what lies beside a small matrix, too, and with that anything is flagged as invalid."""
    inside: list[str] = []

    def told(*_: object) -> None:
        inside.append(np.geterr()["invalid"])

    with np.errstate(invalid="warn"):
        fitted(plan="R=1", progress=told)
        assert (set(inside), np.geterr()["invalid"]) == ({"ignore"}, "warn")
