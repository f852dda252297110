"""Rendering by the shaders: hosts of `svbrdf.wgsl`, `lightfield.wgsl` and `volume.wgsl` behind one method."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from math import ceil
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError, Kind
from ..model import Model
from . import lightfield, volume
from .device import Device
from .gpu_grid import GpuGrid
from .gpu_pass import ComputePass, Slot, out_texture, read_texture, tiles
from .gpu_svbrdf import GpuSvbrdf
from .grid import grid_at, volume_slices
from .layout import Layout, value_range
from .numpy_path import rays_of
from .prelude import shader
from .scene import VOLUME_MODES, Scene
from .software import MOST_TURNS

F32 = NDArray[np.float32]

LIGHTFIELD_FRAME = np.dtype([
    ("width", "u4"), ("height", "u4"), ("cameras", "u4"), ("channels", "u4"),
    ("rows", "u4"), ("columns", "u4"), ("scale", "f4"), ("unused_0", "f4"),
    ("offset_y", "f4"), ("offset_x", "f4"), ("unused_1", "f4", 2),
])
VOLUME_FRAME = np.dtype([
    ("width", "u4"), ("height", "u4"), ("mode", "u4"), ("most_steps", "u4"),
    ("eye", "f4", 4), ("right", "f4", 4), ("up", "f4", 4), ("forward", "f4", 4),
    ("half", "f4", 3), ("step", "f4"), ("clip_low", "f4", 3), ("iso", "f4"), ("clip_high", "f4", 3), ("unit", "f4"),
    ("low", "f4"), ("high", "f4"), ("ambient", "f4"), ("specular", "f4"),
    ("light", "f4", 4), ("background", "f4", 4),
])
#: Uniform, cameras or transfer function, decoded elements, radiance: of both shaders.
SLOTS = (Slot("uniform"), Slot("storage"), Slot("texture", "3d"), Slot("out", format="rgba32float"))


@final
class GpuPath:
    """Radiance of scenes of one model, by the shaders."""

    def __init__(self, device: Device, model: Model, layout: Layout, kind: str) -> None:
        makers: dict[str, Callable[[], GpuSvbrdf | GpuLightfield | GpuVolume]] = {
            "svbrdf": lambda: GpuSvbrdf(device, model, layout),
            "lightfield": lambda: GpuLightfield(device, model, layout),
            "volume": lambda: GpuVolume(device, model, layout),
        }
        self._device = device
        self._renderer = makers[kind]()
        self._out: Any = None

    def refusal(self, scene: Scene, level: int) -> HmkctaError | None:
        """Why a software adapter would not finish this picture, or None."""
        turns = self._renderer.turns(scene, level) if self._device.software else 0
        if turns <= MOST_TURNS:
            return None
        return HmkctaError(Kind.RESOURCE_LIMIT, "software-loops", f"picture by {self._device.name}",
                           found=f"up to {turns} turns of the shader's loops", allowed=f"{MOST_TURNS} in software",
                           hint="use --backend numpy, fewer lights, or a lower level")

    def radiance(self, scene: Scene, level: int | None) -> F32:
        """Radiance and coverage ``[height, width, 4]``."""
        return read_texture(self._device, self.draw(scene, level), "f4", 4)

    def draw(self, scene: Scene, level: int | None) -> Any:
        """Submit the work for a picture and return its texture, rgba32float, which the next call may fill again.

        What stays from picture to picture is kept: what pixels see of a surface, and decoded boxes.
        """
        if self._out is None or self._out.size[:2] != (scene.width, scene.height):
            self._out = out_texture(self._device, "radiance", (scene.width, scene.height, 1), "rgba32float")
        self._renderer.draw(scene, level, self._out)
        return self._out


@final
class GpuLightfield:
    """Host of `lightfield.wgsl`."""

    def __init__(self, device: Device, model: Model, layout: Layout) -> None:
        self._device, self._layout = device, layout
        self._cameras = lightfield.find_cameras(model.metadata.axes, layout)
        self._grid = GpuGrid(device, model, layout)
        self._pass = ComputePass(device, "shade_lightfield", shader("lightfield"), SLOTS)

    def draw(self, scene: Scene, level: int | None, out: Any) -> None:
        """Submit the work that fills `out` with radiance and coverage."""
        aimed = lightfield.aim(self._cameras, scene.viewpoint)
        grid = grid_at(self._layout, lightfield.camera_slices(self._layout, aimed), scene.time)
        channels = len(self._layout.channels)
        cameras = np.zeros((len(aimed.weight), 4), np.float32)
        cameras[:, 0], cameras[:, 1:3] = aimed.weight, aimed.shift
        cameras[:, 3] = np.arange(len(cameras)) * channels
        frame = np.zeros((), LIGHTFIELD_FRAME)
        frame["width"], frame["height"], frame["cameras"] = scene.width, scene.height, len(cameras)
        frame["channels"] = channels
        frame["rows"], frame["columns"] = grid.shape[1:]
        frame["scale"], frame["offset_y"], frame["offset_x"] = lightfield.fit(scene, *grid.shape[1:])
        texture = self._grid.texture(grid, level)
        _shade(self._device, self._pass, scene, (frame, cameras, texture, out))

    def turns(self, scene: Scene, level: int) -> int:
        """A bound of the turns of all loops of an invocation."""
        del scene
        return self._grid.turns(level)


@final
class GpuVolume:
    """Host of `volume.wgsl`."""

    def __init__(self, device: Device, model: Model, layout: Layout) -> None:
        self._device, self._layout, self._model = device, layout, model
        self._grid = GpuGrid(device, model, layout)
        self._pass = ComputePass(device, "shade_volume", shader("volume"), SLOTS)

    def draw(self, scene: Scene, level: int | None, out: Any) -> None:
        """Submit the work that fills `out` with premultiplied display colour and opacity."""
        marching = volume.prepare(self._window, self._model.metadata.axes, self._layout, scene)
        rays, look = rays_of(scene, "volume"), scene.volume
        frame = np.zeros((), VOLUME_FRAME)
        frame["width"], frame["height"], frame["most_steps"] = scene.width, scene.height, marching.most_steps
        frame["mode"] = VOLUME_MODES.index(look.mode)
        for name in ("eye", "right", "up", "forward"):
            frame[name][:3] = getattr(rays, name)
        frame["half"], frame["step"], frame["unit"] = marching.half, marching.step, marching.unit
        frame["clip_low"], frame["clip_high"], frame["iso"] = look.clip_low, look.clip_high, look.iso
        frame["low"], frame["high"] = marching.window
        frame["ambient"], frame["specular"] = look.ambient, look.specular
        frame["light"][:3] = marching.light
        texture = self._grid.texture(grid_at(self._layout, volume_slices(self._layout), scene.time), level)
        _shade(self._device, self._pass, scene, (frame, marching.table, texture, out))

    @cached_property
    def _window(self) -> tuple[float, float]:
        return value_range(self._model, self._layout.sizes)

    def turns(self, scene: Scene, level: int) -> int:
        """A bound of the turns of all loops of an invocation."""
        marched = 4 * ceil(2 * 3**0.5 * max(self._layout.sizes[axis] for axis in self._layout.space)
                           / scene.volume.step)
        return max(self._grid.turns(level), marched)


def _shade(device: Device, work: ComputePass, scene: Scene, given: tuple[NDArray[np.void], F32, Any, Any]) -> None:
    """Run a renderer on its uniform, its table and the decoded elements, into a texture."""
    frame, table, decoded, out = given
    resources = (device.buffer("frame", frame.tobytes(), "UNIFORM"), device.buffer("table", table), decoded, out)
    work.run(resources, tiles(scene.width, scene.height))
