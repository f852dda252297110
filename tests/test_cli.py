"""The command line does what it says, for people and for programs."""

from __future__ import annotations

import io
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any
from warnings import warn

import click
import numpy as np
import pytest

import hmkcta
from cli_tools import finish, refused, report, run, saved, smooth, start
from hmkcta import synthetic
from hmkcta.cli import main
from hmkcta.cli import progress as progress_module
from hmkcta.cli.app import SUMMARIES
from hmkcta.cli.progress import Progress

PLAN = "R=2,2,3 / R=1,1,2 C=2 K=2"


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small array."""
    return saved(tmp_path_factory.mktemp("source") / "wood.npy", smooth(6, 8, 10))


@pytest.fixture(scope="module")
def field(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An array for the search: smooth values with a little noise."""
    noise = np.random.default_rng(0).standard_normal((12, 24, 24))
    return saved(tmp_path_factory.mktemp("field") / "field.npy", smooth(12, 24, 24) + 0.05 * noise)


@pytest.fixture(scope="module")
def packed(source: Path) -> Path:
    """It compressed by two levels."""
    path = source.with_suffix(".hmk")
    run("compress", source, "-o", path, "--plan", PLAN, "--axes", "view,y,x", "--seed", 7, "--quiet")
    return path


def test_compress_ends_with_a_table(source: Path, tmp_path: Path) -> None:
    result = run("compress", source, "-o", tmp_path / "a.hmk", "--plan", PLAN)
    header, first, second = result.stdout.splitlines()[:3]
    assert re.split("  +", header) == ["level", "SNR dB", "MiB", "ratio", "decode cost", "seconds"]
    assert (first.split()[0], second.split()[0]) == ("1", "2")
    assert hmkcta.open(tmp_path / "a.hmk").shape == (6, 8, 10)


def test_compress_for_programs(source: Path, tmp_path: Path) -> None:
    found = report("compress", source, "-o", tmp_path / "a.hmk", "--plan", PLAN)
    model = hmkcta.open(tmp_path / "a.hmk")
    assert found["bytes"] == (tmp_path / "a.hmk").stat().st_size == model.nbytes
    assert found["snr_db"] == pytest.approx(model.snr)
    assert [level["decode_cost"] for level in found["levels"]] == [12, 12 + 2 * 2 * 2 * 2]
    parts = ("bytes", "bytes_upto")
    assert [[level[part] for part in parts] for level in found["levels"]] == [
        [level[part] for part in parts] for level in report("info", tmp_path / "a.hmk")["levels"]
    ]
    assert found["reached"]


def test_one_seed_makes_one_file(source: Path, packed: Path, tmp_path: Path) -> None:
    run("compress", source, "-o", tmp_path / "a.hmk", "--plan", PLAN, "--axes", "view,y,x", "--seed", 7, "--quiet")
    assert (tmp_path / "a.hmk").read_bytes() == packed.read_bytes()


def test_quiet_says_nothing(source: Path, tmp_path: Path) -> None:
    assert run("compress", source, "-o", tmp_path / "a.hmk", "--plan", "R=1", "--quiet").output == ""


def test_verbose_says_where_the_time_went(source: Path, tmp_path: Path) -> None:
    assert "level 1" in run("compress", source, "-o", tmp_path / "a.hmk", "--plan", "R=1", "-v").stderr


def test_goals_are_met(tmp_path: Path) -> None:
    source = saved(tmp_path / "a.npy", smooth(12, 24, 24))
    found = report("compress", source, "-o", tmp_path / "a.hmk", "--snr", 40, "--quality", "fast")
    assert found["snr_db"] >= 40
    found = report("compress", source, "-o", tmp_path / "b.hmk", "--size", "12KiB", "--quality", "fast")
    assert found["bytes"] <= 12 * 1024


@pytest.mark.parametrize("suffix", ["npz", "raw"])
def test_other_inputs(suffix: str, tmp_path: Path) -> None:
    values = smooth(4, 5, 6)
    np.savez(tmp_path / "a.npz", one=values, two=2 * values)
    (tmp_path / "a.raw").write_bytes(b"head" + values.astype(">f4").tobytes("F"))
    words = {"npz": [f"{tmp_path}/a.npz:one"],
             "raw": [tmp_path / "a.raw", "--shape", "4,5,6", "--dtype", ">f4", "--order", "F", "--offset", 4]}[suffix]
    run("compress", *words, "-o", tmp_path / "a.hmk", "--plan", "R=4,5,6")
    np.testing.assert_allclose(hmkcta.open(tmp_path / "a.hmk"), values, rtol=0.01)


def test_info_names_everything(packed: Path) -> None:
    text = run("info", packed).stdout
    for part in ("view 6 (view), y 8 (space), x 10 (space)", "view, y, x", "identity", "seed 7", "lightfield",
                 "float32", f"hmkcta {hmkcta.__version__}", "multiply-adds", "levels", "header"):
        assert part in text
    found = report("info", packed)
    assert found["bytes"]["file"] == packed.stat().st_size
    assert found["bytes"]["file"] == found["bytes"]["levels"] + found["bytes"]["header"]
    assert found["bytes"]["levels"] == sum(level["bytes"] for level in found["levels"])
    numbers = [level.numbers() for level in hmkcta.open(packed).levels]
    assert all(level["bytes"] > 2 * count for level, count in zip(found["levels"], numbers, strict=True))
    assert [level["nodes"] for level in found["levels"]] == [1, 1]
    assert found["levels"][-1]["bytes_upto"] == found["bytes"]["file"]
    assert found["levels"][1]["C"] == [2, 2, 2]
    assert found["levels"][1]["clusters"] == 8


def test_info_counts_what_carries_nothing(tmp_path: Path) -> None:
    source = saved(tmp_path / "a.npy", np.zeros((4, 6), np.float32))
    run("compress", source, "-o", tmp_path / "a.hmk", "--plan", "R=1", "--quiet")
    level = report("info", tmp_path / "a.hmk")["levels"][0]
    assert level["nodes_that_carry_nothing"] == 1 or level["clusters_that_carry_nothing"] == level["clusters"]
    assert "exact" in run("info", tmp_path / "a.hmk").stdout


def test_transform_is_shown(tmp_path: Path) -> None:
    source = saved(tmp_path / "a.npy", smooth(6, 8, 4))
    words = ("compress", source, "-o", tmp_path / "a.hmk", "--plan", "R=2", "--transform", "log1p:0.5", "--overwrite")
    assert "SNR dB  SNR of log1p" in run(*words).stdout
    made = report(*words)["levels"][0]
    text = run("info", tmp_path / "a.hmk").stdout
    assert "log1p, scale 0.5" in text
    assert "SNR dB  SNR of log1p" in text
    level = report("info", tmp_path / "a.hmk")["levels"][0]
    assert (made["snr_db"], made["transformed_snr_db"]) == (level["snr_db"], level["transformed_snr_db"])
    values, decoded = np.load(source).astype(float), np.asarray(hmkcta.open(tmp_path / "a.hmk"), float)
    for key, before, after in (("snr_db", values, decoded),
                               ("transformed_snr_db", np.log1p(2 * values), np.log1p(2 * decoded))):
        assert level[key] == pytest.approx(10 * np.log10(np.sum(before**2) / np.sum((before - after) ** 2)), abs=1e-3)
        assert f" {level[key]:.2f} " in text
    found = report("verify", tmp_path / "a.hmk", "--against", source)["levels"][0]
    assert found["transformed_snr_db"] == pytest.approx(level["transformed_snr_db"], abs=1e-5)
    shown = run("verify", tmp_path / "a.hmk", "--against", source).stdout
    assert "SNR of log1p" in shown
    assert f" {level['transformed_snr_db']:.2f} " in shown


def test_an_undecomposed_mode_is_shown_as_a_plan_has_it(tmp_path: Path) -> None:
    hmkcta.compress(smooth(6, 8), "R=*,2").save(tmp_path / "a.hmk")
    assert "\n      1  *,2  1,1  1,1 " in run("info", tmp_path / "a.hmk").stdout
    assert report("info", tmp_path / "a.hmk")["levels"][0]["R"] == [6, 2]


@pytest.mark.parametrize(("told", "shown"), [
    ([None], "exact"), ("much", None), ([1, 2], None), (["x"], None), ({"a": 1}, None), ([20], "20.00"),
])
def test_what_a_file_says_of_its_source_may_be_anything(told: object, shown: str | None, tmp_path: Path) -> None:
    model = hmkcta.compress(smooth(6, 8), "R=2", transform="sqrt")
    metadata = replace(model.metadata, source={"transformed_snr_db": told})
    hmkcta.Model(metadata, model.levels).save(tmp_path / "a.hmk")
    text = run("info", tmp_path / "a.hmk", "-v").stdout
    assert ("SNR of sqrt" in text) == (shown is not None)
    assert (shown or "") in text


def test_what_numpy_makes_of_flags_is_not_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenBLAS may set one for what lies beside its operands."""

    def flagged(*given: Any, **options: Any) -> hmkcta.Model:
        np.subtract(np.float32(np.inf), np.float32(np.inf))
        warn("This is said", stacklevel=1)
        return hmkcta.compress(*given, **options)

    monkeypatch.setattr("hmkcta.cli.compress.compress", flagged)
    path = saved(tmp_path / "a.npy", smooth(8, 9))
    assert report("compress", path, "-o", tmp_path / "a.hmk", "--plan", "R=1")["notes"][0] == "This is said"


def test_a_plan_larger_than_its_source_is_not_blamed_on_the_header(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.npy", (smooth(20, 24, 28) * 50).astype(np.uint8))
    text = run("compress", path, "-o", tmp_path / "a.hmk", "--plan", "R=20,24,28").stderr
    assert "smaller R or K" in text


def test_directions_come_with_the_array(tmp_path: Path) -> None:
    """As `compress` from Python does it with `Axis`, and as `plan` writes them down."""
    source, out = saved(tmp_path / "a.npy", smooth(30, 6, 7)), tmp_path / "a.hmk"
    angles = np.stack([np.linspace(0, 80, 30), np.linspace(0, 350, 30)], 1)
    np.savetxt(tmp_path / "lights.csv", angles, delimiter=",", header="zenith,azimuth")
    np.savez(tmp_path / "places.npz", y=np.arange(6) / 2, other=np.ones(3))
    words = ("--axes", "light,y,x", "--coords", f"light={tmp_path / 'lights.csv'}", "--unit", "light=degrees",
             "--coords", f"y={tmp_path / 'places.npz'}:y", "--plan", "R=2")
    predicted = report("plan", source, *words, "--kind", "generic")
    run("compress", source, "-o", out, *words, "--kind", "generic")
    assert predicted["estimated_bytes"] == pytest.approx(out.stat().st_size, rel=0.15)
    again = shlex.split(predicted["command"])
    again[again.index("OUT.hmk")] = str(tmp_path / "b.hmk")
    run(*again[1:], "--quiet")
    assert (tmp_path / "b.hmk").read_bytes() == out.read_bytes()
    light, y, x = hmkcta.open(out).metadata.axes
    assert (light.unit, y.unit, x.coords) == ("degrees", "", None)
    np.testing.assert_array_equal(np.asarray(light.coords), angles)
    np.testing.assert_array_equal(np.asarray(y.coords), np.arange(6) / 2)
    assert "light 30 (light, coordinates in degrees), y 6 (space, coordinates), x 7 (space)" in run("info", out).stdout


def test_one_multiply_add_is_one(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.npy", smooth(6, 8))
    assert "1 multiply-add an element" in run("compress", path, "-o", tmp_path / "a.hmk", "--plan", "R=1").stdout
    assert "1 multiply-add an element" in run("info", tmp_path / "a.hmk").stdout
    assert "up to 1 multiply-add an element" in run("plan", path, "--plan", "R=1").stdout


def test_verify_measures_again(source: Path, packed: Path) -> None:
    found = report("verify", packed, "--against", source)
    assert [level["transformed_snr_db"] for level in found["levels"]] == [None] * len(found["levels"])
    for level, quality in zip(found["levels"], hmkcta.open(packed).quality, strict=True):
        assert level["snr_db"] == pytest.approx(quality.snr_db, abs=1e-6)
        assert level["max_abs_error"] == pytest.approx(quality.max_abs_error)
    assert run("verify", packed).stdout.endswith("as they should be.\n")
    assert run("verify", packed, "--against", source).stdout.splitlines()[1].split()[:2] == ["level", "SNR"]


def test_decompress(packed: Path, tmp_path: Path) -> None:
    model = hmkcta.open(packed)
    run("decompress", packed, "-o", tmp_path / "a.npy")
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), model.reconstruct())
    assert "6,8,10 float32" in run("decompress", packed, "-o", tmp_path / "a.raw").stdout
    np.testing.assert_array_equal(np.fromfile(tmp_path / "a.raw", "<f4").reshape(6, 8, 10), model.reconstruct())
    run("decompress", packed, "-o", tmp_path / "coarse.npy", "--level", 1, "--max-memory", "1KiB", code=6)
    run("decompress", packed, "-o", tmp_path / "coarse.npy", "--level", 1)
    np.testing.assert_allclose(np.load(tmp_path / "coarse.npy"), model.at_level(1).reconstruct(), rtol=1e-5)


@pytest.mark.parametrize("kind", ["uint8", "int64", "float16", "bool"])
def test_decompress_into_the_sources_type(tmp_path: Path, kind: str) -> None:
    values = (60 * synthetic.volume((8, 9, 10), frames=1).values[0]).astype(kind)
    np.save(tmp_path / "a.npy", values)
    run("compress", tmp_path / "a.npy", "-o", tmp_path / "a.hmk", "--plan", "R=8,9,10")
    text = run("decompress", tmp_path / "a.hmk", "-o", tmp_path / "b.npy", "--source-type").stdout
    found = np.load(tmp_path / "b.npy")
    assert found.dtype == values.dtype
    assert f"8,9,10 {kind}" in text
    if kind == "float16":
        np.testing.assert_allclose(found, values, atol=0.1)
    else:  # errors of a few thousandths
        np.testing.assert_array_equal(found, values)
    out = np.empty(values.shape, kind)
    assert hmkcta.open(tmp_path / "a.hmk").reconstruct(out) is out
    np.testing.assert_array_equal(out, found)


def test_plan_prints_the_command_that_does_it(source: Path, packed: Path, tmp_path: Path) -> None:
    text = run("plan", source, "--plan", PLAN, "--axes", "view,y,x", "--seed", 7).stdout
    words = shlex.split(text.splitlines()[-1])
    assert words[:2] == ["hmkcta", "compress"]
    words[words.index("OUT.hmk")] = str(tmp_path / "a.hmk")
    run(*words[1:], "--quiet")
    assert (tmp_path / "a.hmk").read_bytes() == packed.read_bytes()


def test_plan_for_a_goal_is_an_estimate_with_its_command(field: Path, tmp_path: Path) -> None:
    words = ("--snr", 30, "--decode-cost", 200, "--quality", "fast", "--axes", "t,y,x")
    found = report("plan", field, *words)
    assert found["plan"] is None
    assert found["estimated_snr_db"] == pytest.approx(30, abs=2)
    assert set(found["blocks"]) == {"t", "y", "x"}
    assert found["estimated_seconds"] > 0
    again = shlex.split(found["command"])
    assert again[3:] == ["-o", "OUT.hmk", "--snr", "30.0", "--decode-cost", "200", "--quality", "fast",
                         "--axes", "t,y,x"]
    again[again.index("OUT.hmk")] = str(tmp_path / "a.hmk")
    run(*again[1:], "--quiet")
    model = hmkcta.open(tmp_path / "a.hmk")
    assert model.snr >= 29.995
    assert model.decode_cost <= 200
    assert found["estimated_bytes"] == pytest.approx(model.nbytes, rel=0.3)


def test_plan_for_a_goal_says_that_it_estimates(field: Path) -> None:
    text = run("plan", field, "--size", "4KB", "--quality", "fast").stdout
    assert text.startswith("Estimated by samples")
    assert "goal          at most 3.91 KiB" in text
    lines = dict(re.findall(r"^(\w+) +(about .*)$", text, re.MULTILINE))
    assert set(lines) == {"bytes", "SNR", "time"}
    assert shlex.split(text.splitlines()[-1])[-4:] == ["--size", "4000", "--quality", "fast"]
    assert "--plan" not in text


def test_plan_keeps_an_organisation_that_was_given(field: Path) -> None:
    found = report("plan", field, "--size", "4KB", "--quality", "fast", "--axes", "t,y,x", "--organisation", "t, y+x")
    assert (found["organisation"], found["mode_sizes"]) == ("t, y+x", [12, 576])
    assert "--organisation 't, y+x'" in found["command"]


@pytest.mark.parametrize(("plan", "exact"), [
    ("R=2,3,4", [True]), ("R=*,3,4", [True]), (PLAN, [True, True]), ("R=1 grid=y:2,x:3 / R=3,4,3", [True, True]),
    ("R=2 C=2 / R=1", [True, True]),
])
def test_plan_counts_the_numbers_of_a_written_plan(plan: str, exact: list[bool], source: Path, tmp_path: Path) -> None:
    words = ("--plan", plan, "--axes", "view,y,x")
    found = report("plan", source, *words)
    run("compress", source, "-o", tmp_path / "a.hmk", *words, "--quiet")
    model = hmkcta.open(tmp_path / "a.hmk")
    assert [level["numbers"] for level in found["levels"]] == [level.numbers() for level in model.levels]
    assert [level["numbers_are_exact"] for level in found["levels"]] == exact
    assert [level["nodes"] for level in found["levels"]] == [level.nodes for level in model.levels]
    assert found["number_bytes"] == 2 * sum(level.numbers() for level in model.levels)
    assert found["estimated_bytes"] == found["number_bytes"] + found["estimated_table_bytes"]
    assert found["estimated_bytes"] == pytest.approx(model.nbytes, rel=0.15)
    assert found["decode_cost"] == model.decode_cost


def test_plan_bounds_the_numbers_of_nodes_that_may_be_small(source: Path, tmp_path: Path) -> None:
    words = ("--plan", "R=2 C=4 / R=3")
    found = report("plan", source, *words)
    run("compress", source, "-o", tmp_path / "a.hmk", *words, "--quiet")
    below = hmkcta.open(tmp_path / "a.hmk").levels[1]
    assert [level["numbers_are_exact"] for level in found["levels"]] == [True, False]
    assert 0 < below.numbers() < found["levels"][1]["numbers"]
    assert "at most" in run("plan", source, *words).stdout


def test_compress_for_a_goal_says_what_it_made(field: Path, tmp_path: Path) -> None:
    """No plan would make it again, so none is shown."""
    words = ("compress", field, "-o", tmp_path / "a.hmk", "--axes", "t,y,x", "--size", "4KB", "--quality", "fast")
    text = run(*words).stdout
    organisation = ", ".join("+".join(mode) for mode in hmkcta.open(tmp_path / "a.hmk").metadata.organisation)
    assert f"\norganisation: {organisation}\n" in text
    assert "--plan" not in text
    found = report(*words, "--overwrite")
    assert (found["organisation"], found["plan"]) == (organisation, None)
    assert found["layout"] == [level["layout"] for level in report("info", tmp_path / "a.hmk")["levels"]]
    assert sum(modes["nodes"] for modes in found["layout"][0]["undecomposed"]) == sum(
        stage.has_cells.sum() for stage in hmkcta.open(tmp_path / "a.hmk").levels)


def test_blocks_and_undecomposed_modes_are_shown(tmp_path: Path) -> None:
    """Values whose halves have nothing in common, one of them a few rows that are as good as noise."""
    values = np.random.default_rng(0).standard_normal((2, 4, 16, 16))
    values[1] = smooth(4, 16, 16) - smooth(4, 16, 16).mean()
    path = saved(tmp_path / "a.npy", values.reshape(8, 16, 16))
    run("compress", path, "-o", tmp_path / "a.hmk", "--axes", "t,y,x", "--organisation", "t, y, x", "--size", "6KB",
        "--quality", "fast", "--quiet")
    model = hmkcta.open(tmp_path / "a.hmk")
    cut = model.stages[0].shape[0, 0].tolist() if model.stages[0].is_cut else [1, 1, 1]
    layout = report("info", tmp_path / "a.hmk")["levels"][0]["layout"]
    assert layout["blocks"] == cut
    assert np.prod(cut) == model.levels[0].nodes
    assert {tuple(each["modes"]): each["nodes"] for each in layout["undecomposed"]} == counted(model)
    assert len(cut) == 3
    assert "  layout        " in run("info", tmp_path / "a.hmk").stdout


def counted(model: hmkcta.Model) -> dict[tuple[str, ...], int]:
    """How many nodes leave which modes undecomposed, by the shapes of all of them."""
    found: dict[tuple[str, ...], int] = {}
    for _, k, r in model.levels[0].shape.astype(int):
        if max(r):
            names = tuple(name for name, mixture in zip(("t", "y", "x"), k, strict=True) if mixture == 0)
            found[names] = found.get(names, 0) + 1
    return found


@pytest.mark.parametrize("command", ["", *main.commands])
def test_help_opens_with_examples_and_fits_one_screen(command: str) -> None:
    lines = run(*command.split(), "--help").stdout.splitlines()
    assert lines[0] == "Examples:"
    assert all(line.startswith("  hmkcta ") for line in lines[1:4])
    assert len(lines) <= (70 if command == "render" else 45)  # a scene has many properties
    assert max(map(len, lines)) <= 100


def test_exit_codes_are_in_the_help() -> None:
    text = run("--help").stdout
    assert all(f"\n  {code} " in text for code in (0, 1, 2, 3, 4, 5, 6, 7, 130))


def test_versions_can_be_pasted() -> None:
    lines = run("--version").stdout.splitlines()
    assert lines[0] == f"hmkcta {hmkcta.__version__}"
    assert f"numpy {np.__version__}" in lines


def test_a_line_now_and_then_without_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    spoken = progress_module.threading.Event()

    def listen(text: str, err: bool) -> None:
        assert err
        said.append(text)
        spoken.set()

    monkeypatch.setattr(progress_module, "INTERVAL", 0.01)
    monkeypatch.setattr(progress_module.click, "echo", listen)
    with Progress() as progress:
        progress("level 2", 0.5)
        assert spoken.wait(10)
    assert said[-1].startswith("hmkcta: ")


class Terminal(io.StringIO):
    """A stderr that is a terminal."""

    def isatty(self) -> bool:
        return True


def test_a_bar_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    stderr = Terminal()
    monkeypatch.setattr("sys.stderr", stderr)
    monkeypatch.setenv("NO_COLOR", "1")
    with Progress() as progress:
        progress("level 1", 0.25)
        progress("level 2", 0.5)
    assert "level 2" in stderr.getvalue()
    assert set(progress.stages) == {"level 1", "level 2"}


def test_progress_shows_the_stages_of_a_search(
    field: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[str, float]] = []
    listen = Progress.__call__

    def heard(progress: Progress, stage: str, fraction: float) -> None:
        told.append((stage, fraction))
        listen(progress, stage, fraction)

    monkeypatch.setattr(Progress, "__call__", heard)
    result = run("compress", field, "-o", tmp_path / "a.hmk", "--size", "4KB", "--quality", "fast", "-v")
    stages = list(dict.fromkeys(stage for stage, _ in told))
    assert stages[:2] == ["search", "measuring"]
    assert all(0 <= fraction <= 1 for _, fraction in told)
    assert re.findall(r"^  (\w+): \d", result.stderr, re.MULTILINE) == stages


def test_nothing_heavy_is_imported() -> None:
    heavy = "{'rich', 'PIL', 'click', 'hmkcta.cli'}"
    program = f"import hmkcta\nsys.stdout.write(str({heavy} & set(sys.modules)))\nraise SystemExit"
    assert finish(start(before=program)) == (0, "set()", "")


@pytest.mark.parametrize(("words", "heavy"), [
    (("--help",), {"numpy"}), (("--version",), {"scipy", "hmkcta.model"}),
    (("info",), {"rich", "hmkcta.fitting.fit", "hmkcta.readers"}),
])
def test_a_command_loads_what_it_needs(words: tuple[str, ...], heavy: set[str], packed: Path) -> None:
    before = f"import atexit\natexit.register(lambda: sys.stderr.write(str({heavy} & set(sys.modules))))"
    code, _, err = finish(start(*words, *([packed] if words == ("info",) else []), before=before))
    assert (code, err) == (0, "set()")


def test_the_summary_of_commands_is_whole() -> None:
    text = run("--help").stdout
    assert all(f"\n  {name:10}  {summary}\n" in text for name, summary in SUMMARIES.items())


def test_a_plan_larger_than_its_source_says_so(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.npy", smooth(6, 8, 10))
    assert "times the values in float32" in run("plan", path, "--plan", "R=4 C=2 K=2").stdout


def test_module_is_the_command(packed: Path) -> None:
    code, out, err = finish(start("info", packed, "--json"))
    assert (code, err) == (0, "")
    assert json.loads(out)["kind"] == "lightfield"


def test_demo(tmp_path: Path) -> None:
    pytest.importorskip("PIL")
    text = run("demo", "--tiny", "-o", tmp_path / "out").stdout
    assert "To try next:" in text
    for name in ("material", "jet"):
        for label in ("levels", "auto"):
            assert (tmp_path / "out" / f"{name}-{label}.png").stat().st_size > 1000
            hmkcta.open(tmp_path / "out" / f"{name}-{label}.hmk")
        assert (tmp_path / "out" / f"{name}-rendered.png").stat().st_size > 1000
    run("verify", tmp_path / "out" / "jet-auto.hmk", "--against", tmp_path / "out" / "jet.npy")


def test_every_command_is_a_click_command() -> None:
    assert set(main.commands) == {"compress", "plan", "info", "verify", "decompress", "view", "render", "bench", "demo"}
    assert all(isinstance(command, click.Command) for command in main.commands.values())


def test_time_is_read_with_its_unit(source: Path, tmp_path: Path) -> None:
    run("compress", source, "-o", tmp_path / "a.hmk", "--quality", "fast", "--time", "2min")
    words = "compress", source, "-o", tmp_path / "b.hmk"
    assert "is no time: write seconds above 0" in run(*words, "--time", "soon", code=2).output
    assert "beside a plan" in refused(*words, "--plan", "R=1", "--time", "9", code=2)
