"""Axes of pictures: their order and their names; files and channels in the order in which people count."""

from __future__ import annotations

import logging
import os
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_tools import finish, start
from hmkcta import compress
from hmkcta.errors import HmkctaError
from hmkcta.labels import labels_of
from hmkcta.readers import open_array
from reader_tools import needed, refusal, same

COLOURS = np.random.default_rng(1).integers(0, 256, (4, 5, 3), np.uint8)
STACK = np.stack([COLOURS, COLOURS[::-1]])


def names_of(array: Any) -> tuple[str, ...] | None:
    """The names of an array's axes; None: it says none."""
    axes = labels_of(array).axes
    return None if axes is None else tuple(axis.name for axis in axes)


@pytest.mark.parametrize("compression", [None, "zlib"])
def test_samples_of_tiff_come_last_also_where_they_lie_plane_by_plane(tmp_path: Path, compression: str | None) -> None:
    tifffile = needed("tifffile")
    for values in (COLOURS, STACK):
        tifffile.imwrite(tmp_path / "a.tif", np.moveaxis(values, -1, -3), photometric="rgb", planarconfig="separate",
                         compression=compression)
        same(tmp_path / "a.tif", values, mapped=compression is None)
        names = ("axis0", "y", "x", "rgb")[-values.ndim:]
        assert names_of(open_array(tmp_path / "a.tif")) == names


def test_axes_of_tiff_are_named_as_the_file_has_them(tmp_path: Path) -> None:
    tifffile = needed("tifffile")
    values = np.arange(2 * 3 * 2 * 5 * 6, dtype=np.uint16).reshape(2, 3, 2, 5, 6)
    for name, options in (("a.ome.tif", {"ome": True}), ("b.tif", {"imagej": True})):
        tifffile.imwrite(tmp_path / name, values, metadata={"axes": "TZCYX"}, **options)
        array = open_array(tmp_path / name)
        assert np.array_equal(array, values)
        assert names_of(array) == ("t", "z", "channel", "y", "x")
        model = compress(array, snr=20, quality="fast")
        assert [axis.name for axis in model.metadata.axes] == ["t", "z", "channel", "y", "x"]
        assert [axis.role for axis in model.metadata.axes] == ["time", "space", "channel", "space", "space"]
        assert [axis.name for axis in compress(array, axes="a,b,c,d,e", snr=20).metadata.axes] == list("abcde")


def test_numbers_of_imagej_are_no_indices_of_its_colours(tmp_path: Path) -> None:
    values = np.arange(60, dtype=np.uint8).reshape(3, 4, 5)
    table = np.linspace(0, 65535, 3 * 256).astype(np.uint16).reshape(3, 256)
    needed("tifffile").imwrite(tmp_path / "a.tif", values, imagej=True, colormap=table)
    assert np.array_equal(open_array(tmp_path / "a.tif"), values)


def test_pictures_and_their_stacks_have_names(tmp_path: Path) -> None:
    pillow = needed("PIL.Image")
    for number in (1, 2):
        pillow.fromarray(COLOURS).save(tmp_path / f"{number}.png")
        pillow.fromarray(COLOURS[..., 0]).save(tmp_path / f"{number}.bmp")
    assert names_of(open_array(tmp_path / "1.png")) == ("y", "x", "rgb")
    assert names_of(open_array(f"{tmp_path}/*.png")) == ("file", "y", "x", "rgb")
    assert names_of(open_array(f"{tmp_path}/*.bmp")) == ("file", "y", "x")


def test_the_command_line_tells_the_names(tmp_path: Path) -> None:
    needed("PIL.Image").fromarray(COLOURS).save(tmp_path / "a.png")
    code, out, _ = finish(start("compress", tmp_path / "a.png", "-o", tmp_path / "a.hmk", "--plan", "R=2,2,2"))
    assert code == 0
    assert "y=4 x=5 rgb=3" in out


def channels(folder: Path, names: list[str]) -> Path:
    """An EXR file whose channels have the value of their place in `names`."""
    library = needed("OpenEXR")
    values = {name: np.full((4, 5), number, np.float32) for number, name in enumerate(names)}
    made = library.File({"compression": library.ZIP_COMPRESSION, "type": library.scanlineimage}, values)
    made.write(str(folder / "a.exr"))
    return folder / "a.exr"


@pytest.mark.parametrize("names", [
    ["ch1", "ch2", "ch10"], ["400nm", "900nm", "1000nm"], ["R", "G", "B", "w2", "w10"],
    ["S0.900,5nm", "S0.1000,0nm"], ["l2.R", "l2.G", "l10.R", "l10.G"], ["Z", "p9.Z", "p80.Z"]])
def test_channels_of_exr_come_as_people_count(tmp_path: Path, names: list[str]) -> None:
    array = open_array(channels(tmp_path, names))
    assert array[0, 0].tolist() == list(range(len(names)))
    named = names_of(array)
    assert named is not None
    assert named[:2] == ("y", "x")


def test_files_come_as_people_count_and_always_the_same(tmp_path: Path) -> None:
    for number, name in enumerate(["b1", "b2", "b10", "b010"]):
        np.save(tmp_path / f"{name}.npy", np.full((2, 2), number))
    assert open_array(tmp_path)[:, 0, 0].tolist() == [0, 1, 3, 2]


@pytest.mark.parametrize("names", [
    ["dark0.125", "dark0.25", "dark0.5", "dark1", "dark2", "dark10"],
    ["at1.25", "at1.5", "at2.0", "at10.75"],
    ["tile1.2", "tile1.9", "tile1.10", "tile2.1"],
    ["run1.2.9", "run1.2.10", "run1.10.1"],
    ["2024.01.31", "2024.02.5", "2024.10.04"],
])
def test_points_between_digits_are_decimal_where_they_can_be(names: list[str], tmp_path: Path) -> None:
    folder = tmp_path / "scans0.10"  # of which nothing follows for the files in it
    folder.mkdir()
    for number, name in enumerate(names):
        np.save(folder / f"{name}.npy", np.full((2, 2), number))
    for source in (folder, folder / "*.npy"):
        assert open_array(source)[:, 0, 0].tolist() == [*range(len(names))]


@pytest.mark.parametrize(("flag", "said"), [(0x08, "a deep EXR picture"), (0x10, "an EXR file of several parts")])
def test_deep_and_multi_part_exr_are_refused_by_name(tmp_path: Path, flag: int, said: str) -> None:
    path = channels(tmp_path, ["R", "G", "B"])
    data = bytearray(path.read_bytes())
    data[5] |= flag
    path.write_bytes(data)
    error = refusal(path)
    assert error.reason == "source-format"
    assert said in str(error)
    assert "oiiotool" in str(error)


def test_standard_input_pipes_and_devices_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for options in ({}, {"shape": (2,), "dtype": "u1"}):
        assert "standard input" in str(refusal("-", **options))
        os.mkfifo("pipe")
        assert "is a pipe" in str(refusal("pipe", **options))
        os.unlink("pipe")
        assert "is a device" in str(refusal("/dev/zero", **options))
        with socket.socket(socket.AF_UNIX) as server:
            server.bind("socket")
            assert "is a socket" in str(refusal("socket", **options))
        os.unlink("socket")
    (tmp_path / "-").write_bytes(b"ab")
    assert open_array("-", shape=(2,), dtype="u1").tolist() == [97, 98]


def test_libraries_are_not_heard(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """tifffile logs, OpenEXR and libpng print by C: of damaged files nothing of that reaches the user."""
    needed("tifffile").imwrite(tmp_path / "a.tif", STACK, photometric="rgb", compression="zlib")
    (tmp_path / "a.png").write_bytes(needed("imagecodecs").png_encode(COLOURS.astype(np.uint16) * 257))
    channels(tmp_path, ["R", "G", "B"])
    heard = logging.StreamHandler()  # as an application may have on its own
    logging.getLogger().addHandler(heard)
    try:
        for path in sorted(tmp_path.iterdir()):
            whole = path.read_bytes()
            draw = np.random.default_rng(0)
            for number in range(80):
                data: Any = bytearray(whole)
                data[int(draw.integers(len(data)))] ^= 1 << int(draw.integers(8))
                path.write_bytes(data if number % 2 else whole[:len(whole) * number // 80])
                try:
                    open_array(path)
                except HmkctaError as error:
                    assert error.reason  # noqa: PT017
    finally:
        logging.getLogger().removeHandler(heard)
    assert capfd.readouterr() == ("", "")
