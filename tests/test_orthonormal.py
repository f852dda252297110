"""Bases become orthonormal, cores take what turned them: the model stays, and the backends agree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings

from hmkcta.backends import Kernels, native, reference
from hmkcta.cells import Cells, dense_basis
from hmkcta.plan import LevelSpec
from test_kernels import LARGE, Node, close, model_of, nodes, random_cells

BACKENDS = pytest.mark.parametrize("backend", [native, reference], ids=["native", "reference"])


def decomposed(cells: Cells) -> list[int]:
    return [n for n, skip in enumerate(cells.undecomposed) if not skip]


def check_same(cells: Cells) -> None:
    expected = model_of(cells)
    for n in decomposed(cells):
        np.testing.assert_array_equal(native.dense_basis(cells, n), dense_basis(cells, n))
        found, readable = cells.copy(), cells.copy()
        native.orthonormalise(found, n)
        reference.orthonormalise(readable, n)
        close(found.bases[n], readable.bases[n], 1e-3)
        close(found.cores, readable.cores, 1e-4)
        close(model_of(found), expected, 1e-5)


@settings(max_examples=100, deadline=None)
@given(nodes())
def test_backends_agree(node: Node) -> None:
    check_same(node[0])


@pytest.mark.parametrize(("sizes", "spec"), LARGE, ids=str)
def test_backends_agree_on_large_nodes(sizes: tuple[int, ...], spec: LevelSpec) -> None:
    check_same(random_cells(sizes, spec, 5))


@BACKENDS
def test_columns_are_orthonormal_or_zero(backend: Kernels) -> None:
    cells = random_cells((9, 4, 5), LevelSpec((3, 6, None), (2, 3, 1), (2, 2, 1)), 1, empty=True)
    cells.bases[0][..., 1] = -2 * cells.bases[0][..., 0]
    for n in decomposed(cells):
        backend.orthonormalise(cells, n)
        dense = dense_basis(cells, n).astype(np.float64)
        gram = dense.transpose(0, 2, 1) @ dense
        kept = np.diagonal(gram, axis1=1, axis2=2) > 0.5
        close(gram, np.eye(gram.shape[1]) * kept[:, None], 1e-5)
        assert not kept.all(), "some columns depend on others, or have no rows"
    assert not cells.bases[0][..., 1].any(), "what depends on columns before it is zero"


def test_an_undecomposed_mode_has_nothing_to_turn() -> None:
    cells = random_cells((4, 3), LevelSpec((None, 2), (1, 2), (1, 1)), 2)
    with pytest.raises(ValueError, match="mode 1 is not decomposed"):
        native.orthonormalise(cells, 0)
    with pytest.raises(ValueError, match="mode 1 is not decomposed"):
        native.dense_basis(cells, 0)
