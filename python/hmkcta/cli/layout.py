"""How the array of a model is cut into blocks, and which modes these leave undecomposed: for programs and people."""

from __future__ import annotations

from collections import Counter
from math import prod
from typing import Any

import numpy as np

from ..axes import format_organisation
from ..model import Model
from ..packed import PackedLevel

#: So many sets of undecomposed modes are named for people.
SHOWN = 4


def layout_of(model: Model) -> list[dict[str, Any]]:
    """Of every level how many parts each mode was cut into before it, in which of them rows are clusters that may lie
    anywhere, and how many nodes leave which modes undecomposed.

    >>> from hmkcta._example import example_level, example_metadata
    >>> layout_of(Model(example_metadata(), [example_level()]))
    [{'blocks': [1, 1], 'clustered': [], 'undecomposed': [{'modes': [], 'nodes': 1}]}]
    """
    found: list[dict[str, Any]] = []
    names = _names(model)
    cuts, clustered = np.ones(len(names), np.int64), list[str]()
    for stage in model.stages:
        if stage.is_cut:
            cuts = cuts * stage.shape[:, 0].max(axis=0)
            clustered += [name for n, name in enumerate(names) if _is_clustered(model, stage, n)]
            continue
        found.append({"blocks": cuts.tolist(), "clustered": clustered, "undecomposed": _undecomposed(stage, names)})
        cuts, clustered = np.ones_like(cuts), []
    return found


def _is_clustered(model: Model, stage: PackedLevel, n: int) -> bool:
    """Whether the root cuts a mode into other parts than segments of its axes."""
    part, sizes = stage.part[n], {axis.name: axis.size for axis in model.metadata.axes}
    extents = [sizes[name] for name in model.metadata.organisation[n]]
    if part is None or stage.nodes > 1 or stage.shape[0, 0, n] < 2:
        return False
    # The number of a segment is a sum of what each axis adds, and does not fall along any.
    numbers = part.astype(np.int64).reshape(extents)
    lines = [numbers[(*(0,) * axis, slice(None), *(0,) * (len(extents) - axis - 1))] for axis in range(len(extents))]
    sums = sum(line.reshape([-1 if a == axis else 1 for a in range(len(extents))]) for axis, line in enumerate(lines))
    return not np.array_equal(numbers, sums) or any(bool((np.diff(line) < 0).any()) for line in lines)


def _names(model: Model) -> list[str]:
    """The modes as an organisation has them."""
    return [format_organisation((mode,)) for mode in model.metadata.organisation]


def _undecomposed(level: PackedLevel, names: list[str]) -> list[dict[str, Any]]:
    modes: list[list[bool]] = level.undecomposed[level.has_cells].tolist()
    sets = Counter(tuple(name for name, whole in zip(names, of_node, strict=True) if whole) for of_node in modes)
    return [{"modes": list(named), "nodes": count}
            for named, count in sorted(sets.items(), key=lambda item: (-item[1], item[0]))]


def layout_lines(model: Model) -> list[str]:
    """A line for each level that has blocks or undecomposed modes: what a plan would not tell of it.

    >>> from hmkcta._example import example_level, example_metadata
    >>> layout_lines(Model(example_metadata(), [example_level()]))
    []
    """
    names, layouts = _names(model), layout_of(model)
    lines: list[str] = []
    for number, layout in enumerate(layouts, start=1):
        blocks, sets = layout["blocks"], layout["undecomposed"]
        if prod(blocks) == 1 and not any(found["modes"] for found in sets):
            continue
        of_level = f"level {number}: " if len(layouts) > 1 else ""
        rows = layout["clustered"]
        parts = [f"{count} clusters of {name}" for count, name in zip(blocks, names, strict=True) if name in rows]
        grid = [1 if name in rows else count for count, name in zip(blocks, names, strict=True)]
        parts += [blocks_text(grid, names)] if prod(grid) > 1 or not rows else []
        lines.append(f"{of_level}{', '.join(parts)}; undecomposed: {_sets_text(sets)}")
    return lines


def blocks_text(counts: list[int], names: list[str]) -> str:
    """Blocks along modes or axes.

    >>> blocks_text([16, 1, 18], ["light+rgb", "view", "x"]), blocks_text([1, 1], ["y", "x"])
    ('16 x 18 blocks of light+rgb, x', 'one block')
    """
    cut = [(count, name) for count, name in zip(counts, names, strict=True) if count > 1]
    if not cut:
        return "one block"
    return f"{' x '.join(str(count) for count, _ in cut)} blocks of {', '.join(name for _, name in cut)}"


def _sets_text(sets: list[dict[str, Any]]) -> str:
    """Sets of undecomposed modes, the most used first."""
    if all(not found["modes"] for found in sets):
        return "no mode"
    named = [" and ".join(found["modes"]) or "no mode" for found in sets[:SHOWN]]
    if len(sets) == 1:
        return named[0]
    told = [f"{name} in {found['nodes']}" for name, found in zip(named, sets, strict=False)]
    return ", ".join([*told, *(["other modes in the rest"] if len(sets) > SHOWN else [])])
