"""Tensor train (TT-SVD): orders of the axes searched; the decode cost is the sum of R_k R_k+1."""

from __future__ import annotations

from itertools import permutations
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from .layouts import F64, Floats, Layout, spectrum
from .matrices import LONGEST_SIDE
from .rates import (
    HEADER_BITS,
    RANK_BITS,
    SCALE_BITS,
    STEP_BITS,
    TRADE,
    class_bits,
    column_bits,
    on_grid,
    price,
    quantise,
    rate,
)
from .search import Coded, Found, Search

#: Of all orders, predicted at a middle step, so many go on to all steps.
KEPT_ORDERS, MIDDLE = 8, 5
#: How much coarser the cut of bonds becomes at a time while an element costs too much.
COARSER = 1.15

#: All cores but the last, `[left * size, right]`, and their singular values.
Cores = list[tuple[F64, F64]]


def tensor_train(values: NDArray[np.float32], search: Search) -> list[Found | None]:
    """The best tensor train of the array for each budget."""
    orders = [Layout(tuple((axis,) for axis in order)) for order in permutations(range(values.ndim))
              if order[0] < order[-1]]
    all_steps = search.steps
    for search.steps in (all_steps[MIDDLE : MIDDLE + 1], all_steps):
        search.curves = {}
        for layout in orders:
            curve = _curve(Train(values, layout, search.decode_cost), search.steps)
            if curve is not None:
                search.curves[layout] = curve
        orders = search.best(KEPT_ORDERS)[0]
    return search.finish(lambda layout: Train(values, layout, search.decode_cost).code)


def _curve(train: Train, steps: F64) -> F64 | None:
    """Lagrangians by step, from coarse to fine, as the decode cost bounds how finely bonds may be cut."""
    curve: list[float] = []
    for step in steps[::-1].tolist():
        coded = train.code(step)
        curve.append(inf if coded is None else coded.error + TRADE * step**2 * coded.bits)
    return None if curve[0] == inf else np.array(curve[::-1])


class Train:
    """Tensor trains of an array in one order of its axes; bonds cut at a step, or a coarser one for the decode cost."""

    def __init__(self, values: NDArray[np.float32], layout: Layout, decode_cost: int) -> None:
        self.values = np.ascontiguousarray(values.transpose([axis for group in layout.groups for axis in group]))
        self.decode_cost, self.finest = decode_cost, 0.0
        self.last: tuple[float, Cores | None] = 0.0, None

    def fit(self, step: float) -> Cores | None:
        """Cores with bonds cut at a step; None: an unfolding is too large."""
        cores: Cores = []
        rest: Floats = self.values.reshape(1, -1)
        for size in self.values.shape[:-1]:
            rest = rest.reshape(len(rest) * size, -1)
            if min(rest.shape) > LONGEST_SIDE:
                return None
            singular, vectors = spectrum(rest)
            keep = slice(self._rank(singular, (rest.shape[0], rest.shape[1]), step))
            if len(rest) <= rest.shape[1]:
                cores.append((vectors[:, keep], singular[keep]))
                rest = cores[-1][0].T.astype(rest.dtype) @ rest
            else:
                kept = vectors[:, keep].astype(rest.dtype)
                cores.append(((rest @ kept / np.maximum(singular[keep], 1e-30)).astype(np.float64), singular[keep]))
                rest = (kept * singular[keep]).T.astype(rest.dtype)
        return cores

    def _rank(self, singular: F64, shape: tuple[int, int], step: float) -> int:
        """Columns of a bond that pay, one at least.

        What is right of a bond will be split again: as if 8 sqrt(n) numbers, not n, but for the last core.
        """
        (rows, columns), c2 = shape, np.square(singular / step)
        right = columns if columns == self.values.shape[-1] else 8 * sqrt(columns)
        costs: F64 = price(c2, rows, STEP_BITS + SCALE_BITS) + TRADE * right * rate(c2 / columns)
        return max(1, int((c2 > costs).sum()))

    def _affordable(self, step: float) -> tuple[Cores, int] | None:
        """Cores at the finest step from `step` on that the decode cost allows, and their cost; None: there are none."""
        at = max(step, self.finest)
        while True:
            cores = self.last[1] if self.last[0] == at else self.fit(at)
            if cores is None:
                return None
            self.last = at, cores
            ranks = [len(singular) for _, singular in cores]
            cost = sum(a * b for a, b in zip(ranks, [*ranks[1:], 1], strict=True))
            if cost <= self.decode_cost:
                return cores, cost
            if max(ranks) == 1:
                return None
            at = self.finest = COARSER * at

    def code(self, step: float) -> Coded | None:
        """Code at a step; what follows a core is fitted to it as decoded. None: too large, or each element too dear."""
        found = self._affordable(step)
        if found is None:
            return None
        cores, cost = found
        bits, rest, decoded = float(HEADER_BITS + RANK_BITS * len(cores)), self.values.astype(np.float64), list[F64]()
        weight: F64 = np.ones(1)
        for (core, singular), size in zip(cores, self.values.shape, strict=False):
            weight = on_grid(singular / step)
            q = quantise(core * weight)
            bits += _core_bits(q, core, weight, size)
            decoded.append(q / weight)
            gram = decoded[-1].T @ decoded[-1] + 1e-12 * np.eye(len(weight))
            rest = np.linalg.solve(gram, decoded[-1].T @ rest.reshape(len(q), -1))
        q = quantise(rest / step)
        expected = np.repeat(weight / sqrt(q.shape[1]), q.shape[1])
        bits += min(column_bits(q.T), class_bits(q.ravel(), expected)) + 1
        error = float(np.sum(np.square(self.values.ravel() - _decoded(decoded, q * step))))
        return Coded(bits, error, cost, "ranks " + ",".join(str(len(singular)) for _, singular in cores))


def _core_bits(q: F64, core: F64, weight: F64, size: int) -> float:
    """Bits of a core, by a law a column, or by what its column and its row of the left bond let expect."""
    columns, left = weight / sqrt(len(core)), len(core) // size
    rows: F64 = np.sqrt(np.square(core * weight).reshape(left, -1).mean(axis=1) / np.square(columns).mean())
    rows = np.exp2(np.round(2.0 * np.log2(np.maximum(rows, 1e-6))) / 2.0)
    expected = (np.repeat(rows, size)[:, None] * columns).ravel()
    by_class = class_bits(q.ravel(), expected) + SCALE_BITS * left
    return min(column_bits(q), by_class) + STEP_BITS * len(weight) + 1


def _decoded(cores: list[F64], last: F64) -> F64:
    """All elements, flat."""
    rest = last
    for core in reversed(cores):
        rest = core @ rest.reshape(core.shape[1], -1)
    return rest.ravel()
