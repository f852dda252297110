"""What a plan is said to take: time and scratch space as it does more, memory as its model is larger."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np
import pytest

from hmkcta import compress
from hmkcta.errors import HmkctaError
from hmkcta.fitting.fit import EFFORTS
from hmkcta.forecast import forecast
from hmkcta.plan import parse_plan
from hmkcta.readers import open_array
from hmkcta.streaming.budget import SMALLEST, memory_limit
from memory_tools import runs, taken, write_waves

SIZES = (40,) * 4
MODES = tuple((f"axis{n}",) for n in range(4))


@pytest.fixture(scope="module")
def waves(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of 10 MB."""
    path = tmp_path_factory.mktemp("waves") / "waves.npy"
    write_waves(path, SIZES[0])
    return path


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of 14 MB: many rows near a few."""
    rng, path = np.random.default_rng(0), tmp_path_factory.mktemp("rows") / "rows.npy"
    values = rng.standard_normal((40, 12))[rng.integers(40, size=300_000)]
    np.save(path, (values + 0.2 * rng.standard_normal(values.shape)).astype(np.float32))
    return path


@pytest.mark.parametrize(("text", "copies"), [
    ("R=4", (0, 0, 0)), ("R=2 C=2 K=2", (0, 0, 0)), ("R=2 grid=axis2:2,axis3:2", (1, 1, 1)),
    ("R=4 / R=2 C=2 / R=1", (0, 1, 1)), ("R=4 C=3 / R=2 C=2 / R=1", (1, 1, 1)), ("R=2 C=2 / R<=4", (2, 2, 2)),
])  # fmt: skip
def test_scratch_space_is_for_pieces_that_are_read_again(text: str, copies: tuple[int, int, int]) -> None:
    """Or that cannot be collected from a source that the system does not keep in its cache."""
    sizes, plan = (174, 58, 400, 380), replace(parse_plan(text, MODES), size=10**6 if "<=" in text else None)
    found = [
        forecast(plan, sizes, EFFORTS[quality], 2, 1_400_000_000, stored=stored).scratch
        for quality, stored in [("fast", 1 << 20), ("medium", 1 << 20), ("fast", 1 << 50)]
    ]
    assert found == [4 * int(np.prod(sizes)) * count for count in copies]


def test_a_plan_costs_more_time_the_more_it_does() -> None:
    sizes, seconds = (100, 100, 100, 100), list[float]()
    tried = [("R=2", "fast"), ("R=2 C=2 K=2", "fast"), ("R=2 C=2 K=2", "medium"), ("R=2 C=9 K=2", "medium")]
    for text, effort in tried:
        seconds.append(forecast(parse_plan(text, MODES), sizes, EFFORTS[effort], 2, None).seconds)
    assert seconds == sorted(set(seconds))


def test_many_nodes_cost_what_each_takes_beside_its_elements() -> None:
    plan = parse_plan("R=1 grid=y:24,x:24 / R=1", (("y",), ("x",)))
    assert 0.5 < forecast(plan, (480, 480), EFFORTS["medium"], 2, None).seconds < 2


def test_a_large_model_costs_what_it_takes_beside_the_elements() -> None:
    """Many cells of high rank have more numbers than the array; joint rows factor H, whatever the elements."""

    def seconds(plan: str) -> float:
        return forecast(parse_plan(plan, MODES), (50,) * 4, EFFORTS["fast"], 2, None).seconds

    assert seconds("R=8 C=6,8,8,8 K=1") > 5 * seconds("R=2 C=6,8,8,8 K=1")
    assert seconds("R=6 C=4 K=2") > 2 * seconds("R=2 C=4 K=2")


def test_clusters_of_long_modes_cost_what_finding_them_takes() -> None:
    """K-means of many clusters takes longer than all of the fit; of many rows some have all its rounds."""
    modes, sizes = (("pixel",), ("frame",)), (200_000, 60)

    def seconds(plan: str) -> float:
        return forecast(parse_plan(plan, modes), sizes, EFFORTS["medium"], 2, None).seconds

    assert seconds("R<=60,* C=500,1") > 3 * seconds("R<=60,* C=2,1") > 3 * seconds("R<=60,*")
    sizes = (2_000_000, 60)
    assert seconds("R<=60,* C=64,1") < 1.5 * seconds("R<=60,*")


def test_sweeps_take_little_of_the_time_where_they_are_of_a_workset() -> None:
    def longer(size: int) -> float:
        sizes, plan = (size, size, size, size), parse_plan("R=2 C=2 K=2", MODES)
        fast, thorough = (forecast(plan, sizes, EFFORTS[each], 2, 2_000_000_000) for each in ("fast", "thorough"))
        return thorough.seconds / fast.seconds

    assert longer(90) > 2 > 1.2 > longer(300)


#: Cores and bases of many cells, more than the array has elements: cells apart; cells that share elements, in turn and
#: below a joint level, whose nodes two threads fit together; cells in turn that are subdivided.
LARGE_MODELS = [
    ("R=8 / R=8 C=4,4,8,8", 1),
    ("R=2 / R=6 C=4,4,8,8 K=2", 1),
    ("R=1 C=2 / R=5 C=4 K=2", 2),
    ("R=2 / R=2 C=7 K=2 / R=1 C=2", 2),
]


@pytest.mark.skipif(sys.platform == "win32", reason="there is no getrusage")
@pytest.mark.parametrize(("plan", "threads"), LARGE_MODELS)
def test_memory_of_a_large_model_is_what_was_said(plan: str, threads: int, waves: Path) -> None:
    said = forecast(parse_plan(plan, MODES), SIZES, EFFORTS["fast"], threads, None).memory
    options = {"plan": plan, "quality": "fast", "scheme": "most", "threads": threads}
    assert said / 1.25 < taken("compress", waves, **options)["peak"] < 1.25 * said


#: Ranks that a size decides: of one node, as bytes; of clusters of many rows; of many nodes; of a streamed tensor.
OWN_RANKS: list[tuple[str, str, int, dict[str, int]]] = [
    ("waves", "R<=40 bits=8", 1_000_000, {}),
    ("rows", "R<=12,* C=40,1", 2_500_000, {}),
    ("waves", "R=1 grid=axis0:5,axis1:5,axis2:5,axis3:2 / R<=8,8,8,20", 5_000_000, {"decode_cost": 15_000}),
    ("waves", "R<=40 bits=8", 1_000_000, {"max_memory": 260_000_000}),
]


@pytest.mark.skipif(sys.platform == "win32", reason="there is no getrusage")
@pytest.mark.parametrize(("name", "text", "size", "options"), OWN_RANKS)
def test_memory_of_ranks_of_each_node_is_what_was_said(
    name: str, text: str, size: int, options: dict[str, int], waves: Path, rows: Path
) -> None:
    path = {"waves": waves, "rows": rows}[name]
    sizes = np.load(path, mmap_mode="r").shape
    plan = replace(parse_plan(text, MODES[: len(sizes)]), size=size)
    cost, memory = options.get("decode_cost", 4096), options.get("max_memory")
    said = forecast(plan, sizes, EFFORTS["fast"], 2, memory, decode_cost=cost).memory
    found = runs(lambda: taken("compress", path, plan=text, size=size, quality="fast", **options))
    assert said / 1.25 < median(took["peak"] for took in found) < 1.25 * said


def test_memory_of_a_goal_is_that_of_its_bytes() -> None:
    """What an SNR takes is known where a sample told."""
    sizes, plan = (300, 300, 300, 20), parse_plan("R=1 grid=axis0:9,axis1:9,axis2:9 / R<=33 bits=8", MODES)

    def memory(**goal: float) -> int:
        return forecast(replace(plan, **goal), sizes, EFFORTS["fast"], 2, 2_000_000_000).memory

    small, large = memory(size=500_000), memory(size=5_500_000)
    assert 40_000_000 < large - small < 60_000_000
    assert memory(snr=30.0, expected=5_500_000) == large
    assert memory(snr=30.0) < small


def test_others_that_a_chosen_plan_is_compared_with_take_times_of_its_own() -> None:
    """More where numbers of clusters are tried, or bytes are sought for an SNR; none of arrays that are streamed, nor
    beside a given plan."""

    def times(text: str, effort: str = "medium", side: int = 40, snr: float | None = None, **options: int) -> float:
        plan = replace(parse_plan(text, MODES), size=None if snr else 100_000, snr=snr)
        cost = forecast(plan, (side,) * 4, EFFORTS[effort], 2, options.get("memory"), choosing=options["choosing"])
        return round(cost.comparing / cost.seconds)

    blocks = "R=1 grid=axis0:2 / R<=8"
    assert times("R<=8", choosing=10**8) > times(blocks, choosing=10**8) > times(blocks, "fast", choosing=10**8) == 1
    assert times(blocks, snr=30.0, choosing=10**8) > times(blocks, choosing=10**8)
    assert times(blocks, choosing=0) == times(blocks, side=80, memory=500_000_000, choosing=10**8) == 0


def test_a_model_that_memory_has_no_room_for_is_refused(waves: Path) -> None:
    with pytest.raises(HmkctaError, match=r"memory for the model of this plan.*--max-memory, or fewer clusters"):
        compress(open_array(waves), "R=8 C=6,6,8,8", max_memory=300_000_000)


def test_nodes_are_fitted_one_after_another_where_memory_has_no_room_for_two(waves: Path) -> None:
    memory, plan = 320_000_000, "R=1 C=2 / R=5 C=4 K=2"
    alone, many = (forecast(parse_plan(plan, MODES), SIZES, EFFORTS["fast"], threads, memory) for threads in (1, 8))
    assert alone.memory == many.memory < memory
    options = {"plan": plan, "quality": "fast", "scheme": "most", "threads": 8, "max_memory": memory}
    assert taken("compress", waves, **options)["peak"] < memory


def test_memory_that_is_free_but_for_little_leaves_enough_elements(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of what is free may be less than the model takes, though all of it has room."""
    plan = parse_plan("R=2 / R=6 C=4,4,8,8 K=2", MODES)
    monkeypatch.setattr("hmkcta.support.memory.available_memory", lambda: 420_000_000)
    monkeypatch.setattr("hmkcta.streaming.budget.available_memory", lambda: 420_000_000)
    assert memory_limit(plan, SIZES, None) >= SMALLEST


def test_a_plan_that_leaves_all_modes_undecomposed_has_a_forecast() -> None:
    plan = parse_plan("R=*,*", (("y",), ("x",)))
    assert 0 < forecast(plan, (4000, 4000), EFFORTS["fast"], 2, 350_000_000).memory < 350_000_000
