"""`hmkcta compress` interrupted, killed, out of room, and resumed."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import click
import numpy as np
import pytest

import hmkcta
from cli_tools import finish, refused, report, run, saved, start
from hmkcta import HmkctaError, Journal
from hmkcta.cli import main
from hmkcta.cli.app import may_go_on
from hmkcta.cli.options import WORDS
from hmkcta.errors import Kind
from hmkcta.hmkfile import published
from hmkcta.journal import NODES
from hmkcta.support.recordlog import RecordLog
from resume_tools import DATA, LEVELS, MODES, After, Stop


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


def test_resume_where_another_process_has_only_begun(source: Path, tmp_path: Path) -> None:
    """Which has no node to go on with yet, and holds its folder."""
    (tmp_path / "a.hmk.partial").mkdir()
    log = RecordLog(tmp_path / "a.hmk.partial" / NODES)
    for extra in ("--resume", "--overwrite", "--quiet"):
        result = run("compress", source, "-o", tmp_path / "a.hmk", *COMMAND, extra, code=3)
        assert "partial-busy" in result.stderr
        assert "begins anew" not in result.stderr
    log.close()


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
    assert err.endswith("--resume\n")
    assert (err.count("\n"), err.count("Next: ")) == (1, 1)
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
import hmkcta.fitting.hierarchy as h, numpy as np
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
    assert err == ("hmkcta: interrupted; nothing is left half written, and nothing kept, as no node was finished. "
                   "Next: the same command, which begins anew.\n")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ready"]


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
def test_an_interrupt_while_a_plan_is_chosen_says_that_the_choice_begins_anew(source: Path, tmp_path: Path) -> None:
    ready = tmp_path / "ready"
    slow = f"""
import hmkcta.encode as e, time
def slow(*a, **k):
    open({str(ready)!r}, "w").close()
    time.sleep(60)
e.find_model = slow
"""
    process = start("compress", source, "-o", tmp_path / "a.hmk", *CHOSEN, before=slow)
    await_size(ready, 0)
    process.send_signal(signal.SIGINT)
    code, _, err = finish(process)
    assert code == 130
    assert err.splitlines()[-1] == (
        "hmkcta: interrupted; nothing is left half written, and nothing kept, as the search keeps only "
        "what it has settled. Next: the same command, which begins anew.")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ready"]


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
def test_an_interrupted_search_ends_with_the_best_found_so_far(source: Path, tmp_path: Path) -> None:
    """The first Ctrl-C comes when the first layouts are judged; without it there would be many more rounds."""
    ready = tmp_path / "ready"
    waiting = f"""
import hmkcta.search.engine as e, time
ranked, rounds = e.Search._ranked, []
def wait(self, *a, **k):
    found = ranked(self, *a, **k)
    rounds.append(1)
    open({str(ready)!r}, "w").close()
    while len(rounds) == 1 and not self.enough():
        time.sleep(0.01)
    assert len(rounds) < 4
    return found
e.Search._ranked = wait
"""
    process = start("compress", source, "-o", tmp_path / "a.hmk", "--size", "3KB", "--json", before=waiting)
    await_size(ready, 0)
    process.send_signal(signal.SIGINT)
    code, out, err = finish(process)
    assert code == 0, err
    assert "taking the best that was found so far" in err
    assert any("ended early" in note for note in json.loads(out)["notes"])
    assert (tmp_path / "a.hmk").stat().st_size <= 3000


def written(path: Path) -> int:
    """Bytes of a file that another process may remove at any moment; -1 where there is none."""
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return -1


def await_size(path: Path, size: int) -> None:
    """Wait until another process has written so much there."""
    deadline = time.monotonic() + 60
    while written(path) < size:
        assert time.monotonic() < deadline
        time.sleep(0.002)


def a_moment(process: subprocess.Popen[str], nodes: Path, more: float, seconds: float) -> None:
    """Wait until more bytes of nodes are kept than were, if the work does not end before, and then some seconds."""
    kept = max(written(nodes), 0)
    while process.poll() is None and written(nodes) < kept + more:
        time.sleep(0.002)
    time.sleep(seconds)


@pytest.mark.skipif(os.name != "posix", reason="needs kill -9")
def test_killed_at_twenty_random_moments(source: Path, tmp_path: Path) -> None:
    """Moments by the clock, before anything is kept too, in turn with moments by what is kept: that work has gone on
    where a machine busy with other tests is slower or faster than it was.
    """
    output, nodes = tmp_path / "a.hmk", tmp_path / "a.hmk.partial" / NODES
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
        if kills % 2:
            a_moment(process, nodes, rng.uniform(0, 0.5) * len(reference[words]), rng.uniform(0, 0.1) * takes)
        else:
            time.sleep(rng.uniform(0, 1) * takes)
        killed = process.poll() is None
        process.kill()
        code, _, err = finish(process)
        assert code in (0, -signal.SIGKILL), err
        kills += killed
        if output.exists():
            assert output.read_bytes() == reference[words]
            output.unlink()
            ended += not nodes.parent.exists()  # killed when the file was there, and what was kept for it still
        else:
            went_on += written(nodes) > 0
    words = (COMMAND, CHOSEN)[ended % 2]
    assert finish(start("compress", source, "-o", output, *words, "--quiet", "--resume"))[0] == 0
    assert output.read_bytes() == reference[words]
    assert [path.name for path in tmp_path.iterdir()] == ["a.hmk"]
    assert went_on >= 5, "the kills came too early or too late to test anything"


@pytest.mark.parametrize(("kind", "reason", "words", "ends_otherwise"), [
    (Kind.IO, "disk-full", (), True), (Kind.IO, "partial-busy", (), False), (Kind.CORRUPTION, "x", (), False),
    (Kind.RESOURCE_LIMIT, "memory", (), True), (Kind.RESOURCE_LIMIT, "memory", ("--max-memory", "1GB"), False),
])
def test_resume_is_advised_where_it_can_help(kind: Kind, reason: str, words: tuple[str, ...],
                                             ends_otherwise: bool) -> None:
    context = click.Context(main)
    context.meta[WORDS] = ["a.npy", *words]
    assert may_go_on(context, HmkctaError(kind, reason, "a.hmk")) == ends_otherwise


# Killed while the file is published

#: What kills the process before or after the file gets its name.
KILL = """
import os, signal
import hmkcta.hmkfile.publish as p
replace = os.replace
def replaced(source, target):
    if str(target).endswith({name!r}):
        if {after}:
            replace(source, target)
        os.kill(os.getpid(), signal.SIGKILL)
    replace(source, target)
p.os.replace = replaced
"""
kills = pytest.mark.skipif(os.name != "posix", reason="needs kill -9")


def killed(*words: object, name: str, after: bool) -> None:
    """A command that is killed when it gives a file of this name its name."""
    assert finish(start(*words, before=KILL.format(name=name, after=after)))[0] == -signal.SIGKILL


def unfinished(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir() if path.suffix == ".tmp"]


@kills
def test_what_a_killed_writer_left_is_removed_by_the_next_run(source: Path, tmp_path: Path) -> None:
    output = tmp_path / "a.hmk"
    killed("compress", source, "-o", output, *COMMAND, name="a.hmk", after=False)
    assert len(unfinished(tmp_path)) == 1
    others = [tmp_path / name for name in (".a.hmk.0123.tmp", ".b.hmk.0123456789abcdef.tmp", "a.hmk.tmp")]
    for other in others:
        other.write_text("precious")
    run("compress", source, "-o", output, *COMMAND, "--resume")
    assert sorted(tmp_path.iterdir()) == sorted([output, *others])
    for other in others:
        other.unlink()
    killed("decompress", output, "-o", tmp_path / "a.npy", name="a.npy", after=False)
    assert len(unfinished(tmp_path)) == 1
    run("decompress", output, "-o", tmp_path / "a.npy")
    assert unfinished(tmp_path) == []


def test_what_another_process_is_writing_stays(tmp_path: Path) -> None:
    """Two that write one output are nothing to each other until one of them is done."""
    with published(tmp_path / "a.hmk") as first:
        first.write(b"first")
        first.flush()
        with published(tmp_path / "a.hmk") as second:
            second.write(b"second")
            assert len(unfinished(tmp_path)) == 2
        (tmp_path / "a.hmk").unlink()
    assert (tmp_path / "a.hmk").read_bytes() == b"first"


@kills
def test_a_finished_output_with_its_journal_is_success(source: Path, tmp_path: Path) -> None:
    output, words = tmp_path / "a.hmk", ("compress", source, "-o", tmp_path / "a.hmk", *COMMAND)
    killed(*words, name="a.hmk", after=True)
    whole, folder = output.read_bytes(), tmp_path / "a.hmk.partial"
    assert folder.exists()
    refused(*words, code=3)
    refused(*words, "--seed", 3, "--resume", code=3)
    result = run(*words, "--resume")
    assert "finished already" in result.stderr
    assert (output.read_bytes(), list(tmp_path.iterdir())) == (whole, [output])
    refused(*words, "--resume", code=3)  # whose file it is nobody knows now

    output.unlink()
    killed(*words, name="a.hmk", after=True)
    output.write_bytes(b"of somebody else")
    refused(*words, "--resume", code=3)
    output.unlink()
    assert report(*words, "--resume")["nodes_resumed"] > 10
    assert output.read_bytes() == whole


@kills
def test_a_finished_output_that_missed_its_goal_says_so_again(source: Path, tmp_path: Path) -> None:
    words = ("compress", source, "-o", tmp_path / "a.hmk", *COMMAND, "--snr", 90)
    killed(*words, name="a.hmk", after=True)
    found = report(*words, "--resume", code=7)
    assert found["reached"] is False
    assert found["bytes"] == (tmp_path / "a.hmk").stat().st_size
