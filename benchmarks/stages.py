"""Where the time of a fit goes: processor seconds of its stages, and of the native kernels within them."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import hmkcta
from benchmarks.compressing import Case
from hmkcta import backends
from hmkcta.readers import open_array

KERNELS = ("fit_cells", "project_cells", "project_pair", "contract_lanes", "accumulate", "dictionary_gram", "code_rows",
           "solve_cores", "gather", "scatter")  # fmt: skip


def profile(case: Case) -> str:
    """Fit on one thread; a markdown table of its stages, then one of the kernels."""
    stages: defaultdict[str, float] = defaultdict(float)
    present = ["reading", time.process_time()]

    def progress(stage: str, _: float) -> None:
        now = time.process_time()
        stages[str(present[0])] += now - float(present[1])
        present[:] = [stage, now]

    with _timed() as kernels:
        start = time.process_time()
        hmkcta.compress(open_array(Path(case.path)), case.plan, axes=case.data[0].split(","),
                        organisation=case.data[1], scheme="most", threads=1, progress=progress)
        total = time.process_time() - start
    progress("", 1.0)
    kernels["all else: NumPy and Python"] = total - sum(kernels.values())
    return "\n\n".join((_table("stage", stages, total), _table("kernel", kernels, total))) + "\n"


@contextmanager
def _timed() -> Generator[dict[str, float]]:
    """Replace the kernels by ones that add up their processor seconds: all threads', which one thread's node uses."""
    spent: dict[str, float] = dict.fromkeys(KERNELS, 0.0)
    originals = {name: getattr(backends, name) for name in KERNELS}

    def timed(name: str, kernel: Callable[..., Any]) -> Callable[..., Any]:
        def call(*given: Any, **options: Any) -> Any:
            start = time.process_time()
            result = kernel(*given, **options)
            spent[name] += time.process_time() - start
            return result

        return call

    try:
        for name, kernel in originals.items():
            setattr(backends, name, timed(name, kernel))
        yield spent
    finally:
        for name, kernel in originals.items():
            setattr(backends, name, kernel)


def _table(title: str, seconds: dict[str, float], total: float) -> str:
    lines = [f"| {title} | cpu-s | share |", "| --- | --- | --- |"]
    lines += [f"| {name} | {spent:.1f} | {100 * spent / total:.0f} % |" for name, spent in seconds.items() if spent]
    return "\n".join(lines)
