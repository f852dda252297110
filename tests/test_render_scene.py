"""Scenes as JSON, the axes a renderer moves along, tables of directions, surfaces, colours."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from hmkcta.axes import Axis, name_axes
from hmkcta.errors import HmkctaError
from hmkcta.render.angles import angle_grid
from hmkcta.render.colours import transfer_table
from hmkcta.render.directions import build_table, directions_of
from hmkcta.render.gbuffer import camera_rays, trace
from hmkcta.render.layout import lay_out, time_steps, value_range
from hmkcta.render.lightfield import aim, find_cameras
from hmkcta.render.mesh import Mesh, load_mesh, make_mesh
from hmkcta.render.scene import Camera, Look, Scene, Surface, Viewpoint, load_scene, scene_from_json
from hmkcta.render.tonemap import tone_map
from hmkcta.synthetic import hemisphere_directions

#: What is no scene, the reason and the field at fault.
REFUSED: list[tuple[Any, str, str]] = [
    ({"widht": 64}, "unknown-field", "scene.widht"),
    ({"camera": {"azimut": 1}}, "unknown-field", "scene.camera.azimut"),
    ({"width": 64.5}, "wrong-type", "scene.width"),
    ({"width": True}, "wrong-type", "scene.width"),
    ({"width": 0}, "out-of-range", "width"),
    ({"height": 9000}, "out-of-range", "height"),
    ({"lights": {"azimuth": 1}}, "wrong-type", "scene.lights"),
    ({"lights": [{}] * 9}, "too-many-lights", "lights"),
    ({"lights": [{"position": [1, 2]}]}, "bad-vector", "scene.lights[0].position"),
    ({"camera": {"elevation": 91}}, "out-of-range", "camera.elevation"),
    ({"tone": {"curve": "log"}}, "unknown-choice", "tone.curve"),
    ({"surface": {"repeat": [0, 1]}}, "bad-vector", "surface.repeat"),
    ({"volume": {"window": [1, 1]}}, "bad-window", "volume.window"),
    ({"volume": {"window": [float("-inf"), 1]}}, "bad-window", "volume.window"),
    ({"volume": {"clip_low": [0.5, 0, 0], "clip_high": [0.5, 1, 1]}}, "bad-clip", "volume.clip_high"),
    ({"volume": {"colours": [[0, 1, 1]]}}, "bad-vector", "volume.colours[0]"),
    ({"volume": {"clip_high": [1, 1]}}, "bad-vector", "scene.volume.clip_high"),
    ({"position": {"time": 1.5}}, "wrong-type", "scene.position.time"),
    ([], "wrong-type", "scene"),
]


def reason(code: str, function: Any, *arguments: Any) -> HmkctaError:
    """The error with this reason that a call must end with."""
    with pytest.raises(HmkctaError) as caught:
        function(*arguments)
    assert caught.value.reason == code
    return caught.value


@pytest.mark.parametrize(("value", "code", "where"), REFUSED)
def test_scenes_are_read_strictly(value: Any, code: str, where: str) -> None:
    assert reason(code, scene_from_json, value).where == where


def test_a_box_of_two_numbers_is_refused() -> None:
    with pytest.raises(HmkctaError, match=r"volume.clip_high: found \[1.0, 1.0\]"):
        Look(clip_high=cast(Any, (1.0, 1.0)))


def test_half_a_pixel_is_refused() -> None:
    with pytest.raises(HmkctaError, match=r"width: found 64.5, allowed a whole number of pixels"):
        Scene(width=cast(Any, 64.5))


def test_scenes_say_only_what_differs(tmp_path: Path) -> None:
    assert scene_from_json({}) == Scene()
    path = tmp_path / "scene.json"
    path.write_text('{"camera": {"azimuth": 5, "distance": null}, "lights": [{"colour": [1, 0.5, 0]}]}', "utf-8")
    scene = load_scene(path)
    assert scene.camera == Camera(azimuth=5.0)
    assert scene.lights[0].colour == (1.0, 0.5, 0.0)
    path.write_text("{", "utf-8")
    reason("not-json", load_scene, path)
    path.write_text('{"time": NaN}', "utf-8")
    reason("not-json", load_scene, path)
    reason("unreadable", load_scene, tmp_path / "none.json")


def test_every_field_of_a_scene_comes_through_json() -> None:
    def plain(value: Any) -> Any:
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)} if is_dataclass(value) else (
            list(map(plain, cast("tuple[Any, ...]", value))) if isinstance(value, tuple) else value)

    scene = Scene(time=1.5, volume=Look(colours=((0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 1.0, 1.0)), window=(0.0, 2.0)))
    assert scene_from_json(json.loads(json.dumps(plain(scene)))) == scene


def test_the_documented_scene_has_every_field() -> None:
    """docs/rendering.md shows one JSON object with all fields, at their defaults but for what it shows."""
    text = (Path(__file__).parent.parent / "docs" / "rendering.md").read_text(encoding="utf-8")
    shown: dict[str, Any] = json.loads(text.partition("```json\n")[2].partition("```")[0])
    scene = scene_from_json(shown)
    assert set(shown) == {f.name for f in fields(Scene)}
    for name in ("camera", "surface", "viewpoint", "volume", "tone", "compare"):
        assert set(shown[name]) == {f.name for f in fields(getattr(Scene(), name))}
    for name in ("surface", "viewpoint", "volume", "tone", "compare", "position", "width", "height"):
        assert getattr(scene, name) == getattr(Scene(), name)


def test_layouts_find_axes_by_role() -> None:
    spectral = lay_out(name_axes((4, 5, 6, 7, 31), ["light", "view", "y", "x", "band:channel"]), "svbrdf")
    assert (spectral.lights, spectral.views, spectral.space, spectral.channels) == ((0,), (1,), (2, 3), (30, 15, 0))
    jet = lay_out(name_axes((2, 3, 4, 5, 6), ["time", "gas:other", "z", "y", "x"]), "volume", {"gas": 2})
    assert (jet.time, jet.space, jet.stands[1]) == (0, (2, 3, 4), 2)
    assert reason("no-space", lay_out, name_axes((2, 3), ["time", "x"]), "volume").where == "axes of a volume"
    reason("no-cameras", lay_out, name_axes((2, 3), ["y", "x"]), "lightfield")
    lamps = name_axes((2, 2, 2, 3, 3), ["light", "lamp:light", "flash:light", "y", "x"])
    assert reason("too-many-directions", lay_out, lamps, "svbrdf").where == "axes of a svbrdf"
    reason("position-outside", lay_out, name_axes((2, 3), ["y", "x"]), "svbrdf", {"y": 2})


def test_time_lies_between_two_frames() -> None:
    assert time_steps(None, 4) == ((0, 1), (1.0, 0.0))
    assert time_steps(3, 4) == ((2, 3), (0.0, 1.0))
    assert time_steps(0, 1) == ((0, 0), (1.0, 0.0))
    reason("time-out-of-range", time_steps, 3.5, 4)


def test_the_value_range_is_that_of_spread_elements() -> None:
    values = np.random.default_rng(0).normal(size=(40, 50, 60))
    low, high = value_range(values, values.shape)
    assert low == pytest.approx(np.percentile(values, 0.5), abs=0.15)
    assert high == pytest.approx(np.percentile(values, 99.5), abs=0.15)


@pytest.mark.parametrize("count", [1, 2, 3, 58, 400])
def test_tables_interpolate_measured_directions(count: int) -> None:
    """At a measured direction only it counts; elsewhere weights are a partition of unity without jumps."""
    measured = hemisphere_directions(count).astype(np.float64)
    table = build_table(measured)
    index, weight, height = table.interpolate(measured.astype(np.float32))
    own = (weight * (index == np.arange(count)[:, None])).sum(axis=1)
    np.testing.assert_allclose(own, 1, atol=2e-4)
    np.testing.assert_allclose(height, measured[:, 2], atol=2e-4)

    rng = np.random.default_rng(count)
    path = np.cumsum(rng.normal(scale=4e-4, size=(4000, 3)), axis=0) + np.array([0.3, 0.2, 0.9])
    path[:, 2] = abs(path[:, 2])
    path /= np.linalg.norm(path, axis=1, keepdims=True)
    index, weight, _ = table.interpolate(path.astype(np.float32))
    assert weight.min() >= 0
    np.testing.assert_allclose(weight.sum(axis=1), 1, atol=1e-5)
    spread = np.zeros((len(path), count))
    for k in range(3):
        np.add.at(spread, (np.arange(len(path)), index[:, k]), weight[:, k])
    steps = np.abs(np.diff(spread, axis=0)).sum(axis=1) / np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() < 12 * np.sqrt(count) + 12


def test_table_triangles_are_their_neighbours_neighbours() -> None:
    table = build_table(hemisphere_directions(58))
    for triangle, across in enumerate(table.neighbours.astype(np.int64)):
        for other in across[across != 0xFFFFFFFF]:
            assert triangle in table.neighbours[other]


def test_directions_come_from_coordinates() -> None:
    slanted = np.array([[0.0, 0.0], [60.0, 90.0]])
    vectors, assumed = directions_of(Axis("light", 2, "light", np.radians(slanted), "radians"))
    np.testing.assert_allclose(vectors[1], [0, np.sin(np.pi / 3), 0.5], atol=1e-12)
    assert not assumed
    assert directions_of(Axis("view", 7, "view"))[1]
    reason("directions-shape", directions_of, Axis("view", 2, "view", np.zeros((2, 4))))
    reason("bad-direction", directions_of, Axis("view", 1, "view", np.array([[0.0, 0.0, -1.0]])))
    with pytest.raises(HmkctaError, match=r"\[2.0, 90.0\].* --unit light=degrees"):
        directions_of(Axis("light", 1, "light", np.array([[2.0, 90.0]])))


def test_grids_of_angles_are_bilinear_and_go_around() -> None:
    theta = Axis("theta", 3, "light", np.array([60.0, 0.0, 30.0]), "degrees")
    phi = Axis("phi", 4, "light", np.array([10.0, 280.0, 100.0, 190.0]), "degrees")
    for axes, numbers in (((theta, phi), (0, 1)), ((phi, theta), (1, 0))):  # azimuths are known by their name
        grid = angle_grid(axes, (0, 1))
        assert grid.axes == numbers
        down, around = np.radians(np.meshgrid(np.linspace(0, 60, 7), np.linspace(-180, 540, 25)))
        vectors = np.stack([np.sin(down) * np.cos(around), np.sin(down) * np.sin(around), np.cos(down)], axis=-1)
        taps, height = grid.interpolate(vectors.reshape(-1, 3).astype(np.float32))
        np.testing.assert_allclose(height, vectors[..., 2].reshape(-1), atol=1e-6)
        for (index, weight), axis in zip(taps, (theta, phi), strict=True):
            np.testing.assert_allclose(weight.sum(axis=1), 1, atol=1e-6)
            assert weight.min() >= 0
            angles = np.radians(np.asarray(axis.coords))[index]
            one = np.einsum("bk,bk->b", weight, np.unwrap(angles, axis=1))
            wanted = (down if axis is theta else around).reshape(-1)
            inside = np.sin(down).reshape(-1) > 1e-6
            if axis is theta:
                np.testing.assert_allclose(one, wanted, atol=1e-6)
            else:
                np.testing.assert_allclose(np.exp(1j * one)[inside], np.exp(1j * wanted)[inside], atol=1e-5)
    beyond, height = grid.interpolate(np.array([[1, 0, 0]], np.float32))
    assert beyond[0][1].max() == 1
    assert height[0] == pytest.approx(0.5)
    bare = Axis("theta", 3, "light")
    reason("directions-shape", angle_grid, (bare, phi), (0, 1))
    reason("bad-direction", angle_grid, (Axis("theta", 2, "light", np.array([0.0, 60.0])), phi), (0, 1))


def test_cameras_come_from_axes_or_coordinates() -> None:
    grid = name_axes((2, 3, 8, 8), ["row", "column", "y", "x"])
    cameras = find_cameras(grid, lay_out(grid, "lightfield"))
    assert cameras.regular
    assert cameras.place[4].tolist() == [1, 1]
    places = np.array([[0.0, 0.0], [0.0, 2.5], [2.5, 0.0], [2.5, 2.5]])
    one = (Axis("view", 4, "view", places), *name_axes((8, 8), ["y", "x"]))
    found = find_cameras(one, lay_out(one, "lightfield"))
    assert found.regular
    assert found.place.max() == 1
    between = aim(found, Viewpoint(row=0.25, column=0.0))
    assert between.weight.tolist() == [0.75, 0.25]
    assert reason("viewpoint-outside", aim, found, Viewpoint(row=1.5)).where == "viewpoint.row"


def test_a_sphere_is_seen_as_one() -> None:
    rays = camera_rays(Camera(30, 20, 4.0, 40.0), 1.5)
    seen = trace(make_mesh(Surface(), 8, 8), rays, 96, 64)
    straight = rays.through_pixels(96, 64)
    middle = straight @ -rays.eye
    inside = middle**2 - (rays.eye @ rays.eye - 1)
    covered = seen.surface[..., 3] > 0
    assert (covered != (inside > 0)).mean() < 0.005
    both = covered & (inside > 0.02)
    np.testing.assert_allclose(seen.surface[..., 2][both], (middle - np.sqrt(np.maximum(inside, 0)))[both], atol=4e-3)
    place = rays.eye + seen.surface[..., 2:3] * straight
    np.testing.assert_allclose(seen.normal[..., :3][both], place[both], atol=6e-3)
    across = np.cross(seen.normal[..., :3], seen.tangent[..., :3]) * seen.tangent[..., 3:]
    assert (across[both][:, 2] < 0).all(), "rows grow downward"


@pytest.mark.parametrize("shape", ["sphere", "plane", "cloth"])
def test_surfaces_have_unit_frames(shape: str) -> None:
    mesh = make_mesh(Surface(shape, (2.0, 3.0)), 10, 20)
    for unit in (mesh.normal, mesh.tangent[:, :3]):
        np.testing.assert_allclose(np.linalg.norm(unit, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(np.einsum("vk,vk->v", mesh.normal, mesh.tangent[:, :3]), 0, atol=1e-5)
    assert mesh.uv.max(axis=0).tolist() == [4.0 if shape == "sphere" else 2.0, 3.0]


def test_meshes_are_read_from_files(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    path = tmp_path / "quad.obj"
    path.write_text("v -2 -1 0\nv 2 -1 0\nv 2 1 0\nv -2 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
                    "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n", "ascii")
    mesh: Mesh = load_mesh(path)
    assert mesh.position.min(axis=0).tolist() == [0, -1, -0.5]
    np.testing.assert_allclose(mesh.normal, [[1, 0, 0]] * len(mesh.normal), atol=1e-6)
    np.testing.assert_allclose(mesh.tangent, [[0, 1, 0, -1]] * len(mesh.tangent), atol=1e-6)
    top = mesh.uv[mesh.position[:, 2] > 0]
    assert top[:, 1].tolist() == [0, 0]
    bare = tmp_path / "bare.obj"
    bare.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "ascii")
    reason("no-texture-coordinates", load_mesh, bare)
    reason("unreadable", load_mesh, tmp_path / "none.obj")
    (tmp_path / "noise.glb").write_bytes(b"glTF" + bytes(range(60)))
    reason("bad-mesh", load_mesh, tmp_path / "noise.glb")
    reason("unknown-shape", make_mesh, Surface("teapot"), 4, 4)


def gltf(path: Path, nodes: list[dict[str, Any]], roots: Sequence[int] = (0,), **changed: Any) -> Path:
    """A triangle with texture coordinates and no material, placed by these nodes."""
    numbers = np.array([0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 1], "<f4").tobytes()
    uri = "data:application/octet-stream;base64," + b64encode(numbers).decode()
    document = {
        "asset": {"version": "2.0"}, "buffers": [{"byteLength": len(numbers), "uri": uri}], "nodes": nodes,
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36,
                                                                           "byteLength": 24}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
                      {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC2"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "TEXCOORD_0": 1}}]}],
        "scenes": [{"nodes": list(roots)}], "scene": 0, **changed}
    path.write_text(json.dumps(document), "utf-8")
    return path


def test_gltf_needs_no_material_and_no_scene(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    placed = [{"children": [1, 2]}, {"mesh": 0}, {"mesh": 0, "translation": [2, 0, 0]}]
    assert len(load_mesh(gltf(tmp_path / "two.gltf", placed)).triangles) == 2
    mesh = load_mesh(gltf(tmp_path / "one.gltf", [{"mesh": 0}]))
    assert sorted(mesh.uv.tolist()) == [[0, 0], [0, 1], [1, 0]]
    assert len(load_mesh(gltf(tmp_path / "bare.gltf", placed, scenes=[])).triangles) == 2


@pytest.mark.parametrize(("nodes", "roots", "found"), [
    ([*({"children": [n + 1, n + 1]} for n in range(60)), {"mesh": 0}], (0,), "several places"),
    ([{"children": [1]}, {"children": [0], "mesh": 0}], (0,), "inside itself"),
    ([{"mesh": 0}], (0, 0), "several places"),
    ([*({"children": [n + 1]} for n in range(300)), {"mesh": 0}], (0,), "256 nodes deep"),
    ([{"mesh": 0}] * 30_000, range(30_000), "30000 nodes"),
])
def test_gltf_that_would_keep_busy_is_refused(tmp_path: Path, nodes: list[dict[str, Any]], roots: Sequence[int],
                                              found: str) -> None:
    pytest.importorskip("trimesh")
    with pytest.raises(HmkctaError, match=found):
        load_mesh(gltf(tmp_path / "hostile.gltf", nodes, roots))


def test_gltf_of_too_many_triangles_is_refused_before_it_is_read(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    accessors = [{"componentType": 5126, "count": count, "type": "VEC3"} for count in (3_000_000, 10**15)]
    primitive = {"attributes": {"POSITION": 0, "TEXCOORD_0": 0}}
    with pytest.raises(HmkctaError, match=f"{10**15} elements"):
        load_mesh(gltf(tmp_path / "long.gltf", [{"mesh": 0}], accessors=accessors))
    with pytest.raises(HmkctaError, match="more than 2000000 triangles"):
        load_mesh(gltf(tmp_path / "often.gltf", [{"mesh": 0}] * 9, range(9), accessors=accessors[:1],
                       meshes=[{"primitives": [primitive]}]))


def test_transfer_functions_are_interpolated() -> None:
    table = transfer_table(Look(colours=((0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.5, 0.0)), opacity=((0.5, 0.0), (1.0, 1.0))))
    np.testing.assert_allclose(table[:, 0], np.linspace(0, 1, 256), atol=1e-6)
    assert (table[:128, 3] == 0).all()
    assert table[255].tolist() == [1, 0.5, 0, 1]
    assert "viridis" in str(reason("unknown-colours", transfer_table, Look(colours="jet")))
    reason("transfer-points", transfer_table, Look(opacity=((1.0, 0.0), (0.0, 1.0))))


@pytest.mark.parametrize("curve", ["linear", "reinhard", "filmic"])
def test_tone_curves_rise_and_end_at_white(curve: str) -> None:
    light = np.array([-1, 0, 0.01, 0.2, 0.5, 1, 10, 1e30, np.inf, np.nan], np.float32)
    shown = tone_map(light, 2.0, curve, srgb=True)
    assert shown[0] == shown[1] == shown[-1] == 0
    assert (np.diff(shown[1:9]) >= 0).all()
    assert shown.max() <= 1
    assert shown[8] > 0.99
