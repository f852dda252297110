"""Host of `grid.wgsl`: a box of decoded elements as a 3D texture, kept as long as nothing it depends on changes."""

from __future__ import annotations

from collections import OrderedDict
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError, Kind
from ..model import Model
from .device import Device
from .frame_contraction import contractable
from .gpu_pass import ComputePass, Slot, out_texture, tiles
from .grid import Grid
from .layout import Layout
from .prelude import NO_AXIS, Options, compose_picked
from .software import loop_turns
from .upload import DecoderBuffers

FRAME = np.dtype([
    ("width", "u4"), ("height", "u4"), ("depth", "u4"), ("first", "u4"),
    ("x_axis", "u4"), ("y_axis", "u4"), ("time_axis", "u4"), ("unused", "u4"),
    ("x_first", "u4"), ("y_first", "u4"), ("x_step", "u4"), ("y_step", "u4"),
    ("time", "u4", 4), ("time_weight", "f4", 4),
])
SLOTS = (Slot("uniform"), Slot("storage"), Slot("out", "3d", "r32float"))
ELEMENTS = 1 << 22  # decoded by one dispatch, so that none takes long enough for a driver to give up on it
KEPT = 2  # boxes kept: two levels, when they are compared


@final
class GpuGrid:
    """Decodes boxes of one model."""

    def __init__(self, device: Device, model: Model, layout: Layout) -> None:
        picks = [1] * len(layout.sizes)
        if layout.time is not None:
            picks[layout.time] = 2
        self._device = device
        self._model = model
        moving = (*layout.views, *layout.space, layout.channel)
        self._still = [axis for axis in range(len(layout.sizes)) if axis not in moving]
        contracted = contractable(model, self._still)
        self._buffers = DecoderBuffers(device, model, Options(picks=tuple(picks), contracted=contracted))
        self._kept: OrderedDict[Any, Any] = OrderedDict()

    def texture(self, grid: Grid, level: int | None) -> Any:
        """The box as a texture r32float, slices along its z.

        Raises:
            HmkctaError: a side is longer than a 3D texture's.
        """
        key = (grid.slices.tobytes(), grid.frames, grid.weights, level)
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        depth, rows, columns = grid.shape
        most = self._device.limits.get("max-texture-dimension-3d", 2048)
        if max(grid.shape) > most:
            raise HmkctaError(Kind.RESOURCE_LIMIT, "texture-too-large", "decoded elements",
                              found=f"{columns} x {rows} x {depth}", allowed=f"up to {most} a side",
                              hint="use --backend numpy")
        while len(self._kept) >= KEPT:
            self._kept.popitem(last=False)
        texture = out_texture(self._device, "grid", (columns, rows, depth), "r32float", "3d")
        self._decode(grid, texture, level)
        self._kept[key] = texture
        return texture

    @cached_property
    def _pass(self) -> ComputePass:
        code = compose_picked(self._buffers.prelude(), "grid")
        return ComputePass(self._device, "decode_grid", code, SLOTS, self._buffers)

    def turns(self, level: int) -> int:
        """A bound of the turns of all loops of an invocation."""
        options = self._buffers.options
        return loop_turns(self._model, options.picks or (), level, options.contracted)

    def _decode(self, grid: Grid, texture: Any, level: int | None) -> None:
        depth, rows, columns = grid.shape
        stands: dict[int, tuple[tuple[int, ...], tuple[float, ...]]] = {
            axis: ((grid.layout.stands[axis],), (1.0,)) for axis in self._still
        }
        if grid.layout.time is not None:
            stands[grid.layout.time] = _frames(grid)
        self._buffers.contract(stands)
        slots = np.zeros((depth, 8), np.uint32)
        slots[:, : grid.slices.shape[1]] = grid.slices
        buffer = self._device.buffer("slots", slots)
        step = max(1, ELEMENTS // (rows * columns))
        for first in range(0, depth, step):
            uniform = self._device.buffer("grid", _frame(grid, first).tobytes(), "UNIFORM")
            self._pass.run((uniform, buffer, texture), tiles(columns, rows, min(step, depth - first)),
                           self._buffers.bind_group(level))


def _frames(grid: Grid) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Frames with a weight, and their weights."""
    return (grid.frames, grid.weights) if grid.weights[1] else (grid.frames[:1], grid.weights[:1])


def _frame(grid: Grid, first: int) -> NDArray[np.void]:
    frame = np.zeros((), FRAME)
    frame["depth"], frame["height"], frame["width"] = grid.shape
    frame["first"] = first
    frame["x_step"] = frame["y_step"] = 1
    frame["y_axis"], frame["x_axis"] = grid.layout.space[-2:]
    frame["time_axis"] = NO_AXIS if grid.layout.time is None else grid.layout.time
    frame["time"][:2], frame["time_weight"][:2] = grid.frames, grid.weights
    return frame
