"""NumPy indexing without an array: which element of the source each element of the result is.

A key becomes, for every source axis, an array of indices that broadcasts to the shape of the result, as `numpy.ix_`
makes them. So nothing is larger than the key itself, and products of independent indices stay recognisable.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from types import EllipsisType
from typing import Any, TypeAlias, TypeGuard, cast

import numpy as np
from numpy.typing import NDArray

from .errors import HmkctaError, Kind, invalid, shown

Index: TypeAlias = NDArray[np.intp]
_ALLOWED = "integers, slices, ..., None, integer arrays, boolean arrays of the axes that they select from"
#: Most dimensions of a NumPy array.
_MOST_DIMENSIONS = 64
#: Indices of a mode that are looked at first.
_FEW = 256
Array: TypeAlias = NDArray[Any]
Item: TypeAlias = int | slice | EllipsisType | Array | None


class IndexingError(HmkctaError, IndexError):
    """A key that does not fit the shape: an `HmkctaError` that code written for NumPy catches as `IndexError`."""

    def __init__(self, reason: str, where: str, found: object, allowed: object, hint: str = "") -> None:
        super().__init__(Kind.INVALID_ARGUMENT, reason, where, found=found, allowed=allowed, hint=hint)


@dataclass(frozen=True, eq=False)
class Selection:
    """The shape of the result, and of each source axis the indices, broadcastable to that shape (of equal order)."""

    shape: tuple[int, ...]
    axes: tuple[Index, ...]


def select(key: Any, shape: Sequence[int]) -> Selection:
    """Resolve a NumPy key: integers, slices, ellipsis, None, index arrays and boolean masks.

    >>> chosen = select((slice(None, None, -2), [0, 2]), (4, 3))
    >>> chosen.shape, [axis.tolist() for axis in chosen.axes]
    ((2, 2), [[[3], [1]], [[0, 2]]])

    Raises:
        IndexingError: what NumPy would raise an IndexError for; also for a single True or False.
    """
    parts = cast("tuple[Any, ...]", key) if isinstance(key, tuple) else (key,)
    items = _split_masks(_fill([_parse(part) for part in parts], len(shape)), shape)
    if any(isinstance(item, np.ndarray) for item in items):  # then integers are index arrays of no dimension
        items = _as_arrays(items, shape)
    arrays = [(i, item) for i, item in enumerate(items) if isinstance(item, np.ndarray)]
    together = _broadcast([array for _, array in arrays])
    # Index arrays side by side leave their dimensions in place, parted ones put them first.
    adjacent = bool(arrays) and arrays[-1][0] - arrays[0][0] == len(arrays) - 1
    first = sum(1 for item in items[: arrays[0][0]] if item is None or isinstance(item, slice)) if adjacent else 0
    result: list[int] = []
    found: list[tuple[int, Index]] = []  # per source axis: first dimension of the result it goes along, and indices
    for item in items:
        axis = len(found)
        if item is None:
            result.append(1)
        elif isinstance(item, slice):
            start, stop, step = item.indices(shape[axis])
            index = np.arange(start, stop, max(-shape[axis], min(step, shape[axis])))
            found.append((len(result), index))
            result.append(len(index))
        elif isinstance(item, np.ndarray):
            # As in NumPy, indices that broadcasting leaves nothing of may be anything; integers may not.
            gone = 0 in together and item.ndim > 0
            found.append((-1, np.zeros(item.shape, np.intp) if gone else _in_range(item, axis, shape[axis])))
        elif isinstance(item, int):
            found.append((0, np.asarray(_one_in_range(item, axis, shape[axis]))))
    return _spread(result, found, first, together)


def _as_arrays(items: list[Item], shape: Sequence[int]) -> list[Item]:
    """The items, integers as arrays; those out of range are refused as they were given, which arrays may not hold."""
    axis, found = 0, list[Item]()
    for item in items:
        found.append(np.asarray(_one_in_range(item, axis, shape[axis]), np.intp) if isinstance(item, int) else item)
        axis += item is not None and item is not Ellipsis
    return found


def positions(coords: Any, shape: Sequence[int], names: Sequence[str]) -> NDArray[np.float64]:
    """Positions between elements, in units of indices: as given, [.., ndim], each within its axis.

    Raises:
        HmkctaError: a position outside, NaN or masked, or not one number an axis.
    """
    order = len(shape)
    if np.ma.is_masked(coords):
        found = f"{int(np.ma.getmaskarray(coords).sum())} masked values"
        raise invalid("masked", "coords", found, "no mask", "give positions to put there, or leave the masked ones out")
    try:
        points = np.asarray(coords, np.float64)
    except (TypeError, ValueError, OverflowError):  # words, lists of different lengths, huge whole numbers
        raise invalid("argument-type", "coords", shown(coords), f"[.., {order}] numbers, one an axis") from None
    if not points.ndim or points.shape[-1] != order:
        raise invalid("coords-shape", "coords", f"shape {points.shape}", f"[.., {order}], one number an axis")
    flat = points.reshape(-1, order)
    last = np.array(shape) - 1
    outside = ~((flat >= 0) & (flat <= last))
    if outside.any():
        row, axis = (int(i) for i in np.argwhere(outside)[0])
        found = f"{flat[row, axis]} ({int(outside.any(axis=1).sum())} such positions)"
        raise invalid("coords-out-of-range", f"coords of axis {names[axis]}", found, f"0 to {last[axis]}")
    return points


def cut(axes: Sequence[Index], part: tuple[slice, ...]) -> list[Index]:
    """The indices of a slab of the selection."""
    return [index[tuple(span if length > 1 else slice(None) for span, length in zip(part, index.shape, strict=False))]
            for index in axes]


def occurring(modes: Sequence[Index], most: int) -> tuple[list[Index], list[Index]] | None:
    """The rows of each mode that occur among indices, ascending, and every index counted among these.

    None where there are more than `most` combinations of them; a few indices mostly tell.

    >>> occurring([np.array([5, 9, 5]), np.array([2, 2, 0])], 4)
    ([array([5, 9]), array([0, 2])], [array([0, 1, 0]), array([1, 1, 0])])
    """
    few = [index.reshape(-1)[:: 1 + index.size // _FEW] for index in modes]
    if prod(len(np.unique(index)) for index in few) > most:
        return None
    found = [_ranked(index) for index in modes]
    if prod(len(rows) for rows, _ in found) > most:
        return None
    return [rows for rows, _ in found], [places for _, places in found]


def _ranked(index: Index) -> tuple[Index, Index]:
    """Distinct values, ascending, and each one's place among them."""
    low, high = int(index.min()), int(index.max())
    if high - low > 16 * index.size:
        return np.unique(index, return_inverse=True)
    places = index - low if low else index
    there = np.zeros(high - low + 1, np.bool_)
    there[places] = True
    return np.flatnonzero(there) + low, places if there.all() else (np.cumsum(there) - 1)[places]


def _spread(result: list[int], found: list[tuple[int, Index]], first: int, together: tuple[int, ...]) -> Selection:
    """Give every axis's indices the order of the result; the index arrays' dimensions begin at dimension `first`."""
    full = (*result[:first], *together, *result[first:])
    if len(full) > _MOST_DIMENSIONS:
        allowed = f"up to {_MOST_DIMENSIONS}, as NumPy has"
        raise IndexingError("index-dimensions", "index", f"a result of {len(full)} dimensions", allowed)
    axes: list[Index] = []
    for dimension, index in found:
        if dimension < 0:  # an index array: its last dimension is the last of `together`
            trailing = len(full) - first - len(together)
            dimension = len(full) - trailing - index.ndim
        elif dimension >= first:
            dimension += len(together)
        shape = [1] * len(full)
        shape[dimension : dimension + index.ndim] = index.shape
        axes.append(index.reshape(shape))
    return Selection(full, tuple(axes))


def _parse(part: Any) -> Item:
    """One part of the key as an integer, slice, ellipsis, None, or array of integers or booleans."""
    if part is None or part is Ellipsis or isinstance(part, slice):
        return cast("Item", part)
    if isinstance(part, bool | np.bool_):
        raise _lone(bool(cast("Any", part)))
    if not isinstance(part, np.ndarray | list | tuple):
        try:
            return operator.index(part)
        except TypeError:
            pass
    try:
        array: Array = np.asarray(cast("Any", part))
    except ValueError:
        raise IndexingError("index-type", "index", "a ragged list", "an array of integers or booleans") from None
    if not array.size and not isinstance(part, np.ndarray):
        return array.astype(np.intp)  # an empty list
    if array.dtype.kind not in "iub":
        raise IndexingError("index-type", "index", f"numbers of type {array.dtype}", _ALLOWED)
    if array.dtype.kind == "b" and array.ndim == 0:
        raise _lone(bool(array))
    return int(array) if array.ndim == 0 else array


def _lone(truth: bool) -> IndexingError:
    hint = f"write {int(truth)} for an element, None for a new axis"
    return IndexingError("index-type", "index", f"a lone bool, {truth}", _ALLOWED, hint)


def _is_mask(item: Item) -> TypeGuard[Array]:
    return isinstance(item, np.ndarray) and item.dtype.kind == "b"


def _fill(items: list[Item], order: int) -> list[Item]:
    """Replace the ellipsis, written or implied, by slices."""
    taken = sum(item.ndim if _is_mask(item) else 1 for item in items if item is not None and item is not Ellipsis)
    written = [i for i, item in enumerate(items) if item is Ellipsis]
    if len(written) > 1:
        raise IndexingError("index-ellipsis", "index", f"{len(written)} ellipses", "one")
    if taken > order:
        raise IndexingError("index-count", "index", f"{taken} indices", f"up to {order}, one an axis")
    at = written[0] if written else len(items)
    missing = [slice(None)] * (order - taken)
    # The ellipsis itself stays: even an empty one parts index arrays.
    return [*items[:at], Ellipsis, *missing, *items[at + 1 :]]


def _split_masks(items: list[Item], shape: Sequence[int]) -> list[Item]:
    """Replace every boolean mask by the index arrays of its true elements, one for each of its axes."""
    split: list[Item] = []
    for item in items:
        if _is_mask(item):
            axis = sum(1 for done in split if done is not None and done is not Ellipsis)
            expected = tuple(shape[axis : axis + item.ndim])
            if item.shape != expected:
                raise IndexingError("mask-shape", f"mask of axis {axis}", f"shape {item.shape}", f"shape {expected}")
            split.extend(np.nonzero(item))
        else:
            split.append(item)
    return split


def _broadcast(arrays: list[Array]) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(*(array.shape for array in arrays))
    except ValueError:
        shapes = ", ".join(str(array.shape) for array in arrays)
        raise IndexingError("index-broadcast", "index arrays", f"shapes {shapes}", "shapes that broadcast",
                            "use numpy.ix_ for an outer product") from None


def _in_range(index: Array, axis: int, size: int) -> Index:
    """Count negative indices from the end, and refuse those outside, which may be beyond the range of `Index`."""
    low, high = int(index.min(initial=0)), int(index.max(initial=0))
    if index.size and (low < -size or high >= size):
        bad = (index < -size) | (index >= size)
        _one_in_range(int(index[bad][0]), axis, size)
    index = index.astype(np.intp, copy=False)
    return index if low >= 0 else np.where(index < 0, index + size, index)


def _one_in_range(index: int, axis: int, size: int) -> int:
    """The same of a single index."""
    if not -size <= index < size:
        raise IndexingError("index-out-of-range", f"index of axis {axis}", index, f"{-size} to {size - 1}")
    return index + size if index < 0 else index
