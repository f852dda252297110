"""The array to compress as everything after it wants it: named axes, finite, float32, value-transformed."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from .axes import Axis, Organisation, name_axes, organise, parse_organisation, separate
from .errors import invalid
from .slabs import slabs
from .transform import Transform, parse

F32 = NDArray[np.float32]
_SLAB = 1 << 22
#: Sums of a few such values still fit float32.
_LARGEST = 1e37


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
    """

    array: NDArray[Any]
    axes: tuple[Axis, ...]
    dtype: str
    nan: float | None
    value_transform: Transform
    fingerprint: dict[str, Any]
    unit: float = 1.0

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
        """What renders it, told by the roles of its axes."""
        roles = {axis.role for axis in self.axes}
        spaces = sum(axis.role == "space" for axis in self.axes)
        if "light" in roles:
            return "svbrdf"
        if "view" in roles:
            return "lightfield"
        return "volume" if spaces >= 3 else "generic"

    def organisation(self, text: str | None) -> Organisation:
        """The organisation a text describes; None: a mode for each axis."""
        return separate(self.axes) if text is None else parse_organisation(text, self.axes)

    def values(self, part: tuple[slice, ...] = ()) -> F32:
        """The transformed values of a slab or strided block in multiples of the unit, float32, in the array's axes.

        What is below 2^-60 of the unit is zero: its squares would underflow.
        """
        scaled = np.ascontiguousarray(self.transformed(part) / self.unit, np.float32)
        scaled[np.abs(scaled) < 2.0**-60] = 0
        return scaled

    def transformed(self, part: tuple[slice, ...]) -> NDArray[Any]:
        """The values of a slab or strided block after the value transform."""
        values = np.asarray(self.array[part])
        values = values if values.dtype.itemsize >= 4 and values.dtype.kind == "f" else values.astype(np.float64)
        if self.nan is not None:
            values = np.where(np.isfinite(values), values, self.nan)
        return values if self.value_transform.name == "identity" else self.value_transform.forward(values)

    def tensor(self, organisation: Organisation) -> F32:
        """The whole tensor of the organisation's modes."""
        return np.ascontiguousarray(organise(self.values(), self.axes, organisation))


def prepare(array: Any, axes: Sequence[Axis] | Sequence[str] | None, transform: str, nan: float | None) -> Source:
    """Check an array and describe it.

    Raises:
        HmkctaError: not an array of 1 to 8 axes of real numbers, empty, not finite with `nan` None, beyond float32's
            range, names that do not fit, or values outside the transform's domain.
    """
    array = cast(NDArray[Any], np.asanyarray(array))
    if array.dtype.kind not in "fiu":
        raise invalid("dtype", "array", f"dtype {array.dtype}", "floating point or integers")
    if not 1 <= array.ndim <= 8 or array.size == 0:
        raise invalid("array-shape", "array", f"shape {array.shape}", "1 to 8 axes, none of them empty")
    named = _named(array.shape, axes)
    if nan is not None and not np.isfinite(nan):
        raise invalid("nan-fill", "nan", nan, "a finite number")
    digest, bad = _scan(array, nan)
    value_transform = parse(transform)
    fingerprint = {"sha256": digest}
    source = Source(
        array, named, array.dtype.newbyteorder("=").name, nan if bad else None, value_transform, fingerprint
    )
    peak = max(float(np.abs(source.transformed(part)).max()) for part in slabs(array.shape, _SLAB))
    return replace(source, unit=2.0 ** float(np.floor(np.log2(peak))) if peak > 0 else 1.0)


def _named(shape: tuple[int, ...], axes: Sequence[Axis] | Sequence[str] | None) -> tuple[Axis, ...]:
    given = list(axes or [])
    described = [axis for axis in given if isinstance(axis, Axis)]
    if len(described) != len(given) or not given:
        return name_axes(shape, [str(name) for name in given] or None)
    name_axes(shape, [axis.name for axis in described])
    for axis, size in zip(described, shape, strict=True):
        if axis.size != size:
            raise invalid("axis-size", f"size of axis {axis.name!r}", axis.size, f"{size}, as the array has")
    return tuple(described)


def _scan(array: NDArray[Any], nan: float | None) -> tuple[str, bool]:
    """SHA-256 of the values in C order, and whether any is not finite."""
    digest = hashlib.sha256(f"{array.dtype.newbyteorder('=').name} {array.shape}".encode())
    count, first, start = 0, 0, 0
    for part in slabs(array.shape, _SLAB):
        values = np.ascontiguousarray(array[part], array.dtype.newbyteorder("="))
        digest.update(values.data)
        if values.dtype.kind == "f":
            bad = ~np.isfinite(values)
            if bad.any():
                first = first if count else start + int(np.flatnonzero(bad)[0])
                count += int(bad.sum())
            if values.itemsize > 2 and (np.abs(values[~bad]) > _LARGEST).any():
                allowed = f"magnitudes up to {_LARGEST:.0e}, that float32 can hold"
                raise invalid("too-large", "array", f"{np.abs(values[~bad]).max():.3g}", allowed, "scale the array")
        start += values.size
    if count and nan is None:
        index = tuple(int(i) for i in np.unravel_index(first, array.shape))
        found = f"{count} values that are NaN or infinite, the first at index {index}"
        raise invalid("not-finite", "array", found, "finite numbers", "give a value to put there, --nan fill=0")
    return digest.hexdigest(), bool(count)
