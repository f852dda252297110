"""Grids that cut axes into blocks: those that a search begins with, and which of their neighbours are allowed."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import isqrt, prod

#: Block edges never fall below this, unless to single indices, nor elements of a block below so many times the sum of
#: its edges.
SMALLEST_EDGE, THIN = 4, 4
#: Most blocks.
MOST_BLOCKS = 4096


def few_grids(shape: Sequence[int]) -> list[tuple[int, ...]]:
    """No blocks, edges of about 64 and 32 along axes longer than 48, and of about 16 along all that are not short."""
    grids = [tuple(round(size / edge) if size > 48 else 1 for size in shape) for edge in (64, 32)]
    grids.append(tuple(round(size / 16) if size >= 24 else 1 for size in shape))
    return list(dict.fromkeys([(1,) * len(shape), *(grid for grid in grids if worth_cutting(grid, shape))]))


def uncut_grids(shape: Sequence[int]) -> list[tuple[int, ...]]:
    """The last of the few grids with some of its axes uncut: blocks are long along axes of little detail."""
    counts = few_grids(shape)[-1]
    grids = (grid for grid in product(*({1, count} for count in counts)) if 1 < prod(grid) < prod(counts))
    return sorted(grids)


def single_grids(shape: Sequence[int]) -> list[tuple[int, ...]]:
    """One axis cut into its single indices, all others uncut, halved, or as in the last of the few grids: what moves
    from frame to frame has low ranks in each frame alone.

    >>> single_grids((10, 48, 5))
    [(10, 1, 1), (10, 2, 1), (1, 1, 5), (1, 2, 5), (1, 3, 5)]
    """
    blocks = few_grids(shape)[-1]
    others = dict.fromkeys([(1,) * len(shape), tuple(min(2, count) for count in blocks), blocks])
    grids = (changed(grid, n, size) for n, size in enumerate(shape) if size > 1 for grid in others)
    return [grid for grid in dict.fromkeys(grids) if worth_cutting(grid, shape)]


def worth_cutting(grid: Sequence[int], shape: Sequence[int]) -> bool:
    """Whether there are not too many blocks, nor such thin ones that one vector for each axis is most of a block."""
    edges = [size / count for size, count in zip(shape, grid, strict=True) if size > 1]
    return prod(grid) <= MOST_BLOCKS and prod(edges) >= THIN * sum(edges)


def changed(grid: tuple[int, ...], n: int, count: int) -> tuple[int, ...]:
    return (*grid[:n], count, *grid[n + 1 :])


def more(count: int, size: int, by: int = 0) -> int:
    """Twice as many blocks of an axis, or `by` more; its single indices where blocks would be too short.

    >>> more(3, 32), more(3, 32, 1), more(5, 32)
    (6, 4, 32)
    """
    count = count + by if by else 2 * count
    return count if count * SMALLEST_EDGE <= size else size


def fewer(count: int, size: int, by: int = 0) -> int:
    """Half as many blocks, or `by` fewer; of single indices the smallest blocks there are.

    >>> fewer(6, 32), fewer(6, 32, 1), fewer(32, 32), fewer(1, 32)
    (3, 5, 8, 0)
    """
    if count * SMALLEST_EDGE > size:
        return max(1, size // SMALLEST_EDGE) if count > 1 else 0
    return count - by if by else count // 2


def coarser(grid: Sequence[int], shape: Sequence[int]) -> tuple[int, ...]:
    """Blocks of twice the edges, or a little less; of single indices the smallest blocks there are.

    >>> coarser((5, 30, 1), (48, 30, 3))
    (3, 7, 1)
    """
    single = [count > 1 and count * SMALLEST_EDGE > size for count, size in zip(grid, shape, strict=True)]
    halves = ((count + 1) // 2 for count in grid)
    return tuple(fewer(size, size) if one else half for half, one, size in zip(halves, single, shape, strict=True))


def allowed(count: int, n: int, grid: tuple[int, ...], shape: Sequence[int]) -> bool:
    """Whether axis n may be cut into `count` blocks, the others as they are."""
    if count < grid[n]:
        return count > 0
    long_enough = count * SMALLEST_EDGE <= shape[n] or count == shape[n]
    return count > grid[n] and long_enough and worth_cutting(changed(grid, n, count), shape)


def divisors(number: int) -> list[int]:
    """Whole numbers that divide it, ascending.

    >>> divisors(12)
    [1, 2, 3, 4, 6, 12]
    """
    low = [n for n in range(1, isqrt(number) + 1) if number % n == 0]
    return sorted({*low, *(number // n for n in low)})
