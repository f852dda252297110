"""HOSVD (Tucker) of the whole array, and of the bricks of a uniform grid, each with ranks of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from math import ceil, inf, log2, prod, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .layouts import F64, Floats, Layout, partitions, unite, united
from .rates import ENERGY_BITS, HEADER_BITS, STEP_BITS, TRADE, class_bits, laplace_bits, on_grid, price, quantise, rate
from .search import Coded, Found, Search

#: Longest modes of the whole array and of bricks; axes so short are kept whole; edges of the first grids.
LONGEST_MODE, LONGEST_BRICK, SHORT_AXIS, EDGES = 1400, 400, 9, (8, 16, 32)
#: How many of the best layouts for a budget are varied, and the shortest axis whose edge is.
BEAM, CUT_AXIS = 3, 4
#: Grids are compared by about so many elements of the array, and at so many steps: at coarser ones nothing is kept.
SAMPLE, FINE_STEPS = 900_000, 7

Vary = Callable[[Layout], Iterable[Layout]]


def hosvd(values: NDArray[np.float32], search: Search) -> list[Found | None]:
    """HOSVD of the whole array, all merges of axes into modes tried; the decode cost is the product of the ranks."""
    sizes = {Layout(groups): max(united(values.shape, groups)) for groups in partitions(values.ndim)}
    layouts = sorted((layout for layout in sizes if sizes[layout] <= LONGEST_MODE), key=lambda layout: sizes[layout])
    return _search(values, search, layouts, lambda _: ())


def bricks(values: NDArray[np.float32], search: Search) -> list[Found | None]:
    """HOSVD of the bricks of a grid: a few grids, then edges halved or doubled and all merges of axes."""
    shape, merges = values.shape, partitions(values.ndim)

    def vary(layout: Layout) -> Iterator[Layout]:
        for axis, edge in enumerate(layout.edges):
            for other in (-(-edge // 2), min(2 * edge, shape[axis])):
                if shape[axis] >= CUT_AXIS:
                    yield Layout(layout.groups, (*layout.edges[:axis], other, *layout.edges[axis + 1 :]))
        yield from (Layout(groups, layout.edges) for groups in merges)

    search.steps = search.steps[:FINE_STEPS]
    few = [groups for groups in merges[::-1] if len(groups) >= len(shape) - 1]
    first = [Layout(groups, grid) for groups, grid in product(few, first_grids(shape))]
    return _search(values, search, [x for x in first if _short_enough(x)], vary, SAMPLE)


def first_grids(shape: Sequence[int]) -> list[tuple[int, ...]]:
    """Grids to begin with: short axes whole, the leading one whole or cut, the others alike."""
    wanted = [[first] + [rest] * (len(shape) - 1) for first in (*EDGES, max(shape)) for rest in EDGES]
    wanted.append(list(shape))
    return sorted({tuple(s if s <= SHORT_AXIS else min(s, e) for s, e in zip(shape, w, strict=True)) for w in wanted})


def _short_enough(layout: Layout) -> bool:
    return max(united(layout.edges, layout.groups)) <= LONGEST_BRICK


def _search(
    values: NDArray[np.float32], search: Search, fresh: list[Layout], vary: Vary, sample: float = inf
) -> list[Found | None]:
    """Predict layouts, then those that `vary` makes of the best for each budget; when these are all known of the two
    best, and so on to the `BEAM` best."""
    beam = 1
    while beam <= BEAM:
        for layout in fresh:
            fitted = Tucker(values, layout, search.decode_cost, sample)
            search.curves[layout] = np.array([fitted.choose(step)[1] for step in search.steps.tolist()])
        best = zip(*search.best(beam), strict=True)
        near = dict.fromkeys(other for layouts in best for layout in layouts for other in vary(layout))
        fresh = [layout for layout in near if layout not in search.curves and _short_enough(layout)]
        beam += not fresh
    return search.finish(lambda layout: Tucker(values, layout, search.decode_cost).code)


def cut(values: Floats, edges: Sequence[int]) -> list[Floats]:
    """Near-equal bricks no longer than `edges`, a batch `[bricks, *axes]` for each shape that occurs."""
    segments: list[list[slice]] = []
    for size, edge in zip(values.shape, edges, strict=True):
        parts = -(-size // edge)
        bounds = [size * part // parts for part in range(parts + 1)]
        segments.append([slice(*pair) for pair in pairwise(bounds)])
    batches: dict[tuple[int, ...], list[Floats]] = {}
    for where in product(*segments):
        batches.setdefault(values[where].shape, []).append(values[where])
    return [np.stack(found) for found in batches.values()]


def mode_product(batch: Floats, matrices: Floats, mode: int) -> Floats:
    """Multiply `mode` of every brick `[bricks, *modes]` by its matrix `[bricks, out, in]`."""
    moved = np.moveaxis(batch, mode + 1, 1)
    done = matrices @ moved.reshape(len(batch), moved.shape[1], -1)
    return np.moveaxis(done.reshape(len(batch), matrices.shape[1], *moved.shape[2:]), 1, mode + 1)


def _along(numbers: NDArray[Any], mode: int, modes: int) -> NDArray[Any]:
    """`[bricks, n]` so that it broadcasts along `mode` of `[bricks, *modes]`."""
    return np.expand_dims(numbers, [1 + m for m in range(modes) if m != mode])


@dataclass(frozen=True, eq=False)
class Batch:
    """HOSVDs, not truncated, of bricks of one shape.

    Attributes:
        values: `[bricks, n_1, .., n_N]`.
        bases: `[bricks, n, n]` of each mode, largest columns first.
        norms: singular values `[bricks, n]` of each mode.
        core: `[bricks, n_1, .., n_N]`.
    """

    values: Floats
    bases: tuple[Floats, ...]
    norms: tuple[Floats, ...]
    core: Floats

    @classmethod
    def of(cls, values: Floats) -> Batch:
        """The HOSVDs of bricks."""
        bases, norms, core = list[Floats](), list[Floats](), values
        for mode in range(values.ndim - 1):
            unfolded = np.moveaxis(values, mode + 1, 1).reshape(len(values), values.shape[mode + 1], -1)
            squares, vectors = np.linalg.eigh((unfolded @ unfolded.swapaxes(1, 2)).astype(np.float64))
            bases.append(np.ascontiguousarray(vectors[:, :, ::-1]).astype(np.float32))
            norms.append(np.sqrt(np.maximum(squares[:, ::-1], 0.0)).astype(np.float32))
            core = mode_product(core, bases[-1].swapaxes(1, 2), mode)
        return cls(values, tuple(bases), tuple(norms), core)

    def choose(self, step: float, decode_cost: int) -> tuple[NDArray[np.int64], float]:
        """Ranks `[bricks, modes]` of least Lagrangian, 0 for an empty brick; and the Lagrangians' sum over D^2."""
        sizes, c2 = self.core.shape[1:], self.core * self.core / np.float32(step * step)
        empty = c2.reshape(len(c2), -1).sum(axis=1, dtype=np.float64)
        # What each number of the core changes, summed over all boxes of ranks; and the bases for such ranks.
        gains = np.where(c2 < 0.36, 0.0, np.float32(1 / 12) - c2) + np.float32(TRADE) * rate(c2)
        for axis in range(1, gains.ndim):
            np.cumsum(gains, axis=axis, out=gains)
        for mode, norm in enumerate(self.norms):
            columns = price(np.square(norm / np.float32(step)), sizes[mode], STEP_BITS)
            gains += _along(np.cumsum(columns, axis=1), mode, len(sizes))
        costs: NDArray[np.intp] = np.prod(np.indices(sizes) + 1, axis=0)
        flat = np.where(costs <= decode_cost, gains, np.inf).reshape(len(c2), -1)
        box = flat.argmin(axis=1)
        gain = np.minimum(flat[np.arange(len(c2)), box], 0.0)
        ranks: NDArray[np.int64] = np.array(np.unravel_index(box, sizes), np.int64).T + 1
        return ranks * (gain < 0.0)[:, None], float((empty + gain).sum())

    def code(self, ranks: NDArray[np.int64], step: float) -> tuple[float, float, F64, F64]:
        """Bits of all but the core, squared error, and the core's whole numbers with what is expected of them."""
        modes, most = self.values.ndim - 1, np.maximum(ranks.max(axis=0), 1).tolist()
        used = np.count_nonzero(ranks[:, 0])
        bits = float(len(ranks) + used * (ENERGY_BITS + sum(ceil(log2(n + 1)) for n in self.values.shape[1:])))
        masks: list[NDArray[np.bool_]] = [np.arange(count) < ranks[:, mode, None] for mode, count in enumerate(most)]
        valid: NDArray[np.bool_] = np.ones((len(ranks), *most), np.bool_)
        for mode, mask in enumerate(masks):
            valid &= _along(mask, mode, modes)
        squares: F64 = np.square(self.core[(slice(None), *map(slice, most))], dtype=np.float64) * valid
        energy: F64 = np.maximum(squares.reshape(len(ranks), -1).sum(axis=1), 1e-30)
        norm: F64 = np.exp2(np.round(2.0 * np.log2(energy)) / 4.0)  # as the decoder knows it
        expected: F64 = np.ones(valid.shape) * (norm / step).reshape(-1, *[1] * modes)
        decoded: list[F64] = []
        for mode, mask in enumerate(masks):
            others = tuple(1 + m for m in range(modes) if m != mode)
            weight = on_grid(np.sqrt(squares.sum(axis=others)) / step)
            q: F64 = quantise(self.bases[mode][:, :, : most[mode]] * weight[:, None]) * mask[:, None]
            bits += _basis_bits(q, weight, mask)
            decoded.append(q / weight[:, None])
            expected *= _along(weight * step / norm[:, None], mode, modes)
        q, error = self._refit(decoded, valid, step)
        return bits, error, q[valid], expected[valid]

    def _refit(self, bases: Sequence[F64], valid: NDArray[np.bool_], step: float) -> tuple[F64, float]:
        """Whole numbers of the core, by least squares in the bases as decoded, and the squared error that is left."""
        core: Floats = self.values.astype(np.float64)
        for mode, basis in enumerate(bases):
            gram = basis.swapaxes(1, 2) @ basis + 1e-9 * np.eye(basis.shape[2])
            core = mode_product(core, np.linalg.solve(gram, basis.swapaxes(1, 2)), mode)
        q: F64 = quantise(core / step) * valid
        model: Floats = q * step
        for mode, basis in enumerate(bases):
            model = mode_product(model, basis, mode)
        return q, float(np.square(self.values - model).sum())


def _basis_bits(q: F64, weight: F64, mask: NDArray[np.bool_]) -> float:
    """Bits of basis columns: a unit column of n numbers has a deviation of n^-1/2, so its step tells the scale."""
    nonzero, scale = np.count_nonzero(q, axis=1), np.maximum(weight / sqrt(2 * q.shape[1]), 0.05)
    lengths = laplace_bits(q.shape[1] - nonzero, nonzero, np.abs(q).sum(axis=1), scale)
    return float(((lengths + STEP_BITS) * mask).sum())


class Tucker:
    """HOSVDs of the bricks of a grid, or of a sample of them."""

    def __init__(
        self, values: NDArray[np.float32], layout: Layout, decode_cost: int, sample: float = inf
    ) -> None:
        self.decode_cost, self.share = decode_cost, 1.0
        batches = cut(values, layout.edges or values.shape)
        if values.size > sample and len(batches[0]) > 3:
            rng, share = np.random.default_rng(0), sample / values.size
            batches = [b[np.sort(rng.permutation(len(b))[: max(1, round(share * len(b)))])] for b in batches]
            self.share = sum(b.size for b in batches) / values.size
        self.batches = [Batch.of(unite(batch, layout.groups)) for batch in batches]

    def choose(self, step: float) -> tuple[list[NDArray[np.int64]], float]:
        """Ranks of each batch's bricks, and the sum of all Lagrangians."""
        chosen = [batch.choose(step, self.decode_cost) for batch in self.batches]
        return [ranks for ranks, _ in chosen], sum(total for _, total in chosen) * step**2 / self.share

    def code(self, step: float) -> Coded:
        """Code at a step."""
        chosen = self.choose(step)[0]
        coded = [batch.code(ranks, step) for batch, ranks in zip(self.batches, chosen, strict=True)]
        bits = HEADER_BITS + sum(own for own, *_ in coded)
        bits += class_bits(np.concatenate([q for *_, q, _ in coded]), np.concatenate([e for *_, e in coded]))
        ranks = np.concatenate(chosen)
        many = [f"{mean:.1f} (<={most})" for mean, most in zip(ranks.mean(axis=0), ranks.max(axis=0), strict=True)]
        text = ", ".join(many if len(ranks) > 1 else map(str, ranks[0]))
        return Coded(bits, sum(error for _, error, *_ in coded), max(map(prod, ranks.tolist())), f"ranks {text}")
