"""Measure a fitted hierarchy whose tensor memory does not hold, in one pass over the source at most.

Every block of the tensor loses level after level; where a node was subdivided, so is its part of the block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

import numpy as np

from .. import backends as kernels
from ..arrays import F32
from ..measure import Sums
from ..metrics import in_float64, snr_db, squared_norm
from ..packed import LevelQuality
from ..streaming.pieces import Norms, Rows, places_of, split
from ..streaming.source import Source
from ..streaming.streamed import Streamed
from ..support.executors import in_order
from ..support.progress import Progress
from ..transform import Transform
from .hierarchy import Hierarchy, Node

#: Elements of a slab: many, so that the parts of small nodes in it are not tiny; some 12 bytes each. And how many slabs
#: memory is shared out to: not one for each thread, as sums of slabs would differ in their last digits.
SLAB, AT_ONCE = 1 << 23, 4


@dataclass(frozen=True, eq=False)
class _Errors:
    """What is summed up over a block: in the domain of the source values, and in that of the value transform."""

    transform: Transform
    unit: float
    plain: Sums
    transformed: Sums

    def add_values(self, values: F32) -> None:
        """Values of the block."""
        self.transformed.add(None, squared_norm(values) * self.unit**2, count=values.size)
        if not self.transform.is_identity:
            for wide in in_float64(values):
                self.plain.add_values(np.asarray(self.transform.inverse(wide * self.unit), np.float64))

    def add(self, levels: range, values: F32, left: F32) -> None:
        """What some levels leave of values."""
        noise, most = squared_norm(left) * self.unit**2, max(float(left.max()), -float(left.min())) * self.unit
        for level in levels:
            self.transformed.add(level, noise, most)
        if not self.transform.is_identity:
            for wide, error in zip(in_float64(values), in_float64(left), strict=True):
                change = self.transform.inverse(wide * self.unit) - self.transform.inverse((wide - error) * self.unit)
                for level in levels:
                    self.plain.add_error(level, np.asarray(change, np.float64))

    def below(self, node: Node, depth: int, rows: Rows, values: F32, left: F32) -> None:
        """Take the node's model and all below it from `left`, what is left of values above it; rows are the node's."""
        if node.cells is not None:
            kernels.accumulate(node.cells.part(rows), left, -1.0)
        deepest = self.transformed.levels
        if node.parts is None or not node.children:
            self.add(range(depth, deepest), values, left)
            return
        self.add(range(depth, depth + 1), values, left)
        assert node.cells is not None
        counts = node.cells.spec.clusters
        places = [places_of(part) for part in node.parts]
        # Without a value transform nobody looks at the values again.
        kept = split(values, rows, node.parts) if not self.transform.is_identity else None
        for child, sub, own in split(left, rows, node.parts):
            old = sub if kept is None else next(kept)[1]
            below = node.children[int(np.ravel_multi_index(child, counts))]
            sub = np.array(sub, order="C")
            self.below(below, depth + 1, tuple(p[r] for p, r in zip(places, own, strict=True)), old, sub)


def _as_seen(norms: Sequence[Norms], source: Source) -> tuple[LevelQuality, ...]:
    """Quality of what levels left when they were subtracted, from the last of which nothing has changed."""
    signal, *left = norms
    return tuple(
        LevelQuality(snr_db(signal.squares, each.squares), (each.squares / prod(source.shape)) ** 0.5 * source.unit,
                     each.largest * source.unit)
        for each in left
    )  # fmt: skip


def slab_within(limit: int) -> int:
    """Elements of a slab, where `limit` of them may be worked on at once."""
    return min(SLAB, max(SLAB // 8, limit // (4 * AT_ONCE)))


def measure_streamed(
    tree: Hierarchy, residual: Streamed, progress: Progress
) -> tuple[tuple[LevelQuality, ...], tuple[LevelQuality, ...]]:
    """As `measure_both`, of the stored numbers of every node against the source.

    The source is read once more, unless all levels were seen to leave what they do when they were fitted to pieces.
    """
    source, levels, root = residual.source, len(tree.levels), tree.levels[0][0]
    if source.value_transform.is_identity and len(residual.residual_norms) == 1 + levels:
        seen = _as_seen(residual.residual_norms, source)
        return seen, seen
    total = Sums(levels), Sums(levels)

    def measured(part: tuple[slice, ...]) -> _Errors:
        rows, values = source.block(residual.organisation, part)
        errors = _Errors(source.value_transform, source.unit, Sums(levels), Sums(levels))
        errors.add_values(values)
        left = values if errors.transform.is_identity else values.copy()
        errors.below(root, 0, tuple(rows), values, left)
        return errors

    slab = slab_within(residual.limit)
    parts = source.parts(slab)
    for number, errors in enumerate(in_order(measured, parts, residual.workers(4 * slab)), start=1):
        total[0].merge(errors.plain)
        total[1].merge(errors.transformed)
        progress("measuring", number / len(parts))
    transformed = total[1].quality()
    return (transformed if source.value_transform.is_identity else total[0].quality()), transformed
