"""What a plan's numbers take, counted as the paper's tables do (`docs/format.md`, section 4)."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod

from .plan import LevelSpec


def paper_bytes(levels: Sequence[LevelSpec], sizes: Sequence[int]) -> int:
    """Bytes of all cores and bases, 2 a number and nothing else, where no node is clamped and none is empty:
    ``2 sum_l [S_l PC prod R_n + sum_n rows_n K_n PC_-n R_n]``.

    Every cell of a level becomes a node of the next, so a level has ``S_l = prod PC`` nodes, which own each row of mode
    n ``prod PC_-n`` times, both products over the levels above. An undecomposed mode has its size for R and no basis.

    Args:
        levels: of a plan.
        sizes: of the modes; the paper's colour is folded into the light mode.

    >>> from hmkcta.plan import parse_plan
    >>> modes = (("light",), ("view",), ("x",), ("y",))
    >>> wh4 = parse_plan("R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2 / R=2,2,3,3 C=3,3,4,4 K=2", modes)
    >>> round(paper_bytes(wh4.levels, (174, 58, 400, 380)) / 2**20, 2)
    22.29
    """
    numbers, nodes, owners = 0, 1, [1] * len(sizes)
    for level in levels:
        ranks = [size if rank is None else rank for rank, size in zip(level.ranks, sizes, strict=True)]
        others = [level.cells // clusters for clusters in level.clusters]
        numbers += nodes * level.cells * prod(ranks)
        numbers += sum(
            size * owner * mixture * other * rank
            for size, owner, mixture, other, rank in zip(sizes, owners, level.mixture, others, level.ranks, strict=True)
            if rank is not None
        )
        nodes *= level.cells
        owners = [owner * other for owner, other in zip(owners, others, strict=True)]
    return 2 * numbers
