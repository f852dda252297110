"""Grids that cut axes into blocks: those that a search begins with, and which of their neighbours are allowed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from math import prod

#: Block edges never fall below this, nor elements of a block below so many times the sum of its edges.
SMALLEST_EDGE, THIN = 4, 4
#: Most blocks.
MOST_BLOCKS = 4096
#: Blocks along the longest axis, for the grids of which one is then climbed on from; every second where two are cut.
COUNTS = (1, 2, 3, 4, 6, 8, 12)


def few_grids(shape: Sequence[int]) -> list[tuple[int, ...]]:
    """No blocks, and edges of about 64 and 32 along axes longer than 48."""
    grids = [tuple(round(size / edge) if size > 48 else 1 for size in shape) for edge in (64, 32)]
    return list(dict.fromkeys([(1,) * len(shape), *(grid for grid in grids if worth_cutting(grid, shape))]))


def worth_cutting(grid: Sequence[int], shape: Sequence[int]) -> bool:
    """Whether there are not too many blocks, nor such thin ones that one vector for each axis is most of a block."""
    edges = [size / count for size, count in zip(shape, grid, strict=True) if size > 1]
    return prod(grid) <= MOST_BLOCKS and prod(edges) >= THIN * sum(edges)


def many_grids(shape: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """The three longest axes cut alike, by one common edge, or two that are longer; those of middle length in two."""
    longest = sorted(range(len(shape)), key=lambda n: -shape[n])[:3]
    long = [n for n in longest if shape[n] >= 24]
    middle = [n for n in range(len(shape)) if n not in long and shape[n] >= 24]
    two = len(long) == 3 and shape[long[2]] < shape[long[1]]
    edges = [[shape[n] / count for n in long[:1] for count in counts] for counts in (COUNTS, COUNTS[1::2] * two)]
    seen = {(1,) * len(shape)}
    yield (1,) * len(shape)
    alike = [(long, edge) for edge in edges[0]] + [(long[:2], edge) for edge in edges[1]]
    for (few, edge), cuts in product(alike, product((1, 2), repeat=len(middle))):
        grid = [1] * len(shape)
        for n in few:
            grid[n] = max(1, round(shape[n] / edge))
        for n, count in zip(middle, cuts, strict=True):
            grid[n] = count
        if tuple(grid) not in seen and edge >= SMALLEST_EDGE and worth_cutting(grid, shape):
            seen.add(tuple(grid))
            yield tuple(grid)


def changed(grid: tuple[int, ...], n: int, count: int) -> tuple[int, ...]:
    return (*grid[:n], count, *grid[n + 1 :])


def allowed(count: int, n: int, grid: tuple[int, ...], shape: Sequence[int]) -> bool:
    """Whether axis n may be cut into so many blocks, the others as they are."""
    if count < grid[n]:
        return count > 0
    return count <= shape[n] / SMALLEST_EDGE and worth_cutting(changed(grid, n, count), shape)
