"""What somebody should know of a result that its figures do not tell: that it is larger, or holds an offset alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..memory import drop_pages
from ..model import Model
from ..slabs import thinning

#: Elements that mean and deviation are told from.
SAMPLE = 1 << 20
#: Parts of a mapped file that are looked at one after another, as even a sample touches most of its pages.
PARTS = 64
#: An offset counts as one beyond so many deviations, and hides the values where the error is this share of one.
OFFSET, HIDDEN = 3.0, 0.5


def notes(model: Model, array: NDArray[Any]) -> list[str]:
    """Sentences about a model of an array, each with what to do next; mostly none.

    >>> import hmkcta
    >>> signal = np.sin(np.arange(3000) / 9)
    >>> notes(hmkcta.compress(signal, quality="fast"), signal)[0][:60]
    'one axis has nothing to share: every number takes two bytes.'
    """
    found: list[str] = []
    if sum(size > 1 for size in array.shape) == 1:
        found.append("one axis has nothing to share: every number takes two bytes. "
                     "Next: make windows of a signal, array.reshape(-1, 256)")
    elif model.nbytes >= array.nbytes:
        found.append(f"the file is no smaller than its source of {array.nbytes} bytes; header and tables alone take "
                     "some KiB. Next: compress more data as one array")
    mean, deviation = _moments(array)
    rmse = model.quality[-1].rmse if model.quality else 0.0
    if abs(mean) > OFFSET * deviation and rmse > HIDDEN * deviation > 0:
        found.append(f"the values are {mean:.6g} give or take {deviation:.3g}, and the RMSE is {rmse:.3g}: of what "
                     "varies the file holds little, whatever the SNR. Next: subtract the mean first")
    return found


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
