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

import hmkcta
from hmkcta.axes import Axis
from hmkcta.errors import HmkctaError, Kind
from hmkcta.hmkfile import Limits, encode, load, save
from hmkcta.packed import LevelQuality, Metadata, PackedLevel
from make_fixture import eight_model, merged_model, packed_model, partly_model, small_model
from random_models import random_model

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
resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
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


def with_level(index: int, **arrays: Any) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """The small model with some arrays of one level replaced."""
    metadata, levels = small_model()
    return metadata, tuple(replace(level, **arrays) if n == index else level for n, level in enumerate(levels))


def with_eight(index: int, **changes: Any) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """The model in bytes with one level changed."""
    metadata, levels = eight_model()
    return metadata, tuple(replace(level, **changes) if n == index else level for n, level in enumerate(levels))


def with_packed(**changes: Any) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """The packed model with its first level changed."""
    metadata, (first, *others) = packed_model()
    return metadata, (replace(first, **changes), *others)


def with_rice(*rice: list[Any] | None) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """The packed model, whose first level has these parameters, mode by mode; [191, 0, 234] of mode 0 fits."""
    return with_packed(rice=tuple(None if own is None else np.array(own, np.uint8) for own in rice))


def without_one_rice(model: tuple[Metadata, tuple[PackedLevel, ...]]) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """The model, whose second level is packed, without the parameters of mode 1."""
    metadata, (first, second, third) = model
    return metadata, (first, replace(second, rice=(second.rice[0], None, None)), third)


def packed_core(number: float) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """The packed model, all core numbers of its first level this one."""
    return with_packed(core=np.full(27, number, np.float16))


def packed_basis(number: float) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """The packed model, all basis numbers of its first level this one."""
    return with_packed(basis=(np.full(30, number, np.float16), None))


def whole_packed() -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """A packed level in bytes that has no decomposed mode."""
    metadata, levels = random_model(np.random.default_rng(0), (3, 2), 1, (0, 1), eight_from=1)
    return metadata, (replace(levels[0], rice=(None, None)),)


def float16_below(metadata: Metadata, levels: tuple[PackedLevel, ...]) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """The packed model with a last level of 16-bit numbers."""
    return metadata, (levels[0], replace(levels[1], bits=16, rice=()))


def with_metadata(**values: Any) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """The small model with some metadata replaced."""
    metadata, levels = small_model()
    return replace(metadata, **values), levels


def without_last(metadata: Metadata, levels: tuple[PackedLevel, ...]) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """The model without the arrays of its last level."""
    return metadata, levels[:-1]


INVALID: dict[str, tuple[Callable[[], tuple[Metadata, tuple[PackedLevel, ...]]], str]] = {
    "core is float32": (lambda: with_level(0, core=np.zeros(18, np.float32)), "array-dtype"),
    "shapes of two dimensions": (lambda: with_level(0, shape=np.ones((1, 6), np.uint32)), "array-shape"),
    "core is int64": (lambda: with_level(0, core=np.zeros(18, np.int64)), "array-dtype"),
    "core too short": (lambda: with_level(0, core=np.zeros(17, np.float16)), "offset-end"),
    "core of two dimensions": (lambda: with_level(0, core=np.zeros((3, 6), np.float16)), "array-shape"),
    "core is infinite": (lambda: with_level(0, core=np.full(18, np.inf, np.float16)), "not-finite"),
    "core is bytes": (lambda: with_level(0, core=np.zeros(18, np.int8)), "array-dtype"),
    "core in bytes is float32": (lambda: with_eight(0, core=np.zeros(18, np.float32)), "array-dtype"),
    "core in bytes is infinite": (lambda: with_eight(1, core=np.full(15, np.inf, np.float16)), "not-finite"),
    "core in bytes is none of them": (lambda: with_eight(0, core=np.full(18, 0.3, np.float16)), "array-dtype"),
    "float16 after bytes": (lambda: with_eight(1, bits=16), "array-dtype"),
    "child missing": (lambda: with_level(0, child=None), "array-missing"),
    "child at the last level": (lambda: with_level(1, child=np.zeros(4, np.uint32)), "array-unexpected"),
    "level missing": (lambda: without_last(*small_model()), "array-missing"),
    "level of bytes missing": (lambda: without_last(*eight_model()), "array-missing"),
    "level too many, of bytes": (lambda: (eight_model()[0], eight_model()[1] * 2), "array-unexpected"),
    "child of bytes missing": (lambda: with_eight(0, child=None), "array-missing"),
    "child of bytes too long": (lambda: with_eight(0, child=np.array([0, 3, 3], np.uint32)), "array-shape"),
    "cluster of bytes missing": (lambda: with_eight(0, cluster=(None, None)), "array-missing"),
    "basis of bytes missing": (lambda: with_eight(0, basis=(None, None)), "array-missing"),
    "row offsets of bytes missing": (lambda: with_eight(0, row_offset=(np.zeros(0, np.uint32),) * 2), "array-shape"),
    "parameters too few": (lambda: with_rice([191, 0], None), "array-shape"),
    "no parameters": (lambda: with_rice([], None), "array-shape"),
    "parameters too many": (lambda: with_rice([191, 0, 234, 234], None), "array-shape"),
    "parameters of two dimensions": (lambda: with_rice([[191, 0, 234]], None), "array-shape"),
    "parameters of modes too few": (lambda: with_rice([191, 0, 234]), "array-shape"),
    "parameters of modes too many": (lambda: with_rice([191, 0, 234], None, None), "array-shape"),
    "column of a parameter too small for its numbers": (lambda: with_rice([191, 0, 224], None), "array-dtype"),
    "core numbers of a parameter too small": (lambda: with_rice([191, 0, 218], None), "array-dtype"),
    "parameters are int64": (lambda: with_packed(rice=(np.array([191, 0, 234]), None)), "array-dtype"),
    "parameters are signed": (lambda: with_packed(rice=(np.array([15, 0, 10], np.int8), None)), "array-dtype"),
    "parameters of an undecomposed mode": (lambda: with_rice([191, 0, 234], [167] * 3), "array-unexpected"),
    "parameters of an undecomposed mode alone": (lambda: with_rice(None, [167] * 3), "array-missing"),
    "parameters of one mode missing": (lambda: without_one_rice(partly_model()), "array-missing"),
    "parameters missing": (lambda: with_packed(rice=()), "array-dtype"),
    "parameters beside 16-bit numbers": (
        lambda: with_level(0, rice=(np.full(2, 167, np.uint8), None)), "array-unexpected"),
    "parameters above bytes beside 16-bit numbers": (lambda: with_packed(bits=16), "array-unexpected"),
    "packed level without decomposed modes": (whole_packed, "array-dtype"),
    "packed shapes of two dimensions": (lambda: with_packed(shape=np.ones((1, 6), np.uint32)), "array-shape"),
    "packed shape of another rank": (lambda: with_packed(shape=np.array([[[3, 1], [2, 1], [2, 3]]], np.uint32)),
                                     "array-shape"),
    "packed shape of more clusters": (lambda: with_packed(shape=np.array([[[4, 1], [2, 1], [3, 3]]], np.uint32)),
                                      "level-bounds"),
    "packed core too short": (lambda: with_packed(core=np.zeros(26, np.float16)), "offset-end"),
    "packed core of two dimensions": (lambda: with_packed(core=np.zeros((3, 9), np.float16)), "array-shape"),
    "packed core is none of its numbers": (lambda: packed_core(2.0**-17), "array-dtype"),
    "packed core is infinite": (lambda: packed_core(np.inf), "not-finite"),
    "packed core is minus infinity": (lambda: packed_core(-np.inf), "not-finite"),
    "packed core is not a number": (lambda: packed_core(np.nan), "not-finite"),
    "packed core is larger than any code": (lambda: packed_core(6), "array-dtype"),
    "packed core is far larger": (lambda: packed_core(65504), "array-dtype"),
    "packed core is far below": (lambda: packed_core(-65504), "array-dtype"),
    "packed core offsets of more": (lambda: with_packed(core_offset=np.array([0, 54], np.uint32)), "offset-size"),
    "packed basis missing": (lambda: with_packed(basis=(None, None)), "array-unexpected"),
    "packed basis too short": (lambda: with_packed(basis=(np.zeros(29, np.float16), None)), "offset-end"),
    "packed basis offsets that descend": (
        lambda: with_packed(basis_offset=(np.array([30, 0], np.uint32), None)), "offset-order"),
    "packed basis is none of its numbers": (lambda: packed_basis(0.3), "array-dtype"),
    "packed basis is larger than any code": (lambda: packed_basis(8200), "array-dtype"),
    "packed basis is far larger": (lambda: packed_basis(65504), "array-dtype"),
    "packed basis is infinite": (lambda: packed_basis(np.inf), "not-finite"),
    "packed basis is not a number": (lambda: packed_basis(np.nan), "not-finite"),
    "float16 after packed numbers": (lambda: float16_below(*packed_model()), "array-dtype"),
    "no levels": (lambda: with_metadata(levels=()), "field-value"),
    "unknown kind": (lambda: with_metadata(kind="brdf"), "field-value"),
    "quality missing": (lambda: with_metadata(quality=()), "field-value"),
    "quality is NaN": (lambda: with_metadata(quality=(LevelQuality(np.nan, 0.0, 0.0),) * 2), "field-type"),
    "SNR of minus infinity": (lambda: with_metadata(quality=(LevelQuality(-np.inf, 1.0, 1.0),) * 2), "field-type"),
    "source is no JSON": (lambda: with_metadata(source={"array": np.zeros(3)}), "field-type"),
    "source holds an array of pairs": (lambda: with_metadata(source={"array": np.ones((2, 2))}), "field-type"),
    "source holds a set of pairs": (lambda: with_metadata(source={"set": {("a", 1)}}), "field-type"),
    "source with half a surrogate pair": (lambda: with_metadata(source={"path": "\udc80"}), "field-type"),
    "seed too large": (lambda: with_metadata(seed=2**53), "json-number"),
    "coordinates of another number": (lambda: with_metadata(axes=(
        Axis("höhe", 4, "space", np.zeros(3)), small_model()[0].axes[1])), "field-value"),
    "coordinates as text": (lambda: with_metadata(axes=(
        Axis("höhe", 4, "space", np.array(list("abcd"))), small_model()[0].axes[1])), "field-type"),
    "coordinates that are infinite": (lambda: with_metadata(axes=(
        Axis("höhe", 4, "space", np.full(4, np.inf)), small_model()[0].axes[1])), "field-type"),
    "coordinates with 17 numbers an index": (lambda: with_metadata(axes=(
        Axis("höhe", 4, "space", np.zeros((4, 17))), small_model()[0].axes[1])), "array-shape"),
}


@pytest.mark.parametrize("name", INVALID)
def test_invalid_model_is_refused(name: str, tmp_path: Path) -> None:
    model, reason = INVALID[name]
    error = refusal(tmp_path / "a.hmk", *model())
    assert (error.kind, error.reason) == (Kind.INVALID_ARGUMENT, reason), error


@pytest.mark.parametrize("rice", [[191, 0, 234], [191, 0, 236], [191, 9, 234], [191, 144, 234], [207, 0, 234]])
def test_columns_may_have_larger_parameters_than_need_be(rice: list[int], tmp_path: Path) -> None:
    model = with_rice(rice, None)
    save(tmp_path / "a.hmk", *model)
    level = load(tmp_path / "a.hmk")[1][0]
    assert [None if own is None else own.tolist() for own in level.rice] == [rice, None]
    np.testing.assert_array_equal(level.basis[0], model[1][0].basis[0])
    np.testing.assert_array_equal(level.core, model[1][0].core)


@pytest.mark.parametrize("k", range(16))
def test_all_numbers_that_are_read_can_be_written(k: int, tmp_path: Path) -> None:
    """Also the largest ones in 16 bits and in fewer, which float16 rounds up."""
    most = (1 << 15, 6 << k)
    whole = np.array([0, 1, -1, *(-own for own in most), *(own - 1 for own in most)])
    numbers = (np.resize(whole, 57) / 2.0 ** (k + 2)).astype(np.float16)
    model = with_packed(core=numbers[:27], basis=(numbers[27:], None), rice=(np.full(3, 17 * k, np.uint8), None))
    save(tmp_path / "a.hmk", *model)
    again = load(tmp_path / "a.hmk")
    np.testing.assert_array_equal(again[1][0].core, numbers[:27])
    np.testing.assert_array_equal(again[1][0].basis[0], numbers[27:])
    save(tmp_path / "b.hmk", *again)
    assert (tmp_path / "a.hmk").read_bytes() == (tmp_path / "b.hmk").read_bytes()


def test_limits_bind_the_writer(tmp_path: Path) -> None:
    error = refusal(tmp_path / "a.hmk", *small_model(), limits=Limits(rank=1))
    assert (error.kind, error.reason) == (Kind.RESOURCE_LIMIT, "rank-limit")
    assert "as readers refuse more" in str(error)


def test_whoever_trusts_a_file_raises_the_limit_that_it_is_beyond(tmp_path: Path) -> None:
    save(tmp_path / "a.hmk", *small_model())
    with pytest.raises(HmkctaError, match=r"limits=hmkcta.Limits\(level_cost=4\)\)"):
        hmkcta.open(tmp_path / "a.hmk", limits=hmkcta.Limits(level_cost=3))
    assert hmkcta.open(tmp_path / "a.hmk", limits=hmkcta.Limits(level_cost=4)).ndim == 2
    with pytest.raises(HmkctaError, match=r"limits: found .*, allowed hmkcta.Limits"):
        hmkcta.open(tmp_path / "a.hmk", limits=1000)  # type: ignore[arg-type]


@pytest.mark.parametrize("exponent", [-30, -9, 0, 9, 10, 13, 16, 30])
def test_how_large_errors_are_does_not_change_the_size_of_a_file(exponent: int) -> None:
    values = np.random.default_rng(0).standard_normal((5, 6, 7)) * 10.0**exponent
    model = hmkcta.compress(values.astype(np.float32), "R=2")
    pieces = encode(model.metadata, model.levels)
    assert sum(map(len, pieces)) == model.nbytes == hmkcta.compress(values / 10.0**exponent, "R=2").nbytes


def test_encode_shares_memory() -> None:
    metadata, levels = merged_model()
    pieces = encode(metadata, levels)
    assert any(np.shares_memory(np.frombuffer(piece, np.uint8), levels[0].core) for piece in pieces if len(piece))
