"""An array that knows its axes and what it shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis
from ..errors import invalid

#: What a data set shows, which decides its renderer: docs/format.md.
KINDS = ("svbrdf", "volume", "lightfield")


@dataclass(frozen=True, eq=False)
class Dataset:
    """Values of one data set with an `Axis` for each array axis, and its kind.

    Args:
        values: float32, a dimension for each axis.
        axes: with names, sizes, roles and, for lights and views, directions as coordinates.
        kind: what it shows, one of `KINDS`.

    >>> from hmkcta.axes import name_axes
    >>> data = Dataset(np.zeros((2, 3), np.float32), name_axes((2, 3), ["y", "x"]), "volume")
    >>> data.nbytes, data.names, data.axis("x").size
    (24, ('y', 'x'), 3)

    Raises:
        HmkctaError: the kind is unknown, or the axes do not have the sizes of the array.
    """

    values: NDArray[np.float32]
    axes: tuple[Axis, ...]
    kind: str

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise invalid("unknown-kind", "kind of the data set", repr(self.kind), ", ".join(KINDS))
        sizes = tuple(axis.size for axis in self.axes)
        if sizes != self.values.shape:
            raise invalid("axis-size", "axes of the data set", sizes, f"{self.values.shape}, the shape of its values")

    @property
    def names(self) -> tuple[str, ...]:
        """Axis names in array order."""
        return tuple(axis.name for axis in self.axes)

    @property
    def nbytes(self) -> int:
        """Bytes of the values."""
        return int(self.values.nbytes)

    def axis(self, name: str) -> Axis:
        """The axis of that name.

        Raises:
            HmkctaError: reason ``unknown-axis``: none has it.
        """
        for axis in self.axes:
            if axis.name == name:
                return axis
        raise invalid("unknown-axis", "axis", repr(name), ", ".join(self.names))


def svbrdf_axes(lights: NDArray[Any], views: NDArray[Any], height: int, width: int) -> tuple[Axis, ...]:
    """Axes of an SVBRDF ``[light, view, y, x, rgb]`` under directions `lights [light, 3]` and `views [view, 3]`.

    >>> up = np.array([[0.0, 0.0, 1.0]])
    >>> [axis.size for axis in svbrdf_axes(up, up, 4, 5)]
    [1, 1, 4, 5, 3]
    """
    return (
        Axis("light", len(lights), "light", lights, "unit vector"),
        Axis("view", len(views), "view", views, "unit vector"),
        Axis("y", height, "space"), Axis("x", width, "space"), Axis("rgb", 3, "channel"),
    )


def checked_count(where: str, value: int, least: int = 1) -> int:
    """A size asked for by the caller as a plain int, or an error that names the argument.

    >>> checked_count("lights", 24)
    24
    """
    if int(value) != value or value < least:
        raise invalid("size-too-small", where, value, f"a whole number from {least} up")
    return int(value)
