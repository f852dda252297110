"""Small models and what NumPy makes of them, for the browser tests of the viewer: `make_viewer_models.py FOLDER`.

`pictures.json` lists scenes with their expected picture (raw RGB bytes beside it); the tests bring the page to the same
scene by its controls.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from hmkcta import Axis, Model, compress, synthetic
from hmkcta.axes import mode_sizes
from hmkcta.render import Camera, Compare, Light, Look, Renderer, Scene, Surface, Tone, Viewpoint
from hmkcta.render.layout import value_range
from random_models import Shapes, random_model

SIZE = 64
RANDOM_SEED = 7
LEVELS = "R=3,3,4,4 / R=1,1,2,2 C=2 K=2"


@dataclass(frozen=True)
class Case:
    """A scene, and for each control of the page the value that brings the page there."""

    name: str
    file: str
    scene: Scene
    controls: dict[str, str] = field(default_factory=dict[str, str])
    drag: tuple[int, int] = (0, 0)  # pixels, of the camera
    mesh: str = ""  # dropped on the page


def main(folder: Path) -> None:
    """Write everything."""
    folder.mkdir(parents=True, exist_ok=True)
    models: dict[str, tuple[Model, Any]] = {name: make() for name, make in MAKERS.items()}
    for name, (model, values) in models.items():
        model.save(folder / f"{name}.hmk", overwrite=True)
        np.save(folder / f"{name}.npy", values)
    patch(folder / "patch.glb")
    entries: list[dict[str, Any]] = []
    for case in CASES:
        model, values = models[case.file]
        scene = replace(case.scene, width=SIZE, height=SIZE)
        if case.mesh:
            scene = replace(scene, surface=Surface(str(folder / case.mesh)))
        picture = Renderer(model, original=values, backend="numpy", kind=scene.kind).picture(scene)
        (folder / f"{case.name}.rgb").write_bytes(picture.tobytes())
        entries.append({"name": case.name, "file": f"{case.file}.hmk", "controls": case.controls, "drag": case.drag,
                        "mesh": case.mesh})
    document = {"size": SIZE, "pictures": entries, "slices": _slices(models["stack"][0]),
                "means": {name: float(models[name][1].mean()) for name in ("photographs", "photograph")},
                "constant": Renderer(models["constant"][0]).picture(Scene(8, 8))[4, 4].tolist()}
    (folder / "pictures.json").write_text(json.dumps(document), encoding="utf-8")


def _compressed(data: synthetic.Dataset, plan: str, organisation: str | None = None) -> tuple[Model, Any]:
    return compress(data.values, plan, axes=data.axes, kind=data.kind, organisation=organisation), data.values


def material() -> tuple[Model, Any]:
    """Colour folded into the light mode."""
    return _compressed(synthetic.material(9, 9, 16), LEVELS, "light+rgb, view, y, x")


def ageing() -> tuple[Model, Any]:
    """A material that changes with time, which is left as it is."""
    data = synthetic.material(9, 9, 16)
    values = np.stack([data.values, data.values[:, ::-1], data.values * 0.3])
    return compress(values, "R=*,3,3,4,4 / R=*,1,1,2,2 C=1,2,2,2,2 K=1,2,2,2,2", kind=data.kind,
                    axes=[Axis("time", 3, "time"), *data.axes], organisation="time, light+rgb, view, y, x"), values


def merged() -> tuple[Model, Any]:
    """Angles and texels merged."""
    return _compressed(synthetic.material(9, 9, 16), "R=6,6 / R=2,2 C=3,2 K=2,1", "light+view+rgb, y+x")


def grids() -> tuple[Model, Any]:
    """Lights and views on grids of zeniths and azimuths, lights in one mode with the colours."""
    data = synthetic.material(9, 9, 16)
    values = data.values.reshape(3, 3, 3, 3, *data.values.shape[2:])
    zenith, azimuth = np.array([10.0, 35.0, 60.0]), np.array([0.0, 120.0, 240.0])
    axes = [Axis(f"{angle}_{role[0]}", 3, role, coords, "degrees") for role in ("light", "view")
            for angle, coords in (("theta", zenith), ("phi", azimuth))]
    return compress(values, "R=9,3,3,8", axes=[*axes, *data.axes[2:]], kind=data.kind,
                    organisation="theta_l+phi_l+rgb, theta_v, phi_v, y+x"), values


def light_field() -> tuple[Model, Any]:
    """Cameras merged, time left as it is."""
    data = synthetic.light_field(views=3, size=24, frames=3)
    return _compressed(data, "R=3,6,6,* / R=2,2,2,* C=2,2,2,1 K=2,2,1,1", "row+column, y, x, time")


def volume() -> tuple[Model, Any]:
    """A volume over time."""
    return _compressed(synthetic.volume(size=12, frames=3), "R=2,5,5,5 / R=2,2,2,2 C=1,2,2,2 K=1,2,2,2")


def deep() -> tuple[Model, Any]:
    """A volume of more elements than are decoded at first in one frame."""
    return _compressed(synthetic.volume(size=16, frames=2), "R=2,5,5,5 / R=2,2,2,2 C=1,2,2,2 K=1,2,2,2")


def cut_volume() -> tuple[Model, Any]:
    """The volume as the search for a goal makes it: cut into blocks, which leave different modes undecomposed."""
    data = synthetic.volume(size=12, frames=3)
    model = compress(data.values, axes=data.axes, kind=data.kind, snr=20)
    cut, blocks = model.stages
    undecomposed = (blocks.shape[:, 1] == 0) & (blocks.shape[:, 2] > 0)
    assert cut.is_cut
    assert blocks.step is not None
    assert len(np.unique(undecomposed, axis=0)) > 1
    return model, data.values


def coded_material() -> tuple[Model, Any]:
    """The material as the search for a goal makes it: one block of whole numbers."""
    data = synthetic.material(9, 9, 16)
    model = compress(data.values, axes=data.axes, kind=data.kind, snr=30, organisation="light+rgb, view, y, x")
    assert all(stage.is_cut or stage.step is not None for stage in model.stages)
    return model, data.values


def random_volume() -> tuple[Model, Any]:
    """Noise of three levels, of which one has float16 numbers, with cut nodes in stages of their own and in others."""
    data = synthetic.volume(size=12, frames=3)
    organisation = (("time",), ("z",), ("y", "x"))
    metadata, stages = random_model(
        np.random.default_rng(RANDOM_SEED), mode_sizes(data.axes, organisation), 5, axes=data.axes,
        organisation=organisation, shapes=Shapes(zero=0.1, leaf=0.2, cut=0.3, own=0.3), coded=0.7, cuts=(1, 4))
    numbered = [stage for stage in stages if not stage.is_cut]
    assert len(numbered) == 3
    assert 0 < sum(stage.step is None for stage in numbered) < 3
    model = Model(replace(metadata, kind="volume"), stages)
    return model, model.reconstruct()


def stack() -> tuple[Model, Any]:
    """Axes of no known role, with negative values, behind a value transform."""
    rng = np.random.default_rng(3)
    x = np.linspace(-2, 2, 12)
    waves = np.sinh(2 * np.sin(x[:, None, None] * 2 + x[None, :10, None]) + x[None, None, :8])
    axes = [Axis("depth", 12), Axis("across", 10), Axis("trial", 8)]
    array = (waves * (1 + 0.1 * rng.random(waves.shape))).astype(np.float32)
    return compress(array, "R=4,4,4 / R=2,2,2 C=2,2,1 K=2,1,1", axes=axes, transform="asinh:0.5"), array


def bare() -> tuple[Model, Any]:
    """A material without directions."""
    data = synthetic.material(5, 5, 8)
    axes = [Axis(axis.name, axis.size, axis.role) for axis in data.axes]
    return compress(data.values, "R=2", axes=axes, kind=data.kind), data.values


def series() -> tuple[Model, Any]:
    """One axis."""
    array = np.sin(np.linspace(0, 9, 40)).astype(np.float32)
    return compress(array, "R=1 C=5 K=1", axes=[Axis("t", 40)]), array


def wide() -> tuple[Model, Any]:
    """Two cameras whose pictures are larger than a texture, with negative values."""
    y, x = np.arange(1600)[:, None] / 300, np.arange(2600) / 400
    array = np.stack([np.sin(x + shift) * np.cos(y) for shift in (0, 0.3)]).astype(np.float32)
    axes = [Axis("camera", 2, "view"), Axis("y", 1600, "space"), Axis("x", 2600, "space")]
    return compress(array, "R=2", axes=axes, kind="lightfield"), array


def constant() -> tuple[Model, Any]:
    """One value everywhere."""
    array = np.full((8, 8), 5, np.float32)
    return compress(array, "R=1", axes=[Axis("a", 8), Axis("b", 8)]), array


def photographs() -> tuple[Model, Any]:
    """Four cameras of 8-bit colours, of which the brightest is far from white."""
    y, x = np.meshgrid(np.linspace(0, 5, 32), np.linspace(0, 4, 32), indexing="ij")
    views = [[95 + 70 * np.sin(x + u) * np.cos(y + v) for v in (0.0, 0.2)] for u in (0.0, 0.2)]
    array = np.stack([np.array(views) * share for share in (1, 0.8, 1.05)], axis=-1).astype(np.uint8)
    axes = [Axis("row", 2, "view"), Axis("column", 2, "view"), *_picture(32)]
    return compress(array, "R=1,1,2,2,1 / R=2,2,6,6,2 C=1,1,2,2,1 K=1", axes=axes, kind="lightfield"), array


def photograph() -> tuple[Model, Any]:
    """One of them, of which nothing is known but the axes."""
    array = photographs()[1][0, 0]
    return compress(array, "R=2,2,1 / R=6,6,2 C=2,2,1 K=1", axes=_picture(32)), array


def painted() -> tuple[Model, Any]:
    """The material as 8-bit photographs, which are sRGB-coded."""
    data = synthetic.material(9, 9, 16)
    light = np.clip(data.values / np.percentile(data.values, 99.5), 0, 1)
    coded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    array = np.rint(255 * coded).astype(np.uint8)
    return compress(array, LEVELS, axes=data.axes, kind=data.kind, organisation="light+rgb, view, y, x"), array


def _picture(size: int) -> list[Axis]:
    return [Axis("y", size, "space"), Axis("x", size, "space"), Axis("rgb", 3, "channel")]


def renamed() -> tuple[Model, Any]:
    """The material as a file whose axes say neither what they are called nor what they are for."""
    model, values = material()
    names = {axis.name: f"axis{n}" for n, axis in enumerate(model.metadata.axes)}
    axes = tuple(Axis(names[axis.name], axis.size) for axis in model.metadata.axes)
    organisation = tuple(tuple(names[name] for name in mode) for mode in model.metadata.organisation)
    return Model(replace(model.metadata, axes=axes, organisation=organisation, kind="generic"), model.levels), values


MAKERS = {"material": material, "ageing": ageing, "merged": merged, "grids": grids,
          "lightfield": light_field, "volume": volume, "deep": deep, "cut": cut_volume,
          "coded": coded_material, "random": random_volume, "stack": stack, "bare": bare,
          "series": series, "renamed": renamed, "wide": wide, "constant": constant, "photographs": photographs,
          "photograph": photograph, "painted": painted}


def patch(path: Path) -> None:
    """A bulging sheet with texture coordinates, as a glTF file."""
    v, u = (a.reshape(-1) for a in np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9), indexing="ij"))
    bulge = 0.5 * np.sin(np.pi * u) * np.sin(np.pi * v)
    corner = (9 * np.arange(8)[:, None] + np.arange(8)).reshape(-1, 1)
    faces = np.concatenate([corner, corner + 1, corner + 9, corner + 1, corner + 10, corner + 9], axis=1).reshape(-1, 3)
    library: Any = import_module("trimesh")  # whose types are incomplete
    looks = library.visual.TextureVisuals(uv=np.stack([u, v], axis=1))
    library.Trimesh(np.stack([u, v, bulge], axis=1), faces, process=False, visual=looks).export(str(path))


def _cases() -> list[Case]:
    low = {"Level": "1"}
    light = Light(azimuth=-20, elevation=60)
    return [
        Case("material", "material", Scene()),
        Case("material-level-1", "material", Scene(level=1), low),
        Case("material-light", "material", Scene(lights=(light,)), {"Azimuth": "-20", "Elevation": "60"}),
        Case("material-turned", "material", Scene(camera=Camera(azimuth=40, elevation=32)), drag=(-50, 30)),
        Case("material-plane", "material", Scene(surface=Surface("plane")), {"Shape": "plane"}),
        Case("material-split", "material", Scene(level=1, compare=Compare("split", 2)),
             {"Show": "split", "With": "2", **low}),
        Case("material-original", "material", Scene(compare=Compare("split", None)), {"Show": "split"}),
        Case("material-mesh", "material", Scene(), mesh="patch.glb"),
        Case("material-time", "ageing", Scene(time=1), {"Frame": "1"}),
        Case("material-coded", "coded", Scene()),
        Case("merged", "merged", Scene()),
        Case("merged-cloth", "merged", Scene(surface=Surface("cloth")), {"Shape": "cloth"}),
        Case("grids", "grids", Scene()),
        Case("grids-plane", "grids", Scene(surface=Surface("plane")), {"Shape": "plane"}),
        Case("lightfield", "lightfield", Scene(viewpoint=Viewpoint(0.5, 1.25)), {"Row": "0.5", "Column": "1.25"}),
        Case("lightfield-focus", "lightfield", Scene(viewpoint=Viewpoint(focus=1.5, aperture=1.0), time=1.5),
             {"Focus": "1.5", "Aperture": "1", "Frame": "1.5"}),
        Case("lightfield-level-1", "lightfield", Scene(level=1), low),
        Case("lightfield-wide", "wide", Scene(viewpoint=Viewpoint(column=0.5, focus=8)),
             {"Column": "0.5", "Focus": "8"}),
        Case("slices-wide", "wide", Scene(kind="generic"), {"Show as": "generic", "camera": "1"}),
        Case("volume", "volume", Scene()),
        Case("volume-cut", "cut", Scene()),
        Case("volume-random", "random", Scene(time=1), {"Frame": "1"}),
        Case("volume-random-level-1", "random", Scene(level=1), low),
        Case("volume-turned", "volume", Scene(camera=Camera(azimuth=50, elevation=33), time=2),
             {"Frame": "2"}, (-50, 20)),
        Case("volume-iso", "volume", Scene(volume=Look("iso", "viridis", iso=0.4), level=1),
             {"Mode": "iso", "Colours": "viridis", "Iso value": "0.4", **low}),
        Case("volume-clip", "volume", Scene(volume=Look("emission", clip_high=(1.0, 0.6, 1.0))),
             {"Mode": "emission", "y to": "0.6"}),
        Case("volume-error", "volume", Scene(level=1, compare=Compare("heat", 2, gain=8.0)),
             {"Show": "heat", "With": "2", "Amplify": "3", **low}),
    ]


def _pictures_of_bytes() -> list[Case]:
    low = {"Level": "1"}
    return [
        Case("painted", "painted", Scene()),
        Case("painted-as-light", "painted", Scene(surface=Surface(coded=False)), {"Values are sRGB-coded": "false"}),
        Case("photographs", "photographs", Scene()),
        Case("photographs-white", "photographs", Scene(tone=Tone(white=120)), {"White, as a number": "120"}),
        Case("photographs-error", "photographs", Scene(level=1, compare=Compare("heat", 2, gain=64.0)),
             {"Show": "heat", "With": "2", "Amplify": "6", **low}),
        Case("photograph", "photograph", Scene(kind="generic")),
        Case("photograph-error", "photograph", Scene(kind="generic", level=1, compare=Compare("heat", 2, gain=16.0)),
             {"Show": "heat", "With": "2", "Amplify": "4", **low}),
    ]


CASES = _cases() + _pictures_of_bytes()


def _slices(model: Model) -> dict[str, Any]:
    """Values of the first picture that the page shows of the stack, by level, and those that show black and white."""
    pictures = {str(level): model.at_level(level)[:, :, 4].reshape(-1).tolist() for level in (1, 2)}
    return {"rows": 12, "columns": 10, "window": value_range(model, model.shape), "levels": pictures}


if __name__ == "__main__":
    main(Path(sys.argv[1]))
