"""Whether a model holds little more of an array than its offset, which an SNR does not tell."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from .model import Model
from .support.slabs import moments

#: An offset counts as one beyond so many deviations, and hides the values where the error is this share of one.
OFFSET, HIDDEN = 3.0, 0.5
#: What values deviate by within this share of their mean is what sums of equal ones are rounded by.
EQUAL = 1e-12


def lost_beside_offset(model: Model, array: NDArray[Any]) -> str | None:
    """A sentence on a model that keeps the offset of an array and loses what varies around it; None: it does not.

    >>> import numpy as np
    >>> from hmkcta._example import example_level, example_metadata
    >>> model = Model(example_metadata(), [example_level()])  # which records an RMSE of 0.0001
    >>> lost_beside_offset(model, 1 + 1e-4 * np.arange(6.0))[:56]
    'the values are 1.00025 give or take 0.000171, and the RM'
    >>> lost_beside_offset(model, np.arange(6.0))
    """
    rmse = model.quality[-1].rmse if model.quality else 0.0
    if not rmse > 0:
        return None
    mean, deviation = moments(array)
    if not (abs(mean) > OFFSET * deviation > EQUAL * abs(mean) and rmse > HIDDEN * deviation):
        return None
    return (f"the values are {mean:.6g} give or take {deviation:.3g}, and the RMSE is {rmse:.3g}: of what varies the "
            "file holds little, whatever the SNR. Next: subtract the mean first")
