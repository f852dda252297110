"""Comparison sheets: the original, each level and where it errs, side by side as a PNG.

`slice_image` cuts a picture out of an array of any order, `comparison_sheet` lays pictures out. All pictures of a
sheet share one tone mapping (`Tone`) and one amplification of the error, so brightness means the same everywhere.
Pillow draws; it comes with ``pip install "hmkcta[demo]"`` and is imported only when a sheet is written.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .arrays import F32
from .axes import Axis, as_drawn
from .errors import HmkctaError, Kind, invalid
from .metrics import snr_db
from .support.optional import library

if TYPE_CHECKING:
    from PIL import Image, ImageDraw

U8 = NDArray[np.uint8]

CELL = 384  # pixels that the longer side of a picture should come near, by whole-numbered scaling
NARROWEST = 260  # pixels a column needs for its captions
GAP, HEADER, CAPTION = 16, 62, 60  # pixels between cells, above the first row, below each picture
WHITE_PERCENTILE, BLACK_PERCENTILE = 99.5, 0.5  # of the original; what lies beyond is clipped
ERROR_PERCENTILE = 99.0  # of a level's error that the heat map should just reach
BACKGROUND, INK, DIM = (24, 25, 28), (236, 236, 232), (158, 160, 166)

#: Degrees between half vector and normal where most materials show both their gloss and their colour.
GLANCE = 10.0

#: Colours of the error map from 0 to the most it shows: dark to bright also in grey and to the colour blind.
HEAT = ((4, 4, 14), (40, 16, 92), (106, 28, 129), (170, 48, 118), (224, 80, 88), (250, 140, 70), (252, 206, 110),
        (252, 253, 216))
HEAT_STEPS = 1024
LARGEST_GAIN = 40  # powers of two that an error may be amplified or damped by


@dataclass(frozen=True)
class Tone:
    """Display of numbers: `low` black, `high` white, and `srgb` whether they are light, which displays encode.

    >>> Tone(0.0, 2.0, srgb=False).show(np.array([[[0.0, 1.0, 9.0]]], np.float32)).tolist()
    [[[0, 128, 255]]]
    """

    low: float
    high: float
    srgb: bool = True

    @property
    def span(self) -> float:
        """What lies between black and white."""
        return self.high - self.low

    def show(self, image: NDArray[Any]) -> U8:
        """8-bit picture of an image of any shape; what is no number is black."""
        light = np.nan_to_num(np.clip((image.astype(np.float64) - self.low) / self.span, 0.0, 1.0))
        if self.srgb:
            light = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
        return np.asarray(np.rint(255.0 * light), np.uint8)


def tone_for(image: F32, kind: str = "svbrdf") -> Tone:
    """The tone mapping that suits an original: exposed by its percentiles; an SVBRDF is light, the rest display-ready.

    Black is 0 where no value is negative.

    >>> tone_for(np.arange(201, dtype=np.float32)[:, None, None], "volume")
    Tone(low=0.0, high=199.0, srgb=False)
    """
    finite = image[np.isfinite(image)]
    if not finite.size:
        return Tone(0.0, 1.0, kind == "svbrdf")
    low = 0.0 if finite.min() >= 0 else float(np.percentile(finite, BLACK_PERCENTILE))
    high = float(np.percentile(finite, WHITE_PERCENTILE))
    if high <= low:
        high = max(float(finite.max()), low)
    return Tone(low, high if high > low else low + 1.0, kind == "svbrdf" and low == 0.0)


def slice_image(
    array: Any, axes: Sequence[Axis], kind: str = "svbrdf", position: Mapping[str, int] | None = None
) -> F32:
    """A picture ``[h, w, 3]`` float32 through an array (or anything NumPy can slice) of any order.

    Its sides are the two largest space axes (the last ones if equal), or else the two longest, `as_drawn`. A
    channel axis of size 3 is its colour. Other axes stand where `position` says, by name, or else at the middle; light
    and view of an SVBRDF with directions where both its gloss and its colour show.

    >>> from hmkcta.axes import name_axes
    >>> frames = np.arange(24.0).reshape(2, 3, 4)
    >>> slice_image(frames, name_axes((2, 3, 4), ["time", "y", "x"]), "volume", {"time": 0})[2, 3].tolist()
    [11.0, 11.0, 11.0]

    Raises:
        HmkctaError: the axes are not the array's or make no picture, `position` names none of them or lies outside.
    """
    sizes = tuple(axis.size for axis in axes)
    if sizes != tuple(array.shape):
        raise invalid("axis-size", "axes", sizes, f"{tuple(array.shape)}, the array's shape")
    sides, colour = picture_axes(axes)
    place = _place(axes, kind, position or {})
    kept = [*sides] if colour is None else [*sides, colour]
    cut = np.asarray(array[tuple(slice(None) if n in kept else place[n] for n in range(len(axes)))], np.float32)
    picture = cut.transpose([sorted(kept).index(n) for n in kept])
    return np.ascontiguousarray(picture if colour is not None else np.repeat(picture[:, :, None], 3, axis=2))


def picture_axes(axes: Sequence[Axis]) -> tuple[list[int], int | None]:
    """Numbers of the two axes that a picture of `slice_image` spans, and of its colours, None where there are none.

    >>> from hmkcta.axes import name_axes
    >>> picture_axes(name_axes((9, 6, 8, 3), ["time", "y", "x", "rgb"]))
    ([1, 2], 3)

    Raises:
        HmkctaError: the axes make no picture.
    """
    colour = next((n for n, axis in enumerate(axes) if axis.role == "channel" and axis.size == 3), None)
    return _sides(axes, colour), colour


def comparison_sheet(
    original_image: F32, levels: Sequence[tuple[str, F32]], path: str | Path, *, title: str = "", kind: str = "svbrdf",
) -> Path:
    """Write a PNG with a row for each of `levels` (label, image): the original, the level, its amplified error.

    Images are ``[h, w, 3]`` as from `slice_image`. Each row's caption has the SNR of that picture in dB; the header
    says what share of white the brightest error colour stands for. Small pictures are enlarged texel by texel. `kind`
    chooses the tone.

    Raises:
        HmkctaError: Pillow is missing, an image has another shape, there is no level, or the file cannot be written.
    """
    if not levels:
        raise invalid("no-levels", "levels", "an empty list", "one (label, image) or more")
    for label, image in (("original", original_image), *levels):
        if image.shape != original_image.shape or image.ndim != 3 or image.shape[2] != 3 or not image.size:
            raise invalid("image-shape", f"image {label!r}", image.shape,
                          f"[h, w, 3] like the original {original_image.shape}")
    sheet = _Sheet(original_image, levels, tone_for(original_image, kind))
    picture = sheet.draw(title or "Original, approximation, error")
    try:
        picture.save(path, format="PNG")
    except OSError as error:
        raise HmkctaError(Kind.IO, "not-writable", str(path), found=error,
                          allowed="a file in a folder that can be written",
                          told=f"cannot be written: {error}") from error
    return Path(path)


def picture_snr(original: F32, image: F32) -> float:
    """SNR in dB of a picture, infinite where equal, by the direct formula in float64.

    >>> round(picture_snr(np.full((1, 1, 3), 10.0, np.float32), np.full((1, 1, 3), 9.0, np.float32)), 6)
    20.0
    """
    signal = np.square(original, dtype=np.float64).sum()
    noise = np.square(original.astype(np.float64) - image).sum()
    return snr_db(float(signal), float(noise))


def heat_colours(share: NDArray[Any]) -> U8:
    """Colours ``[.., 3]`` of shares 0..1 (clipped; what is no number counts as 1) along `HEAT`.

    >>> heat_colours(np.array([0.0, 7.0], np.float32)).tolist()
    [[4, 4, 14], [252, 253, 216]]
    """
    ramp, stops = np.asarray(HEAT, np.float64), np.linspace(0.0, 1.0, len(HEAT))
    steps = np.linspace(0.0, 1.0, HEAT_STEPS)
    table = np.rint(np.stack([np.interp(steps, stops, ramp[:, c]) for c in range(3)], axis=-1)).astype(np.uint8)
    known = np.nan_to_num(np.clip(share, 0.0, 1.0), nan=1.0)
    return table[np.rint(known * (HEAT_STEPS - 1)).astype(np.int64)]


@dataclass(eq=False)
class _Sheet:
    """The parts of one sheet while it is drawn."""

    original: F32
    levels: Sequence[tuple[str, F32]]
    tone: Tone

    def __post_init__(self) -> None:
        wide = self.original.astype(np.float64)
        self.errors = [abs(image - wide).max(axis=2) / self.tone.span for _, image in self.levels]
        self.gain = amplification(self.errors)
        self.picture = self.tone.show(scaled(self.original))
        self.height, self.width = self.picture.shape[:2]
        self.column = max(self.width, NARROWEST)

    def draw(self, title: str) -> Image.Image:
        """The whole sheet."""
        image, draw, font = _pillow()
        rows = len(self.levels)
        sheet = image.new("RGB", (4 * GAP + 3 * self.column, HEADER + rows * (self.height + CAPTION) + GAP), BACKGROUND)
        pen = draw.Draw(sheet)
        self._header(sheet, pen, font, title)
        for row, ((label, level), error) in enumerate(zip(self.levels, self.errors, strict=True)):
            pictures = (self.picture, self.tone.show(scaled(level)), heat_colours(scaled(error) * self.gain))
            snr = picture_snr(self.original, level)
            worst = float(np.where(np.isnan(error), np.inf, error).max())
            texts = (
                ("original", f"{self.original.shape[1]} x {self.original.shape[0]} texels"),
                (label, "identical to the original" if snr == np.inf else f"this picture: SNR {snr:.2f} dB"),
                (f"error, amplified x {self.gain:g}", f"largest {100 * worst:.3g} % of white"),
            )
            for n, (picture, text) in enumerate(zip(pictures, texts, strict=True)):
                self._cell(sheet, pen, font, (row, n), picture, text)
        return sheet

    def _cell(
        self, sheet: Image.Image, pen: ImageDraw.ImageDraw, font: Any, at: tuple[int, int], picture: U8,
        text: tuple[str, str],
    ) -> None:
        """One picture with its two lines of caption, at (row, column)."""
        image, _, _ = _pillow()
        left, top = GAP + at[1] * (self.column + GAP), HEADER + at[0] * (self.height + CAPTION)
        sheet.paste(image.fromarray(picture), (left, top))
        for line, size, ink, below in ((text[0], 18, INK, 5), (text[1], 15, DIM, 29)):
            face = font.load_default(size)
            pen.text((left, top + self.height + below), _fitted(line, face, self.column), ink, face)

    def _header(self, sheet: Image.Image, pen: ImageDraw.ImageDraw, font: Any, title: str) -> None:
        """Title at the left, the scale of the error colours at the right."""
        image, _, _ = _pillow()
        left = GAP + 2 * (self.column + GAP)
        face, small = font.load_default(22), font.load_default(14)
        pen.text((GAP, 17), _fitted(title, face, left - 2 * GAP), INK, face)
        wide = max(self.width, NARROWEST)
        ramp = np.broadcast_to(np.linspace(0.0, 1.0, wide), (12, wide))
        sheet.paste(image.fromarray(heat_colours(ramp)), (left, 40))
        pen.text((left, 17), "error 0", DIM, small)
        most = f"{100 / self.gain:.3g} % of white"
        pen.text((left + wide - small.getlength(most), 17), most, DIM, small)


def scaled(image: NDArray[Any]) -> NDArray[Any]:
    """An image ``[h, w, ..]`` enlarged texel by texel to about `CELL` pixels, or averaged down to below thrice that.

    >>> scaled(np.zeros((96, 64, 3))).shape, scaled(np.zeros((1000, 1537))).shape
    ((384, 256, 3), (500, 768))
    """
    height, width = image.shape[:2]
    step = max(1, round(max(height, width) / CELL / 2))
    if step == 1:
        up = max(1, round(CELL / max(height, width)))
        return np.repeat(np.repeat(image, up, axis=0), up, axis=1)
    down = [min(step, n) for n in (height, width)]
    rows, columns = height // down[0], width // down[1]
    whole = image[:rows * down[0], :columns * down[1]]
    return whole.reshape(rows, down[0], columns, down[1], *image.shape[2:]).mean(axis=(1, 3))


def amplification(errors: Sequence[NDArray[Any]]) -> float:
    """The power of two that brings the typical level's `ERROR_PERCENTILE` nearest to 1, for errors as shares of white.

    >>> amplification([np.full((2, 2), 0.1, np.float32)])
    8.0
    """
    known = [error[np.isfinite(error)] for error in errors]
    tops = [float(np.percentile(error, ERROR_PERCENTILE)) for error in known if error.size]
    tops = [top for top in tops if top > 0]
    power = round(-float(np.mean(np.log2(tops)))) if tops else 0
    return float(2.0 ** min(max(power, -LARGEST_GAIN), LARGEST_GAIN))


def _sides(axes: Sequence[Axis], colour: int | None) -> list[int]:
    """Numbers of the two axes a picture spans: its rows, its columns."""
    free = [n for n in range(len(axes)) if n != colour]
    space = [n for n in free if axes[n].role == "space"]
    choice = space if len(space) >= 2 else free
    if len(choice) < 2:
        named = ", ".join(axis.name for axis in axes)
        raise invalid("no-picture", "axes", named, "two axes or more besides the colour")
    return as_drawn(axes, sorted(choice, key=lambda n: (axes[n].size, n))[-2:])


def _place(axes: Sequence[Axis], kind: str, position: Mapping[str, int]) -> list[int]:
    """The index at which each axis stands."""
    names = [axis.name for axis in axes]
    place = [axis.size // 2 for axis in axes]
    if kind == "svbrdf":
        for n, index in _glancing(axes).items():
            place[n] = index
    for name, index in position.items():
        if name not in names:
            raise invalid("unknown-axis", "position", repr(name), ", ".join(names))
        size = axes[names.index(name)].size
        if not -size <= index < size:
            raise invalid("position-outside", f"position of {name}", index, f"{-size} to {size - 1}")
        place[names.index(name)] = int(index)
    return place


def _glancing(axes: Sequence[Axis]) -> dict[int, int]:
    """Indices of the light and view axes whose half vector is nearest to `GLANCE` degrees from the normal."""
    found = {axis.role: n for n, axis in enumerate(axes) if axis.coords is not None and axis.coords.shape[1:] == (3,)}
    if not {"light", "view"} <= set(found):
        return {}
    lights, views = (np.asarray(axes[found[role]].coords, np.float64) for role in ("light", "view"))
    half = lights[:, None, :] + views[None, :, :]
    tilt = np.degrees(np.arccos(np.clip(half[..., 2] / np.linalg.norm(half, axis=2).clip(1e-9), -1.0, 1.0)))
    # A view from 30 degrees shows the material best; half a degree of that is worth one of the half vector.
    slant = abs(np.degrees(np.arccos(np.clip(views[:, 2], -1.0, 1.0))) - 30.0)
    light, view = np.unravel_index(np.argmin(abs(tilt - GLANCE) + 0.5 * slant[None, :]), tilt.shape)
    return {found["light"]: int(light), found["view"]: int(view)}


def _fitted(text: str, face: Any, width: float) -> str:
    """The text, shortened at its end to that width in pixels."""
    if face.getlength(text) <= width:
        return text
    while text and face.getlength(text + "...") > width:
        text = text[:-1]
    return text.rstrip() + "..."


def _pillow() -> tuple[Any, Any, Any]:
    """Pillow's Image, ImageDraw and ImageFont modules, or an error that says how to get them."""
    names = ("Image", "ImageDraw", "ImageFont")
    image, draw, font = (library(f"PIL.{name}", "Pillow", "demo", "pictures") for name in names)
    return image, draw, font
