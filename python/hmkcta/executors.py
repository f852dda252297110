"""Work on several nodes at once, within a bound on what they take together."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from threading import Condition


class Gate:
    """Lets work in as long as what is inside weighs no more than `limit` together; anything may be inside alone.

    >>> gate = Gate(10)
    >>> with gate.inside(4), gate.inside(6):
    ...     gate.weight
    10
    """

    def __init__(self, limit: int) -> None:
        self.limit, self.weight = limit, 0
        self._changed = Condition()

    @contextmanager
    def inside(self, weight: int) -> Generator[None]:
        """Wait for room, and hold it."""
        weight = min(weight, self.limit)
        with self._changed:
            self._changed.wait_for(lambda: self.weight + weight <= self.limit)
            self.weight += weight
        try:
            yield
        finally:
            with self._changed:
                self.weight -= weight
                self._changed.notify_all()
