"""What the machine can do at best: copy bandwidth and the rate of large float32 matrix products."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, cast

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits  # pyright: ignore[reportMissingTypeStubs] (it has none)

from benchmarks.report import Limits

#: Numbers copied: many times any cache; side of the matrices; runs of which the best counts.
COPIED, SIDE, RUNS = 1 << 27, 2048, 5


def best_of(work: Callable[[], object], runs: int = RUNS, seconds: float = 0.0) -> tuple[float, float]:
    """Wall and processor seconds of the fastest of several runs, the first of which does not count."""
    work()
    walls: list[float] = []
    processors: list[float] = []
    while len(walls) < runs or sum(walls) < seconds:
        wall, processor = time.perf_counter(), time.process_time()
        work()
        walls.append(time.perf_counter() - wall)
        processors.append(time.process_time() - processor)
    return min(walls), min(processors)


def limits(threads: Sequence[int]) -> Limits:
    """Measure both for each number of threads."""
    name = f"{_processor()}, {os.cpu_count()} cores, {platform.system()}, {_blas()}"
    return Limits(name, {count: _copy(count) for count in threads}, {count: _sgemm(count) for count in threads})


def _copy(threads: int) -> float:
    source, target = np.ones(COPIED, np.float32), np.zeros(COPIED, np.float32)
    cuts = [slice(COPIED * i // threads, COPIED * (i + 1) // threads) for i in range(threads)]

    def copy(cut: slice) -> None:
        np.copyto(target[cut], source[cut])

    with ThreadPoolExecutor(threads) as pool:
        _, processor = best_of(lambda: list(pool.map(copy, cuts)))
    return 2 * source.nbytes * threads / processor


def _sgemm(threads: int) -> float:
    a = np.random.default_rng(0).random((SIDE, SIDE), np.float32)
    b, c = a.T.copy(), np.empty_like(a)
    with threadpool_limits(limits=threads, user_api="blas"):
        _, processor = best_of(lambda: np.matmul(a, b, out=c))
    return 2 * SIDE**3 * threads / processor


def _blas() -> str:
    """The matrix product's library and the processor that it takes this one for, as it may know no better."""
    every = cast("list[dict[str, Any]]", threadpool_info())
    found = [one for one in every if one.get("user_api") == "blas"]
    return ", ".join(f"{one['internal_api']} for {one.get('architecture', 'any')}" for one in found) or "no known BLAS"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
