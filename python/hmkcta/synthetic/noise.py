"""Seeded noise with a chosen spectrum: the raw matter of the synthetic data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]


def wavenumber(shape: Sequence[int]) -> NDArray[np.float64]:
    """|k| in cycles per unit of the longest axis for the half spectrum that `numpy.fft.rfftn` gives.

    >>> wavenumber((4, 8))[0].tolist()
    [0.0, 1.0, 2.0, 3.0, 4.0]
    """
    longest = max(shape)
    steps = [np.fft.fftfreq(n, 1.0 / longest) for n in shape[:-1]] + [np.fft.rfftfreq(shape[-1], 1.0 / longest)]
    grids = np.meshgrid(*steps, indexing="ij", sparse=True)
    return np.sqrt(np.sum([np.broadcast_to(g * g, [len(s) for s in steps]) for g in grids], axis=0))


def power_law(shape: Sequence[int], slope: float, low: float = 1.0) -> Array:
    """Amplitudes ``k^-slope``, flat below the wavenumber `low`, none at k = 0.

    >>> power_law((1, 8), 1.0, low=2.0)[0].tolist()
    [0.0, 0.5, 0.5, 0.3333333432674408, 0.25]
    """
    k = wavenumber(shape)
    amplitude = np.maximum(k, low) ** -slope
    return np.where(k > 0, amplitude, 0.0).astype(np.float32)


def fractal_noise(rng: np.random.Generator, shape: Sequence[int], slope: float, low: float = 1.0) -> Array:
    """Periodic Gaussian noise of the given shape with a `power_law` spectrum, mean 0 and standard deviation 1.

    In the plane slope 1 is pink; 2 makes clouds; the larger, the smoother. A single element is 0.

    >>> noise = fractal_noise(np.random.default_rng(0), (32, 32), 2.0)
    >>> noise.shape, bool(abs(noise.std() - 1) < 1e-3)
    ((32, 32), True)
    """
    white = rng.standard_normal(shape, dtype=np.float32)
    noise = np.fft.irfftn(np.fft.rfftn(white) * power_law(shape, slope, low), shape, axes=range(len(shape)))
    spread = float(noise.std())
    return np.asarray(noise / spread if spread > 0 else noise, np.float32)


def smoothstep(low: float, high: float, value: NDArray[Any]) -> Array:
    """0 below `low`, 1 above `high`, a smooth cubic between.

    >>> smoothstep(0.0, 2.0, np.array([-1, 1, 3], np.float32)).tolist()
    [0.0, 0.5, 1.0]
    """
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t), np.float32)
