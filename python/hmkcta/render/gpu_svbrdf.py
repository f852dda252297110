"""Host of `svbrdf.wgsl`: tables of directions, the uniform, the G-buffer; one dispatch a frame."""

from __future__ import annotations

from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError
from ..model import Model
from .contract import contractable
from .device import Device
from .directions import GRID, DirectionTable
from .gbuffer import Rays, trace
from .gpu_pass import ComputePass, Slot, picture_texture, tiles
from .layout import Layout
from .mesh import make_mesh
from .numpy_path import rays_of
from .prelude import Options, compose
from .scene import MOST_LIGHTS, Light, Scene, direction
from .software import loop_turns
from .svbrdf import at_time, prepare
from .upload import DecoderBuffers

F32 = NDArray[np.float32]

LIGHT = np.dtype([("place", "f4", 4), ("strength", "f4", 4)])
FRAME = np.dtype([
    ("width", "u4"), ("height", "u4"), ("light_count", "u4"), ("flags", "u4"),
    ("eye", "f4", 4), ("right", "f4", 4), ("up", "f4", 4), ("forward", "f4", 4),
    ("rows", "u4"), ("columns", "u4"), ("unused_0", "u4", 2),
    ("light_table", "u4", 4), ("view_table", "u4", 4),
    ("y_axis", "u4"), ("x_axis", "u4"), ("channel_axis", "u4"), ("unused_2", "u4"),
    ("channels", "u4", 4), ("stands", "u4", 8), ("lights", LIGHT, MOST_LIGHTS),
])
NO_AXIS = 0xFF
FLAG_Y_UP, FLAG_COSINE, FLAG_NEAREST = 1, 2, 4
SLOTS = (Slot("uniform"), Slot("storage"), *[Slot("texture")] * 3, Slot("out", format="rgba32float"))

@final
class GpuSvbrdf:
    """Renders SVBRDFs of one model by the shaders."""

    def __init__(self, device: Device, model: Model, layout: Layout) -> None:
        self._device = device
        self._model = model
        self._layout = layout
        self._shading = prepare(model.metadata.axes, layout)
        self._channels = 3 if layout.channel is not None and len(layout.channels) == 3 else 1
        self._buffers, self._nearest = _decoder(device, model, layout, self._channels)
        tables, self._light_table, self._view_table = direction_buffer(
            self._shading.light, self._shading.view, layout.light, next(iter(layout.views), None))
        self._directions = device.buffer("directions", tables)
        self._seen: tuple[Any, tuple[Any, ...]] | None = None
        self._stood: tuple[int, ...] | None = None  # where the contracted axes stood

    def draw(self, scene: Scene, level: int | None, out: Any) -> None:
        """Submit the work that fills `out`, a texture rgba32float of the scene's size."""
        rays = rays_of(scene, "svbrdf")
        self._contract(scene)
        uniform = self._device.buffer("svbrdf", self._frame(scene, rays).tobytes(), "UNIFORM")
        resources = (uniform, self._directions, *self._surfaces(scene, rays), out)
        self._pass.run(resources, tiles(scene.width, scene.height), self._buffers.bind_group(level))

    def _contract(self, scene: Scene) -> None:
        """Sum the modes of which no axis moves into the cores, unless they stand where they stood."""
        stands = at_time(self._layout, scene.time).stands
        if stands != self._stood:
            self._stood = stands
            self._buffers.contract({axis: ((stands[axis],), (1.0,)) for axis in _still(self._layout)})

    @cached_property
    def _pass(self) -> ComputePass:
        """Compiled when it is first used: software takes seconds for it, and may then not be let to run it."""
        code = compose(self._buffers.prelude(), "image", "decode", "weighted", "svbrdf")
        return ComputePass(self._device, "shade_svbrdf", code, SLOTS, self._buffers)

    def turns(self, scene: Scene, level: int) -> int:
        """A bound of the turns of all loops of an invocation."""
        options = self._buffers.options
        return len(scene.lights) * loop_turns(self._model, options.picks or (), level, options.contracted)

    def _surfaces(self, scene: Scene, rays: Rays) -> tuple[Any, ...]:
        """The G-buffer's textures, kept while camera and surface stay."""
        key = (scene.width, scene.height, scene.camera, scene.surface)
        if self._seen is None or self._seen[0] != key:
            rows, columns = (self._layout.sizes[axis] for axis in self._layout.space)
            seen = trace(make_mesh(scene.surface, rows, columns), rays, scene.width, scene.height)
            pictures = {"surface": seen.surface, "normal": seen.normal, "tangent": seen.tangent}
            self._seen = key, tuple(picture_texture(self._device, name, p) for name, p in pictures.items())
        return self._seen[1]

    def _frame(self, scene: Scene, rays: Rays) -> NDArray[np.void]:
        frame = np.zeros((), FRAME)
        layout = at_time(self._layout, scene.time)
        frame["width"], frame["height"], frame["light_count"] = scene.width, scene.height, len(scene.lights)
        frame["flags"] = (FLAG_Y_UP * (scene.surface.y_axis == "up") + FLAG_COSINE * (not scene.surface.cosine)
                          + FLAG_NEAREST * self._nearest)
        for name in ("eye", "right", "up", "forward"):
            frame[name][:3] = getattr(rays, name)
        frame["y_axis"], frame["x_axis"] = layout.space
        frame["rows"], frame["columns"] = (layout.sizes[axis] for axis in layout.space)
        frame["light_table"], frame["view_table"] = self._light_table, self._view_table
        stands = list(layout.stands)
        frame["channel_axis"] = NO_AXIS
        if self._channels == 3:
            frame["channel_axis"], frame["channels"][:3] = layout.channel, layout.channels
        elif layout.channel is not None:
            stands[layout.channel] = layout.channels[0]
        frame["stands"][: len(stands)] = stands
        for slot, light in zip(frame["lights"], scene.lights, strict=False):
            slot["place"], slot["strength"][:3] = _place(light), light.intensity * np.array(light.colour)
        return frame


def direction_buffer(light: DirectionTable | None, view: DirectionTable | None, light_axis: int | None,
                     view_axis: int | None) -> tuple[NDArray[np.uint32], list[int], list[int]]:
    """Both tables in one buffer, and for each its first record, first grid cell (in groups of 4), grid side, axis."""
    parts: list[NDArray[np.uint32]] = []
    places: list[list[int]] = []
    start = 0
    for table, axis in ((light, light_axis), (view, view_axis)):
        if table is None or axis is None:
            places.append([0, 0, GRID, NO_AXIS])
            continue
        records = table.records()
        parts.append(records)
        places.append([start, start + 4 * len(table.corners), GRID, axis])
        start += len(records) // 4
    return np.concatenate(parts or [np.zeros(4, np.uint32)]), places[0], places[1]


def _still(layout: Layout) -> list[int]:
    """Axes that stand still in a frame: neither directions, texels nor colours."""
    return [axis for axis in range(len(layout.sizes)) if axis not in (layout.light, *layout.views, *layout.space,
                                                                      layout.channel)]


def _decoder(device: Device, model: Model, layout: Layout, channels: int) -> tuple[DecoderBuffers, bool]:
    """Decoder with room for the interpolation's picks, and whether texels must stay uninterpolated to fit."""
    for texels in (2, 1):
        picks = [1] * len(layout.sizes)
        for axis in (layout.light, *layout.views):
            if axis is not None:
                picks[axis] = 3
        for axis in layout.space:
            picks[axis] = texels
        if channels == 3 and layout.channel is not None:
            picks[layout.channel] = 3
        options = Options(tuple(picks), channels, contractable(model, _still(layout)))
        buffers = DecoderBuffers(device, model, options)
        try:
            buffers.prelude()
        except HmkctaError as error:
            if error.reason != "picks-too-many" or texels == 1:
                raise
            continue
        return buffers, texels == 1
    raise AssertionError("the loop returns or raises")


def _place(light: Light) -> list[float]:
    """Unit direction and 0 of a directional light, position and 1 of a point light."""
    if light.position is None:
        return [*direction(light.azimuth, light.elevation), 0.0]
    return [*light.position, 1.0]
