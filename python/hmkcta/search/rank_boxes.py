"""Ranks of blocks: of each HOSVD core the box of least J, by cumulative sums; the readable twin of `rank_boxes.rs`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32, F64
from .rate_model import MODEL, RateModel


def best_boxes(
    cores: F32, decomposed: Sequence[bool], step: float, decode_cost: float, model: RateModel = MODEL
) -> tuple[F64, NDArray[np.uint32]]:
    """The least J of each block and its ranks; the native kernel does the same.

    Args:
        cores: HOSVD cores in all columns, `[blocks, n_1, .., n_N]`, largest columns first.
        decomposed: of each mode; an undecomposed one has no columns to choose among, and no basis to pay for.
        step: D.
        decode_cost: bound on the product of the ranks of decomposed modes.
        model: what numbers cost.

    Returns:
        J in units of D^2, `[blocks]`, and ranks `[blocks, N]`: 0 in all modes where nothing pays, n_n undecomposed.

    >>> cores = np.zeros((1, 4, 3), np.float32)
    >>> cores[0, 0, 0] = 50
    >>> cost, ranks = best_boxes(cores, (True, True), 1.0, 4096)
    >>> ranks.tolist(), bool(cost[0] < 50**2)
    ([[1, 1]], True)
    """
    order = cores.ndim - 1
    squares = np.square(cores.astype(np.float64) / step)
    energy = squares.reshape(len(cores), -1).sum(axis=1)
    costs = model.core_change(squares)
    product: F64 = np.ones((1,) * (order + 1))
    for n in range(order):
        if not decomposed[n]:
            costs = costs.sum(axis=n + 1, keepdims=True)
            continue
        costs = np.cumsum(costs, axis=n + 1)
        product = product * _along(np.arange(1.0, cores.shape[n + 1] + 1)[None], n, order)
    for n in (n for n in range(order) if decomposed[n]):
        others = tuple(m + 1 for m in range(order) if m != n)
        columns = model.column_cost(squares.sum(axis=others), cores.shape[n + 1])
        costs = costs + _along(np.cumsum(columns, axis=1), n, order)
    flat = np.where(product <= decode_cost, costs, np.inf).reshape(len(cores), -1)
    place = flat.argmin(axis=1)
    least = flat[np.arange(len(cores)), place]
    indices = cast("tuple[NDArray[np.intp], ...]", np.unravel_index(place, costs.shape[1:]))
    ranks = np.stack(indices, axis=1).astype(np.uint32) + 1
    for n in (n for n in range(order) if not decomposed[n]):
        ranks[:, n] = cores.shape[n + 1]
    ranks[least >= 0] = 0
    return energy + np.minimum(least, 0.0), ranks


def _along(numbers: F64, mode: int, order: int) -> F64:
    """Numbers `[blocks or 1, n]` so that they broadcast along a mode of `[blocks, n_1, .., n_N]`."""
    return np.expand_dims(numbers, [1 + m for m in range(order) if m != mode])
