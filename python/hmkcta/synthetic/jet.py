"""A turbulent jet: dye carried by a jet and by eddies whose velocity has no divergence, as a time-varying volume."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..axes import name_axes
from .dataset import Dataset, checked_count
from .noise import fractal_noise, power_law, smoothstep, wavenumber

Array = NDArray[np.float32]

FRAMES_TO_CROSS = 32.0  # frames in which the jet's core crosses the longest axis
WARM_UP = 16  # frames before the first one stored, so that the eddies have rolled up the dye
EDDY_SPEED = 0.28  # of the jet's speed, root mean square in the jet's core
EDDY_LOW = 3.0  # wavenumber of the largest eddies: the jet's width
KOLMOGOROV = 17.0 / 6.0  # potential ~ k^-17/6 gives velocity ~ k^-11/6, an energy spectrum k^-5/3
EDDY_DRIFT = 0.7  # of the jet's speed: it carries its eddies along
EDDY_TURN = 0.25  # radians a frame by which an eddy of wavenumber 3 changes; others as k^2/3
DYE_SLOPE = 1.9  # fine structure of the dye as it leaves the nozzle
NOZZLE, JET = 0.17, 0.25  # radii over the shortest axis
LARGEST_STEP = 2.5  # voxels the dye may move in one step


@dataclass(frozen=True, eq=False)
class Eddies:
    """A random vector potential as spectra ``[3, z, y, x // 2 + 1]`` whose phases turn by `turning` radians a frame."""

    spectrum: NDArray[np.complex64]
    turning: Array
    envelope: Array
    speed: float

    def velocity(self, time: float) -> Array:
        """Velocity ``[3 (z, y, x), z, y, x]`` in voxels a frame, the curl of the potential within the envelope."""
        turned = self.spectrum * np.exp(1j * np.float32(time) * self.turning)
        shape = self.envelope.shape
        potential = np.stack([np.fft.irfftn(part, shape, axes=(0, 1, 2)) for part in turned])
        return curl(np.asarray(potential * self.envelope, np.float32)) * np.float32(self.speed)


def volume(size: int | Sequence[int] = 64, frames: int = 32, seed: int = 0) -> Dataset:
    """Dye of a turbulent jet along x, 0..1, ``[time, z, y, x]`` float32; `size` is one number or (z, y, x).

    The dye enters with fine structure, the eddies fold it ever finer; much of the volume around the jet stays empty.

    Args:
        size: voxels along each axis, at least 4; or of (z, y, x).
        frames: time steps.
        seed: the same one makes the same jet.

    Raises:
        HmkctaError: reason ``size-too-small``.

    >>> small = volume((4, 8, 12), frames=2)
    >>> small.names, small.values.shape
    (('time', 'z', 'y', 'x'), (2, 4, 8, 12))
    """
    sizes = (size, size, size) if isinstance(size, int) else tuple(size)
    shape = tuple(checked_count(f"size of {name}", n, 4) for name, n in zip("zyx", sizes, strict=True))
    values = np.empty((checked_count("frames", frames), *shape), np.float32)
    for frame, dye in zip(values, _simulate(np.random.default_rng(seed), shape), strict=False):
        frame[...] = dye
    return Dataset(values, name_axes(values.shape, ["time", "z", "y", "x"]), "volume")


def curl(potential: Array) -> Array:
    """Curl of a periodic field ``[3 (z, y, x), z, y, x]`` by central differences, whose divergence is 0 the same way.

    >>> flow = curl(np.random.default_rng(0).random((3, 8, 8, 8), dtype=np.float32))
    >>> bool(abs(sum(_slope(flow[n], n) for n in range(3))).max() < 1e-6)
    True
    """
    z, y, x = potential
    return np.stack([_slope(y, 2) - _slope(x, 1), _slope(x, 0) - _slope(z, 2), _slope(z, 1) - _slope(y, 0)])


def advect(field: Array, displacement: Array) -> Array:
    """The field moved by a displacement ``[3, z, y, x]`` in voxels: semi-Lagrangian with MacCormack's correction.

    >>> ramp = np.broadcast_to(np.arange(6, dtype=np.float32), (2, 2, 6))
    >>> advect(ramp, np.broadcast_to(np.float32(0.5), (3, 2, 2, 6)))[0, 0].tolist()
    [0.0, 0.5, 1.5, 2.5, 3.5, 4.5]
    """
    there = _sample(field, displacement, -1.0)
    back = _sample(there.value, displacement, 1.0)
    correction = np.where(back.inside, 0.5 * (field - back.value), 0.0)  # none where the way back left the volume
    return np.asarray(np.clip(there.value + correction, there.low, there.high), np.float32)  # no overshoot


def _simulate(rng: np.random.Generator, shape: tuple[int, ...]) -> Iterator[Array]:
    """Frames of dye without end, after the warm-up."""
    longest = max(shape)
    radius = _radius(shape)  # from the jet's axis over the shortest axis, [z, y, 1]
    jet = longest / FRAMES_TO_CROSS * np.exp(-((radius / JET) ** 2))  # voxels a frame
    eddies = _eddies(rng, shape, radius, float(jet.max()))
    nozzle = smoothstep(NOZZLE, 0.75 * NOZZLE, radius)
    fresh = nozzle * np.clip(0.62 + 0.22 * fractal_noise(rng, shape, DYE_SLOPE, low=3.0), 0.0, 1.0)

    steps = max(1, round(longest / FRAMES_TO_CROSS / LARGEST_STEP))
    inlet = int(longest / FRAMES_TO_CROSS / steps) + 2  # slices that one step may empty
    dye = np.asarray(fresh, np.float32)
    frame = 0
    while True:
        if frame >= WARM_UP:
            yield dye
        for step in range(steps):
            time = frame + step / steps
            flow = eddies.velocity(time)
            flow[2] += jet
            dye = advect(dye, flow / np.float32(steps))
            passed = round(time * longest / FRAMES_TO_CROSS)
            dye[:, :, :inlet] = np.roll(fresh, passed, axis=2)[:, :, :inlet]
        frame += 1


def _eddies(rng: np.random.Generator, shape: tuple[int, ...], radius: Array, jet: float) -> Eddies:
    """Eddies that are strongest in the jet, which widens downstream."""
    white = rng.standard_normal((3, *shape), dtype=np.float32)
    spectrum = np.fft.rfftn(white, axes=(1, 2, 3)) * power_law(shape, KOLMOGOROV, low=EDDY_LOW)
    drift = 2.0 * np.pi * np.fft.rfftfreq(shape[2]) * EDDY_DRIFT * jet  # radians a frame
    turning = EDDY_TURN * (wavenumber(shape) / EDDY_LOW) ** (2.0 / 3.0) - drift
    downstream = (np.arange(shape[2]) + 0.5) / shape[2]
    envelope = 0.25 + 0.75 * np.exp(-((radius / (JET + 0.16 * downstream)) ** 2))
    unscaled = Eddies(spectrum.astype(np.complex64), turning.astype(np.float32), np.ones(shape, np.float32), 1.0)
    speed = float(np.sqrt(np.square(unscaled.velocity(0.0)).mean()))
    scale = EDDY_SPEED * jet / max(speed, 1e-12)
    return Eddies(unscaled.spectrum, unscaled.turning, envelope.astype(np.float32), scale)


def _radius(shape: tuple[int, ...]) -> Array:
    """Distance from the jet's axis over the shorter of z and y, ``[z, y, 1]``."""
    z, y = (np.arange(n) + 0.5 - n / 2 for n in shape[:2])
    return (np.hypot(z[:, None], y[None, :])[:, :, None] / min(shape[:2])).astype(np.float32)


def _slope(field: Array, axis: int) -> Array:
    """Central difference of a periodic field along an axis."""
    return np.asarray(0.5 * (np.roll(field, -1, axis) - np.roll(field, 1, axis)), np.float32)


class _Sampled(NamedTuple):
    """A field's `value` linear between 8 voxels, the least and most of these, and whether the place was inside."""

    value: Array
    low: Array
    high: Array
    inside: NDArray[np.bool_]


def _sample(field: Array, displacement: Array, sign: float) -> _Sampled:
    """The field at ``position + sign displacement``; beyond its faces it goes on as it is there."""
    index, inside = np.zeros(field.shape, np.int64), np.ones(field.shape, np.bool_)
    weight: list[Array] = []
    strides = [int(np.prod(field.shape[n + 1:])) for n in range(3)]
    for n, (size, stride) in enumerate(zip(field.shape, strides, strict=True)):
        place = np.arange(size, dtype=np.float32).reshape(-1, *[1] * (2 - n)) + np.float32(sign) * displacement[n]
        inside &= (place >= 0) & (place <= size - 1)
        np.clip(place, 0.0, size - 1, out=place)
        whole = np.minimum(place.astype(np.int64), size - 2)
        weight.append(place - whole)
        index += whole * stride

    corners = np.stack([np.take(field, index + (a * strides[0] + b * strides[1] + c * strides[2]))
                        for a in (0, 1) for b in (0, 1) for c in (0, 1)])
    low, high = corners.min(axis=0), corners.max(axis=0)
    for fraction in reversed(weight):  # x, then y, then z halves the corners
        corners = corners[::2] + fraction * (corners[1::2] - corners[::2])
    return _Sampled(corners[0], low, high, inside)
