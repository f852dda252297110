"""Progress on stderr: a bar on a terminal, else a plain line every half minute; and where the time went."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType
from typing import Any

import click

from .output import seconds

#: Seconds between the lines where there is no terminal.
INTERVAL = 30.0


class Progress:
    """Called with a stage's name and the fraction of that stage done; a context manager that cleans up its bar.

    Args:
        quiet: show nothing, only keep the times.

    Attributes:
        stages: seconds spent in each stage.
    """

    def __init__(self, quiet: bool = False) -> None:
        self.quiet = quiet
        self.stages: dict[str, float] = {}
        self._start = self._called = self._begun = time.monotonic()
        self._now: tuple[str, float] = ("starting", 0.0)
        self._ended = threading.Event()
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> Progress:
        if self.quiet or sys.stderr is None:  # pyright: ignore[reportUnnecessaryComparison] (None where it is closed)
            return self
        if sys.stderr.isatty():
            self._open_bar()
        else:  # from a thread, as native code can be at one step for minutes
            threading.Thread(target=self._say_lines, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        if self._bar is not None:
            self._bar.stop()

    @property
    def elapsed(self) -> float:
        """Seconds since it was made."""
        return time.monotonic() - self._start

    def __call__(self, stage: str, fraction: float) -> None:
        """Note that up to now `stage` was worked on, and that `fraction` (0..1) of it is done."""
        now = time.monotonic()
        if stage != self._now[0]:
            self._begun = self._called
            if self._bar is not None:
                self._bar.reset(self._task, start=False, total=1.0, description=stage)
                self._bar.tasks[0].start_time = self._start  # elapsed is of all stages, left of this one
        self.stages[stage] = self.stages.get(stage, 0.0) + now - self._called
        self._called, self._now = now, (stage, fraction)
        if self._bar is not None:
            self._bar.update(self._task, completed=fraction)

    def _say_lines(self) -> None:
        while not self._ended.wait(INTERVAL):
            now = time.monotonic()
            click.echo(line(*self._now, now - self._start, now - self._begun), err=True)

    def _open_bar(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TextColumn("elapsed"),
                   TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn())
        self._bar = Bar(*columns, console=Console(stderr=True), transient=True)
        self._task = self._bar.add_task("starting", total=1.0)
        self._bar.start()


def line(stage: str, fraction: float, elapsed: float, spent: float) -> str:
    """What is said without a terminal, `spent` seconds into a stage.

    >>> line("level 2", 0.25, 40.0, 30.0)
    'hmkcta: level 2, 25 %, 40.0 s elapsed, about 1 min 30 s left in this stage'
    """
    known = 0 < fraction < 1
    left = f", about {seconds(spent * (1 - fraction) / fraction)} left in this stage" if known else ""
    return f"hmkcta: {stage}, {100 * fraction:.0f} %, {seconds(elapsed)} elapsed{left}"
