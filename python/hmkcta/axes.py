"""Axes of the source array and their organisation into the modes of the tensor.

A mode is one axis or several merged ones; an index of a merged mode is the C-order flattening of its axes in the
listed order (`docs/format.md`, section 2). The paper folds colour into the light mode: ``light+rgb, view, y, x``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass, replace
from math import isqrt, prod
from numbers import Integral
from typing import Any, cast
from unicodedata import category

import numpy as np
from numpy.typing import NDArray

from .errors import expect, invalid, shown

ROLES = ("space", "view", "light", "time", "channel", "other")
#: Most numbers that a coordinate of an index may have.
MOST_COORDS = 16

_ROLE_OF_NAME = {
    **dict.fromkeys(("x", "y", "z", "u", "v", "texel", "pixel", "space"), "space"),
    **dict.fromkeys(("lat", "latitude", "lon", "longitude", "depth"), "space"),
    **dict.fromkeys(("view", "camera", "row", "column", "s"), "view"),
    **dict.fromkeys(("light", "illumination"), "light"),
    **dict.fromkeys(("time", "t", "frame"), "time"),
    **dict.fromkeys(("rgb", "channel", "colour", "color", "c", "band", "wavelength", "spectral"), "channel"),
}

#: What modes are, where they are no text.
_MODES = 'names of axes for each mode, (("light", "rgb"), ("view",), ("y",), ("x",))'

#: Names of axes that tell what they are drawn as: slices, rows, columns.
DRAWN = ("z", "y", "x")

Organisation = tuple[tuple[str, ...], ...]


#: Unicode categories of controls, formats and separators. Not of what is unassigned: that differs from year to year.
_UNSEEN = ("Cc", "Cf", "Cs", "Co", "Zs", "Zl", "Zp")


@dataclass(frozen=True, eq=False)
class Axis:
    """One axis of the source array: what it is called, how long it is, what it means.

    Args:
        name: a word without ``+ , / =``, spaces or unseen characters; plans and organisations call the axis by it.
        size: number of its indices.
        role: what it stands for, one of `ROLES`; it decides how a file is shown (`compress`, argument `kind`).
        coords: a number, or a list of up to 16, for each index: `[size]` or `[size, 1..16]`, for instance the unit
            vectors `[size, 3]` of lights. None: there are none. `compress` checks them and the file keeps them.
        unit: of the coordinates, such as ``degrees`` or ``unit vector``; empty: not said.

    Raises:
        HmkctaError: an argument is of another type (``argument-type``), the role is unknown (``unknown-role``), or the
            name is empty or has a character that it may not have (``bad-axis-name``).

    >>> Axis("light", 2, "light", np.array([[0, 0, 1], [0.6, 0, 0.8]]), "unit vector").coords.shape
    (2, 3)
    >>> Axis("gloss", 16).role
    'other'
    """

    name: str
    size: int
    role: str = "other"
    coords: NDArray[Any] | None = None
    unit: str = ""

    def __post_init__(self) -> None:
        expect("axis name", self.name, str, "a word")
        expect(f"size of axis {self.name!r}", self.size, Integral, "a whole number")
        expect(f"unit of axis {self.name!r}", self.unit, str, "text such as degrees, or none")
        if self.role not in ROLES:
            raise invalid("unknown-role", f"role of axis {self.name!r}", self.role, ", ".join(ROLES))
        if not self.name or any(c in self.name for c in "+, /=") or any(map(_is_unseen, self.name)):
            raise invalid("bad-axis-name", "axis name", repr(self.name), "a word without + , / = or space")


def _is_unseen(character: str) -> bool:
    return category(character) in _UNSEEN


def folded(shape: Sequence[int]) -> str | None:
    """How to make two axes of one that is longer than all others together; None: none is, or it has no divisor near.

    >>> folded((90_000, 8)), folded((300, 300)), folded((7919,))
    ('array.reshape(300, 300, 8)', None, None)
    """
    longest = max(range(len(shape)), key=lambda n: shape[n], default=0)
    if not shape or shape[longest] ** 2 <= prod(shape):
        return None
    side = next(side for side in range(isqrt(shape[longest]), 0, -1) if shape[longest] % side == 0)
    if side**4 < shape[longest]:
        return None
    return f"array.reshape{(*shape[:longest], shape[longest] // side, side, *shape[longest + 1 :])}"


def listed_axes(axes: object) -> Sequence[Axis | str]:
    """What callers give for axes, listed: names in one text, or any sequence of names and `Axis` objects.

    >>> listed_axes("light, y, x"), listed_axes(np.array(["y", "x"]))
    (['light', ' y', ' x'], ['y', 'x'])

    Raises:
        HmkctaError: something else, or a set, whose order says nothing.
    """
    if isinstance(axes, str):
        return axes.split(",")
    words = 'names in array order: "light, view, y, x", or a list of names and Axis objects'
    expect("axes", axes, Iterable, words)
    if isinstance(axes, Set | bytes) or (isinstance(axes, np.ndarray) and axes.ndim != 1):
        raise invalid("argument-type", "axes", shown(cast(object, axes)), words)
    listed = list(cast("Iterable[Any]", axes))
    for axis in listed:
        expect("name of an axis", axis, str | Axis, words)
    return [axis if isinstance(axis, Axis) else str(axis) for axis in listed]


def name_axes(shape: Sequence[int], names: Sequence[str] | None = None) -> tuple[Axis, ...]:
    """Axes of an array of the given shape; roles follow from well-known names, ``name:role`` says another one.

    >>> [(axis.name, axis.role) for axis in name_axes((6, 8, 3), ["light", "gloss:space", "rgb"])]
    [('light', 'light'), ('gloss', 'space'), ('rgb', 'channel')]

    Raises:
        HmkctaError: the number of names is not the number of axes, a name comes twice, or a role is unknown.
    """
    if names is None:
        names = [f"axis{n}" for n in range(len(shape))]
    if len(names) != len(shape):
        shown = " x ".join(map(str, shape))
        raise invalid(
            "axis-count",
            "axes",
            f"{len(names)} names ({', '.join(names)})",
            f"{len(shape)}, one for each axis of the {shown} array",
            _parted(names, len(shape)) or "give one name an axis, in array order",
        )
    axes: list[Axis] = []
    for text, size in zip(names, shape, strict=True):
        name, _, role = text.strip().partition(":")
        axes.append(Axis(name, int(size), role or _ROLE_OF_NAME.get(name.lower(), "other")))
    if len({axis.name for axis in axes}) != len(axes):
        raise invalid("axis-twice", "axes", ", ".join(axis.name for axis in axes), "names that differ")
    return tuple(axes)


def _parted(names: Sequence[str], count: int) -> str:
    """What to do with names that something else than commas parts; empty where these do not make so many.

    >>> _parted(["z y x"], 3), _parted(["z", "x"], 3)
    ('part names with commas: z,y,x', '')
    """
    words = [word for name in names for word in re.split(r"[\s;/]+", name.strip()) if word]
    return f"part names with commas: {','.join(words)}" if len(words) == count else ""


def as_drawn(axes: Sequence[Axis], numbers: Sequence[int]) -> list[int]:
    """Numbers of axes as they are drawn: slices, rows, columns. These are z, y and x where axes have these names, in
    whatever order an array has them, else they are in array order.

    >>> as_drawn(name_axes((5, 6, 7, 3), ["x", "y", "z", "rgb"]), [0, 1, 2])
    [2, 1, 0]
    >>> as_drawn(name_axes((5, 6, 7), ["x", "y", "depth"]), [0, 1, 2])
    [0, 1, 2]
    """
    if any(axes[n].name.lower() not in DRAWN for n in numbers):
        return sorted(numbers)
    return sorted(numbers, key=lambda n: (DRAWN.index(axes[n].name.lower()), n))


def check_kind(axes: Sequence[Axis], kind: str) -> None:
    """Refuse what nothing that shows a kind could show, for lack of axes of the roles that it needs.

    >>> check_kind(name_axes((4, 8, 8, 3), ["light", "y", "x", "rgb"]), "svbrdf")

    Raises:
        HmkctaError: too few axes of space; more than two of lights or of views; a light field without cameras.
    """
    if kind == "generic":
        return
    named = ", ".join(f"{axis.name} ({axis.role})" for axis in axes)
    hint = "give roles when compressing, --axes NAME:ROLE,.., or another --kind"
    roles = [axis.role for axis in axes]
    wanted, views = 3 if kind == "volume" else 2, roles.count("view")
    if roles.count("space") < wanted:
        raise invalid("no-space", f"axes of a {kind}", named, f"{wanted} axes of role space", hint)
    if kind == "svbrdf" and max(roles.count("light"), views) > 2:
        raise invalid("too-many-directions", f"axes of a {kind}", named,
                      "of lights and of views one axis each with directions as coords, or two with angles "
                      "(zenith, azimuth)", hint)
    if kind == "lightfield" and not 1 <= views <= 2:
        raise invalid("no-cameras", f"axes of a {kind}", named,
                      "one axis of role view (cameras) or two (row, column of cameras)", hint)


def checked_coords(axis: Axis) -> Axis:
    """The axis, its coordinates an array that a file can hold.

    >>> checked_coords(Axis("light", 2, "light", [30, 60], "degrees")).coords
    array([30, 60])

    Raises:
        HmkctaError: they are no finite numbers, or not one, or one list of up to 16, for each index.
    """
    if axis.coords is None:
        return axis
    where = f"coords of axis {axis.name!r}"
    try:
        coords = np.asarray(axis.coords)
    except ValueError:  # rows of different lengths
        raise invalid("coords", where, "lists of different lengths", "as many numbers for each index") from None
    if coords.dtype.kind not in "iufb":
        raise invalid("coords", where, f"dtype {coords.dtype}", "numbers")
    if coords.shape[:1] != (axis.size,) or coords.ndim > 2 or not 1 <= coords[:1].size <= MOST_COORDS:
        allowed = f"shape [{axis.size}], or [{axis.size}, 1 to {MOST_COORDS}], as the axis has {axis.size} indices"
        raise invalid("coords", where, f"shape {coords.shape}", allowed)
    if not np.isfinite(coords).all():
        raise invalid("coords", where, f"{int((~np.isfinite(coords)).sum())} that are NaN or infinite",
                      "finite numbers")
    return replace(axis, coords=coords)


def check_modes(organisation: object) -> None:
    """Refuse modes that are not lists of names of axes; a text would be taken for a list of letters.

    >>> check_modes((("light", "rgb"), ("y",), ("x",)))

    Raises:
        HmkctaError: reason ``argument-type``.
    """
    expect("organisation", organisation, tuple | list, _MODES)
    for mode in cast("Sequence[object]", organisation):
        expect("mode of the organisation", mode, tuple | list, _MODES)
        for name in cast("Sequence[object]", mode):
            expect("name of an axis", name, str, _MODES)


def organisation_text(given: object) -> str | None:
    """An organisation as callers have it, a text or the names of the axes of each mode, as `parse_organisation` has it.

    >>> organisation_text([["light", "rgb"], ["y"]]), organisation_text("y, x"), organisation_text(None)
    ('light+rgb, y', 'y, x', None)

    Raises:
        HmkctaError: reason ``argument-type``, or ``organisation``: a name that no axis has.
    """
    if given is None or isinstance(given, str):
        return given
    expect("organisation", given, tuple | list, f'text such as "light+rgb, view, y+x", or {_MODES}')
    check_modes(given)
    organisation = cast(Organisation, given)
    if any("+" in name or "," in name for mode in organisation for name in mode):
        raise invalid("organisation", "organisation", shown(given), _MODES, "give each axis a text of its own")
    return format_organisation(organisation)


def separate(axes: Sequence[Axis]) -> Organisation:
    """The organisation with a mode for each axis, in array order.

    >>> separate(name_axes((6, 8, 3), ["y", "x", "rgb"]))
    (('y',), ('x',), ('rgb',))
    """
    return tuple((axis.name,) for axis in axes)


def parse_organisation(text: str, axes: Sequence[Axis]) -> Organisation:
    """Read ``"light+rgb, view, y+x"``; every axis must come exactly once.

    >>> parse_organisation("light+rgb, y+x", name_axes((6, 8, 8, 3), ["light", "y", "x", "rgb"]))
    (('light', 'rgb'), ('y', 'x'))

    Raises:
        HmkctaError: reason ``organisation``: an axis is missing, repeated or unknown.
    """
    return check_organisation(tuple(tuple(a.strip() for a in mode.split("+")) for mode in text.split(",")), axes)


def check_organisation(organisation: Organisation, axes: Sequence[Axis]) -> Organisation:
    """Return the organisation, every axis of which must come exactly once.

    >>> check_organisation((("y", "x"), ("rgb",)), name_axes((6, 8, 3), ["y", "x", "rgb"]))
    (('y', 'x'), ('rgb',))

    Raises:
        HmkctaError: reason ``organisation``: an axis is missing, repeated or unknown.
    """
    listed = [name for mode in organisation for name in mode]
    known = [axis.name for axis in axes]
    if sorted(listed) != sorted(known):
        raise invalid(
            "organisation",
            "organisation",
            repr(format_organisation(organisation)),
            f"each of {', '.join(known)} exactly once",
            "merge axes with +, part modes with commas",
        )
    return organisation


def format_organisation(organisation: Organisation) -> str:
    """The text that `parse_organisation` reads.

    >>> format_organisation((("light", "rgb"), ("y",)))
    'light+rgb, y'
    """
    return ", ".join("+".join(mode) for mode in organisation)


def axis_order(axes: Sequence[Axis], organisation: Organisation) -> tuple[int, ...]:
    """Source axis numbers (from 0) in the order in which the organisation lists them.

    >>> axis_order(name_axes((6, 8, 3), ["y", "x", "rgb"]), (("rgb",), ("y", "x")))
    (2, 0, 1)
    """
    number = {axis.name: n for n, axis in enumerate(axes)}
    return tuple(number[name] for mode in organisation for name in mode)


def mode_sizes(axes: Sequence[Axis], organisation: Organisation) -> tuple[int, ...]:
    """The mode sizes I_1..I_N (paper, section 4.2): products of the sizes of the axes that are merged.

    >>> mode_sizes(name_axes((6, 8, 3), ["y", "x", "rgb"]), (("rgb",), ("y", "x")))
    (3, 48)
    """
    size = {axis.name: axis.size for axis in axes}
    return tuple(prod(size[name] for name in mode) for mode in organisation)


def organise(array: NDArray[Any], axes: Sequence[Axis], organisation: Organisation) -> NDArray[Any]:
    """View or copy of the source array as the tensor of the organisation's modes.

    >>> organise(np.zeros((6, 8, 8, 3)), name_axes((6, 8, 8, 3), ["light", "y", "x", "rgb"]),
    ...          (("light", "rgb"), ("y", "x"))).shape
    (18, 64)
    """
    return array.transpose(axis_order(axes, organisation)).reshape(mode_sizes(axes, organisation))


def deorganise(tensor: NDArray[Any], axes: Sequence[Axis], organisation: Organisation) -> NDArray[Any]:
    """The inverse of `organise`: the tensor's elements in the source array's axes.

    >>> deorganise(np.zeros((3, 48)), name_axes((6, 8, 3), ["y", "x", "rgb"]), (("rgb",), ("y", "x"))).shape
    (6, 8, 3)
    """
    order = axis_order(axes, organisation)
    split = tensor.reshape([axes[n].size for n in order])
    return split.transpose(np.argsort(order))


def mode_rows(axes: Sequence[Axis], organisation: Organisation, part: tuple[slice, ...]) -> list[NDArray[np.intp]]:
    """Indices of each mode within a slab of the source array; slices missing at the end stand for all.

    >>> mode_rows(name_axes((2, 3, 2), ["y", "x", "rgb"]), (("y", "rgb"), ("x",)), (slice(1, 2),))
    [array([2, 3]), array([0, 1, 2])]
    """
    span = dict(zip((axis.name for axis in axes), part, strict=False))
    size = {axis.name: axis.size for axis in axes}
    return [np.arange(prod(size[name] for name in mode)).reshape([size[name] for name in mode])
            [tuple(span.get(name, slice(None)) for name in mode)].reshape(-1) for mode in organisation]
