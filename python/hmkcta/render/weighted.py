"""Weighted sums of elements in NumPy: the readable twin of `shaders/weighted.wgsl`, element by element.

Interpolation happens in the domain of the value transform; the inverse comes last, as in the shaders.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import mode_sizes
from ..decode import decode_elements
from ..errors import invalid
from ..model import Model
from ..transform import from_json
from .prelude import axis_places

Picks = tuple[NDArray[Any], NDArray[Any]]


def decode_picked(model: Model, picks: Sequence[Picks], level: int | None = None) -> NDArray[np.float32]:
    """Sums over all combinations of one picked index an axis: the product of their weights times the element.

    Args:
        model: what to decode.
        picks: for each source axis the indices, [P, k], and their weights, [P, k] or [P, k, 3] (red, green, blue); k
            may differ from axis to axis, and P be 1 where all sums share an axis's picks.
        level: the last level to add, all by default.

    Returns:
        Source values, [P], or [P, 3] if any weights have three channels.

    Raises:
        HmkctaError: not one entry an axis, indices or a level out of range.

    >>> from hmkcta._example import example_level, example_metadata
    >>> model = Model(example_metadata(), [example_level()])
    >>> half = np.array([[0.5, 0.5]])
    >>> decode_picked(model, [(np.array([[0, 1]]), half), (np.array([[2]]), np.ones((1, 1)))])
    array([4.5], dtype=float32)
    """
    if len(picks) != len(model.shape):
        raise invalid("picks", "picks", f"{len(picks)} entries", f"{len(model.shape)}, one a source axis")
    metadata = model.metadata
    modes, strides = axis_places(metadata)
    sizes = mode_sizes(metadata.axes, metadata.organisation)
    points = max(len(index) for index, _ in picks)
    channels = 3 if any(np.ndim(weight) == 3 for _, weight in picks) else 1
    total = np.zeros((points, channels), np.float32)
    for choice in product(*(range(index.shape[1]) for index, _ in picks)):
        rows = np.zeros((points, len(sizes)), np.int64)
        weight = np.ones((points, channels), np.float32)
        for axis, ((index, weights), j) in enumerate(zip(picks, choice, strict=True)):
            rows[:, modes[axis]] += np.asarray(index[:, j], np.int64) * strides[axis]
            weight *= np.asarray(weights[:, j], np.float32).reshape(len(weights), -1)
        used = np.flatnonzero(weight.any(axis=1))
        if used.size:
            total[used] += weight[used] * decode_elements(model.stages, sizes, rows[used], level)[:, None]
    values = from_json(metadata.transform).inverse(total).astype(np.float32, copy=False)
    return values if channels == 3 else values[:, 0]
