"""What a plan says it will take is what it takes: memory within a quarter, bytes exactly, scratch space exactly."""

from __future__ import annotations

import json
import os
import shlex
import sys
from dataclasses import replace
from pathlib import Path
from statistics import median
from threading import get_ident

import numpy as np
import pytest

from cli_tools import report, run, smooth
from hmkcta import Axis, compress
from hmkcta.axes import mode_sizes
from hmkcta.errors import HmkctaError
from hmkcta.filesize import predicted_bytes
from hmkcta.fitting.fit import EFFORTS
from hmkcta.forecast import forecast
from hmkcta.plan import parse_plan
from hmkcta.readers import open_array
from hmkcta.streaming.source import Source, described, prepare
from hmkcta.support import memory
from hmkcta.support.executors import thread_count
from hmkcta.support.memory import drop_pages, looked_at, peak_memory
from memory_tools import printed, runs, taken, write_waves

SIDE = 72
MODES = tuple((f"axis{n}",) for n in range(4))


@pytest.fixture(scope="module")
def waves(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of 107 MB: two separable waves and noise."""
    path = tmp_path_factory.mktemp("waves") / "waves.npy"
    write_waves(path, SIDE)
    return path


CASES = [
    ("R=4", None),
    ("R=2 C=3 K=2 / R=2 C=2 K=2", None),
    ("R=4", 450_000_000),
    ("R=2 C=3 K=2", 300_000_000),
    ("R=2 C=3 K=2", 450_000_000),
    ("R=2 C=3 K=2 / R=2 C=2 K=2", 300_000_000),
    ("R=2 / R=2 C=2 K=2 / R=1 C=2 K=2", 300_000_000),
]


@pytest.mark.skipif(sys.platform == "win32", reason="there is no getrusage")
@pytest.mark.parametrize(("plan", "memory"), CASES)
def test_memory_is_what_was_said(waves: Path, plan: str, memory: int | None) -> None:
    said = forecast(parse_plan(plan, MODES), (SIDE,) * 4, EFFORTS["fast"], 2, memory)
    found = runs(lambda: taken("compress", waves, plan=plan, quality="fast", scheme="most", max_memory=memory))
    assert min(took["snr"] for took in found) > 11  # the noise
    peaks = [took["peak"] for took in found]
    # Which sub-tensors happen to be in memory together makes a tenth of difference; on a busy machine they are fewer.
    assert said.memory / 1.25 < max(peaks)
    assert median(peaks) < 1.25 * said.memory
    if memory:
        assert max(peaks) < memory


MERGED = "axis0+axis3, axis1+axis2"
#: Ranks of every node's own: of blocks of one level, of blocks below a carrier, of the whole tensor; and PCA, of which
#: the projections of a slab are as large as the slab, or would be as many times as there are clusters.
OTHERS: list[tuple[str, dict[str, float], str | None]] = [
    ("R<=160,160 grid=axis0:7,axis1:3,axis2:6", {"snr": 12}, MERGED),
    ("R<=160,160 grid=axis0:7,axis1:3,axis2:6", {"size": 1_000_000}, MERGED),
    ("R<=24 grid=axis0:3,axis1:3", {"size": 300_000}, None),
    ("R<=*,20,20,20 grid=axis1:3,axis2:3", {"size": 500_000}, None),
    ("R=1 grid=axis0:3,axis1:3 / R<=24", {"snr": 11.2}, None),
    ("R<=64,64", {"size": 200_000}, MERGED),
    ("R=30,*", {}, MERGED),
    ("R=4,* C=8,1 K=1", {}, MERGED),
]


@pytest.mark.skipif(sys.platform == "win32", reason="there is no getrusage")
@pytest.mark.parametrize(("plan", "goal", "organisation"), OTHERS)
def test_memory_of_other_plans_is_what_was_said(
    waves: Path, plan: str, goal: dict[str, float], organisation: str | None
) -> None:
    memory = 300_000_000
    source = described(open_array(waves))
    modes = source.organisation(organisation)
    parsed = replace(parse_plan(plan, modes), **goal)  # pyright: ignore[reportArgumentType] (size is whole)
    said = forecast(parsed, mode_sizes(source.axes, modes), EFFORTS["fast"], 2, memory).memory
    found = runs(lambda: taken("compress", waves, plan=plan, quality="fast", scheme="most", organisation=organisation,
                               max_memory=memory, **goal))  # fmt: skip
    assert min(took["snr"] for took in found) > 11
    assert max(took["peak"] for took in found) < memory
    assert said / 1.25 < median(took["peak"] for took in found) < 1.25 * said


@pytest.mark.parametrize(
    ("plan", "size", "organisation"), [("R=40,40 C=8,8", None, MERGED), ("R=1 grid=axis0:2 / R<=24", 300_000, None)]
)
def test_what_takes_more_memory_than_given_is_refused_before_the_work(
    waves: Path, plan: str, size: int | None, organisation: str | None
) -> None:
    """Joint rows of many cells; sub-tensors of which no row can be left out."""
    with pytest.raises(HmkctaError, match=r"memory for level \d .*--max-memory"):
        compress(open_array(waves), plan, size=size, organisation=organisation, max_memory=300_000_000)


COMMAND = """
import sys
from hmkcta.support.memory import peak_memory
from hmkcta.cli import main
main(sys.argv[1:], standalone_mode=False)
print(peak_memory())
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no getrusage")
@pytest.mark.parametrize("words", [
    "a.npy --size 30KB --quality fast", "a.npy --snr 12 --quality fast", "a.npz --size 30KB --quality fast",
    "a.npy --quality fast --plan 'R=2 C=2 K=2 / R=1'",
])
def test_memory_of_a_command_is_what_was_said(waves: Path, words: str, tmp_path: Path) -> None:
    """Choosing the plan takes more than following it; unpacked sources stay in memory."""
    values = np.load(waves, mmap_mode="r")[:40, :40, :40, :40]
    np.save(tmp_path / "a.npy", values)
    np.savez_compressed(tmp_path / "a.npz", values)
    source, *options = shlex.split(words)
    given = [tmp_path / source, "--threads", 2, *options]
    said = int(json.loads(printed(COMMAND, "plan", *given, "--json").rpartition("}")[0] + "}")["memory"])
    command = ("compress", *given, "-o", tmp_path / "a.hmk", "--quiet", "--overwrite")
    found = runs(lambda: {"peak": int(printed(COMMAND, *command))})
    assert said / 1.25 < median(took["peak"] for took in found) < 1.25 * said


def test_memory_that_a_plan_says_does_not_depend_on_what_the_process_took_before(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", smooth(30, 31, 32))
    words = ("plan", tmp_path / "a.npy", "--size", "5KB", "--quality", "fast")
    said = report(*words)["memory"]
    assert np.ones(peak_memory() // 8 + (1 << 23)).sum() > 0  # the most that this process ever took
    assert report(*words)["memory"] == said < 100_000_000


def test_a_plan_says_what_choosing_it_takes_and_what_following_it(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", smooth(30, 31, 32))
    words = ("plan", tmp_path / "a.npy", "--size", "5KB", "--quality", "fast")
    found = report(*words)
    assert 0 < found["choosing_seconds"] <= found["seconds"]
    assert "with the plan given, " in run(*words).stdout
    assert " more to choose it anew" in run(*words).stdout
    assert report(*words, "--plan", "R<=4")["choosing_seconds"] is None
    assert " more to choose it anew" not in run(*words, "--plan", "R<=4").stdout
    assert report(*words[:-1], "medium")["comparing_seconds"] > found["comparing_seconds"] > 0
    assert report(*words, "--plan", "R<=4")["comparing_seconds"] == 0


def test_a_plan_for_an_snr_says_about_how_many_bytes_that_takes(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", smooth(40, 41, 42))
    words = (tmp_path / "a.npy", "--snr", "35")
    said = report("plan", *words)
    took = report("compress", *words, "-o", tmp_path / "a.hmk")["bytes"]
    assert said["predicted_bytes"] is None
    assert said["expected_bytes"] / 1.25 < took < 1.25 * said["expected_bytes"]
    assert "about " in run("plan", *words).stdout
    assert report("plan", *words[:1], "--plan", "R<=4", "--snr", "35")["expected_bytes"] is None


def test_a_plan_says_that_written_ranks_take_more_than_the_decode_cost(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", smooth(30, 31, 32))
    words = ("plan", tmp_path / "a.npy", "--plan", "R=4", "--decode-cost")
    (said,) = report(*words, "10")["notes"]
    assert "takes 64 multiply-adds, more than --decode-cost 10" in said
    assert said in run(*words, "10").stderr
    assert not report(*words, "64")["notes"]
    blocks = ("plan", tmp_path / "a.npy", "--plan", "R=1 grid=axis0:15,axis1:16,axis2:16 / R=12", "--decode-cost", "10")
    assert not report(*blocks)["notes"]  # of which none has more than two rows


BYTES = [
    "R=3",
    "R=2 C=2 K=2",
    "R=2,2,2,*",
    "R=2 C=2 K=1 / R=1 C=2 K=1",
    "R=2 / R=2 C=2 K=1 / R=1",
    "R=2,3,*,* C=2,2,1,1 K=2 / R=1,1,*,* C=3,2,1,1",
    "R=1 grid=axis0:3,axis1:2 / R=6",
]


@pytest.mark.parametrize("plan", BYTES)
@pytest.mark.parametrize("scheme", ["uniform", "auto"])
def test_bytes_are_what_was_said(plan: str, scheme: str, tmp_path: Path) -> None:
    """To the byte, where no node is empty: of random numbers none is."""
    values = np.random.default_rng(0).standard_normal((16, 16, 16, 16), np.float32)
    model = compress(values, plan, quality="fast", scheme=scheme, seed=123456)
    model.save(tmp_path / "a.hmk")
    said = predicted_bytes(parse_plan(plan, MODES), described(values), seed=123456)
    assert said == model.nbytes == (tmp_path / "a.hmk").stat().st_size


def test_bytes_are_what_was_said_of_coordinates_transforms_and_merged_axes() -> None:
    values = np.random.default_rng(0).random((5, 80, 30), np.float32)
    axes = [Axis("light", 5, coords=np.arange(5) / 3), Axis("x", 80, coords=np.arange(80.0)), Axis("y", 30)]
    source = described(values, axes, "log1p")
    plan = parse_plan("R=3 grid=x:3,y:4", source.organisation("light, y+x"))
    model = compress(values, plan, axes=axes, transform="log1p")
    assert predicted_bytes(plan, source) == model.nbytes


def test_less_memory_than_anything_needs_is_refused(waves: Path) -> None:
    with pytest.raises(HmkctaError, match=r"214.00 MiB are needed.*--max-memory"):
        compress(open_array(waves), "R=2", max_memory=1_000_000)
    with pytest.raises(HmkctaError, match=r"240.00 MiB are needed.*--max-memory"):  # what choosing takes, at once
        compress(open_array(waves), max_memory=1_000_000)


@pytest.mark.parametrize("threads", [1, 4])
def test_an_array_is_looked_at_by_so_many_threads_within_one_slab(
    monkeypatch: pytest.MonkeyPatch, threads: int
) -> None:
    monkeypatch.setattr("hmkcta.streaming.source.SLAB", 1 << 18)
    extent, workers, sizes = Source.extent, set[int](), list[int]()

    def watched(source: Source, part: tuple[slice, ...]) -> tuple[float, float]:
        workers.add(get_ident())
        sizes.append(source.array[part].size)
        return extent(source, part)

    monkeypatch.setattr(Source, "extent", watched)
    values = np.arange(1.0, 1 + (1 << 20)).reshape(64, 128, 128)
    assert prepare(values, None, "identity", None, threads).unit == 1 << 20
    assert sum(sizes) == values.size
    assert len(workers) <= threads
    assert max(sizes) * thread_count(threads) <= 1 << 18


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_notes_on_a_mapped_file_keep_little_of_it(waves: Path) -> None:
    program = """
import sys
import numpy as np
from hmkcta.support.memory import peak_memory
from hmkcta import compress
from hmkcta.cli.notes import notes
array, model = np.load(sys.argv[1], mmap_mode="r"), compress(np.eye(40), "R=2")
array[0, 0, 0, 0]
before = peak_memory()
notes(model, array)
print(peak_memory() - before)
"""
    assert int(printed(program, waves)) < waves.stat().st_size / 4


def test_pages_of_a_mapped_file_are_let_go_of(waves: Path) -> None:
    if not Path("/proc/self/statm").exists():
        pytest.skip("only Linux says how much of a process is in memory")

    def resident() -> int:
        return int(Path("/proc/self/statm").read_text().split()[2]) * 4096  # file-backed

    array = open_array(waves)
    before = resident()
    total = float(array[SIDE // 2 :].sum())
    looked_at = resident()
    drop_pages(array)
    assert looked_at - before > 30_000_000
    assert resident() - before < 10_000_000
    assert float(array[SIDE // 2 :].sum()) == total


#: Looks at a mapped file, its axes turned, and says by how much the process grew.
LOOK = """
import sys
import numpy as np
from hmkcta.support.memory import peak_memory
from hmkcta.streaming.source import described, prepare
array = np.load(sys.argv[1], mmap_mode="r").transpose([int(n) for n in sys.argv[2]])
source = described(array)
prepare(array[:2, :2, :2, :2], None, "identity", None, 1)
before = peak_memory()
if sys.argv[3] == "all":
    prepare(array, None, "identity", None, 2)
else:
    source.values((slice(None, None, int(sys.argv[3])),) * 4)
print(peak_memory() - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("turn", ["0123", "3210", "2031"])
@pytest.mark.parametrize("step", ["all", "2"])
def test_a_look_at_a_mapped_file_keeps_little_of_it(waves: Path, turn: str, step: str) -> None:
    """Every few rows touch every page of it, as does each slab where other axes vary fastest."""
    assert int(printed(LOOK, waves, turn, step)) < 0.85 * waves.stat().st_size


@pytest.mark.parametrize("turn", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
@pytest.mark.parametrize("most", [1 << 16, 1 << 17])
def test_what_is_read_piece_by_piece_is_what_is_there(
    turn: tuple[int, ...], most: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hmkcta.support.memory.LOOKED_AT", most)
    np.save(tmp_path / "a.npy", np.random.default_rng(0).random((40, 50, 300)))
    array = np.load(tmp_path / "a.npy", mmap_mode="r").transpose(turn)
    parts = [(), (slice(3, 30),), (slice(None, None, 7), slice(2, None, 3)), (slice(None), slice(0, 1)), (slice(9, 9),)]
    for part in [*parts, (slice(None, None, -2),), (slice(None), slice(None), slice(5, None, 11))]:
        assert np.array_equal(looked_at(array, part), array[part])


@pytest.mark.skipif(sys.platform != "linux" or os.confstr("CS_GNU_LIBC_VERSION") is None, reason="not glibc")
@pytest.mark.parametrize(("environment", "kept"), [({}, True), ({"MALLOC_TRIM_THRESHOLD_": "131072"}, False)])
def test_freed_memory_is_kept_for_what_comes_next_unless_the_user_says_otherwise(
    environment: dict[str, str], kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = """
import resource
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from hmkcta.support.memory import keep_freed_memory
keep_freed_memory(2)
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
def node():
    return [np.ones(n << 16) for n in (11, 23, 7, 31)]
with ThreadPoolExecutor(2) as pool:
    for _ in range(3):
        list(pool.map(lambda _: len(node()), range(2)))
    before = faults()
    list(pool.map(lambda _: len(node()), range(20)))
    print(faults() - before)
"""
    for name in [name for name in os.environ if name.startswith(("MALLOC_", "GLIBC_TUNABLES"))]:
        monkeypatch.delenv(name)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert (int(printed(program)) < 2000) == kept


#: Measures a model against a file and says the peak.
MEASURE = """
import sys
import hmkcta
from hmkcta.support.memory import peak_memory
from hmkcta.measure import measure
from hmkcta.readers import open_array
measure(hmkcta.open(sys.argv[2]), open_array(sys.argv[1]), slab=1 << 18)
print(peak_memory())
"""


def test_measuring_lets_go_of_what_it_has_read(waves: Path, tmp_path: Path) -> None:
    """A file larger than memory can be verified."""
    compress(open_array(waves), "R=1", quality="fast").save(tmp_path / "a.hmk")
    assert int(printed(MEASURE, waves, tmp_path / "a.hmk")) < waves.stat().st_size


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("memory", [280_000_000, 400_000_000])
def test_choosing_a_plan_keeps_within_the_memory_given(waves: Path, memory: int) -> None:
    assert taken("choose_plan", waves, size=1_000_000, max_memory=memory)["peak"] < memory


def test_every_control_group_limits_and_what_the_system_can_drop_counts_as_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a batch system nests them: 6 GB for the job, 4 GB of these for the step, both with pages of files."""
    groups = (("", "max", 0, 0), ("job", "6000000000", 5e9, 2e9), ("job/step", "4000000000", 3e9, 5e8))
    for group, limit, held, files in groups:
        folder = tmp_path / group
        folder.mkdir(exist_ok=True)
        (folder / "memory.max").write_text(f"{limit}\n")
        (folder / "memory.current").write_text(f"{int(held)}\n")
        (folder / "memory.stat").write_text(f"anon 12\ninactive_file {int(files)}\n")
    (tmp_path / "cgroup").write_text("4:memory:/elsewhere\n0::/job/step\n")
    (tmp_path / "meminfo").write_text("MemTotal: 16000000 kB\nMemAvailable: 8000000 kB\n")
    for name, path in (("_GROUPS", tmp_path), ("_GROUP", tmp_path / "cgroup"), ("_MEMINFO", tmp_path / "meminfo")):
        monkeypatch.setattr(memory, name, path)
    assert memory.available_memory() == 1_500_000_000
    assert memory.stays_cached(2_000_000_000)
    assert not memory.stays_cached(2_000_000_001)
    (tmp_path / "job/memory.current").write_text("7500000000\n")
    assert memory.available_memory() == 500_000_000
    (tmp_path / "cgroup").write_text("0::/../of/another\n")
    assert memory.available_memory() == 8_192_000_000
