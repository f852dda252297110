"""A box of elements at a time between frames: what a light field or a volume shows while its time stays.

The twin of `grid.wgsl`. Each slice of the box is an index of every axis; x, y and time move.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .elements import fetch, source_values
from .layout import Layout, time_steps

F32 = NDArray[np.float32]
Index = NDArray[np.intp]

VALUES = 1 << 20  # decoded together: bounds memory


@dataclass(frozen=True, eq=False)
class Grid:
    """Which elements: `slices` ``[depth, axes]``, two frames and their weights; rows and columns of every slice."""

    layout: Layout
    slices: Index
    frames: tuple[int, int]
    weights: tuple[float, float]

    @property
    def shape(self) -> tuple[int, int, int]:
        """Slices, rows, columns."""
        rows, columns = (self.layout.sizes[axis] for axis in self.layout.space[-2:])
        return len(self.slices), rows, columns


def grid_at(layout: Layout, slices: Index, time: float | None) -> Grid:
    """The grid at a time; data without a time axis has one frame.

    Raises:
        HmkctaError: the time lies outside the data.
    """
    count = 1 if layout.time is None else layout.sizes[layout.time]
    frames, weights = time_steps(time, count)
    return Grid(layout, slices, frames, weights)


def decode_grid(source: Any, grid: Grid) -> F32:
    """The box ``[depth, rows, columns]`` of a model or an array."""
    depth, rows, columns = grid.shape
    y_axis, x_axis = grid.layout.space[-2:]
    picture = np.empty((depth, rows, columns), np.float32)
    steps = max(1, VALUES // (rows * columns))
    for start in range(0, depth, steps):
        part = grid.slices[start : start + steps]
        indices = {axis: part[:, axis][:, None, None] for axis in range(len(grid.layout.sizes))}
        indices[y_axis] = np.arange(rows)[None, :, None]
        indices[x_axis] = np.arange(columns)[None, None, :]
        total = np.zeros((len(part), rows, columns), np.float32)
        for frame, weight in zip(grid.frames, grid.weights, strict=True):
            if weight:
                if grid.layout.time is not None:
                    indices[grid.layout.time] = np.array(frame)
                total += np.float32(weight) * fetch(source, grid.layout, indices)
        picture[start : start + steps] = source_values(source, total)
    return picture


def volume_slices(layout: Layout) -> Index:
    """A slice for each z."""
    slices = np.tile(np.array(layout.stands, np.intp), (layout.sizes[layout.space[0]], 1))
    slices[:, layout.space[0]] = np.arange(len(slices))
    return slices
