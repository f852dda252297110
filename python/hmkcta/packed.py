"""A fitted model as the file stores it: flat arrays a level, and the metadata (`docs/format.md`, sections 3 and 5).

Every decoder works on exactly these arrays, so that there is one layout to understand.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import inf
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from .arrays import F32
from .axes import Axis, Organisation
from .bitstream import I32
from .narrow import BASIS_NUMBERS, CORE_NUMBERS, I8, U8, narrowed
from .parameters import from_whole, most_of_core, of_basis_numbers, of_core_numbers, whole
from .rice import MOST, MOST_ZEROS, code_bytes, decoded, encoded

U16 = NDArray[np.uint16]
U32 = NDArray[np.uint32]
F16 = NDArray[np.float16]


@dataclass(frozen=True, eq=False)
class PackedLevel:
    """The arrays of one level with S nodes of a tensor with N modes; None where the format leaves an array out.

    Tuples are indexed by mode. The part of node ``s`` in a ragged array ``X`` is ``X[X_offset[s] : X_offset[s + 1]]``.
    """

    shape: U32  # [S, 3, N]: C, K, R of each node
    child: U32 | None  # [S + 1]; None at the last level
    row_offset: tuple[U32, ...]  # N x [S + 1]
    core: F16  # per node [PC, R_1, .., R_N]
    core_offset: U32
    core_scale: F32  # per node [PC]
    cell_offset: U32
    cluster: tuple[U16 | None, ...]  # per node [m, K_n]
    cluster_offset: tuple[U32 | None, ...]
    basis: tuple[F16 | None, ...]  # per node [m, K_n, PC_-n, R_n]
    basis_offset: tuple[U32 | None, ...]
    part: tuple[U16 | None, ...]  # [rows]; None at the last level and for undecomposed modes
    local: tuple[U32 | None, ...]  # [rows]; likewise
    bits: int = 16  # of a core or basis number in the file; of 8 the arrays hold what the bytes stand for (`narrow.py`)
    rice: tuple[U8 | None, ...] = ()  # of a packed level: per node [R_n], see `parameters`; else empty

    @property
    def nodes(self) -> int:
        """S, the number of nodes of the level."""
        return self.shape.shape[0]

    @property
    def order(self) -> int:
        """N, the number of modes."""
        return self.shape.shape[2]

    def numbers(self) -> int:
        """Core and basis numbers stored; the paper counts 2 bytes each."""
        return self.core.size + sum(basis.size for basis in self.basis if basis is not None)

    @property
    def number_bytes(self) -> int:
        """Bytes of the core and basis numbers in the file."""
        return self.core_bytes + sum(self.basis_bytes(n) for n in range(self.order))

    @property
    def core_bytes(self) -> int:
        """Bytes of the core numbers in the file."""
        return code_bytes(*self.whole_numbers("core", self.core)) if self.rice else self.bits // 8 * self.core.size

    def basis_bytes(self, n: int) -> int:
        """Bytes of the basis numbers of a mode in the file."""
        basis = self.basis[n]
        if basis is None:
            return 0
        return code_bytes(*self.whole_numbers(f"basis/{n}", basis)) if self.rice else self.bits // 8 * basis.size

    def tables(self) -> Iterator[tuple[str, NDArray[Any]]]:
        """Names (without ``level/<l>/``) and arrays of the small integer and scale tables."""
        yield "shape", self.shape
        if self.child is not None:
            yield "child", self.child
        yield "core_offset", self.core_offset
        yield "cell_offset", self.cell_offset
        yield "core_scale", self.core_scale
        yield from ((f"rice/{n}", entries) for n, entries in enumerate(self.rice) if entries is not None)
        for n in range(self.order):
            yield f"row_offset/{n}", self.row_offset[n]
            per_mode = (
                ("cluster", self.cluster[n]),
                ("cluster_offset", self.cluster_offset[n]),
                ("basis_offset", self.basis_offset[n]),
                ("part", self.part[n]),
                ("local", self.local[n]),
            )
            yield from ((f"{name}/{n}", array) for name, array in per_mode if array is not None)

    def wide(self) -> Iterator[tuple[str, F16]]:
        """Names (without ``level/<l>/``) and arrays of the core and basis numbers, as decoders take them."""
        yield "core", self.core
        yield from ((f"basis/{n}", basis) for n, basis in enumerate(self.basis) if basis is not None)

    def coefficients(self) -> Iterator[tuple[str, F16 | I8 | U8]]:
        """The same as the file has them: bytes, or in a packed level codes."""
        for name, array in self.wide():
            if self.rice:
                yield name, encoded(*self.whole_numbers(name, array))
            else:
                table = CORE_NUMBERS if name == "core" else BASIS_NUMBERS
                yield name, narrowed(array, table) if self.bits == 8 else array

    def whole_numbers(self, name: str, array: F16) -> tuple[I32, U8]:
        """The whole numbers of an array of a packed level, and the parameters of their codes."""
        parameters, steps = self._parameters(name)
        # The largest number that there is a code for may be one more in float16.
        most = np.maximum(MOST, (MOST_ZEROS // 2) << parameters.astype(np.int32)) - 1
        return np.minimum(whole(array, steps), most), parameters

    def unpacked(self, name: str, codes: U8) -> F16:
        """The numbers of an array of a packed level, of their codes in the file."""
        parameters, steps = self._parameters(name)
        return from_whole(decoded(codes, parameters), steps)

    def _parameters(self, name: str) -> tuple[U8, U8]:
        """Of each number of an array the parameter of its code, and the one that its steps go with."""
        if name == "core":
            most = most_of_core(self.rice, self.shape[:, 2])
            return of_core_numbers(self.rice, self.shape), np.repeat(most, np.diff(self.core_offset.astype(np.int64)))
        n = int(name.split("/")[1])
        entries, offsets = self.rice[n], self.basis_offset[n]
        assert entries is not None
        assert offsets is not None
        own = of_basis_numbers(entries, self.shape[:, 2, n], np.diff(offsets.astype(np.int64)))
        return own, own


@dataclass(frozen=True)
class LevelQuality:
    """Quality up to a level, measured on the stored numbers against the source; see `measure`."""

    snr_db: float
    rmse: float
    max_abs_error: float


@dataclass(frozen=True)
class LevelBounds:
    """The largest C, K, R of any node of a level, and its subdivision scheme: what a shader is built for."""

    clusters: tuple[int, ...]
    mixture: tuple[int, ...]
    ranks: tuple[int, ...]
    scheme: str


@dataclass(frozen=True, eq=False)
class Metadata:
    """What a decoder and a person need to know about a file (`docs/format.md`, section 5).

    `transform` is the value transform as stored, ``{"name": "identity"}`` or a name with its constants;
    `quality` is in the domain of the source values.
    """

    source_dtype: str
    axes: tuple[Axis, ...]
    organisation: Organisation
    levels: tuple[LevelBounds, ...]
    undecomposed: tuple[int, ...] = ()
    kind: str = "generic"
    transform: dict[str, Any] = field(default_factory=lambda: {"name": "identity"})
    quality: tuple[LevelQuality, ...] = ()
    source: dict[str, Any] = field(default_factory=dict[str, Any])
    writer: str = ""
    seed: int = 0

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
        return replace(self, levels=self.levels[:level], quality=self.quality[:level], source=source)
