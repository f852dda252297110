"""What a plan says it will take is what it takes: memory within a quarter, bytes exactly, scratch space exactly."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from threading import get_ident

import numpy as np
import pytest

from hmkcta import compress
from hmkcta.errors import HmkctaError
from hmkcta.readers import open_array
from hmkcta.streaming.source import Source, prepare
from hmkcta.support import memory
from hmkcta.support.executors import thread_count
from hmkcta.support.memory import drop_pages, looked_at
from memory_tools import printed, taken, write_waves

SIDE = 72
MODES = tuple((f"axis{n}",) for n in range(4))


@pytest.fixture(scope="module")
def waves(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file of 107 MB: two separable waves and noise."""
    path = tmp_path_factory.mktemp("waves") / "waves.npy"
    write_waves(path, SIDE)
    return path


MERGED = "axis0+axis3, axis1+axis2"
#: Overlapping cells, several levels, blocks; and PCA, of which the projections of a slab are as large as the slab, or
#: would be as many times as there are clusters.
CASES: list[tuple[str, int, str | None]] = [
    ("R=4", 450_000_000, None),
    ("R=2 C=3 K=2", 300_000_000, None),
    ("R=2 C=3 K=2", 450_000_000, None),
    ("R=2 C=3 K=2 / R=2 C=2 K=2", 300_000_000, None),
    ("R=2 / R=2 C=2 K=2 / R=1 C=2 K=2", 300_000_000, None),
    ("R=24 grid=axis0:3,axis1:3", 300_000_000, None),
    ("R=1 grid=axis0:3,axis1:3 / R=24", 300_000_000, None),
    ("R=30,*", 300_000_000, MERGED),
    ("R=4,* C=8,1 K=1", 300_000_000, MERGED),
]


@pytest.mark.skipif(sys.platform == "win32", reason="there is no getrusage")
@pytest.mark.parametrize(("plan", "memory", "organisation"), CASES)
def test_a_written_plan_keeps_within_the_memory_given(
    waves: Path, plan: str, memory: int, organisation: str | None
) -> None:
    took = taken("compress", waves, plan=plan, quality="fast", scheme="most", organisation=organisation,
                 max_memory=memory)
    assert took["snr"] > 11  # the noise
    assert took["peak"] < memory


@pytest.mark.parametrize(
    ("plan", "organisation"), [("R=40,40 C=8,8", MERGED), ("R=1 grid=axis0:2 / R=24", None)]
)
def test_what_takes_more_memory_than_given_is_refused_before_the_work(
    waves: Path, plan: str, organisation: str | None
) -> None:
    """Joint rows of many cells; sub-tensors of which no row can be left out."""
    with pytest.raises(HmkctaError, match=r"memory for level \d .*--max-memory"):
        compress(open_array(waves), plan, organisation=organisation, max_memory=300_000_000)


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
def test_a_search_for_a_goal_keeps_within_the_memory_given(waves: Path, memory: int) -> None:
    assert taken("compress", waves, size=1_000_000, quality="fast", max_memory=memory)["peak"] < memory


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
