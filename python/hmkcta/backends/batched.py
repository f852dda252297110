"""The kernels on many cells at once, by matrix products over batches: for a GPU, on any library like NumPy.

What `reference.py` computes cell by cell, in the same order (`batches.py`). Cells are gathered into padded blocks;
padding reads an element behind the tensor that is zero, and writes its zero back. Data is float32. Orthonormal columns
come from Gram matrices in float64, whose few numbers the host works on: a GPU would spend its time on being told so.

Only functions are used that NumPy and CuPy have alike, and nothing of one library is handed to the other but by
`Arrays`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32, F64
from ..cells import Cells, Products, check_shape
from .batches import Batch, Index, projection_batches, sweep_batches
from .reference import DEPENDENT

Array = Any  # of whichever library

#: Elements copied at once, at least.
LEAST_COPIED = 1 << 16


@dataclass(frozen=True)
class Arrays:
    """A library of arrays, and how much to do at once.

    Attributes:
        xp: functions with the names and arguments of NumPy's; `xp.array` takes NumPy's arrays.
        to_host: a NumPy array out of one of the library's.
        fill: copies one of the library's into a NumPy array in C order: new pages would take longer than the copy.
        budget: most elements of a batch. A cell that has more is worked on alone.
    """

    xp: Any
    to_host: Callable[[Array], NDArray[Any]]
    fill: Callable[[NDArray[Any], Array], None]
    budget: int = 1 << 25


def fit_cells(on: Arrays, cells: Cells, residual: F32, sweeps: int, iterations: int) -> None:
    """Gauss-Seidel sweeps of HOOI over the cells; bases, cores and residual are replaced when all is done."""
    check_shape(residual, cells)
    batches = _loaded(on, sweep_batches(cells, on.budget))
    tensor, model = _Tensor(on, residual), _Model(on, cells)
    for sweep in range(sweeps):
        for batch in batches:
            bases, core = model.take(batch)
            block = tensor.take(batch) + _reconstructed(on, core, bases)
            if sweep == 0:
                bases = [None if u is None else _orthonormal(on, u) for u in bases]
            bases, core = _hooi(on, block, bases, iterations)
            tensor.put(batch, block - _reconstructed(on, core, bases))
            model.put(batch, bases, core)
    tensor.fill(residual)
    cells.bases, cells.cores = model.on_host(cells)


def accumulate(on: Arrays, cells: Cells, tensor: F32, weight: float) -> None:
    """`tensor += weight * model`."""
    check_shape(tensor, cells)
    total, model = _Tensor(on, tensor), _Model(on, cells)
    for batch in _loaded(on, sweep_batches(cells, on.budget)):
        bases, core = model.take(batch)
        total.put(batch, total.take(batch) + weight * _reconstructed(on, core, bases))
    total.fill(tensor)


def project_cells(on: Arrays, cells: Cells, tensor: F32, n: int) -> F32:
    """`Y_n[c] = T x_{m != n} U_{m,c}^T`: `[PC, I_n, prod_{m != n} R_m]`."""
    check_shape(tensor, cells)
    y = np.zeros((cells.spec.cells, cells.sizes[n], prod(cells.ranks) // cells.ranks[n]), np.float32)
    data, model = _Tensor(on, tensor), _Model(on, cells)
    for batch in _loaded(on, projection_batches(cells, [n], on.budget // 2)):  # a batch grows before it shrinks
        x, bases = _spread(on, data.take(batch), model.take_bases(batch), batch.table.numbers.shape[1])
        y[batch.table.numbers.reshape(-1)] = on.to_host(_unfolded(on, _projected(on, x, bases), n))
    return y


def project_pair(on: Arrays, cells: Cells, tensor: F32, pair: tuple[int, int]) -> F32:
    """The tensor projected on the bases of all cells in two modes: see `reference.project_pair`."""
    check_shape(tensor, cells)
    kept = [m for m in range(cells.order) if m not in pair]
    clusters, ranks = [cells.spec.clusters[m] for m in pair], [cells.ranks[m] for m in pair]
    rows = [cells.sizes[m] for m in kept]
    lanes = cells.spec.cells // prod(clusters)
    shape = (prod(rows), *clusters, ranks[0], lanes, ranks[1])
    together, p = on.xp.zeros(shape, np.float32), np.empty(shape, np.float32)
    data, model = _Tensor(on, tensor), _Model(on, cells)
    for batch in _loaded(on, projection_batches(cells, kept, on.budget // 2)):
        x, bases = _spread(on, data.take(batch), model.take_bases(batch), lanes)
        x = on.xp.moveaxis(_projected(on, x, bases), [m + 1 for m in pair], [-2, -1])
        x = x.reshape(batch.count, lanes, prod(rows), *ranks).transpose(2, 0, 3, 1, 4)
        subsets = np.unravel_index(batch.table.numbers[:, 0], cells.spec.clusters)
        together[:, on.xp.array(subsets[pair[0]]), on.xp.array(subsets[pair[1]])] = x
    on.fill(p, together)
    return p.reshape(*rows, *clusters, ranks[0], *(cells.spec.clusters[m] for m in kept), ranks[1])


def dictionary_gram(on: Arrays, cells: Cells, products: Sequence[Products | None], n: int) -> F64:
    """`H_n = D_n^T D_n` of the dictionaries of all cells: `[PC R_n, PC R_n]`, in float64."""
    xp, count, rank = on.xp, cells.spec.cells, cells.ranks[n]
    cores = xp.array(cells.cores.astype(np.float64))
    right = _unfolded(on, cores, n).transpose(0, 2, 1)  # [PC, Q, R_n]
    step = max(1, on.budget // (2 * count * max(1, prod(cells.ranks))))  # two float32 fit into a float64
    h = np.empty((count, rank, count, rank))
    for first in range(0, count, step):
        part = slice(first, min(first + step, count))
        here = part.stop - first
        x = xp.broadcast_to(cores[part, None], (here, *cores.shape)).reshape(here * count, *cores.shape[1:])
        for m, product in enumerate(products):
            if product is not None and m != n:
                # What takes coefficients of the part's cells to those of all others.
                gram = xp.array(product[:, part]).transpose(1, 3, 2, 0)
                x = _times(on, x, gram.reshape(here * count, *gram.shape[2:]), m)
        left = _unfolded(on, x, n).reshape(here, count, rank, -1)
        h[part] = on.to_host(xp.matmul(left, right[None])).transpose(0, 2, 1, 3)
    return h.reshape(count * rank, count * rank)


class _Loaded:
    """A batch whose tables are where the kernels need them; `next_table` gives them one after the other."""

    def __init__(self, on: Arrays, table: Batch, next_table: Callable[[Index], Array]) -> None:
        self.table, self._xp = table, on.xp
        self.numbers = next_table(table.numbers)
        self.rows = [next_table(rows) for rows in table.rows]
        self.places = [None if places is None else next_table(places) for places in table.places]

    @property
    def count(self) -> int:
        """Cells, or bundles of cells that differ in one mode."""
        return len(self.table.numbers)

    def elements(self) -> Array:
        """Where the elements lie in the tensor: `[B, prod m_n]`."""
        at = self.rows[0]
        for rows in self.rows[1:]:
            at = (at[:, :, None] + rows[:, None, :]).reshape(self.count, -1)
        return self._xp.minimum(at, self.table.end) if self.table.padded else at


def _loaded(on: Arrays, batches: Sequence[Batch]) -> list[_Loaded]:
    """The batches with their tables, which go to the device in one piece: every small one would take as long."""
    tables = [t for b in batches for t in (b.numbers, *b.rows, *(p for p in b.places if p is not None))]
    dtype = batches[0].rows[0].dtype if batches else np.dtype(np.int32)
    together = on.xp.array(np.concatenate([np.zeros(0, dtype), *(t.reshape(-1).astype(dtype) for t in tables)]))
    first = 0

    def next_table(table: Index) -> Array:
        nonlocal first
        first += table.size
        return together[first - table.size : first].reshape(table.shape)

    return [_Loaded(on, batch, next_table) for batch in batches]


class _Tensor:
    """A tensor as a row of numbers, and a zero behind them."""

    def __init__(self, on: Arrays, tensor: F32) -> None:
        self._on, self._size = on, tensor.size
        self._flat, values = on.xp.zeros(self._size + 1, np.float32), tensor.reshape(-1)
        step = max(on.budget, LEAST_COPIED)
        for first in range(0, self._size, step):  # never the whole tensor twice
            part = on.xp.array(values[first : first + step])
            self._flat[first : first + part.size] = part

    def take(self, batch: _Loaded) -> Array:
        """The cells' elements: `[B, m_1, .., m_N]`."""
        shape = (batch.count, *batch.table.shape)
        if batch.table.whole:
            return self._flat[: self._size].reshape(shape)
        return self._on.xp.take(self._flat, batch.elements()).reshape(shape)

    def put(self, batch: _Loaded, blocks: Array) -> None:
        """Replace them."""
        if batch.table.whole:
            self._flat[: self._size] = blocks.reshape(-1)
        else:
            self._flat[batch.elements()] = blocks.reshape(batch.count, -1)

    def fill(self, tensor: F32) -> None:
        """Put all elements there."""
        if tensor.flags.c_contiguous:
            self._on.fill(tensor.reshape(-1), self._flat[: self._size])
        else:
            tensor[...] = self._on.to_host(self._flat[: self._size]).reshape(tensor.shape)


class _Model:
    """Bases of each mode as rows one after another, and a row of zeros behind them; cores."""

    def __init__(self, on: Arrays, cells: Cells) -> None:
        self._on = on
        self._bases: list[Array] = []
        for basis, rank, skip in zip(cells.bases, cells.ranks, cells.undecomposed, strict=True):
            rows = np.concatenate([basis.reshape(-1, rank), np.zeros((1, rank), np.float32)]) if not skip else None
            self._bases.append(None if rows is None else on.xp.array(rows))
        self._cores = on.xp.array(cells.cores)

    def take_bases(self, batch: _Loaded) -> list[Array]:
        """For each mode the cells' bases `[B, .., m_n, R_n]`, rows of padding being zero; None without one."""
        return [
            None if places is None else self._on.xp.take(rows, places, axis=0)
            for rows, places in zip(self._bases, batch.places, strict=True)
        ]

    def take(self, batch: _Loaded) -> tuple[list[Array], Array]:
        """The cells' bases and cores `[B, R_1, .., R_N]`."""
        return self.take_bases(batch), self._on.xp.take(self._cores, batch.numbers, axis=0)

    def put(self, batch: _Loaded, bases: Sequence[Array], core: Array) -> None:
        """Replace them."""
        self._cores[batch.numbers] = core
        for rows, places, basis in zip(self._bases, batch.places, bases, strict=True):
            if basis is not None:
                rows[places] = basis

    def on_host(self, cells: Cells) -> tuple[list[F32], F32]:
        """Bases and cores as `Cells` has them."""
        stored = zip(self._bases, cells.bases, strict=True)
        bases = [old if rows is None else self._on.to_host(rows[:-1]).reshape(old.shape) for rows, old in stored]
        return bases, self._on.to_host(self._cores)


def _times(on: Arrays, x: Array, matrix: Array, n: int) -> Array:
    """The mode product `x x_n matrix` of every block: x `[B, d_1, .., d_N]`, matrix `[B, out, d_n]`."""
    count, before, after = x.shape[0], prod(x.shape[1 : n + 1]), prod(x.shape[n + 2 :])
    shape = (*x.shape[: n + 1], matrix.shape[1], *x.shape[n + 2 :])
    if after == 1:
        product = on.xp.matmul(x.reshape(count, before, x.shape[n + 1]), matrix.transpose(0, 2, 1))
    elif before == 1:
        product = on.xp.matmul(matrix, x.reshape(count, x.shape[n + 1], after))
    else:
        product = on.xp.matmul(matrix[:, None], x.reshape(count, before, x.shape[n + 1], after))
    return product.reshape(shape)


def _projected(on: Arrays, x: Array, bases: Sequence[Array], first: int = 0) -> Array:
    """`x x_n U_n^T` for the modes from `first` on that have a basis.

    Ascending, so that what stands behind a mode, the long side of the product, is not contracted yet.
    """
    for n in range(first, len(bases)):
        if bases[n] is not None:
            x = _times(on, x, bases[n].transpose(0, 2, 1), n)
    return x


def _reconstructed(on: Arrays, core: Array, bases: Sequence[Array]) -> Array:
    """`Z x_1 U_1 .. x_N U_N`: `[B, m_1, .., m_N]`."""
    for n in reversed(range(len(bases))):
        if bases[n] is not None:
            core = _times(on, core, bases[n], n)
    return core


def _unfolded(on: Arrays, x: Array, n: int) -> Array:
    """The mode-n unfolding of every block: `[B, d_n, rest]`."""
    return on.xp.moveaxis(x, n + 1, 1).reshape(x.shape[0], x.shape[n + 1], -1)


def _spread(on: Arrays, x: Array, bases: list[Array], each: int) -> tuple[Array, list[Array]]:
    """Blocks `[B, ..]` that `each` cells share become those of each cell, with the first basis' mode projected already.

    So it is one product with the bases of all of them side by side. Bases are `[B, each, m_n, R_n]`.
    """
    count, decomposed = x.shape[0], [n for n, u in enumerate(bases) if u is not None]
    flat: list[Array] = [None if u is None else u.reshape(count * each, *u.shape[2:]) for u in bases]
    if not decomposed:
        x = on.xp.broadcast_to(x[:, None], (count, each, *x.shape[1:]))
    else:
        n = decomposed[0]
        rank, flat[n] = bases[n].shape[3], None
        side = bases[n].transpose(0, 1, 3, 2).reshape(count, each * rank, -1)
        x = _times(on, x, side, n)
        x = x.reshape(*x.shape[: n + 1], each, rank, *x.shape[n + 2 :])
        x = on.xp.moveaxis(x, n + 1, 1)
    return x.reshape(count * each, *x.shape[2:]), flat


def _hooi(on: Arrays, block: Array, bases: Sequence[Array], iterations: int) -> tuple[list[Array], Array]:
    """One HOOI round: bases and cores. What is projected on new bases already serves all modes that follow."""
    fresh = list(bases)
    for n, u in enumerate(bases):
        if u is not None:
            e = _unfolded(on, _projected(on, block, bases, n + 1), n)
            fresh[n] = _subspace(on, e, u, iterations)
            block = _times(on, block, fresh[n].transpose(0, 2, 1), n)
    return fresh, block


def _subspace(on: Arrays, e: Array, u: Array, iterations: int) -> Array:
    """Towards the leading left subspaces of `e` `[B, m, q]` from `u` `[B, m, R]`, as in `reference`."""
    missing = u.shape[2] - e.shape[2]
    if missing >= 0 and iterations > 0:  # all of e is spanned
        zeros = [on.xp.zeros((*e.shape[:2], missing), np.float32)] if missing else []
        return _orthonormal(on, on.xp.concatenate([e, *zeros], axis=2))
    across = e.transpose(0, 2, 1)
    for number in range(1, iterations + 1):
        v = _orthonormal(on, on.xp.matmul(across, u), passes=1)
        # Between iterations columns must be independent, not exactly orthonormal.
        u = _orthonormal(on, on.xp.matmul(e, v), passes=2 if number == iterations else 1)
    return u


def _orthonormal(on: Arrays, u: Array, passes: int = 2) -> Array:
    """The columns of `u` `[B, m, R]` made orthonormal, in float32; those that depend on earlier ones become zero.

    A pass squares how nearly dependent columns are, so the second takes out what the first left.
    """
    wide = u.astype(np.float64)
    for _ in range(passes):
        gram = on.to_host(on.xp.matmul(wide.transpose(0, 2, 1), wide))
        wide = on.xp.matmul(wide, on.xp.array(_gram_schmidt(gram)))
    return wide.astype(np.float32)


def _gram_schmidt(gram: F64) -> F64:
    """T `[B, R, R]`, upper triangular, such that the columns of U T are orthonormal or zero; gram is `U^T U`."""
    t = np.zeros_like(gram)
    for r in range(gram.shape[1]):
        column = np.zeros(gram.shape[:2])
        column[:, r] = 1.0
        for _ in range(2):
            column = column - (t @ (t.transpose(0, 2, 1) @ (gram @ column[:, :, None])))[:, :, 0]
        length = np.einsum("br,brs,bs->b", column, gram, column)
        independent = length > DEPENDENT**2 * gram[:, r, r]
        t[independent, :, r] = column[independent] / np.sqrt(length[independent, None])
    return t
