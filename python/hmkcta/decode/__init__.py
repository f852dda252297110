"""Decoding: elements of the tensor (indices of modes, not of source axes) from packed levels.

The kernels of `backends.decoding` do the work, or their readable twins `scattered` and `dense`, which also stand in for
them where a block is asked for in float64.

`decode_elements` follows `docs/format.md`, section 7, for scattered elements, and the WGSL decoder mirrors it function
by function; `decode_block` decodes an outer product of index lists at a small part of the cost an element. Both read
the float16 numbers as they are stored and compute in float32 (float64 on request: quality is measured with it).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .. import backends
from ..errors import invalid
from ..packed import PackedLevel, level_ends
from . import dense, scattered
from .scattered import Index, Real


def decode_elements(
    stages: Sequence[PackedLevel],
    sizes: Sequence[int],
    coords: NDArray[np.integer[Any]],
    upto: int | None = None,
    dtype: DTypeLike = np.float32,
) -> Real:
    """Decode scattered elements.

    Args:
        stages: the model's.
        sizes: mode sizes I_1..I_N.
        coords: mode indices of each element, [B, N], from 0.
        upto: how many levels to add up, all by default.
        dtype: float32 or float64, of the arithmetic and of the result.

    Returns:
        The values, [B], in the domain of the value transform.

    Raises:
        HmkctaError: coordinates that are no integers, of another order or outside the tensor; `upto` outside 1..L.

    >>> from hmkcta._example import example_level
    >>> decode_elements([example_level()], (2, 3), np.array([[1, 2], [0, 2]]))
    array([6., 3.], dtype=float32)
    """
    coords = np.asarray(coords)
    if coords.ndim != 2 or coords.shape[1] != len(sizes):
        raise invalid("coords-shape", "coords", f"shape {coords.shape}", f"[elements, {len(sizes)}]")
    for n, size in enumerate(sizes):
        check_indices(coords[:, n], size, f"coords of mode {n + 1}")
    chosen, out = first_levels(stages, upto), np.zeros(len(coords), _float_type(dtype))
    with np.errstate(over="ignore", invalid="ignore"):  # Model looks for these, and decodes them again in float64
        _add_elements(chosen, coords.astype(np.intp, copy=False), out)
    return out


def decode_block(
    stages: Sequence[PackedLevel],
    sizes: Sequence[int],
    rows: Sequence[NDArray[np.integer[Any]]],
    upto: int | None = None,
    out: Real | None = None,
    dtype: DTypeLike = np.float32,
) -> Real:
    """Decode the dense block of an outer product, like ``tensor[np.ix_(*rows)]``.

    Args:
        stages: the model's.
        sizes: mode sizes I_1..I_N.
        rows: N one-dimensional index arrays from 0, in any order and with repeats.
        upto: how many levels to add up, all by default.
        out: where to put the block (float32 or float64), instead of a new array.
        dtype: float32 or float64, of the arithmetic and of the result, where `out` does not say it.

    Returns:
        The block, [len(rows[0]), .., len(rows[N-1])], in the domain of the value transform.

    Raises:
        HmkctaError: rows that are no integers, not one array a mode, or outside it; `upto` outside 1..L; an
            unsuitable `out`.

    >>> from hmkcta._example import example_level
    >>> decode_block([example_level()], (2, 3), [np.array([1, 0]), np.array([2, 2])])
    array([[6., 6.],
           [3., 3.]], dtype=float32)
    """
    if len(rows) != len(sizes):
        raise invalid("rows-count", "rows", f"{len(rows)} arrays", f"{len(sizes)}, one a mode")
    for n, (index, size) in enumerate(zip(rows, sizes, strict=True)):
        if np.ndim(index) != 1:
            raise invalid("rows-shape", f"rows of mode {n + 1}", f"shape {np.shape(index)}", "one dimension")
        check_indices(np.asarray(index), size, f"rows of mode {n + 1}")
    shape = tuple(len(index) for index in rows)
    if out is not None and out.shape != shape:
        raise invalid("out-shape", "out", f"shape {out.shape}", f"{shape}, one number for each requested row")
    chosen, kind = first_levels(stages, upto), _float_type(dtype if out is None else out.dtype)
    block = out if out is not None and out.flags.c_contiguous and out.flags.aligned else np.empty(shape, kind)
    block[...] = 0
    if prod(shape):
        with np.errstate(over="ignore", invalid="ignore"):  # as in `decode_elements`
            _add_block(chosen, [np.asarray(index, np.intp) for index in rows], block)
    if out is not None and block is not out:
        out[...] = block
        return out
    return block


def _native(levels: Sequence[PackedLevel]) -> Any:  # a module, or None
    """The native kernels where they are in use and have room for the model's modes."""
    if backends.name != "native":
        return None
    from ..backends import decoding

    return decoding if levels[0].order <= decoding.MOST_MODES else None


def _add_elements(levels: Sequence[PackedLevel], coords: Index, out: Real) -> None:
    native = _native(levels)
    (native or scattered).decode_batches(levels, coords, out)


def _add_block(levels: Sequence[PackedLevel], rows: Sequence[Index], block: Real, first: int = 0) -> None:
    native = _native(levels) if block.dtype == np.float32 else None
    (native or dense).add_block(levels, rows, block, first)


def add_level(stages: Sequence[PackedLevel], rows: Sequence[Index], block: Real, level: int) -> None:
    """Add one level to a block that holds the levels before it: what `decode_block` would give up to this level.

    Args:
        stages: the model's.
        rows: as of `decode_block`, and valid.
        block: C-contiguous, float32 or float64, of the rows' shape.
        level: its number, 1..L.

    >>> from hmkcta._example import example_level
    >>> block = np.zeros((1, 2), np.float32)
    >>> add_level([example_level()], [np.array([1]), np.array([0, 2])], block, 1)
    >>> block
    array([[2., 6.]], dtype=float32)
    """
    if block.size:
        with np.errstate(over="ignore", invalid="ignore"):  # as in `decode_elements`
            end = level_ends(stages)[level - 1]
            _add_block(stages[:end], rows, block, end - 1)


def first_levels(stages: Sequence[PackedLevel], upto: int | None) -> Sequence[PackedLevel]:
    """The stages of the first `upto` levels; all of them for None."""
    if upto is None:
        return stages
    ends = level_ends(stages)
    if not 1 <= upto <= len(ends):
        raise invalid("level-out-of-range", "upto", upto, f"1 to {len(ends)}")
    return stages[: ends[upto - 1]]


def check_indices(index: NDArray[Any], size: int, where: str) -> None:
    """Refuse anything but integers from 0 to size - 1: a wrong index would silently decode another element."""
    if index.dtype.kind not in "iu":
        raise invalid("index-type", where, f"numbers of type {index.dtype}", "integers")
    if index.size and (int(index.min()) < 0 or int(index.max()) >= size):
        bad = (index < 0) | (index >= size)
        found = f"{index[bad][0]} ({np.count_nonzero(bad)} such)"
        raise invalid("index-out-of-range", where, found, f"0 to {size - 1}")


def _float_type(dtype: DTypeLike) -> np.dtype[Any]:
    kind = np.dtype(dtype)
    if kind not in (np.dtype(np.float32), np.dtype(np.float64)):
        raise invalid("dtype", "dtype", kind, "float32 or float64", "convert the result, or pass another out")
    return kind

