"""A bar of progress on a terminal or in a notebook, with the best found so far and the time left."""

from __future__ import annotations

import sys
import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from .progress import Progress, nobody


class Bar:
    """A bar that is called with a stage's name and the fraction of it done; it vanishes at the end."""

    def __init__(self, begun: float | None = None) -> None:
        """Draw it; `begun`: of `time.monotonic`, from which on time is counted."""
        from rich.console import Console
        from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.progress import Progress as Rich

        columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TextColumn("elapsed"),
                   TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
        self._rich: Any = Rich(*columns, console=Console(stderr=True), transient=True)
        self._task: Any = self._rich.add_task("starting", total=1.0)
        self._begun, self._stage, self._best = begun or time.monotonic(), "starting", ""
        self._rich.start()

    def __call__(self, stage: str, fraction: float) -> None:
        """Note that `fraction` (0..1) of a stage is done."""
        if stage != self._stage:
            self._stage = stage
            self._rich.reset(self._task, start=False, total=1.0, description=self._stage + self._best)
            self._rich.tasks[0].start_time = self._begun  # elapsed is of all stages, left of this one
        self._rich.update(self._task, completed=fraction)

    def best(self, nbytes: int, snr: float) -> None:
        """Show the best file found so far: its bytes, and its SNR in dB."""
        self._best = f", best so far {best_text(nbytes, snr)}"
        self._rich.update(self._task, description=self._stage + self._best)

    def close(self) -> None:
        """Take it off the screen."""
        self._rich.stop()


def best_text(nbytes: int, snr: float) -> str:
    """The best file so far, for people.

    >>> best_text(307200, 29.07)
    '29.1 dB in 300 KiB'
    """
    size = f"{nbytes / 1024:.0f} KiB" if nbytes < 1 << 20 else f"{nbytes / 2**20:.1f} MiB"
    return f"{snr:.1f} dB in {size}"


@contextmanager
def shown(progress: Progress | None) -> Generator[Progress]:
    """The listener that was given; without one a bar, where somebody looks: at a terminal, or in a notebook."""
    if progress is not None or not (_terminal() or "ipykernel" in sys.modules):
        yield progress or nobody
        return
    bar = Bar()
    try:
        yield bar
    finally:
        bar.close()


def _terminal() -> bool:
    # stderr is None where it is closed
    return sys.stderr is not None and sys.stderr.isatty()  # pyright: ignore[reportUnnecessaryComparison]
