"""Every case of the shared corpus is refused for its reason; every reason has a case, or cannot have one."""

from __future__ import annotations

from pathlib import Path

import pytest

from hmk_corpus import Case, read_corpus
from hmkcta.errors import HmkctaError
from hmkcta.hmkfile import REASONS, Limits, load

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
