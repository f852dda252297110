"""Whatever goes wrong ends with one sentence, its documented exit code, and nothing lost."""

from __future__ import annotations

import json
import os
import re
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hmkcta
from cli_tools import finish, refused, report, run, saved, smooth, start
from hmkcta.cli import compress as compress_module
from hmkcta.cli.interrupt import ECHO

PLAN = ("--plan", "R=2")


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small array."""
    return saved(tmp_path_factory.mktemp("source") / "wood.npy", smooth(6, 8, 10))


@pytest.fixture(scope="module")
def packed(source: Path) -> Path:
    """It compressed."""
    run("compress", source, "-o", source.with_suffix(".hmk"), *PLAN, "--quiet")
    return source.with_suffix(".hmk")


# Values


def test_values_none_of_which_is_finite(tmp_path: Path) -> None:
    source = saved(tmp_path / "a.npy", np.full((6, 8, 10), np.nan))
    sentence = refused("compress", source, "-o", tmp_path / "a.hmk", *PLAN, code=2)
    assert "480 values that are NaN or infinite" in sentence
    assert "no value of it is finite" in sentence
    assert "--nan fill=0 puts zeros" in sentence
    assert "others" not in sentence


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite(value: float, tmp_path: Path) -> None:
    values = smooth(6, 8, 10)
    mean = values.mean()
    values[1, 2, 3] = values[5, 7, 9] = value
    source = saved(tmp_path / "a.npy", values)
    sentence = refused("compress", source, "-o", tmp_path / "a.hmk", *PLAN, code=2)
    assert "2 values" in sentence
    assert "(1, 2, 3)" in sentence
    near = re.search(r"near the mean of the others is nan=(\S+) or --nan fill=\1\.", sentence)
    assert near is not None
    assert abs(float(near[1]) - mean) < 0.1 * values[0].std()
    assert not (tmp_path / "a.hmk").exists()
    run("compress", source, "-o", tmp_path / "a.hmk", "--plan", "R=6,8,10", "--nan", "fill=0")
    assert abs(hmkcta.open(tmp_path / "a.hmk")[1, 2, 3]) < 0.1
    refused("verify", tmp_path / "a.hmk", "--against", source, code=2)
    run("verify", tmp_path / "a.hmk", "--against", source, "--nan", "fill=0")


@pytest.mark.parametrize(("names", "advice"), [
    ("z y x", "part names with commas: z,y,x."), ("z;y; x", "part names with commas: z,y,x."),
    ("z, y", "give one name an"),
])
def test_names_that_commas_do_not_part(names: str, advice: str, source: Path, tmp_path: Path) -> None:
    said = refused("compress", source, "-o", tmp_path / "a.hmk", "--axes", names, code=2)
    assert f"Next: {advice}" in said


@pytest.mark.parametrize("goal", [
    ("--plan", "R=2"), ("--plan", "R=2 C=2 K=2"), ("--snr", "40"), ("--size", "20KiB"), (),
], ids=" ".join)
@pytest.mark.parametrize("value", [0.0, 3.5, -1e-8, 1e9])
def test_constant_data(value: float, goal: tuple[str, ...], tmp_path: Path) -> None:
    source = saved(tmp_path / "a.npy", np.full((6, 8, 10), value, np.float32))
    run("compress", source, "-o", tmp_path / "a.hmk", *goal, "--quality", "fast")
    np.testing.assert_allclose(hmkcta.open(tmp_path / "a.hmk"), value, rtol=0.01 if "--snr" in goal else 3.2e-3)
    run("verify", tmp_path / "a.hmk", "--against", source)


@pytest.mark.parametrize("factor", [1e-30, 1e30])
@pytest.mark.parametrize("goal", [("--plan", "R=2"), ("--plan", "R=2 C=2 K=2"), ("--snr", "30")], ids=" ".join)
def test_very_small_and_large_numbers(factor: float, goal: tuple[str, ...], tmp_path: Path) -> None:
    source = saved(tmp_path / "a.npy", np.float32(factor) * smooth(6, 8, 10))
    assert report("compress", source, "-o", tmp_path / "a.hmk", *goal, "--quality", "fast")["snr_db"] > 7
    run("verify", tmp_path / "a.hmk", "--against", source)


@pytest.mark.parametrize("shape", [(1, 8, 10), (6, 1, 10), (1, 1, 1), (12,), (1, 9)])
@pytest.mark.parametrize("goal", [("--plan", "R=1"), ("--snr", "20")], ids=" ".join)
def test_modes_of_size_one(shape: tuple[int, ...], goal: tuple[str, ...], tmp_path: Path) -> None:
    source = saved(tmp_path / "a.npy", smooth(*shape))
    run("compress", source, "-o", tmp_path / "a.hmk", *goal, "--quality", "fast")
    assert hmkcta.open(tmp_path / "a.hmk").shape == shape
    run("verify", tmp_path / "a.hmk", "--against", source)


@pytest.mark.parametrize("dtype", ["uint8", ">i2", "float16", ">f8", "<i8"])
def test_other_number_types(dtype: str, tmp_path: Path) -> None:
    source = saved(tmp_path / "a.npy", (100 * smooth(6, 8, 10) / 5).astype(dtype)[::-1].T)
    run("compress", source, "-o", tmp_path / "a.hmk", *PLAN)
    run("verify", tmp_path / "a.hmk", "--against", source)
    assert report("info", tmp_path / "a.hmk")["source_dtype"] == np.dtype(dtype).newbyteorder("=").name


# Arguments


@pytest.mark.parametrize(("words", "named"), [
    (("--plan", "R=0"), "R of mode 1"), (("--plan", "R=7,8,10"), "R of mode 1"), (("--plan", "R=2 C=0"), "C of mode 1"),
    (("--plan", "R=2 C=7,1,1"), "C of mode 1"), (("--plan", "R=2 C=2 K=3,1,1"), "K of mode 1"),
    (("--plan", "R=2 C=4 K=0"), "K of mode 1"), (("--plan", "R=2,2"), "R of the plan"), (("--plan", "R=x"), "'x'"),
    (("--plan", "two"), "'two'"), (("--plan", "R=* C=2"), "C of mode 1"), (("--plan", ""), "plan"),
    (("--axes", "y,x"), "axes"), (("--axes", "y,x,x"), "axes"), (("--axes", "y,x,z:depth"), "role of axis 'z'"),
    (("--organisation", "axis0, axis1"), "organisation"), (("--organisation", "a+b, c"), "organisation"),
    (("--transform", "cube"), "transform"), (("--transform", "log1p:-1"), "scale of log1p"),
    (("--unit", "light=degrees"), "--unit"), (("--coords", "light=there.npy"), "--coords"),
])
def test_arguments_out_of_range(words: tuple[str, ...], named: str, source: Path, tmp_path: Path) -> None:
    options = words if "--plan" in words else (*words, *PLAN)
    sentence = refused("compress", source, "-o", tmp_path / "a.hmk", *options, code=2)
    assert named in sentence
    assert "allowed" in sentence
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("words", [
    ("--snr", "20", "--size", "1MB"), ("--size", "20MQ"), ("--size", "0"), ("--size", "-3"), ("--nan", "0"),
    ("--nan", "fill=inf"), ("--quality", "best"), ("--scheme", "some"), ("--seed", "-1"), ("--threads", "0"),
    ("--decode-cost", "0"), ("--kind", "cube"), ("--shape", "2,,3"), ("--frobnicate",), ("--snr", "loud"),
    ("--coords", "light"), ("--unit", "=degrees"),
])
def test_usage(words: tuple[str, ...], source: Path, tmp_path: Path) -> None:
    result = run("compress", source, "-o", tmp_path / "a.hmk", *words, "--json", code=2)
    assert "Error: " in result.stderr
    error = json.loads(result.stdout)["error"]
    assert error["exit_code"] == 2
    assert error["sentence"] in result.stderr
    assert not list(tmp_path.iterdir())


def test_coordinates_that_do_not_fit(source: Path, tmp_path: Path) -> None:
    """They are told before the fit, not when the file is written."""
    here = tmp_path / "coords.txt"
    words = ("compress", source, "-o", tmp_path / "a.hmk", "--coords", f"axis0={here}")
    assert "No such file" in refused(*words, code=3)
    here.write_text("0 0 1\n0 1 0\n")
    sentence = refused(*words, code=2)
    assert "coords of axis 'axis0': found shape (2, 3), allowed shape [6]" in sentence
    assert [path.name for path in tmp_path.iterdir()] == ["coords.txt"]


def test_level_that_is_not_there(packed: Path, tmp_path: Path) -> None:
    assert "allowed 1 to 1" in refused("decompress", packed, "-o", tmp_path / "a.npy", "--level", 2, code=2)
    assert ".npy or .raw" in refused("decompress", packed, "-o", tmp_path / "a.tif", code=2)
    assert not list(tmp_path.iterdir())


def test_more_memory_than_allowed(source: Path, packed: Path, tmp_path: Path) -> None:
    for plan in (PLAN, ()):
        sentence = refused("compress", source, "-o", tmp_path / "a.hmk", *plan, "--max-memory", "1KiB", code=6)
        assert "1.00 KiB" in sentence
        assert "--resume" not in sentence
    sentence = refused("compress", source, "-o", tmp_path / "a.hmk", "--max-memory", "1MB", code=6)
    assert "--resume" not in sentence  # the plan that was chosen is no help with less memory than any takes
    refused("decompress", packed, "-o", tmp_path / "a.npy", "--max-memory", "1KiB", code=6)
    assert not list(tmp_path.iterdir())


# Input and output


@pytest.mark.parametrize("command", ["compress", "plan", "info", "verify", "decompress"])
@pytest.mark.parametrize("content", [None, b"", b"\x93NUMPY\x01", b"not an array at all, not a file of ours"])
def test_unreadable_input(command: str, content: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "in.npy"
    if content is not None:
        path.write_bytes(content)
    output = {"compress": ("-o", tmp_path / "a.hmk"), "decompress": ("-o", tmp_path / "a.npy")}.get(command, ())
    takes_arrays = command in ("compress", "plan")
    # What is empty may have been one of ours; what begins otherwise never was.
    sentence = refused(command, path, *output, code=4 if content == b"" and not takes_arrays else 3)
    assert str(path) in sentence
    assert list(tmp_path.iterdir()) == ([] if content is None else [path])


def test_damaged_files(packed: Path, tmp_path: Path) -> None:
    data = packed.read_bytes()
    path = tmp_path / "a.hmk"
    for damaged, code in (
        (data[:-1], 4), (data[:-8] + bytes(8), 4), (data + b"\0", 4),
        (data.replace(b'"nodes":1', b'"nodes":2'), 4), (np.uint64(2).tobytes() + b"{}", 3),
    ):
        assert damaged != data
        path.write_bytes(damaged)
        for words in (("info", path), ("verify", path), ("decompress", path, "-o", tmp_path / "a.npy")):
            refused(*words, code=code)
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_of_a_later_version(packed: Path, tmp_path: Path) -> None:
    data = packed.read_bytes()
    assert int.from_bytes(data[8:12], "little") == 1
    (tmp_path / "a.hmk").write_bytes(data[:8] + (9).to_bytes(4, "little") + data[12:])
    assert "version-unknown" in refused("info", tmp_path / "a.hmk", code=5)


def test_another_source(source: Path, packed: Path, tmp_path: Path) -> None:
    other = saved(tmp_path / "other.npy", np.load(source) * 1.01)
    result = run("verify", packed, "--against", other, code=4)
    assert "as the file says" in result.stderr
    refused("verify", packed, "--against", saved(tmp_path / "small.npy", smooth(6, 8)), code=2)


@pytest.mark.parametrize("command", ["compress", "decompress"])
def test_output_that_exists(command: str, source: Path, packed: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.npy"
    output.write_text("precious")
    words = ("compress", source, *PLAN) if command == "compress" else ("decompress", packed)
    sentence = refused(*words, "-o", output, code=3)
    assert str(output) in sentence
    assert output.read_text() == "precious"
    run(*words, "-o", output, "--overwrite")
    assert output.stat().st_size > 500
    assert list(tmp_path.iterdir()) == [output]


def test_output_is_checked_before_the_work(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compress_module, "compress", None)
    (tmp_path / "a.hmk").write_text("precious")
    refused("compress", source, "-o", tmp_path / "a.hmk", code=3)
    refused("compress", source, "-o", tmp_path / "missing" / "a.hmk", code=3)


@pytest.mark.skipif(sys.platform != "linux", reason="needs a limit on the file size")
@pytest.mark.parametrize("command", ["compress", "decompress"])
def test_full_disk(command: str, source: Path, packed: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.npy"
    output.write_text("precious")
    words = ("compress", source, *PLAN) if command == "compress" else ("decompress", packed)
    limit = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (512, 512))"
    code, out, err = finish(start(*words, "-o", output, "--overwrite", "--quiet", before=limit))
    assert (code, out) == (3, "")
    assert "disk-full" in err
    assert err.count("\n") == 1
    assert output.read_text() == "precious"
    assert list(tmp_path.iterdir()) == [output]


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="the superuser may write anywhere")
def test_read_only_folder(source: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    refused("compress", source, "-o", tmp_path / "a.hmk", *PLAN, code=3)


# Goals, interrupts, and what nobody foresaw


def test_goal_out_of_reach(source: Path, tmp_path: Path) -> None:
    result = run("compress", source, "-o", tmp_path / "a.hmk", "--plan", "R=1", "--snr", 90, code=7)
    assert "below --snr 90" in result.stderr
    assert hmkcta.open(tmp_path / "a.hmk").snr < 90
    assert not report("compress", source, "-o", tmp_path / "b.hmk", "--plan", "R=1", "--snr", 90, code=7)["reached"]


def failing(error: BaseException) -> Callable[..., Any]:
    """A `compress` that fails."""
    def fail(*_: Any, **__: Any) -> Any:
        raise error

    return fail


@pytest.mark.parametrize(("error", "code", "part"), [
    (KeyboardInterrupt(), 130, "interrupted"), (MemoryError(), 6, "--max-memory"),
    (RuntimeError("numbers\nran away"), 1, "unexpected RuntimeError: numbers. Next: run with -v"),
    (OSError(5, "Input/output error", "wood.npy"), 3, "wood.npy: Input/output error"),
])
def test_what_nobody_foresaw(error: BaseException, code: int, part: str, source: Path, tmp_path: Path,
                             monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compress_module, "compress", failing(error))
    assert part in refused("compress", source, "-o", tmp_path / "a.hmk", code=code)
    assert not list(tmp_path.iterdir())


def test_traceback_on_request(source: Path, tmp_path: Path) -> None:
    before = ("import hmkcta.cli.compress as c\n"
              "def fail(*a, **k): raise RuntimeError('numbers ran away')\nc.compress = fail")
    code, out, err = finish(start("compress", source, "-o", tmp_path / "a.hmk", "-v", before=before))
    assert (code, out) == (1, "")
    assert "Traceback" in err
    assert "hmkcta --version" in err.splitlines()[-1]


def test_failures_for_programs(source: Path, tmp_path: Path) -> None:
    result = run("compress", source, "-o", tmp_path / "a.hmk", "--plan", "R=0", "--json", code=2)
    error = json.loads(result.stdout)["error"]
    assert (error["kind"], error["reason"], error["exit_code"]) == ("InvalidArgument", "rank-too-small", 2)
    assert error["sentence"] in result.stderr


SLOW = """
import hmkcta.cli.compress as c, time
def slow(*a, **k):
    open({ready!r}, "w").close()
    {body}
c.compress = slow
"""


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupt(number: signal.Signals, source: Path, tmp_path: Path) -> None:
    output, ready = tmp_path / "a.hmk", tmp_path / "ready"
    output.write_text("precious")
    process = start("compress", source, "-o", output, "--overwrite",
                    before=SLOW.format(ready=str(ready), body="time.sleep(60)"))
    await_file(ready)
    process.send_signal(number)
    code, out, err = finish(process)
    assert (code, out) == (128 + number, "")
    assert err.splitlines()[-1].startswith("hmkcta: interrupted")
    assert output.read_text() == "precious"


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
def test_second_interrupt_ends_at_once(source: Path, tmp_path: Path) -> None:
    ready, stopping = tmp_path / "ready", tmp_path / "stopping"
    stubborn = f"""try: time.sleep(60)
    except KeyboardInterrupt: open({str(stopping)!r}, "w").close(); time.sleep(60)"""
    process = start("compress", source, "-o", tmp_path / "a.hmk",
                    before=SLOW.format(ready=str(ready), body=stubborn))
    await_file(ready)
    process.send_signal(signal.SIGINT)
    await_file(stopping)
    time.sleep(1.5 * ECHO)
    process.send_signal(signal.SIGINT)
    code, _, err = finish(process)
    assert (code, err) == (130, "")


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
def test_one_interrupt_may_come_twice(source: Path, tmp_path: Path) -> None:
    """As `timeout -s INT` sends it: it must not cut the clean-up short."""
    ready, cleaned = tmp_path / "ready", tmp_path / "cleaned"
    thorough = f"""try: time.sleep(60)
    finally: time.sleep({ECHO}); open({str(cleaned)!r}, "w").close()"""
    process = start("compress", source, "-o", tmp_path / "a.hmk",
                    before=SLOW.format(ready=str(ready), body=thorough))
    await_file(ready)
    for _ in range(2):
        process.send_signal(signal.SIGINT)
        time.sleep(ECHO / 10)
    code, _, err = finish(process)
    assert (code, cleaned.exists()) == (130, True)
    assert err.startswith("hmkcta: interrupted")


@pytest.mark.parametrize("module", ["numpy", "hmkcta.cli.app"])
def test_an_interrupt_while_modules_are_loaded_leaves_no_traceback(module: str, packed: Path) -> None:
    """Loading them takes half a second, more than many people wait before they see that a letter was wrong."""
    process = start("info", packed, before=f"""
class Pressed:
    def find_spec(self, name, *rest):
        if name == {module!r}:
            raise KeyboardInterrupt
sys.meta_path.insert(0, Pressed())
""")
    assert finish(process) == (130, "", "hmkcta: interrupted; nothing is left half written.\n")


def await_file(path: Path) -> None:
    """Wait until the other process has made it."""
    deadline = time.monotonic() + 30
    while not path.exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_reader_that_goes_away(packed: Path) -> None:
    process = start("info", packed, "--json")
    assert process.stdout is not None
    process.stdout.close()
    assert process.stderr is not None
    assert "Traceback" not in process.stderr.read()
    assert process.wait(timeout=60) in (0, 1)
    process.stderr.close()
