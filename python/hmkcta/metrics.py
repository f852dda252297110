"""SNR in dB, the paper's measure of quality, and the sums of squares it is made of."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, log10
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Numbers turned to float64 at a time: they stay in the cache.
_WIDE = 1 << 16


def snr_db(signal: float, noise: float) -> float:
    """``10 log10(sum a^2 / sum (a-b)^2)`` from the two sums; infinite where there is no error, whatever the signal.

    >>> snr_db(100.0, 1.0), snr_db(0.0, 0.0), snr_db(0.0, 1.0)
    (20.0, inf, -inf)
    """
    return inf if noise == 0 else -inf if signal == 0 else 10 * log10(signal / noise)


def noise_at(snr: float, signal: float = 1.0) -> float:
    """The sum of squared errors that an SNR in dB allows: ``signal 10^(-snr / 10)``.

    >>> noise_at(20.0, 100.0)
    1.0
    """
    return signal * 10 ** (-snr / 10)


def squared_norm(tensor: NDArray[np.float32]) -> float:
    """Sum of squares in float64, piece by piece.

    >>> squared_norm(np.full((1000, 1000), 0.5, np.float32))
    250000.0
    """
    return sum(float(wide @ wide) for wide in in_float64(tensor))


def in_float64(tensor: NDArray[np.float32]) -> Iterator[NDArray[np.float64]]:
    """The numbers of a tensor in C order, some at a time."""
    flat = tensor.reshape(-1)
    return (flat[start : start + _WIDE].astype(np.float64) for start in range(0, flat.size, _WIDE))


def all_finite(values: NDArray[np.floating[Any]]) -> bool:
    """Whether no number is infinite or NaN; their sum nearly always tells, at a tenth of the cost."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(np.add.reduce(values, axis=None)) or np.isfinite(values).all())
