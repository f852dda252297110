"""TIFF, EXR, PNG and other pictures, and many of them as one array."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_tools import finish, start
from hmkcta.errors import Kind
from hmkcta.readers import open_array
from reader_tools import DTYPES, VALUES, little_memory, needed, refusal, refused_wherever_cut, same, survives_damage

#: y, x, rgb
COLOURS = (np.arange(4 * 5 * 3).reshape(4, 5, 3) * 4).astype(np.uint8)


def tiff(path: Path, values: Any, **options: Any) -> Path:
    """The values as pages of a TIFF file."""
    options = {"photometric": "minisblack", **options}
    needed("tifffile").imwrite(path, values, **options)
    return path


def picture(path: Path, values: Any, **options: Any) -> Path:
    """The values as a picture."""
    needed("PIL.Image").fromarray(values).save(path, **options)
    return path


def exr(path: Path, channels: dict[str, Any]) -> Path:
    """Channels as an EXR file."""
    library = needed("OpenEXR")
    header = {"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage}
    packed = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    library.File(header, packed).write(str(path))
    return path


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("big", [False, True])
def test_tiff_stacks_in_one_piece_are_mapped(tmp_path: Path, dtype: str, big: bool) -> None:
    order = ">" if dtype.startswith(">") else "<"
    same(tiff(tmp_path / "a.tif", VALUES.astype(dtype), bigtiff=big, byteorder=order), VALUES, dtype, mapped=True)


@pytest.mark.parametrize("options", [
    {"compression": "zlib"}, {"compression": "lzw", "predictor": True}, {"compression": "zlib", "rowsperstrip": 1},
    {"compression": "zlib", "tile": (16, 16)}, {"compression": "zlib", "metadata": None},
])
def test_packed_tiff_stacks_are_unpacked(tmp_path: Path, options: dict[str, Any]) -> None:
    needed("imagecodecs")
    same(tiff(tmp_path / "a.tif", VALUES.astype("u2"), **options), VALUES, "u2")


def test_colours_and_more_axes_of_tiff(tmp_path: Path) -> None:
    same(tiff(tmp_path / "a.tif", COLOURS, photometric="rgb"), COLOURS, mapped=True)
    stack = np.stack([[COLOURS, COLOURS + 1], [COLOURS + 2, COLOURS + 3]])
    same(tiff(tmp_path / "b.tif", stack, photometric="rgb", compression="zlib"), stack)


def test_series_of_tiff_are_members(tmp_path: Path) -> None:
    with needed("tifffile").TiffWriter(tmp_path / "a.tif") as file:
        file.write(VALUES[0], photometric="minisblack")
        file.write(VALUES[1, :2], photometric="minisblack")
    error = refusal(tmp_path / "a.tif")
    assert error.reason == "source-member"
    assert "0 (4 x 5 of float32), 1 (2 x 5 of float32)" in str(error)
    same(f"{tmp_path}/a.tif:1", VALUES[1, :2], mapped=True)


def test_tiff_whose_axes_are_not_those_of_its_pages(tmp_path: Path) -> None:
    path = tiff(tmp_path / "a.tif", VALUES[..., np.newaxis], compression="zlib")
    with needed("tifffile").TiffFile(path) as file:
        assert file.series[0].shape[1:] != file.series[0].pages[0].shape
    same(path, VALUES[..., np.newaxis])


def test_tiff_of_which_pages_are_missing_is_refused(tmp_path: Path) -> None:
    """The library would make them zeros."""
    path = tiff(tmp_path / "a.ome.tif", VALUES, compression="zlib", ome=True, metadata={"axes": "ZYX"})
    same(path, VALUES)
    path.write_bytes(path.read_bytes().replace(b'SizeZ="3"', b'SizeZ="4"'))
    assert str(refusal(path)) == (
        f"{path}: found 3 pages, allowed 4, as it says. "
        "Next: fetch it again, or write the pages that are there as a file of their own. [Io/source-incomplete]"
    )


def test_a_missing_codec_of_tiff_is_named(tmp_path: Path) -> None:
    needed("imagecodecs")
    path = tiff(tmp_path / "a.tif", VALUES.astype("u2"), compression="lzw")
    before = "import sys; sys.modules['imagecodecs'] = None"
    code, _, err = finish(start("compress", path, "-o", tmp_path / "a.hmk", before=before))
    assert code == 2
    assert "imagecodecs-missing" in err
    assert 'pip install "hmkcta[tiff]"' in err


def test_cut_tiff_is_refused(tmp_path: Path) -> None:
    stacks = [tiff(tmp_path / "a.tif", VALUES, metadata=None, contiguous=False),
              tiff(tmp_path / "b.tif", VALUES, compression="zlib")]
    for path in stacks:
        whole = path.read_bytes()
        for length in range(0, len(whole), 13):
            path.write_bytes(whole[:length])
            try:
                assert np.array_equal(open_array(path), VALUES), length  # what was cut off were no numbers
            except Exception as error:
                assert getattr(error, "reason", ""), (length, error)  # noqa: PT017
        path.write_bytes(whole)
        survives_damage(path)


def test_exr_channels_come_as_colours(tmp_path: Path) -> None:
    half = COLOURS.astype(np.float16)
    same(exr(tmp_path / "a.exr", {"RGB": half}), half)
    path = exr(tmp_path / "b.exr", {"Z": np.ones((4, 5), np.float32), "A": half[..., 0] + 1, "B": half[..., 2],
                                    "G": half[..., 1], "R": half[..., 0], "light.B": -half[..., 2],
                                    "light.R": -half[..., 0]})
    whole = np.concatenate([half, half[..., :1] + 1, np.ones((4, 5, 1)), -half[..., ::2]], axis=2)
    same(path, whole, np.float32)
    same(f"{path}:light", -half[..., ::2])
    same(f"{path}:Z", np.ones((4, 5), np.float32))
    error = refusal(f"{path}:shadow")
    assert error.reason == "source-member"
    assert "light, light.B, light.R" in str(error)


def test_exr_channels_of_several_sizes_are_opened_one_by_one(tmp_path: Path) -> None:
    library, path = needed("OpenEXR"), tmp_path / "a.exr"
    channels = {"Y": library.Channel("Y", VALUES[0, :, :4].copy(), 1, 1),
                "RY": library.Channel("RY", VALUES[1, :, :4].copy(), 2, 2)}
    library.File({"compression": library.NO_COMPRESSION, "type": library.scanlineimage}, channels).write(str(path))
    assert str(refusal(path)) == (
        f"{path}: found channels of 4 x 4, 2 x 2, allowed channels of one size. "
        f"Next: choose one by {path}:NAME, or resample them. [Io/source-format]"
    )
    same(f"{path}:Y", VALUES[0, :, :4])
    assert open_array(f"{path}:RY").shape == (2, 2)


def test_damaged_exr_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    smooth = np.add.outer(np.arange(400), np.arange(50 * 3)).reshape(400, 50, 3).astype(np.float16)
    path = exr(tmp_path / "a.exr", {"RGB": smooth})
    same(path, smooth)
    refused_wherever_cut(path, 997)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    assert refusal(path).reason == "source-damaged"
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("ending", ["png", "bmp", "ppm", "tga", "gif", "webp"])
def test_pictures_are_read_as_they_are(tmp_path: Path, ending: str) -> None:
    options = {"lossless": True} if ending == "webp" else {}
    same(picture(tmp_path / f"a.{ending}", COLOURS, **options), COLOURS)


@pytest.mark.parametrize("values", [COLOURS[..., 0], COLOURS[..., 0] > 99, COLOURS[..., 0].astype("u2") * 200,
                                    np.concatenate([COLOURS, COLOURS[..., :1]], axis=2), COLOURS[..., :2]])
def test_kinds_of_png(tmp_path: Path, values: Any) -> None:
    same(picture(tmp_path / "a.png", values), values)


def test_palettes_are_looked_up(tmp_path: Path) -> None:
    image = needed("PIL.Image").fromarray(COLOURS).convert("P", palette=1, colors=256)
    image.save(tmp_path / "a.png")
    assert open_array(tmp_path / "a.png").shape == (4, 5, 3)
    assert np.array_equal(open_array(tmp_path / "a.png"), np.asarray(image.convert("RGB")))


@pytest.mark.parametrize("channels", [2, 3, 4])
def test_colours_of_16_bits_keep_all_of_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, channels: int
) -> None:
    values = np.arange(4 * 5 * channels, dtype=np.uint16).reshape(4, 5, channels) * 501 + 7
    (tmp_path / "a.png").write_bytes(needed("imagecodecs").png_encode(values))
    same(tmp_path / "a.png", values)
    monkeypatch.setitem(sys.modules, "imagecodecs", None)
    error = refusal(tmp_path / "a.png")
    assert error.reason == "imagecodecs-missing"
    assert 'pip install "hmkcta[images]"' in str(error)


def test_jpeg_by_its_bytes(tmp_path: Path) -> None:
    picture(tmp_path / "a.jpg", COLOURS, quality=95)
    (tmp_path / "a.dat").write_bytes((tmp_path / "a.jpg").read_bytes())
    array = open_array(tmp_path / "a.dat")
    assert array.dtype == np.uint8
    assert np.abs(array.astype(int) - COLOURS).max() < 60


def test_animations_and_bombs_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    image = needed("PIL.Image")
    frames = [image.fromarray(COLOURS), image.fromarray(COLOURS[::-1])]
    frames[0].save(tmp_path / "a.gif", save_all=True, append_images=frames[1:])
    assert refusal(tmp_path / "a.gif").reason == "source-format"
    picture(tmp_path / "a.bmp", COLOURS)
    monkeypatch.setattr(image, "MAX_IMAGE_PIXELS", 15)
    same(tmp_path / "a.bmp", COLOURS)
    monkeypatch.setattr(image, "MAX_IMAGE_PIXELS", 5)
    assert refusal(tmp_path / "a.bmp").reason == "source-too-large"


@pytest.mark.parametrize("ending", ["png", "jpg", "bmp", "ppm", "tga"])
def test_cut_pictures_are_refused(tmp_path: Path, ending: str) -> None:
    path = picture(tmp_path / f"a.{ending}", np.random.default_rng(0).integers(0, 255, (20, 30, 3), np.uint8))
    whole = path.read_bytes()
    for length in range(0, len(whole) - 40, 31):
        path.write_bytes(whole[:length])
        assert refusal(path).kind in (Kind.IO, Kind.INVALID_ARGUMENT), length
    path.write_bytes(whole)
    survives_damage(path)


def shots(folder: Path, names: list[str]) -> Path:
    """Pictures of a folder, each brighter than the one before."""
    folder.mkdir(exist_ok=True)
    for number, name in enumerate(names):
        picture(folder / name, COLOURS + np.uint8(number))
    return folder


def test_a_folder_is_a_stack_in_natural_order(tmp_path: Path) -> None:
    folder = shots(tmp_path / "shots", ["img2.png", "img10.png", "img100.png"])
    (folder / "readme.txt").write_text("three lights")
    (folder / ".hidden.png").write_bytes(b"")
    stack = np.stack([COLOURS + np.uint8(number) for number in range(3)])
    for uri in (folder, f"{folder}/", f"{folder}/*.png", f"{folder}/img[0-9]*"):
        same(uri, stack)
    same(f"{folder}/img1*.png", stack[1:])
    same(f"{tmp_path}/sh*", stack[np.newaxis])


def test_folders_of_folders_are_stacks_of_stacks(tmp_path: Path) -> None:
    for view in ("view2", "view11"):
        shots(tmp_path / view, ["1.png", "2.png", "3.png"])
    assert open_array(f"{tmp_path}/view*").shape == (2, 3, 4, 5, 3)


def test_stacks_of_other_formats(tmp_path: Path) -> None:
    for number in range(3):
        tiff(tmp_path / f"{number}.tif", VALUES[number])
        np.save(tmp_path / f"{number}.npy", VALUES[number])
        exr(tmp_path / f"{number}.exr", {"light.R": VALUES[number], "light.B": -VALUES[number]})
    same(f"{tmp_path}/*.tif", VALUES)
    same(f"{tmp_path}/?.npy", VALUES)
    same(f"{tmp_path}/*.exr:light.R", VALUES)
    same(f"{tmp_path}/*.exr", VALUES, member="light.R")


@pytest.mark.parametrize("odd", [COLOURS[:3], COLOURS[..., 0], np.concatenate([COLOURS, COLOURS[..., :1]], axis=2)])
def test_the_first_that_differs_is_named(tmp_path: Path, odd: Any) -> None:
    folder = shots(tmp_path / "shots", ["1.png", "2.png", "4.png"])
    picture(folder / "3.png", odd)
    error = refusal(folder)
    assert (error.kind, error.reason) == (Kind.INVALID_ARGUMENT, "series-mixed")
    assert error.where.endswith("3.png")
    assert "4 x 5 x 3 of uint8, as 1.png is" in str(error)


def test_folders_of_several_formats_or_of_none(tmp_path: Path) -> None:
    assert refusal(tmp_path).reason == "unreadable"
    assert refusal(f"{tmp_path}/*.png").reason == "unreadable"
    folder = shots(tmp_path / "shots", ["1.png", "2.bmp"])
    error = refusal(folder)
    assert error.reason == "series-mixed"
    assert "found files of .bmp, .png" in str(error)
    same(f"{folder}/*.bmp", COLOURS[np.newaxis] + np.uint8(1))


@pytest.mark.parametrize("mode", [0, 0o400])
def test_a_folder_that_may_not_be_read(tmp_path: Path, mode: int) -> None:
    """Neither listed nor, with 0o400, entered."""
    folder = shots(tmp_path / "shots", ["1.png"])
    folder.chmod(mode)
    try:
        if os.access(folder, os.X_OK):
            pytest.skip("this user may read everything")
        assert str(refusal(folder)) == (
            f"{folder}: cannot be read: Permission denied. "
            "Next: check its permissions. [Io/unreadable]"
        )
    finally:
        folder.chmod(0o700)


def test_a_file_of_a_patterns_name_comes_first(tmp_path: Path) -> None:
    picture(tmp_path / "shot[1].png", COLOURS)
    picture(tmp_path / "shot1.png", COLOURS + np.uint8(1))
    same(tmp_path / "shot[1].png", COLOURS)


def test_a_stack_that_does_not_fit_is_unpacked_into_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = np.arange(6 * 100 * 120, dtype=np.float32).reshape(6, 100, 120)
    for number in range(6):
        tiff(tmp_path / f"{number}.tif", values[number], compression="zlib")
    tiff(tmp_path / "all.tif", values, compression="zlib")
    little_memory(monkeypatch, 200_000)
    same(f"{tmp_path}/?.tif", values, mapped=True)
    same(tmp_path / "all.tif", values, mapped=True)


def test_exr_files_of_several_parts_are_refused(tmp_path: Path) -> None:
    exr = needed("OpenEXR")
    parts = [exr.Part({"compression": exr.ZIP_COMPRESSION}, {"Y": exr.Channel(VALUES[0].copy())}, name)
             for name in ("left", "right")]
    exr.File(parts).write(str(tmp_path / "a.exr"))
    assert "an EXR file of several parts" in str(refusal(tmp_path / "a.exr"))


def test_a_series_may_be_of_either_byte_order(tmp_path: Path) -> None:
    values = np.arange(24, dtype=np.float32).reshape(2, 3, 4)
    for number, order in enumerate("><"):
        np.save(tmp_path / f"{number}.npy", values[number].astype(f"{order}f4"))
    assert np.array_equal(open_array(tmp_path), values)
