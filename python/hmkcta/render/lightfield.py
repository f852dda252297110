"""Light-field renderer in NumPy, the readable twin of `lightfield.wgsl` (paper, section 5.2).

A view between the cameras is the weighted mean of theirs, each shifted by what lies in focus: bilinear over the nearest
two cameras each way, or over an aperture of cameras, which blurs what is out of focus.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis
from ..errors import invalid
from .grid import Index
from .layout import Layout
from .scene import Scene, Viewpoint

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

MOST_SLICES = 2048  # depth of a 3D texture that WebGPU guarantees


@dataclass(frozen=True, eq=False)
class Cameras:
    """Positions ``[cameras, 2]`` (row, column) in steps of the camera grid, and the view axes' indices of each."""

    place: F64
    index: Index
    rows: int
    columns: int

    @property
    def regular(self) -> bool:
        """Whether they are a full grid, numbered row by row."""
        row, column = np.divmod(np.arange(len(self.place)), self.columns)
        return len(self.place) == self.rows * self.columns and bool((self.place == np.stack([row, column], 1)).all())


@dataclass(frozen=True, eq=False)
class Aim:
    """The cameras a view needs: their view-axis indices ``[n, view axes]``, weights ``[n]``, shifts (y, x)."""

    index: Index
    weight: F32
    shift: F32


def find_cameras(axes: Sequence[Axis], layout: Layout) -> Cameras:
    """Where the cameras stand.

    Two view axes are row and column. One has positions as coordinates ``[cameras, 2]`` (row, column), taken in units of
    their smallest step; without, a square number of cameras is taken for a square grid, any other for one row.

    >>> from hmkcta.axes import name_axes
    >>> from hmkcta.render.layout import lay_out
    >>> axes = name_axes((9, 8, 8), ["view", "y", "x"])
    >>> find_cameras(axes, lay_out(axes, "lightfield")).place[5].tolist()
    [1.0, 2.0]
    """
    sizes = [axes[n].size for n in layout.views]
    if len(sizes) == 2:
        row, column = (a.reshape(-1) for a in np.indices(sizes))
        return Cameras(np.stack([row, column], 1).astype(np.float64), np.stack([row, column], 1), *sizes)
    axis = axes[layout.views[0]]
    number = np.arange(axis.size)[:, None]
    if axis.coords is not None and np.shape(axis.coords) == (axis.size, 2):
        place = np.asarray(axis.coords, np.float64)
        place = place - place.min(axis=0)
        steps: list[float] = np.concatenate([np.sort(along)[1:] - np.sort(along)[:-1] for along in place.T]).tolist()
        place /= min((step for step in steps if step > 1e-9), default=1.0)
        whole = np.floor(place + 0.5)
        place = np.asarray(np.where(np.abs(place - whole) < 1e-4, whole, place), np.float64)
        rows, columns = int(place[:, 0].max()) + 1, int(place[:, 1].max()) + 1
        return Cameras(place, number, rows, columns)
    side = round(axis.size**0.5)
    columns = side if side * side == axis.size else axis.size
    place = np.stack(np.divmod(np.arange(axis.size), columns), axis=1).astype(np.float64)
    return Cameras(place, number, axis.size // columns, columns)


def aim(cameras: Cameras, view: Viewpoint) -> Aim:
    """Cameras, weights and shifts of a view point.

    Raises:
        HmkctaError: the view point lies outside the cameras.
    """
    last = cameras.place.max(axis=0)
    middle = last / 2
    place = np.array([middle[0] if view.row is None else view.row, middle[1] if view.column is None else view.column])
    for name, at, most in zip(("row", "column"), place.tolist(), last.tolist(), strict=True):
        if not 0 <= at <= most:
            raise invalid("viewpoint-outside", f"viewpoint.{name}", at, f"0 to {most:g} (cameras)")
    offset = cameras.place - place
    if view.aperture > 0 or not cameras.regular:
        reach = view.aperture + 1
        weight = np.maximum(0.0, 1 - np.hypot(offset[:, 0], offset[:, 1]) / reach)
        if not weight.any():  # scattered cameras, none within reach
            weight[np.hypot(offset[:, 0], offset[:, 1]).argmin()] = 1
    else:
        weight = np.prod(np.maximum(0.0, 1 - np.abs(offset)), axis=1)
    used = np.flatnonzero(weight > 0)
    share = weight[used] / weight[used].sum()
    shift = view.focus * offset[used]
    return Aim(cameras.index[used], share.astype(np.float32), shift.astype(np.float32))


def camera_slices(layout: Layout, aimed: Aim) -> Index:
    """The slices to decode: one for each camera and shown channel.

    Raises:
        HmkctaError: more than a texture holds.
    """
    shown = len(layout.channels)
    if len(aimed.index) * shown > MOST_SLICES:
        raise invalid("aperture-too-large", "viewpoint.aperture", f"{len(aimed.index)} cameras of {shown} channels",
                      f"up to {MOST_SLICES} pictures", "choose a smaller aperture")
    slices = np.tile(np.array(layout.stands, np.intp), (len(aimed.index) * shown, 1))
    for n, axis in enumerate(layout.views):
        slices[:, axis] = np.repeat(aimed.index[:, n], shown)
    if layout.channel is not None:
        slices[:, layout.channel] = np.tile(np.array(layout.channels, np.intp), len(aimed.index))
    return slices


def fit(scene: Scene, rows: int, columns: int) -> tuple[float, float, float]:
    """Camera pixels a frame pixel, and the camera pixel (y, x) at the centre of the frame's first one: fitted, centred.

    >>> fit(Scene(width=8, height=4), 2, 2)
    (0.5, -0.25, -1.25)
    """
    scale = max(rows / scene.height, columns / scene.width) / scene.viewpoint.zoom
    return scale, (rows - 1) / 2 - scale * (scene.height - 1) / 2, (columns - 1) / 2 - scale * (scene.width - 1) / 2


def shade(decoded: F32, aimed: Aim, channels: int, scene: Scene) -> F32:
    """Radiance and coverage ``[height, width, 4]`` from pictures ``[cameras * channels, rows, columns]``."""
    rows, columns = decoded.shape[1:]
    scale, top, left = fit(scene, rows, columns)
    y = (np.float32(top) + np.float32(scale) * np.arange(scene.height, dtype=np.float32))[:, None]
    x = (np.float32(left) + np.float32(scale) * np.arange(scene.width, dtype=np.float32))[None, :]
    picture = np.zeros((scene.height, scene.width, 4), np.float32)
    for n, (weight, (down, right)) in enumerate(zip(aimed.weight, aimed.shift, strict=True)):
        for c in range(3):
            seen = decoded[n * channels + min(c, channels - 1)]
            picture[:, :, c] += weight * _between_pixels(seen, y + down, x + right)
    inside = (y >= -0.5) & (y <= rows - 0.5) & (x >= -0.5) & (x <= columns - 0.5)
    picture[:, :, 3] = 1
    return np.where(inside[:, :, None], picture, np.float32(0))


def _between_pixels(picture: F32, y: F32, x: F32) -> F32:
    """Bilinear values at rows y ``[h, 1]`` and columns x ``[1, w]``; beyond the border it goes on as it is there."""
    rows, columns = picture.shape
    y, x = np.clip(y, 0, rows - 1), np.clip(x, 0, columns - 1)
    top, left = y.astype(np.intp), x.astype(np.intp)
    below, right = np.minimum(top + 1, rows - 1), np.minimum(left + 1, columns - 1)
    down, across = (y - top).astype(np.float32), (x - left).astype(np.float32)
    upper = picture[top, left] * (1 - across) + picture[top, right] * across
    lower = picture[below, left] * (1 - across) + picture[below, right] * across
    return np.asarray(upper * (1 - down) + lower * down, np.float32)
