"""`hmkcta render`: pictures and films of a file, by the shaders or, without an adapter, by NumPy."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click

from ..errors import invalid
from ..hmkfile import check_output
from ..model import open as open_model
from ..support.cut_short import whole_map
from .compared import opened
from .options import (
    SOURCE,
    Command,
    Count,
    file_argument,
    json_option,
    overwrite_option,
    quiet_option,
    source_options,
    verbose_option,
)
from .output import emit, seconds
from .progress import Progress
from .scene_options import fill_scene, idle_options, scene_options

if TYPE_CHECKING:
    from ..render import Renderer, Scene

EXAMPLES = (
    "hmkcta render wood.hmk -o wood.png --surface cloth --light 60,45",
    "hmkcta render jet.hmk -o jet.mp4 --colours ice --frames 96",
    "hmkcta render bunnies.hmk -o bunnies.gif --animate view --focus 0.5",
    "hmkcta render wood.hmk -o error.png --against wood.npy --heat",
)

#: Frames of a film, and of them in a second, where nobody says it.
FRAMES, FPS = 48, 24.0


@click.command("render", cls=Command, examples=EXAMPLES)
@file_argument
@click.option("-o", "--output", required=True, type=click.Path(), metavar="OUT",
              help="OUT.png, .exr (radiance), .mp4 or .gif.")
@click.option("--scene", type=click.Path(), metavar="JSON", help="Scene to start from; options override it.")
@scene_options
@click.option("--against", metavar="SRC", help="Original, for --split 0 and --heat.")
@source_options
@click.option("--animate", metavar="MOTION", help="Film: orbit, light, view or time.")
@click.option("--frames", type=Count(1), default=FRAMES, metavar="N", help=f"Film: frames (default {FRAMES}).")
@click.option("--fps", type=click.FloatRange(0.1, 240), default=FPS, metavar="N",
              help=f"Film: frames per second (default {FPS:g}).")
@click.option("--backend", type=click.Choice(["auto", "gpu", "numpy"]), default="auto", metavar="auto|gpu|numpy",
              help="Shaders (also in software), NumPy, or by whether there is a GPU (default auto).")
@overwrite_option
@json_option
@quiet_option
@verbose_option
def render_command(file: str, output: str, scene: str | None, against: str | None, animate: str | None, frames: int,
                   fps: float, backend: str, overwrite: bool, as_json: bool, quiet: bool, verbose: bool,
                   **given: Any) -> None:
    """Render FILE: a lit surface, a view of a light field, a volume; what it is, it says itself.

    A scene is a JSON object with the fields that docs/rendering.md lists.
    """
    del verbose
    from ..render.outputs import FILMS, check_format, film_size

    film = check_format(output) in FILMS
    if animate is not None and not film:
        raise invalid("output-format", "output", repr(output), f"a film ({', '.join(FILMS)}) with --animate")
    check_output(output, overwrite)
    source = {name: given.pop(name) for name in SOURCE}
    described = _scene(scene, given)
    _check_compared(described, against)
    model = open_model(file)
    watched = opened("--against", against, source, quiet or as_json)
    original = None if watched is None else watched.array
    from ..render import Renderer

    started = time.monotonic()
    with whole_map(original), Progress(quiet or as_json or not film) as progress:
        renderer = Renderer(model, original=original, backend=backend, kind=described.kind, position=described.position)
        if film:
            pictures = _followed(renderer, described, animate, frames, progress)
            count = _save_film(output, pictures, fps, overwrite)
        else:
            count = _save_still(output, renderer, described, overwrite)
    size = film_size(output, described.width, described.height)
    idle = idle_options(given, renderer.kind, model.metadata.axes, described.volume.mode)
    notes = [*renderer.notes, *_resized(described, size),
             *([] if renderer.gain is None else [f"errors are shown {renderer.gain:g} times as large as they are"]),
             *(["slices are rendered by NumPy: --backend gpu does nothing for them"]
               if backend == "gpu" and renderer.backend == "numpy" else []),
             *([f"for a {renderer.kind} these do nothing: {', '.join(idle)}"] if idle else [])]
    _report(output, renderer, size, count, time.monotonic() - started, notes, as_json, quiet)


def _scene(path: str | None, given: dict[str, Any]) -> Scene:
    from ..render.scene import read_json, scene_from_json

    return scene_from_json(fill_scene({} if path is None else read_json(path), given))


def _check_compared(scene: Scene, against: str | None) -> None:
    """Refuse to compare with nothing, before anything is read."""
    if scene.compare.mode != "none" and scene.compare.level is None and against is None:
        raise invalid("no-original", "compare", f"{scene.compare.mode} without a level",
                      "the original array, or a level to compare with",
                      "give the original by --against FILE, or a level by --split N")


def _followed(renderer: Renderer, scene: Scene, motion: str | None, count: int, progress: Progress) -> Iterator[Any]:
    """The frames, and how many of them are done."""
    for number, picture in enumerate(renderer.frames(scene, motion, count), start=1):
        yield picture
        progress("rendering", number / count)


def _save_film(output: str, pictures: Iterator[Any], fps: float, overwrite: bool) -> int:
    from ..render.outputs import save_film

    return save_film(output, pictures, fps, overwrite)


def _save_still(output: str, renderer: Renderer, scene: Scene, overwrite: bool) -> int:
    from ..render.outputs import save_picture, save_radiance

    if not output.lower().endswith(".exr"):
        save_picture(output, renderer.picture(scene), overwrite)
        return 1
    if scene.compare.mode != "none":
        raise invalid("output-format", "output", repr(output), "a name that ends with .png for a comparison")
    save_radiance(output, renderer.radiance(scene), overwrite)
    return 1


def _resized(scene: Scene, size: tuple[int, int]) -> list[str]:
    """A sentence on a film that has other sides than the scene; none if it has the same."""
    width, height = size
    if (width, height) == (scene.width, scene.height):
        return []
    return [f"the sides of an MP4 are even: it has {width} x {height} pixels, not {scene.width} x {scene.height}. "
            "Next: ask for even ones, by --size, or for a .gif, which has any"]


def _report(output: str, renderer: Renderer, size: tuple[int, int], count: int, spent: float, notes: list[str],
            as_json: bool, quiet: bool) -> None:
    width, height = size
    by = renderer.adapter if renderer.backend == "gpu" else "NumPy"
    if as_json:
        emit({"output": output, "kind": renderer.kind, "width": width, "height": height, "frames": count,
              "backend": renderer.backend, "adapter": renderer.adapter, "notes": notes,
              "seconds": round(spent, 3)})
    elif not quiet:
        for note in notes:
            click.echo(note, err=True)
        frames = "" if count == 1 else f", {count} frames"
        click.echo(f"{output}: {renderer.kind}, {width} x {height}{frames}, by {by}, in {seconds(spent)}")
