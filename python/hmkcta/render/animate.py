"""Scenes of a film: an orbit of the camera, a sweep of the light, a walk among the cameras, time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import cos, pi, sin

from ..axes import Axis
from ..errors import invalid
from .layout import Layout, axes_without_place
from .lightfield import find_cameras
from .numpy_path import placed_camera
from .scene import Light, Scene

MOTIONS = ("orbit", "light", "view", "time")
SWING = 40.0  # degrees to each side: an orbit about a plane, which is seen from the front only


def default_motion(kind: str, axes: Sequence[Axis], layout: Layout) -> str:
    """What moves where nobody says it: time of a volume and of slices, the view of a light field, else the camera.

    Raises:
        HmkctaError: they are slices of what has no time.
    """
    timed = _has_time(kind, axes, layout) and layout.sizes[layout.time or 0] > 1
    if kind == "generic" and not timed:
        raise invalid("motion-kind", "film", "slices, in which nothing moves", "a picture, or a film of time",
                      "give a name that ends with .png, or an axis the role time when compressing, --axes NAME:ROLE,..")
    if kind == "lightfield":
        return "view"
    return "time" if kind in ("volume", "generic") and timed else "orbit"


def moving(scene: Scene, motion: str, count: int, kind: str, axes: Sequence[Axis], layout: Layout) -> Iterator[Scene]:
    """The `count` scenes of a film; all but time come round to where they began.

    >>> from hmkcta.axes import name_axes
    >>> from hmkcta.render.layout import lay_out
    >>> axes = name_axes((3, 4, 4, 4), ["time", "z", "y", "x"])
    >>> [frame.time for frame in moving(Scene(), "time", 3, "volume", axes, lay_out(axes, "volume"))]
    [0.0, 1.0, 2.0]

    Raises:
        HmkctaError: the motion is unknown or does not suit the kind; there is no frame.
    """
    fitting = {"orbit": ("svbrdf", "volume"), "light": ("svbrdf", "volume"), "view": ("lightfield",)}
    if motion not in MOTIONS:
        raise invalid("unknown-motion", "animate", repr(motion), ", ".join(MOTIONS))
    timed = _has_time(kind, axes, layout)
    if kind not in fitting.get(motion, (kind,)) or (motion == "time" and not timed):
        suiting = [m for m in MOTIONS if kind in fitting.get(m, ()) or (m == "time" and timed)]
        hint = "" if suiting else "give roles when compressing, --axes NAME:ROLE,.., for a kind that moves"
        raise invalid("motion-kind", "animate", motion, f"{', '.join(suiting) or 'nothing'} for this {kind}", hint)
    if count < 1:
        raise invalid("no-frames", "frames", count, "1 or more")
    for number in range(count):
        share = number / count
        if motion == "orbit":
            yield _orbit(scene, share, kind)
        elif motion == "light":
            light = scene.lights[0] if scene.lights else Light()
            turned = replace(light, position=None, azimuth=light.azimuth + 360 * share)
            yield replace(scene, lights=(turned, *scene.lights[1:]))
        elif motion == "view":
            yield _walk(scene, share, axes, layout)
        else:
            last = layout.sizes[layout.time or 0] - 1
            yield _at_time(scene, last * number / max(count - 1, 1), kind, layout)


def _has_time(kind: str, axes: Sequence[Axis], layout: Layout) -> bool:
    """Whether there are frames one after another: slices may show all of time as a picture."""
    return layout.time is not None and not (kind == "generic" and layout.time in axes_without_place(axes, kind))


def _at_time(scene: Scene, time: float, kind: str, layout: Layout) -> Scene:
    """Slices stand at a frame as on any other axis, at the nearest one."""
    if kind != "generic":
        return replace(scene, time=time)
    return replace(scene, position={**scene.position, layout.names[layout.time or 0]: round(time)})


def _orbit(scene: Scene, share: float, kind: str) -> Scene:
    camera = placed_camera(scene, kind)
    start = camera.azimuth or 0.0
    flat = kind == "svbrdf" and scene.surface.shape == "plane"
    azimuth = start + SWING * sin(2 * pi * share) if flat else start + 360 * share
    return replace(scene, camera=replace(camera, azimuth=azimuth))


def _walk(scene: Scene, share: float, axes: Sequence[Axis], layout: Layout) -> Scene:
    """Once around an ellipse among the cameras."""
    last = find_cameras(axes, layout).place.max(axis=0)
    row, column = (float(most / 2 * (1 + 0.8 * wave(2 * pi * share)))
                   for most, wave in zip(last, (sin, cos), strict=True))
    return replace(scene, viewpoint=replace(scene.viewpoint, row=row, column=column))
