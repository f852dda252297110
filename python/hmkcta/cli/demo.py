"""`hmkcta demo`: what the method does, on data it makes itself, in a few minutes."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from ..encode import compress
from ..errors import HmkctaError, Kind
from ..model import Model
from ..support.memory import format_bytes
from .options import Command, quiet_option, verbose_option
from .output import decibels, mebibytes, seconds, table, warnings_as_notes
from .progress import Progress

if TYPE_CHECKING:
    from ..synthetic import Dataset

EXAMPLES = ("hmkcta demo", "hmkcta demo -o /tmp/demo", "hmkcta demo --tiny")

#: WH4 of the paper's table 2: the second and third level fit what the clusters of the level above them leave.
LEVELS = "R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2 / R=2,2,3,3 C=3,3,4,4 K=2"
TINY_LEVELS = "R=3,3,4,4 / R=1,1,2,2 C=2 K=2 / R=1,1,2,2 C=2"


@dataclass(frozen=True)
class Case:
    """Data to compress, and how its axes become the four modes of `LEVELS`."""

    name: str
    make: Callable[[bool], Dataset]
    organisation: str
    shown: str


@dataclass(frozen=True, eq=False)
class Result:
    """A compressed data set."""

    label: str
    path: Path
    model: Model
    seconds: float


@click.command("demo", cls=Command, examples=EXAMPLES)
@click.option("-o", "--output", type=click.Path(file_okay=False), default="demo-output",
              help="Folder for files and pictures (default demo-output).")
@click.option("--tiny", is_flag=True, help="Small data, in less time.")
@quiet_option
@verbose_option
def demo_command(output: str, tiny: bool, quiet: bool, verbose: bool) -> None:
    """Compress a synthetic material and a jet, and write pictures to compare.

    Each is fitted twice: by the paper's three levels, whose coarse levels show first, and by a plan found for it.
    """
    del verbose
    folder = _folder(output)
    rows: list[list[str]] = []
    pictures: list[Path] = []
    for case in CASES:
        click.echo(f"Making {case.shown} ..")
        data = case.make(tiny)
        np.save(folder / f"{case.name}.npy", data.values)
        shape = " x ".join(map(str, data.values.shape))
        click.echo(f"  {shape} ({', '.join(data.names)}), {format_bytes(data.nbytes)}")
        results = _results(case, data, folder, TINY_LEVELS if tiny else LEVELS, quiet)
        for result in results:
            rows += _rows(case, data, result)
            pictures.append(_sheet(case, data, result))
        pictures.append(_rendered(case, results[-1], tiny))
    click.echo()
    click.echo(table(["data", "plan", "level", "SNR dB", "MiB", "ratio", "decode cost", "seconds"], rows))
    click.echo(_closing(folder, pictures))


def _material(tiny: bool) -> Dataset:
    from ..synthetic import material

    return material(16, 12, 32) if tiny else material()


def _jet(tiny: bool) -> Dataset:
    from ..synthetic import volume

    return volume(24, frames=16) if tiny else volume()


CASES = (
    Case("material", _material, "light+rgb, view, y, x", "a brocade under 24 lights from 24 views"),
    Case("jet", _jet, "time, z, y, x", "a turbulent jet of 32 frames"),
)


def _folder(output: str) -> Path:
    folder = Path(output)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise HmkctaError(Kind.IO, "unwritable", output, found=error.strerror, allowed="a folder",
                          hint="choose another one with -o", told=f"cannot be made: {error.strerror}") from error
    return folder


def _results(case: Case, data: Dataset, folder: Path, levels: str, quiet: bool) -> list[Result]:
    """Fitted by the paper's levels, and by a plan found for 1/100 of the bytes or 50 dB."""
    results: list[Result] = []
    for label, plan, organisation in (("levels", levels, case.organisation), ("auto", None, None)):
        start = time.monotonic()
        with Progress(quiet) as progress, warnings_as_notes() as said:
            model = compress(data.values, plan, axes=data.axes, organisation=organisation, kind=data.kind,
                             scheme="most" if plan else "auto", quality="fast", progress=progress)
        path = folder / f"{case.name}-{label}.hmk"
        model.save(path, overwrite=True)
        spent = time.monotonic() - start
        results.append(Result(label, path, model, spent))
        click.echo(f"  {label}: {decibels(model.snr)} dB in {format_bytes(model.nbytes)}, {seconds(spent)}")
        for sentence in [] if quiet else said:
            click.echo(f"hmkcta: {sentence}.", err=True)
    return results


def _rows(case: Case, data: Dataset, result: Result) -> list[list[str]]:
    rows: list[list[str]] = []
    last = len(result.model.levels)
    for number, quality in enumerate(result.model.quality, start=1):
        upto = result.model.at_level(number)
        rows.append([case.name, result.label, str(number), decibels(quality.snr_db), mebibytes(upto.nbytes),
                     f"{data.nbytes / upto.nbytes:.0f}", str(upto.decode_cost),
                     f"{result.seconds:.1f}" if number == last else ""])
    return rows


def _sheet(case: Case, data: Dataset, result: Result) -> Path:
    """A picture of the original, each level and its error."""
    from ..pictures import comparison_sheet, slice_image

    original = slice_image(data.values, data.axes, data.kind)
    levels = [(f"level {number}, {decibels(quality.snr_db)} dB over all",
               slice_image(result.model.at_level(number), data.axes, data.kind))
              for number, quality in enumerate(result.model.quality, start=1)]
    title = f"{case.name}: {format_bytes(data.nbytes)} in {format_bytes(result.model.nbytes)}"
    return comparison_sheet(original, levels, result.path.with_suffix(".png"), title=title, kind=data.kind)


def _rendered(case: Case, result: Result, tiny: bool) -> Path:
    """The material on a cloth, the jet as a volume: rendered from the file's model, by NumPy, which needs no GPU."""
    from ..render import Scene, Surface, render
    from ..render.outputs import save_picture

    width, height = (96, 72) if tiny else (320, 240)
    path = result.path.with_name(f"{case.name}-rendered.png")
    scene = Scene(width, height, surface=Surface("cloth", (2.0, 2.0)))
    save_picture(path, render(result.model, scene, backend="numpy"), overwrite=True)
    return path


def _closing(folder: Path, pictures: list[Path]) -> str:
    """Where the pictures are, and commands to go on with."""
    return "\n".join([
        "", "Pictures to look at:", *(f"  {path}" for path in pictures), "", "To try next:",
        f"  hmkcta render {folder / 'jet-levels.hmk'} -o {folder / 'jet.gif'} --colours ice --frames 32",
        f"  hmkcta info {folder / 'material-levels.hmk'}",
        f"  hmkcta verify {folder / 'jet-auto.hmk'} --against {folder / 'jet.npy'}",
        f"  hmkcta plan {folder / 'material.npy'} --axes light,view,y,x,rgb --snr 30",
        f"  hmkcta compress {folder / 'material.npy'} -o {folder / 'mine.hmk'} --axes light,view,y,x,rgb --size 300KiB",
        f"  hmkcta decompress {folder / 'material-levels.hmk'} -o {folder / 'coarse.npy'} --level 1",
    ])
