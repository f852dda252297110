"""Models as files have them, where modes are undecomposed in all nodes or in none, and no node is cut."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, cast

import numpy as np

from ..errors import invalid
from ..packed import LevelBounds, Metadata, PackedLevel, bounds_of, undecomposed_modes


@dataclass(frozen=True, eq=False)
class Stored(Metadata):
    """Metadata of a file."""

    undecomposed: tuple[int, ...] = ()


def stored(metadata: Metadata, undecomposed: Sequence[int]) -> Metadata:
    """The metadata of a file whose modes of these numbers are undecomposed."""
    bounds = tuple(replace(level, mixture=_ones(level, undecomposed)) for level in metadata.stages)
    return Stored(**_fields(metadata, bounds), undecomposed=tuple(undecomposed))


def to_stored(metadata: Metadata, levels: Sequence[PackedLevel]) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """The model with no arrays, and K = 1, for modes that are undecomposed."""
    if isinstance(metadata, Stored) or not levels or not all(level.shape.ndim == 3 for level in levels):
        return metadata, tuple(levels)
    modes = undecomposed_modes(levels)
    if any(level.is_cut or level.undecomposed.sum() != level.has_cells.sum() * len(modes) for level in levels):
        raise invalid("level-arrays", "levels", "cut nodes, or nodes with undecomposed modes of their own", "neither")
    return stored(metadata, modes), tuple(_left_out(each, modes) for each in levels)


def level_parts(levels: Sequence[PackedLevel]) -> tuple[PackedLevel, ...]:
    """The levels as files have them."""
    modes = undecomposed_modes(levels)
    return tuple(_left_out(level, modes) for level in levels)


def from_stored(metadata: Metadata, levels: Sequence[PackedLevel]) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """The other way round."""
    if not isinstance(metadata, Stored):
        return metadata, tuple(levels)
    whole = tuple(_filled_in(level, metadata.undecomposed) for level in levels)
    bounds = tuple(bounds_of(level, told.scheme) for level, told in zip(whole, metadata.stages, strict=True))
    kept = bounds if metadata.undecomposed else metadata.stages
    return Metadata(**_fields(metadata, kept)), whole


def _fields(metadata: Metadata, stages: tuple[LevelBounds, ...]) -> dict[str, Any]:
    return {field.name: stages if field.name == "stages" else getattr(metadata, field.name)
            for field in fields(Metadata)}


def _ones(level: LevelBounds, modes: Sequence[int]) -> tuple[int, ...]:
    return tuple(1 if n in modes and any(level.ranks) else k for n, k in enumerate(level.mixture))


def _left_out(level: PackedLevel, modes: Sequence[int]) -> PackedLevel:
    shape = level.shape.copy()
    shape[:, 1][level.undecomposed] = 1

    def kept(arrays: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(None if n in modes else array for n, array in enumerate(arrays))

    return replace(level, shape=shape, **{name: kept(getattr(level, name)) for name in _OF_MODES})


def _filled_in(level: PackedLevel, modes: Sequence[int]) -> PackedLevel:
    if not modes:
        return level
    shape, nothing = level.shape.copy(), np.zeros(level.nodes + 1, np.uint32)
    shape[:, 1, list(modes)] = 0
    lengths = [np.diff(offset.astype(np.int64)) for offset in level.row_offset]
    places = {n: np.concatenate([np.zeros(0, np.int64), *map(np.arange, lengths[n].tolist())]) for n in modes}
    made: dict[str, Callable[[int], Any]] = {
        "cluster": lambda _: np.zeros(0, np.uint16), "basis": lambda _: np.zeros(0, np.float16),
        "cluster_offset": lambda _: nothing, "basis_offset": lambda _: nothing,
        "part": lambda n: None if level.child is None else np.zeros(int(level.row_offset[n][-1]), np.uint16),
        "local": lambda n: None if level.child is None else places[n].astype(np.uint32),
    }

    def whole(name: str) -> tuple[Any, ...]:
        arrays = cast("tuple[Any, ...]", getattr(level, name))
        return tuple(made[name](n) if n in modes else array for n, array in enumerate(arrays))

    return replace(level, shape=shape, **{name: whole(name) for name in _OF_MODES})


_OF_MODES = ("cluster", "cluster_offset", "basis", "basis_offset", "part", "local")
