"""Results that several callers ask for, found once."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from concurrent.futures import Future
from threading import Lock
from typing import Generic, TypeVar

T = TypeVar("T")


class Once(Generic[T]):
    """Results by their keys: the first to ask finds one, others who ask meanwhile wait for it.

    Args:
        most: how many are kept, those that were asked for last.

    >>> squares = Once[int](most=2)
    >>> [squares.get(n, lambda n=n: print("found", n) or n * n) for n in (2, 3, 2)]
    found 2
    found 3
    [4, 9, 4]
    """

    def __init__(self, most: int) -> None:
        self._most, self._lock = most, Lock()
        self._results = dict[Hashable, Future[T]]()

    def get(self, key: Hashable, find: Callable[[], T]) -> T:
        """The result under a key; what its finder raises is raised to all who wait."""
        with self._lock:
            result = self._results.pop(key, None)
            is_new, result = result is None, result or Future[T]()
            self._results[key] = result
            for oldest in list(self._results)[: -self._most]:
                del self._results[oldest]
        if is_new:
            try:
                result.set_result(find())
            except BaseException as error:
                result.set_exception(error)
                raise
        return result.result()
