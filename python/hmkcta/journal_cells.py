"""The fitted cells of a node as bytes of a journal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import prod
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .cells import Cells
from .plan import LevelSpec

Number = TypeVar("Number", np.uint16, np.float16, np.float32)


def packed(cells: Cells) -> bytes:
    """I, R (-1: undecomposed), C, K of every mode, memberships, bases as float16, which they are rounded to, cores.

    Cores are kept as float32: they are float16 times a factor, and which factor is not known any more.
    """
    ranks = [-1 if rank is None else rank for rank in cells.spec.ranks]
    shape = np.array([cells.sizes, ranks, cells.spec.clusters, cells.spec.mixture], np.int32)
    numbers = [array.tobytes() for array in (*cells.members, *(b.astype(np.float16) for b in cells.bases), cells.cores)]
    return b"".join([bytes([cells.order]), shape.tobytes(), *numbers])


def unpacked(content: bytes, spec: LevelSpec) -> Cells:
    """The cells; what their spec has beside R, C and K is that of `spec`."""
    place = 1 + 16 * content[0]
    shape = np.frombuffer(content, np.int32, 4 * content[0], 1).reshape(4, -1).tolist()
    sizes, ranks, clusters, mixture = (tuple(row) for row in shape)
    exact = replace(spec, ranks=tuple(None if r < 0 else r for r in ranks), clusters=clusters, mixture=mixture)

    def taken(shape: tuple[int, ...], dtype: type[Number]) -> NDArray[Number]:
        nonlocal place
        array = np.frombuffer(content, dtype, prod(shape), place).reshape(shape)
        place += array.nbytes
        return array.copy()

    members = [taken((i, k), np.uint16) for i, k in zip(sizes, mixture, strict=True)]
    bases = [
        taken((0,) if r < 0 else (i, k, exact.cells // c, r), np.float16).astype(np.float32)
        for i, r, c, k in zip(*shape, strict=True)
    ]
    cores = taken((exact.cells, *(i if r < 0 else r for i, r in zip(sizes, ranks, strict=True))), np.float32)
    return Cells(sizes, exact, members, bases, cores)


def fits(cells: Cells, sizes: Sequence[int], spec: LevelSpec) -> bool:
    """Whether cells can be what a node of these sizes was fitted by, so that a mixed-up journal is noticed."""
    most, found = spec.clamped(sizes), cells.spec
    within = all((r is None) == (m is None) and (r or 0) <= (m or 0)
                 for r, m in zip(found.ranks, most.ranks, strict=True))
    return cells.sizes == tuple(sizes) and found.clusters == most.clusters and within
