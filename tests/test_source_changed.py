"""A source that is rewritten, replaced, removed or cut short while it is read: never a file of no state of it."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hmkcta
from cli_tools import finish, refused, report, run, saved, smooth, start
from hmkcta import HmkctaError
from hmkcta.errors import Kind
from hmkcta.support.cut_short import file_map, whole_map

PLAN = ("--plan", "R=2")
ONE, OTHER = smooth(6, 40, 32), smooth(6, 40, 32)[:, ::-1].copy()


def write_npy(path: Path, array: NDArray[Any]) -> str:
    """In place: who has mapped the file sees it."""
    with open(path, "r+b" if path.exists() else "wb") as file:
        np.save(file, array)
    return str(path)


def write_raw(path: Path, array: NDArray[Any]) -> str:
    with open(path, "r+b" if path.exists() else "wb") as file:
        file.write(array.tobytes())
    return str(path)


def write_hdf5(path: Path, array: NDArray[Any], **how: Any) -> str:
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "a") as file:
        if "a" in file:
            file["a"][...] = array
        else:
            file.create_dataset("a", data=array, **how)
    return str(path)


def write_chunked(path: Path, array: NDArray[Any]) -> str:
    return write_hdf5(path, array, chunks=(1, 40, 32), compression="gzip")


def write_virtual(path: Path, array: NDArray[Any]) -> str:
    """The numbers are in another file, which is the one that changes."""
    h5py = pytest.importorskip("h5py")
    write_hdf5(path.with_name("numbers.h5"), array)
    if not path.exists():
        layout = h5py.VirtualLayout(array.shape, array.dtype)
        layout[...] = h5py.VirtualSource("numbers.h5", "a", array.shape)
        with h5py.File(path, "w") as file:
            file.create_virtual_dataset("a", layout)
    return str(path)


def write_zarr(path: Path, array: NDArray[Any]) -> str:
    zarr = pytest.importorskip("zarr")
    if path.exists():
        zarr.open(str(path), mode="r+")[...] = array
    else:
        zarr.create_array(str(path), data=array, chunks=(1, 40, 32))
    return str(path)


def write_pictures(path: Path, array: NDArray[Any]) -> str:
    image = pytest.importorskip("PIL.Image")
    path.mkdir(exist_ok=True)
    for number, page in enumerate(np.asarray(array * 9, np.uint8)):
        image.fromarray(page).save(path / f"page{number}.png")
    return str(path)


def write_stack(path: Path, array: NDArray[Any]) -> str:
    """A pattern of mapped files."""
    path.mkdir(exist_ok=True)
    for number, page in enumerate(array):
        write_npy(path / f"page{number}.npy", page)
    return f"{path}/*.npy"


def write_nifti(path: Path, array: NDArray[Any]) -> str:
    nibabel = pytest.importorskip("nibabel")
    nibabel.save(nibabel.Nifti1Image(array, np.eye(4)), str(path))
    return str(path)


def write_tiff(path: Path, array: NDArray[Any]) -> str:
    pytest.importorskip("tifffile").imwrite(path, array)
    return str(path)


WRITERS: dict[str, Callable[[Path, NDArray[Any]], str]] = {
    "a.npy": write_npy, "a.raw": write_raw, "a.h5": write_hdf5, "chunked.h5": write_chunked,
    "virtual.h5": write_virtual, "a.zarr": write_zarr, "pictures": write_pictures, "stack": write_stack,
    "a.nii.gz": write_nifti, "a.tif": write_tiff,
}
RAW = ("--shape", "6,40,32", "--dtype", "float32")


def during_fit(monkeypatch: pytest.MonkeyPatch, happens: Callable[[], object]) -> None:
    """Let something happen once values have been looked at, before the fit."""
    import hmkcta.encode as encode

    fit_plan = encode.fit_plan

    def fitted(*words: Any, **options: Any) -> Any:
        happens()
        return fit_plan(*words, **options)

    monkeypatch.setattr(encode, "fit_plan", fitted)


@pytest.mark.parametrize("name", WRITERS)
def test_a_source_rewritten_during_the_fit_is_refused(name: str, tmp_path: Path,
                                                      monkeypatch: pytest.MonkeyPatch) -> None:
    source = WRITERS[name](tmp_path / name, ONE)
    during_fit(monkeypatch, lambda: WRITERS[name](tmp_path / name, OTHER))
    words = RAW if name == "a.raw" else ()
    sentence = refused("compress", source, "-o", tmp_path / "a.hmk", *PLAN, *words, code=8)
    assert "changed while" in sentence
    assert sentence.endswith("[SourceChanged/source-changed]")
    assert not (tmp_path / "a.hmk").exists()
    assert not (tmp_path / "a.hmk.partial").exists(), "what is kept is of two states of the source"


@pytest.mark.parametrize("name", WRITERS)
def test_a_source_written_again_as_it_was_is_the_same(name: str, tmp_path: Path,
                                                      monkeypatch: pytest.MonkeyPatch) -> None:
    source = WRITERS[name](tmp_path / name, ONE)
    during_fit(monkeypatch, lambda: WRITERS[name](tmp_path / name, ONE))
    run("compress", source, "-o", tmp_path / "a.hmk", *PLAN, *(RAW if name == "a.raw" else ()))


def test_a_source_replaced_by_another_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By renaming: what was mapped stays as it was, and the name now has other values."""
    source = saved(tmp_path / "a.npy", ONE)
    saved(tmp_path / "b.npy", OTHER)
    during_fit(monkeypatch, lambda: os.replace(tmp_path / "b.npy", source))
    refused("compress", source, "-o", tmp_path / "a.hmk", *PLAN, code=8)


def test_a_source_that_is_removed_is_what_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file that is made of it is then all there is."""
    source = saved(tmp_path / "a.npy", ONE)
    during_fit(monkeypatch, source.unlink)
    result = run("compress", source, "-o", tmp_path / "a.hmk", *PLAN)
    assert "no longer there" in result.stderr
    assert (tmp_path / "a.hmk").exists()


def test_a_picture_more_is_a_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = Path(write_pictures(tmp_path / "pictures", ONE))
    during_fit(monkeypatch, lambda: shutil.copy(source / "page1.png", source / "page9.png"))
    refused("compress", source, "-o", tmp_path / "a.hmk", *PLAN, code=8)


def test_a_change_while_it_is_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import hmkcta.readers.unpacked as unpacked

    source = write_chunked(tmp_path / "a.h5", ONE)
    unpack = unpacked.Unpacker.array

    def changed(*words: Any) -> Any:
        os.utime(source)
        return unpack(*words)

    monkeypatch.setattr(unpacked.Unpacker, "array", changed)
    refused("compress", source, "-o", tmp_path / "a.hmk", *PLAN, code=8)


@pytest.mark.parametrize("command", ["verify", "plan"])
def test_other_commands_look_too(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = saved(tmp_path / "a.npy", ONE)
    run("compress", source, "-o", tmp_path / "a.hmk", *PLAN)
    import hmkcta.cli.verify as verify
    import hmkcta.encode as encode

    def after(work: Callable[..., Any]) -> Callable[..., Any]:
        def worked(*words: Any, **options: Any) -> Any:
            write_npy(source, OTHER)
            return work(*words, **options)

        return worked

    monkeypatch.setattr(encode, "estimate_model", after(encode.estimate_model))
    monkeypatch.setattr(verify, "measure_both", after(verify.measure_both))
    if command == "plan":
        refused("plan", source, code=8)
    else:  # which has measured what is there now
        result = run("verify", tmp_path / "a.hmk", "--against", source, code=4)
        assert "their SHA-256 differ" in result.stderr


def test_in_python_an_array_that_changes_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    array = ONE.copy()

    def change() -> None:
        array[...] = OTHER

    during_fit(monkeypatch, change)
    with pytest.raises(HmkctaError) as caught:
        hmkcta.compress(array, "R=2")
    assert (caught.value.kind, caught.value.reason) == (Kind.SOURCE_CHANGED, "source-changed")


def test_a_long_fit_ends_early(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import hmkcta.streaming.steady as steady

    monkeypatch.setattr(steady, "EVERY", 0.0)
    source = saved(tmp_path / "a.npy", ONE)
    plan, calls = "R=4 C=2 K=1 / R=2 C=2 K=1", 0

    def progress(*_: object) -> None:
        nonlocal calls
        calls += 1
        if calls == changed_at:
            write_npy(source, OTHER)

    changed_at = 0
    hmkcta.compress(np.load(source, mmap_mode="r"), plan, progress=progress)
    whole, calls, changed_at = calls, 0, 3
    with pytest.raises(HmkctaError, match="source-changed"):
        hmkcta.compress(np.load(source, mmap_mode="r"), plan, progress=progress)
    assert calls < whole


# Cut short under a map

needs_signals = pytest.mark.skipif(os.name != "posix", reason="elsewhere a mapped file cannot be cut short")

CUT = """
import os
import hmkcta.encode as e, hmkcta.cli.verify as v
fit_plan, measure = e.fit_plan, v.measure_both
def cut(work):
    def worked(*a, **k):
        os.truncate({path!r}, 5000)
        return work(*a, **k)
    return worked
e.fit_plan, v.measure_both = cut(fit_plan), cut(measure)
"""


@needs_signals
@pytest.mark.parametrize("command", ["compress", "verify"])
def test_a_source_cut_short_ends_in_a_sentence(command: str, tmp_path: Path) -> None:
    source = saved(tmp_path / "a.npy", ONE)
    run("compress", source, "-o", tmp_path / "a.hmk", *PLAN)
    words = ("compress", source, "-o", tmp_path / "b.hmk", *PLAN)
    if command == "verify":
        words = ("verify", tmp_path / "a.hmk", "--against", source)
    code, out, err = finish(start(*words, before=CUT.format(path=str(source))))
    assert (code, out) == (8, ""), err
    assert "has become shorter" in err
    assert "Traceback" not in err
    assert not (tmp_path / "b.hmk").exists()


@needs_signals
def test_in_python_a_map_that_was_cut_short_is_never_taken_again(tmp_path: Path) -> None:
    source = saved(tmp_path / "a.npy", ONE)
    array = np.load(source, mmap_mode="r")
    with pytest.raises(HmkctaError, match="source-cut-short"), whole_map(array):  # noqa: PT012
        os.truncate(source, 5000)
        assert float(array[-1].sum()) == 0
    os.truncate(source, 128 + ONE.nbytes)
    for _ in range(2):
        with pytest.raises(HmkctaError, match="source-cut-short"):
            hmkcta.compress(array, "R=2")
    assert file_map(array[2:, ::3].T) is file_map(array)


@needs_signals
def test_a_stack_of_files_of_which_one_is_cut_short(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import hmkcta.readers.series as series

    pattern = write_stack(tmp_path / "stack", np.repeat(ONE, 64, axis=1))
    layout = series.Layout

    def cut(*words: Any) -> Any:
        os.truncate(tmp_path / "stack" / "page0.npy", 5000)
        return layout(*words)

    monkeypatch.setattr(series, "Layout", cut)
    monkeypatch.setattr(series, "drop_pages", print)
    with pytest.raises(HmkctaError) as caught:
        hmkcta.open_array(pattern)
    assert caught.value.reason in ("source-cut-short", "source-truncated")


# `verify --against` another source


def test_verify_knows_the_source_by_its_fingerprint(tmp_path: Path) -> None:
    """Another source of like quality is said to be one, with the figures."""
    source = saved(tmp_path / "a.npy", ONE)
    run("compress", source, "-o", tmp_path / "a.hmk", *PLAN)
    near = ONE.copy()
    near[3, 4, 5] *= np.float32(1.00001)
    other = saved(tmp_path / "b.npy", near)
    sentence = refused_after_report("verify", tmp_path / "a.hmk", "--against", other, code=9)
    model = hmkcta.open(tmp_path / "a.hmk")
    assert "not the array" in sentence
    assert sentence.count(f"{model.snr:.2f} dB") == 2
    assert sentence.endswith("[OtherSource/source-differs]")
    error = report("verify", tmp_path / "a.hmk", "--against", other, code=9)["error"]
    assert (error["kind"], error["reason"], error["exit_code"]) == ("OtherSource", "source-differs", 9)
    assert report("verify", tmp_path / "a.hmk", "--against", source)["made_from_source"] is True


def refused_after_report(*words: object, code: int) -> str:
    """The sentence of a command that has shown its figures."""
    return run(*words, code=code).stderr.splitlines()[-1]


@pytest.mark.parametrize("how", ["float64", "big-endian", "Fortran order", "raw", "uint8 as float32"])
def test_the_same_values_stored_otherwise_are_the_same_source(how: str, tmp_path: Path) -> None:
    array = np.asarray(ONE * 9, np.uint8) if how.startswith("uint8") else ONE
    run("compress", saved(tmp_path / "a.npy", array), "-o", tmp_path / "a.hmk", *PLAN)
    other = {"float64": array.astype(np.float64), "big-endian": array.astype(">f4"),
             "Fortran order": np.asfortranarray(array), "raw": array, "uint8 as float32": array.astype(np.float32)}[how]
    words: tuple[object, ...] = (saved(tmp_path / "b.npy", other),)
    if how == "raw":
        words = (write_raw(tmp_path / "b.raw", array), *RAW)
    assert report("verify", tmp_path / "a.hmk", "--against", *words)["made_from_source"] is True
