"""Interpolation on a product grid of directions: one axis of zeniths and one of azimuths, bilinear in the angles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import tau

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis
from ..errors import invalid

F32 = NDArray[np.float32]
U32 = NDArray[np.uint32]

#: A name with one of these is that of azimuths.
_AZIMUTH = ("phi", "azim")


@dataclass(frozen=True, eq=False)
class AngleList:
    """The angles of one axis, ascending, in radians ``[k]``, k at least 2, and their indices ``[k]``."""

    angle: F32
    index: U32

    def interpolate(self, angle: F32) -> tuple[U32, F32]:
        """Indices ``[b, 2]`` and weights ``[b, 2]`` of angles ``[b]``; beyond the list the last one counts alone.

        >>> index, weight = AngleList(np.float32([0, 1]), np.uint32([4, 7])).interpolate(np.float32([0.25, 2]))
        >>> index.tolist(), weight.tolist()
        ([[4, 7], [4, 7]], [[0.75, 0.25], [0.0, 1.0]])
        """
        first = np.clip(np.searchsorted(self.angle, angle, side="right") - 1, 0, len(self.angle) - 2)
        gap = np.maximum(self.angle[first + 1] - self.angle[first], np.float32(1e-6))
        share = np.clip((angle - self.angle[first]) / gap, 0, 1).astype(np.float32)
        return np.stack([self.index[first], self.index[first + 1]], axis=1), np.stack([1 - share, share], axis=1)

    def records(self) -> U32:
        """What the shader reads: for each angle its bits and its index, in four words."""
        words = np.zeros((len(self.angle), 4), np.uint32)
        words[:, 0], words[:, 1] = self.angle.view(np.uint32), self.index
        return words.reshape(-1)


@dataclass(frozen=True, eq=False)
class AngleGrid:
    """Zeniths and azimuths, and the numbers of their axes."""

    axes: tuple[int, int]
    zenith: AngleList
    azimuth: AngleList

    def interpolate(self, directions: F32) -> tuple[list[tuple[U32, F32]], F32]:
        """For both axes indices and weights ``[b, 2]`` of unit directions ``[b, 3]``, and the z measured there.

        >>> theta = Axis("theta", 2, "light", np.array([0, 60]), "degrees")
        >>> phi = Axis("phi", 2, "light", np.array([0, 180]), "degrees")
        >>> (zenith, azimuth), height = angle_grid((theta, phi), (0, 1)).interpolate(np.float32([[0, 1, 0]]))
        >>> zenith[0].tolist(), azimuth[1].round(3).tolist(), height.round(3).tolist()
        ([[0, 1]], [[0.5, 0.5]], [0.5])
        """
        zenith = np.arctan2(np.hypot(directions[:, 0], directions[:, 1]), directions[:, 2])
        azimuth = np.arctan2(directions[:, 1], directions[:, 0])
        azimuth = np.where(azimuth < 0, azimuth + np.float32(tau), azimuth).astype(np.float32)
        within = np.clip(zenith, self.zenith.angle[0], self.zenith.angle[-1])
        return [self.zenith.interpolate(zenith), self.azimuth.interpolate(azimuth)], np.cos(within)


def angle_grid(axes: Sequence[Axis], numbers: tuple[int, int]) -> AngleGrid:
    """The grid of two axes with one angle an index: zenith first, unless the first one's name says azimuth.

    Raises:
        HmkctaError: an axis has no angles as coordinates, or zeniths reach below the surface.
    """
    zenith, azimuth = numbers
    if any(part in axes[zenith].name.lower() for part in _AZIMUTH):
        zenith, azimuth = azimuth, zenith
    down = _angles(axes[zenith])
    if (np.cos(down) < -0.2).any() or (down < 0).any():
        raise invalid("bad-direction", f"coords of axis {axes[zenith].name!r}", np.degrees(down).tolist(),
                      "zenith angles above the surface, 0 to 90 degrees from the normal",
                      "give the unit 'degrees' if they are in degrees")
    turned = _angles(axes[azimuth]) % tau
    order = np.argsort(turned, kind="stable")
    around = np.concatenate([order[-1:], order, order[:1]])  # once around, and one more at either end
    angle = turned[around] + tau * np.array([-1, *[0] * len(order), 1])
    down = np.minimum(down, np.pi / 2)  # hand-held measurements dip a little below the horizon
    rise = np.argsort(down, kind="stable")
    rise = rise if len(rise) > 1 else np.repeat(rise, 2)  # there are always two to be between
    return AngleGrid((zenith, azimuth), AngleList(down[rise].astype(np.float32), rise.astype(np.uint32)),
                     AngleList(angle.astype(np.float32), around.astype(np.uint32)))


def _angles(axis: Axis) -> NDArray[np.float64]:
    """The coordinates of an axis in radians."""
    coords = None if axis.coords is None else np.asarray(axis.coords, np.float64)
    if coords is None or coords.shape != (axis.size,):
        found = "none" if coords is None else f"shape {coords.shape}"
        raise invalid("directions-shape", f"coords of axis {axis.name!r}", found, f"[{axis.size}] angles",
                      "one of two axes of lights or views has zeniths, the other one azimuths")
    return np.radians(coords) if "deg" in axis.unit.lower() else coords
