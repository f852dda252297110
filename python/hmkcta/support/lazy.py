"""Attributes that are computed when they are first asked for, each object's by itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar, overload

T = TypeVar("T")


class lazy(Generic[T]):
    """As `functools.cached_property`, without the lock that Python 3.11 has all objects of a class wait for.

    Threads that ask one object at once may both compute it.

    >>> class Square:
    ...     def __init__(self, side):
    ...         self.side = side
    ...     @lazy
    ...     def area(self):
    ...         return self.side**2
    >>> Square(3).area
    9
    """

    def __init__(self, compute: Callable[[Any], T]) -> None:
        self._compute, self.__doc__ = compute, compute.__doc__

    def __set_name__(self, _: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, owner: None, _: type) -> lazy[T]: ...

    @overload
    def __get__(self, owner: object, _: type) -> T: ...

    def __get__(self, owner: object | None, _: type) -> lazy[T] | T:
        if owner is None:
            return self
        found = self._compute(owner)
        owner.__dict__[self._name] = found  # which is looked up before this is asked again
        return found
