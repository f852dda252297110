"""A fitted model in memory: flat arrays of each stage of the tree, and the metadata.

Every decoder works on exactly these arrays, so that there is one layout to understand.

A *stage* is one step down the tree; a *level*, what people see, is a stage that has numbers. Stages of cut nodes alone,
which have none, belong to the level behind them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from .arrays import F32
from .axes import Axis, Organisation

U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]
U32 = NDArray[np.uint32]
F16 = NDArray[np.float16]


@dataclass(frozen=True, eq=False)
class PackedLevel:
    """The arrays of one stage with S nodes of a tensor with N modes.

    Tuples are indexed by mode. The part of node ``s`` in a ragged array ``X`` is ``X[X_offset[s] : X_offset[s + 1]]``.
    By its ``shape`` a node is one of three:

    - all zero: it adds nothing and has no children;
    - a *cut*, K = R = 0 < C in all modes: it adds nothing, and its rows go to prod C children. Not at the last stage;
    - *cells*: it adds numbers, and has prod C children or none. A mode with K = 0 is *undecomposed in the node*: C is
      1, R are its rows, the basis is the identity, of which the node has no entries in `cluster`, `basis`, `column`.

    Rows of one part keep their order, so that a mode with C = 1 keeps its rows' positions.
    """

    shape: U32  # [S, 3, N]: C, K, R of each node
    child: U32 | None  # [S + 1]; None at the last stage
    row_offset: tuple[U32, ...]  # N x [S + 1]
    core: F16  # per node [PC, R_1, .., R_N]
    core_offset: U32
    core_scale: F32  # per node [PC]
    cell_offset: U32
    cluster: tuple[U16, ...]  # per node [m, K_n]
    cluster_offset: tuple[U32, ...]
    basis: tuple[F16, ...]  # per node [m, K_n, PC_-n, R_n]
    basis_offset: tuple[U32, ...]
    part: tuple[U16 | None, ...]  # [rows], all of every node; None at the last stage
    local: tuple[U32 | None, ...]  # likewise: the position of a row among those of its part
    step: float | None = None  # D, of which core numbers are multiples; None: numbers are float16
    column: tuple[U8, ...] = ()  # per node [PC, R_n]: k of every column of a basis; without a step no arrays

    @property
    def nodes(self) -> int:
        """S, the number of nodes of the level."""
        return self.shape.shape[0]

    @property
    def order(self) -> int:
        """N, the number of modes."""
        return self.shape.shape[2]

    @property
    def has_cells(self) -> NDArray[np.bool_]:
        """Which nodes add numbers, [S]; the others are empty, or cuts."""
        return np.any(self.shape[:, 2], axis=1)

    @property
    def is_cut(self) -> bool:
        """Whether the stage has no numbers, but cut nodes that lead on to the next."""
        return bool(self.shape[:, 0].any() and not self.shape[:, 2].any())

    @property
    def undecomposed(self) -> NDArray[np.bool_]:
        """Which modes are undecomposed in each node, [S, N]."""
        return (self.shape[:, 1] == 0) & (self.shape[:, 2] > 0)

    @property
    def decode_cost(self) -> int:
        """Multiply-adds for one scattered element: the largest prod R_n K_n of any node, of its decomposed modes."""
        _, mixture, ranks = self.shape.astype(np.int64).transpose(1, 0, 2)
        costs = np.where(self.undecomposed, 1, mixture * ranks).prod(axis=1)
        return int((costs * self.has_cells).max(initial=0))

    def numbers(self) -> int:
        """Core and basis numbers stored; the paper counts 2 bytes each."""
        return self.core.size + sum(basis.size for basis in self.basis)

    def wide(self) -> Iterator[tuple[str, F16]]:
        """Names and arrays of the core and basis numbers."""
        yield "core", self.core
        yield from ((f"basis/{n}", basis) for n, basis in enumerate(self.basis))


@dataclass(frozen=True)
class LevelQuality:
    """Quality up to a level, measured on the stored numbers against the source; see `measure`."""

    snr_db: float
    rmse: float
    max_abs_error: float


@dataclass(frozen=True)
class LevelBounds:
    """The largest C, K, R of any node of a stage, and its subdivision scheme: what a shader is built for."""

    clusters: tuple[int, ...]
    mixture: tuple[int, ...]
    ranks: tuple[int, ...]
    scheme: str

    @property
    def is_cut(self) -> bool:
        """Whether the stage has no numbers, but cut nodes that lead on to the next."""
        return any(self.clusters) and not any(self.ranks)


def bounds_of(level: PackedLevel, scheme: str = "most") -> LevelBounds:
    """The largest C, K and R of a stage's nodes.

    >>> from hmkcta._example import example_level
    >>> bounds_of(example_level())
    LevelBounds(clusters=(1, 1), mixture=(1, 1), ranks=(1, 1), scheme='most')
    """
    clusters, mixture, ranks = (tuple(map(int, row)) for row in level.shape.max(axis=0, initial=0))
    return LevelBounds(clusters, mixture, ranks, scheme)


def level_ends(stages: Sequence[PackedLevel | LevelBounds]) -> list[int]:
    """For each level how many stages it takes together with all levels before it.

    >>> from hmkcta._example import example_level
    >>> level_ends([example_level(), example_level()])
    [1, 2]
    """
    return [number for number, stage in enumerate(stages, 1) if not stage.is_cut]


def undecomposed_modes(stages: Sequence[PackedLevel]) -> tuple[int, ...]:
    """Modes that are undecomposed in every node of a model that has numbers: what a shader is built for.

    >>> from hmkcta._example import example_level
    >>> undecomposed_modes([example_level()])
    ()
    """
    some = any(stage.has_cells.any() for stage in stages)
    return tuple(n for n in range(stages[0].order)
                 if some and all(stage.undecomposed[stage.has_cells, n].all() for stage in stages))


@dataclass(frozen=True, eq=False)
class Metadata:
    """What a decoder and a person need to know about a file (`docs/format.md`, section 3).

    `stages` are all stages of the tree, `quality` and `levels` count those that have numbers.
    `transform` is the value transform as stored, ``{"name": "identity"}`` or a name with its constants;
    `quality` is in the domain of the source values.
    """

    source_dtype: str
    axes: tuple[Axis, ...]
    organisation: Organisation
    stages: tuple[LevelBounds, ...]
    kind: str = "generic"
    transform: dict[str, Any] = field(default_factory=lambda: {"name": "identity"})
    quality: tuple[LevelQuality, ...] = ()
    source: dict[str, Any] = field(default_factory=dict[str, Any])
    writer: str = ""
    seed: int = 0

    @property
    def levels(self) -> tuple[LevelBounds, ...]:
        """Bounds of the stages that have numbers."""
        return tuple(stage for stage in self.stages if not stage.is_cut)

    @property
    def is_transformed(self) -> bool:
        """Whether levels approximate transformed values."""
        return self.transform["name"] != "identity"

    @property
    def transformed_snr_db(self) -> list[float | None]:
        """SNR of each level in the domain of the value transform, None where the file does not say it.

        Its `quality` is in that of the values. What a file says of its source is free, so it may be anything.
        """
        told, count = self.source.get("transformed_snr_db"), len(self.levels)
        if not isinstance(told, list) or len(cast("list[Any]", told)) != count:
            return [None] * count
        return [float(snr) if isinstance(snr, int | float) else inf if snr is None else None
                for snr in cast("list[Any]", told)]

    def upto(self, level: int) -> Metadata:
        """Of a model of the levels 1 to `level`."""
        source, told = self.source, self.source.get("transformed_snr_db")
        if isinstance(told, list):  # one for each level
            source = {**source, "transformed_snr_db": cast("list[Any]", told)[:level]}
        stages = self.stages[: level_ends(self.stages)[level - 1]]
        return replace(self, stages=stages, quality=self.quality[:level], source=source)
