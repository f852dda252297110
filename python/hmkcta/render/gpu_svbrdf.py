"""Host of `svbrdf.wgsl`: tables of directions, the uniform, the G-buffer; one dispatch a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from ..errors import invalid
from ..model import Model
from ..packed import Metadata
from .angles import AngleGrid
from .device import Device
from .directions import GRID, DirectionTable
from .frame_contraction import AxisPicks
from .gbuffer import Rays, trace
from .gpu_pass import ComputePass, Slot, picture_texture, tiles
from .layout import Layout
from .mesh import make_mesh
from .numpy_path import rays_of
from .paying_modes import paying_modes
from .prelude import NO_AXIS, Options, compose_picked, picks_fit
from .scene import MOST_LIGHTS, Light, Scene, direction
from .software import loop_turns
from .svbrdf import FixedLight, Measured, at_time, fixed_lights, prepare
from .upload import DecoderBuffers
from .white import coded_white

F32 = NDArray[np.float32]
U32 = NDArray[np.uint32]

LIGHT = np.dtype([("place", "f4", 4), ("strength", "f4", 4), ("corners", "u4", 4), ("shares", "f4", 4)])
FRAME = np.dtype([
    ("width", "u4"), ("height", "u4"), ("light_count", "u4"), ("flags", "u4"),
    ("eye", "f4", 4), ("right", "f4", 4), ("up", "f4", 4), ("forward", "f4", 4),
    ("rows", "u4"), ("columns", "u4"), ("y_axis", "u4"), ("x_axis", "u4"),
    ("channel_axis", "u4"), ("set_numbers", "u4"), ("coded_white", "f4"), ("unused", "u4"),
    ("channels", "u4", 4), ("stands", "u4", 8), ("tables", "u4", (2, 4)), ("angles", "u4", (4, 4)),
    ("lights", LIGHT, MOST_LIGHTS),
])
FLAG_Y_UP, FLAG_COSINE, FLAG_NEAREST, FLAG_NEAREST_AZIMUTH = 1, 2, 4, 8
SLOTS = (Slot("uniform"), Slot("storage"), *[Slot("texture")] * 3, Slot("out", format="rgba32float"))


def constants(*, angles: bool, fixed: bool) -> str:
    """What `svbrdf.wgsl` needs beside the prelude."""
    return f"const ANGLES = {str(angles).lower()};\nconst FIXED_LIGHT = {str(fixed).lower()};\n"


@final
class GpuSvbrdf:
    """Renders SVBRDFs of one model by the shaders: one that finds the lights at every pixel, and, where it pays, one
    for lights that are the same at all pixels, whose mode is contracted.
    """

    def __init__(self, device: Device, model: Model, layout: Layout) -> None:
        self._device = device
        self._model = model
        self._layout = layout
        self._shading = prepare(model.metadata.axes, layout)
        self._picks, self._flags = choose_picks(
            model.metadata, (self._shading.view.axes, self._shading.light.axes), layout, self._channels)
        tables, self._tables, self._angles = direction_buffer((self._shading.view, self._shading.light))
        self._directions = device.buffer("directions", tables)
        self._seen: tuple[Any, tuple[Any, ...]] | None = None
        self._general = self._variant((), None)

    def draw(self, scene: Scene, level: int | None, out: Any) -> None:
        """Submit the work that fills `out`, a texture rgba32float of the scene's size."""
        rays = rays_of(scene, "svbrdf")
        lights = self._fixed_lights(scene, rays)
        variant = self._general if lights is None else self._fixed or self._general
        variant.contract(self._sets(scene, lights))
        frame = self._frame(scene, rays, lights or (), variant.buffers.stride)
        resources = (self._device.buffer("svbrdf", frame.tobytes(), "UNIFORM"), self._directions,
                     *self._surfaces(scene, rays), out)
        variant.shade.run(resources, tiles(scene.width, scene.height), variant.buffers.bind_group(level))

    def turns(self, scene: Scene, level: int) -> int:
        """A bound of the turns of all loops of an invocation."""
        options = self._general.buffers.options
        return len(scene.lights) * loop_turns(self._model, options.picks or (), level, options.contracted)

    def contracted(self, *, fixed: bool) -> tuple[int, ...]:
        """The modes that are contracted, for lights that are the same at all pixels or for others."""
        variant = self._fixed or self._general if fixed else self._general
        return variant.buffers.options.contracted

    @property
    def _channels(self) -> int:
        return 3 if self._layout.channel is not None and len(self._layout.channels) == 3 else 1

    def _variant(self, fixed: Sequence[int], shared: DecoderBuffers | None) -> _Variant:
        options = Options(self._picks, self._channels)
        modes = paying_modes(self._model, options, _still(self._layout), fixed, self._layout.channel)
        angles = any(isinstance(each.table, AngleGrid) for each in (self._shading.view, self._shading.light))
        buffers = DecoderBuffers(self._device, self._model, replace(options, contracted=modes), shared)
        return _Variant(self._device, buffers, constants(angles=angles, fixed=bool(fixed)))

    @cached_property
    def _fixed(self) -> _Variant | None:
        """For lights that are the same at all pixels; None where it does not pay."""
        if self._flags & FLAG_NEAREST_AZIMUTH:
            return None
        made = self._variant(self._layout.lights, self._general.buffers)
        return None if made.buffers.options.contracted == self._general.buffers.options.contracted else made

    def _fixed_lights(self, scene: Scene, rays: Rays) -> list[FixedLight] | None:
        """The lights, where the variant for fixed ones is to be used."""
        lights = fixed_lights(self._shading, scene, rays)
        if lights is None or self._fixed is None or not self._fixed.buffers.fits(len(lights)):
            return None
        return lights

    def _sets(self, scene: Scene, lights: Sequence[FixedLight] | None) -> list[AxisPicks]:
        """What contracted axes stand at: one set, or one a fixed light."""
        layout = at_time(self._layout, scene.time)
        stands: dict[int, tuple[tuple[int, ...], tuple[float, ...]]] = {
            axis: ((layout.stands[axis],), (1.0,)) for axis in _still(layout)}
        if layout.channel is not None:
            stands[layout.channel] = (layout.channels, (1.0,) * len(layout.channels))
        if lights is None:
            return [stands]
        return [{**stands, **light.taps} for light in lights]

    def _surfaces(self, scene: Scene, rays: Rays) -> tuple[Any, ...]:
        """The G-buffer's textures, kept while camera and surface stay."""
        key = (scene.width, scene.height, scene.camera, scene.surface)
        if self._seen is None or self._seen[0] != key:
            rows, columns = (self._layout.sizes[axis] for axis in self._layout.space)
            seen = trace(make_mesh(scene.surface, rows, columns), rays, scene.width, scene.height)
            pictures = {"surface": seen.surface, "normal": seen.normal, "tangent": seen.tangent}
            self._seen = key, tuple(picture_texture(self._device, name, p) for name, p in pictures.items())
        return self._seen[1]

    def _frame(self, scene: Scene, rays: Rays, fixed: Sequence[FixedLight], stride: int) -> NDArray[np.void]:
        frame = np.zeros((), FRAME)
        layout = at_time(self._layout, scene.time)
        frame["width"], frame["height"], frame["light_count"] = scene.width, scene.height, len(scene.lights)
        frame["flags"] = (FLAG_Y_UP * (scene.surface.y_axis == "up") + FLAG_COSINE * (not scene.surface.cosine)
                          + self._flags)
        for name in ("eye", "right", "up", "forward"):
            frame[name][:3] = getattr(rays, name)
        frame["y_axis"], frame["x_axis"] = layout.space
        frame["rows"], frame["columns"] = (layout.sizes[axis] for axis in layout.space)
        frame["tables"], frame["angles"], frame["set_numbers"] = self._tables, self._angles, stride
        frame["coded_white"] = coded_white(self._model.metadata.source_dtype, "svbrdf", scene.surface.coded)
        stands = list(layout.stands)
        frame["channel_axis"] = NO_AXIS
        if self._channels == 3:
            frame["channel_axis"], frame["channels"][:3] = layout.channel, layout.channels
        elif layout.channel is not None:
            stands[layout.channel] = layout.channels[0]
        frame["stands"][: len(stands)] = stands
        for slot, light in zip(frame["lights"], scene.lights, strict=False):
            slot["place"], slot["strength"][:3] = _place(light), light.intensity * np.array(light.colour)
        for slot, light in zip(frame["lights"], fixed, strict=False):
            corners = [pick for axis in light.axes for pick in zip(*light.taps[axis], strict=True)]
            slot["strength"][3] = light.height
            slot["corners"][: len(corners)], slot["shares"][: len(corners)] = zip(*corners, strict=True)
        return frame


@final
class _Variant:
    """A shader and its decoder, contracted anew only when something moves that stood still."""

    def __init__(self, device: Device, buffers: DecoderBuffers, constants: str) -> None:
        self._device = device
        self._constants = constants
        self._stood: list[AxisPicks] | None = None
        self.buffers = buffers

    @cached_property
    def shade(self) -> ComputePass:
        """Compiled when it is first used: software takes seconds for it, and may then not be let to run it."""
        code = compose_picked(self.buffers.prelude() + self._constants, "svbrdf")
        return ComputePass(self._device, "shade_svbrdf", code, SLOTS, self.buffers)

    def contract(self, sets: list[AxisPicks]) -> None:
        """Sum the modes that stand still into the cores."""
        if sets != self._stood:
            self._stood = sets
            self.buffers.contract(*sets)


def choose_picks(metadata: Metadata, directions: Sequence[Sequence[int]], layout: Layout, channels: int
                 ) -> tuple[tuple[int, ...], int]:
    """Room for the picks of each axis, and flags for what must stay uninterpolated because a mode holds too much.

    `directions` are the axes of views and of lights, zeniths before azimuths.

    Raises:
        HmkctaError: there is no room for any way.
    """
    for texels, azimuths, flags in ((2, 2, 0), (1, 2, FLAG_NEAREST), (1, 1, FLAG_NEAREST | FLAG_NEAREST_AZIMUTH)):
        picks = [1] * len(layout.sizes)
        for axes in directions:
            for axis, count in zip(axes, (3,) if len(axes) == 1 else (2, azimuths), strict=False):
                picks[axis] = count
        for axis in layout.space:
            picks[axis] = texels
        if channels == 3 and layout.channel is not None:
            picks[layout.channel] = 3
        if picks_fit(metadata, picks):
            return tuple(picks), flags
    raise invalid("picks-too-many", "organisation", metadata.organisation,
                  "one whose modes hold fewer axes of directions", "use --backend numpy")


def direction_buffer(both: Sequence[Measured]) -> tuple[U32, U32, U32]:
    """Tables of directions in one buffer; for each its first record, first grid cell (in groups of 4), grid side, axis;
    and of the angles on both of its axes the first entry, their number, the axis.
    """
    parts: list[U32] = []
    tables, angles = np.zeros((2, 4), np.uint32), np.zeros((4, 4), np.uint32)
    start = 0
    for which, measured in enumerate(both):
        tables[which] = 0, 0, GRID, NO_AXIS
        table = measured.table
        if isinstance(table, DirectionTable):
            tables[which] = start, start + 4 * len(table.corners), GRID, measured.axes[0]
            parts.append(table.records())
        elif table is not None:
            for part, (axis, listed) in enumerate(zip(measured.axes, (table.zenith, table.azimuth), strict=True)):
                angles[2 * which + part, :3] = start + len(table.zenith.angle) * part, len(listed.angle), axis
                parts.append(listed.records())
        start = sum(map(len, parts)) // 4
    return np.concatenate(parts or [np.zeros(4, np.uint32)]), tables, angles


def _still(layout: Layout) -> list[int]:
    """Axes that stand still in a frame: neither directions, texels nor colours."""
    moving = (*layout.lights, *layout.views, *layout.space, layout.channel)
    return [axis for axis in range(len(layout.sizes)) if axis not in moving]


def _place(light: Light) -> list[float]:
    """Unit direction and 0 of a directional light, position and 1 of a point light."""
    if light.position is None:
        return [*direction(light.azimuth, light.elevation), 0.0]
    return [*light.position, 1.0]
