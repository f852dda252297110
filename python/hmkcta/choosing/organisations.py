"""Ways to merge axes into modes, for a search among them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

from ..axes import Axis, Organisation


def organisations(axes: Sequence[Axis]) -> Iterator[Organisation]:
    """Every way to merge axes into modes, that which merges none first; axes of size 1 ride with the first mode."""
    names = [axis.name for axis in axes if axis.size > 1]
    for partition in _partitions(names):
        if len(partition) > 1 or len(names) < 2:
            yield _arranged(partition, axes)


def _arranged(partition: Sequence[Sequence[str]], axes: Sequence[Axis]) -> Organisation:
    """Axes in their order within a mode, and modes in the order of their first axes."""
    names = [axis.name for axis in axes if axis.size > 1]
    single = tuple(axis.name for axis in axes if axis.size == 1)
    modes = sorted((sorted(mode, key=names.index) for mode in partition), key=lambda mode: names.index(mode[0]))
    first, *others = [tuple(mode) for mode in modes] or [()]
    return (single + first, *others)


def merges(organisation: Organisation, axes: Sequence[Axis]) -> Iterator[Organisation]:
    """The organisation with two of its modes made one."""
    modes = _of_many(organisation, axes)
    for a, b in combinations(range(len(modes)), 2):
        yield _arranged([modes[a] + modes[b], *(mode for n, mode in enumerate(modes) if n not in (a, b))], axes)


def moves(organisation: Organisation, axes: Sequence[Axis]) -> Iterator[Organisation]:
    """The organisation with one of its axes in another of its modes, or in one of its own.

    >>> video = [Axis("time", 9), Axis("y", 40), Axis("x", 60)]
    >>> [*moves((("time",), ("y", "x")), video)]
    [(('time', 'y'), ('x',)), (('time',), ('y',), ('x',)), (('time', 'x'), ('y',))]
    """
    modes, found = _of_many(organisation, axes), dict[Organisation, None]()
    for name in (name for mode in modes for name in mode):
        left = [[other for other in mode if other != name] for mode in modes]
        for n in range(len(left) + 1):
            moved = [[*mode, name] if m == n else mode for m, mode in enumerate([*left, []])]
            found[_arranged([mode for mode in moved if mode], axes)] = None
    yield from (each for each in found if len(each) > 1 and each != organisation)


def _of_many(organisation: Organisation, axes: Sequence[Axis]) -> list[list[str]]:
    """Its modes without axes of size 1."""
    single = {axis.name for axis in axes if axis.size == 1}
    return [[name for name in mode if name not in single] for mode in organisation]


def _partitions(names: list[str]) -> Iterator[list[list[str]]]:
    if not names:
        yield []
        return
    for rest in _partitions(names[1:]):
        yield [[names[0]], *rest]
        for n, mode in enumerate(rest):
            yield [*rest[:n], [names[0], *mode], *rest[n + 1 :]]
