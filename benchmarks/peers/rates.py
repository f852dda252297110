"""What stored numbers cost, one model for all peers.

One step D rules everything. An error e in a number of a factor adds c^2 e^2 to the squared error of the array, where c
is what its column *counts for*: the singular value (PCA, tensor train), the norm of its slice of the core (Tucker); 1
for the numbers of a core, or of a factor that carries the singular values. So a number is rounded with step D / c, and
all numbers add about D^2 / 12 each. A number that contributes c is predicted to take 1/2 log2(1 + 12 c^2 / D^2) bits.
Ranks minimise squared error + TRADE D^2 bits.

Bits are realisable: a decoder knows nothing that is not paid for.

- c / D is first rounded to a power of 2^(1/3), 6 bits a column, and numbers are rounded by that.
- Factors of PCA and tensor train: a Laplace law a column, of one of 64 scales.
- Cores: decoded steps tell the magnitude to expect of a number; numbers are sorted by it into classes half an octave
  wide, and a class is coded adaptively, by counts that start at PRIOR and grow as symbols come.
"""

from __future__ import annotations

from math import lgamma, log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .layouts import F64, Floats

#: What a bit is worth, in units of D^2 (by trial; theory has 2 ln 2 / 12 = 0.116 for fine steps); how much more than to
#: the nearest magnitudes are rounded down; what counts of adaptive codes begin with.
TRADE, DEAD_ZONE, PRIOR = 0.13, 0.1, 0.25
#: Bits of a header (shape, layout, D), of a rank, of a column's step, of its Laplace scale, of a brick's energy.
HEADER_BITS, RANK_BITS, STEP_BITS, SCALE_BITS, ENERGY_BITS = 8 * 64, 16, 6, 6, 8
#: Scales of Laplace distributions.
SCALES: F64 = np.geomspace(0.02, 3000.0, 2**SCALE_BITS)
#: Magnitudes from here on are told by an Elias gamma code behind the last symbol; classes of expected magnitude.
ESCAPE, CLASSES = 15, 61


def rate(c2: Any) -> Any:
    """Predicted bits of a number that contributes c, given c^2 / D^2."""
    return 0.5 * np.log2(1.0 + 12.0 * c2)


def price(c2: Any, size: float, parameters: float = 0) -> Any:
    """Predicted TRADE * bits of a column of `size` numbers that counts for c, given c^2 / D^2."""
    return TRADE * (size * rate(c2 / size) + parameters)


def quantise(x: Floats) -> F64:
    """Whole numbers, rounded towards zero by DEAD_ZONE more than to the nearest.

    >>> quantise(np.array([0.55, -0.65])).tolist()
    [0.0, -1.0]
    """
    return np.sign(x) * np.floor(np.abs(x) + (0.5 - DEAD_ZONE))


def on_grid(weight: F64) -> F64:
    """c / D as the decoder knows it: 2^(k/3), k of STEP_BITS."""
    return 2.0 ** (np.clip(np.round(3.0 * np.log2(np.maximum(weight, 1e-9))), -9, 54) / 3.0)


def laplace_bits(zeros: Any, others: Any, total: Any, scale: F64) -> F64:
    """Bits of whole numbers by a rounded Laplace law: how many are 0, how many are not, the sum of magnitudes."""
    zero, other = -np.log2(-np.expm1(-0.5 / scale)), 1.0 - np.log2(-np.expm1(-1.0 / scale))
    return zeros * zero + others * other + (total - 0.5 * others) / (scale * log(2.0))


def column_bits(q: F64) -> float:
    """Bits of whole numbers `[rows, columns]`, each column with the best of SCALES."""
    others, total = np.count_nonzero(q, axis=0)[:, None], np.abs(q).sum(axis=0)[:, None]
    return float((laplace_bits(len(q) - others, others, total, SCALES).min(axis=1) + SCALE_BITS).sum())


def adaptive_bits(counts: NDArray[np.intp]) -> float:
    """Length of adaptive codes (Dirichlet-multinomial), given how often each symbol came, `[.., symbols]`.

    >>> adaptive_bits(np.array([0, 0, 0])) == 0.0, 7.9 < adaptive_bits(np.array([4, 4])) < 11
    (True, True)
    """
    rows: list[list[int]] = counts.reshape(-1, counts.shape[-1]).tolist()
    nats = 0.0
    for row in rows:
        prior = len(row) * PRIOR
        nats += lgamma(sum(row) + prior) - lgamma(prior)
        nats -= sum(lgamma(count + PRIOR) - lgamma(PRIOR) for count in row if count)
    return nats / log(2.0)


def class_bits(q: F64, expected: F64) -> float:
    """Bits of whole numbers in classes by the magnitude expected of them, which the decoder knows."""
    classes = np.clip(np.round(2.0 * np.log2(np.maximum(expected, 1e-3))) + 20, 0, CLASSES - 1).astype(np.int64)
    magnitude = np.abs(q).astype(np.int64)
    symbols = ESCAPE + 1
    counts = np.bincount(symbols * classes + np.minimum(magnitude, ESCAPE), minlength=CLASSES * symbols)
    beyond = magnitude[magnitude >= ESCAPE] - (ESCAPE - 1)
    gamma = float((2 * np.floor(np.log2(beyond)) + 1).sum())
    return adaptive_bits(counts.reshape(CLASSES, symbols)) + np.count_nonzero(q) + gamma
