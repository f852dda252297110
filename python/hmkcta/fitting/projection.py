"""Projections of a node's tensor on the bases of all cells, one mode after the other, with one pass for two modes.

What search and subdivision want of mode n is `Y_n[c] = T x_{m != n} U_{m,c}^T`. Projected on two modes, the tensor is
small, and two modes are left: the rows of one may be solved for, and then those of the other with the new bases of the
first, before the tensor is looked at again. So a sweep over four modes is two passes, whatever the number of cells.

With modes a and b kept, and c and d projected on, the first projection and what comes of it are

    P[i_a, i_b, c_c, c_d, r_c, c_a, c_b, r_d] = sum over i_c, i_d of T[i_a, i_b, i_c, i_d] U_c[i_c, r_c] U_d[i_d, r_d]
    Y_a[c, i_a, r_b r_c r_d]                  = sum over i_b of P[i_a, i_b, ..] U_b[i_b, r_b]

where all U are those of the cell c = (c_a, c_b, c_c, c_d). Axes of P behind those of rows are *lanes*: each is
multiplied by the basis of its own cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

import numpy as np

from .. import backends as kernels
from ..arrays import F32
from ..cells import Cells

#: The index that an axis of a projection runs over: ("I", m) for i_m, ("C", m) for c_m, ("R", m) for r_m.
Index = tuple[str, int]

#: A projection, and the bases beside it, may have as many numbers as the tensor, or this many; beyond, modes are
#: projected one by one.
LARGEST = 1 << 22


@dataclass(frozen=True, eq=False)
class Projection:
    """A tensor on its way to the projections of the modes that are kept.

    Attributes:
        tensor: of the node's shape.
        pair: the modes it has been projected on; None: none, each mode is projected from the tensor.
        p: what came of it, as `kernels.project_pair` has it.
    """

    tensor: F32
    pair: tuple[int, int] | None
    p: F32 | None

    def onto(self, cells: Cells, n: int) -> F32:
        """`Y_n` `[PC, I_n, prod_{m != n} R_m]`, with the present bases of the other kept mode."""
        if self.pair is None or self.p is None:
            return kernels.project_cells(cells, self.tensor, n)
        kept = [m for m in range(cells.order) if m not in self.pair]
        lanes, p = _lanes(self.pair, kept), self.p
        axes = [*(("I", m) for m in kept), *lanes]
        for m in (m for m in kept if m != n and not cells.undecomposed[m]):
            at, first_lane, sizes = axes.index(("I", m)), len(axes) - len(lanes), _sizes(cells, axes)
            flat = p.reshape(prod(sizes[:at]), sizes[at], prod(sizes[at + 1 : first_lane]), prod(sizes[first_lane:]))
            p = kernels.contract_lanes(flat, _basis_in_lanes(cells, m, lanes))
            axes = [*axes[:at], *axes[at + 1 : first_lane], ("R", m), *lanes]
        others = [("I" if cells.undecomposed[m] else "R", m) for m in range(cells.order) if m != n]
        wanted = [*(("C", m) for m in range(cells.order)), ("I", n), *others]
        p = p.reshape(_sizes(cells, axes)).transpose([axes.index(index) for index in wanted])
        return p.reshape(cells.spec.cells, cells.sizes[n], -1)


def passes(cells: Cells) -> list[tuple[int, ...]]:
    """Decomposed modes by twos where each two leave two to project on, else one by one.

    Neighbours go together, unless projections would be too large then and are not for other twos.

    >>> from hmkcta.cells import zero_cells
    >>> from hmkcta.plan import LevelSpec
    >>> passes(zero_cells((4, 5, 6, 7), LevelSpec((2,) * 4, (2,) * 4, (1,) * 4)))
    [(0, 1), (2, 3)]
    >>> passes(zero_cells((4, 5, 6, 7), LevelSpec((None, 2, 2, 2), (1, 2, 2, 2), (1,) * 4)))
    [(1,), (2,), (3,)]
    """
    modes = [n for n, skip in enumerate(cells.undecomposed) if not skip]
    if len(modes) != 4:
        return [(n,) for n in modes]
    a, b, c, d = modes
    pairings: list[list[tuple[int, ...]]] = [[(a, b), (c, d)], [(a, c), (b, d)], [(a, d), (b, c)]]
    return next((twos for twos in pairings if all(_summed_over(cells, kept) for kept in twos)), pairings[0])


def project(cells: Cells, tensor: F32, kept: Sequence[int]) -> Projection:
    """One pass over the tensor for the kept modes, one of `passes`."""
    pair = _summed_over(cells, kept)
    return Projection(tensor, pair, None if pair is None else kernels.project_pair(cells, tensor, pair))


def _summed_over(cells: Cells, kept: Sequence[int]) -> tuple[int, int] | None:
    """The two modes beside the kept ones; None if they are not two, or the projection would be too large."""
    rest = [m for m, skip in enumerate(cells.undecomposed) if m not in kept and not skip]
    if len(rest) != 2:
        return None
    # Few rows beside long columns: what is summed over first should be long.
    a, b = rest if rest[1] == cells.order - 1 else sorted(rest, key=lambda m: cells.sizes[m])
    # P has all lanes for each tuple of rows of the kept modes, and what it is contracted with for each number of U_n.
    elements = prod(cells.sizes)
    most = max(elements // max(1, cells.sizes[a] * cells.sizes[b]), *(cells.sizes[n] * cells.ranks[n] for n in kept))
    small = most * cells.spec.cells * cells.ranks[a] * cells.ranks[b] <= max(elements, LARGEST)
    return (a, b) if small else None


def project_one(cells: Cells, tensor: F32, n: int) -> F32:
    """`Y_n` alone: of several cells two modes are summed over at once, and then a third, that of fewest rows.

    For the last mode that pays only where they overlap and there is no third.
    """
    others = [m for m, skip in enumerate(cells.undecomposed) if m != n and not skip]
    last = cells.order - 1
    pays = n != last or (len(others) == 2 and max(cells.spec.mixture) > 1)
    if cells.spec.cells == 1 or len(others) not in (2, 3) or not pays:
        return kernels.project_cells(cells, tensor, n)
    third = [min((m for m in others if m != last), key=lambda m: cells.sizes[m])] if len(others) == 3 else []
    return project(cells, tensor, sorted([n, *third])).onto(cells, n)


def _lanes(pair: tuple[int, int], kept: Sequence[int]) -> list[Index]:
    """Axes of P behind those of rows: of kept a, b and the pair c, d these are c_c, c_d, r_c, c_a, c_b, r_d."""
    return [*(("C", m) for m in pair), ("R", pair[0]), *(("C", m) for m in kept), ("R", pair[1])]


def _sizes(cells: Cells, axes: Sequence[Index]) -> list[int]:
    """How many values the index of each axis takes."""
    sizes = {"I": cells.sizes, "C": cells.spec.clusters, "R": cells.ranks}
    return [sizes[kind][m] for kind, m in axes]


def _basis_in_lanes(cells: Cells, m: int, lanes: Sequence[Index]) -> F32:
    """U_m,c of every lane's cell c: `[I_m, R_m, lanes]`; lanes that differ in a rank alone have the same."""
    rows = [cells.sizes[m], cells.ranks[m]]
    dense = kernels.dense_basis(cells, m).reshape(*cells.spec.clusters, *rows)
    order = [cells.order, cells.order + 1, *(k for kind, k in lanes if kind == "C")]
    thin = [cells.spec.clusters[k] if kind == "C" else 1 for kind, k in lanes]
    wide = np.broadcast_to(dense.transpose(order).reshape(*rows, *thin), [*rows, *_sizes(cells, lanes)])
    return np.ascontiguousarray(wide).reshape(*rows, -1)
