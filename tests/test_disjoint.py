"""Blocks that share no element, of a tensor that memory does not hold: fitted one by one, as in memory."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from hmkcta.errors import HmkctaError
from hmkcta.streaming import budget
from streaming_tools import WH4_LIKE, fitted

pytestmark = pytest.mark.usefixtures("small_slabs")

@pytest.mark.parametrize("plan", ["R=2 grid=view:2,x:3", "R=4 grid=y:2,x:3", "R=*,4,4,4 grid=y:2,x:3"])
def test_blocks_that_share_no_element_are_fitted_as_in_memory(
    cloth: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, plan: str
) -> None:
    """To the byte, whatever the threads, and without joint rows, which would take numbers for every row and cell."""
    files: list[bytes] = []
    for share, threads in [(1, 2), (3, 1), (3, 3)]:
        monkeypatch.setattr("hmkcta.fitting.workset.solve_rows", None)
        model = fitted(cloth, monkeypatch, cloth.values.size // share, plan, threads=threads)
        model.save(tmp_path / f"{share},{threads}.hmk")
        files.append((tmp_path / f"{share},{threads}.hmk").read_bytes())
    assert files[0] == files[1] == files[2]


def test_progress_moves_while_blocks_are_fitted(cloth: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[str, float]] = []

    def progress(stage: str, share: float) -> None:
        told.append((stage, share))

    fitted(cloth, monkeypatch, cloth.values.size // 3, "R=4 grid=y:2,x:3", progress=progress)
    assert len({share for name, share in told if name == "level 1"}) > 5


@pytest.mark.parametrize("plan", [WH4_LIKE, "R=3,*,3,3"])
def test_progress_moves_within_a_node_that_is_streamed(
    cloth: Any, monkeypatch: pytest.MonkeyPatch, plan: str
) -> None:
    """As many passes are told of as are made: the share rises, from near 0 to 1, and does not end early."""
    told: dict[str, list[float]] = {}

    def progress(stage: str, share: float) -> None:
        told.setdefault(stage, []).append(share)

    fitted(cloth, monkeypatch, cloth.values.size // 3, plan, quality="medium", progress=progress)
    assert "level 1" in told
    for stage in {"level 1", "reordering", "back-fitting level 1"} & told.keys():
        shares = told[stage]
        assert shares == sorted(shares)
        assert shares[-1] == 1
        assert len(set(shares)) > 5
        assert all(after - before < 0.2 for before, after in pairwise(shares))


@pytest.mark.parametrize("plan", ["R=8 grid=y:2", "R=1 grid=y:2 / R=8", "R=1 grid=y:2 / R=4 grid=x:2"])
def test_blocks_too_large_for_memory_are_streamed_themselves(
    cloth: Any, monkeypatch: pytest.MonkeyPatch, plan: str
) -> None:
    inside, outside = (
        fitted(cloth, monkeypatch, cloth.values.size // share, plan, quality="medium") for share in (1, 5)
    )
    assert outside.snr > inside.snr - 0.1
    assert outside.nbytes == pytest.approx(inside.nbytes, rel=0.01)


def test_back_fitting_of_blocks_is_as_in_memory(cloth: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = "R=2,2,3,3 grid=y:2,x:2 / R=2,2,2,2 C=1,1,2,2 K=1"
    snrs = [fitted(cloth, monkeypatch, cloth.values.size // share, plan, quality="medium").snr for share in (1, 3, 7)]
    assert snrs[1] == pytest.approx(snrs[0], abs=0.02)
    assert snrs[2] == pytest.approx(snrs[0], abs=0.15)  # clusters within blocks are searched for on a part of each


def test_a_model_that_memory_does_not_hold_is_refused(cloth: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(budget, "SMALLEST", 1000)
    monkeypatch.setattr(budget, "MODEL", 1e6)
    memory = budget.PROCESS + budget.WORKING * cloth.values.size // 3
    with pytest.raises(HmkctaError, match=r"memory for the model of this plan.*--max-memory"):
        fitted(cloth, monkeypatch, cloth.values.size // 3, "R=8 grid=y:2,x:3", max_memory=memory)
