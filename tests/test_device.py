"""--device cuda: whole fits on a stand-in for the GPU, what happens where there is none, which device a run is on."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
from benchmarks import kernels

import hmkcta
from cli_tools import refused, report, run, saved
from cupy_stand_in import CUDARuntimeError, StandIn
from fit_tools import file_of
from hmkcta import backends
from hmkcta.backends import batched, cuda, find_device, reference
from hmkcta.errors import HmkctaError
from hmkcta.plan import LevelSpec
from hmkcta.streaming import budget, streamed
from hmkcta.support.executors import Pool
from resume_tools import DATA, LEVELS, MODES, After, Stop
from test_batched import kernels_of
from test_kernels import check_same, random_cells, smooth_data

TWO_LEVELS = "R=3,2,3,3 / R=2,1,2,2 C=2,1,2,2 K=2,1,2,2"
NAMES = ["light", "view", "y", "x", "rgb"]
AXES = ("--axes", ",".join(NAMES), "--organisation", MODES)


def estimate(monkeypatch: pytest.MonkeyPatch, **speeds: float) -> None:
    """Have calls shared out by other speeds."""
    for name, speed in speeds.items():
        monkeypatch.setattr(cuda, name, speed)


def put_in_place(stand_in: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have `import cupy` find this; None: nothing."""
    monkeypatch.setitem(sys.modules, "cupy", stand_in)
    estimate(monkeypatch, CORES=1e-9)  # all calls go to the GPU
    cuda._looked_for.cache_clear()  # pyright: ignore[reportPrivateUsage]


@pytest.fixture(autouse=True)
def _forget() -> Iterator[None]:  # pyright: ignore[reportUnusedFunction] (pytest uses it)
    yield
    cuda._looked_for.cache_clear()  # pyright: ignore[reportPrivateUsage]


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> StandIn:
    """A device that works, and gets all kernel calls."""
    device = StandIn()
    put_in_place(device, monkeypatch)
    return device


@pytest.fixture
def nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """No CuPy, also where it is installed."""
    put_in_place(None, monkeypatch)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return saved(tmp_path_factory.mktemp("source") / "material.npy", DATA.values)


def fitted(plan: str, device: Any, **options: Any) -> hmkcta.Model:
    settings: dict[str, Any] = {"scheme": "most", "quality": "fast", "threads": 2, "organisation": MODES, **options}
    return hmkcta.compress(DATA.values, plan, axes=NAMES, device=device, **settings)


# Whole fits


@pytest.mark.parametrize("plan", [
    "R=3,2,3,3", "R=2 C=3,2,3,3", TWO_LEVELS, "R=2,*,2,2 C=2,1,2,2 K=2,1,2,2", "R=1 C=12,1,12,12 K=2,1,2,2",
    "R=1 grid=y:2,x:2 / R=3",
])  # fmt: skip
def test_a_fit_on_the_device_is_as_good(plan: str, gpu: StandIn) -> None:
    quality = "medium" if plan == TWO_LEVELS else "fast"
    device = find_device("cuda")
    found, expected = (fitted(plan, where, quality=quality) for where in (device, "cpu"))
    assert abs(found.snr - expected.snr) < 0.02
    assert found.nbytes <= expected.nbytes + 8
    assert (device.calls > 0, device.calls_on_cpu) == (True, 0)
    assert found.metadata.writer == f"{expected.metadata.writer}, cuda"
    assert gpu.memory.used == 0


def test_all_kernels_are_called_on_the_device(gpu: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    del gpu
    names = ("fit_cells", "accumulate", "project_cells", "project_pair", "dictionary_gram")
    called: set[str] = set()
    for name in names:
        original = getattr(batched, name)

        def counted(*given: Any, name: str = name, original: Any = original) -> Any:
            called.add(name)
            return original(*given)

        monkeypatch.setattr(batched, name, counted)
    for plan in (TWO_LEVELS, "R=1 C=12,1,12,12 K=2,1,2,2", "R=1 C=2,1,2,2"):
        fitted(plan, "cuda")
    assert called == set(names)


def test_a_streamed_fit_on_the_device_is_as_good(gpu: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    del gpu
    monkeypatch.setattr(streamed, "SLAB", 15_000)
    monkeypatch.setattr(budget, "WORKSET", DATA.values.size // 3)
    device = find_device("cuda")
    found, expected = (fitted(TWO_LEVELS, where) for where in (device, "cpu"))
    assert abs(found.snr - expected.snr) < 0.02
    assert device.calls > 20


def test_the_same_bytes_each_time_whatever_the_threads(gpu: StandIn, tmp_path: Path) -> None:
    del gpu
    files = [file_of(fitted(TWO_LEVELS, "cuda", threads=threads), tmp_path) for threads in (1, 1, 4)]
    assert files[0] == files[1] == files[2]


def test_kernels_are_measured_on_the_device(gpu: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    estimate(monkeypatch, CORES=1e300)
    monkeypatch.setattr(kernels, "SECONDS", 0.0)
    monkeypatch.setattr(kernels, "RUNS", 1)
    device = find_device("cuda")
    rows = list(kernels.rows(["level 2 node"], [1], device=device))
    assert [rows[0].what, rows[-1].what] == ["accumulate", "fit_cells, a sweep"]
    assert sum(row.what.startswith("project_pair") for row in rows) == 2
    assert device.calls >= len(rows) == 8
    assert device.calls_on_cpu == gpu.memory.used == 0


# Which device


def test_a_device_is_of_a_run_and_its_threads(gpu: StandIn) -> None:
    del gpu
    cells, data = random_cells((6, 5), LevelSpec((2, 2), (2, 1), (1, 1)), 1), smooth_data((6, 5), 1)
    device = find_device("cuda")

    def call() -> int:
        backends.accumulate(cells, data.copy(), 1.0)
        return device.calls

    assert call() == 0
    with backends.use(device), Pool(1) as own, ThreadPoolExecutor(1) as others:
        assert call() == 1
        assert own.submit(call).result() == 2
        assert others.submit(call).result() == 2
        with backends.use(find_device("cpu")):
            assert call() == 2
        assert call() == 3
    assert call() == 3


def test_one_call_at_a_time_is_on_the_device(gpu: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    del gpu
    cells, data = random_cells((6, 5), LevelSpec((2, 2), (2, 1), (1, 1)), 1), smooth_data((6, 5), 1)
    inside: list[int] = []
    most = [0]

    def slow(*_: object) -> None:
        inside.append(1)
        most[0] = max(most[0], len(inside))
        time.sleep(0.02)
        inside.pop()

    device = find_device("cuda")
    monkeypatch.setattr(batched, "accumulate", slow)
    with backends.use(device), Pool(4) as pool:
        for done in [pool.submit(backends.accumulate, cells, data, 1.0) for _ in range(8)]:
            done.result()
    assert (most[0], device.calls) == (1, 8)


def test_small_calls_do_not_wait_for_the_device(gpu: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    del gpu
    estimate(monkeypatch, CORES=1000.0, LINK=1e300, BEGUN=1.0)
    small, large = (random_cells(sizes, LevelSpec((2, 2), (2, 1), (1, 1)), 1) for sizes in ((6, 5), (60, 50)))
    begun, ended = Event(), Event()

    def slow(*_: object) -> None:
        begun.set()
        assert ended.wait(20)

    device = find_device("cuda")
    monkeypatch.setattr(batched, "accumulate", slow)
    with backends.use(device), Pool(1) as pool:
        waiting = pool.submit(backends.accumulate, large, np.zeros((60, 50), np.float32), 1.0)
        assert begun.wait(20)
        backends.accumulate(small, np.zeros((6, 5), np.float32), 1.0)
        assert not waiting.done()
        ended.set()
        waiting.result()
    assert (device.calls, device.calls_on_cpu) == (1, 1)


def test_small_calls_stay_on_the_cpu(gpu: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cells that must come one by one take as often as long to begin with."""
    estimate(monkeypatch, CORES=999.5, LINK=1e300, BEGUN=1.0, SWEPT=5.0)
    device = find_device("cuda")
    taken = gpu.memory.peak
    with backends.use(device):
        for sizes, mixture, large in [((10, 10, 9), 1, 0), ((10, 10, 10), 1, 1), ((20, 20, 19), 2, 0),
                                      ((20, 20, 20), 2, 1)]:  # fmt: skip
            spec, before = LevelSpec((1, 1, 1), (4, 4, 4), (mixture, mixture, mixture)), device.calls
            cells, data = random_cells(sizes, spec, 2), smooth_data(sizes, 2)
            backends.fit_cells(cells, data, 1, 1)
            backends.accumulate(cells, data, 1.0)
            assert device.calls - before == 2 * large
    assert device.calls_on_cpu == 4
    assert gpu.memory.peak > taken


@pytest.mark.parametrize(("link", "calls"), [(1e300, 2), (1e-300, 0)])
def test_what_is_moved_counts(link: float, calls: int, gpu: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    del gpu
    estimate(monkeypatch, CORES=1e-200, LINK=link)
    device = find_device("cuda")
    cells, data = random_cells((6, 5), LevelSpec((2, 2), (2, 1), (1, 1)), 1), smooth_data((6, 5), 1)
    with backends.use(device):
        backends.project_cells(cells, data, 0)
        backends.project_pair(cells, data, (0, 1))
    assert (device.calls, device.calls_on_cpu) == (calls, 2 - calls)


def test_names_of_devices() -> None:
    with pytest.raises(HmkctaError, match="device: found 'gpu', allowed cpu or cuda"):
        fitted("R=1", "gpu")
    assert find_device("cpu").missing == ""


# Failures


def test_the_device_may_have_little_memory(gpu: StandIn) -> None:
    spec = LevelSpec((2, 2, 2), (4, 4, 4), (1, 1, 1))
    cells, data = random_cells((64, 64, 64), spec, 3), smooth_data((64, 64, 64), 3)
    expected = data.copy()
    reference.accumulate(cells, expected, 1.0)
    device = find_device("cuda")
    gpu.memory.limit, freed = 3 * data.nbytes, gpu.memory.frees
    with backends.use(device):
        backends.accumulate(cells, data, 1.0)
        np.testing.assert_allclose(data, expected, atol=1e-4)
        assert gpu.memory.frees > freed
        gpu.memory.limit, before = data.nbytes // 2, data.copy()
        with pytest.raises(HmkctaError, match=r"a node of 64 x 64 x 64 elements.*use --device cpu") as caught:
            backends.fit_cells(cells, data, 1, 1)
        assert caught.value.kind.label == "ResourceLimit"
        np.testing.assert_array_equal(data, before)
    assert gpu.memory.used == 0


def test_a_device_that_fails_on_the_way(gpu: StandIn, source: Path, tmp_path: Path) -> None:
    device = find_device("cuda")
    gpu.failure = CUDARuntimeError("cudaErrorECCUncorrectable: uncorrectable ECC error encountered")
    with pytest.raises(HmkctaError, match=r"uncorrectable ECC error.*use --device cpu"):
        fitted("R=2", device)
    sentence = refused("compress", source, "-o", tmp_path / "a.hmk", *AXES, "--plan", "R=2", "--device", "cuda", code=6)
    assert "ResourceLimit/device-failed" in sentence
    gpu.failure = ValueError("a mistake of ours")
    with pytest.raises(ValueError, match="ours"):
        fitted("R=2", device)


BANNER = "\n=====\nFailed to import CuPy.\n\nOriginal error:\n  ImportError: libnvrtc.so.12: not found\n=====\n"


class Unloadable:
    """In the place of the finders: CuPy is there, its libraries are not."""

    def find_spec(self, name: str, *_: object) -> None:
        """Fail as CuPy's own import does."""
        if name == "cupy":
            raise ImportError(BANNER)


@pytest.mark.parametrize(("stand_in", "said"), [
    (None, ("CuPy, which is not installed", 'pip install "hmkcta[cuda]"')),
    (Unloadable(), ("cannot be loaded: ImportError: libnvrtc.so.12: not found", 'pip install "hmkcta[cuda]"')),
    (StandIn(devices=0), ("no NVIDIA GPU",)),
    (StandIn(devices=-1), ("cudaErrorInsufficientDriver", "driver for CUDA 12")),
    (StandIn(failure=CUDARuntimeError("cudaErrorNoKernelImageForDevice: no kernel image")), ("no kernel image",)),
    (StandIn(memory=10), ("Out of memory",)),
    (StandIn(wrong=True), ("it computes",)),
], ids=["no CuPy", "no libraries", "no GPU", "old driver", "old GPU", "full GPU", "broken GPU"])  # fmt: skip
def test_the_cpu_takes_over_and_says_why(stand_in: Any, said: tuple[str, ...], source: Path, tmp_path: Path,
                                         monkeypatch: pytest.MonkeyPatch) -> None:  # fmt: skip
    put_in_place(stand_in, monkeypatch)
    if isinstance(stand_in, Unloadable):
        monkeypatch.delitem(sys.modules, "cupy")
        monkeypatch.setattr(sys, "meta_path", [stand_in, *sys.meta_path])
    with pytest.warns(UserWarning, match="the CPU is used instead") as caught:
        model = fitted("R=2", "cuda")
    assert caught[0].filename == __file__
    assert all(word in str(caught[0].message) for word in said)
    assert file_of(model, tmp_path) == file_of(fitted("R=2", "cpu"), tmp_path)
    result = run("compress", source, "-o", tmp_path / "a.hmk", *AXES, "--plan", "R=2", "--device", "cuda", "--quiet")
    assert result.stderr == f"hmkcta: {caught[0].message}\n"
    assert result.stdout == ""


@pytest.mark.usefixtures("nothing")
def test_the_report_says_what_was_missing(source: Path, tmp_path: Path) -> None:
    command = ("compress", source, "-o", tmp_path / "a.hmk", *AXES, "--plan", "R=2", "--overwrite")
    found = report(*command, "--device", "cuda")["device"]
    assert (found["name"], found["described"]) == ("cpu", "cpu")
    assert "CuPy" in found["missing"]
    assert report(*command)["device"]["missing"] == ""


def test_the_report_names_the_device(gpu: StandIn, source: Path, tmp_path: Path) -> None:
    del gpu
    command = ("compress", source, "-o", tmp_path / "a.hmk", *AXES, "--plan", "R=2", "--device", "cuda", "--overwrite")
    result = run(*command)
    described = "cuda: Stand-in 1, compute capability 9.0, CuPy 14.2.0, CUDA 12.9"
    assert f"{described}: 3 of 3 kernel calls" in result.stdout
    assert "cuda" not in result.stderr
    found = report(*command)["device"]
    assert found == {"name": "cuda", "described": described, "missing": "", "calls": 3, "calls_on_cpu": 0}
    assert report("info", tmp_path / "a.hmk")["writer"].endswith(", cuda")


def test_interrupted_work_is_of_one_device(gpu: StandIn, source: Path, tmp_path: Path) -> None:
    del gpu
    output = tmp_path / "a.hmk"
    options: dict[str, Any] = {"quality": "medium", "scheme": "auto"}
    command = ("compress", source, "-o", output, *AXES, "--plan", LEVELS, "--resume")
    for first, second in (("cpu", "cuda"), ("cuda", "cpu")):
        with pytest.raises(Stop), hmkcta.Journal(f"{output}.partial") as journal:
            fitted(LEVELS, first, journal=journal, progress=After(20), **options)
        sentence = refused(*command, "--device", second, code=2)
        assert f'found device "{second}' in sentence
        assert f'allowed device "{first}' in sentence
        found = report(*command, "--device", first)
        assert found["nodes_resumed"] > 0
        assert file_of(fitted(LEVELS, first, **options), tmp_path) == output.read_bytes()
        output.unlink()


# A real one


def test_on_a_real_gpu(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    device = find_device("cuda")
    if device.missing:
        pytest.skip(f"no GPU: {device.missing}")
    import cupy  # pyright: ignore[reportMissingImports]

    on = cuda.arrays(cupy, 1 << 16)
    for spec in (LevelSpec((3, 9, 4), (3, 2, 4), (2, 2, 2)), LevelSpec((3, None, 4), (3, 1, 4), (1, 1, 1))):
        check_same(random_cells((70, 40, 90), spec, 1), smooth_data((70, 40, 90), 2), kernels_of(on))
    estimate(monkeypatch, CORES=1e-9)
    found, again, expected = (fitted(TWO_LEVELS, where) for where in (device, device, "cpu"))
    assert abs(found.snr - expected.snr) < 0.02
    assert json.loads(json.dumps(device.calls)) > 10
    assert file_of(found, tmp_path) == file_of(again, tmp_path)
