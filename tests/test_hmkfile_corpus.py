"""Every case of the shared corpus is refused for its reason; every reason has a case, or cannot have one."""

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


@pytest.mark.parametrize("case", CASES, ids=[case.name for case in CASES])
def test_case(case: Case, tmp_path: Path) -> None:
    path = tmp_path / "case.hmk"
    path.write_bytes(case.build())
    with pytest.raises(HmkctaError) as caught:
        load(path, limits=Limits(**case.limits))
    error = caught.value
    assert (error.kind.value[0], error.reason) == (case.kind, case.reason), error
    assert case.where is None or error.where == case.where, error
    assert str(path) in str(error)


def test_every_reason_has_a_case() -> None:
    """But for a path that cannot be read, which is no file."""
    assert REASONS.keys() - {case.reason for case in CASES} == {"unreadable"}
    assert len({case.name for case in CASES}) == len(CASES)


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
    cases = [case for case in CASES if case.where == "header" and not case.limits]
    assert {case.reason for case in cases} >= {"foreign-file", "truncated", "json-syntax", "header-too-large"}
    for case in cases:
        path.write_bytes(case.build())
        found = json.loads(CliRunner().invoke(main, ["info", str(path), "--json"]).stdout)["error"]
        assert (found["kind"], found["reason"]) == (case.kind, case.reason), case.name
    path.unlink()
    path.mkdir()
    for command in ("info", "verify"):
        found = json.loads(CliRunner().invoke(main, [command, str(path), "--json"]).stdout)["error"]
        assert (found["kind"], found["reason"], found["exit_code"]) == ("Io", "unreadable", 3)
