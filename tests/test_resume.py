"""Interrupted work goes on where it was, and ends in the bytes of work that was not interrupted."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hmkcta
from cli_tools import smooth
from fit_tools import file_of
from hmkcta import HmkctaError, Journal, Model
from hmkcta.journal import NODES, RUN
from hmkcta.support.recordlog import RecordLog
from resume_tools import DATA, LEVELS, MODES, After, Stop

#: Every kind of step: levels with back-fitting, a scheme found by trial, blocks, both goals, a transform.
CASES: dict[str, dict[str, Any]] = {
    "levels": {"plan": LEVELS, "scheme": "least"},
    "scheme chosen": {"plan": LEVELS, "quality": "fast"},
    "many clusters": {"plan": "R=1 C=4,1,5,5 K=2,1,2,2", "quality": "fast", "search": "fast"},
    "blocks, snr": {"plan": "R=1 grid=y:2,x:2 / R=4 / R=8", "snr": 20.0},
    "snr": {"snr": 20.0, "quality": "fast"},
    "size": {"size": 24000, "organisation": None},
    "transform": {"plan": "R=2,1,2,2 / R=1 C=2,1,2,2 K=2", "transform": "log1p"},
}
#: More calls than any run makes.
MANY = 10**6


def fitted(**options: Any) -> Model:
    settings: dict[str, Any] = {"organisation": MODES, **options}
    return hmkcta.compress(DATA.values, axes=DATA.axes, threads=2, **settings)


def resumed(folder: Path, **options: Any) -> tuple[bytes, int]:
    """The file that a resumed run makes, and how many nodes it found finished."""
    with Journal(folder / "partial", resume=True) as journal:
        return file_of(fitted(journal=journal, **options), folder), journal.found


def interrupted(folder: Path, calls: int, **options: Any) -> None:
    """Begin a run, or go on with one, and stop it."""
    with pytest.raises(Stop), Journal(folder / "partial", resume=True) as journal:
        fitted(journal=journal, progress=After(calls), **options)


def whole(folder: Path, **options: Any) -> tuple[bytes, int]:
    """The file of a run that is not stopped, and how often it tells its progress."""
    counter = After(MANY)
    return file_of(fitted(progress=counter, **options), folder), MANY - counter.left


@pytest.mark.parametrize("name", CASES)
def test_the_same_bytes_wherever_it_stopped(name: str, tmp_path: Path) -> None:
    options = CASES[name]
    reference, calls = whole(tmp_path, **options)
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
    ("snr", {"snr": 20.0}), ("transform", {"transform": "sqrt"}), ("nan", {"nan": 0.0}), ("kind", {"kind": "generic"}),
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


def test_what_was_explored_is_not_explored_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options: dict[str, Any] = {"snr": 25.0, "quality": "fast"}
    reference = file_of(fitted(**options), tmp_path)
    calls = 0
    while not (tmp_path / "partial" / "explored.json").exists():
        calls += 1
        interrupted(tmp_path, calls, **options)
    monkeypatch.setattr("hmkcta.search.engine.first_layouts", None)
    assert resumed(tmp_path, **options)[0] == reference


def test_the_memory_of_the_first_run_decides(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is streamed follows from the memory that was free when the run began, not from what is free now."""
    options = CASES["levels"]
    with monkeypatch.context() as patch:
        patch.setattr("hmkcta.streaming.budget.WORKSET", 5000)
        reference = file_of(fitted(**options), tmp_path)
        interrupted(tmp_path, 40, **options)
    assert resumed(tmp_path, **options)[0] == reference
    assert file_of(fitted(**options), tmp_path) != reference


def test_what_was_cut_into_blocks_is_cut_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Levels below blocks of a streamed tensor read it in the order of these, also where their cells are recalled."""
    monkeypatch.setattr("hmkcta.streaming.budget.WORKSET", 5000)
    options = {"plan": "R=2,1,2,2 grid=y:2,x:2 / R=2,1,2,2 / R=1"}
    reference, calls = whole(tmp_path, **options)
    for share in (0.3, 0.6, 0.95):
        interrupted(tmp_path, int(share * calls), **options)
        assert resumed(tmp_path, **options)[0] == reference


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
    for options in ({}, {"resume": True}, {"overwrite": True}):
        with pytest.raises(HmkctaError) as caught, Journal(tmp_path / "partial", **options) as journal:
            fitted(journal=journal, **CASES["levels"])
        assert caught.value.reason == "partial-busy"
    assert len(log) > 0
    log.close()


def test_one_call_a_journal(tmp_path: Path) -> None:
    """Whose block has not ended, so that there is no other process to wait for."""
    with Journal(tmp_path / "partial") as journal:
        fitted(journal=journal, plan="R=1")
        with pytest.raises(HmkctaError, match="one call a journal") as caught:
            fitted(journal=journal, plan="R=2")
    assert caught.value.reason == "partial-busy"


def test_another_node_than_the_one_written_down(tmp_path: Path) -> None:
    """A journal that got mixed up is noticed, not mixed in."""
    interrupted(tmp_path, 40, **CASES["levels"])
    with Records(tmp_path) as log:
        first = log.read((2, 0))
        assert first is not None
        log.clear()
        log.append((3, 0), first)
    with pytest.raises(HmkctaError) as caught:
        resumed(tmp_path, **CASES["levels"])
    assert caught.value.reason == "partial-damaged"


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


def test_what_is_kept_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was finished first is forgotten, and fitted once more, to the same bytes."""
    import hmkcta.journal as journals

    options = CASES["levels"]
    reference, calls = whole(tmp_path, **options)
    monkeypatch.setattr(journals, "LEAST_KEPT", 8_000)
    monkeypatch.setattr(journals, "ARRAY_KEPT", 0)
    interrupted(tmp_path, int(0.95 * calls), **options)
    assert 1_000 < (tmp_path / "partial" / NODES).stat().st_size <= 8_000
    content, found = resumed(tmp_path, **options)
    assert (content, found > 0) == (reference, True)


def test_the_smallest_keys_are_forgotten(tmp_path: Path) -> None:
    """And not written again when they come once more, as what comes next in a resumed run would go for them."""
    path = tmp_path / "log"
    log = RecordLog(path)
    log.most = 1000
    for n in range(50):
        log.append((n, 0), bytes(80))
        assert path.stat().st_size <= 1000
    kept = list(log)
    assert kept == sorted(kept)
    assert kept[-1] == (49, 0)
    assert 5 <= len(kept) <= 10
    for n in range(kept[0][0]):
        log.append((n, 0), bytes(80))
    assert set(kept[-4:]) <= set(log)
    log.append((60, 0), bytes(2000))
    assert (60, 0) not in set(log)
    log.close()
    again = RecordLog(path)
    assert set(kept[-4:]) <= set(again)
    again.close()
    assert list(tmp_path.iterdir()) == [path]
