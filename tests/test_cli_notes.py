"""Sentences on stderr about what figures do not tell, each with what to do next."""

from __future__ import annotations

import re
import warnings
from math import floor
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

import hmkcta
from cli_tools import report, run, saved, smooth
from hmkcta.cli.compress import unused
from hmkcta.cli.goal import Goal


@pytest.mark.parametrize(("array", "sentence"), [
    (np.sin(np.arange(2000) / 9), "make windows of a signal"),
    (1e6 + smooth(12, 14, 16), "subtract the mean first"),
    (smooth(3, 4, 5), "no smaller than its source of 240 bytes"),
    (np.ones((1, 1)), "no smaller than its source of 8 bytes"),
    (np.arange(3.0), "no smaller than its source of 24 bytes"),
    (np.where(np.arange(6720).reshape(12, 20, 28) % 3000 == 7, 9e4, smooth(12, 20, 28)), "--transform asinh:"),
    (smooth(20, 24, 28), None),
    (np.maximum(smooth(20, 24, 28) - smooth(20, 24, 28).max() * 0.9, 0) + 1e-13 * smooth(20, 24, 28), None),
], ids=["vector", "offset", "tiny", "one number", "three numbers", "outliers", "none", "as good as zeros"])
def test_what_figures_do_not_tell_is_said(array: NDArray[Any], sentence: str | None, tmp_path: Path) -> None:
    path, words = saved(tmp_path / "a.npy", array), ("--quality", "fast", "--overwrite")
    result = run("compress", path, "-o", tmp_path / "a.hmk", *words)
    assert result.stderr.count("hmkcta: ") == (sentence is not None)
    assert sentence is None or sentence in result.stderr
    assert run("compress", path, "-o", tmp_path / "a.hmk", *words, "--quiet").stderr == ""
    assert len(report("compress", path, "-o", tmp_path / "a.hmk", *words)["notes"]) == (sentence is not None)


@pytest.mark.parametrize(("dtype", "step", "is_said"), [
    ("uint8", 1, False), ("uint16", 1, False), ("uint16", 100, True), ("float32", 1, False), ("float32", 0.5, True),
])
def test_noise_of_whole_numbers_is_not_said_to_be_lost(dtype: str, step: float, is_said: bool, tmp_path: Path) -> None:
    """A transform that gives it more weight makes a file of noise."""
    noise = np.random.default_rng(0).integers(0, 4, (12, 20, 28)) * step
    noise[:, 5:8, 5:10] += 200 * step
    path = saved(tmp_path / "a.npy", noise.astype(dtype))
    said = run("compress", path, "-o", tmp_path / "a.hmk", "--plan", "R=1,2,2").stderr
    assert ("--transform asinh:" in said) == is_said


@pytest.mark.parametrize(("values", "plan", "is_said"), [
    (np.random.default_rng(0).integers(0, 5, (12, 14, 16), np.uint8), "R=2", True),
    (np.random.default_rng(0).random((12, 14, 16)) < 0.3, "R=2", True),
    (np.random.default_rng(0).integers(0, 50, (12, 14, 16)), "R=2", False),
    (np.random.default_rng(0).integers(0, 5, (12, 14, 16)).astype(float), "R=2", False),
    (np.add.outer(np.arange(5), np.arange(8)), "R=2", False),  # rounded, all of them are right
    (np.zeros((12, 14, 16), bool), "R=2", False),
], ids=["labels", "mask", "counts", "floats", "right ones", "zeros"])
def test_labels_are_said_to_be_better_kept_losslessly(
    values: NDArray[Any], plan: str, is_said: bool, tmp_path: Path
) -> None:
    path = saved(tmp_path / "a.npy", values)
    said = run("compress", path, "-o", tmp_path / "a.hmk", "--plan", plan).stderr
    assert ("different values, all whole: if they are labels or a mask" in said) == is_said


def test_directions_that_are_missing_are_asked_for(tmp_path: Path) -> None:
    path, words = saved(tmp_path / "a.npy", smooth(6, 5, 8, 10)), ("--plan", "R=2", "--overwrite")
    axes, given = ("--axes", "light,view,y,x"), list[str]()
    for name, count in (("light", 6), ("view", 5)):
        said = run("compress", path, "-o", tmp_path / "a.hmk", *words, *axes, *given).stderr
        assert "render and view will assume a spiral" in said
        assert f"--coords {name}=FILE" in said
        given += ["--coords", f"{name}={saved(tmp_path / f'{name}.npy', np.ones((count, 3)))}"]
    assert "spiral" not in run("compress", path, "-o", tmp_path / "a.hmk", *words, *axes, *given).stderr
    assert "spiral" not in run("compress", path, "-o", tmp_path / "a.hmk", *words, "--axes", "t,view,y,x").stderr


@pytest.mark.parametrize(("words", "advised"), [
    (("--axes", "u,v,y,x"), "u:view,v:view,y,x"), (("--axes", "V,U,y,x"), "V:view,U:view,y,x"),
    (("--axes", "u:space,v,y,x"), None), (("--axes", "u:view,v:view,y,x"), None),
    (("--axes", "u,v,y,x", "--kind", "volume"), None), (("--axes", "y,x,v,u"), None),
    (("--axes", "light,u,v,w"), None), ((), None),
])
def test_cameras_that_are_read_as_space_are_told(words: tuple[str, ...], advised: str | None, tmp_path: Path) -> None:
    path = saved(tmp_path / "a.npy", smooth(6, 5, 8, 10))
    for said in (run("compress", path, "-o", tmp_path / "a.hmk", "--plan", "R=2", *words).stderr,
                 run("plan", path, "--plan", "R=2", *words).stderr):
        assert ("not as cameras" in said) == (advised is not None)
        assert advised is None or f"Next: for a light field write --axes {advised}.\n" in said


@pytest.mark.parametrize(("words", "sentence"), [
    (("--size", "60KB"), "numbers are decoded in float16"), (("--size", "4000"), None),
    (("--size", "60KB", "--plan", "R=2"), None),
], ids=["numbers", "none", "written plan"])
def test_what_keeps_a_file_from_its_size_is_said(words: tuple[str, ...], sentence: str | None, tmp_path: Path) -> None:
    path = saved(tmp_path / "a.npy", smooth(16, 20, 24) + 0.1 * np.random.default_rng(0).random((16, 20, 24)))
    result = run("compress", path, "-o", tmp_path / "a.hmk", "--axes", "z,y,x", "--quality", "fast", *words)
    assert (" % are used" in result.stderr) == (sentence is not None)
    assert (sentence or "") in result.stderr


@pytest.mark.parametrize(("share", "snr", "plan", "said"), [
    (0.995, 40.0, None, None), (0.9, 40.0, None, "of --size 90 % are used: that is the closest"),
    (0.9, 70.0, None, "of --size 90 % are used: numbers are decoded in float16"), (0.9, 40.0, "R=2", None),
    (0.1, np.inf, None, None),
])
def test_a_size_counts_as_used_from_99_percent_on(share: float, snr: float, plan: str | None, said: str | None) -> None:
    found = SimpleNamespace(nbytes=round(share * 100_000), snr=snr)
    goal = Goal(None, 100_000, None, {}, {}, {})
    sentences = unused(cast("hmkcta.Model", found), goal, plan)
    assert len(sentences) == (said is not None)
    assert said is None or sentences[0].startswith(said)


@pytest.mark.parametrize("name", ["channel", "variable"])
def test_channels_that_are_lost_beside_louder_ones_are_named(name: str, tmp_path: Path) -> None:
    """As a pressure beside velocities, whatever their axis is called; not where each keeps its share, nor of what is
    constant."""
    loud, quiet = smooth(20, 24, 12), 0.001 * np.random.default_rng(0).random((20, 24, 12))
    values = np.stack([100 * loud, quiet, np.zeros_like(loud), 0.01 * loud], axis=-1)
    words = ("--axes", f"z,y,x,{name}", "--plan", "R=6,6,6,1")
    said = run("compress", saved(tmp_path / "a.npy", values), "-o", tmp_path / "a.hmk", *words).stderr
    assert f"along {name} the file holds little of index 1 (RMSE 0.000" in said
    assert said.count("values 0.00029 around their mean), as others of larger values make the SNR. Next: divide") == 1
    even = saved(tmp_path / "b.npy", np.stack([loud, 2 * loud, 3 * loud], axis=-1))
    assert "of larger values" not in run("compress", even, "-o", tmp_path / "b.hmk", *words).stderr


def test_an_offset_that_hides_what_varies_is_warned_of_once(tmp_path: Path) -> None:
    values = 101325 + 5 * np.random.default_rng(0).standard_normal((12, 14, 16))
    with pytest.warns(UserWarning, match=r"are 101325 give or take 4\.9.*subtract the mean first") as told:
        hmkcta.compress(values, snr=40, quality="fast")
    assert [warning.filename for warning in told] == [__file__]
    path = saved(tmp_path / "a.npy", values)
    words = ("--snr", "40", "--quality", "fast")
    assert run("compress", path, "-o", tmp_path / "a.hmk", *words).stderr.count("give or take") == 1
    with warnings.catch_warnings():  # of an offset alone, and of what varies enough, there is nothing to say
        warnings.simplefilter("error")
        hmkcta.compress(np.full((12, 14, 15), 101325.1), snr=40, quality="fast")
        hmkcta.compress(values - 101225, snr=50, quality="fast")


def test_worse_than_zeros_is_said_to_be(tmp_path: Path) -> None:
    """A transform of a scale far below the values leaves next to nothing of them."""
    values = (np.random.default_rng(0).random((20, 24, 28)) < 0.9).astype(float)
    with pytest.warns(UserWarning, match=r"an SNR of -\d.*no better than zeros alone. Next: another transform") as told:
        hmkcta.compress(values, "R=4", transform="asinh:1e-30", quality="fast")
    assert [warning.filename for warning in told] == [__file__]
    path = saved(tmp_path / "a.npy", values)
    words = ("--transform", "asinh:1e-30", "--plan", "R=4", "--quality", "fast")
    result = run("compress", path, "-o", tmp_path / "a.hmk", *words)
    assert result.stderr.count("no better than zeros alone. Next: another transform") == 1


def test_a_size_beyond_what_is_of_use_is_said_to_be(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.npy", smooth(16, 20, 24))
    result = run("compress", path, "-o", tmp_path / "a.hmk", "--size", "40KB", "--quality", "fast")
    found = re.search(r"of --size (\d+) % are used: numbers are decoded in float16", result.stderr)
    assert found is not None
    assert int(found[1]) == round((tmp_path / "a.hmk").stat().st_size / 400)


def test_nothing_is_said_of_a_size_where_no_error_is_left(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.npy", np.zeros((20, 30, 40)))
    assert run("compress", path, "-o", tmp_path / "a.hmk", "--size", "5KB").stderr == ""


def test_a_plan_beyond_the_decode_cost_is_said_to_be(tmp_path: Path) -> None:
    path, words = saved(tmp_path / "a.npy", smooth(16, 20, 24)), ("--quality", "fast", "--overwrite", "--plan", "R=4")
    result = run("compress", path, "-o", tmp_path / "a.hmk", *words, "--decode-cost", "10")
    assert "takes 64 multiply-adds, more than --decode-cost 10, which bounds what a goal chooses" in result.stderr
    assert run("compress", path, "-o", tmp_path / "a.hmk", *words, "--decode-cost", "64").stderr == ""


def test_a_coarse_model_keeps_the_snr_of_transformed_values(tmp_path: Path) -> None:
    model = hmkcta.compress(smooth(6, 8, 4), "R=1 / R=1", transform="sqrt")
    model.at_level(1).save(tmp_path / "a.hmk")
    assert "SNR of sqrt" in run("info", tmp_path / "a.hmk").stdout


def test_advice_fits_what_was_asked(tmp_path: Path) -> None:
    source = saved(tmp_path / "a.npy", smooth(6, 8, 10))
    text = run("compress", source, "-o", tmp_path / "a.hmk", "--plan", "R=1", "--snr", 60, code=7).stderr
    assert "add ranks or a level" in text
    text = run("compress", source, "-o", tmp_path / "b.hmk", "--snr", 200, "--quality", "fast", code=7).stderr
    reached = floor(hmkcta.open(tmp_path / "b.hmk").snr)
    assert reached > 65
    assert f"ask for up to {reached} dB: a search makes two levels" in text
    words = ("--plan", "R=6,8,10", "--snr", 100)
    assert '--plan "R=.. / R=.."' in run("compress", source, "-o", tmp_path / "d.hmk", *words, code=7).stderr
    words = ("--plan", "R=6,8,10 / R=6,8,10", "--snr", 200)
    assert "decoded in float32" in run("compress", source, "-o", tmp_path / "e.hmk", *words, code=7).stderr
