"""What each pixel of a frame sees of a mesh: texture coordinates, distance, normal, tangent.

A z-buffer in NumPy, used by both render paths of Python so that their silhouettes agree: pixels in the bounds of each
projected triangle are candidates, a ray through the pixel's centre decides (Moeller and Trumbore 1997), and the nearest
hit stays. The browser rasterises the same triangles by `gbuffer.wgsl`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import radians, tan

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh
from .scene import Camera, direction

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Index = NDArray[np.intp]

NEAR = 1e-3  # what lies nearer to the eye is not seen
CANDIDATES = 1 << 21  # pairs of a pixel and a triangle looked at together: some 200 MB
EDGE = 1e-9  # two triangles that share an edge must not leave a gap between them


@dataclass(frozen=True, eq=False)
class Rays:
    """Eye and image plane of a camera: the ray of (x, y), each in -1..1, is ``forward + x * right + y * up``."""

    eye: F64
    right: F64
    up: F64
    forward: F64

    def through(self, x: F64, y: F64) -> F64:
        """Unit vectors ``[.., 3]`` through the points (x, y) of the image plane."""
        rays = self.forward + x[..., None] * self.right + y[..., None] * self.up
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    def through_pixels(self, width: int, height: int) -> F64:
        """Unit vectors ``[height, width, 3]`` through the pixels' centres."""
        x = (np.arange(width) + 0.5) * 2 / width - 1
        y = 1 - (np.arange(height) + 0.5) * 2 / height
        return self.through(*np.meshgrid(x, y))


def camera_rays(camera: Camera, aspect: float) -> Rays:
    """The rays of a camera without Nones; `aspect` is width over height.

    >>> camera_rays(Camera(0, 0, 2.0), 1.0).eye.tolist()
    [2.0, 0.0, 0.0]
    """
    azimuth, elevation = camera.azimuth or 0.0, camera.elevation or 0.0
    backward = np.array(direction(azimuth, elevation))
    right = np.array(direction(azimuth + 90.0, 0.0))
    size = tan(radians(camera.fov) / 2)
    up = np.cross(right, -backward)
    eye = np.array(camera.target) + (camera.distance or 1.0) * backward
    return Rays(eye, right * size * aspect, up * size, -backward)


@dataclass(frozen=True, eq=False)
class GBuffer:
    """Surface seen by each pixel.

    Attributes:
        surface: u, v, distance along the unit ray, 1 where there is a surface, ``[height, width, 4]``.
        normal: unit normal towards the eye and 0, ``[height, width, 4]``.
        tangent: unit tangent and handedness, ``[height, width, 4]``.
    """

    surface: F32
    normal: F32
    tangent: F32


def trace(mesh: Mesh, rays: Rays, width: int, height: int) -> GBuffer:
    """The G-buffer of a mesh.

    >>> from hmkcta.render.mesh import plane
    >>> seen = trace(plane(), camera_rays(Camera(0, 0, 3.0), 1.0), 4, 4)
    >>> seen.surface[1, 1, 3], seen.normal[1, 1, :3].tolist()
    (np.float32(1.0), [1.0, 0.0, 0.0])
    """
    corners = mesh.position.astype(np.float64)[mesh.triangles]  # [t, 3, 3]
    low, high = _bounds(corners, rays, width, height)
    counts = np.prod(np.maximum(high - low, 0), axis=1)
    depth = np.full(width * height, np.inf)
    winner = np.full(width * height, -1, np.intp)
    places = np.zeros((width * height, 2))
    pixel_rays = rays.through_pixels(width, height).reshape(-1, 3)
    ends = np.cumsum(counts)
    start = 0
    while start < len(corners):
        done = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, done + CANDIDATES, side="right")))
        chosen = np.arange(start, stop)
        triangle, pixel = _candidates(chosen, low, high, width)
        _nearest(corners, rays.eye, pixel_rays, triangle, pixel, (depth, winner, places))
        start = stop
    return _shade(mesh, winner, places, depth, pixel_rays, (height, width))


def _bounds(corners: F64, rays: Rays, width: int, height: int) -> tuple[Index, Index]:
    """First and one past the last pixel (x, y) whose centre a triangle may cover, ``[t, 2]`` each."""
    relative = corners - rays.eye
    ahead = relative @ rays.forward
    near = ahead.min(axis=1) <= NEAR  # reaches behind the eye: every pixel is a candidate
    safe = np.maximum(ahead, NEAR)
    x = relative @ rays.right / (rays.right @ rays.right) / safe
    y = relative @ rays.up / (rays.up @ rays.up) / safe
    place = np.stack([(x + 1) * width / 2 - 0.5, (1 - y) * height / 2 - 0.5], axis=-1)  # in pixel centres
    limit = np.array([width, height])
    low = np.clip(np.ceil(place.min(axis=1) - 1e-6), 0, limit)
    high = np.clip(np.floor(place.max(axis=1) + 1e-6) + 1, 0, limit)
    low[near], high[near] = 0, limit
    hidden = ahead.max(axis=1) <= NEAR
    high[hidden] = low[hidden]
    return low.astype(np.intp), high.astype(np.intp)


def _candidates(chosen: Index, low: Index, high: Index, width: int) -> tuple[Index, Index]:
    """All pairs (triangle, flat pixel) of the chosen triangles and the pixels in their bounds."""
    size = np.maximum(high[chosen] - low[chosen], 0)
    counts = size[:, 0] * size[:, 1]
    triangle = np.repeat(chosen, counts)
    within = np.arange(len(triangle)) - np.repeat(np.cumsum(counts) - counts, counts)
    across = np.repeat(size[:, 0], counts)
    x = low[triangle, 0] + within % np.maximum(across, 1)
    y = low[triangle, 1] + within // np.maximum(across, 1)
    return triangle, y * width + x


def _nearest(corners: F64, eye: F64, pixel_rays: F64, triangle: Index, pixel: Index,
             best: tuple[F64, Index, F64]) -> None:
    """Keep for each pixel the nearest hit among the candidates and what `best` (depth, triangle, place) had."""
    depth, winner, places = best
    distance, first, second = _hits(corners[triangle], eye, pixel_rays[pixel])
    hit = np.flatnonzero(np.isfinite(distance))
    order = hit[np.lexsort((triangle[hit], distance[hit], pixel[hit]))]
    ahead = order[np.diff(pixel[order], prepend=-1) != 0]  # the nearest of each pixel; the lower triangle of equals
    nearer = ahead[distance[ahead] < depth[pixel[ahead]]]
    depth[pixel[nearer]] = distance[nearer]
    winner[pixel[nearer]] = triangle[nearer]
    places[pixel[nearer]] = np.stack([first[nearer], second[nearer]], axis=1)


def _hits(corners: F64, eye: F64, rays: F64) -> tuple[F64, F64, F64]:
    """Distance along the rays ``[b, 3]`` to triangles ``[b, 3, 3]``, infinite without a hit, and where on it."""
    one, two = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    cross = np.cross(rays, two)
    volume = np.einsum("bk,bk->b", one, cross)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = eye - corners[:, 0]
        first = np.einsum("bk,bk->b", offset, cross) / volume
        turned = np.cross(offset, one)
        second = np.einsum("bk,bk->b", rays, turned) / volume
        distance = np.einsum("bk,bk->b", two, turned) / volume
        inside = (first >= -EDGE) & (second >= -EDGE) & (first + second <= 1 + EDGE) & (distance > NEAR)
    return np.where(inside, distance, np.inf), first, second


def _shade(mesh: Mesh, winner: Index, places: F64, depth: F64, pixel_rays: F64, shape: tuple[int, int]) -> GBuffer:
    """Interpolate the winners' attributes."""
    seen = np.flatnonzero(winner >= 0)
    corners = mesh.triangles[winner[seen]].astype(np.intp)
    weight = np.stack([1 - places[seen].sum(axis=1), places[seen, 0], places[seen, 1]], axis=1)
    surface, normal, tangent = (np.zeros((len(winner), 4), np.float32) for _ in range(3))

    def between(attribute: F32) -> F64:
        return np.einsum("bk,bkj->bj", weight, attribute[corners].astype(np.float64))

    surface[seen, :2] = between(mesh.uv)
    surface[seen, 2] = depth[seen]
    surface[seen, 3] = 1
    smooth = between(mesh.normal)
    place = mesh.position[corners].astype(np.float64)
    flat = np.cross(place[:, 1] - place[:, 0], place[:, 2] - place[:, 0])
    # The back of a cloth is the same material. The triangle decides, for smooth normals turn away before it does.
    towards = np.einsum("bk,bk->b", flat, smooth) * np.einsum("bk,bk->b", flat, pixel_rays[seen])
    smooth *= np.where(towards > 0, -1.0, 1.0)[:, None]
    normal[seen, :3] = smooth / np.linalg.norm(smooth, axis=1, keepdims=True)
    tangent[seen, :3] = between(mesh.tangent[:, :3])
    tangent[seen, 3] = mesh.tangent[corners[:, 0], 3]
    return GBuffer(*(array.reshape(*shape, 4) for array in (surface, normal, tangent)))
