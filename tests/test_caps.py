"""Plans chosen for little memory: caps of ranks are as low as memory needs them, and are told before the search."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_tools import smooth
from hmkcta import choose_plan, compress
from hmkcta.choosing.caps import Ranks, Room, capped, check_room, room_of
from hmkcta.choosing.trial import OUT_OF_REACH, trial_of
from hmkcta.comparing.follow import Task
from hmkcta.comparing.rivals import follow_any
from hmkcta.errors import HmkctaError
from hmkcta.fitting.fit import EFFORTS
from hmkcta.fitting.run import Run
from hmkcta.fitting.workset import check_worksets
from hmkcta.plan import LevelSpec, Plan, parse_plan
from hmkcta.streaming.budget import memory_limit
from hmkcta.streaming.source import described, prepare
from hmkcta.support.progress import nobody

#: Bytes of memory that choosing a plan takes at the least; so three million elements are held.
LEAST = 252_000_000
SIDE = 160
MODES = tuple((f"axis{n}",) for n in range(3))


def plan_with(ranks: Ranks, snr: float = 20) -> Plan:
    ones = (1,) * len(ranks)
    return Plan(tuple((f"axis{n}",) for n in range(len(ranks))), (LevelSpec(ranks, ones, ones, own=True),), snr)


NARROW: list[tuple[tuple[int, ...], Ranks, int]] = [
    ((512, 512, 200), (160, 160, 160), 500_000_000),
    ((32, 128, 150, 150), (32, 128, 150, None), 600_000_000),
    ((128, 512, 300, 150), (128, 160, 160, 150), 600_000_000),
    ((200_000, 400), (160, 160), 300_000_000),
    ((200_000, 400), (160, None), 300_000_000),
]


@pytest.mark.parametrize(("sizes", "ranks", "memory"), NARROW)
def test_caps_are_lowered_until_the_plan_is_no_longer_refused(
    sizes: tuple[int, ...], ranks: Ranks, memory: int
) -> None:
    plan = plan_with(ranks)
    with pytest.raises(HmkctaError, match="memory for level 1"):
        check_worksets(plan, sizes, memory_limit(plan, sizes, memory), memory)
    lower = capped(plan, sizes, room_of(int(np.prod(sizes)), memory))
    assert lower is not None
    check_worksets(lower, sizes, memory_limit(lower, sizes, memory), memory)
    for rank, before in zip(lower.levels[0].ranks, ranks, strict=True):
        assert rank == before or (rank is not None and before is not None and 1 <= rank < before)


@pytest.mark.parametrize(
    ("text", "memory"), [("R<=160", 300_000_000), ("R<=10", LEAST), ("R<=160 grid=axis0:2", LEAST)]
)
def test_caps_that_memory_has_room_for_stay_as_they_are(text: str, memory: int) -> None:
    plan = replace(parse_plan(text, MODES), snr=20.0)
    assert capped(plan, (SIDE,) * 3, Room(SIDE**3, 3_000_000, memory, memory)) is plan


@pytest.mark.parametrize("memory", [None, 1 << 40])
def test_where_all_is_held_nothing_is_bound(memory: int | None) -> None:
    assert room_of(SIDE**3, memory) is None


def test_caps_are_those_of_the_blocks_below_a_carrier() -> None:
    plan = replace(parse_plan("R=1 grid=axis0:2 / R<=160", MODES), snr=20.0)
    lower = capped(plan, (512, 512, 200), room_of(512 * 512 * 200, 300_000_000))
    assert lower is not None
    assert lower.levels[0] == plan.levels[0]
    check_worksets(lower, (512, 512, 200), memory_limit(lower, (512, 512, 200), 300_000_000), 300_000_000)


@pytest.fixture(scope="module")
def cube() -> NDArray[np.float32]:
    return smooth(SIDE, SIDE, SIDE)


@pytest.mark.parametrize("organisation", [None, "axis0, axis1, axis2"])
def test_a_plan_is_chosen_for_little_memory_and_followed(cube: NDArray[np.float32], organisation: str | None) -> None:
    """The plan without caps for it is refused."""
    with pytest.raises(HmkctaError, match="memory for level 1"):
        compress(cube, "R<=160", snr=30, max_memory=LEAST)
    model = compress(
        cube, snr=30, quality="fast", threads=1, organisation=organisation, max_memory=LEAST, decode_cost=100_000
    )
    assert model.snr >= 30


def test_the_search_judges_by_the_caps(cube: NDArray[np.float32]) -> None:
    """Noise takes all ranks there are: what has low caps promises less, and what no cap makes small enough nothing."""
    noise = cube + np.random.default_rng(0).standard_normal(cube.shape).astype(np.float32)
    free = trial_of(prepare(noise, None, "identity", None, 1), None, 30, 1_000_000, 0)
    room, held = room_of(noise.size, LEAST), list[float]()
    for memory in (None, room, Room(noise.size, 1000, 0, 0)):
        held.append(replace(free, memory=memory).worths(MODES, (1, 1, 1), 1 << 18)[0].worth)
    assert held[0] > held[1] > 0 > -OUT_OF_REACH > held[2]


def test_where_nothing_fits_that_is_said_before_the_search(monkeypatch: pytest.MonkeyPatch) -> None:
    """Modes so short that no row can be left out."""
    array = np.ones((13,) * 6, np.uint8)

    def searched(*_: object) -> None:
        pytest.fail("began to search")

    monkeypatch.setattr("hmkcta.choosing.tuning.trial_of", searched)
    with pytest.raises(HmkctaError, match=r"any plan for 13 x .*264.* MiB are needed, .*--organisation") as refused:
        choose_plan(array, organisation="axis0,axis1,axis2,axis3,axis4,axis5", max_memory=LEAST)
    assert "lower R" not in str(refused.value)
    check_room(described(array), None, room_of(array.size, LEAST))  # merged modes can be thinned


def test_a_further_plan_that_memory_does_not_hold_takes_no_model_away(cube: NDArray[np.float32]) -> None:
    noise = cube + np.random.default_rng(0).standard_normal(cube.shape).astype(np.float32)
    source, run = prepare(noise, None, "identity", None, 1), Run(EFFORTS["fast"], 0, 1, nobody)
    first, other = (replace(parse_plan(text, MODES), snr=60.0) for text in ("R=1", "R<=160"))
    told = list[str]()
    model = follow_any(Task(source, first, 4096, "generic", run, LEAST), [other], told.append).model
    assert len(told) == 1
    assert model.plan.levels[0].ranks == (1, 1, 1)


@pytest.mark.skipif(sys.platform != "linux" or os.confstr("CS_GNU_LIBC_VERSION") is None, reason="not glibc")
def test_a_fit_does_not_begin_with_what_choosing_its_plan_took() -> None:
    program = """
from hmkcta import compress
import hmkcta.comparing.follow, numpy as np
from pathlib import Path
def resident():
    return next(int(line.split()[1]) for line in Path("/proc/self/status").open() if line.startswith("RssAnon"))
pieces = [np.ones(12_000) for _ in range(2000)]
held, full = pieces[::50], resident()
del pieces
begun, fit = [], hmkcta.comparing.follow.fit_to_goal
hmkcta.comparing.follow.fit_to_goal = lambda *given: (begun.append(resident()), fit(*given))[1]
waves = np.sin(np.add.outer(np.arange(40), np.arange(30) ** 2))
compress(waves.astype(np.float32), snr=20, quality="fast")
print(full - begun[0])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert int(done.stdout) > 100_000, "of 190,000 KiB that were freed"
