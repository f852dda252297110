"""Pictures under many lights with a list of them (RTI), and light fields as grids of pictures or one of all views."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_tools import refused, report, run
from hmkcta.readers import open_array
from reader_tools import axes_of, coords_of, needed, refusal, roles_of, same

LIGHTS = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, -0.6, 0.8], [-0.28, 0.0, 0.96]])
#: Pictures ``[number, y, x, rgb]`` of which no two are alike.
PICTURES = np.random.default_rng(0).integers(0, 256, (16, 6, 8, 3), np.uint8)


def pictures(folder: Path, names: list[str], values: NDArray[np.uint8] = PICTURES) -> Path:
    """PNG files of these names."""
    image = needed("PIL.Image")
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in zip(names, values, strict=False):
        image.fromarray(picture).save(folder / name)
    return folder


def lit(folder: Path, names: list[str], text: str | None = None, listed: str = "coin.lp") -> Path:
    """Pictures with a list of their lights."""
    pictures(folder, [Path(name.replace("\\", "/")).name for name in names])
    lines = [f"{name} {' '.join(map(str, light))}" for name, light in zip(names, LIGHTS.tolist(), strict=True)]
    (folder / listed).write_text("\n".join([str(len(names)), *lines]) + "\n" if text is None else text)
    return folder


@pytest.mark.parametrize("before", ["", "pictures/", "/gone/by now/", "C:\\rti\\coin 3\\"])
def test_lists_of_lights(tmp_path: Path, before: str) -> None:
    names = [f"{before}coin 10.png", f"{before}coin 9.png", f"{before}b.png", f"{before}a.png"]
    folder = lit(tmp_path / "coin", names)
    for uri in (folder, folder / "coin.lp"):
        same(uri, PICTURES[:4])  # in the order of the list
        array = open_array(uri)
        assert coords_of(array) == [LIGHTS.tolist()]
        assert axes_of(array)["light"].unit == "unit vector"
        assert roles_of(array) == [("light", "light"), ("y", "space"), ("x", "space"), ("rgb", "channel")]


def test_lists_in_a_folder_of_their_own(tmp_path: Path) -> None:
    folder = lit(tmp_path / "coin", ["pictures/1.png", "pictures/2.png", "pictures/3.png", "pictures/4.png"])
    (folder / "pictures").mkdir()
    for path in folder.glob("*.png"):
        shutil.move(path, folder / "pictures" / path.name)
    same(folder, PICTURES[:4])


def test_near_lights_have_positions(tmp_path: Path) -> None:
    text = "2\r\n1.png 0 0 250.5\r\n2.png 10 -20 3e2\r\n"
    array = open_array(lit(tmp_path, ["1.png", "2.png", "3.png", "4.png"], text))
    assert axes_of(array)["light"].unit == ""
    assert coords_of(array) == [[[0, 0, 250.5], [10, -20, 300]]]


@pytest.mark.parametrize(("text", "reason"), [
    ("", "source-damaged"), ("Minimize\n obj: x1\n", "source-damaged"), ("0\n", "source-damaged"),
    ("5\n" + "1.png 0 0 1\n" * 4, "source-truncated"), ("3\n" + "1.png 0 0 1\n" * 4, "source-too-long"),
    ("1\n1.png 0 0\n", "source-damaged"), ("1\n1.png 0 0 nan\n", "source-damaged"), ("1\n0 0 1\n", "source-damaged"),
    ("1\n1.png 0 0 up\n", "source-damaged"), ("1\ngone.png 0 0 1\n", "unreadable"), ("9" * 12, "source-damaged"),
])
def test_lists_that_are_refused(tmp_path: Path, text: str, reason: str) -> None:
    folder = lit(tmp_path, ["1.png", "2.png", "3.png", "4.png"], text)
    assert refusal(folder).reason == reason
    assert refusal(folder / "coin.lp").reason == reason


def test_lists_may_be_stacked_but_not_name_themselves(tmp_path: Path) -> None:
    names = ["1.png", "2.png", "3.png", "4.png"]
    for name in ("a", "b"):
        lit(tmp_path / name, names)
    for pattern in ("*", "*/coin.lp"):
        assert open_array(f"{tmp_path}/{pattern}").shape == (2, 4, 6, 8, 3)
    (tmp_path / "a" / "coin.lp").write_text("1\ncoin.lp 0 0 1\n")
    assert refusal(tmp_path / "a").reason == "source-format"


def test_of_several_lists_one_is_to_be_named(tmp_path: Path) -> None:
    names = ["1.png", "2.png", "3.png", "4.png"]
    lit(lit(tmp_path, names), names, listed="cropped.lp")
    error = refusal(tmp_path)
    assert error.reason == "source-member"
    assert "coin.lp, cropped.lp" in str(error)
    same(tmp_path / "cropped.lp", PICTURES[:4])


def test_a_list_end_to_end(tmp_path: Path) -> None:
    folder = lit(tmp_path / "coin", ["1.png", "2.png", "3.png", "4.png"])
    report("compress", folder, "-o", tmp_path / "a.hmk", "--plan", "R=2,2,2,2")
    axes = report("info", tmp_path / "a.hmk")["axes"]
    assert [axis["name"] for axis in axes] == ["light", "y", "x", "rgb"]
    assert report("verify", tmp_path / "a.hmk", "--against", folder)["made_from_source"]


#: Names as collections have them for a grid of 2 x 3.
STANFORD = [f"out_{row:02}_{column:02}_-{776 + row}.88_{533 + column}.25_.png"
            for row in range(2) for column in range(3)]


def test_stanfords_names_are_a_grid(tmp_path: Path) -> None:
    folder = pictures(tmp_path / "chess", STANFORD)
    (folder / "out.txt").write_text("of the camera")
    pictures(folder, ["thumbnail.png"])
    for uri in (folder, f"{folder}/*"):
        same(uri, PICTURES[:6].reshape(2, 3, 6, 8, 3), names="out_{row}_{column}_*")
    array = open_array(folder, names="out_{row}_{column}_*", views="2x3")
    assert roles_of(array) == [("row", "view"), ("column", "view"), ("y", "space"), ("x", "space"), ("rgb", "channel")]
    assert coords_of(array) == []
    assert refusal(folder, names="out_{row}_{column}_*", views="3x2").reason == "source-views"
    swapped = open_array(folder, names="out_{column}_{row}_*")
    assert list(axes_of(swapped))[:2] == ["column", "row"]


def test_heidelbergs_names_are_a_grid_by_its_size(tmp_path: Path) -> None:
    folder = pictures(tmp_path / "cotton", [f"input_Cam{number:03}.png" for number in range(12)])
    expected = PICTURES[:12].reshape(3, 4, 6, 8, 3)
    same(f"{folder}/input_Cam*.png", expected, views=(3, 4))
    same(folder, expected, views="3,4")
    pictures(folder, ["objectids.png"])
    same(folder, expected, views="3x4", names="input_Cam{view}.png")
    assert roles_of(open_array(folder, views="3x4", names="input_Cam{view}.png"))[0] == ("row", "view")
    error = refusal(folder, views="3x4")
    assert error.reason == "source-views"
    assert "13 files" in str(error)
    same(folder, PICTURES[:12], names="input_Cam{view}.png")


def test_numbers_in_names_become_coordinates(tmp_path: Path) -> None:
    names = [f"light{light}_{wave}nm.png" for light in (3, 20) for wave in (400, 550, 1000)]
    array = open_array(pictures(tmp_path, names), names="light{light}_{wavelength}nm.png")
    assert array.shape == (2, 3, 6, 8, 3)
    assert coords_of(array) == [[3, 20], [400, 550, 1000]]
    assert roles_of(array)[:2] == [("light", "light"), ("wavelength", "channel")]
    assert roles_of(open_array(tmp_path, names="light{t:view}_400nm.png"))[0] == ("t", "view")


@pytest.mark.parametrize(("template", "said"), [
    ("out_*", "fields in braces"), ("in_{row}_{column}*", "some that are called"), ("out_{row}_*", "both at (0,)"),
    ("out_{}_{column}_*", ""), ("out_{row}_{row}_*", "axis-twice"), ("out_{x}_{y}_*", "axis-twice"),
    ("out_{a b}_{c}_*", "bad-axis-name"), ("out_{row:up}_{column}_*", "unknown-role"),
])
def test_names_that_make_no_grid(tmp_path: Path, template: str, said: str) -> None:
    assert said in str(refusal(pictures(tmp_path, STANFORD), names=template))


def test_a_grid_with_a_hole(tmp_path: Path) -> None:
    pictures(tmp_path, STANFORD[:4] + STANFORD[5:])
    error = refusal(tmp_path, names="out_{row}_{column}_*")
    assert error.reason == "source-names"
    assert "row 1, column 1" in str(error)


@pytest.mark.parametrize("views", ["17", "0x3", "3x-1", (3,), (2, 3, 4), "2x3:lens", 17, "axb"])
def test_views_that_are_no_grid(tmp_path: Path, views: Any) -> None:
    assert refusal(pictures(tmp_path, STANFORD), views=views).reason == "source-views"


def test_views_of_one_picture(tmp_path: Path) -> None:
    grid = PICTURES[:6].reshape(2, 3, 6, 8, 3)
    tiled = grid.transpose(0, 2, 1, 3, 4).reshape(12, 24, 3)
    lens = grid.transpose(2, 0, 3, 1, 4).reshape(12, 24, 3)
    pictures(tmp_path, ["tiles.png", "eslf.png", "gray.png"], np.stack([tiled, lens, lens]))
    same(tmp_path / "tiles.png", grid, views="2x3")
    same(tmp_path / "eslf.png", grid, views="2x3:lenslets")
    array = open_array(tmp_path / "eslf.png", views="2x3:lenslets")
    assert roles_of(array) == [("row", "view"), ("column", "view"), ("y", "space"), ("x", "space"), ("rgb", "channel")]
    np.save(tmp_path / "gray.npy", lens[..., 0])
    same(tmp_path / "gray.npy", grid[..., 0], views="2x3:lenslets", mapped=True)
    for views, reason in (("5x3", "source-views"), ("2x7:lenslets", "source-views")):
        assert refusal(tmp_path / "eslf.png", views=views).reason == reason
    assert refusal(tmp_path / "eslf.png", names="{a}.png").reason == "source-names"
    assert refusal(f"{tmp_path}/*.png", views="1x3:lenslets").reason == "source-views"
    assert refusal(tmp_path / "eslf.png", views="2x3", shape=(2,), dtype="u1").reason == "source-views"


def test_a_light_field_end_to_end(tmp_path: Path) -> None:
    folder, words = pictures(tmp_path / "chess", STANFORD), ("--names", "out_{row}_{column}_*")
    made = report("compress", folder, "-o", tmp_path / "a.hmk", "--plan", "R=2,2,2,2,2", *words)
    assert made["snr_db"] > 0
    found = report("info", tmp_path / "a.hmk")
    assert found["kind"] == "lightfield"
    assert [axis["name"] for axis in found["axes"]] == ["row", "column", "y", "x", "rgb"]
    assert report("verify", tmp_path / "a.hmk", "--against", folder, *words)["made_from_source"]
    planned = run("plan", folder, *words, "--views", "2x3").output
    assert "--views 2x3" in planned
    assert "--names 'out_{row}_{column}_*'" in planned
    assert "3 x 3" in refused("compress", folder, "-o", tmp_path / "b.hmk", "--views", "3x3", code=2)
