"""Synthetic data: seeded, named, physically plausible, and as hard as the figures in docs expect."""

from __future__ import annotations

from math import acos, exp, pi, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.data import SHEET_FILE
from numpy.typing import NDArray

from hmkcta.errors import HmkctaError
from hmkcta.synthetic import (
    Dataset,
    SheetMaps,
    brocade_maps,
    hemisphere_directions,
    light_field,
    load_sheet,
    material,
    svbrdf_from_parameters,
    volume,
)
from hmkcta.synthetic.jet import advect
from hmkcta.synthetic.layers import Layer
from hmkcta.synthetic.microfacet import evaluate
from real_data import real_data


def small(kind: str, seed: int = 0) -> Dataset:
    if kind == "svbrdf":
        return material(lights=5, views=4, size=24, seed=seed)
    if kind == "volume":
        return volume((12, 16, 20), frames=3, seed=seed)
    return light_field(views=3, size=32, frames=2, seed=seed)


@pytest.mark.parametrize(
    ("kind", "names", "shape"),
    [
        ("svbrdf", ("light", "view", "y", "x", "rgb"), (5, 4, 24, 24, 3)),
        ("volume", ("time", "z", "y", "x"), (3, 12, 16, 20)),
        ("lightfield", ("row", "column", "y", "x", "time"), (3, 3, 32, 32, 2)),
    ],
)
def test_shape_names_and_roles(kind: str, names: tuple[str, ...], shape: tuple[int, ...]) -> None:
    data = small(kind)
    assert (data.kind, data.names, data.values.shape) == (kind, names, shape)
    assert data.values.dtype == np.float32
    assert data.values.flags.c_contiguous
    roles = {"row": "view", "column": "view", "rgb": "channel", "z": "space", "y": "space", "x": "space"}
    assert [axis.role for axis in data.axes] == [roles.get(axis.name, axis.name) for axis in data.axes]


@pytest.mark.parametrize("kind", ["svbrdf", "volume", "lightfield"])
def test_seeded_and_finite(kind: str) -> None:
    first, again, other = small(kind), small(kind), small(kind, seed=1)
    assert np.array_equal(first.values, again.values)
    assert abs(first.values - other.values).mean() > 0.02 * abs(first.values).mean()
    assert np.isfinite(first.values).all()
    assert first.values.min() >= 0
    assert first.values.std() > 0.1 * first.values.mean()
    assert first.values.max() <= (1.0 if kind != "svbrdf" else 20.0)


def test_default_material_has_the_papers_layout() -> None:
    data = material()
    assert data.values.shape == (24, 24, 96, 96, 3)
    assert data.nbytes == 63_700_992


# --- directions -------------------------------------------------------------------------------------------------------


def test_directions_are_unit_vectors_spread_over_the_upper_hemisphere() -> None:
    directions = hemisphere_directions(58).astype(np.float64)
    assert np.allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-6)
    assert directions[:, 2].min() > np.cos(np.radians(75.0))
    cosine = np.clip(directions @ directions.T, -1, 1) - 2 * np.eye(58)
    nearest = np.degrees(np.arccos(cosine.max(axis=1)))
    assert nearest.min() > 10.0  # 58 caps that tile the same area are 15 degrees apart
    assert abs(directions[:, :2].mean(axis=0)).max() < 0.05


def test_material_axes_carry_their_directions() -> None:
    data = small("svbrdf")
    for name, count in (("light", 5), ("view", 4)):
        coords = data.axis(name).coords
        assert coords is not None
        assert coords.shape == (count, 3)
        assert np.allclose(np.linalg.norm(coords, axis=1), 1.0, atol=1e-6)
        assert coords[:, 2].min() > 0


# --- the microfacet material ------------------------------------------------------------------------------------------


def scalar_microfacet(n: Any, l: Any, v: Any, albedo: float, f0: float, alpha: float) -> float:  # noqa: E741
    """GGX, height-correlated Smith, Schlick over Lambert, times the cosine: from the textbook, one number at a time."""
    h = (l + v) / np.linalg.norm(l + v)
    nl, nv, nh, vh = (float(a @ b) for a, b in ((n, l), (n, v), (n, h), (v, h)))
    d = alpha**2 / (pi * (nh**2 * (alpha**2 - 1) + 1) ** 2)

    def smith(cosine: float) -> float:
        return (sqrt(1 + alpha**2 * (1 / cosine**2 - 1)) - 1) / 2

    g = 1 / (1 + smith(nl) + smith(nv))
    f = f0 + (1 - f0) * (1 - vh) ** 5
    return (albedo / pi + d * g * f / (4 * nl * nv)) * nl


def test_material_against_the_textbook_formula() -> None:
    maps = brocade_maps(24, seed=0)
    data = small("svbrdf")
    lights, views = (np.asarray(data.axis(name).coords, np.float64) for name in ("light", "view"))
    for m, n, y, x, c in [(0, 0, 0, 0, 0), (4, 3, 23, 23, 2), (1, 2, 7, 15, 1), (3, 0, 12, 4, 0), (2, 1, 20, 9, 2)]:
        normal = maps.normal[y, x].astype(np.float64)
        expected = scalar_microfacet(normal, lights[m], views[n], float(maps.albedo[y, x, c]),
                                     float(maps.specular[y, x, c]), float(maps.roughness[y, x]))
        assert data.values[m, n, y, x, c] == pytest.approx(expected, rel=1e-4)


def test_material_is_reciprocal() -> None:
    directions = hemisphere_directions(7, max_zenith=45)
    maps = brocade_maps(16, seed=2)
    cosine = np.einsum("lc,yxc->lyx", directions, maps.normal)
    brdf = evaluate(maps, directions, directions) / cosine[:, None, :, :, None]
    assert np.allclose(brdf, brdf.swapaxes(0, 1), rtol=1e-4)


def test_material_reflects_no_more_than_it_receives() -> None:
    lights, view = hemisphere_directions(800, max_zenith=90), hemisphere_directions(1)
    reflected = evaluate(brocade_maps(8), lights, view).mean(axis=0) * 2 * np.pi  # [view, y, x, rgb]
    assert 0.02 < reflected.min() < reflected.max() < 1.0


def test_maps_are_in_range_and_varied() -> None:
    maps = brocade_maps(96)
    assert np.allclose(np.linalg.norm(maps.normal, axis=2), 1.0, atol=1e-5)
    assert maps.normal[:, :, 2].min() > 0.5
    assert 0.25 <= maps.roughness.min() < maps.roughness.max() <= 0.8
    gold = maps.specular[:, :, 0] > 0.3
    assert 0.1 < gold.mean() < 0.6


def captured(values: NDArray[np.float32], axis: int, rank: int) -> float:
    """dB left over by the best `rank` basis vectors of one axis."""
    rows = np.moveaxis(values, axis, 0).reshape(values.shape[axis], -1).astype(np.float64)
    energy = np.linalg.eigvalsh(rows @ rows.T)[::-1]
    return float(10 * np.log10(energy.sum() / energy[rank:].sum()))


def test_material_is_neither_trivial_nor_hopeless() -> None:
    values = material(lights=8, views=6).values
    assert 10 < captured(values, 2, 6) < 20
    assert 20 < captured(values, 2, 48) < 35


# --- the measured sheet -----------------------------------------------------------------------------------------------


def random_sheet(seed: int = 0) -> tuple[SheetMaps, NDArray[np.float32]]:
    rng = np.random.default_rng(seed)
    maps = SheetMaps(rng.random((4, 5, 3)), rng.random((4, 5, 3)).astype(np.float16), rng.uniform(0.05, 0.9, (4, 5)))
    return maps, hemisphere_directions(6)


def scalar_sheet(maps: SheetMaps, light: Any, view: Any, y: int, x: int, c: int) -> float:
    half = np.asarray(light, np.float64) + view
    tilt = acos(min(1.0, float(half[2] / np.linalg.norm(half))))
    lobe = exp(-((tilt / float(maps.roughness[y, x])) ** 2)) / (4 * float(view[2]))
    return float(maps.diffuse[y, x, c]) * float(light[2]) + float(maps.specular[y, x, c]) * lobe


def test_sheet_against_the_published_formula() -> None:
    maps, directions = random_sheet()
    values = svbrdf_from_parameters(maps, directions, directions[::-1]).values
    for m, n, y, x, c in [(0, 0, 0, 0, 0), (5, 5, 3, 4, 2), (2, 4, 1, 3, 1), (3, 2, 2, 0, 0)]:
        expected = scalar_sheet(maps, directions[m], directions[5 - n], y, x, c)
        assert values[m, n, y, x, c] == pytest.approx(expected, rel=1e-5)


def test_sheet_writes_into_a_memmap(tmp_path: Path) -> None:
    maps, directions = random_sheet()
    out = np.lib.format.open_memmap(tmp_path / "sheet.npy", "w+", np.float32, (6, 2, 4, 5, 3))
    data = svbrdf_from_parameters(maps, directions, directions[:2], out=out)
    out.flush()
    assert data.values is out
    assert np.array_equal(np.load(tmp_path / "sheet.npy"), svbrdf_from_parameters(maps, directions).values[:, :2])


def test_grey_sheet_becomes_rgb() -> None:
    maps, directions = random_sheet()
    grey = SheetMaps(maps.diffuse[:, :, 0], maps.specular[:, :, 1], maps.roughness)
    values = svbrdf_from_parameters(grey, directions).values
    assert values.shape == (6, 6, 4, 5, 3)
    assert np.array_equal(values[..., 0], values[..., 2])


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"roughness": np.zeros((4, 5))}, "roughness-not-positive"),
        ({"diffuse": np.full((4, 5, 3), np.nan)}, "not-finite"),
        ({"specular": np.ones((4, 6, 3))}, "map-shape"),
        ({"roughness": np.ones((4, 5, 1))}, "map-shape"),
    ],
)
def test_bad_maps_are_refused(change: dict[str, NDArray[Any]], reason: str) -> None:
    good = {"diffuse": np.ones((4, 5, 3)), "specular": np.ones((4, 5)), "roughness": np.ones((4, 5))}
    SheetMaps(**good)
    with pytest.raises(HmkctaError) as caught:
        SheetMaps(**{**good, **change})
    assert caught.value.reason == reason


@pytest.mark.parametrize(
    ("directions", "reason"),
    [
        ([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]], "bad-direction"),
        ([[0.0, 0.0, -1.0]], "bad-direction"),
        ([[0.0, 0.5, 0.5]], "bad-direction"),
        ([[0.0, np.nan, 1.0]], "bad-direction"),
        ([0.0, 0.0, 1.0], "directions-shape"),
    ],
)
def test_bad_directions_are_refused(directions: list[Any], reason: str) -> None:
    with pytest.raises(HmkctaError) as caught:
        svbrdf_from_parameters(random_sheet()[0], np.array(directions))
    assert caught.value.reason == reason


@pytest.mark.parametrize("out", [np.empty((6, 6, 4, 5), np.float32), np.empty((6, 6, 4, 5, 3))])
def test_unfit_destination_is_refused(out: Any) -> None:
    maps, directions = random_sheet()
    with pytest.raises(HmkctaError, match=r"out-mismatch"):
        svbrdf_from_parameters(maps, directions, out=out)


@pytest.mark.parametrize("state", ["new", "rusted"])
def test_real_steel_sheet(state: str) -> None:
    maps, directions = load_sheet(real_data(SHEET_FILE), state)
    maps = maps.cropped(20, 30)
    values = svbrdf_from_parameters(maps, directions).values
    assert values.shape == (58, 58, 20, 30, 3)
    assert np.isfinite(values).all()
    for m, n, y, x, c in [(0, 0, 0, 0, 0), (57, 3, 19, 29, 2), (11, 40, 7, 8, 1)]:
        expected = scalar_sheet(maps, directions[m], directions[n], y, x, c)
        assert values[m, n, y, x, c] == pytest.approx(expected, rel=1e-3)  # the directions are not exactly unit


def test_missing_sheet_is_named(tmp_path: Path) -> None:
    with pytest.raises(HmkctaError, match=r"nothing\.npz.*Io/sheet-not-readable"):
        load_sheet(tmp_path / "nothing.npz")


# --- volume and light field -------------------------------------------------------------------------------------------


def test_volume_moves_coherently_and_has_fine_structure() -> None:
    dye = volume(32, frames=8).values.astype(np.float64)
    near, far = (np.square(dye[step] - dye[0]).sum() / np.square(dye[0]).sum() for step in (1, 7))
    assert 0.02 < near < far
    assert dye[:, :, :, 16].max(axis=(1, 2)).min() > 0.3  # the jet never leaves the middle
    assert dye[:, :3].mean() < 0.05 * dye[:, 14:18].mean()  # and hardly reaches the walls
    power = abs(np.fft.fftn(dye[4] - dye[4].mean())) ** 2
    k = np.sqrt(sum(np.square(g) for g in np.meshgrid(*[np.fft.fftfreq(32, 1 / 32)] * 3)))
    assert 0.03 < power[k > 6].sum() / power.sum() < 0.5


def test_dye_is_carried_along_x() -> None:
    core = volume(32, frames=6).values[:, 12:20, 12:20]  # the jet crosses 32 voxels in 32 frames

    def likeness(shift: int) -> float:
        later, earlier = core[3:, :, :, 8:24], core[:-3, :, :, 8 - shift:24 - shift]
        return float(np.corrcoef(later.ravel(), earlier.ravel())[0, 1])

    assert max(range(-4, 8), key=likeness) in (1, 2, 3, 4)


def test_advection_moves_by_whole_voxels_exactly_and_keeps_its_range() -> None:
    rng = np.random.default_rng(0)
    field = rng.random((5, 6, 7), dtype=np.float32)
    step = np.zeros((3, 5, 6, 7), np.float32)
    step[2] = 2
    assert np.array_equal(advect(field, step)[:, :, 2:], field[:, :, :-2])
    wild = advect(field, rng.normal(0, 3, step.shape).astype(np.float32))
    assert field.min() <= wild.min() <= wild.max() <= field.max()


def test_layers_move_by_their_disparity_and_motion() -> None:
    shade = np.random.default_rng(0).random((30, 30), dtype=np.float32)
    layer = Layer(shade, np.ones_like(shade), 10, disparity=2.0, motion=(1.0, -1.0))
    assert np.array_equal(layer.window(10, (0, 0), 0)[0], shade[10:20, 10:20])
    assert np.array_equal(layer.window(10, (1, -2), 0)[0], shade[12:22, 6:16])
    assert np.array_equal(layer.window(10, (0, 0), 3)[0], shade[7:17, 13:23])
    between = layer.window(10, (0.25, 0), 0)[0]
    assert np.allclose(between, 0.5 * (shade[10:20, 10:20] + shade[11:21, 10:20]), atol=1e-6)


def test_light_field_has_parallax_and_motion() -> None:
    values = light_field(views=3, size=48, frames=3).values
    scene = values[1, 1, :, :, 1]
    energy = np.square(scene).sum()
    for other in (values[1, 2, :, :, 1], values[2, 1, :, :, 1], values[1, 1, :, :, 2]):
        assert 0.003 < np.square(other - scene).sum() / energy < 0.3
    # The fence, nearest of all, moves with the cameras: 1.4 pixels of 96 for each.
    bar = [int(np.argmin(values[row, 1, 30:, 2, 1])) for row in range(3)]
    assert bar[0] > bar[2]


@pytest.mark.parametrize("make", [lambda: material(lights=0), lambda: volume(2), lambda: light_field(frames=0),
                                  lambda: material(size=1), lambda: volume((4, 4, 3)), lambda: volume(8, frames=0)])
def test_sizes_too_small_are_refused(make: Any) -> None:
    with pytest.raises(HmkctaError, match=r"InvalidArgument/size-too-small"):
        make()


def test_dataset_checks_its_axes() -> None:
    data = small("volume")
    with pytest.raises(HmkctaError, match=r"axis-size"):
        Dataset(data.values[0], data.axes, "volume")
    with pytest.raises(HmkctaError, match=r"unknown-kind"):
        Dataset(data.values, data.axes, "movie")
    with pytest.raises(HmkctaError, match=r"unknown-axis"):
        data.axis("light")
