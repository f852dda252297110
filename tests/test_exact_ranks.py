"""Data of few exact ranks: float16 numbers where bytes would hide them, all ranks in as many bits as fit or do."""

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


def labels_apart() -> NDArray[np.float32]:
    """Twelve labels of boxes, `[20, 24, 22, 12]`, 1 where the label is the last index: of ranks 5, 6, 11, 12."""
    boxes = np.random.default_rng(7).integers(0, 12, (5, 6, 11))
    labels = boxes.repeat(4, axis=0).repeat(4, axis=1).repeat(2, axis=2)
    return (labels[..., None] == np.arange(12)).astype(np.float32)


def boxes() -> NDArray[np.float32]:
    """A number for each box, `[20, 24, 22, 12]`, of ranks 5, 4, 2, 3."""
    values = np.random.default_rng(8).integers(0, 9, (5, 4, 2, 3))
    return values.repeat(4, axis=0).repeat(6, axis=1).repeat(11, axis=2).repeat(4, axis=3).astype(np.float32)


@pytest.mark.parametrize(("size", "least"), [(5_000, 17.0), (6_000, 29.0), (8_000, 52.0)])
def test_a_size_is_filled_by_all_ranks_where_data_end(size: int, least: float) -> None:
    """Ranks by what each is worth in usual bits, and fewer of them, end at 5 to 12 dB."""
    model = compress(labels_apart(), "R<=20,24,22,12 bits=8", size=size, threads=1)
    assert model.nbytes <= size
    assert model.snr > least


@pytest.mark.parametrize("seed", range(4))
def test_data_end_though_float32_does_not_tell_exactly_where(seed: int) -> None:
    """What spectra leave of ranks (4, 5, 6) is some 80 dB, or nothing; fewer ranks than these end at 40 dB."""
    rng = np.random.default_rng(seed)
    factors = [rng.standard_normal((rows, rank)) for rows, rank in ((16, 4), (18, 5), (20, 6))]
    values = np.einsum("abc,ia,jb,kc->ijk", rng.standard_normal((4, 5, 6)), *factors).astype(np.float32)
    assert compress(values, "R<=16,18,20 bits=8", size=2269, threads=1).snr > 45


def test_a_level_that_is_left_nothing_fills_no_size() -> None:
    """All energy is in the first level's blocks: below it no rank is worth its bytes, however many there are."""
    values = np.random.default_rng(0).standard_normal((16, 16)).repeat(4, 0).repeat(4, 1)[..., None].repeat(8, 2)
    model = compress(values.astype(np.float32), "R=1 C=16,16,1 / R<=4,4,8 bits=8", size=18_000, threads=1)
    assert model.snr > 60


def test_a_larger_size_does_more_where_data_end() -> None:
    """Some plans end at 16 dB; the whole, uncut, is always fitted beside them."""
    reached = [compress(boxes(), size=size, threads=1).snr for size in (2_000, 2_600, 3_600, 4_600)]
    assert reached == sorted(reached)
    assert reached[2] > 65


@pytest.mark.parametrize("snr", [10.0, 20.0, 30.0, 40.0])
def test_an_snr_is_just_met_where_data_end(snr: float) -> None:
    """All ranks promise too much and the next fewer too little: bits alone meet it, far from where they began."""
    factors = [np.random.default_rng(n).standard_normal((rows, 6)) for n, rows in enumerate((40, 50, 60))]
    values = np.einsum("ir,jr,kr->ijk", *factors).astype(np.float32)
    assert snr <= compress(values, "R<=40,50,60 bits=8", snr=snr, threads=1).snr < snr + 0.3
