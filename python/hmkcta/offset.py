"""Whether a model holds little more of an array than its offset, which an SNR does not tell."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .model import Model
from .support.memory import drop_pages
from .support.slabs import thinning

#: Elements that mean and deviation are told from.
SAMPLE = 1 << 20
#: Parts of a mapped file that are looked at one after another, as even a sample touches most of its pages.
PARTS = 64
#: An offset counts as one beyond so many deviations, and hides the values where the error is this share of one.
OFFSET, HIDDEN = 3.0, 0.5


def lost_beside_offset(model: Model, array: NDArray[Any]) -> str | None:
    """A sentence on a model that keeps the offset of an array and loses what varies around it; None: it does not.

    >>> from hmkcta._example import example_level, example_metadata
    >>> model = Model(example_metadata(), [example_level()])  # which records an RMSE of 0.0001
    >>> lost_beside_offset(model, 1 + 1e-4 * np.arange(6.0))[:56]
    'the values are 1.00025 give or take 0.000171, and the RM'
    >>> lost_beside_offset(model, np.arange(6.0))
    """
    rmse = model.quality[-1].rmse if model.quality else 0.0
    if not rmse > 0:
        return None
    mean, deviation = _moments(array)
    if not (abs(mean) > OFFSET * deviation and rmse > HIDDEN * deviation > 0):
        return None
    return (f"the values are {mean:.6g} give or take {deviation:.3g}, and the RMSE is {rmse:.3g}: of what varies the "
            "file holds little, whatever the SNR. Next: subtract the mean first")


def _moments(array: NDArray[Any]) -> tuple[float, float]:
    """Mean and standard deviation of the finite numbers of a sample."""
    steps = thinning(array.shape, SAMPLE)
    parts: list[NDArray[np.float64]] = []
    length = steps[0] * -(-array.shape[0] // (steps[0] * PARTS))
    for start in range(0, array.shape[0], length):
        spans = (slice(start, start + length, steps[0]), *(slice(None, None, step) for step in steps[1:]))
        sample = np.asarray(array[spans], np.float64)
        parts.append(sample[np.isfinite(sample)])
        drop_pages(array)
    finite = np.concatenate(parts)
    return (float(finite.mean()), float(finite.std())) if finite.size else (0.0, 0.0)
