"""Writing refuses what no reader would take, and leaves the target as it was whenever it fails."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hmkcta
from hmkcta.axes import Axis, name_axes, separate
from hmkcta.errors import HmkctaError, Kind
from hmkcta.hmkfile import Limits, load, save
from hmkcta.packed import LevelQuality, Metadata, PackedLevel, bounds_of
from make_fixture import half_model, merged_model, small_model

TESTS = Path(__file__).parent


def refusal(path: Path, metadata: Metadata, levels: tuple[PackedLevel, ...], **options: Any) -> HmkctaError:
    """The error with which `save` refuses; the folder must be as it was."""
    before = sorted(path.parent.iterdir()) if path.parent.is_dir() else []
    with pytest.raises(HmkctaError) as caught:
        save(path, metadata, levels, **options)
    assert (sorted(path.parent.iterdir()) if path.parent.is_dir() else []) == before
    return caught.value


def test_existing_output_is_refused_unless_told(tmp_path: Path) -> None:
    path = tmp_path / "a.hmk"
    path.write_text("precious")
    error = refusal(path, *small_model())
    assert (error.kind, error.reason) == (Kind.IO, "output-exists")
    assert path.read_text() == "precious"
    save(path, *small_model(), overwrite=True)
    load(path)


def test_overwriting_keeps_open_files_readable(tmp_path: Path) -> None:
    path = tmp_path / "a.hmk"
    save(path, *merged_model())
    _, levels = load(path)
    save(path, *small_model(), overwrite=True)
    assert levels[0].core.tobytes() == merged_model()[1][0].core.tobytes()


def test_overwriting_follows_a_link(tmp_path: Path) -> None:
    (tmp_path / "real.hmk").write_text("old")
    (tmp_path / "link.hmk").symlink_to("real.hmk")
    save(tmp_path / "link.hmk", *small_model(), overwrite=True)
    assert (tmp_path / "link.hmk").is_symlink()
    load(tmp_path / "real.hmk")


def test_folder_as_output(tmp_path: Path) -> None:
    (tmp_path / "a.hmk").mkdir()
    assert refusal(tmp_path / "a.hmk", *small_model(), overwrite=True).reason == "output-exists"


@pytest.mark.parametrize("name", ["missing/a.hmk", "n" * 300 + ".hmk", "nul\0.hmk"])
def test_unwritable_output(tmp_path: Path, name: str) -> None:
    error = refusal(tmp_path / name, *small_model())
    assert (error.kind, error.reason) == (Kind.IO, "unwritable")


@pytest.mark.parametrize("name", [".", "missing.hmk", "n" * 300, "nul\0.hmk"])
def test_unreadable_input(tmp_path: Path, name: str) -> None:
    with pytest.raises(HmkctaError) as caught:
        load(tmp_path / name)
    assert (caught.value.kind, caught.value.reason) == (Kind.IO, "unreadable")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_pipe_as_input_does_not_block(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(HmkctaError) as caught:
        load(tmp_path / "pipe")
    assert caught.value.reason == "unreadable"


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EIO])
def test_failing_disk_leaves_nothing(tmp_path: Path, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(descriptor: int) -> None:
        raise OSError(number, os.strerror(number), descriptor)

    (tmp_path / "a.hmk").write_text("old")
    monkeypatch.setattr(os, "fsync", fail)
    error = refusal(tmp_path / "a.hmk", *small_model(), overwrite=True)
    assert (error.kind, error.reason) == (Kind.IO, "unwritable" if number == errno.EIO else "disk-full")
    assert (tmp_path / "a.hmk").read_text() == "old"


def test_interrupt_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(source: object, target: object) -> None:
        raise KeyboardInterrupt(source, target)

    monkeypatch.setattr(os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        save(tmp_path / "a.hmk", *small_model())
    assert not list(tmp_path.iterdir())


FULL = """
import resource, sys
sys.path[:0] = sys.argv[1:3]
from make_fixture import merged_model
from hmkcta.errors import HmkctaError
from hmkcta.hmkfile import save
resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024))
try:
    save(sys.argv[3], *merged_model())
except HmkctaError as error:
    sys.stdout.write(error.reason)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="needs a limit on the file size")
def test_file_size_limit_leaves_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-c", FULL, str(TESTS.parent / "python"), str(TESTS), str(tmp_path / "a.hmk")]
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert (result.stderr, result.stdout) == ("", "disk-full")
    assert not list(tmp_path.iterdir())


Model = tuple[Metadata, tuple[PackedLevel, ...]]


def changed(stage: int, **arrays: Any) -> Model:
    """The model of three stages (a cut, float16, coded) with some arrays of one replaced."""
    metadata, stages = half_model()
    return metadata, tuple(replace(own, **arrays) if t == stage else own for t, own in enumerate(stages))


def small(**arrays: Any) -> Model:
    """The small model, whose only stage is coded, with some of its arrays replaced."""
    metadata, (stage,) = small_model()
    return metadata, (replace(stage, **arrays),)


def with_metadata(**values: Any) -> Model:
    """The small model with some metadata replaced."""
    metadata, stages = small_model()
    return replace(metadata, **values), stages


def with_coords(coords: Any) -> Model:
    """The small model with other coordinates of its first axis."""
    return with_metadata(axes=(Axis("höhe", 4, "space", coords), small_model()[0].axes[1]))


def numbers(stage: int, name: str) -> Any:
    """An array of the model of three stages."""
    return getattr(half_model()[1][stage], name)


CORE = small_model()[1][0].core

INVALID: dict[str, tuple[Callable[[], Model], str]] = {
    "core is float32": (lambda: small(core=CORE.astype(np.float32)), "array-dtype"),
    "core is int64": (lambda: small(core=CORE.astype(np.int64)), "array-dtype"),
    "shapes of two dimensions": (lambda: small(shape=np.ones((1, 6), np.uint32)), "array-shape"),
    "core too short": (lambda: small(core=CORE[:-1]), "not-whole"),
    "float16 core too short": (lambda: changed(1, core=numbers(1, "core")[:-1]), "array-shape"),
    "core of two dimensions": (lambda: small(core=CORE.reshape(2, -1)), "array-shape"),
    "float16 core is infinite": (lambda: changed(1, core=numbers(1, "core") * np.float16(np.inf)), "not-finite"),
    "core is infinite": (lambda: small(core=np.full(CORE.size, np.inf, np.float16)), "not-whole"),
    "core is no whole number": (lambda: small(core=CORE + np.float16(0.3)), "not-whole"),
    "scales are no multiples": (
        lambda: small(core_scale=small_model()[1][0].core_scale * np.float32(1.5)),
        "not-whole",
    ),
    "a step of numbers that have none": (lambda: changed(1, step=0.5), "array-shape"),
    "a k beyond 63": (lambda: small(column=(np.full(2, 64, np.uint8), np.zeros(0, np.uint8))), "not-whole"),
    "columns missing": (lambda: small(column=()), "array-shape"),
    "child missing": (lambda: changed(0, child=None), "array-shape"),
    "child at the last stage": (lambda: changed(2, child=np.zeros(4, np.uint32)), "array-shape"),
    "a stage missing": (lambda: (half_model()[0], half_model()[1][:-1]), "array-shape"),
    "a stage too many": (lambda: (small_model()[0], small_model()[1] * 2), "array-shape"),
    "children that are not there": (lambda: changed(0, child=np.array([0, 2], np.uint32)), "child-count"),
    "a part that is not there": (
        lambda: changed(0, part=(numbers(0, "part")[0] + np.uint16(9), numbers(0, "part")[1])),
        "cluster-range",
    ),
    "positions in another order": (
        lambda: changed(0, local=(numbers(0, "local")[0][::-1].copy(), numbers(0, "local")[1])),
        "array-shape",
    ),
    "rows of nobody": (
        lambda: changed(0, row_offset=(np.array([0, 62], np.uint32), numbers(0, "row_offset")[1])),
        "row-count",
    ),
    "a shape of K above C": (lambda: small(shape=np.array([[[1, 1], [2, 0], [2, 3]]], np.uint32)), "not-whole"),
    "a float16 shape of K above C": (
        lambda: changed(1, shape=numbers(1, "shape") * np.array([1, 9, 1], np.uint32)[:, None]),
        "run-count",
    ),
    "no stages": (lambda: with_metadata(stages=()), "array-shape"),
    "unknown kind": (lambda: with_metadata(kind="brdf"), "field-value"),
    "quality missing": (lambda: with_metadata(quality=()), "field-value"),
    "quality is NaN": (lambda: with_metadata(quality=(LevelQuality(np.nan, 0.0, 0.0),)), "field-type"),
    "SNR of minus infinity": (lambda: with_metadata(quality=(LevelQuality(-np.inf, 1.0, 1.0),)), "field-type"),
    "source is no JSON": (lambda: with_metadata(source={"array": np.zeros(3)}), "field-type"),
    "source holds a set of pairs": (lambda: with_metadata(source={"set": {("a", 1)}}), "field-type"),
    "source with half a surrogate pair": (lambda: with_metadata(source={"path": "\udc80"}), "field-type"),
    "seed too large": (lambda: with_metadata(seed=2**53), "json-number"),
    "coordinates of another number": (lambda: with_coords(np.zeros(3)), "field-value"),
    "coordinates as text": (lambda: with_coords(np.array(list("abcd"))), "field-type"),
    "coordinates that are infinite": (lambda: with_coords(np.full(4, np.inf)), "field-type"),
    "coordinates with 17 numbers an index": (lambda: with_coords(np.zeros((4, 17))), "field-value"),
}


@pytest.mark.parametrize("name", INVALID)
def test_invalid_model_is_refused(name: str, tmp_path: Path) -> None:
    model, reason = INVALID[name]
    error = refusal(tmp_path / "a.hmk", *model())
    assert (error.kind, error.reason) == (Kind.INVALID_ARGUMENT, reason), error


def test_limits_bind_the_writer(tmp_path: Path) -> None:
    error = refusal(tmp_path / "a.hmk", *small_model(), limits=Limits(level_cost=1))
    assert (error.kind, error.reason) == (Kind.RESOURCE_LIMIT, "level-cost-limit")
    assert "as readers refuse more" in str(error)


def ridges() -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """Two blocks of 1500 x 1500 elements of rank 1, the columns of one undecomposed and the rows of the other."""
    size, nothing = 1500, np.zeros(2, np.uint32)

    def table(*numbers: int) -> NDArray[np.uint32]:
        return np.array(numbers, np.uint32)

    none, halves, places = np.zeros(0, np.uint16), np.zeros(0, np.float16), np.arange(size, dtype=np.uint32)
    cut = PackedLevel(
        shape=np.array([[[2, 1], [0, 0], [0, 0]]], np.uint32), child=table(0, 2),
        row_offset=(table(0, 2 * size), table(0, size)), core=halves, core_offset=nothing,
        core_scale=np.zeros(0, np.float32), cell_offset=nothing, cluster=(none, none),
        cluster_offset=(nothing, nothing), basis=(halves, halves), basis_offset=(nothing, nothing),
        part=(np.repeat(np.arange(2, dtype=np.uint16), size), np.zeros(size, np.uint16)),
        local=(np.tile(places, 2), places))
    rows, ones = table(0, size, 2 * size), np.ones(size, np.float16)
    blocks = PackedLevel(
        shape=np.array([[[1, 1], [0, 1], [size, 1]], [[1, 1], [1, 0], [1, size]]], np.uint32), child=None,
        row_offset=(rows, rows), core=np.ones(2 * size, np.float16), core_offset=rows,
        core_scale=np.ones(2, np.float32), cell_offset=table(0, 1, 2),
        cluster=(np.zeros(size, np.uint16),) * 2, cluster_offset=(table(0, 0, size), table(0, size, size)),
        basis=(ones, ones), basis_offset=(table(0, 0, size), table(0, size, size)),
        part=(None, None), local=(None, None))
    axes = name_axes((2 * size, size))
    quality = (LevelQuality(10.0, 0.1, 0.2),)
    bounds = (bounds_of(cut), bounds_of(blocks))
    return Metadata("float32", axes, separate(axes), bounds, quality=quality), (cut, blocks)


def test_limits_of_decomposed_modes_are_those_of_nodes(tmp_path: Path) -> None:
    """An element of these blocks costs a product; the largest K and R of all nodes together would cost two millions."""
    save(tmp_path / "a.hmk", *ridges())
    _, stages = load(tmp_path / "a.hmk")
    assert stages[1].shape.max(axis=0).tolist() == [[1, 1], [1, 1], [1500, 1500]]
    load(tmp_path / "a.hmk", limits=Limits(level_cost=1, rank=1))
    with pytest.raises(HmkctaError) as caught:
        load(tmp_path / "a.hmk", limits=Limits(level_cost=0))
    assert (caught.value.reason, caught.value.where) == ("level-cost-limit", "stages[1].runs[0]")
    with pytest.raises(HmkctaError) as caught:
        load(tmp_path / "a.hmk", limits=Limits(rank=0))
    assert (caught.value.reason, caught.value.where) == ("rank-limit", "stages[1].runs[0]")


def test_whoever_trusts_a_file_raises_the_limit_that_it_is_beyond(tmp_path: Path) -> None:
    save(tmp_path / "a.hmk", *small_model())
    with pytest.raises(HmkctaError, match=r"limits=hmkcta.Limits\(level_cost=2\)\)"):
        hmkcta.open(tmp_path / "a.hmk", limits=hmkcta.Limits(level_cost=1))
    assert hmkcta.open(tmp_path / "a.hmk", limits=hmkcta.Limits(level_cost=2)).ndim == 2
    with pytest.raises(HmkctaError, match=r"limits: found .*, allowed hmkcta.Limits"):
        hmkcta.open(tmp_path / "a.hmk", limits=1000)  # type: ignore[arg-type]
