"""Cores of all cells together: what conjugate gradients leave falls with every step, to the least there is."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from numpy.typing import NDArray

from hmkcta.backends import Kernels, native, reference
from hmkcta.cells import Cells, dense_basis
from hmkcta.fitting.search import all_products
from hmkcta.plan import LevelSpec
from test_kernels import LARGE, Node, energy, model_of, nodes, random_cells, smooth_data

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


def projected_on_all(cells: Cells, data: F32) -> F64:
    """The data projected on the bases of every cell: `[PC, R_1, .., R_N]`."""
    x = np.broadcast_to(data.astype(np.float64), (cells.spec.cells, *data.shape))
    for m, skip in enumerate(cells.undecomposed):
        if not skip:
            x = np.moveaxis(np.einsum("c...i,cir->c...r", np.moveaxis(x, m + 1, -1), dense_basis(cells, m)), -1, m + 1)
    return x


def left_after(kernels: Kernels, node: Node, steps: int) -> float:
    """Squared error of the node's data after so many steps."""
    solved = node[0].copy()
    kernels.solve_cores(solved, all_products(solved), projected_on_all(*node), steps)
    return energy(node[1] - model_of(solved))


def check_same(node: Node) -> None:
    """Both leave as much after each step, and no more than before it."""
    before = energy(node[1] - model_of(node[0]))
    whole = max(before, energy(node[1]))
    for steps in (0, 1, 2, 3):
        found, expected = left_after(native, node, steps), left_after(reference, node, steps)
        assert found == pytest.approx(expected, rel=1e-3, abs=1e-5 * whole)
        assert found <= before * (1 + 1e-5) + 1e-9 * whole
        before = found


@settings(max_examples=60, deadline=None)
@given(nodes())
def test_backends_agree(node: Node) -> None:
    check_same(node)


@pytest.mark.parametrize(("sizes", "spec"), LARGE, ids=lambda value: str(value))
def test_backends_agree_on_large_nodes(sizes: tuple[int, ...], spec: LevelSpec) -> None:
    check_same((random_cells(sizes, spec, 5), smooth_data(sizes, 5)))


def test_threads_do_not_change_a_bit() -> None:
    spec = LevelSpec((2, 3, 3), (3, 4, 6), (2, 2, 3))
    cells, data = random_cells((70, 64, 90), spec, 8), smooth_data((70, 64, 90), 8)
    b, found = projected_on_all(cells, data), set[bytes]()
    try:
        for threads in (1, 2, 5, 0):
            native.set_threads(threads)
            solved = cells.copy()
            native.solve_cores(solved, all_products(solved), b, 3)
            found.add(solved.cores.tobytes())
    finally:
        native.set_threads(0)
    assert len(found) == 1


@pytest.mark.parametrize("backend", [native, reference], ids=["native", "reference"])
def test_cores_end_as_the_least_squares_solution(backend: Kernels) -> None:
    spec = LevelSpec((2, 3, None, 2), (2, 3, 1, 2), (2, 2, 1, 1))
    cells, data = random_cells((9, 10, 3, 8), spec, 7), smooth_data((9, 10, 3, 8), 7)
    columns: list[F64] = []
    for c, core in np.ndindex(spec.cells, cells.cores[0].size):
        one = replace(cells, cores=np.zeros_like(cells.cores))
        one.cores[c].reshape(-1)[core] = 1
        columns.append(model_of(one).reshape(-1).astype(np.float64))
    system, values = np.stack(columns, axis=1), data.reshape(-1).astype(np.float64)
    least = float(np.square(values - system @ np.linalg.lstsq(system, values)[0]).sum())
    left: list[float] = []
    for steps in (0, 1, 2, 4, 400):
        solved = cells.copy()
        backend.solve_cores(solved, all_products(cells), projected_on_all(cells, data), steps)
        left.append(energy(data - model_of(solved)))
    assert all(after < before for before, after in pairwise(left))
    assert left[0] > 2 * least
    assert left[-1] == pytest.approx(least, rel=1e-3)
