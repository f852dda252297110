"""Pictures of integer sources: white is their type's, and sRGB-coded values are shown as they are."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hmkcta import Axis, Model, compress
from hmkcta.axes import name_axes
from hmkcta.render import Camera, Light, Renderer, Scene, Surface, Tone, render
from hmkcta.render.display import Display
from hmkcta.render.scene import Look


def photograph(dtype: Any, shape: tuple[int, ...] = (24, 32, 3), peak: float = 0.72) -> Any:
    """A smooth picture, none of whose numbers comes near its type's largest."""
    y, x = np.mgrid[0:1:shape[-3] * 1j, 0:1:shape[-2] * 1j]
    one = np.stack([0.2 + 0.5 * x, 0.3 + 0.4 * y, 0.25 + 0.2 * x * y], axis=-1)[..., : shape[-1]]
    most = 1 if np.dtype(dtype) == bool else np.iinfo(dtype).max
    return np.broadcast_to(np.rint(peak * most * one), shape).astype(dtype)


def shown(model: Model, **changes: Any) -> Any:
    """The model's picture, texel for pixel, by the readable renderer."""
    rows, columns = (model.shape[[axis.name for axis in model.metadata.axes].index(name)] for name in "yx")
    return render(model, Scene(width=columns, height=rows, **changes), backend="numpy")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(("axes", "shape", "kind"), [
    ("y,x,rgb", (24, 32, 3), "generic"), ("view,y,x,rgb", (4, 24, 32, 3), "lightfield"), ("y,x,rgb", (24, 32, 1), "generic")])
def test_a_picture_has_the_mean_of_its_source(dtype: Any, axes: str, shape: tuple[int, ...], kind: str) -> None:
    source = photograph(dtype, shape)
    model = compress(source, axes=axes, kind=kind, snr=50)
    picture = shown(model)
    mean = float(source.mean()) / np.iinfo(dtype).max * 255
    assert picture.mean() == pytest.approx(mean, rel=0.01)


def test_black_and_white_keep_their_numbers() -> None:
    source = (np.add.outer(np.arange(16), np.arange(20)) // 4 % 3) == 0
    picture = shown(compress(source, axes="y,x", snr=60))
    assert np.array_equal(picture[..., 0] > 127, source)


def test_what_is_said_goes_before_the_type() -> None:
    source = photograph(np.uint8)
    model = compress(source, axes="y,x,rgb", snr=50)
    doubled = shown(model, tone=Tone(white=127.5)).mean()
    assert doubled == pytest.approx(2 * shown(model).mean(), rel=0.02)
    assert shown(model, volume=Look(window=(0.0, 127.5))).mean() == pytest.approx(doubled, rel=0.01)


def display(values: Any, axes: str, kind: str = "generic") -> Display:
    model = compress(values, axes=axes, kind=kind, snr=40)
    return Renderer(model, backend="numpy").display(Scene())


def test_measurements_are_exposed_by_their_values() -> None:
    """Floats, wide and signed integers, and volumes in slices: 4095 of 65535 would be black."""
    ramp = np.arange(8 * 9 * 10).reshape(8, 9, 10)
    for values in (ramp.astype(np.uint16), ramp.astype(np.uint8)):
        assert display(values, "z,y,x").exposure > 1 / 800
    for dtype in (np.int16, np.int32, np.float32):
        assert display(ramp[0].astype(dtype), "y,x").exposure > 1 / 100
    assert display(ramp[0].astype(np.uint16), "y,x").exposure == pytest.approx(1 / 65535)


def material(dtype: Any) -> tuple[Any, Model]:
    """A plane under lights of four directions, as photographs of it are."""
    source = photograph(dtype, (4, 24, 32, 3))
    lights = np.array([[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8], [-0.6, 0, 0.8]])
    axes = (Axis("light", 4, "light", lights, "unit vector"), *name_axes((24, 32, 3), ["y", "x", "rgb"]))
    return source, compress(source, axes=axes, kind="svbrdf", snr=55)


#: So near that the plane fills the picture.
NEAR = {"surface": Surface("plane"), "camera": Camera(distance=1.5), "lights": (Light(0, 0),)}


def test_a_material_of_photographs_is_shown_as_they_are() -> None:
    """Values of 8 bits are sRGB-coded: they are decoded, lit, and coded again; those of 16 are light."""
    source, model = material(np.uint8)
    picture = render(model, Scene(32, 24, **NEAR), backend="numpy")
    whole = np.asarray(render(model, Scene(64, 48, **NEAR), backend="numpy"), np.float64)
    assert picture.shape == (24, 32, 3)
    middle = source[0, 8:16, 10:22].mean()
    assert whole[16:32, 20:44].mean() == pytest.approx(middle, rel=0.03)
    deep, light = material(np.uint16)
    linear = render(light, Scene(64, 48, **NEAR), backend="numpy")[16:32, 20:44]
    share = deep[0, 8:16, 10:22] / 65535
    assert linear.mean() == pytest.approx(255 * (1.055 * share ** (1 / 2.4) - 0.055).mean(), rel=0.03)


def test_lights_of_coded_values_add_up_as_light() -> None:
    _, model = material(np.uint8)
    lit = Renderer(model, backend="numpy")
    one = lit.radiance(Scene(16, 12, **NEAR))
    two = lit.radiance(Scene(16, 12, **{**NEAR, "lights": (Light(0, 0), Light(0, 0))}))
    assert np.allclose(two[..., :3], 2 * one[..., :3])
    as_stored = lit.radiance(Scene(16, 12, **{**NEAR, "surface": Surface("plane", coded=False)}))
    share = as_stored[..., :3] / 255
    assert np.allclose(one[..., :3], 255 * ((share + 0.055) / 1.055) ** 2.4, rtol=1e-4)
