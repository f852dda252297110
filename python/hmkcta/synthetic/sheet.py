"""A measured sheet as an SVBRDF: one Gaussian lobe and a diffuse term for each texel, evaluated at any directions.

For unit light l, view v and half vector h: ``kd l_z + ks exp(-(acos(h_z) / sigma)^2) / (4 v_z)``; the normal is flat
and the cosine of the light is in it. It has neither parallax nor shadows.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError, Kind, invalid
from .dataset import Dataset, svbrdf_axes
from .directions import upper_unit_vectors

Array = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class SheetMaps:
    """Per texel: `diffuse` kd and `specular` ks ``[y, x]`` or ``[y, x, rgb]``, `roughness` sigma ``[y, x]`` in radians.

    >>> grey = np.full((4, 5), 0.5)
    >>> SheetMaps(grey, grey, grey).cropped(2, 3).shape
    (2, 3)

    Raises:
        HmkctaError: the shapes do not agree, a value is not finite, or a roughness is not above 0.
    """

    diffuse: NDArray[Any]
    specular: NDArray[Any]
    roughness: NDArray[Any]

    def __post_init__(self) -> None:
        if self.roughness.ndim != 2:
            raise invalid("map-shape", "roughness", f"shape {self.roughness.shape}", "[y, x]")
        for name, colour in (("diffuse", self.diffuse), ("specular", self.specular)):
            if colour.shape not in (self.shape, (*self.shape, 3)):
                raise invalid("map-shape", name, f"shape {colour.shape}", f"{self.shape} or {(*self.shape, 3)}")
        for name, values in (("diffuse", self.diffuse), ("specular", self.specular), ("roughness", self.roughness)):
            bad = int(np.size(values) - np.isfinite(values).sum())
            if bad:
                raise invalid("not-finite", name, f"{bad} values that are infinite or no number", "finite numbers only")
        if self.roughness.min(initial=1.0) <= 0:
            raise invalid("roughness-not-positive", "roughness", self.roughness.min(), "above 0", "clip it first")

    @property
    def shape(self) -> tuple[int, int]:
        """(y, x)."""
        return self.roughness.shape[0], self.roughness.shape[1]

    def cropped(self, height: int, width: int) -> SheetMaps:
        """The upper left part, of at most `height` x `width` texels."""
        return SheetMaps(*(values[:height, :width] for values in (self.diffuse, self.specular, self.roughness)))


def load_sheet(path: str | Path, state: str = "new") -> tuple[SheetMaps, Array]:
    """Maps and directions ``[count, 3]`` from an archive of measured parameters.

    Args:
        path: an ``.npz`` file with the arrays ``directions``, ``diffuse_<state>``, ``specular_<state>`` and
            ``roughness_<state>``.
        state: which of the measured states to take.

    Raises:
        HmkctaError: `Io`, reason ``sheet-not-readable``: the file is not there or has no such arrays; or what
            `SheetMaps` refuses.

    >>> import tempfile
    >>> grey = np.full((4, 5), 0.5)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(f"{folder}/sheet.npz", directions=[[0, 0, 1]], diffuse_new=grey, specular_new=grey,
    ...              roughness_new=grey)
    ...     maps, directions = load_sheet(f"{folder}/sheet.npz")
    >>> maps.shape, directions.shape
    ((4, 5), (1, 3))
    """
    try:
        with np.load(path) as archive:
            maps = SheetMaps(*(archive[f"{name}_{state}"] for name in ("diffuse", "specular", "roughness")))
            return maps, np.asarray(archive["directions"], np.float32)
    except (OSError, KeyError) as error:
        raise HmkctaError(Kind.IO, "sheet-not-readable", str(path), found=error,
                          allowed="an .npz with diffuse_, specular_, roughness_ of one state") from error


def svbrdf_from_parameters(
    maps: SheetMaps, directions: NDArray[Any], views: NDArray[Any] | None = None, *, out: Array | None = None
) -> Dataset:
    """Evaluate the sheet at every light of `directions` and every view of `views` (default: the same directions).

    The result is ``[light, view, y, x, rgb]`` float32, written a picture at a time into `out` if given (a memmap, say);
    beyond the result this needs memory for four pictures only.

    >>> up, grey = np.array([[0.0, 0.0, 1.0]]), np.full((1, 1), 0.5)
    >>> svbrdf_from_parameters(SheetMaps(grey, grey, grey), up).values.tolist()
    [[[[[0.625, 0.625, 0.625]]]]]

    Raises:
        HmkctaError: a direction is not a unit vector above the sheet, or `out` has another shape or type.
    """
    lights = upper_unit_vectors(directions, "directions")
    eyes = lights if views is None else upper_unit_vectors(views, "views")
    axes = svbrdf_axes(np.asarray(lights, np.float32), np.asarray(eyes, np.float32), *maps.shape)
    values = _destination(tuple(axis.size for axis in axes), out)

    # Colour everything, so that the inner loop runs over one contiguous picture.
    falloff = _coloured(-1.0 / np.square(maps.roughness, dtype=np.float32))
    diffuse, specular = _coloured(maps.diffuse), _coloured(maps.specular)
    lobe = np.empty_like(falloff)  # [y, x, rgb]
    for m, light in enumerate(lights):
        shade = diffuse * np.float32(light[2])
        for n, eye in enumerate(eyes):
            np.multiply(falloff, np.float32(_half_angle(light, eye) ** 2), out=lobe)
            np.exp(lobe, out=lobe)
            lobe *= specular
            lobe *= np.float32(0.25 / eye[2])
            np.add(lobe, shade, out=values[m, n])
    return Dataset(values, axes, "svbrdf")


def _half_angle(light: NDArray[np.float64], eye: NDArray[np.float64]) -> float:
    """Radians between the normal (0, 0, 1) and the half vector of two unit vectors."""
    half = light + eye
    return float(np.arctan2(np.hypot(half[0], half[1]), half[2]))  # acos loses half the digits near the normal


def _coloured(values: NDArray[Any]) -> Array:
    """A map ``[y, x]`` or ``[y, x, rgb]`` as contiguous float32 ``[y, x, rgb]``."""
    wide = values if values.ndim == 3 else values[:, :, None]
    return np.ascontiguousarray(np.broadcast_to(wide, (*values.shape[:2], 3)), np.float32)


def _destination(shape: tuple[int, ...], out: Array | None) -> Array:
    """`out` after a check, or a new array."""
    if out is None:
        return np.empty(shape, np.float32)
    if out.shape != shape or out.dtype != np.float32:
        raise invalid("out-mismatch", "out", f"{out.dtype} {out.shape}", f"float32 {shape}")
    return out
