"""Every case of the shared corpus, and guards: the corpus is there, and it exercises every reason code."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from hmk_corpus import TESTS, Case, read_corpus
from hmkcta.cli import main
from hmkcta.errors import HmkctaError, Kind
from hmkcta.hmkfile import REASONS, WRITER_REASONS, Limits, load

CASES = read_corpus()


def test_corpus_is_there() -> None:
    assert len(CASES) > 200
    assert len({(case.name, case.base, str(case.edits), str(case.limits)) for case in CASES}) == len(CASES)


def test_corpus_exercises_every_reason() -> None:
    assert {case.reason for case in CASES} - {"ok"} == set(REASONS)


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.reason}: {case.name}")
def test_case(case: Case, tmp_path: Path) -> None:
    path = tmp_path / "case.hmk"
    data = case.build()
    if data is not None:
        path.write_bytes(data)
    if case.reason == "ok":
        load(path, limits=Limits(**case.limits))
        return
    with pytest.raises(HmkctaError) as caught:
        load(path, limits=Limits(**case.limits))
    assert (caught.value.kind.label, caught.value.reason) == (case.kind, case.reason), caught.value
    assert case.where in (None, caught.value.where)


def test_cases_have_the_kind_of_their_reason() -> None:
    kinds = {kind.label for kind in Kind}
    for case in CASES:
        assert case.reason == "ok" or (case.kind in kinds and case.kind == REASONS[case.reason].kind.label)


def test_specification_lists_every_reason() -> None:
    text = (TESTS.parent / "docs" / "format.md").read_text(encoding="utf-8")
    kinds = "|".join(kind.label for kind in Kind)
    rows = re.findall(rf"^\| `([a-z-]+)` \| ({kinds}) \| (.*) \|$", text, re.MULTILINE)
    documented = {code: (kind, sentence) for code, kind, sentence in rows}
    reasons = {**REASONS, **WRITER_REASONS}
    assert documented == {code: (reason.kind.label, reason.sentence) for code, reason in reasons.items()}


def test_the_command_line_has_the_same_reasons(tmp_path: Path) -> None:
    """Of every way to be no file at all, or none of this format; and a folder."""
    path = tmp_path / "case.hmk"
    cases = [case for case in CASES if case.where == "header" and case.reason != "ok" and not case.limits]
    assert {case.reason for case in cases} >= {"foreign-file", "truncated", "json-syntax", "header-too-large"}
    for case in cases:
        data = case.build()
        assert data is not None
        path.write_bytes(data)
        found = json.loads(CliRunner().invoke(main, ["info", str(path), "--json"]).stdout)["error"]
        assert (found["kind"], found["reason"]) == (case.kind, case.reason), case.name
    path.unlink()
    path.mkdir()
    for command in ("info", "verify"):
        found = json.loads(CliRunner().invoke(main, [command, str(path), "--json"]).stdout)["error"]
        assert (found["kind"], found["reason"], found["exit_code"]) == ("Io", "unreadable", 3)
