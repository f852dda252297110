"""Levels whose numbers have eight bits: what is stored, what it costs, and when a chosen plan has them."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hmkcta
from cli_tools import refused, report, run, smooth
from hmk_corpus import FIXTURES, Parts
from hmkcta import HmkctaError, Model, choose_plan, compress, parse_plan
from hmkcta.backends import reference
from hmkcta.cells import Cells, round_cores
from hmkcta.comparing.follow import Task, follow
from hmkcta.filesize import planned_bytes
from hmkcta.narrow import BASIS_NUMBERS, CORE_NUMBERS, narrowed, widened
from hmkcta.plan import LevelSpec, Plan, parse_level
from hmkcta.streaming import budget
from hmkcta.streaming.source import prepare
from hmkcta.synthetic import Dataset, volume
from random_models import random_model
from test_kernels import random_cells

#: A ramp with noise, of which every level leaves something, and its modes.
RAMP = np.add.outer(np.arange(32.0), np.arange(24.0)) + np.random.default_rng(0).random((32, 24))
MODES = (("axis0",), ("axis1",))
#: Plans of every structure; `{}` stands for the bits.
PLANS = (
    "R=4,5,5,5{}",
    "R=*,5,5,5{}",
    "R=2,3,3,3 C=2,2,2,2{}",
    "R=2,3,3,3 C=1,2,2,2 K=1,2,2,2{}",
    "R=1 grid=y:2,x:2 / R=2,3,3,3{}",
    "R=3,4,4,4{} / R=2,2,2,2 C=1,2,2,2 K=1,2,2,2{}",
)
NAMES = ("time", "z", "y", "x")


@cache
def jet() -> Dataset:
    return volume((12, 20, 20), frames=8)


def fitted(**options: Any) -> Model:
    return compress(jet().values, axes=jet().axes, threads=1, **options)


def measured(model: Model) -> float:
    values = jet().values.astype(np.float64)
    error = np.square(values - np.asarray(model, np.float64)).sum()
    return float(10 * np.log10(np.square(values).sum() / error))


@pytest.mark.parametrize("numbers", [BASIS_NUMBERS, CORE_NUMBERS], ids=["basis", "core"])
def test_a_number_becomes_the_byte_that_is_nearest(numbers: Any) -> None:
    every = np.arange(-128, 128).astype(np.int8)
    wide = widened(every, numbers)
    assert (np.diff(wide.astype(np.float64)) > 0).all()
    assert (narrowed(wide, numbers) == every).all()
    values = np.random.default_rng(0).uniform(-1, 1, 2000)
    written = wide[1:].astype(np.float64)
    left = np.abs(values - widened(narrowed(values, numbers), numbers))
    assert left == pytest.approx(np.abs(values[:, None] - written).min(axis=1), abs=1e-12)


@pytest.mark.parametrize("text", ["R=2,3,2", "R=2,*,3", "R=2,2,2 C=2,1,3", "R=2,2,2 C=3,2,2 K=2,1,2"])
def test_rounding_twice_is_rounding_once(text: str) -> None:
    """Numbers that are read back from a journal, or packed, are those that the residual was made with."""
    cells = random_cells((9, 8, 7), parse_level(f"{text} bits=8", (("z",), ("y",), ("x",))), seed=1)
    once = cells.rounded()
    twice = once.rounded()
    for first, second in zip((*once.bases, once.cores), (*twice.bases, twice.cores), strict=True):
        assert first.tobytes() == second.tobytes()
    stored, scale = round_cores(once.cores, 8)
    assert (stored.astype(np.float32) * scale.reshape(-1, 1, 1, 1) == once.cores).all()
    assert np.isin(stored, CORE_NUMBERS).all()
    assert all(np.isin(basis.astype(np.float16), BASIS_NUMBERS).all() for basis in once.bases)
    assert _error(cells, once) < 0.03 * _norm(cells)


def _norm(cells: Cells) -> float:
    return float(np.linalg.norm(_dense(cells)))


def _error(cells: Cells, other: Cells) -> float:
    return float(np.linalg.norm(_dense(cells) - _dense(other)))


def _dense(cells: Cells) -> Any:
    tensor = np.zeros(cells.sizes, np.float32)
    reference.accumulate(cells, tensor, 1.0)
    return tensor


@pytest.mark.parametrize("text", PLANS)
def test_a_plan_of_bytes_takes_a_byte_a_number_and_loses_little(text: str, tmp_path: Path) -> None:
    wide, narrow = (fitted(plan=text.replace("{}", bits)) for bits in ("", " bits=8"))
    levels = [level for level in narrow.levels if level.bits == 8]
    assert levels
    saved = sum(level.numbers() for level in levels)
    numbers, narrower = (sum(level.number_bytes for level in model.levels) for model in (wide, narrow))
    assert narrower == numbers - saved
    assert narrow.nbytes - narrower < 0.5 * (wide.nbytes - numbers)  # tables are short
    assert narrow.snr > wide.snr - 0.25
    assert narrow.snr == pytest.approx(measured(narrow), abs=1e-3)
    path = tmp_path / "jet.hmk"
    narrow.save(path)
    assert path.stat().st_size == narrow.nbytes
    model = hmkcta.open(path)
    assert [level.bits for level in model.plan.levels] == [level.bits for level in narrow.plan.levels]
    assert (np.asarray(model) == np.asarray(narrow)).all()


@pytest.mark.parametrize("text", PLANS)
def test_the_bytes_of_a_plan_are_known_before(text: str) -> None:
    source = prepare(jet().values, jet().axes, None, None)
    plan = parse_plan(text.replace("{}", " bits=8"), source.organisation(None))
    assert planned_bytes(plan, source) == fitted(plan=plan).nbytes


def test_bytes_known_before_are_enough_whatever_scheme_is_best(tmp_path: Path) -> None:
    """Of uniform blocks it is stored which rows they have, of other schemes it follows."""
    np.save(source := tmp_path / "noise.npy", np.random.default_rng(9).standard_normal((40, 36, 30), np.float32))
    text = "R=3,3,3 C=3,2,2 bits=8 / R=2,2,2 bits=8"
    planned = {scheme: report("plan", source, "--plan", text, "--scheme", scheme)["predicted_bytes"]
               for scheme in ("most", "uniform", "auto")}
    assert planned["auto"] == planned["uniform"] > planned["most"]
    for scheme in planned:
        run("compress", source, "-o", tmp_path / scheme, "--plan", text, "--scheme", scheme, "--quiet")
        assert (tmp_path / scheme).stat().st_size <= planned[scheme]
    assert (tmp_path / "most").stat().st_size == planned["most"]


def test_a_second_level_of_bytes_takes_up_what_the_first_rounds_off() -> None:
    """At the edge of what bytes keep of one level, two levels of the same ranks end far beyond."""
    tensor = smooth(12, 20, 20, 20)
    one, two = (compress(tensor, text, threads=1) for text in ("R=4 bits=8", "R=4 bits=8 / R=4 bits=8"))
    assert one.snr < 48
    assert two.snr > one.snr + 8


def test_back_fitting_of_bytes_gains() -> None:
    """Columns are orthonormal again before sweeps that need them to be."""
    plan = "R=3,4,4,4 bits=8 / R=2,2,2,2 C=1,2,2,2 K=1,2,2,2 bits=8"
    assert fitted(plan=plan).snr > fitted(plan=plan, quality="fast").snr + 0.2


@pytest.mark.parametrize("text", ["R=2,3,3,3 C=1,2,2,2 K=1,2,2,2 bits=8", "R=1 grid=y:2,x:2 / R=2,3,3,3 bits=8"])
def test_streamed_levels_of_bytes_are_as_good(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    inside = fitted(plan=text)

    def little(*_: object) -> int:
        return jet().values.size // 2

    monkeypatch.setattr("hmkcta.comparing.follow.memory_limit", little)
    outside = fitted(plan=text)
    assert outside.snr > inside.snr - 0.3
    assert outside.snr == pytest.approx(measured(outside), abs=1e-3)


def test_a_level_in_which_nothing_is_left_has_no_more_bits_than_the_one_above(tmp_path: Path) -> None:
    tensor = np.zeros((8, 8, 8), np.float32)
    tensor[0, 0, 0] = 127 / 128
    for plan in ("R=1 bits=8 / R=1 bits=8", "R=1 C=2,1,1 bits=8 / R=1 bits=8"):
        model = compress(tensor, plan, threads=1)
        model.save(tmp_path / "one.hmk", overwrite=True)
        assert (np.asarray(hmkcta.open(tmp_path / "one.hmk")) == tensor).all()


# Plans that are chosen


def test_a_size_buys_more_where_numbers_are_bytes() -> None:
    wide, chosen = fitted(size=20_000, bits=16), fitted(size=20_000)
    assert chosen.levels[-1].bits == 8
    assert chosen.snr > wide.snr + 2
    assert chosen.nbytes <= 20_000


def test_transformed_values_have_bytes_where_these_do() -> None:
    """The default of 50 dB is beyond bytes once the logarithm is taken, but what is aimed at is a size."""
    rng = np.random.default_rng(4)
    heights = rng.standard_normal((16, 48, 48)).cumsum(1).cumsum(2) / 40
    values = np.exp(2.2 * heights)[..., None] * np.array([1, 0.8, 0.6])
    values[rng.random(heights.shape) > 0.9995] *= 1e3
    model = compress(values.astype(np.float32), axes="view, y, x, rgb", transform="log1p:0.1", threads=1)
    assert model.plan.levels[-1].bits == 8


def test_an_snr_takes_fewer_bytes() -> None:
    wide, chosen = fitted(snr=25.0, bits=16), fitted(snr=25.0)
    assert chosen.levels[-1].bits == 8
    assert chosen.snr >= 25
    assert chosen.nbytes < 0.75 * wide.nbytes


def test_packed_numbers_do_near_60_db() -> None:
    """Of a smooth tensor that many ranks do not exhaust, which whole bytes leave too much of."""
    tensor = smooth(16, 24, 24, 24)
    chosen, wide = compress(tensor, snr=58.0, threads=1), compress(tensor, snr=58.0, bits=16, threads=1)
    assert [level.bits for level in chosen.levels] == [8]
    assert chosen.snr >= 58
    assert chosen.nbytes < 0.7 * wide.nbytes


@pytest.mark.parametrize("bits", [8, 16])
def test_bits_that_are_asked_for_are_kept(bits: int, tmp_path: Path) -> None:
    for goal in ({"snr": 20.0}, {"size": 15_000}):
        assert fitted(bits=bits, quality="fast", **goal).levels[-1].bits == bits
    plan = choose_plan(jet().values, axes=jet().axes, size=15_000, bits=bits, threads=1)
    assert plan.levels[-1].bits == bits
    model = fitted(plan="R=2 / R=2 C=1,2,1,1", bits=bits)
    assert [level.bits for level in model.levels] == [bits, bits]
    model.save(tmp_path / "jet.hmk")
    header = json.JSONDecoder().raw_decode((tmp_path / "jet.hmk").read_bytes()[8:].decode("latin-1"))[0]
    assert json.loads(header["__metadata__"]["hmkcta"])["version"] == {8: "1.2", 16: "1.0"}[bits]


def test_what_misses_its_snr_in_bytes_is_tried_with_two(monkeypatch: pytest.MonkeyPatch) -> None:
    followed: list[Plan] = []

    def weak(task: Task) -> Model:
        followed.append(task.plan)
        return follow(replace(task, plan=replace(task.plan, snr=15.0)) if task.plan.levels[-1].bits == 8 else task)

    monkeypatch.setattr("hmkcta.comparing.followed.follow", weak)
    with pytest.warns(UserWarning, match="another is tried"):
        model = fitted(snr=25.0, quality="fast")
    assert model.snr >= 25
    assert [plan.levels[-1].bits for plan in followed[:2]] == [8, 16]


# What is refused


@pytest.mark.parametrize("bits", [7, 0, 32, "8", 8.5])
def test_bits_are_eight_or_sixteen(bits: Any) -> None:
    with pytest.raises(HmkctaError, match="bits"):
        fitted(plan="R=2", bits=bits)


@pytest.mark.parametrize(("plan", "reason"), [("R=2 bits=12", "bits"), ("R=2 bits=x", "plan-number"),
                                              ("R=2 bits=8 / R=2", "bits-ascend")])
def test_plans_of_other_bits_are_refused(plan: str, reason: str) -> None:
    with pytest.raises(HmkctaError) as refusal:
        fitted(plan=plan)
    assert refusal.value.reason == reason


@pytest.mark.parametrize(("plan", "bits", "level"), [
    ("R=4 bits=8", 16, 1), ("R=4 bits=16", 8, 1), ("R=4 / R=2 bits=8", 16, 2), ("R=4 / R<=2 bits=8", 16, 2),
])
def test_bits_beside_a_plan_that_says_others_are_refused(plan: str, bits: int, level: int, tmp_path: Path) -> None:
    source, found = tmp_path / "a.npy", f"found {bits}, and bits={24 - bits} in level {level} of the plan"
    for given in (plan, parse_plan(plan, MODES)):
        with pytest.raises(HmkctaError, match=found) as refusal:
            compress(RAMP, given, bits=bits, size=20_000)
        assert refusal.value.reason == "two-bits"
    np.save(source, RAMP)
    words = ("--plan", plan, "--bits", bits, "--size", "20KB")
    assert found in refused("plan", source, *words, code=2)
    assert found in refused("compress", source, "-o", tmp_path / "a.hmk", *words, code=2)
    assert list(tmp_path.iterdir()) == [source]


@pytest.mark.parametrize(("plan", "bits", "stored"), [
    ("R=4", 8, [8]), ("R=4 bits=16", 16, [16]), ("R=4 / R=2 bits=8", 8, [8, 8]), ("R=4 / R=2 bits=8", None, [16, 8]),
])
def test_bits_beside_a_plan_count_where_it_says_none(plan: str, bits: int | None, stored: list[int]) -> None:
    assert [level.bits for level in compress(RAMP, plan, bits=bits).levels] == stored
    by_hand = replace(parse_plan("R=4", MODES), levels=(LevelSpec((4, 4), (1, 1), (1, 1), bits=8),))
    with pytest.raises(HmkctaError, match="two-bits"):
        compress(RAMP, by_hand, bits=16)


def test_random_files_of_bytes_decode_as_their_numbers_say(tmp_path: Path) -> None:
    """A file of bytes, and the same model in float16 numbers, are the same values."""
    metadata, levels = random_model(np.random.default_rng(5), (7, 6, 5), 2, (), eight_from=1)
    wide = Model(metadata, tuple(replace(level, bits=16) for level in levels))
    Model(metadata, levels).save(tmp_path / "bytes.hmk")
    assert (np.asarray(hmkcta.open(tmp_path / "bytes.hmk")) == np.asarray(wide)).all()


def noisy(edge: int) -> NDArray[np.float32]:
    """A bell that moves through a volume, with noise all over but for some frames and rows that are zero."""
    t, z, y, x = np.meshgrid(np.arange(16), *[np.arange(edge)] * 3, indexing="ij")
    way = (z - edge / 4 - t * edge / 32) ** 2 + (y - edge / 2 - 5 * np.sin(t / 3)) ** 2
    values = np.exp(-(way + (x - edge / 2 - 5 * np.cos(t / 3)) ** 2) / 30) + 0.1 * np.sin(x / 4 + t / 2) * np.cos(y / 5)
    values += np.random.default_rng(1).normal(0, 0.02, values.shape)
    values[4:7] = 0
    values[:, :, edge // 3 : edge // 2] = 0
    return values.astype(np.float32)


@pytest.mark.parametrize("snr", [42.0, 45.0])
def test_noise_beyond_what_bytes_keep_takes_one_level_of_packed_numbers(snr: float) -> None:
    """One level of bytes ends just below, and one of float16 numbers 25 dB above it in over 90,000 bytes.

    Ranks of one may stand above it, of float16 numbers.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of what was tried before
        model = compress(noisy(16), axes="t, z, y, x", snr=snr, threads=1)
    assert model.levels[-1].rice
    assert all((bounds.ranks[n] == 1) for bounds in model.bounds[:-1] for n in range(3))
    assert model.snr >= snr
    assert model.nbytes < 40_000


# Command line


def test_the_command_line_asks_for_bits_and_shows_them(tmp_path: Path) -> None:
    source = tmp_path / "jet.npy"
    np.save(source, jet().values)
    sizes: dict[int, int] = {}
    for bits in (8, 16):
        output = tmp_path / f"{bits}.hmk"
        run("compress", source, "-o", output, "--axes", ",".join(NAMES), "--plan", "R=4", "--bits", bits, "--quiet")
        told = report("info", output)
        assert [level["bits"] for level in told["levels"]] == [bits]
        assert told["bytes"]["file"] == output.stat().st_size
        sizes[bits] = output.stat().st_size
    assert sizes[8] < sizes[16]
    planned = report("plan", source, "--axes", ",".join(NAMES), "--size", "15KB", "--bits", "8", "--quality", "fast")
    assert planned["plan"].endswith("bits=8")
    assert "--bits" not in planned["command"]  # the plan says it
    run("compress", source, "-o", tmp_path / "x.hmk", "--bits", "9", code=2)
    goal = ("--snr", "150", "--bits", "8", "--quality", "fast")
    missed = run("compress", source, "-o", tmp_path / "x.hmk", *goal, code=7)
    assert "--bits 16" in missed.stderr


def test_what_memory_does_not_hold_has_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    """At as many bytes they come to more, also streamed, and where worksets are small for want of memory."""
    options: dict[str, Any] = {"size": 8_000, "quality": "fast"}
    monkeypatch.setattr(budget, "SMALLEST", 1000)
    monkeypatch.setattr(budget, "WORKSET", jet().values.size // 3)
    model = fitted(**options)
    assert {level.bits for level in choose_plan(jet().values, axes=jet().axes, **options).levels} == {8}
    assert model.snr > fitted(**options, bits=16).snr + 1
    monkeypatch.setattr(budget, "WORKING", 2000)
    scarce = budget.PROCESS + budget.WORKING * jet().values.size // 4
    plan = choose_plan(jet().values, axes=jet().axes, max_memory=scarce, **options)
    assert {level.bits for level in plan.levels} == {8}


def test_info_counts_the_bits_of_packed_levels() -> None:
    path = FIXTURES / "v1.4-partly.hmk"
    arrays = Parts.split(path.read_bytes()).arrays
    sizes = {name: len(data) for name, (_, _, data) in arrays.items()}
    numbers = {name: size for name, size in sizes.items() if name.endswith("/core") or "/basis/" in name}
    told = report("info", path)
    assert told["bytes"]["numbers"] == sum(numbers.values())
    assert told["bytes"]["tables"] == sum(sizes.values()) - sum(numbers.values())
    assert sum(told["bytes"][part] for part in ("header", "numbers", "tables")) == path.stat().st_size
    assert [level["bytes"] for level in told["levels"]] == [
        sum(size for name, size in sizes.items() if name.startswith(f"level/{level}/")) for level in (1, 2, 3)
    ]
    packed = sum(size for name, size in numbers.items() if name.startswith("level/2/"))
    mean = 8 * packed / hmkcta.open(path).levels[1].numbers()
    assert [level["bits"] for level in told["levels"]] == [16, pytest.approx(mean), 8]
    rows = [line.split() for line in run("info", path).stdout.splitlines() if line.split()[:1] in (["1"], ["2"], ["3"])]
    assert [row[4] for row in rows] == ["16", f"{mean:.1f}", "8"]
    assert run("verify", path).stdout.endswith("as they should be.\n")
