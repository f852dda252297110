"""Rendering without a GPU: radiance of a model or of an array, by the readable renderers; for small frames."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis
from ..model import Model
from ..pictures import slice_image
from . import lightfield, svbrdf, volume
from .gbuffer import Rays, camera_rays, trace
from .grid import decode_grid, grid_at, volume_slices
from .layout import Layout, value_range
from .mesh import make_mesh
from .scene import Camera, Scene
from .white import coded_white

F32 = NDArray[np.float32]


def placed_camera(scene: Scene, kind: str) -> Camera:
    """The scene's camera with what suits its kind and surface in place of Nones."""
    if kind == "svbrdf" and scene.surface.shape == "plane":
        return scene.camera.placed(0.0, 0.0, 3.6)
    if kind == "svbrdf" and scene.surface.shape == "cloth":
        return scene.camera.placed(20.0, 38.0, 5.3)
    return scene.camera.placed(30.0, 25.0, 5.4) if kind == "volume" else scene.camera.placed(20.0, 20.0, 3.4)


def rays_of(scene: Scene, kind: str) -> Rays:
    """The rays of the scene's camera."""
    return camera_rays(placed_camera(scene, kind), scene.width / scene.height)


@final
class NumpyPath:
    """Radiance of scenes, from a model or an array of the same axes.

    Args:
        source: a model, or an array of its shape (the original).
        axes: the source axes.
        layout: what they are to the renderer.
        kind: of `hmkcta.render.scene.KINDS`.
        reference: what the volume's window, and whether values are sRGB-coded, is taken from: the model, also where the
            original is shown.
    """

    def __init__(self, source: Any, axes: Sequence[Axis], layout: Layout, kind: str, reference: Model) -> None:
        self._source = source
        self._axes = axes
        self._layout = layout
        self._kind = kind
        self._reference = reference
        self._shading = svbrdf.prepare(axes, layout) if kind == "svbrdf" else None

    @property
    def assumed(self) -> tuple[str, ...]:
        """Axes whose directions had to be assumed."""
        return () if self._shading is None else self._shading.assumed

    def radiance(self, scene: Scene, level: int | None) -> F32:
        """Radiance and coverage ``[height, width, 4]`` of the first `level` levels; an array has no levels."""
        source = self._source if level is None else self._source.at_level(level)
        if self._shading is not None:
            return self._svbrdf(source, scene)
        if self._kind == "lightfield":
            return self._lightfield(source, scene)
        return self._volume(source, scene) if self._kind == "volume" else self._slice(source, scene)

    def _svbrdf(self, source: Any, scene: Scene) -> F32:
        assert self._shading is not None, "made for this kind"
        rays = rays_of(scene, self._kind)
        rows, columns = (self._layout.sizes[axis] for axis in self._layout.space)
        seen = trace(make_mesh(scene.surface, rows, columns), rays, scene.width, scene.height)
        coded = coded_white(self._reference.metadata.source_dtype, self._kind, scene.surface.coded)
        return svbrdf.shade(source, self._shading, scene, seen, rays, coded)

    def _lightfield(self, source: Any, scene: Scene) -> F32:
        aimed = lightfield.aim(lightfield.find_cameras(self._axes, self._layout), scene.viewpoint)
        grid = grid_at(self._layout, lightfield.camera_slices(self._layout, aimed), scene.time)
        return lightfield.shade(decode_grid(source, grid), aimed, len(self._layout.channels), scene)

    def _volume(self, source: Any, scene: Scene) -> F32:
        marching = volume.prepare(self._window, self._axes, self._layout, scene)
        values = decode_grid(source, grid_at(self._layout, volume_slices(self._layout), scene.time))
        return volume.shade(values, marching, rays_of(scene, self._kind), scene.width, scene.height)

    @cached_property
    def _window(self) -> tuple[float, float]:
        return value_range(self._reference, self._layout.sizes)

    def _slice(self, source: Any, scene: Scene) -> F32:
        picture = slice_image(source, self._axes, "generic", scene.position)
        rows, columns = picture.shape[:2]
        scale, top, left = lightfield.fit(scene, rows, columns)
        y = np.rint(top + scale * np.arange(scene.height)).astype(np.intp)
        x = np.rint(left + scale * np.arange(scene.width)).astype(np.intp)
        inside = ((y >= 0) & (y < rows))[:, None] & ((x >= 0) & (x < columns))
        found = picture[y.clip(0, rows - 1)[:, None], x.clip(0, columns - 1)]
        covered = np.concatenate([found, np.ones((*found.shape[:2], 1), np.float32)], axis=2)
        return np.asarray(np.where(inside[..., None], covered, 0), np.float32)
