"""Whether a software adapter finishes a shader: Mesa's llvmpipe ends loops after 65,535 turns, without a word.

The count runs over all loops of an invocation together, so that interpolation over many clusters passes it and the
picture would be wrong. GPUs and SwiftShader have no such limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import prod

import numpy as np

from ..model import Model
from ..packed import PackedLevel
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
    for packed, bounds in zip(model.levels[:level], model.bounds, strict=False):
        if not all(bounds.clusters):  # only empty nodes
            break
        groups = [min(r, p) for r, p in zip(rows, parts, strict=True)]
        modes_of = zip(rows, groups, bounds.mixture, bounds.clusters, strict=True)
        cells = prod(min(r * k, g * c) for r, g, k, c in modes_of)
        # An undecomposed mode brings its rows into the contraction, not all of its core.
        undecomposed = model.metadata.undecomposed
        entries = [rows[n] if n in undecomposed else rank for n, rank in enumerate(bounds.ranks)]
        contraction = sum(prod(entries[: n + 1]) for n in range(order))
        shared = [-(-r // g) for r, g in zip(rows, groups, strict=True)]
        weighing = sum(r * k * (2 + rank) for r, k, rank in zip(shared, bounds.mixture, entries, strict=True))
        together = cells * (contraction + weighing + 6 * order)
        turns += min(together, prod(groups) * _worst_node(packed, rows, undecomposed)) + prod(groups) * 8 * order
        parts = [p * c for p, c in zip(parts, bounds.clusters, strict=True)]
    return turns


def _worst_node(level: PackedLevel, rows: Sequence[int], undecomposed: Sequence[int]) -> int:
    """A bound of the turns in any one node of a level, if all rows were in it."""
    clusters, mixture, ranks = level.shape.astype(np.int64).transpose(1, 0, 2)
    ranks[:, list(undecomposed)] = np.array(rows, np.int64)[list(undecomposed)]
    cells = np.minimum(np.array(rows) * mixture, clusters).prod(axis=1)
    weighing = (np.array(rows) * mixture * (2 + ranks)).sum(axis=1)
    return int((cells * (ranks.cumprod(axis=1).sum(axis=1) + weighing + 6 * len(rows))).max(initial=0))
