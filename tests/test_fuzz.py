"""The fuzzer: that it finds what it is there to find, and that a few hundred mutants find nothing."""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from fuzz.__main__ import main
from fuzz.campaign import Campaign, seeds
from fuzz.mutants import CHANGES, mutated
from fuzz.readers import Answer, Reader, bundled, python_reader, viewer_reader
from hmk_corpus import Parts
from hmkcta.errors import HmkctaError
from hmkcta.hmkfile import loads

#: A reader that takes every file; `{}` is what it does before it answers.
PLANTED = """
import json, os, sys, time
while len(head := sys.stdin.buffer.read(4)) == 4:
    data = sys.stdin.buffer.read(int.from_bytes(head, "little"))
    said = dict(reason="ok", kind="", escape="", seconds=0.0, mebibytes=0.0, lines=0)
    {}
    print(json.dumps(said), flush=True)
"""


def planted(fault: str) -> Reader:
    return Reader([sys.executable, "-c", PLANTED.format(fault)])


class Fixed(Reader):
    """A reader that says the same of every file."""

    def __init__(self, reason: str) -> None:
        super().__init__([])
        self.reason = reason

    def send(self, data: bytes) -> None:
        del data

    def answer(self) -> Answer:
        return Answer(self.reason)


def findings(readers: dict[str, Reader]) -> list[str]:
    """What a campaign of a few mutants finds."""
    campaign = Campaign(readers, seed=1)
    try:
        campaign.run(5)
    finally:
        for reader in readers.values():
            reader.close()
    return sorted(campaign.findings)


def test_the_first_files_are_valid() -> None:
    found = seeds(np.random.default_rng(1))
    assert len(found) > 20
    for data in found:
        loads(data)


def test_mutants_follow_from_the_seed_and_get_past_the_checksums() -> None:
    """Most must be refused by what comes after the checksums, and every change must lead somewhere."""
    first = seeds(np.random.default_rng(1))
    reasons, changes = Counter[str](), Counter[str]()
    rng, again = np.random.default_rng(2), np.random.default_rng(2)
    for number in range(600):
        change, data = mutated(rng, first[number % len(first)], first)
        assert mutated(again, first[number % len(first)], first) == (change, data)
        changes.update(change.split(" + "))
        try:
            loads(data)
            reasons["ok"] += 1
        except HmkctaError as error:
            reasons[error.reason] += 1
    assert {change.__name__ for change in CHANGES} <= set(changes)
    assert len(reasons) > 30
    assert 10 < reasons["ok"] < 300
    assert reasons["header-crc"] + reasons["section-crc"] < 60


def test_what_cannot_be_taken_apart_is_changed_all_the_same() -> None:
    rng = np.random.default_rng(1)
    for data in (b"", b"x", bytes(8), b"\xff" * 100):
        assert mutated(rng, data, [data])[0] == "raw_bytes"


def test_a_disagreement_is_found() -> None:
    assert findings({"one": Fixed("ok"), "other": Fixed("ok")}) == []
    assert findings({"one": Fixed("ok"), "other": Fixed("truncated")}) == [
        "they disagree: one says ok, other says truncated"]


@pytest.mark.parametrize(("fault", "told"), [
    ("said['escape'] = 'TypeError: no'", "reader: TypeError: no"),
    ("said['seconds'] = 1.5", "reader takes more than 1 s (ok)"),
    ("said['mebibytes'] = 300", "reader takes more than 256 MiB (ok)"),
    ("os.abort()", "reader: the process ended with -6: "),
    ("raise SystemError('gone')", "reader: the process ended with 1: SystemError: gone"),
])
def test_a_fault_of_a_reader_is_found(fault: str, told: str) -> None:
    assert findings({"reader": planted(fault)}) == [told]


def test_a_reader_that_does_not_answer_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fuzz.readers.PATIENCE", 0.3)
    assert "reader: no answer" in findings({"reader": planted("time.sleep(60)")})


def test_the_python_reader_says_what_it_thinks() -> None:
    reader, valid = python_reader(256), seeds(np.random.default_rng(1))[0]
    try:
        for data, verdict in ((valid, "ok"), (valid[:-1], "InsufficientData/truncated"), (valid, "ok")):
            reader.send(data)
            answer = reader.answer()
            assert (answer.verdict, answer.escape) == (verdict, "")
    finally:
        reader.close()


def test_new_lines_make_a_mutant_worth_a_change() -> None:
    campaign = Campaign({"reader": planted("said['lines'] = len(data) % 2")}, seed=1)
    before = len(campaign._pool)  # pyright: ignore[reportPrivateUsage]
    for number, data in enumerate(seeds(np.random.default_rng(1))[:6]):
        parts = Parts.split(data)
        changed = [parts.with_header({**parts.header, "writer": writer}).join() for writer in ("x", "xx")]
        campaign.examine(number, "", next(each for each in changed if len(each) % 2))
    for reader in campaign._readers.values():  # pyright: ignore[reportPrivateUsage]
        reader.close()
    assert len(campaign._pool) == before + 6  # pyright: ignore[reportPrivateUsage]


def test_a_few_hundred_mutants_find_nothing(tmp_path: Path) -> None:
    """`make fuzz` tries more. Time is not asserted: the machine may be at work."""
    bundle = bundled(tmp_path)
    if bundle is None:
        pytest.skip("no Node, or its packages were not installed: make page")
    viewer_reader(bundle).close()
    options = ["--count", "300", "--jobs", "1", "--seed", "7", "--seconds", "15", "--output", str(tmp_path / "found")]
    result = CliRunner().invoke(main, options)
    assert result.exit_code == 0, result.output
    assert "300 mutants" in result.output
