"""The shaders against the readable renderers: the same pictures, whatever the kind, the organisation and the level."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hmkcta
from gpu_tools import adapter
from hmkcta import Axis, Model, synthetic
from hmkcta.axes import mode_sizes, name_axes
from hmkcta.errors import HmkctaError
from hmkcta.render import Camera, Compare, Light, Look, Renderer, Scene, Surface, Tone, Viewpoint, render
from hmkcta.render.gbuffer import camera_rays, trace
from hmkcta.render.gpu_pass import read_texture
from hmkcta.render.gpu_path import GpuPath
from hmkcta.render.gpu_svbrdf import GpuSvbrdf
from hmkcta.render.layout import lay_out
from hmkcta.render.mesh import make_mesh
from hmkcta.render.numpy_path import placed_camera
from hmkcta.render.prelude import shader
from hmkcta.render.software import MOST_TURNS, loop_turns
from hmkcta.render.workload import configuration, random_model
from random_models import Shapes
from random_models import random_model as random_blocks

#: Two levels of clusters, and few enough that software finishes them (`hmkcta.render.software`).
PLAN = "R=2 / R=2,1,2,2 C=2,2,2,2 K=1 / R=1 C=2,1,2,2 K=1"
SMALL = Scene(width=48, height=40)
CLOSE = 2  # of 255


@pytest.fixture(scope="module")
def material() -> synthetic.Dataset:
    return synthetic.material(lights=14, views=11, size=16)


def compressed(data: synthetic.Dataset, organisation: str, plan: str = PLAN, **settings: Any) -> Model:
    return hmkcta.compress(data.values, plan, axes=data.axes, organisation=organisation, kind=data.kind,
                           quality="fast", **settings)


def same(model: Model, scene: Scene, original: Any = None, position: dict[str, int] | None = None) -> NDArray[Any]:
    """The picture by the shaders, which must be NumPy's."""
    adapter()
    pictures: list[NDArray[Any]] = []
    for backend in ("gpu", "numpy"):
        renderer = Renderer(model, original=original, backend=backend, position=position)
        pictures.append(renderer.picture(scene).astype(int))
        assert renderer.backend == backend
    assert pictures[1].std() > 5, "something must be seen"
    worst = np.abs(pictures[0] - pictures[1])
    assert worst.max() <= CLOSE, f"{worst.max()} at {np.unravel_index(worst.argmax(), worst.shape)}"
    return pictures[0]


@pytest.mark.parametrize("organisation", [
    "light+rgb, view, y, x", "light+rgb, view, y+x", "light+view, y, x+rgb", "light, view, y, x, rgb",
    "light+rgb, view+y, x",
])
def test_svbrdfs_of_every_organisation(material: synthetic.Dataset, organisation: str) -> None:
    modes = organisation.count(",") + 1
    two = ",".join(["2"] * modes)
    plan = f"R=2 / R=1 C={two} K=1"
    same(compressed(material, organisation, plan), SMALL)


def test_a_material_of_8_bits_is_decoded_to_light(material: synthetic.Dataset) -> None:
    coded = np.rint(255 * (material.values / material.values.max()) ** (1 / 2.4)).astype(np.uint8)
    two = (Light(), Light(200, 70, colour=(0.2, 0.5, 1.0)))
    same(compressed(replace(material, values=coded), "light+rgb, view, y, x"), replace(SMALL, lights=two))


def blocks(shape: tuple[int, ...], roles: list[str], organisation: str, seed: int) -> Model:
    """A random model of blocks with ranks and undecomposed modes of their own."""
    axes = name_axes(shape, roles)
    modes = tuple(tuple(mode.split("+")) for mode in organisation.split(", "))
    metadata, stages = random_blocks(np.random.default_rng(seed), mode_sizes(axes, modes), 2, axes=axes,
                                     organisation=modes, shapes=Shapes(2, 1, 2, 16, 0, own=0.3), cuts=(1,))
    return Model(metadata, stages)


@pytest.mark.parametrize("organisation", ["light+rgb, view, y, x", "light, view, y+x, rgb"])
def test_svbrdfs_of_blocks(organisation: str) -> None:
    data = synthetic.material(lights=9, views=6, size=12)
    model = blocks(data.values.shape, [axis.name for axis in data.axes], organisation, 5)
    model = Model(replace(model.metadata, axes=data.axes, kind="svbrdf"), model.stages)
    same(model, SMALL)


def test_volumes_and_light_fields_of_blocks() -> None:
    model = blocks((10, 12, 14, 3), ["z", "y", "x", "time"], "z, y+x, time", 6)
    same(Model(replace(model.metadata, kind="volume"), model.stages), replace(SMALL, time=0.5))
    model = blocks((3, 3, 20, 24), ["row", "column", "y", "x"], "row+column, y, x", 7)
    same(Model(replace(model.metadata, kind="lightfield"), model.stages), SMALL)


@pytest.mark.parametrize("level", [1, 2, 3])
def test_svbrdfs_of_every_level(material: synthetic.Dataset, level: int) -> None:
    same(compressed(material, "light+rgb, view, y, x"), replace(SMALL, level=level))


@pytest.mark.parametrize("scene", [
    Scene(surface=Surface("plane", (2.0, 1.0)), lights=(Light(position=(1.0, 0.5, 0.6), intensity=2.0),)),
    Scene(surface=Surface("cloth", (2.0, 2.0), y_axis="up"), lights=(Light(), Light(200, 70, colour=(0.2, 0.5, 1.0)))),
    Scene(surface=Surface(cosine=False), camera=Camera(200, -35, 2.2, 70.0), tone=Tone(1.0, curve="filmic")),
    Scene(tone=Tone(-0.5, 0.2, "reinhard", srgb=False, background=(0.5, 0.0, 0.2))),
], ids=["plane", "cloth", "below", "tone"])
def test_svbrdfs_on_every_surface(material: synthetic.Dataset, scene: Scene) -> None:
    same(compressed(material, "light+rgb, view, y, x", "R=3,3,4,4 / R=1 C=2,2,2,2 K=1"),
         replace(scene, width=48, height=40))


FIXED = Scene(48, 40, surface=Surface("plane", (2.0, 1.0)), lights=(
    Light(30, 50), Light(-40, 20, colour=(0.3, 0.5, 1.0)), Light(200, 40)))


@pytest.mark.parametrize(("organisation", "plan", "general", "fixed"), [
    ("light+rgb, view, y, x", PLAN, (), (0,)), ("light+rgb, view, y+x", "R=16,6,8", (), (0,)),
    ("light, view+rgb, y+x", "R=9,8,6", (), (0,)), ("light, view+rgb, y+x", "R=*,8,6", (), (0,)),
    ("light, view, y, x, rgb", "R=8,4,4,4,3", (), (0, 4)), ("light+view, y+x, rgb", "R=9,8,*", (), ()),
    ("light+view+rgb, y+x", "R=8,6", (), ()), ("light+rgb, view, y, x", "R=3,4,5,5 / R=1 C=3,2,2,2 K=2", (), (0,)),
    ("light+view, y+x, rgb", "R=9,8,* / R=2,2,* C=3,3,1 K=1", (2,), (2,)),
    ("light+rgb, view, y, x", "R=2,2,3,3 C=3,2,2,2 K=1", (), ()),
])
def test_distant_lights_on_a_plane_are_contracted(material: synthetic.Dataset, organisation: str, plan: str,
                                                  general: tuple[int, ...], fixed: tuple[int, ...]) -> None:
    """Where it pays; and nothing changes, whether it does or not, for any number of lights and on either side."""
    model = compressed(material, organisation, plan)
    made = GpuSvbrdf(adapter(), model, lay_out(model.metadata.axes, "svbrdf"))
    assert made.contracted(fixed=False) == general
    assert made.contracted(fixed=True) == fixed
    gpu, numpy = (Renderer(model, backend=backend) for backend in ("gpu", "numpy"))
    for scene in (FIXED, replace(FIXED, lights=FIXED.lights[:1], camera=Camera(160, 10)), SMALL,
                  replace(FIXED, lights=(*FIXED.lights, Light(position=(1.0, 1.0, 1.0))))):
        expected = numpy.radiance(scene)
        assert expected.max() > 0
        assert np.abs(gpu.radiance(scene) - expected).max() <= 1e-5 * expected.max()


def angular(data: synthetic.Dataset, unit: str = "degrees") -> synthetic.Dataset:
    """A material measured on grids of angles, as a function of directions that no grid shows."""
    scale = 1.0 if unit == "degrees" else np.pi / 180
    theta, phi = np.array([0.0, 25, 50, 75]), np.arange(0, 360, 60.0)
    axes = (Axis("theta_i", 4, "light", theta * scale, unit), Axis("phi_i", 6, "light", phi * scale, unit),
            Axis("phi_v", 6, "view", phi[::-1] * scale, unit), Axis("theta_v", 4, "view", theta * scale, unit))
    light = np.cos(np.radians(theta))[:, None] * (1.5 + np.cos(np.radians(phi)))
    view = (2 + np.sin(np.radians(phi[::-1])))[:, None] * np.cos(np.radians(theta)) ** 0.5
    values = light[:, :, None, None, None, None, None] * view[:, :, None, None, None] * data.values[3, 2]
    return synthetic.Dataset(values.astype(np.float32), (*axes, *data.axes[2:]), "svbrdf")


@pytest.mark.parametrize("organisation", [
    "theta_i, phi_i, phi_v, theta_v, y, x, rgb", "theta_i+phi_i+rgb, phi_v+theta_v, y+x",
    "phi_i, theta_i+rgb, theta_v+phi_v, y, x",
])
def test_directions_on_grids_of_angles(material: synthetic.Dataset, organisation: str) -> None:
    model = compressed(angular(material), organisation, "R=3")
    for scene in (SMALL, FIXED):
        same(model, scene)


def test_svbrdfs_with_transform_and_without_some_axes(material: synthetic.Dataset) -> None:
    plan = "R=3 / R=1 C=2 K=1"
    same(compressed(material, "light+rgb, view, y, x", "R=3", transform="log1p:0.1"), SMALL)
    fixed = synthetic.Dataset(np.ascontiguousarray(material.values[:, 3, ..., 1]),
                              (material.axes[0], *material.axes[2:4]), "svbrdf")
    same(compressed(fixed, "light, y, x", plan), SMALL)
    grey = synthetic.Dataset(np.ascontiguousarray(material.values[..., :2]),
                             (*material.axes[:4], Axis("pol", 2, "channel")), "svbrdf")
    polarised = compressed(grey, "light+pol, view, y, x", plan)
    assert (same(polarised, SMALL) != same(polarised, SMALL, position={"pol": 1})).any()


@pytest.mark.parametrize("plan", ["R=*,3,3,4,4 / R=*,2,2,2,2 C=1,2,2,2,2 K=1", "R=2,3,3,4,4 / R=1,1,2,2,2 C=2 K=1"])
def test_svbrdfs_that_change_with_time(material: synthetic.Dataset, plan: str) -> None:
    """The mode of time stands still in a frame, and is contracted."""
    values = np.stack([material.values, material.values[:, ::-1], 1 - material.values])
    data = synthetic.Dataset(values, (Axis("time", 3, "time"), *material.axes), "svbrdf")
    model = compressed(data, "time, light+rgb, view, y, x", plan)
    first = same(model, replace(SMALL, time=0.0))
    assert (first != same(model, replace(SMALL, time=2.0))).any()


def test_texels_are_not_interpolated_where_a_mode_holds_too_much(material: synthetic.Dataset) -> None:
    """Light, view and rows in one mode are 3 x 3 x 2 rows and 3 colours: more than the shader has room for."""
    adapter()
    model = compressed(material, "light+view+y+rgb, x", "R=4")
    picture = render(model, SMALL, backend="gpu").astype(int)
    smooth = render(model, SMALL, backend="numpy").astype(int)
    assert np.abs(picture - smooth).mean() < 12


def test_comparisons(material: synthetic.Dataset) -> None:
    model = compressed(material, "light+rgb, view, y, x")
    same(model, replace(SMALL, level=1, compare=Compare("split", level=3, position=0.4)))
    same(model, replace(SMALL, compare=Compare("heat", gain=4.0)), original=material.values)
    same(model, replace(SMALL, compare=Compare("split")), original=material.values)


@pytest.mark.parametrize(("organisation", "plan"), [
    ("row+column, y, x, time", "R=3,5,5,* / R=2,3,3,* C=2,2,2,1 K=1"),
    ("row+y, column+x, time", "R=6,6,2 / R=3,3,1 C=2 K=1"),
    ("row, column, y, x, time", "R=2,2,6,6,3"),
])
def test_light_fields(organisation: str, plan: str) -> None:
    model = compressed(synthetic.light_field(4, 24, 3), organisation, plan)
    same(model, SMALL)
    view = Viewpoint(row=0.3, column=2.6, focus=0.7)
    same(model, replace(SMALL, time=1.4, viewpoint=view))
    same(model, replace(SMALL, level=1, viewpoint=replace(view, aperture=1.2, zoom=1.5)))


def test_light_fields_in_colour_with_cameras_in_one_axis() -> None:
    grey = synthetic.light_field(3, 20, 1).values[..., 0].reshape(9, 20, 20)
    values = np.stack([grey, grey**2, 1 - grey], axis=-1)
    places = np.stack(np.divmod(np.arange(9), 3), axis=1).astype(np.float64)
    axes = (Axis("view", 9, "view", places), Axis("y", 20, "space"), Axis("x", 20, "space"), Axis("rgb", 3, "channel"))
    same(compressed(synthetic.Dataset(values, axes, "lightfield"), "view, y, x+rgb", "R=4,8,8"),
         replace(SMALL, viewpoint=Viewpoint(1.2, 0.4)))


def test_one_band_of_many(material: synthetic.Dataset) -> None:
    bands = [each for n in range(2) for each in (material.values[..., n], material.values[..., n] ** 2)]
    cloth = synthetic.Dataset(np.stack(bands, axis=-1), (*material.axes[:4], Axis("band", 4, "channel")), "svbrdf")
    grid = np.stack([synthetic.light_field(3, 20, 1).values[..., 0] ** n for n in range(1, 5)], axis=-1)
    field = synthetic.Dataset(grid, name_axes(grid.shape, ["row", "column", "y", "x", "band"]), "lightfield")
    for model in (compressed(cloth, "light, view, y, x+band", "R=4,3,6,8"),
                  compressed(field, "row, column, y, x+band", "R=2,2,8,9")):
        assert (same(model, SMALL, position={"band": 3}) != same(model, SMALL)).any()


@pytest.mark.parametrize("look", [
    Look(), Look("emission", "ice", clip_high=(0.8, 0.6, 1.0)), Look("maximum", "viridis", step=1.0),
    Look("iso", "coolwarm", iso=0.4, ambient=0.2, window=(0.0, 0.8)),
], ids=["shaded", "emission", "maximum", "iso"])
def test_volumes(look: Look) -> None:
    data = synthetic.volume((12, 16, 20), frames=4)
    model = compressed(data, "time, z, y, x", "R=*,4,5,6 / R=*,2,2,2 C=1,2,2,2 K=1")
    same(model, replace(SMALL, volume=look))
    same(model, replace(SMALL, volume=look, time=2.3, level=1, camera=Camera(-70, 50, 2.8)))


def test_volumes_stand_where_other_axes_say() -> None:
    data = synthetic.volume((8, 8, 8), frames=3)
    axes = (Axis("gas", 3, "other"), *data.axes[1:])
    model = compressed(synthetic.Dataset(data.values, axes, "volume"), "gas, z, y, x", "R=3,4,4,4")
    first = same(model, SMALL, position={"gas": 0})
    assert (first != same(model, SMALL, position={"gas": 2})).any()


@pytest.mark.parametrize("names", [["x", "y", "z", "t"], ["y", "t", "x", "z"]])
def test_volumes_whose_axes_are_in_another_order(names: list[str]) -> None:
    data = synthetic.volume((8, 10, 12), frames=3)
    order = [["t", "z", "y", "x"].index(name) for name in names]
    axes = name_axes([data.values.shape[n] for n in order], names)
    turned = synthetic.Dataset(np.ascontiguousarray(data.values.transpose(order)), axes, "volume")
    same(compressed(turned, ", ".join(names), "R=3"), replace(SMALL, time=1.5))


def test_software_that_would_not_finish_is_refused() -> None:
    device = adapter()
    model = random_model(replace(configuration("WH4"), sizes=(20, 16, 40, 36)))
    turns = loop_turns(model, (3, 3, 2, 2, 3), 3)
    assert turns < MOST_TURNS, "one light is finished"
    many = replace(SMALL, lights=tuple(Light(45 * n, 40) for n in range(8)))
    assert 8 * turns > MOST_TURNS
    if not device.software:
        same(model, many)
        return
    with pytest.raises(HmkctaError, match="software-loops"):
        Renderer(model, backend="gpu").picture(many)


def test_an_adapter_in_software_is_taken_if_it_is_asked_for(material: synthetic.Dataset) -> None:
    """NumPy outruns it, by three to nine times."""
    software = adapter().software
    model = compressed(material, "light+rgb, view, y, x", "R=3,3,4,4")
    assert Renderer(model, backend="gpu").adapter
    assert Renderer(model).backend == ("numpy" if software else "gpu")


def test_software_finishes_the_papers_models() -> None:
    """Table 1's and 2's configurations, at a size that tests have the time for."""
    device = adapter()
    for name in ("WM1", "WM2", "WH2", "WH4", "Dove", "Season Greetings"):
        small = replace(configuration(name), sizes=(20, 16, 40, 36))
        path = GpuPath(device, random_model(small), lay_out(random_model(small).metadata.axes, "svbrdf"), "svbrdf")
        assert path.refusal(SMALL, 1) is None
        assert path.refusal(SMALL, len(random_model(small).levels)) is None, name
    model = random_model(replace(configuration("WH4"), sizes=(20, 16, 40, 36)))
    same(model, SMALL)


@pytest.mark.parametrize("shape", ["sphere", "plane", "cloth"])
def test_the_rasteriser_sees_what_rays_see(shape: str) -> None:
    """`gbuffer.wgsl`, drawn, against the G-buffer of NumPy."""
    device = adapter()
    width, height = 96, 80
    scene = Scene(width=width, height=height, surface=Surface(shape))
    rays = camera_rays(placed_camera(scene, "svbrdf"), width / height)
    mesh = make_mesh(scene.surface, 8, 8)
    traced = trace(mesh, rays, width, height)
    drawn = rasterise(device, mesh, rays, width, height)
    both = (traced.surface[..., 3] > 0) & (drawn[0][..., 3] > 0)
    assert both.mean() > 0.1
    assert ((traced.surface[..., 3] > 0) ^ (drawn[0][..., 3] > 0)).mean() < 0.01
    for found, expected, near in zip(drawn, (traced.surface, traced.normal, traced.tangent), (0.01, 0.02, 0.02),
                                     strict=True):
        close = (np.abs(found - expected)[both] < near).all(axis=1)
        assert close.mean() > 0.99


def rasterise(device: Any, mesh: Any, rays: Any, width: int, height: int) -> list[NDArray[np.float32]]:
    """Draw a mesh with `gbuffer.wgsl`: its three targets, as a viewer would."""
    gpu = device.gpu
    module = gpu.create_shader_module(code=shader("gbuffer"))
    formats = ("rgba32float", "rgba16float", "rgba16float")
    places = ((0, 0, "float32x3"), (1, 12, "float32x3"), (2, 24, "float32x4"), (3, 40, "float32x2"))
    attributes = [{"shader_location": n, "offset": offset, "format": form} for n, offset, form in places]
    pipeline = gpu.create_render_pipeline(
        layout="auto", primitive={"topology": "triangle-list", "cull_mode": "none"},
        vertex={"module": module, "entry_point": "surface_vertex",
                "buffers": [{"array_stride": 48, "step_mode": "vertex", "attributes": attributes}]},
        depth_stencil={"format": "depth32float", "depth_write_enabled": True, "depth_compare": "less"},
        fragment={"module": module, "entry_point": "surface_fragment", "targets": [{"format": f} for f in formats]})
    targets = [gpu.create_texture(size=(width, height, 1), format=f, usage="RENDER_ATTACHMENT|COPY_SRC")
               for f in formats]
    depth = gpu.create_texture(size=(width, height, 1), format="depth32float", usage="RENDER_ATTACHMENT")
    uniform = np.concatenate([clip_from_world(rays).T.reshape(-1), rays.eye, [0]]).astype(np.float32)
    group = gpu.create_bind_group(layout=pipeline.get_bind_group_layout(0), entries=[
        {"binding": 0, "resource": {"buffer": device.buffer("surface", uniform, "UNIFORM"), "offset": 0, "size": 80}}])
    encoder = gpu.create_command_encoder()
    work = encoder.begin_render_pass(
        color_attachments=[{"view": t.create_view(), "load_op": "clear", "store_op": "store"} for t in targets],
        depth_stencil_attachment={"view": depth.create_view(), "depth_clear_value": 1.0, "depth_load_op": "clear",
                                  "depth_store_op": "store"})
    work.set_pipeline(pipeline)
    work.set_bind_group(0, group)
    work.set_vertex_buffer(0, device.buffer("vertices", mesh.vertices(), "VERTEX"))
    work.set_index_buffer(device.buffer("triangles", mesh.triangles, "INDEX"), "uint32")
    work.draw_indexed(mesh.triangles.size)
    work.end()
    gpu.queue.submit([encoder.finish()])
    kinds = ("f4", "f2", "f2")
    return [read_texture(device, t, kind, 4).astype(np.float32) for t, kind in zip(targets, kinds, strict=True)]


def clip_from_world(rays: Any, near: float = 0.1, far: float = 20.0) -> NDArray[np.float64]:
    """The projection of a camera's rays, depth 0 to 1."""
    rows = [axis / (axis @ axis) for axis in (rays.right, rays.up)]
    view = np.stack([*rows, rays.forward])
    world = np.zeros((4, 4))
    world[:3, :3], world[:3, 3], world[3, 3] = view, -view @ rays.eye, 1
    clip = np.zeros((4, 4))
    clip[0, 0] = clip[1, 1] = clip[3, 2] = 1
    clip[2, 2], clip[2, 3] = far / (far - near), -far * near / (far - near)
    return clip @ world
