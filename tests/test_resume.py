"""Interrupted work goes on where it was, and ends in the bytes of work that was not interrupted."""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hmkcta
from cli_tools import finish, refused, report, run, saved, smooth, start
from hmkcta import HmkctaError, Journal, Model
from hmkcta.journal import NODES, PLAN, RUN
from hmkcta.recordlog import RecordLog
from hmkcta.synthetic import material

DATA = material(lights=4, views=6, size=24, seed=2)
LEVELS = "R=3,2,4,4 / R=2,1,2,2 C=3,2,2,2 K=2 / R=1 C=2,1,2,2 K=2"
MODES = "light+rgb, view, y, x"

#: Every kind of step: levels with back-fitting, a scheme found by trial, ranks of their own for both goals, a plan.
CASES: dict[str, dict[str, Any]] = {
    "levels": {"plan": LEVELS, "scheme": "least"},
    "scheme chosen": {"plan": LEVELS, "quality": "fast"},
    "many clusters": {"plan": "R=1 C=12,1,12,12 K=2,1,2,2", "quality": "fast"},
    "blocks, snr": {"plan": "R=1 grid=y:2,x:2 / R<=8", "snr": 20.0},
    "own ranks, size": {"plan": "R=2,1,2,2 C=2,1,2,2 / R<=8", "size": 20000},
    "chosen plan": {"snr": 20.0, "quality": "fast"},
    "transform": {"plan": "R=2,1,2,2 / R=1 C=2,1,2,2 K=2", "transform": "log1p"},
}


class Stop(Exception):
    """What ends a run in these tests."""


class After:
    """Progress that ends the run when it is called for the n-th time."""

    def __init__(self, calls: int) -> None:
        self.left = calls

    def __call__(self, *_: object) -> None:
        self.left -= 1
        if self.left < 0:
            raise Stop


def fitted(**options: Any) -> Model:
    return hmkcta.compress(DATA.values, axes=DATA.axes, organisation=MODES, threads=2, **options)


def file_of(model: Model, folder: Path) -> bytes:
    model.save(folder / "model.hmk", overwrite=True)
    return (folder / "model.hmk").read_bytes()


def resumed(folder: Path, **options: Any) -> tuple[bytes, int]:
    """The file that a resumed run makes, and how many nodes it found finished."""
    with Journal(folder / "partial", resume=True) as journal:
        return file_of(fitted(journal=journal, **options), folder), journal.found


def interrupted(folder: Path, calls: int, **options: Any) -> None:
    """Begin a run, or go on with one, and stop it."""
    with pytest.raises(Stop), Journal(folder / "partial", resume=True) as journal:
        fitted(journal=journal, progress=After(calls), **options)


def calls_of(**options: Any) -> int:
    """How often a whole run tells its progress."""
    many = 10**6
    counter = After(many)
    fitted(progress=counter, **options)
    return many - counter.left


@pytest.mark.parametrize("name", CASES)
def test_the_same_bytes_wherever_it_stopped(name: str, tmp_path: Path) -> None:
    options = CASES[name]
    reference = file_of(fitted(**options), tmp_path)
    calls = calls_of(**options)
    for share in (0.3, 0.6, 0.95):
        interrupted(tmp_path, int(share * calls), **options)
        assert resumed(tmp_path, **options)[0] == reference
        assert not (tmp_path / "partial").exists()


def test_a_run_stopped_again_and_again_comes_to_its_end(tmp_path: Path) -> None:
    options = CASES["levels"]
    found = [0]
    for calls in (20, 35, 50):
        interrupted(tmp_path, calls, **options)
        with Records(tmp_path) as log:
            found.append(len(log))
    assert found == sorted(set(found))
    content, before = resumed(tmp_path, **options)
    assert (content, before) == (file_of(fitted(**options), tmp_path), found[-1])


class Records:
    """The records of the journal in a folder."""

    def __init__(self, folder: Path) -> None:
        self.log = RecordLog(folder / "partial" / NODES)

    def __enter__(self) -> RecordLog:
        return self.log

    def __exit__(self, *_: object) -> None:
        self.log.close()


def test_a_torn_or_damaged_end_is_dropped(tmp_path: Path) -> None:
    """Whatever a crash of the machine leaves of the last records, the others count."""
    options = CASES["levels"]
    reference = file_of(fitted(**options), tmp_path)
    rng = random.Random(5)
    for damage in ("cut", "flip", "noise", "all"):
        interrupted(tmp_path, 50, **options)
        path = tmp_path / "partial" / NODES
        content = bytearray(path.read_bytes())
        at = rng.randrange(len(content))
        whole = len(content)
        if damage == "cut":
            del content[at:]
        elif damage == "flip":
            content[at] ^= 1 << rng.randrange(8)
        elif damage == "noise":
            content += rng.randbytes(1000)
        else:
            content.clear()
        path.write_bytes(content)
        with Records(tmp_path) as log:
            assert len(log) > 0 or damage == "all"
        assert path.stat().st_size <= whole
        assert resumed(tmp_path, **options)[0] == reference


def test_records_are_a_prefix_wherever_the_file_is_cut(tmp_path: Path) -> None:
    path = tmp_path / "log"
    log = RecordLog(path)
    for n in range(4):
        log.append((1, n), bytes([n]) * n)
    log.close()
    whole = path.read_bytes()
    lengths: list[int] = []
    for size in range(len(whole) + 1):
        path.write_bytes(whole[:size])
        log = RecordLog(path)
        assert [log.read((1, n)) for n in range(len(log))] == [bytes([n]) * n for n in range(len(log))]
        lengths.append(len(log))
        log.append((2, 0), b"after")
        log.close()
        log = RecordLog(path)
        assert (len(log), log.read((2, 0))) == (lengths[-1] + 1, b"after")
        log.close()
    assert lengths == sorted(lengths)
    assert (lengths[0], lengths[-1]) == (0, 4)


@pytest.mark.parametrize(("field", "changed"), [
    ("seed", {"seed": 4}), ("quality", {"quality": "fast"}), ("plan", {"plan": LEVELS.replace("R=1", "R=2")}),
    ("snr", {"snr": 20.0}), ("transform", {"transform": "sqrt"}), ("nan", {"nan": 0.0}), ("kind", {"kind": "volume"}),
    ("scheme", {"scheme": "most"}), ("organisation", {"organisation": "light, rgb+view, y, x"}),
    ("axes", {"axes": ["a", "b", "c", "d", "e"], "organisation": "a+e, b, c, d"}),
    ("max_memory", {"max_memory": 2**30}),
    ("sha256 of the array", {"array": DATA.values * np.float32(1.5)}),
])
def test_another_run_is_refused(field: str, changed: dict[str, Any], tmp_path: Path) -> None:
    options: dict[str, Any] = {"array": DATA.values, "axes": DATA.axes, "organisation": MODES, **CASES["levels"]}
    if field == "nan":  # it decides only where there is something to replace
        options |= {"array": np.where(DATA.values > DATA.values.max() / 2, np.nan, DATA.values), "nan": 1.0}
    with pytest.raises(Stop), Journal(tmp_path / "partial") as journal:
        hmkcta.compress(**options, journal=journal, progress=After(30))
    before = sorted((path.name, path.read_bytes()) for path in (tmp_path / "partial").iterdir())
    with pytest.raises(HmkctaError) as caught, Journal(tmp_path / "partial", resume=True) as journal:
        hmkcta.compress(**{**options, **changed}, journal=journal)
    assert caught.value.reason == "partial-differs"
    assert field in str(caught.value.found)
    assert field in str(caught.value.allowed)
    assert sorted((path.name, path.read_bytes()) for path in (tmp_path / "partial").iterdir()) == before


@pytest.mark.parametrize("field", ["hmkcta", "kernels", "machine"])
def test_another_program_is_refused(field: str, tmp_path: Path) -> None:
    interrupted(tmp_path, 30, **CASES["levels"])
    path = tmp_path / "partial" / RUN
    path.write_text(json.dumps({**json.loads(path.read_text()), field: "another"}))
    with pytest.raises(HmkctaError, match=f'{field} .* allowed {field} "another"'):
        resumed(tmp_path, **CASES["levels"])


def test_a_chosen_plan_is_not_chosen_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options: dict[str, Any] = {"snr": 25.0}
    reference = file_of(fitted(**options), tmp_path)
    calls = 0
    while not (tmp_path / "partial" / PLAN).exists():
        calls += 5
        interrupted(tmp_path, calls, **options)
    monkeypatch.setattr("hmkcta.encode.tune", None)
    assert resumed(tmp_path, **options)[0] == reference


def test_the_memory_of_the_first_run_decides(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is streamed follows from the memory that was free when the run began, not from what is free now."""
    options = CASES["levels"]
    with monkeypatch.context() as patch:
        patch.setattr("hmkcta.predict.WORKSET", 5000)
        reference = file_of(fitted(**options), tmp_path)
        interrupted(tmp_path, 40, **options)
    assert resumed(tmp_path, **options)[0] == reference
    assert file_of(fitted(**options), tmp_path) != reference


def test_no_trace_of_a_run_that_cannot_be(tmp_path: Path) -> None:
    for options in ({"plan": "R=99"}, {"plan": "R=2,1,2,2", "size": 10}):
        with pytest.raises(HmkctaError), Journal(tmp_path / "partial") as journal:
            fitted(journal=journal, **options)
        assert not list(tmp_path.iterdir())


def test_files_of_others_stay(tmp_path: Path) -> None:
    folder = tmp_path / "partial"
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    with Journal(folder) as journal:
        fitted(journal=journal, plan="R=1")
    assert [path.name for path in folder.iterdir()] == ["notes.txt"]


def test_one_process_at_a_time(tmp_path: Path) -> None:
    interrupted(tmp_path, 30, **CASES["levels"])
    log = RecordLog(tmp_path / "partial" / NODES)
    for options in ({"resume": True}, {"overwrite": True}):
        with pytest.raises(HmkctaError) as caught, Journal(tmp_path / "partial", **options) as journal:
            fitted(journal=journal, **CASES["levels"])
        assert caught.value.reason == "partial-busy"
    assert len(log) > 0
    log.close()


def test_another_node_than_the_one_written_down(tmp_path: Path) -> None:
    """A journal that got mixed up is noticed, not mixed in."""
    interrupted(tmp_path, 40, **CASES["levels"])
    with Records(tmp_path) as log:
        first = log.read((1, 0))
        assert first is not None
        log.clear()
        log.append((2, 0), first)
    with pytest.raises(HmkctaError) as caught:
        resumed(tmp_path, **CASES["levels"])
    assert caught.value.reason == "partial-damaged"


# The command line


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return saved(tmp_path_factory.mktemp("source") / "material.npy", DATA.values)


COMMAND = ("--axes", "light,view,y,x,rgb", "--organisation", MODES, "--plan", LEVELS, "--threads", 2)
CHOSEN = ("--axes", "light,view,y,x,rgb", "--organisation", MODES, "--snr", 27, "--threads", 2)


def begun(source: Path, output: Path) -> None:
    """Interrupted work on an output."""
    with pytest.raises(Stop), Journal(f"{output}.partial") as journal:
        hmkcta.compress(np.load(source), LEVELS, axes=["light", "view", "y", "x", "rgb"], organisation=MODES,
                        journal=journal, progress=After(40))


def test_interrupted_work_is_neither_lost_nor_taken_silently(source: Path, tmp_path: Path) -> None:
    output = tmp_path / "a.hmk"
    begun(source, output)
    sentence = refused("compress", source, "-o", output, *COMMAND, code=3)
    assert "--resume" in sentence
    assert "--overwrite" in sentence
    assert "seed 3" in refused("compress", source, "-o", output, *COMMAND, "--seed", 3, "--resume", code=2)
    found = report("compress", source, "-o", output, *COMMAND, "--resume")
    assert found["nodes_resumed"] > 10
    assert list(tmp_path.iterdir()) == [output]
    begun(source, output)
    again = report("compress", source, "-o", output, *COMMAND, "--overwrite")
    assert again["nodes_resumed"] == 0
    assert list(tmp_path.iterdir()) == [output]


def test_resume_replaces_an_output_only_when_told_to(source: Path, tmp_path: Path) -> None:
    output = tmp_path / "a.hmk"
    output.write_text("precious")
    begun(source, output)
    refused("compress", source, "-o", output, *COMMAND, "--resume", code=3)
    found = report("compress", source, "-o", output, *COMMAND, "--resume", "--overwrite")
    assert found["nodes_resumed"] > 10
    assert hmkcta.open(output).nbytes == found["bytes"]


def test_resume_where_nothing_was_begun(source: Path, tmp_path: Path) -> None:
    """So that a batch script can always ask for it."""
    result = run("compress", source, "-o", tmp_path / "a.hmk", *COMMAND, "--resume")
    assert "begins anew" in result.stderr
    assert list(tmp_path.iterdir()) == [tmp_path / "a.hmk"]


def test_a_file_where_the_journal_should_be(source: Path, tmp_path: Path) -> None:
    (tmp_path / "a.hmk.partial").write_text("precious")
    for extra in ("--resume", "--overwrite", "--quiet"):
        assert "a.hmk.partial" in refused("compress", source, "-o", tmp_path / "a.hmk", *COMMAND, extra, code=3)
    assert (tmp_path / "a.hmk.partial").read_text() == "precious"


@pytest.mark.skipif(sys.platform != "linux", reason="needs a limit on the file size")
def test_full_disk(source: Path, tmp_path: Path) -> None:
    """Every node that still fitted on the disk is there when there is room again."""
    output = tmp_path / "a.hmk"
    limit = "import resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))"
    code, out, err = finish(start("compress", source, "-o", output, *COMMAND, "--quiet", before=limit))
    assert (code, out) == (3, "")
    assert "disk-full" in err
    assert "--resume" in err
    assert err.count("\n") == 1
    found = report("compress", source, "-o", output, *COMMAND, "--resume")
    assert found["nodes_resumed"] > 0
    run("compress", source, "-o", tmp_path / "b.hmk", *COMMAND)
    assert output.read_bytes() == (tmp_path / "b.hmk").read_bytes()


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_says_how_to_go_on(number: signal.Signals, source: Path, tmp_path: Path) -> None:
    words = ("compress", source, "-o", "a.hmk", *COMMAND)
    process = start(*words, cwd=tmp_path)
    await_size(tmp_path / "a.hmk.partial" / NODES, 20000)
    process.send_signal(number)
    code, out, err = finish(process)
    assert (code, out) == (128 + number, "")
    assert err.splitlines()[-1].startswith("hmkcta: interrupted")
    assert err.splitlines()[-1].endswith(f"--plan '{LEVELS}' --threads 2 --resume")
    assert "a.hmk.partial" in err
    code, out, err = finish(start(*words, "--resume", "--json", cwd=tmp_path))
    assert (code, json.loads(out)["nodes_resumed"] > 0) == (0, True)


#: A long call of native code, during which Python sees no signal: the first before any journal, the second within.
DEAF = """
import hmkcta.cli.compress as c, numpy as np
def deaf(*a, **k):
    open({ready!r}, "w").close()
    np.linalg.svd(np.random.default_rng(1).random((4000, 4000)))
c.compress = deaf
"""
DEAF_NODE = """
import hmkcta.hierarchy as h, numpy as np
def deaf(*a, **k):
    open({ready!r}, "w").close()
    np.linalg.svd(np.random.default_rng(1).random((4000, 4000)))
h.fit_level = deaf
"""


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
@pytest.mark.parametrize("deaf", [DEAF, DEAF_NODE], ids=["main thread", "node"])
def test_an_interrupt_does_not_wait_for_native_code(deaf: str, source: Path, tmp_path: Path) -> None:
    process = start("compress", source, "-o", tmp_path / "a.hmk", *COMMAND, "--json",
                    before=deaf.format(ready=str(tmp_path / "ready")))
    await_size(tmp_path / "ready", 0)
    begin = time.monotonic()
    process.send_signal(signal.SIGINT)
    code, out, err = finish(process)
    assert code == 130
    assert time.monotonic() - begin < 8
    assert json.loads(out)["error"]["exit_code"] == 130
    assert err == "hmkcta: interrupted; nothing is left half written.\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ready"]


def await_size(path: Path, size: int) -> None:
    """Wait until another process has written so much there."""
    deadline = time.monotonic() + 60
    while not (path.exists() and path.stat().st_size >= size):
        assert time.monotonic() < deadline
        time.sleep(0.002)


@pytest.mark.skipif(os.name != "posix", reason="needs kill -9")
def test_killed_at_twenty_random_moments(source: Path, tmp_path: Path) -> None:
    output = tmp_path / "a.hmk"
    rng = random.Random(20)
    reference: dict[tuple[object, ...], bytes] = {}
    for words in (COMMAND, CHOSEN):
        begin = time.monotonic()
        assert finish(start("compress", source, "-o", output, *words, "--quiet"))[0] == 0
        takes = time.monotonic() - begin
        reference[words] = output.read_bytes()
        output.unlink()
    kills = went_on = ended = 0
    while kills < 20:
        words = (COMMAND, CHOSEN)[ended % 2]
        process = start("compress", source, "-o", output, *words, "--quiet", "--resume")
        time.sleep(rng.uniform(0.3, 1.0) * takes)
        killed = process.poll() is None
        process.kill()
        code, _, err = finish(process)
        assert code in (0, -signal.SIGKILL), err
        kills += killed
        if output.exists():
            assert output.read_bytes() == reference[words]
            output.unlink()
            ended += 1
        else:
            nodes = tmp_path / "a.hmk.partial" / NODES
            went_on += nodes.exists() and nodes.stat().st_size > 0
    words = (COMMAND, CHOSEN)[ended % 2]
    assert finish(start("compress", source, "-o", output, *words, "--quiet", "--resume"))[0] == 0
    assert output.read_bytes() == reference[words]
    assert [path.name for path in tmp_path.iterdir() if path.suffix != ".tmp"] == ["a.hmk"]
    assert went_on >= 5, "the kills came too early or too late to test anything"


def test_a_node_that_backfitting_leaves_as_it_was(tmp_path: Path) -> None:
    """It is remembered as such."""
    array = smooth(6, 8, 10)
    plan = "R=6,8,10 / R=1 C=2 K=2"
    reference = hmkcta.compress(array, plan)
    journal = Journal(tmp_path / "partial")
    hmkcta.compress(array, plan, journal=journal)
    journal.close()
    with Records(tmp_path) as log:
        assert b"" in [log.read(key) for key in log]
    with Journal(tmp_path / "partial", resume=True) as journal:
        model = hmkcta.compress(array, plan, journal=journal)
    assert np.array_equal(model.reconstruct(), reference.reconstruct())
