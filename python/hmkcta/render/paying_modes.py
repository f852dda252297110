"""Which modes it pays to contract: that of the colours, and that of the lights where all pixels have the same light.

Contracted modes cost nothing at a pixel, but cores in which the colours' mode is contracted hold colours, so that every
multiply-add of the rest counts three times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import prod

from ..model import Model
from .frame_contraction import contractable
from .prelude import Options, colour_mode, rooms
from .tree import Tree, tree_of

#: By how much the loops of models of several cells that keep an undecomposed mode are slower than others.
_GENERAL = 3


def paying_modes(model: Model, options: Options, still: Sequence[int], fixed: Sequence[int], channel: int | None
                 ) -> tuple[int, ...]:
    """The modes to contract that make a pixel cost the least.

    Args:
        model: what is rendered.
        options: of the shader, its contracted modes aside.
        still: axes that stand still in a frame.
        fixed: those of the lights, if these are the same for all pixels.
        channel: the axis of the colours, which can be contracted where all of them are wanted.

    >>> from hmkcta import compress, synthetic
    >>> data = synthetic.material(lights=9, views=4, size=8)
    >>> model = compress(data.values, "R=9,4,4", axes=data.axes, organisation="light, view+rgb, y+x")
    >>> options = Options((3, 3, 2, 2, 3), 3)
    >>> paying_modes(model, options, (), (), 4), paying_modes(model, options, (), (0,), 4)
    ((), (0,))
    """
    colours = [] if channel is None or options.channels == 1 else [channel]
    tried = [contractable(model, [*still, *more], 3 if colours and colours[0] in more else 1)
             for more in ([], colours, fixed, [*fixed, *colours])]
    tree = tree_of(model.metadata, model.stages)
    return min(tried, key=lambda modes: pixel_cost(tree, replace(options, contracted=modes)))


def pixel_cost(tree: Tree, options: Options) -> int:
    """What one weighted sum costs at most, in all cells that its rows can be members of.

    A multiply-add counts 1, a word read 2, for reading is what decoders wait for.
    """
    stages, room, (colour, tinted) = tree.metadata.stages, rooms(tree.metadata, options), colour_mode(
        tree.metadata, options)
    kept = [n for n in range(len(room)) if n not in options.contracted]
    parts, total = [1] * len(room), 0
    for bounds in stages:
        parts = [part * c for part, c in zip(parts, bounds.clusters, strict=True)]
        if bounds.is_cut:
            continue
        cells = prod(min(rows * max(1, k), part) for rows, k, part in zip(room, bounds.mixture, parts, strict=True))
        basis = [n for n in kept if bounds.mixture[n]]
        counts = [tree.expected(bounds, n, rows) for n, rows in enumerate(room)]
        nest = [counts[n] for n in sorted(kept, key=lambda n: n != colour)]
        lanes = [3 if tinted or (colour in kept and not k) else 1 for k in range(len(nest))]
        core = sum(lane * prod(nest[: k + 1]) for k, lane in enumerate(lanes))
        halves = prod(nest) * (6 if tinted else 2 if options.contracted else 1)
        rows = sum(room[n] * (counts[n] + 2 * -(-counts[n] // 2)) for n in basis)
        total += cells * (core + halves + rows)
    one_cell = len(stages) == 1 and prod(parts) == 1
    general = not one_cell and any(n in tree.undecomposed or n in tree.mixed for n in kept)
    return total * (_GENERAL if general else 1)
