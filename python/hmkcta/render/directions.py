"""Interpolation among measured directions: a triangulation of the hemisphere as a table that a shader can walk.

Directions are projected stereographically, ``p = (x, y) / (1 + z)``: the hemisphere becomes the unit disk and planar
Delaunay triangles are Delaunay on the sphere. A ring of ghost points outside the disk repeats the nearest measured
direction, so that every direction lies in a triangle and nothing jumps at the border of what was measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis
from ..errors import invalid
from ..support.optional import library
from ..synthetic import hemisphere_directions

F32 = NDArray[np.float32]
U32 = NDArray[np.uint32]

GHOSTS, GHOST_RADIUS = 32, 1.25
GRID = 64  # cells a side over p in [-1, 1] squared
MOST_STEPS = 8  # of the walk from a cell's triangle to the direction's; a finer list than the grid may stop short
NO_NEIGHBOUR = 0xFFFFFFFF
VIEW_TURN = 1.2  # radians by which synthetic views are turned against lights


@dataclass(frozen=True, eq=False)
class DirectionTable:
    """Triangles over measured directions.

    Attributes:
        corners: direction indices of each triangle, ``[triangles, 3]``.
        neighbours: triangle across the edge opposite each corner, `NO_NEIGHBOUR` for none, ``[triangles, 3]``.
        weights: ``[triangles, 2, 3]``: weight of corner k = ``weights[:, k] @ (p.x, p.y, 1)``; corner 2 has the rest.
        heights: z of the corners' directions, ``[triangles, 3]``.
        grid: the triangle at the centre of each cell, ``[GRID, GRID]``, row-major by p.y.
    """

    corners: U32
    neighbours: U32
    weights: F32
    heights: F32
    grid: U32

    def records(self) -> U32:
        """What the shader reads: 16 numbers a triangle, floats as their bits; then the grid."""
        table = np.zeros((len(self.corners), 16), np.uint32)
        weights, heights = self.weights.view(np.uint32), self.heights.view(np.uint32)
        table[:, 0:3], table[:, 3] = self.corners, heights[:, 2]
        table[:, 4:7] = self.neighbours
        table[:, 8:11], table[:, 11:14] = weights[:, 0], weights[:, 1]
        table[:, 14:16] = heights[:, :2]
        return np.concatenate([table.reshape(-1), self.grid.reshape(-1)])

    def interpolate(self, directions: F32) -> tuple[U32, F32, F32]:
        """Indices ``[b, 3]`` and weights ``[b, 3]`` of unit directions ``[b, 3]``, and the z they interpolate ``[b]``.

        >>> table = build_table(np.array([[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8]]))
        >>> index, weight, _ = table.interpolate(np.array([[0.6, 0.0, 0.8]], np.float32))
        >>> int(index[0, weight[0].argmax()]), round(float(weight.max()), 5)
        (1, 1.0)
        """
        p = (directions[:, :2] / (1 + np.maximum(directions[:, 2:], 0))).astype(np.float32)
        cell = np.clip(((p + 1) * np.float32(GRID / 2)).astype(np.int64), 0, GRID - 1)
        triangle = self.grid[cell[:, 1], cell[:, 0]].astype(np.int64)
        weight = self._barycentric(triangle, p)
        for _ in range(MOST_STEPS):
            worst = weight.argmin(axis=1)
            across = self.neighbours[triangle, worst]
            move = (weight[np.arange(len(p)), worst] < 0) & (across != NO_NEIGHBOUR)
            if not move.any():
                break
            triangle = np.where(move, across, triangle).astype(np.int64)
            weight = self._barycentric(triangle, p)
        weight = np.maximum(weight, 0)
        weight /= weight.sum(axis=1, keepdims=True)
        return self.corners[triangle], weight, np.einsum("bk,bk->b", weight, self.heights[triangle])

    def _barycentric(self, triangle: NDArray[np.int64], p: F32) -> F32:
        first = np.einsum("bkj,bj->bk", self.weights[triangle][:, :, :2], p) + self.weights[triangle][:, :, 2]
        return np.concatenate([first, 1 - first.sum(axis=1, keepdims=True)], axis=1).astype(np.float32)


def build_table(directions: NDArray[Any]) -> DirectionTable:
    """The table of unit vectors ``[count, 3]`` with z >= 0, in any order.

    >>> build_table(np.array([[0, 0, 1.0]])).corners.max()
    np.uint32(0)
    """
    spatial = library("scipy.spatial", "SciPy", "render", "interpolation among directions")
    vectors = np.asarray(directions, np.float64)
    flat = vectors[:, :2] / (1 + np.maximum(vectors[:, 2:], 0))
    angle = 2 * np.pi * np.arange(GHOSTS) / GHOSTS
    ring = GHOST_RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    nearest = np.square(ring[:, None] - flat[None]).sum(axis=2).argmin(axis=1)
    points = np.concatenate([flat, ring])
    stands_for = np.concatenate([np.arange(len(flat)), nearest])

    mesh: Any = spatial.Delaunay(points)
    corners = np.asarray(mesh.simplices, np.int64)
    centres = (np.arange(GRID) + 0.5) * 2 / GRID - 1
    cells = np.stack(np.meshgrid(centres, centres), axis=-1).reshape(-1, 2)
    grid = np.maximum(np.asarray(mesh.find_simplex(cells, tol=1e-9)), 0).reshape(GRID, GRID)
    neighbours = np.asarray(mesh.neighbors, np.int64)
    indices = stands_for[corners]
    return DirectionTable(
        indices.astype(np.uint32),
        np.where(neighbours < 0, NO_NEIGHBOUR, neighbours).astype(np.uint32),
        _affine_weights(points[corners]),
        vectors[:, 2].astype(np.float32)[indices],
        grid.astype(np.uint32),
    )


def directions_of(axis: Axis) -> tuple[NDArray[np.float64], bool]:
    """Unit vectors ``[size, 3]`` of a light or view axis, and whether they are assumed because it has no coordinates.

    >>> directions_of(Axis("light", 2, "light", np.array([[0, 0], [60, 90]]), "degrees"))[0].round(3).tolist()
    [[0.0, 0.0, 1.0], [0.0, 0.866, 0.5]]

    Raises:
        HmkctaError: the coordinates are no directions of the upper hemisphere.
    """
    if axis.coords is None:
        turn = VIEW_TURN if axis.role == "view" else 0.0
        return hemisphere_directions(axis.size, turn).astype(np.float64), True
    coords = np.asarray(axis.coords, np.float64)
    if coords.shape == (axis.size, 2):
        zenith, azimuth = (np.radians(coords) if "deg" in axis.unit.lower() else coords).T
        vectors = np.stack([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)], axis=1)
    elif coords.shape == (axis.size, 3):
        vectors = coords
    else:
        allowed = f"[{axis.size}, 3] unit vectors or [{axis.size}, 2] (zenith, azimuth)"
        raise invalid("directions-shape", f"coords of axis {axis.name!r}", f"shape {coords.shape}", allowed)
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    bad = ~((length[:, 0] > 1e-6) & (vectors[:, 2] > -0.2 * length[:, 0]))
    if bad.any():
        row = int(np.argmax(bad))
        radians = coords.shape[1] == 2 and "deg" not in axis.unit.lower()
        raise invalid("bad-direction", f"coords of axis {axis.name!r}, row {row}", coords[row].tolist(),
                      "directions with z along the normal, above the surface",
                      f"if these are degrees say so, --unit {axis.name}=degrees" if radians else "")
    unit = vectors / length
    unit[:, 2] = np.maximum(unit[:, 2], 0.0)  # hand-held measurements dip a little below the horizon
    return unit, False


def _affine_weights(triangle: NDArray[np.float64]) -> F32:
    """Barycentric weights of corners 0 and 1 as affine functions of p, of triangles ``[n, 3 corners, 2]``."""
    (x0, y0), (x1, y1), (x2, y2) = (triangle[:, k].T for k in range(3))
    area = (y1 - y2) * (x0 - x2) + (x2 - x1) * (y0 - y2)
    area = np.where(np.abs(area) < 1e-14, 1e-14, area)
    a0, b0, a1, b1 = (y1 - y2) / area, (x2 - x1) / area, (y2 - y0) / area, (x0 - x2) / area
    rows = [[a0, b0, -(a0 * x2 + b0 * y2)], [a1, b1, -(a1 * x2 + b1 * y2)]]
    return np.ascontiguousarray(np.moveaxis(np.array(rows), 2, 0), np.float32)
