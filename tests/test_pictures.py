"""Comparison sheets: the right slice, one tone for all, and a PNG whose pixels say what they should."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hmkcta.axes import Axis, name_axes
from hmkcta.errors import HmkctaError, Kind
from hmkcta.pictures import (
    CAPTION,
    GAP,
    HEADER,
    HEAT,
    Tone,
    amplification,
    comparison_sheet,
    heat_colours,
    picture_snr,
    slice_image,
    tone_for,
)
from hmkcta.synthetic import material

Image = pytest.importorskip("PIL.Image", reason="Pillow is not installed")


def ramp(height: int = 24, width: int = 32) -> NDArray[np.float32]:
    y, x = np.mgrid[:height, :width]
    return np.stack([x / width, y / height, 0.3 + 0 * x], axis=2).astype(np.float32)


def pixels(path: Path) -> NDArray[np.uint8]:
    with Image.open(path) as png:
        assert png.format == "PNG"
        return np.asarray(png.convert("RGB"))


def cell(sheet: NDArray[np.uint8], row: int, column: int, height: int, width: int) -> NDArray[np.uint8]:
    top, left = HEADER + row * (height + CAPTION), GAP + column * (width + GAP)
    return sheet[top:top + height, left:left + width]


# --- slices -----------------------------------------------------------------------------------------------------------


def test_slice_takes_space_axes_colour_and_the_middle() -> None:
    values = np.arange(2 * 5 * 3 * 4 * 6, dtype=np.float32).reshape(2, 5, 3, 4, 6)
    axes = name_axes(values.shape, ["light", "view", "rgb", "y", "x"])
    assert np.array_equal(slice_image(values, axes), np.moveaxis(values[1, 2], 0, 2))
    at = slice_image(values, axes, "svbrdf", {"light": 0, "view": -1})
    assert np.array_equal(at, np.moveaxis(values[0, 4], 0, 2))


def test_slice_of_a_volume_takes_its_two_largest_sides() -> None:
    values = np.random.default_rng(0).random((9, 7, 3, 8), dtype=np.float32)
    axes = name_axes(values.shape, ["time", "z", "y", "x"])
    picture = slice_image(values, axes, "volume")
    assert picture.shape == (7, 8, 3)
    assert np.array_equal(picture[:, :, 1], values[4, :, 1, :])
    cube = np.random.default_rng(0).random((4, 4, 4), dtype=np.float32)
    assert np.array_equal(slice_image(cube, name_axes(cube.shape, ["z", "y", "x"]), "volume")[..., 0], cube[2])


def test_axes_named_x_and_y_are_columns_and_rows_in_any_order() -> None:
    values = np.random.default_rng(0).random((6, 5, 3), dtype=np.float32)
    picture = slice_image(values, name_axes(values.shape, ["x", "y", "rgb"]))
    assert np.array_equal(picture, slice_image(values.swapaxes(0, 1), name_axes((5, 6, 3), ["y", "x", "rgb"])))
    assert picture.shape == (5, 6, 3)


def test_slice_without_space_takes_the_two_longest_axes() -> None:
    values = np.random.default_rng(0).random((6, 2, 8))
    assert np.allclose(slice_image(values, name_axes(values.shape))[:, :, 0], values[:, 1, :])


def test_svbrdf_is_shown_near_its_highlight() -> None:
    data = material(lights=24, views=24, size=8)
    picture = slice_image(data.values, data.axes, data.kind)
    found = np.argwhere((data.values == picture).all(axis=(2, 3, 4)))
    assert len(found) == 1
    light, view = (np.asarray(data.axes[n].coords)[found[0][n]] for n in (0, 1))
    half = (light + view) / np.linalg.norm(light + view)
    assert 3 < np.degrees(np.arccos(half[2])) < 17
    assert 15 < np.degrees(np.arccos(view[2])) < 45


@pytest.mark.parametrize(
    ("position", "reason"),
    [({"moon": 0}, "unknown-axis"), ({"time": 2}, "position-outside"), ({"time": -3}, "position-outside")],
)
def test_wrong_positions_are_refused(position: dict[str, int], reason: str) -> None:
    with pytest.raises(HmkctaError) as caught:
        slice_image(np.zeros((2, 3, 4)), name_axes((2, 3, 4), ["time", "y", "x"]), "volume", position)
    assert caught.value.reason == reason


def test_arrays_without_a_picture_are_refused() -> None:
    with pytest.raises(HmkctaError, match=r"no-picture"):
        slice_image(np.zeros((5, 3)), (Axis("x", 5, "space"), Axis("rgb", 3, "channel")))
    with pytest.raises(HmkctaError, match=r"axis-size"):
        slice_image(np.zeros((5, 3)), name_axes((3, 5)))


# --- tone and error ---------------------------------------------------------------------------------------------------


def test_tone_encodes_light_and_clips() -> None:
    tone = Tone(0.0, 1.0)
    shown = tone.show(np.array([-1.0, 0.0, 0.002, 0.2140, 1.0, 7.0, np.nan], np.float32))
    assert shown.tolist() == [0, 0, 7, 127, 255, 255, 0]


def test_tone_follows_the_data() -> None:
    bright = np.linspace(0, 50, 5001, dtype=np.float32).reshape(-1, 1, 1)
    exposed = tone_for(bright)
    assert (exposed.low, exposed.high, exposed.srgb) == (0.0, pytest.approx(49.75, abs=0.01), True)
    signed = tone_for(bright - 25, "volume")
    assert (signed.low, signed.high) == (pytest.approx(-24.75, abs=0.01), pytest.approx(24.75, abs=0.01))
    assert not signed.srgb
    assert not tone_for(bright, "lightfield").srgb
    for odd in (0.0, -3.0, 5.0, np.nan):
        assert tone_for(np.full((2, 2, 3), odd, np.float32)).span > 0


def test_amplification_is_a_power_of_two_for_the_typical_level() -> None:
    error = np.full((4, 4), 0.1, np.float32)
    assert amplification([error]) == 8
    assert amplification([error, error / 64]) == 64  # between 10 and 640
    assert amplification([0 * error]) == 1
    assert amplification([0 * error, error]) == 8


def test_heat_grows_brighter() -> None:
    light = heat_colours(np.linspace(0, 1, 50, dtype=np.float32)).astype(float) @ (0.2126, 0.7152, 0.0722)
    assert (np.diff(light) > 0).all()


def test_picture_snr() -> None:
    image = ramp()
    assert picture_snr(image, image) == np.inf
    assert picture_snr(image, 0 * image) == pytest.approx(0.0)
    assert picture_snr(0 * image, image) == -np.inf
    assert picture_snr(image, np.float32(0.999) * image) == pytest.approx(60.0, abs=0.01)


# --- sheets -----------------------------------------------------------------------------------------------------------


def test_sheet_has_every_picture_in_its_place(tmp_path: Path) -> None:
    original = ramp()
    levels = [("level 1", 0.5 * original), ("level 2", original.copy())]
    path = comparison_sheet(original, levels, tmp_path / "sheet.png", title="A ramp")
    sheet = pixels(path)
    height, width = 24 * 12, 32 * 12  # 384 pixels / 32 texels
    assert sheet.shape == (HEADER + 2 * (height + CAPTION) + GAP, 4 * GAP + 3 * width, 3)
    tone = tone_for(original)
    for row, (_, level) in enumerate(levels):
        for column, image in ((0, tone.show(original)), (1, tone.show(level))):
            shown = cell(sheet, row, column, height, width)
            assert np.array_equal(shown[6::12, 6::12], image)
            assert np.array_equal(shown[::12, ::12], image)
    assert (cell(sheet, 1, 2, height, width) == HEAT[0]).all()  # level 2 is exact
    error = abs(0.5 * original).max(axis=2) / tone.span
    amplified = heat_colours(np.asarray(error * amplification([error, 0 * error]), np.float32))
    assert np.array_equal(cell(sheet, 0, 2, height, width)[::12, ::12], amplified)


def test_labels_are_written_below_the_pictures(tmp_path: Path) -> None:
    original = ramp()
    sheets = [pixels(comparison_sheet(original, [(label, original)], tmp_path / "s.png")) for label in ("", "level 1")]
    top, left = HEADER + 24 * 12, GAP + 32 * 12 + GAP
    captions = [sheet[top:top + CAPTION, left:left + 32 * 12].astype(int) for sheet in sheets]
    differing = np.argwhere((captions[0] != captions[1]).any(axis=2))
    assert len(differing) > 50
    assert differing[:, 0].max() < CAPTION // 2  # only the label's line
    # Never across the column's edge, however long.
    long = pixels(comparison_sheet(original, [("word " * 60, original)], tmp_path / "s.png")).astype(int)
    gap = long[top:top + CAPTION, left + 32 * 12:left + 32 * 12 + GAP]
    assert np.ptp(gap.reshape(-1, 3), axis=0).max() == 0


@pytest.mark.parametrize(
    ("shape", "height", "width"), [((8, 8), 384, 384), ((3, 500), 3, 500), ((1800, 1600), 900, 800)]
)
def test_sheets_scale_their_pictures(tmp_path: Path, shape: tuple[int, int], height: int, width: int) -> None:
    original = ramp(*shape)
    sheet = pixels(comparison_sheet(original, [("half", 0.5 * original)], tmp_path / "s.png"))
    assert sheet.shape == (HEADER + height + CAPTION + GAP, 4 * GAP + 3 * width, 3)


def test_broken_levels_still_make_a_sheet(tmp_path: Path) -> None:
    original = ramp()
    broken = original.copy()
    broken[3, 4] = np.nan
    broken[5, 6] = np.inf
    sheet = pixels(comparison_sheet(original, [("broken", broken), ("black", 0 * original)], tmp_path / "s.png"))
    assert (cell(sheet, 0, 2, 288, 384)[3 * 12 + 6, 4 * 12 + 6] == HEAT[-1]).all()


def test_sheets_refuse_what_cannot_be_compared(tmp_path: Path) -> None:
    original = ramp()
    with pytest.raises(HmkctaError, match=r"no-levels"):
        comparison_sheet(original, [], tmp_path / "s.png")
    with pytest.raises(HmkctaError, match=r"'small'.*image-shape"):
        comparison_sheet(original, [("small", original[1:])], tmp_path / "s.png")
    with pytest.raises(HmkctaError) as caught:
        comparison_sheet(original, [("level", original)], tmp_path / "none" / "s.png")
    assert caught.value.kind is Kind.IO


def test_missing_pillow_says_how_to_get_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "PIL.Image", None)
    with pytest.raises(HmkctaError, match=r'pip install "hmkcta\[demo\]"') as caught:
        comparison_sheet(ramp(), [("level", ramp())], tmp_path / "s.png")
    assert caught.value.reason == "pillow-missing"
    assert slice_image(np.zeros((4, 4)), name_axes((4, 4))).shape == (4, 4, 3)  # slices need no Pillow
