"""Progress on stderr: a bar on a terminal, else a plain line every half minute; and where the time went."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType

import click

from ..support.bar import Bar, best_text
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
        self._best = ""
        self._bar: Bar | None = None

    def __enter__(self) -> Progress:
        if self.quiet or sys.stderr is None:  # pyright: ignore[reportUnnecessaryComparison] (None where it is closed)
            return self
        if sys.stderr.isatty():
            self._bar = Bar(self._start)
        else:  # from a thread, as native code can be at one step for minutes
            threading.Thread(target=self._say_lines, daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        if self._bar is not None:
            self._bar.close()

    @property
    def elapsed(self) -> float:
        """Seconds since it was made."""
        return time.monotonic() - self._start

    def __call__(self, stage: str, fraction: float) -> None:
        """Note that up to now `stage` was worked on, and that `fraction` (0..1) of it is done."""
        now = time.monotonic()
        if stage != self._now[0]:
            self._begun = self._called
        self.stages[stage] = self.stages.get(stage, 0.0) + now - self._called
        self._called, self._now = now, (stage, fraction)
        if self._bar is not None:
            self._bar(stage, fraction)

    def best(self, nbytes: int, snr: float) -> None:
        """Note the best file found so far: its bytes, and its SNR in dB."""
        self._best = f", best so far {best_text(nbytes, snr)}"
        if self._bar is not None:
            self._bar.best(nbytes, snr)

    def _say_lines(self) -> None:
        while not self._ended.wait(INTERVAL):
            now = time.monotonic()
            click.echo(line(*self._now, now - self._start, now - self._begun) + self._best, err=True)


def line(stage: str, fraction: float, elapsed: float, spent: float) -> str:
    """What is said without a terminal, `spent` seconds into a stage.

    >>> line("level 2", 0.25, 40.0, 30.0)
    'hmkcta: level 2, 25 %, 40.0 s elapsed, about 1 min 30 s left in this stage'
    """
    known = 0 < fraction < 1
    left = f", about {seconds(spent * (1 - fraction) / fraction)} left in this stage" if known else ""
    return f"hmkcta: {stage}, {100 * fraction:.0f} %, {seconds(elapsed)} elapsed{left}"
