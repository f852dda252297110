"""Data of few exact ranks: float16 numbers where bytes would hide them, and bytes for what these leave."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hmkcta import compress
from hmkcta.comparing.alternatives import with_clusters_times
from hmkcta.comparing.follow import Task
from hmkcta.comparing.followed import fits
from hmkcta.fitting.fit import EFFORTS
from hmkcta.fitting.run import Run
from hmkcta.plan import parse_plan
from hmkcta.streaming.source import prepare
from hmkcta.support.progress import nobody

pytestmark = pytest.mark.usefixtures("one_goal")


def rank_three() -> NDArray[np.float32]:
    """Texels y+x by lights a+b, `[40, 44, 18, 20]`, of rank three."""
    rng = np.random.default_rng(3)
    left, right = rng.standard_normal((40 * 44, 3)), rng.standard_normal((3, 18 * 20))
    return (left @ right).reshape(40, 44, 18, 20).astype(np.float32)


def test_a_size_goes_to_float16_numbers_where_bytes_end_early() -> None:
    """Blocks that are best with bytes have no room for float16 numbers: judged by these alone, 45 dB."""
    assert compress(rank_three(), size=22_000, threads=1).snr > 70


@pytest.mark.parametrize(("snr", "most"), [(60.0, 17_000), (75.0, 24_500), (90.0, 29_000)])
def test_bytes_do_for_what_float16_numbers_leave(snr: float, most: int) -> None:
    model = compress(rank_three(), snr=snr, threads=1)
    assert model.snr >= snr
    assert model.nbytes < most


def test_no_more_clusters_are_tried_than_there_are_rows() -> None:
    source = prepare(rank_three()[..., :3], ["y", "x", "a", "c"], None, None, 1)
    plan = parse_plan("R=1 C=1,1,1,3 / R<=4", (("y",), ("x",), ("a",), ("c",)))
    task = Task(source, plan, 4096, "generic", Run(EFFORTS["medium"], 0, 1, nobody))
    model = compress(rank_three()[..., :3], "R=1", threads=1)
    more = with_clusters_times(plan, 1.5)
    assert more is not None
    assert max(more.levels[0].clusters) == 4
    assert not fits(task, more, model)
