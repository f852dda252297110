"""Elements of a model or an array for the NumPy renderers: each is decoded once, in the domain of the value transform.

Interpolation happens there, as in the shaders, where weights go onto basis rows before the core; `source_values` leads
back. An array, such as the original, has no transform.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import mode_sizes
from ..decode import decode_elements
from ..model import Model
from ..transform import from_json
from .layout import Layout

F32 = NDArray[np.float32]
Index = NDArray[np.intp]


def fetch(source: Any, layout: Layout, indices: Mapping[int, Index]) -> F32:
    """Elements at index arrays that broadcast together, one for each axis that moves; the others stand.

    >>> from hmkcta.axes import name_axes
    >>> from hmkcta.render.layout import lay_out
    >>> table = np.arange(12, dtype=np.float32).reshape(3, 4)
    >>> layout = lay_out(name_axes((3, 4), ["y", "x"]), "generic")
    >>> fetch(table, layout, {0: np.array([[0], [2]]), 1: np.array([1, 3])}).tolist()
    [[1.0, 3.0], [9.0, 11.0]]
    """
    along = [np.asarray(indices.get(axis, stand), np.intp) for axis, stand in enumerate(layout.stands)]
    shape = np.broadcast_shapes(*(index.shape for index in along))
    spread = [np.broadcast_to(index, shape) for index in along]
    if not isinstance(source, Model):
        return np.asarray(source[tuple(spread)], np.float32)
    flat = np.ravel_multi_index([index.reshape(-1) for index in spread], layout.sizes)
    distinct, place = np.unique(flat, return_inverse=True)
    values = _decode(source, [np.asarray(i, np.intp) for i in np.unravel_index(distinct, layout.sizes)])
    return values[place.reshape(shape)]


def source_values(source: Any, values: F32) -> F32:
    """Values of `fetch`, interpolated or not, in the domain of the source."""
    if not isinstance(source, Model):
        return values
    return np.asarray(from_json(source.metadata.transform).inverse(values), np.float32)


def _decode(model: Model, axes: list[Index]) -> F32:
    """Scattered elements by their source axes, before the inverse of the value transform."""
    metadata = model.metadata
    number = {axis.name: n for n, axis in enumerate(metadata.axes)}
    coords = np.zeros((len(axes[0]), len(metadata.organisation)), np.intp)
    for mode, members in enumerate(metadata.organisation):
        for name in members:
            coords[:, mode] = coords[:, mode] * model.shape[number[name]] + axes[number[name]]
    sizes = mode_sizes(metadata.axes, metadata.organisation)
    return np.asarray(decode_elements(model.stages, sizes, coords), np.float32)
