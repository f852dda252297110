"""What callers from Python hand over: arrays of every kind, names and numbers in the forms that are at hand."""

from __future__ import annotations

import copy
import os
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hmkcta
from hmkcta import Axis, HmkctaError, Journal, LevelSpec, Plan, compress, parse_plan, plan_checks
from hmkcta import backends as kernels
from hmkcta.hmkfile import DEFAULT_LIMITS
from hmkcta.plan import HIGHEST_RANK
from hmkcta.plan_checks import check_plan
from hmkcta.render import Camera, Light, Scene, render
from hmkcta.render.layout import lay_out
from hmkcta.serve import serve
from hmkcta.streaming.source import described as describe_source
from hmkcta.support.executors import thread_count

WAVE: NDArray[np.float64] = np.add.outer(np.sin(np.arange(20) / 3), np.arange(18.0) / 9)


def refused(array: Any = WAVE, **options: Any) -> HmkctaError:
    with pytest.raises(HmkctaError) as caught:
        compress(array, **options)
    return caught.value


def test_booleans_are_zeros_and_ones(tmp_path: Path) -> None:
    model = compress(WAVE > 1, "R=9")
    model.save(tmp_path / "a.hmk")
    assert hmkcta.open(tmp_path / "a.hmk").metadata.source_dtype == "bool"
    assert np.array_equal(np.asarray(model), np.asarray(compress((WAVE > 1).astype(np.float32), "R=9")))


def test_of_long_floats_a_file_records_what_it_can(tmp_path: Path) -> None:
    model = compress(WAVE.astype(np.longdouble), "R=2")
    model.save(tmp_path / "a.hmk")
    assert hmkcta.open(tmp_path / "a.hmk").metadata.source_dtype == "float64"
    assert model.snr > 60


def test_what_a_mask_hides_is_not_compressed_as_data() -> None:
    error = refused(np.ma.masked_array(WAVE, WAVE > 1.5), plan="R=2")
    assert (error.reason, error.found) == ("masked", f"{(WAVE > 1.5).sum()} masked values")
    assert compress(np.ma.masked_array(WAVE, False), "R=2").snr == compress(WAVE, "R=2").snr


@pytest.mark.parametrize("axes", [
    "y, x", ["y", "x"], ("y", Axis("x", 18, "space")), [Axis("y", 20, "space"), "x"], np.array(["y", "x"]),
], ids=str)
def test_axes_are_named_in_many_ways(axes: str | list[str] | tuple[str | Axis, ...] | list[str | Axis]) -> None:
    named = compress(WAVE, "R=1", axes=axes).metadata.axes
    assert [(axis.name, axis.size, axis.role) for axis in named] == [("y", 20, "space"), ("x", 18, "space")]


@pytest.mark.parametrize("axes", [
    3, pytest.param({"y", "x"}, id="set"), b"y,x", [1, 2], ["y", None], np.array("y,x"), Path("y"),
], ids=str)
def test_what_names_no_axes_is_said(axes: Any) -> None:
    error = refused(plan="R=1", axes=axes)
    assert (error.reason, error.allowed is not None) == ("argument-type", True)
    assert "in array order" in str(error)


@pytest.mark.parametrize(("name", "size", "unit"), [(3, 3, ""), ("y", "3", ""), ("y", 3, 3)], ids=str)
def test_an_axis_is_described_by_words_and_a_number(name: Any, size: Any, unit: Any) -> None:
    with pytest.raises(HmkctaError, match="argument-type"):
        Axis(name, size, unit=unit)


def test_a_model_has_axes_of_its_own() -> None:
    light = Axis("l", 20, "light", np.arange(20.0), "degrees")
    model = compress(WAVE, "R=2", axes=(light, "x"))
    again = compress(model, "R=1").metadata.axes
    assert [(axis.name, axis.role, axis.unit) for axis in again] == [("l", "light", "degrees"), ("x", "space", "")]
    assert np.array_equal(np.asarray(again[0].coords), np.arange(20.0))
    assert [axis.name for axis in compress(model, "R=1", axes="y, x").metadata.axes] == ["y", "x"]


@pytest.mark.parametrize("path", ["s.npy", Path("s.npy"), b"s.npy"], ids=repr)
def test_a_path_is_to_be_opened_first(path: Any) -> None:
    for refuse in (compress, hmkcta.estimate):
        with pytest.raises(HmkctaError, match="array-is-path") as caught:
            refuse(path, snr=20)
        assert "hmkcta.open_array('s.npy')" in str(caught.value)
    assert hmkcta.open_array.__name__ == "open_array"


def test_nested_lists_have_one_length() -> None:
    assert refused([[1, 2], [3]]).reason == "array-shape"


def test_more_axes_than_a_file_can_have_are_to_be_made_one() -> None:
    error = refused(np.ones((2,) * 9))
    assert error.reason == "array-shape"
    assert "Next: make axes that belong together one" in str(error)


@pytest.mark.parametrize(("axes", "kind", "reason"), [
    ("frame, y, x, rgb", "volume", "no-space"), ("light, view, x, rgb", "svbrdf", "no-space"),
    ("t, z, y, x", "lightfield", "no-cameras"), ("theta:view, phi:view, a:view, y, x", "svbrdf", "too-many-directions"),
])
def test_a_kind_that_nothing_could_show_is_refused_before_the_fit(axes: str, kind: str, reason: str) -> None:
    error = refused(np.ones((2,) * len(axes.split(","))), plan="R=1", axes=axes, kind=kind)
    assert (error.reason, error.where) == (reason, f"axes of a {kind}")
    assert "NAME:ROLE" in error.hint


@pytest.mark.parametrize(("axes", "kind"), [
    ("light, y, x", "svbrdf"), ("light, view, y, x, rgb", "svbrdf"), ("row, column, y, x", "lightfield"),
    ("view, y, x", "lightfield"), ("t, z, y, x", "volume"), ("t, y, x", "generic"), ("light, view, rgb", "generic"),
    ("theta:light, phi:light, view, y, x", "generic"), ("row, column, view, y, x", "generic"),
])
def test_a_kind_is_one_that_can_be_shown(axes: str, kind: str) -> None:
    shape = (2,) * len(axes.split(","))
    model = compress(np.ones(shape), "R=1", axes=axes)
    assert model.metadata.kind == kind
    lay_out(model.metadata.axes, kind)


def test_an_axis_of_another_size_is_named() -> None:
    error = refused(axes=["y", Axis("x", 17)])
    assert (error.reason, error.found) == ("axis-size", 17)


@pytest.mark.parametrize("coords", [
    np.zeros((17, 3)), np.zeros((18, 3, 1)), np.zeros((18, 17)), np.zeros((18, 0)), np.full(18, np.nan), 3,
    ["north"] * 18, [[1]] * 17 + [[1, 2]],
], ids=str)
def test_coordinates_that_no_file_holds_are_refused_before_the_fit(coords: Any) -> None:
    with pytest.raises(HmkctaError) as caught:
        describe_source(WAVE, [Axis("y", 20), Axis("x", 18, coords=coords)])
    assert (caught.value.reason, caught.value.where) == ("coords", "coords of axis 'x'")
    assert caught.value.allowed


def test_coordinates_may_be_lists(tmp_path: Path) -> None:
    lists: Any = [[n, 0] for n in range(18)]
    compress(WAVE, "R=1", axes=[Axis("y", 20), Axis("x", 18, coords=lists)]).save(tmp_path / "a.hmk")
    assert np.array_equal(np.asarray(hmkcta.open(tmp_path / "a.hmk").metadata.axes[1].coords), lists)


@pytest.mark.parametrize("options", [
    {"snr": "30"}, {"size": ["1 MB"]}, {"decode_cost": 1.5}, {"seed": None}, {"threads": 2.5}, {"nan": "0"},
    {"quality": ["fast"]}, {"progress": 3}, {"journal": "a.partial"}, {"max_memory": [1]},
    {"organisation": 3}, {"transform": 3}, {"plan": ["R=2"]},
    {"size": True}, {"snr": False}, {"seed": True}, {"threads": True}, {"max_memory": True},
], ids=str)
def test_arguments_of_another_type_are_named(options: dict[str, Any]) -> None:
    error = refused(**options)
    assert (error.reason, error.where) == ("argument-type", next(iter(options)))
    assert error.allowed


@pytest.mark.parametrize(("name", "method", "given"), [
    ("level", "at_level", "1"), ("level", "at_level", [1]), ("coords", "sample", "x"),
    ("coords", "sample", [[1, 2], [1]]), ("out", "reconstruct", 3), ("path", "save", None), ("path", "save", 3),
])
def test_so_are_those_of_models(name: str, method: str, given: object) -> None:
    with pytest.raises(HmkctaError, match="argument-type") as caught:
        getattr(compress(WAVE, "R=1"), method)(given)
    assert caught.value.where == name


@pytest.mark.parametrize(("name", "function", "given"), [
    ("path", hmkcta.open, (None,)), ("uri", hmkcta.open_array, (["a.npy"],)), ("plan", parse_plan, (3, (("y",),))),
    ("organisation", parse_plan, ("R=1", "y,x")), ("mode of the organisation", parse_plan, ("R=1", ["y", "x"])),
    ("organisation", parse_plan, ("R=1", 3)), ("name of an axis", parse_plan, ("R=1", [["y"], [3]])),
])
def test_and_those_of_functions(name: str, function: Callable[..., object], given: tuple[Any, ...]) -> None:
    with pytest.raises(HmkctaError, match="argument-type") as caught:
        function(*given)
    assert caught.value.where == name


@pytest.mark.parametrize(("name", "function", "given"), [
    ("path", serve, {"path": compress(WAVE, "R=1")}), ("port", serve, {"path": "a.hmk", "port": "80"}),
    ("model", render, {"model": "a.hmk"}), ("scene", render, {"model": compress(WAVE, "R=1"), "scene": {"width": 3}}),
    ("surface", Scene, {"surface": "cloth"}), ("lights", Scene, {"lights": Light(0, 45)}),
    ("light", Scene, {"lights": [{"azimuth": 0}]}), ("width", Scene, {"width": "640"}),
    ("camera.azimuth", Camera, {"azimuth": "left"}),
])
def test_and_those_of_pages_and_pictures(name: str, function: Callable[..., object], given: dict[str, Any]) -> None:
    error = raised(lambda: function(**given))
    assert (error.reason, error.where) == ("argument-type", name)


@pytest.mark.parametrize("shape", ["3,4", 3, [2.5]], ids=str)
def test_a_shape_is_of_whole_numbers(shape: Any) -> None:
    with pytest.raises(HmkctaError, match="argument-type"):
        hmkcta.open_array("a.raw", shape=shape, dtype="f4")


def test_numbers_may_be_numpys(tmp_path: Path) -> None:
    """Their range is not that of Python's, and JSON does not know them."""
    given: dict[str, Any] = {"snr": 20, "decode_cost": 400, "seed": 3, "max_memory": 10**9}
    types = (np.float16, np.int32, np.int64, np.int64)
    compress(WAVE, **given).save(tmp_path / "own.hmk")
    with Journal(tmp_path / "a.partial") as journal:
        made = zip(given.items(), types, strict=True)
        numpys: dict[str, Any] = {name: make(value) for (name, value), make in made}
        compress(WAVE, journal=journal, **numpys).save(tmp_path / "numpys.hmk")
    assert (tmp_path / "numpys.hmk").read_bytes() == (tmp_path / "own.hmk").read_bytes()


@pytest.mark.parametrize("text", ["R=4 C=2 K=3", "R=4 C=2,3 K=3", "R=2 K=2", "R=1 grid=y:2 K=3", "R=1 C=4,1 K=2,2"])
def test_rows_are_in_no_more_clusters_than_there_are(text: str) -> None:
    with pytest.raises(HmkctaError, match="mixture-out-of-range") as caught:
        parse_plan(text, (("y",), ("x",)))
    assert "lower K, or raise C" in str(caught.value)


def test_small_nodes_have_fewer_clusters_than_the_plan() -> None:
    assert parse_plan("R=1 C=4,1 K=3", (("y",), ("x",))).levels[0].mixture == (3, 1)
    assert parse_plan("R=1 C=4,3 K=3", (("y",), ("x",))).levels[0].clamped((2, 9)).mixture == (2, 3)


def test_a_level_has_one_of_each_for_every_mode() -> None:
    with pytest.raises(HmkctaError) as caught:
        LevelSpec((2, 2), (1, 1), (1,))
    assert caught.value.reason == "level-modes"


@pytest.mark.parametrize("plan", ["R=1025", "R=1 / R=1,1025"])
def test_ranks_that_no_file_can_have_are_refused_before_the_fit(plan: str) -> None:
    modes = (("y",), ("x",))
    with pytest.raises(HmkctaError) as caught:
        check_plan(parse_plan(plan, modes), (1500, 1600))
    assert caught.value.reason == "rank-too-large"
    check_plan(parse_plan("R=1 / R=1025", modes), (600, 700))  # nodes have no more rows


@pytest.mark.parametrize(
    ("text", "hint"), [("out/wave.hmk", "Model.save"), ("fast", "give R of each level"), ("", "give R of each level")]
)
def test_what_is_no_plan_at_all_is_told_what_one_is(text: str, hint: str) -> None:
    """A second argument is a file's name elsewhere."""
    error = raised(lambda: compress(WAVE, text))
    assert error.reason == "plan-syntax"
    assert f"found '{text}', allowed levels such as R=4,4" in str(error)
    assert hint in str(error)


MODES = (("axis0",), ("axis1",))
#: What may be built by hand, and no tensor of two modes can be fitted by.
MISFITS: list[tuple[Callable[[], object], str]] = [
    (lambda: Plan((("y",), ("x",)), (LevelSpec((2, 2), (1, 1), (1, 1)),)), "organisation"),
    (lambda: Plan((("axis0",),), (LevelSpec((2,), (1,), (1,)),)), "organisation"),
    (lambda: Plan(MODES, ()), "plan-levels"),
    (lambda: Plan(MODES, (LevelSpec((2,), (1,), (1,)),)), "plan-modes"),
    (lambda: Plan(MODES, (LevelSpec((1, 1), (1, 1), (1, 1)),) * 17), "plan-levels"),
    (lambda: Plan(MODES, ("R=2",)), "argument-type"),  # pyright: ignore[reportArgumentType]
    (lambda: Plan(MODES, (LevelSpec((2, 2), (1, 1), (1, 1)),), snr="30"), "argument-type"),  # pyright: ignore
    (lambda: LevelSpec((2.0, 2), (1, 1), (1, 1)), "argument-type"),  # pyright: ignore[reportArgumentType]
    (lambda: LevelSpec((2, 2), (1, 1), (1, "1")), "argument-type"),  # pyright: ignore[reportArgumentType]
]


def test_complex_numbers_are_refused_with_what_to_do() -> None:
    assert "real and imaginary part" in str(raised(lambda: compress(np.ones((4, 5), complex), "R=1")))


@pytest.mark.parametrize(("text", "reason"), [
    ("R=30 C=8 K=8", "level-cost"), ("R=1 C=101 / R=1 C=2 / R=1", "plan-nodes"),
])
def test_plans_for_files_that_readers_refuse_are_refused_before_the_fit(text: str, reason: str) -> None:
    modes, sizes = (("z",), ("y",), ("x",)), (120, 120, 120)
    with pytest.raises(HmkctaError) as caught:
        check_plan(parse_plan(text, modes), sizes)
    assert caught.value.reason == reason
    check_plan(parse_plan("R=12 C=8 K=8", modes), sizes)
    check_plan(parse_plan("R=1 C=60 / R=1", modes), sizes)


def test_plans_and_readers_have_the_same_limits() -> None:
    plans = (HIGHEST_RANK, plan_checks.MOST_LEVELS, plan_checks.MOST_NODES, plan_checks.MOST_LEVEL_COST)
    assert plans == (DEFAULT_LIMITS.rank, DEFAULT_LIMITS.levels, DEFAULT_LIMITS.nodes, DEFAULT_LIMITS.level_cost)


@pytest.mark.parametrize(("made", "reason"), MISFITS)
def test_plans_made_by_hand_are_checked(made: Callable[[], Any], reason: str) -> None:
    assert raised(lambda: compress(WAVE, made())).reason == reason


def test_what_is_said_beside_a_plan_counts() -> None:
    """As it does beside levels in words."""
    noise = np.random.default_rng(0).random((20, 18))
    levels = "R=4 / R=6 / R=8"
    own, coarse, fine = parse_plan(levels, MODES), compress(noise, levels, snr=8), compress(noise, levels)
    assert len(coarse.quality) < len(fine.quality)
    for plan in (own, replace(own, snr=30), replace(own, size=fine.nbytes)):
        assert compress(noise, plan, snr=8, organisation="axis0, axis1").snr == coarse.snr
    assert raised(lambda: compress(noise, parse_plan("R=9", MODES), size=300)).reason == "size-too-small"
    assert raised(lambda: compress(noise, own, snr=8, organisation="axis0+axis1")).where == "organisation"
    clusters = parse_plan("R=1 C=2 / R=1", MODES)
    for scheme in ("least", "uniform"):
        assert compress(noise, clusters, scheme=scheme).metadata.levels[0].scheme == scheme


@pytest.mark.parametrize("scheme", ["most", "least", "uniform"])
def test_a_plan_is_subdivided_as_it_says(scheme: str) -> None:
    """A model's own plan makes it again."""
    noise = np.random.default_rng(0).random((20, 18))
    model = compress(noise, parse_plan("R=1 C=3 K=2 / R=1", MODES, scheme))
    assert model.metadata.levels[0].scheme == scheme
    assert compress(noise, model.plan).metadata.levels == model.metadata.levels


def raised(call: Callable[[], object]) -> HmkctaError:
    with pytest.raises(HmkctaError) as caught:
        call()
    return caught.value


def test_no_memory_at_all_is_a_bad_argument() -> None:
    error = refused(WAVE, max_memory=-1)
    assert (error.reason, error.found, error.allowed) == ("size", -1, "a positive number of bytes")


def test_what_to_do_next_is_said_in_the_words_of_python_too(tmp_path: Path) -> None:
    compress(WAVE, "R=1").save(tmp_path / "a.hmk")
    (tmp_path / "a.partial").mkdir()
    (tmp_path / "a.partial" / "explored.json").write_text("[]")
    calls: list[tuple[Callable[[], object], str]] = [
        (lambda: compress(WAVE / 0, "R=1"), "nan=0"),
        (lambda: compress(WAVE, "R=1").save(tmp_path / "a.hmk"), "overwrite=True"),
        (lambda: Journal(tmp_path / "a.partial"), "resume=True"),
        (lambda: compress(WAVE, max_memory=1000), "max_memory"),
    ]
    for call, words in calls:
        with np.errstate(all="ignore"):
            assert words in raised(call).hint


@pytest.mark.parametrize("call", [lambda: hmkcta.open("no.hmk"), lambda: compress(WAVE, "R=1")[99]],
                         ids=["file", "index"])
def test_errors_go_from_process_to_process(call: Callable[[], object]) -> None:
    """One that could not would end a pool of processes without a sentence, or let it wait for ever."""
    error = raised(call)
    for same in (pickle.loads(pickle.dumps(error)), copy.copy(error)):
        assert (type(same), str(same), vars(same)) == (type(error), str(error), vars(error))


def test_no_more_threads_are_started_than_there_are_cores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", {0: {0, 1}}.__getitem__, raising=False)
    begun: list[int] = []
    monkeypatch.setattr(kernels, "set_threads", begun.append)
    files: set[bytes] = set()
    for threads in (1, 100_000):
        compress(WAVE, "R=2", threads=threads).save(tmp_path / f"{threads}.hmk")
        files.add((tmp_path / f"{threads}.hmk").read_bytes())
    assert len(files) == 1
    assert thread_count(100_000) == thread_count() == 2
    assert max(begun) <= 2


def test_no_transform_is_identity() -> None:
    assert compress(WAVE, "R=1", transform=None).metadata.transform == {"name": "identity"}


def test_an_index_out_of_range_is_told_as_it_was_given() -> None:
    model = compress(WAVE, "R=1")
    for key, number in ((2**70, 2**70), (([0, 1], -(2**70)), -(2**70)), ((slice(None), 2**64), 2**64),
                        ([2**63], 2**63), (np.array([1, 2**64 - 1], np.uint64), 2**64 - 1)):
        with pytest.raises(IndexError, match=f"found {number},"):
            model[key]


def test_the_package_lists_what_it_offers() -> None:
    offered = {name for name in dir(hmkcta) if not name.startswith("__")}
    assert offered >= {"compress", "open_array", "render"}
    assert not offered & {"Any", "TYPE_CHECKING", "import_module", "_MODULES"}
    assert "__version__" in dir(hmkcta)
