"""Volume renderer in NumPy, the readable twin of `volume.wgsl` (paper, section 5.3): rays through a box of values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis
from .colours import transfer_table
from .gbuffer import Rays
from .layout import Layout
from .scene import Look, Scene, direction

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

OPAQUE, GLOSS, FADE = 0.995, 24.0, 8.0  # as in the shader
RAYS = 1 << 15  # marched together


@dataclass(frozen=True, eq=False)
class Marching:
    """What does not change with the camera: the box, the window, the transfer function.

    Attributes:
        half: half extents (x, y, z) in world units, the largest 1.
        window: values at share 0 and 1.
        table: display colour and opacity of 256 shares, ``[256, 4]``.
        step, unit: length of a step and of a voxel in world units.
        light: unit vector towards the light.
    """

    look: Look
    half: F32
    window: tuple[float, float]
    table: F32
    step: float
    unit: float
    light: F32

    @property
    def most_steps(self) -> int:
        """Steps along the box's diagonal."""
        return ceil(2 * float(np.linalg.norm(self.half)) / self.step) + 1


def prepare(window: tuple[float, float], axes: Sequence[Axis], layout: Layout, scene: Scene) -> Marching:
    """Box and transfer function of a scene; `window` is that of the data, for scenes that do not say one."""
    look = scene.volume
    extent = np.array([axes[n].size * spacing(axes[n]) for n in reversed(layout.space)])
    voxel = min(2 * spacing(axes[n]) / extent.max() for n in layout.space)
    window = look.window or window
    if window[1] <= window[0]:  # one value: any width will do that float32 can tell from 0
        window = (window[0], window[0] + max(1.0, abs(window[0])))
    light = scene.lights[0] if scene.lights else None
    towards = direction(light.azimuth, light.elevation) if light is not None else (0.0, 0.0, 1.0)
    half = (extent / extent.max()).astype(np.float32)
    return Marching(look, half, window, transfer_table(look), look.step * voxel, voxel, np.array(towards, np.float32))


def spacing(axis: Axis) -> float:
    """Distance between neighbours on a space axis: from coordinates that rise evenly, else 1.

    >>> spacing(Axis("x", 3, "space", np.array([0.0, 0.5, 1.0]), "mm"))
    0.5
    """
    if axis.coords is None or np.shape(axis.coords) != (axis.size,) or axis.size < 2:
        return 1.0
    steps = np.diff(np.asarray(axis.coords, np.float64))
    even = bool((np.abs(steps - steps.mean()) <= 1e-3 * abs(steps.mean())).all())
    return float(abs(steps.mean())) if even and steps.mean() else 1.0


def shade(values: F32, marching: Marching, rays: Rays, width: int, height: int) -> F32:
    """Premultiplied display colour and opacity ``[height, width, 4]`` of values ``[z, y, x]``."""
    share = (values - np.float32(marching.window[0])) / np.float32(marching.window[1] - marching.window[0])
    caster = _Caster(np.asarray(share, np.float32), marching)
    pixel_rays = rays.through_pixels(width, height).reshape(-1, 3).astype(np.float32)
    eye = rays.eye.astype(np.float32)
    picture = np.zeros((len(pixel_rays), 4), np.float32)
    start, stop = caster.span(eye, pixel_rays)
    meeting = np.flatnonzero(stop > start)
    cast = {"iso": caster.surface, "maximum": caster.brightest}.get(marching.look.mode, caster.march)
    for first in range(0, len(meeting), RAYS):
        part = meeting[first : first + RAYS]
        picture[part] = cast(eye, pixel_rays[part], start[part], stop[part])
    return picture.reshape(height, width, 4)


@dataclass(frozen=True, eq=False)
class _Caster:
    """Rays through shares ``[z, y, x]``; methods have the shader's names."""

    share: F32
    marching: Marching

    def span(self, eye: F32, rays: F32) -> tuple[F32, F32]:
        """Distances at which rays enter and leave the clipped box."""
        look, half = self.marching.look, self.marching.half
        low = (2 * np.array(look.clip_low, np.float32) - 1) * half
        high = (2 * np.array(look.clip_high, np.float32) - 1) * half
        safe = np.where(np.abs(rays) < 1e-9, np.float32(1e-9), rays)
        one, two = (low - eye) / safe, (high - eye) / safe
        return np.maximum(np.minimum(one, two).max(axis=1), 0), np.maximum(one, two).min(axis=1)

    def place(self, eye: F32, rays: F32, distance: F32) -> F32:
        """Places in the box, 0..1 along x, y, z."""
        return np.asarray((eye + distance[:, None] * rays) / (2 * self.marching.half) + np.float32(0.5), np.float32)

    def share_at(self, place: F32) -> F32:
        """Trilinear shares at places ``[b, 3]`` (x, y, z)."""
        size = np.array(self.share.shape[::-1], np.float32)
        inside = np.clip(place * size - np.float32(0.5), 0, size - 1)
        low = inside.astype(np.intp)
        high = np.minimum(low + 1, size.astype(np.intp) - 1)
        t = (inside - low).astype(np.float32)
        (x0, y0, z0), (x1, y1, z1) = low.T, high.T
        pairs = [self.share[z, y, x0] * (1 - t[:, 0]) + self.share[z, y, x1] * t[:, 0]
                 for z in (z0, z1) for y in (y0, y1)]
        lower = pairs[0] * (1 - t[:, 1]) + pairs[1] * t[:, 1]
        upper = pairs[2] * (1 - t[:, 1]) + pairs[3] * t[:, 1]
        return np.asarray(lower * (1 - t[:, 2]) + upper * t[:, 2], np.float32)

    def gradient_at(self, place: F32) -> F32:
        """World gradients by central differences one voxel apart, ``[b, 3]``."""
        voxel = (1 / np.array(self.share.shape[::-1], np.float32)).astype(np.float32)
        slopes = [self.share_at(place + np.eye(3, dtype=np.float32)[n] * voxel[n])
                  - self.share_at(place - np.eye(3, dtype=np.float32)[n] * voxel[n]) for n in range(3)]
        return np.asarray(np.stack(slopes, axis=1) / (4 * self.marching.half * voxel), np.float32)

    def transfer_at(self, share: F32) -> F32:
        """Colour and opacity of shares, ``[b, 4]``."""
        place = np.clip(share, 0, 1) * np.float32(255)
        low = place.astype(np.intp)
        t = (place - low)[:, None]
        table = self.marching.table
        return np.asarray(table[low] * (1 - t) + table[np.minimum(low + 1, 255)] * t, np.float32)

    def lit(self, colour: F32, gradient: F32, rays: F32) -> F32:
        """Colours lit from two sides; flat regions keep theirs."""
        look, light = self.marching.look, self.marching.light
        steepness = np.linalg.norm(gradient, axis=1, keepdims=True)
        normal = gradient / np.maximum(steepness, np.float32(1e-6))
        halfway = light - rays
        halfway = halfway / np.maximum(np.linalg.norm(halfway, axis=1, keepdims=True), 1e-6)
        diffuse = np.abs(normal @ light)[:, None]
        glance = np.abs(np.einsum("bk,bk->b", normal, halfway))[:, None]
        shaded = colour * (look.ambient + (1 - look.ambient) * diffuse) + look.specular * glance**np.float32(GLOSS)
        return np.asarray(np.where(steepness < 1e-6, colour, shaded), np.float32)

    def march(self, eye: F32, rays: F32, start: F32, stop: F32) -> F32:
        """Emission and absorption, front to back."""
        marching = self.marching
        total = np.zeros((len(rays), 4), np.float32)
        for k in range(marching.most_steps):
            distance = start + np.float32((k + 0.5) * marching.step)
            going = np.flatnonzero((distance < stop) & (total[:, 3] <= OPAQUE))
            if not len(going):
                break
            place = self.place(eye, rays[going], distance[going])
            found = self.transfer_at(self.share_at(place))
            seen = np.flatnonzero(found[:, 3] > 0)
            found, going = found[seen], going[seen]
            colour = found[:, :3]
            if marching.look.mode == "shaded":
                colour = self.lit(colour, self.gradient_at(place[seen]), rays[going])
            alpha = 1 - (1 - np.minimum(found[:, 3:], np.float32(0.9999))) ** np.float32(marching.step / marching.unit)
            sample = np.concatenate([colour, np.ones_like(alpha)], axis=1) * alpha
            total[going] += (1 - total[going, 3:]) * sample
        return total

    def brightest(self, eye: F32, rays: F32, start: F32, stop: F32) -> F32:
        """The largest share on each ray; what is next to nothing lets the background through."""
        most = np.zeros(len(rays), np.float32)
        for k in range(self.marching.most_steps):
            distance = start + np.float32((k + 0.5) * self.marching.step)
            going = np.flatnonzero(distance < stop)
            if not len(going):
                break
            most[going] = np.maximum(most[going], self.share_at(self.place(eye, rays[going], distance[going])))
        colour = self.transfer_at(most)
        colour[:, 3] = 1
        return colour * np.minimum(np.float32(FADE) * most, 1)[:, None]

    def surface(self, eye: F32, rays: F32, start: F32, stop: F32) -> F32:
        """The first crossing of the iso value, refined linearly between two steps."""
        iso = np.float32(self.marching.look.iso)
        before = self.share_at(self.place(eye, rays, start))
        crossing = np.where(before >= iso, start, np.float32(np.nan))
        last = start.copy()
        going = np.flatnonzero(before < iso)
        for k in range(1, self.marching.most_steps + 1):
            if not len(going):
                break
            distance = np.minimum(start[going] + np.float32(k * self.marching.step), stop[going])
            share = self.share_at(self.place(eye, rays[going], distance))
            hit = share >= iso
            at = going[hit]
            along = (iso - before[at]) / (share[hit] - before[at])
            crossing[at] = last[at] * (1 - along) + distance[hit] * along
            before[going], last[going] = share, distance
            going = going[~hit & (distance < stop[going])]
        picture = np.zeros((len(rays), 4), np.float32)
        met = np.flatnonzero(~np.isnan(crossing))
        place = self.place(eye, rays[met], crossing[met])
        colour = self.transfer_at(np.full(len(met), iso))[:, :3]
        picture[met, :3] = self.lit(colour, self.gradient_at(place), rays[met])
        picture[met, 3] = 1
        return picture
