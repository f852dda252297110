"""A light field of a layered, moving scene: parallax between the layers, occlusion, a camera grid and frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..axes import name_axes
from .dataset import Dataset, checked_count
from .noise import fractal_noise, smoothstep

Array = NDArray[np.float32]

LEAVES = 90
DESIGN_SIZE = 96.0  # pixels for which disparities and motions below are given; other sizes scale them


@dataclass(frozen=True, eq=False)
class Layer:
    """A flat picture ``[y, x]`` in the scene with its coverage, in [0, 1], larger than a view by `margin` all around.

    `disparity` is how many pixels it moves from one camera to the next (near layers more), `motion` (y, x) from one
    frame to the next.
    """

    shade: Array
    cover: Array
    margin: int
    disparity: float = 0.0
    motion: tuple[float, float] = (0.0, 0.0)

    def window(self, size: int, camera: tuple[float, float], time: float) -> tuple[Array, Array]:
        """Premultiplied shade and coverage ``[size, size]`` as the camera (row, column from the middle) sees them."""
        corner = [self.margin + c * self.disparity - m * time for c, m in zip(camera, self.motion, strict=True)]
        return _shifted(self.shade * self.cover, size, corner), _shifted(self.cover, size, corner)


def light_field(views: int = 9, size: int = 96, frames: int = 8, seed: int = 0) -> Dataset:
    """Brightness 0..1, display-ready, ``[row, column, y, x, time]`` float32 from ``views x views`` cameras.

    Far to near: a brick wall, a ball that rolls behind foliage, foliage, a ball in front of it, a fence.

    Args:
        views: cameras in a row, and in a column.
        size: pixels along y and along x, at least 4.
        frames: time steps.
        seed: the same one makes the same scene.

    Raises:
        HmkctaError: reason ``size-too-small``.

    >>> small = light_field(views=2, size=12, frames=2)
    >>> small.names, small.values.shape
    (('row', 'column', 'y', 'x', 'time'), (2, 2, 12, 12, 2))
    """
    views, size, frames = checked_count("views", views), checked_count("size", size, 4), checked_count("frames", frames)
    layers = _scene(np.random.default_rng(seed), views, size, frames)
    values = np.empty((views, views, size, size, frames), np.float32)
    middle, halfway = (views - 1) / 2, (frames - 1) / 2
    for row, column, frame in np.ndindex(views, views, frames):
        picture = np.zeros((size, size), np.float32)
        for layer in layers:
            shade, cover = layer.window(size, (row - middle, column - middle), frame - halfway)
            picture += shade - cover * picture
        values[row, column, :, :, frame] = picture
    return Dataset(values, name_axes(values.shape, ["row", "column", "y", "x", "time"]), "lightfield")


def _scene(rng: np.random.Generator, views: int, size: int, frames: int) -> list[Layer]:
    """The layers, far to near."""
    unit = size / DESIGN_SIZE
    margin = int(np.ceil(unit * (1.5 * views / 2 + 3.0 * frames / 2))) + 2  # the largest disparity and motion below
    y, x = _grid(size, margin)
    one = np.ones_like(x)
    wall = Layer(_bricks(rng, y, x), one, margin, -0.4 * unit, (0.0, 0.15 * unit))
    bush = _foliage(rng, y, x, margin, 0.35 * unit, (0.0, -0.2 * unit))
    bars = np.maximum(smoothstep(0.035, 0.022, abs((x + 0.05 * y) % 0.34 - 0.17)), smoothstep(0.03, 0.02, abs(y - 0.8)))
    fence = Layer(np.clip(0.13 + 0.04 * fractal_noise(rng, x.shape, 1.0), 0.0, 1.0), bars, margin, 1.4 * unit)
    far = _ball(y, x, margin, (0.36, 0.55), 0.17, 0.0 * unit, (0.4 * unit, -2.4 * unit))
    near = _ball(y, x, margin, (0.62, 0.42), 0.15, 0.8 * unit, (-0.6 * unit, 2.8 * unit))
    return [wall, far, bush, near, fence]


def _grid(size: int, margin: int) -> tuple[Array, Array]:
    """y and x of a layer's pixels in widths of a view, from the view's corner."""
    place = ((np.arange(size + 2 * margin) - margin + 0.5) / size).astype(np.float32)
    y, x = np.meshgrid(place, place, indexing="ij")
    return y, x


def _bricks(rng: np.random.Generator, y: Array, x: Array) -> Array:
    """A brick wall, lit from the upper left, ``[y, x]``."""
    rows = np.floor(y * 9.0)
    along = x * 4.5 + 0.5 * (rows % 2)
    joint = np.maximum(smoothstep(0.42, 0.48, abs(y * 9.0 - rows - 0.5)),
                       smoothstep(0.46, 0.485, abs(along - np.floor(along) - 0.5)))
    tint = rng.uniform(-0.1, 0.1, 4096)[((rows * 61 + np.floor(along) * 7) % 4096).astype(np.int64)]
    shade = 0.52 + tint + 0.05 * fractal_noise(rng, x.shape, 0.9) + 0.06 * fractal_noise(rng, x.shape, 2.0)
    lit = 1.12 - 0.35 * x - 0.2 * y
    return np.clip((shade + joint * (0.72 - shade)) * lit, 0.0, 1.0).astype(np.float32)


def _ball(
    y: Array, x: Array, margin: int, middle: tuple[float, float], radius: float, disparity: float,
    motion: tuple[float, float],
) -> Layer:
    """A glossy striped ball; `middle` (y, x) and `radius` in widths of a view."""
    v, u = (y - middle[0]) / radius, (x - middle[1]) / radius
    square = u * u + v * v
    height = np.sqrt(np.maximum(1.0 - square, 0.0))
    facing = np.clip(-0.45 * u - 0.55 * v + 0.7 * height, 0.0, 1.0)
    stripes = 0.5 + 0.5 * np.tanh(6.0 * np.sin(9.0 * np.arcsin(np.clip(0.8 * u + 0.6 * v, -1.0, 1.0))))
    shade = 0.1 + facing * (0.35 + 0.45 * stripes) + 0.9 * facing**40
    edge = 1.5 / (radius * len(x))
    cover = smoothstep(1.0 + edge, 1.0 - edge, np.sqrt(square))
    return Layer(np.clip(shade, 0.0, 1.0).astype(np.float32), cover, margin, disparity, motion)


def _foliage(
    rng: np.random.Generator, y: Array, x: Array, margin: int, disparity: float, motion: tuple[float, float]
) -> Layer:
    """Leaves in two clumps, each lit by how it hangs, the later over the earlier."""
    shade, cover = np.zeros_like(x), np.zeros_like(x)
    for _ in range(LEAVES):
        clump = (0.15, 0.2) if rng.random() < 0.5 else (0.7, 0.85)
        place, angle, light = rng.normal(clump, (0.17, 0.14)), rng.uniform(0, np.pi), rng.uniform(0.15, 0.5)
        along = (x - place[1]) * np.cos(angle) + (y - place[0]) * np.sin(angle)
        across = (y - place[0]) * np.cos(angle) - (x - place[1]) * np.sin(angle)
        inside = 1.0 - (along / 0.085) ** 2 - abs(across) / 0.03  # 1 on the vein, 0 at the rim
        leaf = smoothstep(0.0, 0.25, inside)
        shade += leaf * (light * (0.75 + 0.25 * np.sign(across)) + 0.15 * smoothstep(0.85, 1.0, inside) - shade)
        cover += leaf * (1.0 - cover)
    return Layer(np.asarray(shade / np.maximum(cover, 1e-3), np.float32), cover, margin, disparity, motion)


def _shifted(picture: Array, size: int, corner: list[float]) -> Array:
    """The window of ``size x size`` pixels whose corner (y, x) lies between pixels, by linear interpolation."""
    top, left = (int(np.floor(c)) for c in corner)
    down, right = corner[0] - top, corner[1] - left
    window = picture[top:top + size + 1, left:left + size + 1]
    columns = window[:, :-1] + right * (window[:, 1:] - window[:, :-1])
    return np.asarray(columns[:-1] + down * (columns[1:] - columns[:-1]), np.float32)
