"""Odd input, odd outputs, odd terminals: a sentence and a documented exit code, and nobody's file is lost."""

from __future__ import annotations

import json
import os
import shutil
import struct
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hmkcta
from cli_tools import PYTHON, finish, refused, report, run, saved, smooth, start

PLAN = ("--plan", "R=1")


def header(shape: Any, descr: Any = "<f4", version: tuple[int, int] = (1, 0)) -> bytes:
    """The header of a `.npy` file that says what it likes."""
    text = f"{{'descr': {descr!r}, 'fortran_order': False, 'shape': {shape!r}, }}".encode()
    text += b" " * (64 - (len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY" + bytes(version) + struct.pack("<H", len(text)) + text


@pytest.fixture
def source(tmp_path: Path) -> Path:
    return saved(tmp_path / "wood.npy", smooth(6, 8, 10))


# Arrays


@pytest.mark.parametrize(("array", "part"), [
    (np.ones((4, 5), complex), "imaginary"), (np.float32(3), "shape"),
    (np.zeros(5, [("a", "f4")]), "structured"), (np.array([["ab"]]), "numbers first"), (np.zeros((0, 5)), "(0, 5)"),
    (np.array(["2020-01-01"], "M8[D]"), "numbers first"), (np.zeros((5, 0, 3)), "(5, 0, 3)"),
    (np.zeros((2,) * 9, np.float32), "1 to 8 axes"), (np.full((4, 5), 1e38), "1e+32"),
    (np.full((4, 5), 1e-300), "1e-38"),
], ids=lambda value: value if isinstance(value, str) else "")
def test_arrays_that_are_refused(array: Any, part: str, tmp_path: Path) -> None:
    source = saved(tmp_path / "a.npy", array)
    assert part in refused("compress", source, "-o", tmp_path / "a.hmk", *PLAN, code=2)
    assert list(tmp_path.iterdir()) == [source]


def test_objects_are_never_unpickled(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.array([1, None], object), allow_pickle=True)
    assert "object" in refused("compress", path, "-o", tmp_path / "a.hmk", *PLAN, code=2)
    path.write_bytes(header((1,), "|O") + b"cos\nsystem\n(S'exit 1'\ntR.")
    assert "object" in refused("compress", path, "-o", tmp_path / "a.hmk", *PLAN, code=2)


@pytest.mark.parametrize("content", [
    header((2**40, 2**40)), header((2**62,)), header((10**30, 2)), header((2,), version=(9, 9)) + bytes(8),
    header((2, 3)) + bytes(20), header((2, 3)) + bytes(28), header((2, "x")), header((2.5,)) + bytes(10),
    b"\x93NUMPY\x02\x00" + struct.pack("<I", 200000) + b"(" * 200000, b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**31),
    b"\x93NUMPY\x01\x00" + struct.pack("<H", 30) + b"__import__('os').abort()      \n",
], ids=range(11))
def test_forged_headers(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    path.write_bytes(content)
    assert str(path) in refused("compress", path, "-o", tmp_path / "a.hmk", *PLAN, code=3)
    assert list(tmp_path.iterdir()) == [path]


def test_truth_values_for_sizes_are_sizes(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(header((True, 5)) + np.arange(5, dtype="<f4").tobytes())
    run("compress", tmp_path / "a.npy", "-o", tmp_path / "a.hmk", *PLAN)
    assert hmkcta.open(tmp_path / "a.hmk").shape == (1, 5)


def test_archives(tmp_path: Path) -> None:
    output = ("-o", tmp_path / "a.hmk", *PLAN)
    path = tmp_path / "a.npz"
    np.savez(path)
    assert "found none" in refused("compress", path, *output, code=2)
    np.savez(path, one=smooth(4, 5), two=smooth(4, 5))
    assert f"{path}:NAME" in refused("compress", path, *output, code=2)
    assert "one (4 x 5 of float32), two (4 x 5 of float32)" in refused("compress", f"{path}:three", *output, code=2)
    path.write_bytes(path.read_bytes()[:300])
    refused("compress", path, *output, code=3)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", header((2**34,)) + bytes(1000))
    assert "68719476736 bytes" in refused("compress", path, *output, code=3)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(("content", "part"), [
    (b"<!DOCTYPE html>\n<html><body>404</body></html>", "a web page"),
    (b"\n<html lang=en><head></head></html>", "a web page"),
    (b"\x93NUMPY\x01\0v\0{'descr': '<f4'}", "hmkcta compress"), (b"PK\x03\x04\x14\0\0\0", "a zip archive"),
    (b"\x89PNG\r\n\x1a\n", "a PNG picture"), (b"\x89HDF\r\n\x1a\n", "hmkcta compress"),
    (b"\x1f\x8b\x08\0\0\0\0\0", "gunzip"), (b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
])
def test_a_file_that_is_no_hmk_file_is_recognised(content: bytes, part: str, tmp_path: Path) -> None:
    """By the same reason in Python and on the command line; that of the page is the corpus's."""
    path = tmp_path / "a.hmk"
    path.write_bytes(content + bytes(60))
    with pytest.raises(hmkcta.HmkctaError) as caught:
        hmkcta.open(path)
    assert (caught.value.kind.label, caught.value.reason) == ("Io", "foreign-file")
    assert "again" not in caught.value.hint
    sentence = refused("verify", path, code=3)
    assert part in sentence
    assert sentence.endswith(". [Io/foreign-file]")
    assert report("verify", path, code=3)["error"]["reason"] == "foreign-file"
    assert "header: found what begins like a" in sentence or "header: found what begins like HDF5" in sentence
    assert "allowed an .hmk file" in sentence


def test_safetensors_of_somebody_else_are_no_hmk_file(tmp_path: Path) -> None:
    """What they begin like is told."""
    header = b'{"weight":{"dtype":"F32","shape":[3],"data_offsets":[0,12]}}'
    (tmp_path / "other.safetensors").write_bytes(len(header).to_bytes(8, "little") + header + bytes(12))
    with pytest.raises(hmkcta.HmkctaError) as caught:
        hmkcta.open(tmp_path / "other.safetensors")
    assert (caught.value.kind.label, caught.value.reason) == ("Io", "foreign-file")
    assert "found what begins like safetensors, allowed an .hmk file" in refused("info", tmp_path / "other.safetensors",
                                                                                 code=3)


@pytest.mark.parametrize("content", [bytes(range(200, 230)) * 3, b"plain text of somebody" * 3])
def test_what_looks_like_nothing_is_not_guessed_at(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.hmk").write_bytes(content)
    assert "Next: check that it is an .hmk file." in refused("info", tmp_path / "a.hmk", code=3)


def test_a_damaged_hmk_file_is_not_taken_for_another(source: Path, tmp_path: Path) -> None:
    run("compress", source, "-o", tmp_path / "a.hmk", *PLAN, "--quiet")
    whole = (tmp_path / "a.hmk").read_bytes()
    for damaged, code in ((whole[:40], 4), (whole[:15] + b"\xff" + whole[16:], 6), (whole[:20] + b"[" + whole[21:], 4)):
        (tmp_path / "a.hmk").write_bytes(damaged)
        assert "foreign-file" not in refused("info", tmp_path / "a.hmk", code=code)


def test_a_compressed_file_is_no_source(source: Path, tmp_path: Path) -> None:
    run("compress", source, "-o", tmp_path / "a.hmk", *PLAN, "--quiet")
    sentence = refused("compress", tmp_path / "a.hmk", "-o", tmp_path / "b.hmk", code=3)
    assert "a compressed file" in sentence
    assert "hmkcta decompress" in sentence


def test_a_pattern_that_matches_nothing(tmp_path: Path) -> None:
    sentence = refused("compress", tmp_path / "nope*.png", "-o", tmp_path / "b.hmk", code=3)
    assert "no file that matches" in sentence
    assert "quote" not in sentence


@pytest.mark.parametrize(("words", "part"), [
    (("--nan", "fill=1e308"), "magnitude"), (("--transform", "asinh:1e300"), "1e-30 to 1e+30"),
    (("--organisation", ""), "found ''"), (("--plan", "R=1 /"), "an empty level"), (("--axes", ""), "1 names"),
])
def test_arguments_at_the_edge(words: tuple[str, ...], part: str, source: Path, tmp_path: Path) -> None:
    options = words if "--plan" in words else (*words, *PLAN)
    assert part in refused("compress", source, "-o", tmp_path / "a.hmk", *options, code=2)


@pytest.mark.parametrize(("words", "part"), [
    (("compress", "", "-o", "a.hmk"), "path is empty"), (("info", ""), "path is empty"),
    (("compress", "a.npy", "-o", "-"), "not to standard output"), (("compress", "a.npy", "-o", ""), "path is empty"),
    (("decompress", "a.hmk", "-o", "a.npy", "--level", "0"), "1 or more"),
])
def test_words_that_cannot_be(words: tuple[str, ...], part: str) -> None:
    assert part in " ".join(run(*words, code=2).stderr.split())


@pytest.mark.parametrize("plan", [
    "R=7,8,10", "R=1 C=9,1,1", "R=1 grid=axis0:7", "R<=3", "R=1 bits=8", "R=2 C=2 K=3",
])
def test_plan_refuses_what_compress_refuses(plan: str, source: Path, tmp_path: Path) -> None:
    sentence = refused("plan", source, "--plan", plan, code=2)
    assert refused("compress", source, "-o", tmp_path / "a.hmk", "--plan", plan, code=2) == sentence


def test_plan_refuses_a_kind_that_nothing_could_show(source: Path, tmp_path: Path) -> None:
    words = ("--axes", "frame,y,x", "--kind", "volume")
    sentence = refused("plan", source, *words, code=2)
    assert "3 axes of role space" in sentence
    assert refused("compress", source, "-o", tmp_path / "a.hmk", *words, code=2) == sentence


# Outputs


@pytest.mark.parametrize("name", ["wood.npy", "link.npy", "folder/../wood.npy"])
def test_an_output_never_replaces_its_input(name: str, source: Path, tmp_path: Path) -> None:
    (tmp_path / "link.npy").symlink_to("wood.npy")
    (tmp_path / "folder").mkdir()
    before = source.read_bytes()
    assert "than the input" in refused("compress", source, "-o", tmp_path / name, *PLAN, "--overwrite", code=2)
    assert source.read_bytes() == before


def test_nor_does_that_of_an_archive_or_of_decompress(source: Path, tmp_path: Path) -> None:
    archive = tmp_path / "a.npz"
    np.savez(archive, a=smooth(4, 5), b=smooth(4, 5))
    refused("compress", f"{archive}:a", "-o", archive, *PLAN, "--overwrite", code=2)
    run("compress", source, "-o", tmp_path / "a.raw", *PLAN)
    before = (tmp_path / "a.raw").read_bytes()
    refused("decompress", tmp_path / "a.raw", "-o", tmp_path / "a.raw", "--overwrite", code=2)
    assert (tmp_path / "a.raw").read_bytes() == before


@pytest.mark.parametrize("name", ["folder", "pipe", "wood.npy/a.hmk", "missing/a.hmk", "x" * 300, "/dev/full"])
def test_outputs_that_cannot_be(name: str, source: Path, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe")
    before = sorted(tmp_path.rglob("*"))
    refused("compress", source, "-o", tmp_path / name, *PLAN, "--overwrite", code=3)
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.skipif(not Path("/dev/fd").exists(), reason="needs /dev/fd")
def test_a_pipe_is_refused_before_the_work(source: Path) -> None:
    code, out, err = finish(start("compress", source, "-o", "/dev/fd/1", *PLAN, "--overwrite"))
    assert (code, out) == (3, "")
    assert "no regular file" in err
    assert not Path("/dev/fd/1.partial").exists()


def test_a_link_keeps_pointing_where_it_does(source: Path, tmp_path: Path) -> None:
    (tmp_path / "link.hmk").symlink_to("real.hmk")
    run("compress", source, "-o", tmp_path / "link.hmk", *PLAN)
    assert (tmp_path / "link.hmk").is_symlink()
    assert hmkcta.open(tmp_path / "real.hmk").shape == (6, 8, 10)


@pytest.mark.parametrize(("name", "content"), [
    ("run.json", "[]"), ("run.json", "{"), ("run.json", None), ("explored.json", '{"levels"'),
    ("explored.json", '{"levels": 3}'), ("explored.json", "[0.1, [[3, 4]]]"), ("coded-*.json", "[]"),
    ("explored.json", "\udcff"),
])
def test_a_journal_that_makes_no_sense(name: str, content: str | None, source: Path, tmp_path: Path) -> None:
    folder = tmp_path / "a.hmk.partial"
    with pytest.raises(KeyboardInterrupt), hmkcta.Journal(folder) as journal:
        hmkcta.compress(np.load(source), snr=20.0, quality="fast", journal=journal, progress=stop_at_measuring)
    (path,) = folder.glob(name)
    path.unlink()
    if content is not None:
        path.write_text(content, errors="surrogateescape")
    words = ("compress", source, "-o", tmp_path / "a.hmk", "--snr", 20, "--quality", "fast")
    assert "begin again with --overwrite" in refused(*words, "--resume", code=4)
    run(*words, "--overwrite")
    assert not folder.exists()


def stop_at_measuring(stage: str, fraction: float) -> None:
    """Progress that stops once the search is over."""
    del fraction
    if stage == "measuring":
        raise KeyboardInterrupt


# Terminals and streams

#: Run without a shell's help: what the shell would close is closed by the program itself.
CLOSED = "import os\nos.close({number})"


@pytest.mark.parametrize("words", [
    ("info", "FILE"), ("info", "FILE", "--json"), ("verify", "FILE"), ("plan", "SRC", *PLAN), ("--help",),
    ("--version",), ("compress", "SRC", "-o", "OUT", *PLAN), ("info", "missing", "--json"),
], ids=" ".join)
def test_a_reader_that_goes_away(words: tuple[str, ...], source: Path, tmp_path: Path) -> None:
    file = tmp_path / "a.hmk"
    run("compress", source, "-o", file, *PLAN)
    names = {"FILE": file, "SRC": source, "OUT": tmp_path / "b.hmk"}
    reading, writing = os.pipe()
    os.close(reading)
    program = f"import sys\nsys.path.insert(0, {str(PYTHON)!r})\nfrom hmkcta.cli import main\nmain(sys.argv[1:])"
    done = subprocess.run([sys.executable, "-c", program, *(str(names.get(word, word)) for word in words)],
                          stdout=writing, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    os.close(writing)
    assert "Traceback" not in done.stderr
    assert done.returncode in (0, 1, 3)
    if "OUT" in words:
        hmkcta.open(tmp_path / "b.hmk")


@pytest.mark.skipif(os.name != "posix", reason="needs a shell")
@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_streams_that_are_closed(closed: str, source: Path, tmp_path: Path) -> None:
    program = f"import sys\nsys.path.insert(0, {str(PYTHON)!r})\nfrom hmkcta.cli import main\nmain(sys.argv[1:])"
    (tmp_path / "program.py").write_text(program)
    command = f'"$0" program.py compress "$1" -o a.hmk --plan R=1 {closed}'
    done = subprocess.run(["/bin/sh", "-c", command, sys.executable, str(source)], cwd=tmp_path, capture_output=True,
                          text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert hmkcta.open(tmp_path / "a.hmk").shape == (6, 8, 10)


def test_a_terminal_that_knows_only_ascii(source: Path, tmp_path: Path) -> None:
    run("compress", source, "-o", tmp_path / "a.hmk", *PLAN, "--axes", "höhe,y,x")
    shutil.copy(tmp_path / "a.hmk", tmp_path / "ü.hmk")
    before = "import sys\nsys.stdout.reconfigure(encoding='ascii', errors='strict')"
    code, out, _ = finish(start("info", tmp_path / "ü.hmk", before=before))
    assert code == 0
    assert "6 (other)" in out


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0 or not shutil.which("setpriv"),
                    reason="needs a superuser who can become nobody")
def test_a_folder_that_cannot_be_written_to(source: Path, tmp_path: Path) -> None:
    folder = tmp_path / "locked"
    folder.mkdir(mode=0o555)
    for parent in tmp_path.parents[:2]:
        parent.chmod(0o755)
    program = f"import sys\nsys.path.insert(0, {str(PYTHON)!r})\nfrom hmkcta.cli import main\nmain(sys.argv[1:])"
    done = subprocess.run(["setpriv", "--reuid", "65534", "--clear-groups", sys.executable, "-c", program, "compress",
                           str(source), "-o", str(folder / "a.hmk"), *PLAN, "--json"],
                          capture_output=True, text=True, timeout=60, check=False)
    if "hmkcta: " not in done.stderr:
        pytest.skip("nobody may not run this Python")
    assert done.returncode == 3
    assert json.loads(done.stdout)["error"]["reason"] == "unwritable"
