"""From radiance to the 8-bit picture: tone, background, split view, error heat map; the twin of `display.wgsl`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..pictures import amplification
from .colours import heat_table
from .scene import Compare, Tone, Vector
from .tonemap import to_bytes, tone_map

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]


@dataclass(frozen=True)
class Display:
    """How radiance ``[h, w, 4]`` is shown; `premultiplied` says whether it has been multiplied by its coverage.

    `black` is what shows as black, which only slices have other than 0; these are never shown on a GPU.
    """

    exposure: float
    curve: str
    srgb: bool
    premultiplied: bool
    background: Vector
    mode: str = "none"
    split: float = 0.5
    gain: float = 1.0
    black: float = 0.0


def display_of(tone: Tone, compare: Compare, kind: str, white: float, black: float = 0.0) -> Display:
    """The display of a scene; `white` is what shows as white where the tone does not say it, `black` what as black.

    >>> display_of(Tone(stops=1), Compare(), "lightfield", 0.5).exposure
    4.0
    """
    volume = kind == "volume"  # its colours come from the transfer function
    white = 1.0 if volume else tone.white or white
    span = white - black if white > black else 1.0
    srgb = kind == "svbrdf" if tone.srgb is None else tone.srgb
    return Display(2.0**tone.stops / span, tone.curve, srgb, volume, tone.background, compare.mode, compare.position,
                   compare.gain or 1.0, black)


def show(one: F32, two: F32, display: Display) -> U8:
    """The picture ``[h, w, 3]`` of one radiance picture, next to or minus another (the same one where there is none).

    >>> grey = np.full((1, 2, 4), 0.5, np.float32)
    >>> show(grey, grey, Display(1.0, "linear", False, True, (0.0, 0.0, 0.0)))[0, 0].tolist()
    [128, 128, 128]
    """
    if display.mode == "heat":
        return to_bytes(_heat(one, two, display))
    picture = _shown(one, display)
    if display.mode == "split":
        width = one.shape[1]
        centre = np.arange(width, dtype=np.float64) + 0.5
        place = display.split * width
        left: NDArray[np.bool_] = centre < place
        picture = np.asarray(np.where(left[None, :, None], picture, _shown(two, display)), np.float32)
        picture[:, np.abs(centre - place) < 1] = 1
    return to_bytes(picture)


def heat_gain(one: F32, two: F32, exposure: float) -> float:
    """The power of two that amplifies the difference of two pictures so that it just fills the colours."""
    return amplification([np.abs(one[..., :3] - two[..., :3]).max(axis=2) * np.float32(exposure)])


def _shown(radiance: F32, display: Display) -> F32:
    light = tone_map(radiance[..., :3] - np.float32(display.black), display.exposure, display.curve, display.srgb)
    cover = radiance[..., 3:]
    light = light if display.premultiplied else light * cover
    return np.asarray(light + (1 - cover) * np.array(display.background, np.float32), np.float32)


def _heat(one: F32, two: F32, display: Display) -> F32:
    with np.errstate(over="ignore"):
        error = np.abs(one[..., :3] - two[..., :3]).max(axis=2) * np.float32(display.exposure * display.gain)
    colours = heat_table()[(np.clip(error, 0, 1) * np.float32(255) + np.float32(0.5)).astype(np.intp), :3]
    covered = np.maximum(one[..., 3], two[..., 3]) > 0
    return np.where(covered[..., None], colours, np.array(display.background, np.float32))
