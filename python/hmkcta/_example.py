"""The smallest model there is, for the examples in docstrings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .axes import name_axes, separate
from .packed import LevelBounds, LevelQuality, Metadata, PackedLevel


def example_level() -> PackedLevel:
    """The 2 x 3 tensor [[1, 2, 3], [2, 4, 6]] as a core of one number and two bases of one column.

    >>> example_level().numbers()
    6
    """
    def table(*numbers: int) -> NDArray[np.uint32]:
        return np.array(numbers, np.uint32)

    return PackedLevel(
        shape=np.ones((1, 3, 2), np.uint32), child=None, row_offset=(table(0, 2), table(0, 3)),
        core=np.ones(1, np.float16), core_offset=table(0, 1),
        core_scale=np.ones(1, np.float32), cell_offset=table(0, 1),
        cluster=(np.zeros(2, np.uint16), np.zeros(3, np.uint16)), cluster_offset=(table(0, 2), table(0, 3)),
        basis=(np.array([1, 2], np.float16), np.array([1, 2, 3], np.float16)), basis_offset=(table(0, 2), table(0, 3)),
        part=(None, None), local=(None, None),
    )


def example_metadata() -> Metadata:
    """The metadata of `example_level` as a model of one level with the axes y and x."""
    axes = name_axes((2, 3), ["y", "x"])
    bounds = LevelBounds((1, 1), (1, 1), (1, 1), "most")
    return Metadata("float32", axes, separate(axes), (bounds,), quality=(LevelQuality(90.0, 0.0001, 0.0002),))
