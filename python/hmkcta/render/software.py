"""Whether a software adapter finishes a shader: Mesa's llvmpipe ends loops after 65,535 turns, without a word.

The count runs over all loops of an invocation together, so that interpolation over many clusters passes it and the
picture would be wrong. GPUs and SwiftShader have no such limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import prod

import numpy as np
from numpy.typing import NDArray

from ..model import Model
from ..packed import PackedLevel, level_ends
from .cell_loops import Cells, registered_stages
from .prelude import Options, axis_places, channel_axis, colour_mode
from .single_cell import is_single
from .tree import tree_of

#: A little below the limit, for the loops outside the decoder.
MOST_TURNS = 60_000


def loop_turns(model: Model, picks: Sequence[int], level: int, contracted: Sequence[int] = ()) -> int:
    """A bound of the turns of all loops of `decode_picked` with these `picks` for each source axis.

    `contracted` are the modes that have been summed into the cores.

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
    channel = channel_axis(model.metadata)
    coloured = channel is not None and picks[channel] == 3
    colour, _ = colour_mode(model.metadata, Options(channels=3 if coloured else 1, contracted=tuple(contracted)))
    tree = tree_of(model.metadata, model.stages)
    if is_single(tree):
        return _single(model, rows, contracted)
    registered = registered_stages(tree, rows, colour, contracted)
    parts = [1] * order
    turns = 0
    stages = level_ends(model.stages)[level - 1]
    for number, (packed, bounds) in enumerate(zip(model.stages[:stages], model.metadata.stages, strict=False)):
        if not all(bounds.clusters):  # only empty nodes
            break
        groups = [min(r, p) for r, p in zip(rows, parts, strict=True)]
        mixture = [max(1, k) for k in bounds.mixture]
        clusters = [min(r * k, g * c) for r, g, k, c in zip(rows, groups, mixture, bounds.clusters, strict=True)]
        if number in registered:
            turns += _registered(rows, groups, clusters, mixture, registered[number])
        elif not bounds.is_cut:
            together = _together(packed, mixture, rows, groups, prod(clusters))
            turns += min(together, prod(groups) * _worst_node(packed, rows))
        turns += prod(groups) * 8 * order
        parts = [p * c for p, c in zip(parts, bounds.clusters, strict=True)]
    return turns


def _single(model: Model, rows: Sequence[int], contracted: Sequence[int]) -> int:
    """Turns of `single_cell.py`'s loops: over the rows of every mode, their numbers, and the core."""
    kept = [n for n in range(len(rows)) if n not in contracted]
    bounds = model.bounds[0]
    counts = [bounds.ranks[n] if bounds.mixture[n] else rows[n] for n in kept]
    weights = sum(rows[n] * (2 + bounds.ranks[n]) for n in kept if bounds.mixture[n])
    return weights + 2 * sum(prod(counts[: k + 1]) for k in range(len(counts)))


def _registered(rows: Sequence[int], groups: Sequence[int], clusters: Sequence[int], mixture: Sequence[int],
                generated: Cells) -> int:
    """Turns of `cells.py`'s loops in all nodes of a level: rows, clusters mode by mode, members of cells, cores.

    `clusters` are those of each mode that rows are members of, added up over the parts.
    """
    order = range(len(rows))
    cells = prod(clusters)
    opened = prod(groups) * sum(r * (1 + k) for r, k in zip(rows, mixture, strict=True))
    looped = [0 if generated.beside(n) else rows[n] for n in order]
    loops = sum(prod(clusters[: n + 1]) * prod(groups[n + 1 :]) * (1 + looped[n]) for n in order)
    members = sum(looped[n] * mixture[n] * cells // clusters[n] for n in order)
    return opened + loops + members + cells * generated.turns


def _entries(level: PackedLevel, rows: Sequence[int]) -> NDArray[np.int64]:
    """Weights of each node and mode, [S, N]: an undecomposed mode brings its rows, not all of its core."""
    return np.where(level.undecomposed, np.array(rows, np.int64), level.shape[:, 2])


def _together(level: PackedLevel, mixture: Sequence[int], rows: Sequence[int], groups: Sequence[int], cells: int
              ) -> int:
    """Turns of `picked_value` in all nodes of a level."""
    entries = _entries(level, rows).max(axis=0, initial=0).tolist()
    contraction = sum(prod(entries[: n + 1]) for n in range(len(rows)))
    shared = [-(-r // g) for r, g in zip(rows, groups, strict=True)]
    weighing = sum(r * k * (2 + rank) for r, k, rank in zip(shared, mixture, entries, strict=True))
    return cells * (contraction + weighing + 6 * len(rows))


def _worst_node(level: PackedLevel, rows: Sequence[int]) -> int:
    """A bound of the turns in any one node of a level, if all rows were in it."""
    clusters, mixture, _ = level.shape.astype(np.int64).transpose(1, 0, 2)
    mixture, ranks = np.maximum(mixture, 1), _entries(level, rows)
    cells = np.minimum(np.array(rows) * mixture, clusters).prod(axis=1)
    weighing = (np.array(rows) * mixture * (2 + ranks)).sum(axis=1)
    return int((cells * (ranks.cumprod(axis=1).sum(axis=1) + weighing + 6 * len(rows))).max(initial=0))
