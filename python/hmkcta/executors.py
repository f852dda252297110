"""Work on several nodes at once, within a bound on what they take together."""

from __future__ import annotations

from collections.abc import Callable, Generator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from threading import Condition
from typing import Any, TypeVar

T = TypeVar("T")


class Pool(ThreadPoolExecutor):
    """Threads whose work sees the context variables of whoever hands it in, among them the device of the run.

    >>> from contextvars import ContextVar
    >>> device = ContextVar("device", default="cpu")
    >>> token = device.set("cuda")
    >>> with Pool(1) as pool:
    ...     pool.submit(device.get).result()
    'cuda'
    """

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Have it done in a copy of the context at hand."""
        return super().submit(copy_context().run, fn, *args, **kwargs)


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
