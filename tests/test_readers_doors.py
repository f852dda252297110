"""What tells a format, what is missing, where a path ends and a member begins; and the command line on some."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hmkcta
from cli_tools import finish, refused, report, run, smooth, start
from hmkcta.cli.progress import Progress
from hmkcta.errors import HmkctaError, Kind
from hmkcta.readers import open_array, source_files
from hmkcta.readers.formats import FORMATS
from hmkcta.readers.source import Layout
from hmkcta.readers.unpacked import Unpacker, block_parts
from reader_tools import VALUES, little_memory, needed, refusal, same

#: The start of a file of each format, its library, the reason that this is missing, and what brings it.
LIBRARIES = [
    ("a.h5", b"\x89HDF\r\n\x1a\n", "h5py", "h5py-missing", "hdf5"),
    ("a.nii", bytes(344) + b"n+1\0", "nibabel", "nibabel-missing", "nifti"),
    ("a.nrrd", b"NRRD0004\n", "nrrd", "pynrrd-missing", "nrrd"),
    ("a.tif", b"II*\0", "tifffile", "tifffile-missing", "tiff"),
    ("a.exr", b"\x76\x2f\x31\x01", "OpenEXR", "openexr-missing", "exr"),
    ("a.png", b"\x89PNG\r\n\x1a\n", "PIL.Image", "pillow-missing", "images"),
    ("a.fits", b"SIMPLE  =                    T", "astropy.io.fits", "astropy-missing", "fits"),
    ("a.zarr", None, "zarr", "zarr-missing", "zarr"),
]


@pytest.mark.parametrize(("name", "start", "module", "reason", "extra"), LIBRARIES, ids=[row[0] for row in LIBRARIES])
def test_a_missing_library_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, start: bytes | None, module: str, reason: str,
    extra: str,
) -> None:
    if start is None:
        (tmp_path / name).mkdir()
        (tmp_path / name / "zarr.json").write_text("{}")
    else:
        (tmp_path / name).write_bytes(start)
    monkeypatch.setitem(sys.modules, module, None)
    error = refusal(tmp_path / name)
    assert (error.kind, error.reason) == (Kind.INVALID_ARGUMENT, reason)
    assert f'pip install "hmkcta[{extra}]"' in str(error)


def test_extras_bring_what_errors_name() -> None:
    text = (Path(__file__).parent.parent / "pyproject.toml").read_text(encoding="utf-8")
    extras = tomllib.loads(text)["project"]["optional-dependencies"]
    together = extras["formats"][0].partition("[")[2].rstrip("]").split(",")
    assert sorted(together) == sorted(row[-1] for row in LIBRARIES)
    for *_, reason, extra in LIBRARIES:
        assert any(each.lower().startswith(f"{reason.removesuffix('-missing')}>=") for each in extras[extra])


def test_a_broken_library_is_told_from_a_missing_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "h5py.py").write_text("raise ValueError('numpy is too old')")
    (tmp_path / "a.h5").write_bytes(b"\x89HDF\r\n\x1a\n")
    for module in [name for name in sys.modules if name.partition(".")[0] == "h5py"]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setattr(sys, "path", [str(tmp_path), *sys.path])
    error = refusal(tmp_path / "a.h5")
    assert error.reason == "h5py-missing"
    assert "h5py cannot be loaded: numpy is too old" in str(error)


def test_no_library_is_loaded_before_its_format_comes() -> None:
    program = ("import sys, hmkcta.readers; print([name for name in ('h5py', 'zarr', 'numcodecs', 'nibabel', 'nrrd', "
               "'tifffile', 'imagecodecs', 'OpenEXR', 'PIL', 'astropy', 'scipy') if name in sys.modules])")
    path = str(Path(hmkcta.__file__).parent.parent)
    done = subprocess.run([sys.executable, "-c", f"import sys; sys.path.insert(0, {path!r}); {program}"],
                          capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("ending", sorted({ending for each in FORMATS for ending in each.endings}))
def test_empty_files_and_other_contents_are_refused(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"a{ending}"
    path.write_bytes(b"")
    assert refusal(path).reason == "source-damaged"
    path.write_bytes(b"\1" * 5000)
    assert refusal(path).kind is Kind.IO


@pytest.mark.parametrize("name", ["a.png", "a.exr", "a.npy", "a.nrrd", "a.nii"])
def test_a_member_of_a_file_that_has_none(tmp_path: Path, name: str) -> None:
    starts = {row[0]: row[1] for row in LIBRARIES}
    (tmp_path / name).write_bytes(starts.get(name) or b"\x93NUMPY\x01\0")
    if name == "a.exr":
        needed("OpenEXR")
        assert refusal(f"{tmp_path}/{name}:diffuse").reason == "source-damaged"
    else:
        assert refusal(f"{tmp_path}/{name}:wood").reason == "source-member"


def test_a_file_of_that_name_comes_before_a_member(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", VALUES)
    (tmp_path / "a.npy").rename(tmp_path / "a.h5:x")
    same(tmp_path / "a.h5:x", VALUES, mapped=True)
    np.savez(tmp_path / "b.npz", wood=-VALUES)
    same(f"{tmp_path}/b.npz:wood", -VALUES, mapped=True)
    assert refusal(f"{tmp_path}/gone.h5:/a:b").where == f"{tmp_path}/gone.h5"
    assert refusal(f"{tmp_path}/gone:b").where == f"{tmp_path}/gone:b"


def test_files_that_a_uri_names(tmp_path: Path) -> None:
    for name in ("1.npy", "2.npy"):
        np.save(tmp_path / name, VALUES)
    assert source_files(f"{tmp_path}/1.npy:x") == [tmp_path / "1.npy"]
    assert sorted(source_files(f"{tmp_path}/*.npy")) == [tmp_path / "1.npy", tmp_path / "2.npy"]


@pytest.mark.parametrize("shape", [(1,), (7, 5), (3, 4, 5), (2, 1, 9, 4)])
@pytest.mark.parametrize("limit", [1, 4, 11, 1000])
def test_blocks_cover_an_array_once(shape: tuple[int, ...], limit: int) -> None:
    for chunks in (shape, tuple(min(2, size) for size in shape), (1,) * len(shape)):
        seen = np.zeros(shape, int)
        order: list[int] = []
        for part in block_parts(shape, chunks, limit):
            seen[part] += 1
            order += np.arange(seen.size).reshape(shape)[part].ravel().tolist()
            assert seen[part].size <= max(limit, int(np.prod(chunks)))
            assert all(span.start % chunk == 0 for span, chunk in zip(part, chunks, strict=True))
        assert (seen == 1).all()
        if set(chunks) == {1}:
            assert order == sorted(order)


def test_unpacking_stays_within_memory_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    little_memory(monkeypatch, 64_000)
    largest = 0

    class Ones:
        shape, dtype = (300, 400), np.dtype(">i4")

        def __getitem__(self, part: tuple[slice, ...]) -> Any:
            nonlocal largest
            block = np.ones([span.stop - span.start for span in part], ">i4")
            largest = max(largest, block.nbytes)
            return block

    array = Unpacker().chunks("ones", Ones(), (3, 7))
    assert isinstance(array, np.memmap)
    assert not array.flags.writeable
    assert array.sum() == 120_000
    assert 0 < largest <= 8_000
    assert not list(tmp_path.iterdir())


def test_no_room_for_unpacking_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    little_memory(monkeypatch, 1000)
    layout = Layout((300, 400), np.dtype("u1"))

    def full(folder: object) -> SimpleNamespace:
        del folder
        return SimpleNamespace(free=100_000)

    for folder, usage, reason in ((tmp_path / "gone", shutil.disk_usage, "scratch"), (tmp_path, full, "scratch-full")):
        monkeypatch.setattr(tempfile, "tempdir", str(folder))
        monkeypatch.setattr(shutil, "disk_usage", usage)
        with pytest.raises(HmkctaError, match="TMPDIR") as caught:
            Unpacker().array("ones", layout, [(slice(0, 300), slice(0, 400))], lambda _: np.ones(()))
        assert (caught.value.kind, caught.value.reason) == (Kind.IO, reason)


@pytest.mark.parametrize(("number", "works"), [(errno.EOPNOTSUPP, True), (errno.EINVAL, True), (errno.ENOSPC, False)])
def test_room_is_set_aside_where_the_system_can(monkeypatch: pytest.MonkeyPatch, number: int, works: bool) -> None:
    def unable(*_: int) -> None:
        raise OSError(number, "no")

    little_memory(monkeypatch, 1000)
    monkeypatch.setattr(os, "posix_fallocate", unable, raising=False)
    layout, parts = Layout((30, 40), np.dtype("u1")), [(slice(0, 30), slice(0, 40))]
    if works:
        assert Unpacker().array("ones", layout, parts, lambda _: np.ones(())).sum() == 1200
    else:
        with pytest.raises(HmkctaError, match="scratch-full"):
            Unpacker().array("ones", layout, parts, lambda _: np.ones(()))


def test_unpacking_tells_how_far_it_is(tmp_path: Path) -> None:
    for number in range(4):
        with needed("h5py").File(tmp_path / f"{number}.h5", "w") as file:
            file.create_dataset("a", data=np.full((6, 20), number, ">i4"), chunks=(1, 20))
    told: list[tuple[str, float]] = []

    def note(stage: str, fraction: float) -> None:
        told.append((stage, fraction))

    for uri, steps in ((f"{tmp_path}/1.h5", 3), (f"{tmp_path}/*.h5", 4)):  # two rows fit, of files each counts as one
        hmkcta.open_array(uri, max_memory=8 * 40 * 4, progress=note)
        assert told == [("unpacking", (n + 1) / steps) for n in range(steps)]
        told.clear()


def test_commands_show_that_they_unpack(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with needed("h5py").File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("a", data=smooth(8, 9, 10), chunks=(1, 9, 10))
    stages: list[str] = []

    def note(_: Progress, stage: str, fraction: float) -> None:
        stages.append(f"{stage} {fraction:g}")

    monkeypatch.setattr(Progress, "__call__", note)
    monkeypatch.setattr("hmkcta.serve.installed_page", dict)
    monkeypatch.setattr("hmkcta.serve.Server.wait", hmkcta.serve.Server.close)
    source, output = tmp_path / "a.h5", tmp_path / "a.hmk"
    for words in (("compress", source, "-o", output), ("plan", source), ("verify", output, "--against", source),
                  ("render", output, "--against", source, "--split", 0, "-o", tmp_path / "a.png"),
                  ("view", output, "--original", source, "--no-browser")):
        run(*words)
        assert stages[0] == "unpacking 1", words
        stages.clear()


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
def test_unpacking_can_be_interrupted(tmp_path: Path) -> None:
    for number in range(2):
        np.save(tmp_path / f"{number}.npy", VALUES)
    before = """
import signal, time
import hmkcta.readers.series as s
def slow(array):
    signal.raise_signal(signal.SIGINT)
    time.sleep(60)
s.drop_pages = slow
"""
    code, out, err = finish(start("compress", f"{tmp_path}/*.npy", "-o", tmp_path / "a.hmk", before=before))
    assert (code, out) == (130, "")
    assert err.startswith("hmkcta: interrupted")
    assert not (tmp_path / "a.hmk").exists()


@pytest.mark.parametrize("fortran", [False, True])
def test_packed_archives_go_to_a_file_where_memory_is_scarce(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fortran: bool
) -> None:
    values = np.array(VALUES, order="F" if fortran else "C")
    np.savez_compressed(tmp_path / "a.npz", a=values)
    same(tmp_path / "a.npz", values)
    little_memory(monkeypatch, 2 * values.nbytes)
    same(tmp_path / "a.npz", values, mapped=True)


@pytest.mark.parametrize(("words", "reason"), [
    ({"order": "F"}, "raw-description"), ({"offset": 8}, "raw-description"),
    ({"offset": 8, "shape": (3, 4, 5)}, "raw-description"),
    ({"shape": (3, 4, 5), "dtype": "f4", "member": "a"}, "source-member"),
])
def test_a_description_of_raw_binary_is_never_passed_over(
    tmp_path: Path, words: dict[str, Any], reason: str
) -> None:
    np.save(tmp_path / "a.npy", VALUES)
    assert refusal(tmp_path / "a.npy", **words).reason == reason


def test_nor_is_one_of_an_array_that_is_not_named(tmp_path: Path) -> None:
    hmkcta.compress(VALUES, "R=2").save(tmp_path / "a.hmk")
    for words in (("verify", tmp_path / "a.hmk"), ("render", tmp_path / "a.hmk", "-o", tmp_path / "a.png"),
                  ("view", tmp_path / "a.hmk"), ("view", tmp_path / "a.hmk", "--original", tmp_path / "a.hmk")):
        for options in (("--shape", "3,4,5"), ("--order", "F"), ("--offset", 8), ("--member", "a")):
            assert f"{options[0]} says how an array is read" in run(*words, *options, code=2).stderr
    np.save(tmp_path / "a.npy", VALUES)
    for words in (("view", tmp_path / "a.hmk", "--original"), ("verify", tmp_path / "a.hmk", "--against"),
                  ("plan",)):
        assert "raw-description" in refused(*words, tmp_path / "a.npy", "--order", "F", code=2)


class Labelled:
    """What an xarray looks like from outside."""

    def __init__(self, values: Any, dims: Any) -> None:
        self.values, self.dims = values, dims

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        return np.array(self.values, dtype)


@pytest.mark.parametrize(("dims", "axes", "names"), [
    (("t", "y", "x"), None, ["t", "y", "x"]), (("t", "y", "x"), "z,y,x", ["z", "y", "x"]),
    (("my time", "y-pos", "a:b"), None, ["my_time", "y-pos", "a_b"]),
    (("a b", "a_b", "x"), None, ["axis0", "axis1", "axis2"]), ([1, 2], None, ["axis0", "axis1", "axis2"]),
])
def test_labels_of_an_array_name_its_axes(dims: Any, axes: Any, names: list[str]) -> None:
    model = hmkcta.compress(Labelled(VALUES, dims), "R=2", axes=axes)
    assert [axis.name for axis in model.metadata.axes] == names


def test_arrays_of_other_libraries(tmp_path: Path) -> None:
    direct = hmkcta.compress(VALUES, "R=2")
    with needed("h5py").File(tmp_path / "a.h5", "w") as file:
        chunked = file.create_dataset("a", data=VALUES, chunks=(1, 4, 5))
        assert hmkcta.compress(chunked, "R=2").metadata.source == direct.metadata.source
    zarr = needed("zarr").create_array(tmp_path / "a.zarr", data=VALUES)
    assert hmkcta.compress(zarr, "R=2").metadata.source == direct.metadata.source


def test_what_holds_arrays_is_told_to_be_given_one_of_them(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", wood=VALUES)
    with (needed("h5py").File(tmp_path / "a.h5", "w") as file, np.load(tmp_path / "a.npz") as arrays):
        file["group/wood"] = VALUES
        zarr = needed("zarr").open_group(tmp_path / "a.zarr", mode="w")
        zarr["wood"] = VALUES
        for holder in (file["group"], arrays, zarr, {"wood": VALUES}):
            with pytest.raises(HmkctaError, match=r"of \['wood'\], allowed one array.*open_array") as caught:
                hmkcta.compress(holder, "R=2")
            assert caught.value.reason == "array-is-group"


@pytest.mark.parametrize("uri", ["", ":/member"])
def test_no_path_is_not_the_folder_at_hand(uri: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.save(tmp_path / "a.npy", VALUES)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(HmkctaError):
        hmkcta.open_array(uri)


def test_from_hdf5_to_a_file_and_back(tmp_path: Path) -> None:
    values = smooth(16, 24, 20)
    with needed("h5py").File(tmp_path / "run.h5", "w") as file:
        file.create_dataset("fields/density", data=values, chunks=(4, 24, 20), compression="gzip")
        file["fields/speed"] = -values
    source, output = f"{tmp_path}/run.h5:/fields/density", tmp_path / "a.hmk"
    assert "/fields/speed" in refused("compress", f"{tmp_path}/run.h5", "-o", output, code=2)
    made = report("compress", source, "-o", output, "--axes", "z,y,x", "--snr", 30, "--quality", "fast")
    assert made["reached"]
    assert f"compress {source}" in run("plan", source, "--size", "20KB", "--quality", "fast").stdout
    report("verify", output, "--against", source)
    report("verify", output, "--against", tmp_path / "run.h5", "--member", "/fields/density")
    run("verify", output, "--against", f"{tmp_path}/run.h5:/fields/speed", code=4)
    assert "another file" in refused("compress", source, "-o", tmp_path / "run.h5", "--overwrite", code=2)
    resumed = report("compress", source, "-o", output, "--axes", "z,y,x", "--snr", 30, "--quality", "fast", "--resume",
                     "--overwrite")
    assert resumed["bytes"] == made["bytes"]


def test_max_memory_is_that_of_unpacking_too(tmp_path: Path) -> None:
    with needed("h5py").File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("a", data=VALUES, chunks=(1, 2, 5))
    same(tmp_path / "a.h5", VALUES, max_memory=2 * VALUES.nbytes)
    same(tmp_path / "a.h5", VALUES, mapped=True, max_memory=2 * VALUES.nbytes - 1)
    assert refusal(tmp_path / "a.h5", max_memory=79).reason == "memory"


def test_from_a_folder_of_pictures(tmp_path: Path) -> None:
    values = (smooth(6, 32, 24, 3) * 20 + 100).astype(np.uint8)
    for number, each in enumerate(values):
        needed("PIL.Image").fromarray(each).save(tmp_path / f"light{number}.png")
    run("compress", tmp_path, "-o", tmp_path / "a.hmk", "--axes", "light,y,x,rgb", "--snr", 25, "--quality", "fast")
    report("verify", tmp_path / "a.hmk", "--against", f"{tmp_path}/*.png")
    wanted = f"{tmp_path}/light*.png"
    assert "another file" in refused("compress", wanted, "-o", tmp_path / "light3.png", "--overwrite", code=2)
    assert np.array_equal(open_array(wanted), values)
