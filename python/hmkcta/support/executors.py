"""Work on several nodes at once, within a bound on what they take together."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import copy_context
from threading import Condition
from typing import Any, TypeVar

S = TypeVar("S")
T = TypeVar("T")


def thread_count(wanted: int | None = None) -> int:
    """How many threads to start: as many as wanted (None: all), and never more than this process has cores.

    More of them only take turns, and each takes memory and time to begin.

    >>> thread_count(1), thread_count(10**9) == thread_count()
    (1, True)
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return cores if wanted is None else min(int(wanted), cores)


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


def in_order(work: Callable[[S], T], items: Sequence[S], workers: int) -> Iterator[T]:
    """What the work makes of the items, in their order, few of them ahead of what is taken."""
    if min(workers, len(items)) <= 1:
        yield from map(work, items)
        return
    waiting: deque[Future[T]] = deque()
    with Pool(workers) as pool:
        try:
            for item in items:
                waiting.append(pool.submit(work, item))
                if len(waiting) > workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


def repeatedly(work: Callable[[], int], times: int, workers: int, told: Callable[[int], None]) -> None:
    """Do the work that many `times`, side by side; `told` hears what the results add up to.

    >>> repeatedly(lambda: 2, 3, 1, print)
    2
    4
    6
    """
    done = 0
    with Pool(workers) as pool:
        futures = [pool.submit(work) for _ in range(times)]
        try:
            for future in futures:
                done += future.result()
                told(done)
        except BaseException:
            pool.shutdown(wait=True, cancel_futures=True)
            raise


class Queue:
    """Work by weight: the heaviest first that fits beside what is being done.

    No more than `limit` is done at once, but anything may be done alone.

    >>> queue = Queue([1, 4, 9, 5], limit=10)
    >>> with queue.next() as first, queue.next() as second:
    ...     first, second
    (2, 0)
    """

    def __init__(self, weights: Sequence[int], limit: int) -> None:
        self._weights = [min(weight, limit) for weight in weights]
        self._left = sorted(range(len(weights)), key=lambda number: -weights[number])
        self._room = limit
        self._changed = Condition()

    @contextmanager
    def next(self) -> Generator[int]:
        """Wait for room, and hold it: the number of a piece of work that nobody else gets."""
        with self._changed:
            self._changed.wait_for(lambda: self.following is not None)
            number = self.following
            assert number is not None
            self._left.remove(number)
            self._room -= self._weights[number]
        try:
            yield number
        finally:
            with self._changed:
                self._room += self._weights[number]
                self._changed.notify_all()

    @property
    def following(self) -> int | None:
        """What would be next, if there is room for anything that is left."""
        return next((number for number in self._left if self._weights[number] <= self._room), None)
