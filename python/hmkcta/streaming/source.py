"""The array to compress as everything after it wants it: named axes, finite, float32, value-transformed."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from .. import backends as kernels
from ..arrays import F32
from ..axes import (
    Axis,
    Organisation,
    checked_coords,
    listed_axes,
    mode_rows,
    organise,
    parse_organisation,
    separate,
)
from ..conventions import meant
from ..errors import invalid, shown
from ..labels import Labels, labels_of
from ..support.executors import thread_count
from ..support.memory import LOOKED_AT, drop_pages, looked_at
from ..support.slabs import moments, slabs
from ..transform import Transform, parse
from .collecting import collected
from .steady import Steady, fingerprint_start

#: Elements of slabs that are checked one after another.
SLAB = 1 << 22
#: Elements at the least of slabs that many threads check at once.
_SMALL_SLAB = 1 << 16
#: Smallest magnitude, but for zero, that the largest of an array may have: float32 keeps few digits below.
_SMALLEST = 1e-38
#: Largest magnitude of an array: float32 can hold sums and products of such numbers.
_LARGEST = 1e32
#: What is below this share of the unit is taken for zero.
TINY = 2.0**-60


@dataclass(frozen=True, eq=False)
class Source:
    """A checked array with its description.

    Attributes:
        array: as given, any real dtype and layout.
        axes: one for each axis.
        dtype: what the file records of the array's type, e.g. ``float32``.
        nan: what NaN and infinity are read as, None: there are none.
        value_transform: applied before fitting.
        fingerprint: identifies the values, stored in the file.
        unit: power of two near the largest transformed value; fitting works in multiples of it.
        notes: sentences on what came with the array and is not kept.
        tiny: whether there are values below 2^-60 of the unit, which are taken for zero: their squares would underflow.
        steady: looks whether the array is still what it was; None: its values were not looked at.
    """

    array: NDArray[Any]
    axes: tuple[Axis, ...]
    dtype: str
    nan: float | None
    value_transform: Transform
    fingerprint: dict[str, Any]
    unit: float = 1.0
    tiny: bool = True
    notes: tuple[str, ...] = ()
    steady: Steady | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Sizes of the axes."""
        return tuple(axis.size for axis in self.axes)

    @property
    def transform(self) -> dict[str, Any]:
        """The value transform as the file stores it."""
        return self.value_transform.to_json()

    @property
    def kind(self) -> str:
        """What renders it, told by the roles of its axes; a table of angles without texels, say, is generic."""
        roles = [axis.role for axis in self.axes]
        lights, views, spaces = (roles.count(role) for role in ("light", "view", "space"))
        if lights == 1 and views <= 1 and spaces >= 2:
            return "svbrdf"
        if not lights and 1 <= views <= 2 and spaces >= 2:
            return "lightfield"
        return "volume" if not (lights or views) and spaces >= 3 else "generic"

    def organisation(self, text: str | None) -> Organisation:
        """The organisation a text describes; None: a mode for each axis."""
        return separate(self.axes) if text is None else parse_organisation(text, self.axes)

    def values(self, part: tuple[slice, ...] = ()) -> F32:
        """The transformed values of a slab or strided block in multiples of the unit, float32, in the array's axes."""
        if not part:  # slab by slab, as integers are float64 on the way
            whole = np.empty(self.shape, np.float32)
            for each in self.parts(SLAB):
                whole[each] = self.values(each)
            return whole
        # Scaling by a power of two rounds nothing, except what float32 does to float64.
        return self._settled(self.transformed(looked_at(self.array, part)) * (1 / self.unit))

    def at(self, organisation: Organisation, rows: Sequence[NDArray[np.intp]], most: int = LOOKED_AT) -> F32:
        """The same of the tensor's elements in some rows of every mode, looking at about `most` bytes at a time."""
        modes = [[self._axis(name) for name in mode] for mode in organisation]
        plain = self.array.dtype == np.float32 and self.value_transform.is_identity and self.nan is None
        values = collected(self.array, modes, rows, 1 / self.unit if plain else None, most)
        return self._settled(values if plain else self.transformed(values) * (1 / self.unit))

    def _settled(self, scaled: NDArray[Any]) -> F32:
        """Values in multiples of the unit as float32, without tiny ones; what has been looked at is let go of."""
        scaled = np.asarray(scaled, np.float32, order="C")
        if self.tiny:
            scaled[np.abs(scaled) < TINY] = 0
        drop_pages(self.array)
        return scaled

    def transformed(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values of the array after the value transform."""
        values = values if values.dtype.itemsize >= 4 and values.dtype.kind == "f" else values.astype(np.float64)
        if self.nan is not None:
            values = np.where(np.isfinite(values), values, self.nan)
        return values if self.value_transform.is_identity else self.value_transform.forward(values)

    def extent(self, part: tuple[slice, ...]) -> tuple[float, float]:
        """The largest magnitude of a slab's transformed values, and the smallest but zero."""
        values = np.abs(self.transformed(looked_at(self.array, part)))
        drop_pages(self.array)
        return float(values.max()), float(values.min(where=values > 0, initial=np.inf))

    def tensor(self, organisation: Organisation) -> F32:
        """The whole tensor of the organisation's modes."""
        return np.ascontiguousarray(organise(self.values(), self.axes, organisation))

    def parts(self, limit: int) -> list[tuple[slice, ...]]:
        """The array cut into slabs of up to `limit` elements, in the order in which they lie in memory."""
        backwards = self.array.flags.f_contiguous and not self.array.flags.c_contiguous
        if not backwards:
            return list(slabs(self.array.shape, limit))
        turned = slabs(self.array.shape[::-1], limit)
        return [(*[slice(None)] * (self.array.ndim - len(part)), *part[::-1]) for part in turned]

    def block(
        self, organisation: Organisation, part: tuple[slice, ...], steps: Sequence[int] | None = None
    ) -> tuple[list[NDArray[np.intp]], F32]:
        """Rows of every mode of a slab, and the slab as a block of the tensor.

        With `steps` of the modes, every steps-th row of the tensor alone, counted as rows of the tensor thinned so.
        """
        steps = steps or [1] * len(organisation)
        spans = dict(zip((axis.name for axis in self.axes), part, strict=False))
        for mode, step in zip(organisation, steps, strict=True):
            if len(mode) == 1 and step > 1:  # what is left out need not be read
                start, stop, _ = spans.get(mode[0], slice(None)).indices(self.shape[self._axis(mode[0])])
                spans[mode[0]] = slice(-(-start // step) * step, stop, step)
        chosen = tuple(spans.get(axis.name, slice(None)) for axis in self.axes)
        rows = mode_rows(self.axes, organisation, chosen)
        rows = [own[own % step == 0] for own, step in zip(rows, steps, strict=True)]
        tensor = self.at(organisation, rows)
        return [own // step for own, step in zip(rows, steps, strict=True)], tensor

    def _axis(self, name: str) -> int:
        return next(number for number, axis in enumerate(self.axes) if axis.name == name)


def as_array(values: Any, where: str) -> NDArray[Any]:
    """Real numbers that were given in whatever form; what they mean, of an open dataset.

    Raises:
        HmkctaError: not an array of real numbers, or a masked one.

    >>> as_array([[1, 2]], "array").shape
    (1, 2)
    """
    try:
        array = cast(NDArray[Any], np.asanyarray(meant(values)))
    except ValueError:  # nested lists of different lengths
        raise invalid("array-shape", where, shown(values), "as many numbers in each of its lists") from None
    if array.dtype.kind not in "bfiu":
        hint = "give real and imaginary part as an axis of two" if array.dtype.kind == "c" else ""
        raise invalid("dtype", where, f"dtype {array.dtype}", "floating point, integers or booleans", hint)
    if np.ma.is_masked(array):  # what is behind a mask would be compressed as if it were data
        found = f"{int(np.ma.getmaskarray(array).sum())} masked values"
        raise invalid("masked", where, found, "no mask", "give a value to put there, array.filled(0)")
    return array.astype(np.float64) if array.dtype.kind == "f" and array.dtype.itemsize > 8 else array


def described(array: Any, axes: Sequence[Axis | str] | None = None, transform: str | None = None) -> Source:
    """An array with its description; its values are not looked at, so its fingerprint is a stand-in.

    Raises:
        HmkctaError: not an array of 1 to 8 axes of real numbers, empty, masked, names or coordinates that do not
            fit, or no such transform.
    """
    own = labels_of(array)
    array = as_array(array, "array")
    if not 1 <= array.ndim <= 8 or array.size == 0:
        raise invalid("array-shape", "array", f"shape {array.shape}", "1 to 8 axes, none of them empty",
                      "make axes that belong together one, array.reshape(..)" if array.ndim > 8 else "")
    named, dtype = _named(array.shape, axes, own), array.dtype.newbyteorder("=").name
    change = parse("identity" if transform is None else transform)
    return Source(array, named, dtype, None, change, {"sha256": "0" * 64}, notes=own.notes)


def prepare(
    array: Any,
    axes: Sequence[Axis | str] | None,
    transform: str | None,
    nan: float | None,
    threads: int | None = None,
) -> Source:
    """Describe an array and check its values, by so many threads (None: all cores).

    Raises:
        HmkctaError: what `described` raises; values that are not finite with `nan` None, too large or all too small for
            float32, or outside the transform's domain.
    """
    source = described(array, axes, transform)
    if nan is not None and not abs(nan) <= _LARGEST:
        raise invalid("nan-fill", "nan", nan, f"a number, its magnitude up to {_LARGEST:.0e}")
    steady = Steady(source.array)
    digest, bad, extents = _scan(source.array, nan)
    steady.fingerprint = digest
    source = replace(source, nan=nan if bad else None, fingerprint={"sha256": digest}, steady=steady)
    if bad or not source.value_transform.is_identity or not extents:
        workers = thread_count(threads)
        with ThreadPoolExecutor(workers) as pool:  # which hold one slab's memory together
            extents = list(pool.map(source.extent, source.parts(max(_SMALL_SLAB, SLAB // workers))))
    peak, least = max(high for high, _ in extents), min(low for _, low in extents)
    if 0 < peak < _SMALLEST:
        allowed = f"{_SMALLEST:.0e} or more, or 0, as float32 keeps few digits below"
        raise invalid("too-small", "largest magnitude of the array", f"{peak:.3g}", allowed, "scale the array")
    unit = 2.0 ** float(np.floor(np.log2(peak))) if peak > 0 else 1.0
    return replace(source, unit=unit, tiny=least < TINY * unit)


def _named(shape: tuple[int, ...], axes: Sequence[Axis | str] | None, own: Labels) -> tuple[Axis, ...]:
    given: Sequence[Axis | str] = [] if axes is None else listed_axes(axes)
    named = own.named(shape, given)
    for axis, size in zip(given, shape, strict=False):
        if isinstance(axis, Axis) and axis.size != size:
            raise invalid("axis-size", f"size of axis {axis.name!r}", axis.size, f"{size}, as the array has")
    if not given:
        return named
    return tuple(checked_coords(axis) if isinstance(axis, Axis) else by_name
                 for axis, by_name in zip(given, named, strict=True))


def _scan(array: NDArray[Any], nan: float | None) -> tuple[str, bool, list[tuple[float, float]]]:
    """SHA-256 of the values in C order, whether any is not finite, and, if they are float32, the largest magnitude of
    each slab and the smallest but zero."""
    digest = fingerprint_start(array.dtype, array.shape)
    count, first, start, extents = 0, 0, 0, list[tuple[float, float]]()
    with ThreadPoolExecutor(1) as hashing:
        hashed = None
        for part in slabs(array.shape, SLAB):
            values = np.ascontiguousarray(looked_at(array, part), array.dtype.newbyteorder("="))
            if values.dtype == np.float32:
                extents.append(_extent(values))
            bad = _not_finite(values, extents[-1][0] if extents else None)
            if bad is not None:
                first = first if count else start + int(np.flatnonzero(bad)[0])
                count += int(bad.sum())
            start += values.size
            if hashed is not None:
                hashed.result()
                drop_pages(array)
            hashed = hashing.submit(digest.update, values.data)
    drop_pages(array)
    if count and nan is None:
        index = tuple(int(i) for i in np.unravel_index(first, array.shape))
        found = f"{count} values that are NaN or infinite, the first at index {index}"
        raise invalid("not-finite", "array", found, "finite numbers", _fill(array, count))
    return digest.hexdigest(), bool(count), extents


def _fill(array: NDArray[Any], count: int) -> str:
    """What to do where `count` values are not finite."""
    if count == array.size:
        return "look at what made the array, as no value of it is finite; nan=0 or --nan fill=0 puts zeros everywhere"
    value = _near_mean(array)
    return f"give a value to put there; near the mean of the others is nan={value} or --nan fill={value}"


def _near_mean(array: NDArray[Any]) -> str:
    """The mean of what is finite, as a sample has it, to a tenth of the deviation or finer."""
    mean, deviation = moments(array)
    return f"{round(mean, 1 - int(np.floor(np.log10(deviation)))) + 0.0 if deviation else mean:.10g}"


def _extent(values: F32) -> tuple[float, float]:
    """The largest magnitude, NaN if a value is infinite or none, and the smallest but zero."""
    squares, largest, smallest = kernels.magnitudes(values)
    return largest if np.isfinite(squares) else np.nan, smallest


def _not_finite(values: NDArray[Any], largest: float | None) -> NDArray[np.bool_] | None:
    """Which values are no finite numbers; None: all are. Refuses those too large for float32.

    The largest magnitude may be known.
    """
    if values.dtype.kind != "f":
        return None
    if largest is None:
        largest = max(float(values.max()), -float(values.min()))  # NaN if any is
    bad = None
    if not largest < np.inf:
        bad = ~np.isfinite(values)
        largest = float(np.abs(values, where=~bad, out=np.zeros_like(values)).max())
    if values.itemsize > 2 and largest > _LARGEST:
        allowed = f"magnitudes up to {_LARGEST:.0e}, of which float32 can hold sums and products"
        raise invalid("too-large", "array", f"{largest:.3g}", allowed, "scale the array")
    return bad
