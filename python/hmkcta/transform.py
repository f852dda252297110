"""Value transforms for data of high dynamic range: what is fitted is f(x), and every decoded value goes back.

| name | f(x) | values allowed |
| --- | --- | --- |
| `identity` | x | any |
| `log1p` | log(1 + x / scale) | above -scale |
| `asinh` | arcsinh(x / scale): linear near 0, logarithmic beyond the scale, for signed data | finite |
| `sqrt` | square root of x | 0 or more |
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .errors import invalid

Values = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class _Rule:
    """f and its inverse at scale 1, the values f takes at scale 1, and whether a scale has a meaning."""

    forward: Callable[[Values], Values]
    inverse: Callable[[Values], Values]
    allowed: Callable[[Values], NDArray[np.bool_]]
    domain: str  # in words; {scale} stands for the scale
    scaled: bool


def _finite(x: Values) -> NDArray[np.bool_]:
    return np.isfinite(x)


#: Scales that leave room in float32 for what is divided by them.
_SMALLEST, _LARGEST = 1e-30, 1e30

_RULES = {
    "identity": _Rule(lambda x: x, lambda y: y, lambda x: np.ones(x.shape, np.bool_), "any number", False),
    "log1p": _Rule(np.log1p, np.expm1, lambda x: _finite(x) & (x > -1), "finite numbers above -{scale:g}", True),
    "asinh": _Rule(np.arcsinh, np.sinh, _finite, "finite numbers", True),
    # A decoded root a little below zero stands for zero, not for the square of the error.
    "sqrt": _Rule(np.sqrt, lambda y: np.square(np.maximum(y, 0)), lambda x: _finite(x) & (x >= 0), "0 or more", False),
}

#: Value transforms that decoders undo, each with the names of its constants.
TRANSFORMS: Mapping[str, tuple[str, ...]] = {name: ("scale",) if rule.scaled else () for name, rule in _RULES.items()}


@dataclass(frozen=True)
class Transform:
    """A value transform and its scale, in the unit of the source values.

    >>> Transform("log1p", 0.5).forward(np.array([0.0, 0.5]))
    array([0.        , 0.69314718])

    Raises:
        HmkctaError: the name is unknown; the scale is not a positive number, or given where it means nothing.
    """

    name: str = "identity"
    scale: float = 1.0

    def __post_init__(self) -> None:
        if self.name not in _RULES:
            raise invalid("unknown-transform", "transform", self.name, ", ".join(_RULES))
        if not (isfinite(self.scale) and self.scale > 0):
            raise invalid("transform-scale", f"scale of {self.name}", self.scale, "a positive number")
        if self.scale != 1 and not _RULES[self.name].scaled:
            raise invalid("transform-scale", f"scale of {self.name}", self.scale, "none", f"write {self.name}")

    @property
    def is_identity(self) -> bool:
        """Whether values stay as they are."""
        return self.name == "identity"

    def forward(self, values: NDArray[Any]) -> Values:
        """f of the values, of their shape; float32 stays float32, integers of 32 bits or more become float64.

        Raises:
            HmkctaError: values outside the domain; says how many and where the first is. `identity` looks at none.
        """
        x = values.astype(np.result_type(values.dtype, np.float32), copy=False)
        rule = _RULES[self.name]
        dtype = x.dtype
        if rule.scaled:
            x = _in_float64_if_too_large(lambda x: x / x.dtype.type(self.scale), x)
        allowed = rule.allowed(x)
        if not allowed.all():
            bad = np.flatnonzero(~allowed)
            index = tuple(int(i) for i in np.unravel_index(int(bad[0]), values.shape))
            found = f"{len(bad)} outside, the first {values[index]} at index {index}"
            raise invalid(
                "transform-domain", f"values for {self}", found,
                rule.domain.format(scale=self.scale), "choose asinh for signed data, or clean the values")
        return rule.forward(x).astype(dtype, copy=False)

    def inverse(self, values: Values) -> Values:
        """The x with f(x) = value, of the same shape and type.

        What is too large for the type becomes its largest number: a decoder never makes infinity.

        >>> Transform("sqrt").inverse(np.array([2.0, -0.1]))
        array([4., 0.])
        """
        if self.is_identity:
            return values
        rule, largest = _RULES[self.name], np.finfo(values.dtype).max
        x = _in_float64_if_too_large(lambda x: rule.inverse(x) * x.dtype.type(self.scale), values)
        return np.clip(x, -largest, largest).astype(values.dtype, copy=False)

    def to_json(self) -> dict[str, Any]:
        """What the file stores.

        >>> Transform("asinh", 2.0).to_json()
        {'name': 'asinh', 'scale': 2.0}
        """
        return {"name": self.name, "scale": self.scale} if _RULES[self.name].scaled else {"name": self.name}

    def __str__(self) -> str:
        """The text `parse` reads."""
        return f"{self.name}:{self.scale!r}" if self.scale != 1 else self.name


def _in_float64_if_too_large(work: Callable[[Values], Values], values: Values) -> Values:
    """The work on values of float32, or of float64 where it makes numbers too large on the way."""
    with np.errstate(over="ignore"):
        found = work(values)
        enough = values.dtype == np.float64 or np.isfinite(found).all()
        return found if enough else work(values.astype(np.float64))


def from_json(stored: Mapping[str, Any]) -> Transform:
    """The transform a file stores.

    >>> from_json({"name": "log1p", "scale": 0.5})
    Transform(name='log1p', scale=0.5)

    Raises:
        HmkctaError: unknown name, missing, unknown or bad constants.
    """
    name = stored.get("name")
    if not isinstance(name, str) or name not in _RULES:
        raise invalid("unknown-transform", "transform.name", repr(name), ", ".join(_RULES))
    expected = {"name", *TRANSFORMS[name]}
    if set(stored) != expected:
        raise invalid("transform-fields", "transform", ", ".join(sorted(stored)), ", ".join(sorted(expected)))
    scale = stored.get("scale", 1.0)
    if isinstance(scale, bool) or not isinstance(scale, int | float):
        raise invalid("transform-scale", "transform.scale", repr(cast("object", scale)), "a positive number")
    return Transform(name, float(scale))


def parse(text: str) -> Transform:
    """Read ``name`` or ``name:scale``.

    >>> parse("log1p:0.5")
    Transform(name='log1p', scale=0.5)

    Raises:
        HmkctaError: unknown name or bad scale.
    """
    name, colon, scale = text.strip().partition(":")
    if not colon:
        return Transform(name)
    try:
        number = float(scale)
    except ValueError:
        raise invalid("transform-scale", f"scale of {name}", repr(scale), "a positive number") from None
    if number > 0 and not _SMALLEST <= number <= _LARGEST:  # values are divided by it in float32
        raise invalid("transform-scale", f"scale of {name}", scale, f"{_SMALLEST:g} to {_LARGEST:g}")
    return Transform(name, number)


def nearest(values: NDArray[Any], dtype: DTypeLike) -> NDArray[Any]:
    """The nearest numbers of a type: integers are rounded, and cut off at its range, as floats are.

    >>> nearest(np.array([-3.0, 1.5, 299.0], np.float32), np.uint8).tolist()
    [0, 2, 255]
    """
    kind: np.dtype[Any] = np.dtype(dtype)
    if kind == np.bool_:
        return np.asarray(values) >= 0.5
    info: Any = np.iinfo(kind) if kind.kind in "iu" else np.finfo(kind)
    wide = np.asarray(values, np.float64)
    # Beyond 2^53 a float64 next to the largest integer of a type may be more than that.
    most = float(info.max) if int(float(info.max)) <= int(info.max) else float(np.nextafter(float(info.max), 0.0))
    return np.clip(np.rint(wide) if kind.kind in "iu" else wide, float(info.min), most).astype(kind)
