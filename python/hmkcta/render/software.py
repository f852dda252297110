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
from .cell_loops import Cells, registered_levels
from .core_sums import uniform_levels
from .prelude import Options, axis_places, channel_axis, colour_mode
from .single_cell import is_single

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
    uniform = uniform_levels(model.metadata, model.levels)
    if is_single(model.metadata, uniform):
        return _single(model, rows, contracted)
    registered = registered_levels(model.metadata, rows, colour, contracted, uniform)
    parts = [1] * order
    turns = 0
    for number, (packed, bounds) in enumerate(zip(model.levels[:level], model.bounds, strict=False)):
        if not all(bounds.clusters):  # only empty nodes
            break
        groups = [min(r, p) for r, p in zip(rows, parts, strict=True)]
        clusters = [min(r * k, g * c) for r, g, k, c in zip(rows, groups, bounds.mixture, bounds.clusters, strict=True)]
        if number in registered:
            turns += _registered(rows, groups, clusters, bounds.mixture, registered[number])
        else:
            together = _together(model, number, rows, groups, prod(clusters))
            turns += min(together, prod(groups) * _worst_node(packed, rows, model.metadata.undecomposed))
        turns += prod(groups) * 8 * order
        parts = [p * c for p, c in zip(parts, bounds.clusters, strict=True)]
    return turns


def _single(model: Model, rows: Sequence[int], contracted: Sequence[int]) -> int:
    """Turns of `single_cell.py`'s loops: over the rows of every mode, their numbers, and the core."""
    kept = [n for n in range(len(rows)) if n not in contracted]
    ranks = model.bounds[0].ranks
    counts = [rows[n] if n in model.metadata.undecomposed else ranks[n] for n in kept]
    weights = sum(rows[n] * (2 + ranks[n]) for n in kept if n not in model.metadata.undecomposed)
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


def _together(model: Model, level: int, rows: Sequence[int], groups: Sequence[int], cells: int) -> int:
    """Turns of `picked_value` in all nodes of a level."""
    bounds = model.bounds[level]
    # An undecomposed mode brings its rows into the contraction, not all of its core.
    entries = [rows[n] if n in model.metadata.undecomposed else rank for n, rank in enumerate(bounds.ranks)]
    contraction = sum(prod(entries[: n + 1]) for n in range(len(rows)))
    shared = [-(-r // g) for r, g in zip(rows, groups, strict=True)]
    weighing = sum(r * k * (2 + rank) for r, k, rank in zip(shared, bounds.mixture, entries, strict=True))
    return cells * (contraction + weighing + 6 * len(rows))


def _worst_node(level: PackedLevel, rows: Sequence[int], undecomposed: Sequence[int]) -> int:
    """A bound of the turns in any one node of a level, if all rows were in it."""
    clusters, mixture, ranks = level.shape.astype(np.int64).transpose(1, 0, 2)
    ranks[:, list(undecomposed)] = np.array(rows, np.int64)[list(undecomposed)]
    cells = np.minimum(np.array(rows) * mixture, clusters).prod(axis=1)
    weighing = (np.array(rows) * mixture * (2 + ranks)).sum(axis=1)
    return int((cells * (ranks.cumprod(axis=1).sum(axis=1) + weighing + 6 * len(rows))).max(initial=0))
