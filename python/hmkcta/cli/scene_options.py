"""Options of `hmkcta render` that say what a picture shows; each fills a field of the scene's JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from typing import Any

import click

from ..axes import Axis
from .options import Count, Function, Shape, together
from .param_type import ParamType


class Numbers(ParamType[tuple[float, ...]]):
    """Numbers parted by commas, as many as `names` says.

    >>> Numbers("AZ,EL").convert("60,45", None, None)
    (60.0, 45.0)
    """

    def __init__(self, names: str) -> None:
        self.name = names

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Read it, or end with what is wrong."""
        wanted = self.name.count(",") + 1
        try:
            numbers = tuple(float(word) for word in str(value).split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != wanted:
            self.fail(f"{value!r}: write {wanted} numbers as {self.name}.", param, ctx)
        return numbers


class Place(ParamType[tuple[str, int]]):
    """An axis and an index, ``NAME=INDEX``.

    >>> Place().convert("time=3", None, None)
    ('time', 3)
    """

    name = "axis=index"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, int]:
        """Read it, or end with what is wrong."""
        name, _, index = str(value).partition("=")
        if not name or not index.isdecimal():
            self.fail(f"{value!r}: write AXIS=INDEX, e.g. time=3.", param, ctx)
        return name, int(index)


def _choice(*words: str) -> Any:
    return {"type": click.Choice(words), "metavar": "|".join(words)}


#: Option, the field of the scene's JSON it fills, and what click is told.
_OPTIONS: tuple[tuple[str, str, Mapping[str, Any]], ...] = (
    ("--kind", "kind", {**_choice("svbrdf", "lightfield", "volume", "generic"),
                        "help": "What to show it as, instead of what FILE says."}),
    ("--level", "level", {"type": Count(1), "metavar": "N", "help": "Levels 1 to N only."}),
    ("--time", "time", {"type": float, "metavar": "T", "help": "Frame, from 0; may lie between two."}),
    ("--azimuth", "camera.azimuth", {"type": float, "metavar": "DEG", "help": "Camera: from x towards y."}),
    ("--elevation", "camera.elevation", {"type": float, "metavar": "DEG", "help": "Camera: up from the xy plane."}),
    ("--distance", "camera.distance", {"type": float, "metavar": "D", "help": "Camera: from the middle."}),
    ("--fov", "camera.fov", {"type": float, "metavar": "DEG", "help": "Camera: vertical field of view (default 38)."}),
    ("--surface", "surface.shape", {"metavar": "SHAPE", "help": "SVBRDF: sphere, plane, cloth, or a mesh."}),
    ("--repeat", "surface.repeat", {"type": Numbers("U,V"), "metavar": "U,V",
                                    "help": "SVBRDF: repeats of the texels along u and v."}),
    ("--y-axis", "surface.y_axis", {**_choice("down", "up"), "help": "SVBRDF: y of its directions."}),
    ("--row", "viewpoint.row", {"type": float, "metavar": "R", "help": "Light field: camera row."}),
    ("--column", "viewpoint.column", {"type": float, "metavar": "C", "help": "Light field: camera column."}),
    ("--focus", "viewpoint.focus", {"type": float, "metavar": "PX", "help": "Light field: disparity in focus."}),
    ("--aperture", "viewpoint.aperture", {"type": float, "metavar": "N", "help": "Light field: cameras averaged."}),
    ("--zoom", "viewpoint.zoom", {"type": float, "metavar": "Z", "help": "Light field: enlarge."}),
    ("--mode", "volume.mode", {**_choice("emission", "shaded", "iso", "maximum"), "help": "Volume: how to show it."}),
    ("--colours", "volume.colours", {"metavar": "MAP", "help": "Volume: grey, inferno, viridis, ice, coolwarm."}),
    ("--window", "volume.window", {"type": Numbers("LOW,HIGH"), "metavar": "LOW,HIGH",
                                   "help": "Volume, slice: darkest and brightest value."}),
    ("--iso", "volume.iso", {"type": float, "metavar": "SHARE", "help": "Volume: surface, as a share of the window."}),
    ("--clip-low", "volume.clip_low", {"type": Numbers("X,Y,Z"), "metavar": "X,Y,Z", "help": "Volume: cut below."}),
    ("--clip-high", "volume.clip_high", {"type": Numbers("X,Y,Z"), "metavar": "X,Y,Z", "help": "Volume: cut above."}),
    ("--stops", "tone.stops", {"type": float, "metavar": "EV", "help": "Exposure: brighter by a factor of 2^EV."}),
    ("--white", "tone.white", {"type": float, "metavar": "V", "help": "Value shown as white."}),
    ("--curve", "tone.curve", {**_choice("linear", "reinhard", "filmic"), "help": "Tone curve."}),
    ("--split", "compare.level", {"type": Count(0), "metavar": "N",
                                  "help": "Right half: level N; 0: the original."}),
)
_LIGHTS = together(
    click.option("--light", "lights", type=Numbers("AZ,EL"), metavar="AZ,EL", multiple=True,
                 help="A directional light, in degrees; several times for several."),
    click.option("--point-light", "points", type=Numbers("X,Y,Z"), metavar="X,Y,Z", multiple=True,
                 help="A point light."),
    click.option("--size", type=Shape(), metavar="WxH", help="Pixels (default 640x480)."),
    click.option("--at", "places", type=Place(), metavar="AXIS=I", multiple=True,
                 help="Index of an axis the picture does not span."),
    click.option("--heat", is_flag=True, help="The error against level N (--split N), or the original (--against)."),
)


#: The kinds that look at some fields of a scene, or at the other fields of some parts; all look at the rest.
_LOOKED_AT: Mapping[str, Sequence[str]] = {
    "camera": ["svbrdf", "volume"], "surface": ["svbrdf"], "viewpoint": ["lightfield"], "volume": ["volume"],
    "volume.window": ["volume", "generic"],
}
#: What moves along an axis of a role, in place of `--at`.
_MOVERS: Mapping[str, Mapping[str, str]] = {
    "time": dict.fromkeys(("svbrdf", "lightfield", "volume"), "--time moves"),
    "light": {"svbrdf": "--light and --point-light move"},
    "view": {"svbrdf": "the camera moves", "lightfield": "--row and --column move"},
}


def _parameter(field: str) -> str:
    """What click calls an option that fills a field."""
    return field.replace(".", "__")


def idle_options(given: Mapping[str, Any], kind: str, axes: Sequence[Axis], mode: str) -> list[str]:
    """Those of the options that were given which change nothing of what is shown as this kind, with why where that
    hangs on the file or on other options; `mode` is that of a volume.

    >>> from hmkcta.axes import name_axes
    >>> axes = name_axes((4, 6, 8), ["time", "y", "x"])
    >>> idle_options({"volume__colours": "ice", "tone__stops": 1.0}, "generic", axes, "iso")
    ['--colours']
    >>> idle_options({"places": (("time", 1), ("x", 2))}, "generic", axes, "iso")
    ['--at x=2 (all of x is shown)']
    """
    fields = ((option, field) for option, field, _ in _OPTIONS if given.get(_parameter(field)) is not None)
    idle = [option for option, field in fields
            if kind not in _LOOKED_AT.get(field, _LOOKED_AT.get(field.partition(".")[0], (kind,)))]
    if kind == "volume" and mode != "iso" and given.get("volume__iso") is not None:
        idle.append(f"--iso (the mode is {mode}: --mode iso shows it)")
    if given.get("time") is not None:
        idle += _idle_time(kind, axes)
    return idle + _idle_places(given.get("places") or (), kind, axes)


def _idle_time(kind: str, axes: Sequence[Axis]) -> list[str]:
    """`--time`, where there is none or the kind is shown in slices."""
    name = next((axis.name for axis in axes if axis.role == "time"), None)
    if name is None:
        return [f"--time (of the axes {', '.join(axis.name for axis in axes)} none is time)"]
    return [f"--time (a slice stands by --at {name}=INDEX)"] if kind == "generic" else []


def _idle_places(places: Sequence[tuple[str, int]], kind: str, axes: Sequence[Axis]) -> list[str]:
    """`--at` of the axes that stand nowhere."""
    from ..render.layout import axes_without_place

    shown = {axes[n].name: axes[n].role for n in axes_without_place(axes, kind)} if places else {}
    idle: list[str] = []
    for name, index in places:
        if name in shown:
            mover = _MOVERS.get(shown[name], {}).get(kind)
            why = f"all of {name} is shown" if mover is None else f"{mover} along {name}"
            idle.append(f"--at {name}={index} ({why})")
    return idle


def scene_options(function: Function) -> Function:
    """Add the options."""
    decorators: list[Callable[[Any], Any]] = [
        click.option(option, _parameter(field), **settings) for option, field, settings in _OPTIONS
    ]
    return together(*decorators, _LIGHTS)(function)


def fill_scene(described: dict[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """The JSON of a scene with the options that were given in place of its fields.

    >>> fill_scene({"camera": {"fov": 30}}, {"camera__azimuth": 10.0, "size": (64, 48)})
    {'camera': {'fov': 30, 'azimuth': 10.0}, 'width': 64, 'height': 48}
    """
    scene: dict[str, Any] = deepcopy(described)
    for _, field, _ in _OPTIONS:
        value = given.get(_parameter(field))
        if value is not None:
            section, _, name = field.rpartition(".")
            (scene.setdefault(section, {}) if section else scene)[name] = value
    size: Sequence[int] | None = given.get("size")
    if size is not None:
        if len(size) != 2:
            raise click.BadParameter("write WIDTHxHEIGHT, e.g. 640x480", param_hint="--size")
        scene["width"], scene["height"] = size
    lights = [{"azimuth": azimuth, "elevation": elevation} for azimuth, elevation in given.get("lights") or ()]
    lights += [{"position": list(position), "intensity": 4.0} for position in given.get("points") or ()]
    if lights:
        scene["lights"] = lights
    if given.get("places"):
        scene["position"] = {**scene.get("position", {}), **dict(given["places"])}
    return _compared(scene, given)


def _compared(scene: dict[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Level 0 stands for the original; naming one is asking for the split view."""
    level = given.get("compare__level")
    if level is not None or given.get("heat"):
        compare = scene.setdefault("compare", {})
        compare["mode"] = "heat" if given.get("heat") else "split"
        compare["level"] = compare.get("level") or None
    return scene
