"""SNR in dB, the paper's measure of quality."""

from __future__ import annotations

from math import inf, log10


def snr_db(signal: float, noise: float) -> float:
    """``10 log10(sum a^2 / sum (a-b)^2)`` from the two sums; infinite where there is no error, whatever the signal.

    >>> snr_db(100.0, 1.0), snr_db(0.0, 0.0), snr_db(0.0, 1.0)
    (20.0, inf, -inf)
    """
    return inf if noise == 0 else -inf if signal == 0 else 10 * log10(signal / noise)
