"""Parameters of the codes of a packed level's numbers (`docs/format.md`, section 3): of each column of its bases.

The array ``rice/<n>`` has a byte for each column of a mode: the lower four bits are the parameter of the column's basis
numbers, the upper four the largest one of the core numbers that stand for this column. A core number, which stands for
a column of each mode, has the least of these. Numbers are whole ones q, in steps that go with their parameter.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arrays import F32, F64
from .bitstream import I32, U8
from .rice import PARAMETERS

F16 = NDArray[np.float16]
U32 = NDArray[np.uint32]

#: Numbers looked at together: what is made of them on the way stays in the cache.
_TOGETHER = 1 << 14
#: Larger ones, for which there is no code either, are taken for this.
_LARGEST = (1 << 30) - 1
#: A number is q / 2^(k + 2): about one at the most, as codes are short where 2^k is near the size of most q.
BELOW_ONE = 2
#: About what the finest steps of a fit leave of the energy of what a level is to hold.
LEFT = 2e-7


def bytes_of(basis: U8, core: U8) -> U8:
    """The table entries of columns of these parameters of basis numbers, and of core numbers at most.

    >>> bytes_of(np.array([7, 3], np.uint8), np.array([15, 1], np.uint8)).tolist()
    [247, 19]
    """
    return (basis | (core << 4)).astype(np.uint8)


def of_basis(entries: U8) -> U8:
    """The parameter of the basis numbers of each column.

    >>> of_basis(np.array([247, 19], np.uint8)).tolist()
    [7, 3]
    """
    return (entries & 15).astype(np.uint8)


def of_core(entries: U8) -> U8:
    """The largest parameter of the core numbers of each column.

    >>> of_core(np.array([247, 19], np.uint8)).tolist()
    [15, 1]
    """
    return (entries >> 4).astype(np.uint8)


def of_basis_numbers(rice: U8, ranks: NDArray[np.integer[Any]], numbers: NDArray[np.integer[Any]]) -> U8:
    """Of each number of a mode's bases, by the entries of the nodes' columns, their ranks and how many numbers.

    >>> of_basis_numbers(np.array([7, 2, 4], np.uint8), np.array([2, 1]), np.array([4, 3])).tolist()
    [7, 2, 7, 2, 4, 4, 4]
    """
    ranks, ends = ranks.astype(np.int64), np.cumsum(numbers.astype(np.int64))
    starts, columns, own = ends - numbers, np.cumsum(ranks) - ranks, of_basis(rice)
    found = np.empty(int(ends[-1]) if ends.size else 0, np.uint8)
    for begin in range(0, found.size, _TOGETHER):  # of nodes there can be a million, of numbers more
        end = min(begin + _TOGETHER, found.size)
        first, last = (int(np.searchsorted(ends, at, side="right")) for at in (begin, end - 1))
        edges = np.clip(np.append(starts[first : last + 1], ends[last]), begin, end)
        node = np.repeat(np.arange(first, last + 1), np.diff(edges))
        found[begin:end] = own[columns[node] + (np.arange(begin, end) - starts[node]) % ranks[node]]
    return found


def of_core_numbers(rice: Sequence[U8 | None], shape: U32) -> U8:
    """Of each core number of a level, by the entries of its columns and the shapes `[S, 3, N]` of its nodes.

    >>> rice = [np.array([128, 48], np.uint8), None, np.array([80, 64], np.uint8)]
    >>> of_core_numbers(rice, np.array([[[1, 1, 1], [1, 1, 1], [2, 3, 2]]], np.uint32)).tolist()
    [5, 4, 5, 4, 5, 4, 3, 3, 3, 3, 3, 3]
    """
    ranks, cells = shape[:, 2].astype(np.int64), shape[:, 0].prod(axis=1, dtype=np.int64)
    sizes, own = cells * ranks.prod(axis=1), [None if each is None else of_core(each) for each in rice]
    begins, columns = np.cumsum(sizes) - sizes, np.cumsum(ranks, axis=0) - ranks
    numbers = np.empty(int(sizes.sum()), np.uint8)
    alike, kind, counts = np.unique(np.column_stack([cells, ranks]), axis=0, return_inverse=True, return_counts=True)
    order, ends = np.argsort(kind.reshape(-1), kind="stable"), np.cumsum(counts)
    for (count, *rank), begin, end in zip(alike.tolist(), ends - counts, ends, strict=True):
        each = count * prod(rank)  # numbers of a node
        together = max(1, _TOGETHER // max(1, each))
        for first in range(begin, end if each else begin, together):
            nodes = order[first : min(first + together, end)]
            found = np.full((nodes.size, *rank), PARAMETERS - 1, np.uint8)
            for n, of_mode in enumerate(own):
                if of_mode is not None:
                    of_rows = of_mode[columns[nodes, n][:, None] + np.arange(rank[n])]
                    along = (nodes.size, *(rank[n] if m == n else 1 for m in range(len(rank))))
                    np.minimum(found, of_rows.reshape(along), out=found)
            numbers[begins[nodes][:, None] + np.arange(each)] = np.tile(found.reshape(nodes.size, -1), (1, count))
    return numbers


def most_of_core(rice: Sequence[U8 | None], ranks: NDArray[np.integer[Any]]) -> U8:
    """The largest one of each node's core numbers, `[S]`: the least, over the modes, of the most of its columns.

    >>> most_of_core([np.array([128, 48], np.uint8), np.array([80, 64], np.uint8)], np.array([[2, 2]])).tolist()
    [5]
    """
    most = np.full(len(ranks), PARAMETERS - 1, np.uint8)
    for own, rank in zip(rice, ranks.astype(np.int64).T, strict=True):
        if own is not None and own.size:
            there = rank > 0
            starts = (np.cumsum(rank) - rank)[there]
            most[there] = np.minimum(most[there], np.maximum.reduceat(of_core(own), starts))
    return most


def whole_of_core(cores: F32) -> tuple[I32, F64]:
    """Core numbers `[PC, ..]` as whole ones, and for each cell the largest number that all are multiples of.

    That is 1 where all are 0.

    >>> whole, step = whole_of_core(np.array([[0.75, -1.5, 0], [0, 0, 0]], np.float32))
    >>> whole.tolist(), step.tolist()
    ([[1, -2, 0], [0, 0, 0]], [0.75, 1.0])
    """
    each = cores.reshape(len(cores), -1)
    mantissa, exponent = np.frexp(each)
    lowest = np.where(each == 0, 1 << 10, exponent).min(axis=1, initial=1 << 10, keepdims=True) - 24
    digits = np.ldexp(mantissa.astype(np.float64), np.where(each == 0, 0, exponent - lowest)).astype(np.int64)
    shared = np.gcd.reduce(digits, axis=1).astype(np.float64) if digits.size else np.zeros(len(cores))
    step = np.where(shared > 0, np.ldexp(shared, lowest[:, 0]), 1.0)
    return np.rint(each / step[:, None]).astype(np.int32).reshape(cores.shape), step


def of_columns(basis: F32) -> U8:
    """The parameter of each column `[R_n]` of bases `[.., R_n]`: that of which its numbers are whole steps.

    >>> of_columns(np.array([[0.25, 0.375], [-0.75, 0.5]], np.float32)).tolist()
    [0, 1]
    """
    finest = PARAMETERS - 1
    used = np.bitwise_or.reduce(whole(basis, np.array(finest, np.uint8)).reshape(-1, basis.shape[-1]), axis=0)
    lowest = np.log2(np.maximum(used & -used, 1)).astype(np.int32)
    return np.where(used == 0, 0, np.maximum(finest - lowest, 0)).astype(np.uint8)


def whole(numbers: F16 | F32, k: U8) -> I32:
    """Numbers of these parameters as whole ones.

    >>> whole(np.array([0.5, -0.75], np.float16), np.array([0, 1], np.uint8)).tolist()
    [2, -6]
    """
    found, flat = np.empty(numbers.size, np.int32), numbers.reshape(-1)
    each = np.broadcast_to(k, numbers.shape).reshape(-1)
    for part in _parts(found.size):
        scaled = np.ldexp(flat[part].astype(np.float64), each[part].astype(np.int32) + BELOW_ONE)
        found[part] = np.clip(np.rint(scaled), -_LARGEST, _LARGEST)
    return found.reshape(numbers.shape)


def from_whole(whole: I32, k: U8) -> F16:
    """The float16 numbers nearest to whole ones of these parameters.

    >>> from_whole(np.array([2, -6]), np.array([0, 1], np.uint8)).tolist()
    [0.5, -0.75]
    """
    found, flat = np.empty(whole.size, np.float16), whole.reshape(-1)
    each = np.broadcast_to(k, whole.shape).reshape(-1)
    for part in _parts(found.size):
        found[part] = np.ldexp(flat[part].astype(np.float64), -each[part].astype(np.int32) - BELOW_ONE)
    return found.reshape(whole.shape)


def _parts(count: int) -> Iterator[slice]:
    """Some numbers after others, of so many."""
    return (slice(begin, begin + _TOGETHER) for begin in range(0, count, _TOGETHER))
