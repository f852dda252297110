"""Projections by two modes at once are those of one mode after another."""

from __future__ import annotations

import pytest

from hmkcta.backends import reference
from hmkcta.fitting.projection import project_one
from hmkcta.plan import LevelSpec
from test_kernels import close, random_cells, smooth_data


@pytest.mark.parametrize("order", [3, 4, 5])
@pytest.mark.parametrize("rank", [2, None])
@pytest.mark.parametrize("mixture", [1, 2])
def test_one_projection_is_that_of_the_cells(order: int, rank: int | None, mixture: int) -> None:
    spec = LevelSpec((rank, *(2,) * (order - 1)), (1, *(3,) * (order - 1)), (1, *(mixture,) * (order - 1)))
    cells, data = random_cells((3, 6, 5, 7, 4)[:order], spec, 3), smooth_data((3, 6, 5, 7, 4)[:order], 3)
    for n in range(order):
        close(project_one(cells, data, n), reference.project_cells(cells, data, n), 1e-4)
