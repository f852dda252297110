"""Whether a software adapter finishes a shader: Mesa's llvmpipe ends loops after 65,535 turns, without a word.

The count runs over all loops of an invocation together, so that interpolation over many clusters passes it and the
picture would be wrong. GPUs and SwiftShader have no such limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import prod

from ..model import Model
from .prelude import axis_places

#: A little below the limit, for the loops outside the decoder.
MOST_TURNS = 60_000


def loop_turns(model: Model, picks: Sequence[int], level: int) -> int:
    """A bound of the turns of all loops of `decode_picked` with so many picks for each source axis.

    Rows of a mode spread over the parts of the levels above; in a node, a mode brings at most K clusters a row and at
    most C in all, and each combination of the modes' clusters is a cell to contract.

    >>> from hmkcta import Model
    >>> from hmkcta._example import example_level, example_metadata
    >>> loop_turns(Model(example_metadata(), [example_level()]), (1, 1), 1) < MOST_TURNS
    True
    """
    modes, _ = axis_places(model.metadata)
    order = len(model.metadata.organisation)
    rows = [prod(count for count, mode in zip(picks, modes, strict=True) if mode == n) for n in range(order)]
    parts = [1] * order
    turns = 0
    for bounds in model.bounds[:level]:
        groups = [min(r, p) for r, p in zip(rows, parts, strict=True)]
        modes_of = zip(rows, groups, bounds.mixture, bounds.clusters, strict=True)
        cells = prod(min(r * k, g * c) for r, g, k, c in modes_of)
        contraction = sum(prod(bounds.ranks[: n + 1]) for n in range(order))
        shared = [-(-r // g) for r, g in zip(rows, groups, strict=True)]
        weighing = sum(r * k * (2 + rank) for r, k, rank in zip(shared, bounds.mixture, bounds.ranks, strict=True))
        turns += cells * (contraction + weighing) + prod(groups) * 8 * order
        parts = [p * c for p, c in zip(parts, bounds.clusters, strict=True)]
    return turns
