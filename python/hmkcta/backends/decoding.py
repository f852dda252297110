"""Decoding by the Rust kernels: `decode_batches` of `decode.scattered` and `add_block` of `decode.dense`.

Levels are handed over as they are stored: nothing is converted or copied but what an element needs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError, Kind, sentence
from ..packed import PackedLevel
from ..support.extension import native

Index = NDArray[np.intp]

#: Modes the kernels have room for: as many as a file may have.
MOST_MODES = 8
#: What the kernels, and what flattens arrays for them, raise of a level whose arrays are none.
NO_LEVEL = (ValueError, TypeError, AttributeError, OverflowError, RuntimeError)
#: Of levels that are in use.
flattened: WeakKeyDictionary[PackedLevel, dict[str, Any]] = WeakKeyDictionary()


def decode_batches(levels: Sequence[PackedLevel], coords: Index, out: NDArray[Any]) -> None:
    """Add the values of the elements at `coords` [B, N] to `out` [B], float32 or float64, contiguous."""
    kernel = native.decode_scattered_f32 if out.dtype == np.float32 else native.decode_scattered_f64
    flat = np.ascontiguousarray(coords, np.int64).reshape(-1)
    _checked(lambda: kernel([_arrays(level) for level in levels], flat, out))


def add_block(levels: Sequence[PackedLevel], rows: Sequence[Index], block: NDArray[np.float32], first: int = 0) -> None:
    """Add the elements of the outer product of `rows` (N index lists) to the C-contiguous `block`.

    The levels before number `first`, from 0, only lead the way.
    """
    wide = [np.ascontiguousarray(index, np.int64) for index in rows]
    _checked(lambda: native.decode_block([_arrays(level) for level in levels], wide, first, block.reshape(-1)))


def _checked(decode: Callable[[], None]) -> None:
    """Arrays that contradict each other are reported: no file has them, but models can be made of any."""
    try:
        decode()
    except NO_LEVEL as error:
        raise HmkctaError(
            Kind.CORRUPTION, "level-arrays", "arrays of a level", found=sentence(error),
            allowed="what docs/format.md, section 4, says",
            hint="make the model of the stages of a file, or of compress") from error


def _arrays(level: PackedLevel) -> dict[str, Any]:
    """The arrays of a level as the kernels take them; made once, as it takes longer than to decode an element."""
    if level not in flattened:
        flattened[level] = _flat_arrays(level)
    return flattened[level]


def _flat_arrays(level: PackedLevel) -> dict[str, Any]:
    return {
        "shape": _flat(level.shape), "child": _flat(level.child), "row_offset": [_flat(x) for x in level.row_offset],
        "core": _flat(level.core), "core_offset": _flat(level.core_offset),
        "core_scale": _flat(level.core_scale), "cell_offset": _flat(level.cell_offset),
        "cluster": [_flat(x) for x in level.cluster], "cluster_offset": [_flat(x) for x in level.cluster_offset],
        "basis": [_flat(x) for x in level.basis], "basis_offset": [_flat(x) for x in level.basis_offset],
        "part": [_flat(x) for x in level.part], "local": [_flat(x) for x in level.local],
    }  # fmt: skip


def _flat(array: NDArray[Any] | None) -> NDArray[Any] | None:
    """In one piece and aligned, float16 as its bits."""
    if array is None:
        return None
    flat = array.reshape(-1)
    if not (flat.flags.c_contiguous and flat.flags.aligned):
        flat = np.require(flat, None, ["C", "A"])
    return flat.view(np.uint16) if flat.dtype == np.float16 else flat
