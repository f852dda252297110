"""SVBRDF renderer in NumPy, the readable twin of `svbrdf.wgsl` (paper, section 5.1).

Per pixel: the directions of the light and of the eye in the frame of the surface, interpolated among the measured ones,
times bilinear texels, for each colour; summed over the lights.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis
from .angles import AngleGrid, angle_grid
from .directions import DirectionTable, build_table, directions_of
from .elements import fetch, source_values
from .gbuffer import GBuffer, Rays
from .layout import Layout, time_steps
from .mesh import make_mesh
from .scene import Light, Scene, direction
from .white import as_light

F32 = NDArray[np.float32]
Index = NDArray[np.intp]

LEAST_VIEW = 0.01  # z of a view direction: smooth normals turn away before the surface does
PIXELS = 1 << 13  # shaded together: bounds memory to some 100 MB
#: Indices of an axis around each pixel, ``[b, k]``, and their weights.
Taps = tuple[Index, F32]


@dataclass(frozen=True, eq=False)
class Measured:
    """Measured directions of lights or views: a list along one axis, or a grid of the angles of two; or no axis."""

    axes: tuple[int, ...]
    table: DirectionTable | AngleGrid | None

    def taps(self, directions: F32) -> tuple[dict[int, Taps], F32]:
        """For each axis the taps around unit vectors ``[b, 3]``; and the z that they interpolate, ``[b]``."""
        if self.table is None:
            return {}, directions[:, 2]
        if isinstance(self.table, AngleGrid):
            found, height = self.table.interpolate(directions)
        else:
            index, weight, height = self.table.interpolate(directions)
            found = [(index, weight)]
        return {axis: (np.asarray(index, np.intp), weight) for axis, (index, weight)
                in zip(self.axes, found, strict=True)}, height


@dataclass(frozen=True, eq=False)
class Shading:
    """What does not change from frame to frame: the axes, and the measured directions.

    `assumed` names the axes whose directions had to be assumed because they have no coordinates.
    """

    layout: Layout
    light: Measured
    view: Measured
    assumed: tuple[str, ...]


def prepare(axes: Sequence[Axis], layout: Layout) -> Shading:
    """Triangulate the measured directions of lights and views.

    >>> from hmkcta.axes import name_axes
    >>> from hmkcta.render.layout import lay_out
    >>> axes = name_axes((9, 8, 8), ["light", "y", "x"])
    >>> prepare(axes, lay_out(axes, "svbrdf")).assumed
    ('light',)
    """
    assumed: list[str] = []

    def measured(numbers: Sequence[int]) -> Measured:
        if len(numbers) == 2:
            grid = angle_grid(axes, (numbers[0], numbers[1]))
            return Measured(grid.axes, grid)
        if not numbers:
            return Measured((), None)
        vectors, guessed = directions_of(axes[numbers[0]])
        assumed.extend([axes[numbers[0]].name] if guessed else [])
        return Measured(tuple(numbers), build_table(vectors))

    return Shading(layout, measured(layout.lights), measured(layout.views), tuple(assumed))


def at_time(layout: Layout, time: float | None) -> Layout:
    """The layout of an SVBRDF that changes with time, standing at the nearest frame."""
    if layout.time is None:
        return layout
    frames, weights = time_steps(time, layout.sizes[layout.time])
    stands = list(layout.stands)
    stands[layout.time] = frames[int(weights[1] > 0.5)]
    return replace(layout, stands=tuple(stands))


def shade(source: Any, shading: Shading, scene: Scene, seen: GBuffer, rays: Rays, coded: float = 0.0) -> F32:
    """Radiance and coverage ``[height, width, 4]`` of what the G-buffer shows, from a model or an array.

    `coded` is the white of values that are sRGB-coded, 0 where they are light.
    """
    height, width = seen.surface.shape[:2]
    picture = np.zeros((height * width, 4), np.float32)
    covered = np.flatnonzero(seen.surface.reshape(-1, 4)[:, 3] > 0)
    pixel_rays = rays.through_pixels(width, height).reshape(-1, 3).astype(np.float32)
    for start in range(0, len(covered), PIXELS):
        part = covered[start : start + PIXELS]
        surface, normal, tangent = (a.reshape(-1, 4)[part] for a in (seen.surface, seen.normal, seen.tangent))
        picture[part, :3] = _shade_pixels(source, shading, scene, (surface, normal, tangent), pixel_rays[part], rays,
                                          coded)
        picture[part, 3] = 1
    return picture.reshape(height, width, 4)


def _shade_pixels(source: Any, shading: Shading, scene: Scene, seen: tuple[F32, F32, F32], pixel_rays: F32,
                  rays: Rays, coded: float) -> F32:
    """Radiance ``[b, 3]`` of pixels that see the surface."""
    surface, normal, tangent = seen
    layout = at_time(shading.layout, scene.time)
    rows, columns = (layout.sizes[axis] for axis in layout.space)
    texels = dict(zip(layout.space, (texel_taps(surface[:, 1], rows), texel_taps(surface[:, 0], columns)), strict=True))
    frame = local_frame(normal[:, :3], tangent, scene.surface.y_axis == "up")
    view = np.einsum("bjk,bk->bj", frame, -pixel_rays)
    view[:, 2] = np.maximum(view[:, 2], np.float32(LEAST_VIEW))
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    views, _ = shading.view.taps(view.astype(np.float32))

    place = np.asarray(rays.eye.astype(np.float32) + surface[:, 2:3] * pixel_rays, np.float32)
    radiance = np.zeros((len(surface), 3), np.float32)
    for light in scene.lights:
        towards, strength = incident(light, place)
        local = np.einsum("bjk,bk->bj", frame, towards)
        lit = np.flatnonzero(local[:, 2] > 0)
        lights, height = shading.light.taps(local[lit].astype(np.float32))
        scale = strength[lit] * horizon(local[lit, 2], height, scene.surface.cosine)
        others = {axis: (index[lit], weight[lit]) for axis, (index, weight) in {**views, **texels}.items()}
        radiance[lit] += scale * as_light(interpolate(source, layout, {**lights, **others}), coded)
    return radiance


@dataclass(frozen=True)
class FixedLight:
    """A light that is the same at all pixels: for each axis (zeniths before azimuths) the measured directions around it
    with their weights, and the height that they interpolate.
    """

    axes: tuple[int, ...]
    taps: dict[int, tuple[tuple[int, ...], tuple[float, ...]]]
    height: float


def fixed_lights(shading: Shading, scene: Scene, rays: Rays) -> list[FixedLight] | None:
    """The lights, if all are the same at all pixels: distant ones on a plane; else None."""
    distant = all(light.position is None for light in scene.lights)
    if scene.surface.shape != "plane" or not scene.lights or not distant or not shading.light.axes:
        return None
    mesh = make_mesh(scene.surface, 1, 1)
    normal, tangent = mesh.normal[:1], mesh.tangent[:1]
    seen_from_behind = float(normal[0] @ (rays.eye - mesh.position[0])) < 0
    frame = local_frame(-normal if seen_from_behind else normal, tangent, scene.surface.y_axis == "up")
    found: list[FixedLight] = []
    for light in scene.lights:
        local = np.einsum("bjk,k->bj", frame, np.array(direction(light.azimuth, light.elevation), np.float32))
        taps, height = shading.light.taps(local.astype(np.float32))
        listed = {axis: (tuple(index[0].tolist()), tuple(weight[0].tolist())) for axis, (index, weight) in taps.items()}
        found.append(FixedLight(shading.light.axes, listed, float(height[0])))
    return found


def texel_taps(coordinate: F32, count: int) -> Taps:
    """The two texels around a texture coordinate (in repeats) and their weights; every other repeat is mirrored.

    Directions are not mirrored: at the border between two repeats the same texel would then be lit from two sides, and
    the border would show.

    >>> index, weight = texel_taps(np.array([0.25, 1.25], np.float32), 4)
    >>> index.tolist(), weight.tolist()
    ([[0, 1], [2, 3]], [[0.5, 0.5], [0.5, 0.5]])
    """
    repeat = np.floor(coordinate)
    within = coordinate - repeat
    odd = repeat % 2 == 1
    within = np.where(odd, 1 - within, within)
    place = np.clip(within * count - np.float32(0.5), 0, count - 1)
    first = np.minimum(place.astype(np.intp), max(count - 2, 0))
    share = (place - first).astype(np.float32)
    index = np.stack([first, np.minimum(first + 1, count - 1)], axis=1)
    return index, np.stack([1 - share, share], axis=1)


def local_frame(normal: F32, tangent: F32, y_up: bool) -> F32:
    """Rows x, y, z of the measured directions' frame in world coordinates, ``[b, 3, 3]``."""
    along = tangent[:, :3] - np.einsum("bk,bk->b", tangent[:, :3], normal)[:, None] * normal
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    down = np.asarray(np.cross(normal, along) * tangent[:, 3:], np.float32)
    return np.stack([along, -down if y_up else down, normal], axis=1).astype(np.float32)


def incident(light: Light, place: F32) -> tuple[F32, F32]:
    """Unit vectors ``[b, 3]`` towards a light from points ``[b, 3]``, and its strength there ``[b, 3]``."""
    colour = np.float32(light.intensity) * np.array(light.colour, np.float32)
    if light.position is None:
        towards = np.array(direction(light.azimuth, light.elevation), np.float32)
        return np.broadcast_to(towards, place.shape), np.broadcast_to(colour, place.shape)
    offset = np.array(light.position, np.float32) - place
    square = np.maximum(np.einsum("bk,bk->b", offset, offset), np.float32(1e-8))[:, None]
    return offset / np.sqrt(square), colour / square


def horizon(z: F32, measured: F32, contains_cosine: bool) -> F32:
    """Factor ``[b, 1]`` of a light at height z: values beyond the measured ones fall to 0 at the horizon with z.

    >>> horizon(np.array([0.1], np.float32), np.array([0.2], np.float32), True).tolist()
    [[0.5]]
    """
    if contains_cosine:
        return np.asarray(np.minimum(1, z / np.maximum(measured, 1e-6)), np.float32)[:, None]
    return np.asarray(z, np.float32)[:, None]


def interpolate(source: Any, layout: Layout, taps: Mapping[int, Taps]) -> F32:
    """Interpolated values ``[b, 3]``, from taps ``[b, k]`` of axes."""
    points = len(next(iter(taps.values()))[0])
    if not points:
        return np.zeros((0, 3), np.float32)
    indices: dict[int, Index] = {}
    weight = np.ones((points, *[1] * len(taps)), np.float32)
    for number, (axis, (index, share)) in enumerate(taps.items()):
        shape = [points, *(index.shape[1] if n == number else 1 for n in range(len(taps)))]
        weight = weight * share.reshape(shape)
        indices[axis] = index.reshape(*shape, 1)
    if layout.channel is not None:
        indices[layout.channel] = np.array(layout.channels, np.intp).reshape(*[1] * weight.ndim, -1)
    values = fetch(source, layout, indices).reshape(points, weight[0].size, -1)
    values = source_values(source, np.einsum("bkc,bk->bc", values, weight.reshape(points, -1)))
    return np.asarray(np.broadcast_to(values, (points, 3)), np.float32)
