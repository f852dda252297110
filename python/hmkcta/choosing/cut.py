"""Sampled blocks of one organisation of axes and one grid: as tensors, with their HOSVD cores and how ranks grow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis, Organisation
from ..support.lazy import lazy
from .blocks import Blocks, halved, organised, split
from .growth import Growth, growth_of
from .spectra import Values, cores

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Cut:
    """An organisation of axes cut by a grid.

    Attributes:
        batch: the sampled blocks as tensors, `[B, modes]`; with `energy`, their squared norms.
        edges: mode sizes of a block before thinning.
        sizes: mode sizes of the whole.
        clusters: numbers of blocks along each mode.
        precision: what cores and energies are found in.
        enough: share of the energy that ranks may leave untold.
    """

    axes: Sequence[Axis]
    organisation: Organisation
    grid: tuple[int, ...]
    blocks: Blocks
    batch: F32
    energy: F64
    limits: tuple[int, ...]
    edges: tuple[int, ...]
    sizes: tuple[int, ...]
    clusters: tuple[int, ...]
    precision: Any
    enough: float

    @lazy
    def core(self) -> Values:
        """Their truncated HOSVD cores, no mode shorter than its entry of `limits`."""
        return cores(self.batch, self.limits, self.precision, self.enough)

    @lazy
    def growth(self) -> Growth | None:
        """What ranks of whole blocks are told by; None where no rows were left out."""
        return self.growth_of(self.batch, self.core, (1,) * len(self.grid), self.edges)

    def growth_of(self, parts: F32, core: Values, way: Sequence[int], edges: Sequence[int]) -> Growth | None:
        """The same of the blocks cut into so many `parts` along each axis, by their cores and rows."""
        if not self.blocks.thinned:
            return None
        fewer = organised(split(halved(self.blocks), way), self.axes, self.organisation)
        return growth_of(parts, core, fewer, edges)
