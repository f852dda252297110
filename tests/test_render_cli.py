"""`hmkcta render` as a user runs it: pictures, radiance, films, and sentences for what cannot be."""

from __future__ import annotations

import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import hmkcta
from cli_tools import refused, report, run
from hmkcta import Model, synthetic
from hmkcta.render import Renderer, Scene, scene_from_json
from hmkcta.render.outputs import save_film

SIZE = ("--size", "40x30", "--backend", "numpy")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of each kind, and the sources."""
    folder = tmp_path_factory.mktemp("files")
    sets = {"cloth": synthetic.material(8, 6, 12), "scene": synthetic.light_field(3, 16, 3),
            "jet": synthetic.volume(10, frames=4)}
    for name, data in sets.items():
        np.save(folder / f"{name}.npy", data.values)
        plan = "R=3 / R=2" if name == "cloth" else "R=3"
        hmkcta.compress(data.values, plan, axes=data.axes, kind=data.kind, quality="fast").save(folder / f"{name}.hmk")
    return folder


def pixels(path: Path) -> NDArray[np.uint8]:
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB"))


@pytest.mark.parametrize("name", ["cloth", "scene", "jet"])
def test_each_kind_is_rendered_as_python_renders_it(files: Path, tmp_path: Path, name: str) -> None:
    out = tmp_path / "frame.png"
    done = report("render", files / f"{name}.hmk", "-o", out, *SIZE)
    assert (done["width"], done["height"], done["frames"], done["backend"]) == (40, 30, 1, "numpy")
    model: Model = hmkcta.open(files / f"{name}.hmk")
    assert done["kind"] == model.metadata.kind
    assert (pixels(out) == Renderer(model, backend="numpy").picture(Scene(width=40, height=30))).all()


def test_options_go_before_the_scene(files: Path, tmp_path: Path) -> None:
    scene = {"width": 20, "height": 30, "camera": {"azimuth": 10, "elevation": 5}, "surface": {"shape": "cloth"},
             "lights": [{"azimuth": 0}]}
    (tmp_path / "scene.json").write_text(json.dumps(scene), "utf-8")
    run("render", files / "cloth.hmk", "-o", tmp_path / "a.png", "--scene", tmp_path / "scene.json", "--azimuth", 50,
        "--light", "80,30", "--point-light", "0,1,2", "--repeat", "2,1", "--stops", 1, "--at", "rgb=1", *SIZE)
    scene |= {"width": 40, "camera": {"azimuth": 50, "elevation": 5}, "tone": {"stops": 1},
              "surface": {"shape": "cloth", "repeat": [2, 1]}, "position": {"rgb": 1},
              "lights": [{"azimuth": 80, "elevation": 30}, {"position": [0, 1, 2], "intensity": 4}]}
    described = scene_from_json(scene)
    renderer = Renderer(hmkcta.open(files / "cloth.hmk"), backend="numpy", position=described.position)
    assert (pixels(tmp_path / "a.png") == renderer.picture(described)).all()


def test_radiance_is_written_as_exr(files: Path, tmp_path: Path) -> None:
    exr = pytest.importorskip("OpenEXR")
    run("render", files / "cloth.hmk", "-o", tmp_path / "a.exr", *SIZE)
    with exr.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        channels: dict[str, Any] = file.channels()
        stored = np.stack([channels[name].pixels for name in "RGBA"], axis=-1)
    radiance = Renderer(hmkcta.open(files / "cloth.hmk"), backend="numpy").radiance(Scene(width=40, height=30))
    assert (stored == radiance).all()


@pytest.mark.parametrize(("name", "motion"), [("cloth", "orbit"), ("cloth", "light"), ("scene", "view"),
                                              ("scene", "time"), ("jet", "time"), ("jet", "orbit")])
def test_films_move(files: Path, tmp_path: Path, name: str, motion: str) -> None:
    out = tmp_path / "film.gif"
    done = report("render", files / f"{name}.hmk", "-o", out, "--animate", motion, "--frames", 4, "--fps", 10, *SIZE)
    assert done["frames"] == 4
    frames: list[NDArray[np.uint8]] = []
    with Image.open(out) as film:
        assert (getattr(film, "n_frames", 1), film.info["duration"]) == (4, 100)
        for number in range(4):
            film.seek(number)
            frames.append(np.asarray(film.convert("RGB")))
    assert all((a != b).any() for a, b in pairwise(frames))


# The package leaves its pipes to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_films_are_mp4_that_ffmpeg_reads(files: Path, tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    out = tmp_path / "film.mp4"
    words = ("render", files / "jet.hmk", "-o", out, "--frames", 5, "--size", "41x31", "--backend", "numpy")
    assert ": volume, 40 x 30, 5 frames, by NumPy" in run(*words).stdout
    reader = ffmpeg.read_frames(str(out))
    assert next(reader)["size"] == (40, 30)
    frames = [np.frombuffer(frame, np.uint8).reshape(30, 40, 3).astype(int) for frame in reader]
    assert len(frames) == 5
    renderer = Renderer(hmkcta.open(files / "jet.hmk"), backend="numpy")
    expected = list(renderer.frames(Scene(width=41, height=31), "time", 5))
    assert np.abs(frames[4] - expected[4][:30, :40]).mean() < 6


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(("asked", "written"), [((41, 31), (40, 30)), ((40, 31), (40, 30)), ((40, 30), (40, 30)),
                                                ((41, 1), (40, 2)), ((1, 40), (2, 40))])
def test_the_report_has_the_size_that_an_mp4_has(
    files: Path, tmp_path: Path, asked: tuple[int, int], written: tuple[int, int]
) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    out, size = tmp_path / "film.mp4", "x".join(map(str, asked))
    done = report("render", files / "jet.hmk", "-o", out, "--frames", 2, "--size", size, "--backend", "numpy")
    assert (done["width"], done["height"]) == written == next(ffmpeg.read_frames(str(out)))["size"]
    sides = f"it has {written[0]} x {written[1]} pixels, not {asked[0]} x {asked[1]}."
    assert [sides in note for note in done["notes"]] == ([] if asked == written else [True])
    gif = report("render", files / "jet.hmk", "-o", tmp_path / "film.gif", "--frames", 2, "--size", size,
                 "--backend", "numpy")
    assert ((gif["width"], gif["height"]), gif["notes"]) == (asked, [])


def test_comparisons_with_the_original_and_with_a_level(files: Path, tmp_path: Path) -> None:
    cloth, source = files / "cloth.hmk", files / "cloth.npy"
    pictures: dict[str, NDArray[np.uint8]] = {}
    for name, words in {"plain": (), "split": ("--split", 1), "original": ("--split", 0, "--against", source),
                        "heat": ("--heat", "--against", source), "levels": ("--heat", "--split", 1)}.items():
        run("render", cloth, "-o", tmp_path / f"{name}.png", *words, *SIZE)
        pictures[name] = pixels(tmp_path / f"{name}.png")
    for name in ("split", "original"):
        assert (pictures[name][:, :19] == pictures["plain"][:, :19]).all()
        assert (pictures[name][:, 21:] != pictures["plain"][:, 21:]).any()
    assert (pictures["heat"] != pictures["levels"]).any()
    (said,) = report("render", cloth, "-o", tmp_path / "again.png", "--heat", "--split", 1, *SIZE)["notes"]
    assert re.fullmatch(r"errors are shown \d+ times as large as they are", said)


def test_what_is_assumed_is_said(tmp_path: Path) -> None:
    values = np.random.default_rng(0).uniform(size=(6, 4, 8, 8)).astype(np.float32)
    path = tmp_path / "bare.hmk"
    hmkcta.compress(values, "R=2", axes=["light", "view", "y", "x"], kind="svbrdf", quality="fast").save(path)
    said = run("render", path, "-o", tmp_path / "a.png", *SIZE).stderr
    assert "'light' has no directions" in said
    assert "'view' has no directions" in said
    assert len(report("render", path, "-o", tmp_path / "b.png", *SIZE)["notes"]) == 2


def test_options_that_do_nothing_are_said(files: Path, tmp_path: Path) -> None:
    idle = ("--colours", "ice", "--focus", 3, "--stops", 1)
    for name, kind, options in (("jet", "volume", "--focus"), ("jet", "generic", "--focus, --colours"),
                                ("cloth", "svbrdf", "--focus, --colours")):
        words = ("render", files / f"{name}.hmk", "-o", tmp_path / f"{name}-{kind}.png", "--kind", kind, *idle, *SIZE)
        assert report(*words)["notes"][-1] == f"for a {kind} these do nothing: {options}"


def test_a_band_of_many_is_chosen_and_nothing_is_said(tmp_path: Path) -> None:
    values = np.random.default_rng(0).uniform(size=(3, 3, 8, 8, 5)).astype(np.float32)
    words = ("render", tmp_path / "bands.hmk", "-o", tmp_path / "a.png", *SIZE, "--at", "band=3")
    hmkcta.compress(values, "R=2", axes="row, column, y, x, band", quality="fast").save(words[1])
    assert report(*words)["notes"] == []
    assert np.ptp(pixels(words[3]), axis=-1).max() < 10, "grey, but for the background"


@pytest.mark.parametrize(("name", "kind", "given", "said"), [
    ("jet", "volume", ("--at", "time=1", "--at", "x=3"),
     "--at time=1 (--time moves along time), --at x=3 (all of x is shown)"),
    ("jet", "generic", ("--at", "y=2", "--time", 1),
     "--time (a slice stands by --at time=INDEX), --at y=2 (all of y is shown)"),
    ("cloth", "svbrdf", ("--at", "rgb=1", "--at", "light=2", "--at", "view=0"),
     "--at rgb=1 (all of rgb is shown), --at light=2 (--light and --point-light move along light), "
     "--at view=0 (the camera moves along view)"),
    ("scene", "lightfield", ("--at", "column=1"), "--at column=1 (--row and --column move along column)"),
    ("cloth", "svbrdf", ("--time", 2), "--time (of the axes light, view, y, x, rgb none is time)"),
    ("jet", "volume", ("--iso", 0.4), "--iso (the mode is shaded: --mode iso shows it)"),
    ("jet", "generic", ("--iso", 0.4), "--iso"),
])
def test_options_that_do_nothing_in_this_file_are_said_with_why(
    files: Path, tmp_path: Path, name: str, kind: str, given: tuple[object, ...], said: str
) -> None:
    words = ("render", files / f"{name}.hmk", "--kind", kind, *SIZE)
    run(*words, "-o", tmp_path / "plain.png")
    notes = report(*words, "-o", tmp_path / "idle.png", *given)["notes"]
    assert notes == [f"for a {kind} these do nothing: {said}"]
    assert (pixels(tmp_path / "plain.png") == pixels(tmp_path / "idle.png")).all()


@pytest.mark.parametrize(("name", "kind", "given"), [
    ("jet", "generic", ("--at", "z=2", "--at", "time=1")), ("scene", "lightfield", ("--time", 2)),
    ("jet", "volume", ("--mode", "iso", "--iso", 0.4)), ("two", "lightfield", ("--at", "channel=1")),
])
def test_nothing_is_said_of_options_that_do_something(
    files: Path, tmp_path: Path, name: str, kind: str, given: tuple[object, ...]
) -> None:
    values = np.random.default_rng(0).uniform(size=(3, 8, 8, 2)).astype(np.float32)
    two = hmkcta.compress(values, "R=2", axes=["view", "y", "x", "channel"], kind="lightfield", quality="fast")
    (two if name == "two" else hmkcta.open(files / f"{name}.hmk")).save(tmp_path / "a.hmk")
    words = ("render", tmp_path / "a.hmk", "--kind", kind, *SIZE)
    run(*words, "-o", tmp_path / "plain.png")
    assert report(*words, "-o", tmp_path / "other.png", *given)["notes"] == []
    assert (pixels(tmp_path / "plain.png") != pixels(tmp_path / "other.png")).any()


@pytest.mark.parametrize(("words", "code", "says"), [
    (("-o", "a.jpg"), 2, "output-format"),
    (("-o", "a.png", "--animate", "orbit"), 2, "output-format"),
    (("-o", "a.gif", "--animate", "time"), 2, "motion-kind"),
    (("-o", "a.gif", "--animate", "dance"), 2, "unknown-motion"),
    (("-o", "a.exr", "--split", "1"), 2, "output-format"),
    (("-o", "a.png", "--level", "9"), 2, "level-out-of-range"),
    (("-o", "a.png", "--split", "0"), 2, "no-original"),
    (("-o", "a.png", "--heat"), 2, "by --against FILE, or a level by --split N"),
    (("-o", "a.gif", "--kind", "generic"), 2, "found slices, in which nothing moves"),
    (("-o", "a.png", "--time", "5", "--kind", "lightfield"), 2, "time-out-of-range"),
    (("-o", "a.png", "--scene", "none.json"), 3, "unreadable"),
    (("-o", "a.png", "--surface", "none.obj"), 3, "unreadable"),
    (("-o", "none/a.png"), 3, "unwritable"),
    (("-o", "a.png", "--against", "none.npy"), 3, "none.npy"),
])
def test_what_cannot_be_is_a_sentence(files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                      words: tuple[str, ...], code: int, says: str) -> None:
    monkeypatch.chdir(tmp_path)
    assert says in refused("render", files / "cloth.hmk", *words, *SIZE, code=code)
    assert list(tmp_path.iterdir()) == [], "nothing is left half written"


def test_a_film_of_slices_is_one_of_time(files: Path, tmp_path: Path) -> None:
    words = ("render", files / "jet.hmk", "--kind", "generic", *SIZE)
    assert report(*words, "-o", tmp_path / "a.gif", "--frames", 4)["frames"] == 4
    with Image.open(tmp_path / "a.gif") as film:
        frames = [np.asarray(film.convert("RGB")) for number in range(4) if film.seek(number) is None]
    assert all((one != other).any() for one, other in pairwise(frames))


def test_it_is_said_that_no_shader_shows_slices(files: Path, tmp_path: Path) -> None:
    words = ("render", files / "jet.hmk", "--kind", "generic", "--size", "40x30", "-o", tmp_path / "a.png")
    notes = report(*words, "--backend", "gpu")["notes"]
    assert notes == ["slices are rendered by NumPy: --backend gpu does nothing for them"]


def test_outputs_are_not_replaced_unasked(files: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.png"
    out.write_bytes(b"mine")
    said = refused("render", files / "jet.hmk", "-o", out, *SIZE, code=3)
    assert "output-exists" in said
    assert "replace it by --overwrite" in said
    assert out.read_bytes() == b"mine"
    run("render", files / "jet.hmk", "-o", out, "--overwrite", *SIZE)
    assert pixels(out).shape == (30, 40, 3)


def test_a_film_without_frames_is_refused(tmp_path: Path) -> None:
    with pytest.raises(hmkcta.HmkctaError, match="no-frames"):
        save_film(tmp_path / "a.gif", [])
    assert not list(tmp_path.iterdir())


def test_without_an_adapter_numpy_renders(files: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import hmkcta.render.device as device

    def nothing() -> Any:
        raise hmkcta.HmkctaError(hmkcta.errors.Kind.IO, "no-adapter", "rendering on the GPU", hint=device.REMEDY)

    monkeypatch.setattr(device, "shared_device", nothing)
    done = report("render", files / "jet.hmk", "-o", tmp_path / "a.png", "--size", "40x30")
    assert (done["backend"], done["adapter"]) == ("numpy", "")
    sentence = refused("render", files / "jet.hmk", "-o", tmp_path / "b.png", "--backend", "gpu", code=3)
    assert "mesa-vulkan-drivers" in sentence
