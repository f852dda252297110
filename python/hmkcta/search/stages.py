"""Coded blocks as the stages of a model: a node that the grid cuts, where there are several blocks, and the blocks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..hmkfile import stage_arrays
from ..packed import PackedLevel
from ..support.extension import native
from .coded import CodedBlocks, LayoutCoder


def stages_of(coder: LayoutCoder, levels: Sequence[CodedBlocks], scale: float = 1.0) -> tuple[PackedLevel, ...]:
    """The arrays of every stage, as a reader widens them from the file.

    Args:
        coder: of the layout.
        levels: its blocks, level by level.
        scale: power of two that values were divided by before they were coded.
    """
    stages: list[PackedLevel] = []
    coders = coder.stages(*levels)
    steps = [*[None] * (len(coders) - len(levels)), *(float(np.float32(level.step * scale)) for level in levels)]
    for (stage, places), after, step in zip(coders, [*(at for _, at in coders[1:]), None], steps, strict=True):
        stages.append(widened(stage, places, after, step))
    return tuple(stages)


def widened(stage: dict[str, Any], places: dict[str, Any], after: dict[str, Any] | None, step: float | None
            ) -> PackedLevel:
    """A stage as a reader widens it from the file; its step is None where it has no numbers."""
    order = len(stage["cluster"])
    runs = [(np.frombuffer(data, np.uint8), counts) for data, counts in native.encode_stage(stage, places)]
    shape = stage["shape"].reshape(-1, 3, order)
    following = (0, [0] * order) if after is None else (len(after["rows"]) // order, _sums(after["rows"], order))
    header = {"last": after is None, "step": step, "raw": False, "largest": shape.max(axis=0).reshape(-1),
              "next": following}
    return stage_arrays(native.decode_stage(header, places, runs), places, step, last=after is None)


def _sums(rows: Any, order: int) -> Sequence[int]:
    return [int(total) for total in rows.reshape(-1, order).astype(np.int64).sum(axis=0)]
