"""Which source axes of a file are its lights, views, rows, columns, colours and frames, and where the others stand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis, as_drawn, check_kind
from ..errors import invalid
from ..pictures import picture_axes

#: Elements that decide white and the window of a picture; they are picked by a multiplicative hash.
SAMPLES, HASH = 4096, 2654435761
LOW_SHARE, HIGH_SHARE = 0.005, 0.995


@dataclass(frozen=True)
class Layout:
    """Numbers of the source axes by what they are to a renderer, None or empty where there is none.

    Attributes:
        time, channel: one axis each.
        lights: one axis of directions, or two of angles (zenith and azimuth).
        views: likewise; of a light field one axis of cameras, or row and column of their grid.
        space: (y, x), or (z, y, x) of a volume.
        channels: the indices of the channel axis shown as red, green, blue; one index for grey.
        stands: the index of every axis that nothing else moves along.
        names: of all axes.
        sizes: of all axes.
    """

    lights: tuple[int, ...]
    views: tuple[int, ...]
    time: int | None
    space: tuple[int, ...]
    channel: int | None
    channels: tuple[int, ...]
    stands: tuple[int, ...]
    names: tuple[str, ...]
    sizes: tuple[int, ...]

    @property
    def moving(self) -> tuple[int, ...]:
        """The axes that a renderer moves along."""
        single = (self.time, self.channel)
        return (*self.lights, *self.views, *self.space, *(axis for axis in single if axis is not None))


def lay_out(axes: Sequence[Axis], kind: str, position: Mapping[str, int] | None = None) -> Layout:
    """Find the axes of a kind's renderer by their roles.

    >>> from hmkcta.axes import name_axes
    >>> found = lay_out(name_axes((4, 8, 8, 3), ["light", "y", "x", "rgb"]), "svbrdf")
    >>> found.lights, found.views, found.space, found.channels
    ((0,), (), (1, 2), (0, 1, 2))

    Raises:
        HmkctaError: the axes do not make this kind, or `position` is not one of theirs.
    """
    roles: dict[str, list[int]] = {}
    for number, axis in enumerate(axes):
        roles.setdefault(axis.role, []).append(number)
    check_kind(axes, kind)
    space = tuple(roles.get("space", []))
    if kind != "generic":  # z, y, x of a volume, else y, x
        space = tuple(as_drawn(axes, space)[-3 if kind == "volume" else -2 :])
    lights, views = roles.get("light", []), roles.get("view", [])
    channel = next((n for n in roles.get("channel", []) if axes[n].size > 1), None)
    time = next(iter(roles.get("time", [])), None)
    stands = _stands(axes, position or {})
    return Layout(
        lights=tuple(lights) if kind == "svbrdf" else (),
        views=tuple(views) if kind != "volume" else (),
        time=time,
        space=space,
        channel=channel if kind != "volume" else None,
        channels=(0,) if channel is None or kind == "volume" else _channels(axes[channel], position or {}),
        stands=stands,
        names=tuple(axis.name for axis in axes),
        sizes=tuple(axis.size for axis in axes),
    )


def axes_without_place(axes: Sequence[Axis], kind: str) -> list[int]:
    """Numbers of the axes of which a scene's `position` says nothing: all of them is shown, or others move along them.

    >>> from hmkcta.axes import name_axes
    >>> axes = name_axes((9, 6, 8, 7), ["time", "z", "y", "x"])
    >>> axes_without_place(axes, "volume"), axes_without_place(axes, "generic")
    ([1, 2, 3, 0], [2, 3])
    >>> axes_without_place(name_axes((5, 8, 7, 12), ["view", "y", "x", "band"]), "lightfield")
    [0, 1, 2]

    Raises:
        HmkctaError: the axes do not make this kind.
    """
    if kind == "generic":
        sides, colour = picture_axes(axes)
        return sides if colour is None else [*sides, colour]
    layout = lay_out(axes, kind)
    placed = [n for n in (layout.channel,) if n is not None and axes[n].size != 3]  # one channel may be shown
    return [axis for axis in layout.moving if axis not in placed]


def value_range(source: Any, shape: Sequence[int]) -> tuple[float, float]:
    """The 0.5th and 99.5th percentile of 4096 elements spread over a model or an array of that shape.

    Where these are one value, as most values of sparse data are, it is the least and the largest of the elements.

    >>> value_range(np.arange(1000.0), (1000,))
    (4.0, 994.0)
    >>> value_range(np.where(np.arange(1000) == 500, 7.0, 0.0), (1000,))
    (0.0, 7.0)
    """
    size = prod(shape)
    flat = np.unravel_index(np.arange(SAMPLES, dtype=np.uint64) * HASH % size, tuple(shape))
    values: NDArray[np.float64] = np.sort(np.asarray(source[tuple(np.asarray(i) for i in flat)], np.float64))
    low, high = int(LOW_SHARE * (SAMPLES - 1)), int(np.ceil(HIGH_SHARE * (SAMPLES - 1)))
    if values[low] == values[high]:
        low, high = 0, SAMPLES - 1
    return float(values[low]), float(values[high])


def time_steps(time: float | None, count: int) -> tuple[tuple[int, int], tuple[float, float]]:
    """The two frames a time lies between, and their weights; None is the first frame.

    >>> time_steps(1.25, 4)
    ((1, 2), (0.75, 0.25))

    Raises:
        HmkctaError: outside 0 to count - 1.
    """
    place = 0.0 if time is None else time
    if not 0 <= place <= count - 1:
        raise invalid("time-out-of-range", "time", time, f"0 to {count - 1} (frames, from 0)")
    first = min(int(place), max(count - 2, 0))
    return (first, min(first + 1, count - 1)), (1.0 - (place - first), place - first)


def _channels(axis: Axis, position: Mapping[str, int]) -> tuple[int, ...]:
    """Indices shown as red, green, blue: the first three of a colour, else long, middle and short end of a spectrum.

    Of two channels one is shown, in grey; so is the one of more than three that `position` names.
    """
    if axis.size == 2 or (axis.size > 3 and axis.name in position):
        return (position.get(axis.name, 0),)
    return (0, 1, 2) if axis.size <= 4 else (axis.size - 1, axis.size // 2, 0)


def _stands(axes: Sequence[Axis], position: Mapping[str, int]) -> tuple[int, ...]:
    names = [axis.name for axis in axes]
    place = [axis.size // 2 for axis in axes]
    for name, index in position.items():
        if name not in names:
            raise invalid("unknown-axis", "position", repr(name), ", ".join(names))
        size = axes[names.index(name)].size
        if not 0 <= index < size:
            raise invalid("position-outside", f"position of {name}", index, f"0 to {size - 1}")
        place[names.index(name)] = index
    return tuple(place)
