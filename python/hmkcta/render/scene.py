"""What a picture shows: camera, lights, surface, level, time, tone; as dataclasses and as a small JSON object.

World coordinates are right-handed with z up. Angles are degrees. Every field has a default, so a scene says only what
differs; `scene_from_json` is strict: an unknown field, a wrong type or a value out of range is an error that names it.
"""

from __future__ import annotations

import json
import types
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from math import cos, radians, sin
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Union, cast, get_args, get_origin, get_type_hints

from ..errors import HmkctaError, Kind, expect, invalid
from ..hmkfile import KINDS

CURVES = ("linear", "reinhard", "filmic")
COMPARISONS = ("none", "split", "heat")
VOLUME_MODES = ("emission", "shaded", "iso", "maximum")
MOST_LIGHTS = 8
MOST_PIXELS = 8192  # a side: WebGPU's guaranteed texture size
Vector = tuple[float, float, float]


def _check_choice(where: str, value: str, allowed: Sequence[str]) -> None:
    if value not in allowed:
        raise invalid("unknown-choice", where, repr(value), ", ".join(allowed))


def _check_range(where: str, value: float, low: float, high: float, meaning: str = "") -> None:
    expect(where, value, Real, "a number")
    if not low <= value <= high:
        raise invalid("out-of-range", where, value, f"{low:g} to {high:g}{meaning}")


def _check_vector(where: str, value: Sequence[float], length: int = 3, least: float = -1e9) -> None:
    if len(value) != length or not all(least <= x <= 1e9 for x in value):
        raise invalid("bad-vector", where, list(value), f"{length} finite numbers from {least:g} up")


def direction(azimuth: float, elevation: float) -> Vector:
    """Unit vector of an azimuth (from x towards y) and an elevation (from the xy plane towards z) in degrees.

    >>> [round(x, 6) for x in direction(90, 0)]
    [0.0, 1.0, 0.0]
    """
    a, e = radians(azimuth), radians(elevation)
    return (cos(e) * cos(a), cos(e) * sin(a), sin(e))


@dataclass(frozen=True)
class Camera:
    """Perspective camera on an orbit about `target`; `fov` is its vertical field of view. None: what suits the kind."""

    azimuth: float | None = None
    elevation: float | None = None
    distance: float | None = None
    fov: float = 38.0
    target: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        _check_range("camera.azimuth", self.azimuth or 0.0, -1e6, 1e6)
        _check_range("camera.elevation", self.elevation or 0.0, -90.0, 90.0)
        _check_range("camera.distance", 1.0 if self.distance is None else self.distance, 1e-3, 1e6)
        _check_range("camera.fov", self.fov, 1.0, 150.0)
        _check_vector("camera.target", self.target)

    def placed(self, azimuth: float, elevation: float, distance: float) -> Camera:
        """The camera with its Nones replaced."""
        return replace(
            self,
            azimuth=azimuth if self.azimuth is None else self.azimuth,
            elevation=elevation if self.elevation is None else self.elevation,
            distance=distance if self.distance is None else self.distance,
        )


@dataclass(frozen=True)
class Light:
    """A directional light from (azimuth, elevation), or a point light at `position`; `colour` times `intensity`.

    A point light's strength falls with the square of the distance, and is `intensity` at distance 1.
    """

    azimuth: float = 60.0
    elevation: float = 45.0
    position: Vector | None = None
    colour: Vector = (1.0, 1.0, 1.0)
    intensity: float = 1.0

    def __post_init__(self) -> None:
        _check_range("lights.azimuth", self.azimuth, -1e6, 1e6)
        _check_range("lights.elevation", self.elevation, -90.0, 90.0)
        _check_range("lights.intensity", self.intensity, 0.0, 1e9)
        _check_vector("lights.colour", self.colour, least=0.0)
        if self.position is not None:
            _check_vector("lights.position", self.position)


@dataclass(frozen=True)
class Surface:
    """What an SVBRDF covers: ``sphere``, ``plane``, ``cloth``, or a path of a mesh (.obj, .gltf, .glb, .ply).

    `repeat` is how often the texels come along u and v. `y_axis` says whether the directions' y component points along
    growing texel rows (``down``, as in `hmkcta.synthetic`) or against them (``up``, as for photographs). `cosine` says
    whether the values contain the cosine of the light's angle, as radiance under unit irradiance does. `coded` says
    whether the values are sRGB-coded, and light only once they are decoded; None: those of 8 bits (uint8) are.
    """

    shape: str = "sphere"
    repeat: tuple[float, float] = (1.0, 1.0)
    y_axis: str = "down"
    cosine: bool = True
    coded: bool | None = None

    def __post_init__(self) -> None:
        _check_vector("surface.repeat", self.repeat, 2, 1e-3)
        _check_choice("surface.y_axis", self.y_axis, ("down", "up"))


@dataclass(frozen=True)
class Tone:
    """From radiance to display: ``2**stops / white``, a curve, sRGB encoding.

    `white` None is the largest number of the type of integer pictures (bool, uint8, uint16), else the 99.5th percentile
    of the data; `srgb` None encodes an SVBRDF and leaves the rest, which is display-ready. `background` is a display colour, 0..1.
    """

    stops: float = 0.0
    white: float | None = None
    curve: str = "linear"
    srgb: bool | None = None
    background: Vector = (0.055, 0.06, 0.07)

    def __post_init__(self) -> None:
        _check_range("tone.stops", self.stops, -40.0, 40.0)
        if self.white is not None:
            _check_range("tone.white", self.white, 1e-30, 1e30)
        _check_choice("tone.curve", self.curve, CURVES)
        _check_vector("tone.background", self.background, least=0.0)


@dataclass(frozen=True)
class Viewpoint:
    """Where a light field is seen from: `row` and `column` among the cameras (None: the middle), and what is in focus.

    `focus` is the disparity, in pixels from one camera to the next, of what shall be sharp; `aperture` how many cameras
    around the view point are averaged (0: the nearest two each way, interpolated); `zoom` enlarges.
    """

    row: float | None = None
    column: float | None = None
    focus: float = 0.0
    aperture: float = 0.0
    zoom: float = 1.0

    def __post_init__(self) -> None:
        for name in ("row", "column"):
            _check_range(f"viewpoint.{name}", getattr(self, name) or 0.0, -1e6, 1e6)
        _check_range("viewpoint.focus", self.focus, -1e4, 1e4)
        _check_range("viewpoint.aperture", self.aperture, 0.0, 1e4)
        _check_range("viewpoint.zoom", self.zoom, 1e-3, 1e3)


@dataclass(frozen=True)
class Look:
    """How a volume is shown.

    `colours` names a colour map or lists ``[share, red, green, blue]``, `opacity` lists ``[share, opacity per voxel]``;
    shares are 0 at the window's low value and 1 at its high one. `window` None is the 0.5th to 99.5th percentile. `iso`
    is the share of the iso-surface. `clip_low`, `clip_high` cut the box (0..1 along x, y, z). `step` is in voxels.
    """

    mode: str = "shaded"
    colours: str | tuple[tuple[float, ...], ...] = "inferno"
    opacity: tuple[tuple[float, ...], ...] = ((0.0, 0.0), (0.15, 0.0), (1.0, 0.35))
    window: tuple[float, float] | None = None
    iso: float = 0.5
    clip_low: Vector = (0.0, 0.0, 0.0)
    clip_high: Vector = (1.0, 1.0, 1.0)
    step: float = 0.5
    ambient: float = 0.35
    specular: float = 0.25

    def __post_init__(self) -> None:
        _check_choice("volume.mode", self.mode, VOLUME_MODES)
        for at, point in enumerate(self.opacity):
            _check_vector(f"volume.opacity[{at}]", point, 2, 0.0)
        for at, point in enumerate(self.colours if not isinstance(self.colours, str) else ()):
            _check_vector(f"volume.colours[{at}]", point, 4, 0.0)
        _check_range("volume.iso", self.iso, -1e6, 1e6)
        if self.window is not None and not 1e-30 < self.window[1] - self.window[0] < 1e38:
            raise invalid("bad-window", "volume.window", list(self.window), "[low, high], 1e-30 to 1e38 apart")
        _check_vector("volume.clip_low", self.clip_low, least=0.0)
        _check_vector("volume.clip_high", self.clip_high, least=0.0)
        if any(not low < high <= 1 for low, high in zip(self.clip_low, self.clip_high, strict=True)):
            found = f"{list(self.clip_low)} to {list(self.clip_high)}"
            raise invalid("bad-clip", "volume.clip_high", found, "0 <= low < high <= 1 along each of x, y, z")
        _check_range("volume.step", self.step, 0.05, 10.0, " voxels")
        _check_range("volume.ambient", self.ambient, 0.0, 1.0)
        _check_range("volume.specular", self.specular, 0.0, 10.0)


@dataclass(frozen=True)
class Compare:
    """``split``: the picture left of `position` (0..1), what it is compared with right of it; ``heat``: their error.

    It is compared with `level`, or, where that is None, with the original, which must then be given. `gain` None
    amplifies the difference by a power of two so that it just fills the colours.
    """

    mode: str = "none"
    level: int | None = None
    position: float = 0.5
    gain: float | None = None

    def __post_init__(self) -> None:
        _check_choice("compare.mode", self.mode, COMPARISONS)
        _check_range("compare.position", self.position, 0.0, 1.0)
        if self.gain is not None:
            _check_range("compare.gain", self.gain, 1e-12, 1e12)


@dataclass(frozen=True)
class Scene:
    """One picture. `kind` None is the file's, `level` None all levels, `time` a frame that may lie between two.

    `position` is the index at which other axes stand, by name (the middle by default).

    >>> Scene(width=64, height=64, camera=Camera(azimuth=30)).camera.azimuth
    30

    Raises:
        HmkctaError: a value out of range.
    """

    width: int = 640
    height: int = 480
    kind: str | None = None
    level: int | None = None
    time: float | None = None
    camera: Camera = field(default_factory=Camera)
    lights: tuple[Light, ...] = (Light(),)
    surface: Surface = field(default_factory=Surface)
    tone: Tone = field(default_factory=Tone)
    viewpoint: Viewpoint = field(default_factory=Viewpoint)
    volume: Look = field(default_factory=Look)
    compare: Compare = field(default_factory=Compare)
    position: dict[str, int] = field(default_factory=dict[str, int])

    def __post_init__(self) -> None:
        for name, pixels in (("width", self.width), ("height", self.height)):
            expect(name, pixels, Integral, "a whole number of pixels")
            _check_range(name, pixels, 1, MOST_PIXELS, " pixels")
        if self.kind is not None:
            _check_choice("kind", self.kind, KINDS)
        for name, part in (("camera", Camera), ("surface", Surface), ("viewpoint", Viewpoint), ("volume", Look),
                           ("tone", Tone), ("compare", Compare)):
            expect(name, getattr(self, name), part, f"a {part.__name__}")
        expect("lights", self.lights, tuple | list, "a tuple of Light")
        for light in self.lights:
            expect("light", light, Light, "a Light")
        if len(self.lights) > MOST_LIGHTS:
            raise invalid("too-many-lights", "lights", len(self.lights), f"up to {MOST_LIGHTS}")


def scene_from_json(value: Any) -> Scene:
    """The scene that a JSON object describes.

    >>> scene_from_json({"width": 64, "lights": [{"azimuth": 10}], "tone": {"stops": 1}}).tone.stops
    1.0

    Raises:
        HmkctaError: an unknown field, a wrong type, a value out of range.
    """
    return _read(Scene, value, "scene")


def load_scene(path: str | Path) -> Scene:
    """The scene of a JSON file.

    Raises:
        HmkctaError: the file cannot be read, is no JSON, or is no scene.
    """
    return scene_from_json(read_json(path))


def read_json(path: str | Path) -> dict[str, Any]:
    """The JSON object of a file.

    Raises:
        HmkctaError: the file cannot be read, or is no JSON object.
    """
    try:
        value: Any = json.loads(Path(path).read_text(encoding="utf-8"), parse_constant=_no_number)
    except OSError as error:
        raise HmkctaError(Kind.IO, "unreadable", str(path), found=error.strerror, allowed="a JSON file",
                          told=f"cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise invalid("not-json", str(path), error, "a JSON object, e.g. {\"width\": 640}") from error
    if not isinstance(value, dict):
        raise invalid("not-json", str(path), type(value).__name__, "a JSON object, e.g. {\"width\": 640}")
    return cast("dict[str, Any]", value)


def _no_number(word: str) -> None:
    raise ValueError(f"{word} is no number")


def _read(wanted: Any, value: Any, where: str) -> Any:
    """The value as the type says, recursively; `where` is its path, for errors."""
    origin = get_origin(wanted)
    if origin in (Union, types.UnionType):
        return _read_union(get_args(wanted), value, where)
    if is_dataclass(wanted) and isinstance(wanted, type):
        return _read_object(wanted, value, where)
    if origin is tuple:
        return _read_list(get_args(wanted), value, where)
    if origin is dict:
        if not isinstance(value, Mapping):
            raise invalid("wrong-type", where, repr(value), "an object")
        entries = cast("Mapping[str, Any]", value)
        return {name: _read(int, entry, f"{where}.{name}") for name, entry in entries.items()}
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if wanted is float and number:
        return float(value)
    if (wanted is int and number and isinstance(value, int)) or (wanted in (bool, str) and isinstance(value, wanted)):
        return value
    names: dict[Any, str] = {float: "a number", int: "a whole number", bool: "true or false", str: "a text"}
    raise invalid("wrong-type", where, repr(value), names[wanted])


def _read_union(choices: tuple[Any, ...], value: Any, where: str) -> Any:
    if value is None and type(None) in choices:
        return None
    rest = [choice for choice in choices if choice is not type(None)]
    if len(rest) > 1:  # a text or a list
        return value if isinstance(value, str) else _read(rest[-1], value, where)
    return _read(rest[0], value, where)


def _read_object(wanted: type, value: Any, where: str) -> Any:
    known = get_type_hints(wanted)
    names = [entry.name for entry in fields(wanted)]
    if not isinstance(value, Mapping):
        raise invalid("wrong-type", where, repr(value), f"an object with fields from {', '.join(names)}")
    entries = cast("Mapping[str, Any]", value)
    for name in entries:
        if name not in names:
            raise invalid("unknown-field", f"{where}.{name}", "an unknown field", ", ".join(names))
    return wanted(**{name: _read(known[name], entry, f"{where}.{name}") for name, entry in entries.items()})


def _read_list(items: tuple[Any, ...], value: Any, where: str) -> Any:
    if not isinstance(value, list | tuple):
        raise invalid("wrong-type", where, repr(value), "a list")
    entries = cast("Sequence[Any]", value)
    if items[-1] is Ellipsis:
        return tuple(_read(items[0], entry, f"{where}[{n}]") for n, entry in enumerate(entries))
    if len(entries) != len(items):
        raise invalid("bad-vector", where, list(entries), f"{len(items)} numbers")
    pairs = enumerate(zip(items, entries, strict=True))
    return tuple(_read(item, entry, f"{where}[{n}]") for n, (item, entry) in pairs)
