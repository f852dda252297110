"""The whole numbers of a node in a run: cell by cell the columns of its bases, then its core."""

from __future__ import annotations

from itertools import product
from math import frexp, prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .contexts import MOST_K, code_integer, code_magnitude, size_of
from .range_coder import CodeError, Coder

if TYPE_CHECKING:
    from .run_code import Node, Place

Array = NDArray[Any]


def length_log(length: int) -> int:
    """Twice the logarithm of a length, rounded."""
    below = (length * length).bit_length() - 1
    return below + (length**4 >= 2 ** (2 * below + 1))


def code_numbers(coder: Coder, node: Node, place: Place) -> None:
    """All numbers of a node whose tables are known."""
    free = [n for n in range(len(node.mixture)) if node.mixture[n]]
    for flat, cell in enumerate(product(*map(range, node.clusters))):
        rows = {n: np.argwhere(node.members[n] == cell[n]) for n in free}  # row and place of each member
        if any(len(own) == 0 for own in rows.values()):
            continue
        before: list[int] = []
        for n in free:
            _code_steps(coder, n, node.columns[n][flat], before)
            others = [c for m, c in enumerate(node.clusters) if m != n]
            among = int(np.ravel_multi_index([c for m, c in enumerate(cell) if m != n], others)) if others else 0
            extents = place.extents[n]
            inner = extents[-1] if node.clusters[n] == 1 and len(extents) > 1 else 0
            for r in range(node.ranks[n]):
                column = node.basis[n][rows[n][:, 0], rows[n][:, 1], among, r]
                _code_column(coder, column, int(node.columns[n][flat, r]), inner)
                node.basis[n][rows[n][:, 0], rows[n][:, 1], among, r] = column
        _code_core(coder, node, place, flat, free)


def _code_steps(coder: Coder, n: int, own: Array, before: list[int]) -> None:
    """k of a mode's columns: of the first of all by itself, of others by what they are less than one before."""
    for r in range(len(own)):
        if not before:
            k = code_integer(coder, "first k", int(own[r]))
        else:
            known = before[0] if r == 0 else before[-1]
            less = known - int(own[r])
            zigzag = code_integer(
                coder, ("k", n, r > 0), 0 if coder.decodes else 2 * less if less >= 0 else -2 * less - 1
            )
            k = known - (zigzag // 2 if zigzag % 2 == 0 else -(zigzag + 1) // 2)
        if not 0 <= k <= MOST_K:
            raise CodeError("code-range")
        own[r] = k
        before.append(k)


def _sign(number: int) -> int:
    return (number > 0) - (number < 0) + 1


def _code_column(coder: Coder, column: Array, k: int, inner: int) -> None:
    """A column's numbers; `inner`: the last of several extents of its rows, else 0."""
    size = size_of(k - length_log(len(column)), 80, 16)
    for i in range(len(column)):
        if inner:
            a = int(column[i - 1]) if i % inner else None
            b = int(column[i - inner]) if i >= inner else None
        else:
            a = int(column[i - 1]) if i > 0 else None
            b = int(column[i - 2]) if i > 1 else None
        around = [a if a is not None else b or 0, b if b is not None else a or 0]
        given = int(column[i])
        magnitude = code_magnitude(coder, "basis", size, around, given)
        negative = 0
        if magnitude:
            negative = coder.bit(("basis sign", _sign(a or 0), _sign(b or 0), min(size[0], 63) >> 2), int(given < 0))
        column[i] = -magnitude if negative else magnitude


def _base(node: Node, place: Place, flat: int, free: list[int]) -> int:
    """What the sizes of a cell's core numbers are counted from, in half octaves."""
    if not free:
        return 0
    energy = 0.0
    for k in node.columns[free[0]][flat]:
        energy += 2.0 ** int(k)
    exponent = frexp(2**0.5 * energy)[1] - 1
    whole = sum(rows.bit_length() - 1 for n, rows in enumerate(place.rows) if n not in free)
    return -(len(free) - 1) * exponent - whole


def _code_core(coder: Coder, node: Node, place: Place, flat: int, free: list[int]) -> None:
    """A cell's core. Modes without a basis have an axis for each of their extents."""
    sizes, modes = list[int](), list[int]()
    for n, rank in enumerate(node.ranks):
        own = [rank] if n in free else list(place.extents[n])
        sizes += own
        modes += [n] * len(own)
    core = node.core[flat].reshape(sizes)
    # Neighbours along axes without a basis come mode by mode, the last extent first.
    whole = sorted((a for a, n in enumerate(modes) if n not in free), key=lambda a: (modes[a], -a))
    base = _base(node, place, flat, free)
    for index in product(*map(range, sizes)):
        t = base + sum(int(node.columns[n][flat, i]) for n, i in zip(modes, index, strict=True) if n in free)
        near = {a: int(core[(*index[:a], i - 1, *index[a + 1 :])]) for a, i in enumerate(index) if i > 0}
        given = int(core[index])
        magnitude = code_magnitude(coder, "core", size_of(t, 96, 40), list(near.values()), given)
        negative = 0
        if magnitude and whole:
            a, b, *_ = [*(near[axis] for axis in whole if axis in near), 0, 0]
            negative = coder.bit(("core sign", _sign(a), _sign(b)), int(given < 0))
        elif magnitude:
            negative = coder.raw(1, int(given < 0))
        core[index] = -magnitude if negative else magnitude
    node.core[flat] = core.reshape(node.core[flat].shape)
    assert core.size == prod(node.ranks)
