"""The readable renderers against what pictures must be: measured elements, sums, known volumes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import degrees
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hmkcta
from hmkcta import Axis, Model
from hmkcta.axes import name_axes
from hmkcta.errors import HmkctaError
from hmkcta.render import Camera, Compare, Light, Look, Renderer, Scene, Surface, Tone, Viewpoint, render, svbrdf
from hmkcta.render.directions import DirectionTable
from hmkcta.render.gbuffer import GBuffer, Rays
from hmkcta.render.layout import lay_out, value_range
from hmkcta.synthetic import hemisphere_directions

F32 = NDArray[np.float32]

ROWS, COLUMNS, LIGHTS, VIEWS = 5, 7, 12, 9


def model_of(values: F32, axes: Sequence[Axis], kind: str, **settings: Any) -> Model:
    """A model that holds the array but for rounding: ranks as large as the modes."""
    ranks = ",".join(str(n) for n in values.shape)
    return hmkcta.compress(values, f"R={ranks}", axes=tuple(axes), kind=kind, quality="fast", **settings)


def svbrdf_axes() -> tuple[Axis, ...]:
    """Axes of a small SVBRDF with measured directions."""
    return (Axis("light", LIGHTS, "light", hemisphere_directions(LIGHTS), "unit vector"),
            Axis("view", VIEWS, "view", hemisphere_directions(VIEWS, 1.2), "unit vector"),
            *name_axes((ROWS, COLUMNS, 3), ["y", "x", "rgb"]))


def svbrdf_values() -> F32:
    """Random numbers: neighbours have nothing to do with each other, so that any wrong index shows."""
    return np.random.default_rng(3).uniform(0.1, 1, (LIGHTS, VIEWS, ROWS, COLUMNS, 3)).astype(np.float32)


def texels(u: NDArray[Any], v: NDArray[Any]) -> GBuffer:
    """A flat sample in the world's xy plane, its frame the world's, that shows these texture coordinates."""
    surface = np.stack(np.broadcast_arrays(u, v, 1.0, 1.0), axis=-1).astype(np.float32)
    normal = np.broadcast_to(np.array([0, 0, 1, 0], np.float32), surface.shape)
    tangent = np.broadcast_to(np.array([1, 0, 0, 1], np.float32), surface.shape)
    return GBuffer(surface, normal, tangent)


def parallel(view: NDArray[Any]) -> Rays:
    """Rays that all come from one direction."""
    return Rays(view.astype(np.float64), np.zeros(3), np.zeros(3), -view.astype(np.float64))


def lit(direction: NDArray[Any], **settings: Any) -> Light:
    """A directional light from a unit vector."""
    x, y, z = direction.tolist()
    return Light(degrees(np.arctan2(y, x)), degrees(np.arcsin(z)), **settings)


def shade(source: Any, light: NDArray[Any], view: NDArray[Any], seen: GBuffer | None = None, **scene: Any) -> F32:
    """Radiance of the flat sample, one pixel a texel."""
    axes = svbrdf_axes()
    v, u = np.mgrid[:ROWS, :COLUMNS]
    seen = seen or texels((u + 0.5) / COLUMNS, (v + 0.5) / ROWS)
    shading = svbrdf.prepare(axes, lay_out(axes, "svbrdf"))
    described = replace(Scene(lights=(lit(light),)), **scene)
    return svbrdf.shade(source, shading, described, seen, parallel(view))[..., :3]


@pytest.mark.parametrize(("light", "view"), [(0, 0), (5, 3), (11, 8)])
def test_measured_directions_show_measured_texels(light: int, view: int) -> None:
    values, (lights, views, *_) = svbrdf_values(), svbrdf_axes()
    assert lights.coords is not None
    assert views.coords is not None
    for source in (values, model_of(values, svbrdf_axes(), "svbrdf")):
        found = shade(source, lights.coords[light], views.coords[view])
        np.testing.assert_allclose(found, values[light, view], atol=3e-3)


def test_directions_and_texels_are_interpolated() -> None:
    """The literal sum over three lights, three views and four texels."""
    values, axes = svbrdf_values(), svbrdf_axes()
    light, view = np.array([0.2, -0.35, 0.0]), np.array([-0.4, 0.1, 0.0])
    for direction in (light, view):
        direction[2] = np.sqrt(1 - direction @ direction)
    u, v = np.array([[0.4]]), np.array([[0.53]])
    found = shade(values, light, view, texels(u, v))[0, 0]

    x, y = 0.4 * COLUMNS - 0.5, 0.53 * ROWS - 0.5
    expected = np.zeros(3)
    shading = svbrdf.prepare(axes, lay_out(axes, "svbrdf"))
    tables = [each.table for each in (shading.light, shading.view) if isinstance(each.table, DirectionTable)]
    (i, wi, _), (j, wj, _) = (table.interpolate(d[None].astype(np.float32))
                              for table, d in zip(tables, (light, view), strict=True))
    for a in range(3):
        for b in range(3):
            for row, wy in ((int(y), 1 - y % 1), (int(y) + 1, y % 1)):
                for column, wx in ((int(x), 1 - x % 1), (int(x) + 1, x % 1)):
                    expected += wi[0, a] * wj[0, b] * wy * wx * values[i[0, a], j[0, b], row, column]
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_lights_add_up_and_fall_off() -> None:
    values, axes = svbrdf_values(), svbrdf_axes()
    assert axes[0].coords is not None
    one, two = axes[0].coords[2], axes[0].coords[4]
    view = np.array([0.0, 0.0, 1.0])
    first, second = shade(values, one, view), shade(values, two, view)
    both = (lit(one, intensity=2.0), lit(two, colour=(1.0, 0.5, 0.0)))
    np.testing.assert_allclose(shade(values, one, view, lights=both), 2 * first + second * [1, 0.5, 0], rtol=1e-5)
    # The sample is at distance 1 below the eye: at the origin.
    point = Light(position=tuple((3 * one).tolist()), intensity=9.0)
    np.testing.assert_allclose(shade(values, one, view, lights=(point,)), first, rtol=1e-4)
    below = Light(azimuth=0.0, elevation=-5.0)
    assert not shade(values, one, view, lights=(below,)).any()
    assert not shade(values, one, view, lights=()).any()


def test_values_without_cosine_are_multiplied_by_it() -> None:
    values, axes = svbrdf_values(), svbrdf_axes()
    assert axes[0].coords is not None
    light, view = axes[0].coords[9], np.array([0.0, 0.0, 1.0])
    without = shade(values, light, view, surface=Surface(cosine=False))
    np.testing.assert_allclose(without, light[2] * shade(values, light, view), rtol=1e-5)


def test_light_fades_to_the_horizon() -> None:
    values = np.ones((LIGHTS, VIEWS, ROWS, COLUMNS, 3), np.float32)
    heights = np.array([0.2, 0.1, 0.01])
    seen = [shade(values, np.array([np.sqrt(1 - z * z), 0, z]), np.array([0.0, 0.0, 1.0])).mean() for z in heights]
    np.testing.assert_allclose(np.array(seen) / heights, seen[0] / heights[0], rtol=0.05)


def test_repeats_are_mirrored_without_a_border() -> None:
    values, axes = svbrdf_values(), svbrdf_axes()
    assert axes[0].coords is not None
    light, view = axes[0].coords[7], axes[0].coords[3]
    u, v = np.array([[0.2]]), np.array([[0.6]])
    plain = shade(values, light, view, texels(u, v))
    np.testing.assert_allclose(shade(values, light, view, texels(2 - u, v)), plain, rtol=1e-4)
    border = shade(values, light, view, texels(np.array([[0.9999, 1.0001]]), v))
    np.testing.assert_allclose(border[0, 0], border[0, 1], rtol=1e-3)
    up = np.array([1, -1, 1])
    np.testing.assert_allclose(shade(values, up * light, up * view, texels(u, v), surface=Surface(y_axis="up")), plain,
                               rtol=1e-4)


def test_interpolation_is_in_the_domain_of_the_transform() -> None:
    values, axes = svbrdf_values(), svbrdf_axes()
    model = model_of(values, axes, "svbrdf", transform="sqrt")
    light, view = np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0])
    roots = shade(np.sqrt(values), light, view)
    np.testing.assert_allclose(shade(model, light, view), roots**2, atol=4e-3)


def test_a_camera_of_a_light_field_sees_its_picture() -> None:
    values = np.random.default_rng(4).uniform(size=(3, 4, ROWS, COLUMNS, 3, 2)).astype(np.float32)
    axes = name_axes(values.shape, ["row", "column", "y", "x", "rgb", "time"])
    model = model_of(values, axes, "lightfield")
    scene = Scene(width=COLUMNS, height=ROWS, viewpoint=Viewpoint(row=1, column=2))
    renderer = Renderer(model, backend="numpy")
    np.testing.assert_allclose(renderer.radiance(scene)[..., :3], values[1, 2, ..., 0], atol=3e-3)
    later = replace(scene, time=0.25)
    between = 0.75 * values[1, 2, ..., 0] + 0.25 * values[1, 2, ..., 1]
    np.testing.assert_allclose(renderer.radiance(later)[..., :3], between, atol=3e-3)
    halfway = replace(scene, viewpoint=Viewpoint(row=1.5, column=2))
    mean = (values[1, 2, ..., 0] + values[2, 2, ..., 0]) / 2
    np.testing.assert_allclose(renderer.radiance(halfway)[..., :3], mean, atol=3e-3)
    wide = renderer.radiance(replace(scene, width=3 * COLUMNS))
    assert not wide[:, : COLUMNS - 1].any()
    np.testing.assert_allclose(wide[:, COLUMNS : 2 * COLUMNS, :3], values[1, 2, ..., 0], atol=3e-3)


def test_one_band_of_many_is_shown_in_grey() -> None:
    values = np.random.default_rng(4).uniform(size=(3, 3, ROWS, COLUMNS, 5)).astype(np.float32)
    model = model_of(values, name_axes(values.shape, ["row", "column", "y", "x", "band"]), "lightfield")
    scene = Scene(width=COLUMNS, height=ROWS, viewpoint=Viewpoint(row=1, column=2))
    for position, shown in ((None, [4, 2, 0]), ({"band": 3}, [3, 3, 3])):
        radiance = Renderer(model, backend="numpy", position=position).radiance(scene)
        np.testing.assert_allclose(radiance[..., :3], values[1, 2][..., shown], atol=3e-3)


def test_what_is_in_focus_stays_sharp() -> None:
    """A plane that moves by 2 pixels a camera: averaged over an aperture, it is itself only in its focus."""
    plane = np.random.default_rng(5).uniform(size=(40, 40)).astype(np.float32)
    values = np.empty((5, 5, 24, 24), np.float32)
    for row, column in np.ndindex(5, 5):
        values[row, column] = plane[8 - 2 * row + 2 : 32 - 2 * row + 2, 8 - 2 * column + 2 : 32 - 2 * column + 2]
    model = model_of(values, name_axes(values.shape, ["row", "column", "y", "x"]), "lightfield")
    renderer = Renderer(model, backend="numpy")
    errors: dict[float, float] = {}
    for focus in (0.0, 2.0):
        scene = Scene(width=24, height=24, viewpoint=Viewpoint(row=2, column=2, focus=focus, aperture=1.5))
        seen = renderer.radiance(scene)[6:-6, 6:-6, 0]
        errors[focus] = float(np.abs(seen - values[2, 2, 6:-6, 6:-6]).mean())
    assert errors[2.0] < 5e-3
    assert errors[0.0] > 0.1


def volume_model(values: F32) -> Model:
    return model_of(values, name_axes(values.shape, ["time", "z", "y", "x"]), "volume")


def test_a_uniform_volume_absorbs_by_its_thickness() -> None:
    model = volume_model(np.ones((1, 20, 10, 10), np.float32))
    look = Look(mode="emission", colours="grey", opacity=((0, 0.1), (1, 0.1)), window=(0.0, 1.0))
    scene = Scene(width=9, height=9, camera=Camera(0, 0, 100.0, 1.0), volume=look)
    middle = Renderer(model, backend="numpy").radiance(scene)[4, 4]
    assert middle[3] == pytest.approx(1 - 0.9**10, abs=0.01), "10 voxels deep along x"
    np.testing.assert_allclose(middle[:3], middle[3], rtol=2e-3)
    cut = replace(scene, volume=replace(look, clip_high=(0.5, 1.0, 1.0)))
    assert Renderer(model, backend="numpy").radiance(cut)[4, 4, 3] == pytest.approx(1 - 0.9**5, abs=0.01)
    above = replace(scene, camera=Camera(0, 90, 100.0, 1.0))
    assert Renderer(model, backend="numpy").radiance(above)[4, 4, 3] == pytest.approx(1 - 0.9**20, abs=0.01)


def test_a_volume_looks_the_same_in_whatever_order_its_axes_are() -> None:
    """As of NIfTI files, whose first axis is x; without these names they are in array order."""
    values = np.random.default_rng(0).random((2, 6, 8, 10)).astype(np.float32)
    scene = Scene(width=24, height=24)
    expected = Renderer(volume_model(values), backend="numpy").radiance(scene)
    turned = np.ascontiguousarray(values.transpose(3, 2, 1, 0))
    named = model_of(turned, name_axes(turned.shape, ["x", "y", "z", "t"]), "volume")
    np.testing.assert_allclose(Renderer(named, backend="numpy").radiance(scene), expected, atol=1e-4)
    unnamed = model_of(turned, name_axes(turned.shape, ["a:space", "b:space", "c:space", "t"]), "volume")
    assert np.abs(Renderer(unnamed, backend="numpy").radiance(scene) - expected).max() > 0.01


def test_a_cube_is_whole_from_wherever_the_default_camera_turns() -> None:
    model = hmkcta.compress(np.ones((6, 6, 6), np.float32), "R=1", axes=["z", "y", "x"], kind="volume", quality="fast")
    look = Look("iso", "grey", window=(0.0, 1.0), iso=0.5)
    renderer = Renderer(model, backend="numpy")
    for azimuth in (None, 0.0, 45.0, 200.0):
        cover = renderer.radiance(Scene(48, 48, camera=Camera(azimuth=azimuth), volume=look))[..., 3]
        assert cover.max() == 1
        assert not any(edge.any() for edge in (cover[0], cover[-1], cover[:, 0], cover[:, -1]))


def test_an_iso_surface_of_distance_is_a_sphere() -> None:
    z, y, x = (np.mgrid[:32, :32, :32] - 15.5) / 16
    ball = (1 - np.sqrt(z * z + y * y + x * x)).astype(np.float32)
    look = Look(mode="iso", iso=0.5, window=(0.0, 1.0), colours="grey", ambient=0.0, specular=0.0)
    light = Light(azimuth=0.0, elevation=0.0)
    scene = Scene(width=65, height=65, camera=Camera(0, 0, 50.0, 2.4), volume=look, lights=(light,))
    seen = Renderer(volume_model(ball[None]), backend="numpy").radiance(scene)
    across = np.hypot(*np.mgrid[-32:33, -32:33]) * 2 / 65 * 50 * np.tan(np.radians(1.2))
    assert ((seen[..., 3] > 0) == (across < 0.5)).mean() > 0.985
    inside = across < 0.42
    np.testing.assert_allclose(seen[inside][:, 0], 0.5 * np.sqrt(1 - (across[inside] / 0.5) ** 2), atol=0.03)


def test_the_maximum_is_the_largest_on_the_ray() -> None:
    values = np.zeros((2, 8, 8, 8), np.float32)
    values[1, 3, 4, 5] = 2.0
    look = Look(mode="maximum", colours="grey", window=(0.0, 2.0), step=0.1)
    scene = Scene(width=33, height=33, camera=Camera(0, 0, 100.0, 1.2), volume=look)
    renderer = Renderer(volume_model(values), backend="numpy")
    assert not renderer.radiance(scene)[..., :3].any()
    assert renderer.radiance(replace(scene, time=1)).max() == pytest.approx(1, abs=0.06)
    assert renderer.radiance(replace(scene, time=0.5))[..., 0].max() == pytest.approx(0.5, abs=0.04)


def test_pictures_compare_levels_and_the_original() -> None:
    values, axes = svbrdf_values(), svbrdf_axes()
    model = hmkcta.compress(values, "R=2,2,2,2,3 / R=4,4,4,4,3", axes=axes, kind="svbrdf", quality="fast")
    renderer = Renderer(model, original=values, backend="numpy")
    scene = Scene(width=32, height=32, tone=Tone(stops=0.5))
    coarse, fine = (renderer.picture(replace(scene, level=level)) for level in (1, 2))
    assert np.abs(coarse.astype(int) - fine).max() > 10
    split = renderer.picture(replace(scene, level=1, compare=Compare("split", level=2, position=0.25)))
    assert (split[:, :7] == coarse[:, :7]).all()
    assert (split[:, 9:] == fine[:, 9:]).all()
    same = renderer.picture(replace(scene, compare=Compare("heat", level=2, gain=1.0)))
    assert len(np.unique(same.reshape(-1, 3), axis=0)) == 2, "no error, and the background"
    against = renderer.picture(replace(scene, level=1, compare=Compare("heat")))
    assert against.max() > 200
    holed = values.copy()
    holed[...] = np.nan
    lost = Renderer(model, original=holed, backend="numpy").picture(replace(scene, compare=Compare("heat")))
    assert lost[16, 16].min() > 200, "no number: the brightest colour"
    with pytest.raises(HmkctaError, match="no-original"):
        Renderer(model, backend="numpy").picture(replace(scene, compare=Compare("split")))


def test_a_file_of_no_kind_shows_a_slice() -> None:
    values = np.random.default_rng(6).uniform(size=(3, 16, 24)).astype(np.float32)
    model = model_of(values, name_axes(values.shape, ["gas", "y", "x"]), "generic")
    scene = Scene(width=24, height=16, position={"gas": 2}, tone=Tone(white=1.0))
    expected = np.rint(255 * np.clip(np.asarray(model[2]), 0, 1))
    assert np.abs(render(model, scene, backend="numpy")[..., 0] - expected).max() <= 1


def test_a_slice_shows_what_is_negative_and_what_a_window_says() -> None:
    values = np.linspace(-3, 1, 24 * 16, dtype=np.float32).reshape(16, 24)
    model = model_of(values, name_axes(values.shape, ["y", "x"]), "generic")
    low, high = value_range(model, model.shape)
    for window in (None, (-1.0, 0.5)):
        scene = Scene(width=24, height=16, volume=Look(window=window))
        black, white = window or (low, high)
        expected = np.rint(255 * np.clip((np.asarray(model) - black) / (white - black), 0, 1))
        assert np.abs(render(model, scene, backend="numpy")[..., 0] - expected).max() <= 1
    assert low < -2.9


@pytest.mark.parametrize(("scene", "reason"), [
    (Scene(level=3), "level-out-of-range"),
    (Scene(level=0), "level-out-of-range"),
    (Scene(position={"gloss": 1}), "unknown-axis"),
    (Scene(kind="lightfield", viewpoint=Viewpoint(row=3)), "viewpoint-outside"),
    (Scene(kind="volume"), "no-space"),
    (Scene(surface=Surface("teapot")), "unknown-shape"),
])
def test_scenes_that_do_not_fit_are_refused(scene: Scene, reason: str) -> None:
    values = svbrdf_values()
    model = hmkcta.compress(values, "R=1", axes=svbrdf_axes(), kind="svbrdf", quality="fast")
    with pytest.raises(HmkctaError, match=reason):
        render(model, scene, backend="numpy")
    with pytest.raises(HmkctaError, match="original-shape"):
        Renderer(model, original=values[:3])


def test_render_is_loaded_when_it_is_used() -> None:
    assert hmkcta.render.render is render
    with pytest.raises(AttributeError, match="teapot"):
        _ = hmkcta.teapot
