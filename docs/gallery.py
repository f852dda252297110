"""Pictures like the paper's figures 5 to 9: ``python docs/gallery.py`` or ``make gallery`` (some minutes).

Each shows the original and what HOSVD, one level of clusters (MK-CTA) and levels of clusters (HMK-CTA) make of it in
about as many bytes, with the errors below; and the levels one by one. Data is synthetic; with ``--data FOLDER`` also
the real sets of that folder, whose pictures stay out of this repository.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER.parent / "python"))

from hmkcta import Model, compress, synthetic  # noqa: E402 - found through the path above
from hmkcta.axes import Axis, name_axes  # noqa: E402
from hmkcta.pictures import heat_colours  # noqa: E402
from hmkcta.render import (  # noqa: E402
    Camera,
    Compare,
    Light,
    Look,
    Renderer,
    Scene,
    Surface,
    Tone,
    Viewpoint,
)
from hmkcta.synthetic import Dataset  # noqa: E402

U8 = NDArray[np.uint8]

GAP, CAPTION = 10, 54
PAPER, INK, DIM = (255, 255, 255), (20, 20, 24), (96, 98, 106)


@dataclass(frozen=True)
class Figure:
    """Data, how its axes become modes, the plans to compare (name, plan), and what to show of it.

    `inset` is the part (left, top, right, bottom; shares of the picture) that is also shown enlarged.
    """

    name: str
    data: Callable[[], Dataset]
    organisation: str
    plans: Sequence[tuple[str, str]]
    scene: Scene
    gain: float
    inset: tuple[float, float, float, float] | None = None


SYNTHETIC = (
    Figure(
        "material", synthetic.material, "light+rgb, view, y, x",
        (("HOSVD", "R=18,12,36,36"),
         ("clusters (MK-CTA)", "R=3,3,4,4 C=4,3,6,6 K=2"),
         ("levels (HMK-CTA)", "R=6,4,8,8 C=2 K=2 / R=2,2,3,3 C=2,2,3,3 K=2")),
        Scene(300, 240, surface=Surface("cloth", (2, 2)), camera=Camera(20, 42, 4.7),
              lights=(Light(60, 50),),
              tone=Tone(0.3, curve="filmic", background=(1.0, 1.0, 1.0))), 8.0,
    ),
    Figure(
        "lightfield", synthetic.light_field, "row+column, y, x, time",
        (("HOSVD", "R=20,40,40,*"),
         ("clusters (MK-CTA)", "R=2,4,4,* C=8,8,8,1 K=2,2,2,1"),
         ("levels (HMK-CTA)", "R=4,8,8,* / R=2,3,3,* C=4,4,4,1 K=2,2,2,1 / R=1,2,2,* C=3,3,3,1 K=2,2,2,1")),
        Scene(288, 288, viewpoint=Viewpoint(3.5, 4.5), time=3), 4.0, (0.3, 0.25, 0.62, 0.57),
    ),
    Figure(
        "volume", synthetic.volume, "time, z, y, x",
        (("HOSVD", "R=*,20,20,20"),
         ("clusters (MK-CTA)", "R=*,2,2,2 C=1,9,9,9 K=1,2,2,2"),
         ("levels (HMK-CTA)", "R=*,4,4,4 / R=*,2,2,2 C=1,4,4,4 K=1,2,2,2 / R=*,1,1,1 C=1,4,4,4 K=1,2,2,2")),
        Scene(300, 220, camera=Camera(-60, 20, 3.0, 38.0), lights=(Light(-20, 40),), time=20,
              volume=Look(opacity=((0.0, 0.0), (0.12, 0.0), (1.0, 0.4)), window=(0.0, 0.8), ambient=0.55)), 2.0,
    ),
)


def real_figures(folder: Path) -> list[Figure]:
    """The real sets of a folder, as far as they are there; plans are those of the synthetic set of their kind."""
    material, light_field, volume = SYNTHETIC
    made = {
        "steel_svbrdf_parameters": replace(
            material, name="steel", data=lambda: _sheet(folder / "steel_svbrdf_parameters.npz"),
            scene=replace(material.scene, surface=Surface("sphere", y_axis="up"), camera=Camera(10, 15, 3.6),
                          tone=replace(material.scene.tone, stops=-0.8))),
        "shop_lightfield": replace(
            light_field, name="shop", data=lambda: _npz(folder / "shop_lightfield.npz", "lightfield"),
            organisation="row+column+rgb, y, x",
            plans=(("HOSVD", "R=50,80,100"), ("clusters (MK-CTA)", "R=3,6,6 C=8,8,10 K=2"),
                   ("levels (HMK-CTA)", "R=6,12,16 / R=3,4,4 C=3,4,5 K=2 / R=2,3,3 C=2,3,4 K=2")),
            scene=Scene(384, 256, viewpoint=Viewpoint(4, 4)), inset=(0.4, 0.4, 0.65, 0.7)),
        "viscous_fingers_volume": replace(
            volume, name="fingers", data=lambda: _npz(folder / "viscous_fingers_volume.npz", "volume"),
            scene=replace(volume.scene, volume=Look(colours="ice"), camera=Camera(-60, 20, 4.0)), gain=8.0),
    }
    return [figure for name, figure in made.items() if (folder / f"{name}.npz").is_file()]


def _sheet(path: Path) -> Dataset:
    """The measured steel sheet at 58 x 58 directions; it has neither parallax nor shadows."""
    maps, directions = synthetic.load_sheet(path, "rusted")
    return synthetic.svbrdf_from_parameters(maps.cropped(96, 96), directions[::2], directions[::2])


def _npz(path: Path, kind: str) -> Dataset:
    values = np.asarray(np.load(path)["values"], np.float32)
    names = ["row", "column", "y", "x", "rgb"] if kind == "lightfield" else ["time", "z", "y", "x"]
    axes: tuple[Axis, ...] = name_axes(values.shape, names)
    return Dataset(values / np.float32(values.max()), axes, kind)


def draw(figure: Figure, folder: Path) -> list[Path]:
    """Fit, render and write the figure of methods, and that of the levels of the last of them."""
    data = figure.data()
    models = [(name, compress(data.values, plan, axes=data.axes, organisation=figure.organisation, kind=data.kind,
                              quality="fast")) for name, plan in figure.plans]
    raw = f"{data.nbytes / 2**20:.0f} MiB as float32"
    deepest = models[-1][1]
    levels = [(f"level {n}", deepest.at_level(n)) for n in range(1, len(deepest.levels) + 1)]
    written: list[Path] = []
    for what, shown in (("methods", models), ("levels", levels)):
        columns = [_column(figure, data, model, name) for name, model in shown]
        original = Renderer(shown[0][1], original=data.values, backend="numpy").original_picture(figure.scene)
        columns.insert(0, (["original", raw], _enlarged(figure, original), None))
        path = folder / f"gallery_{figure.name}_{what}.png"
        _montage(columns, figure.gain).quantize(256, dither=Image.Dither.FLOYDSTEINBERG).save(path, optimize=True)
        written.append(path)
    return written


Column = tuple[list[str], U8, U8 | None]


def _column(figure: Figure, data: Dataset, model: Model, name: str) -> Column:
    renderer = Renderer(model, original=data.values, backend="numpy")
    picture = renderer.picture(figure.scene)
    error = renderer.picture(replace(figure.scene, compare=Compare("heat", gain=figure.gain)))
    size = f"{model.nbytes / 1024:.0f} KiB" if model.nbytes < 2**20 else f"{model.nbytes / 2**20:.1f} MiB"
    caption = [name, f"{model.snr:.2f} dB, {size}", f"{model.decode_cost:,} multiply-adds an element"]
    return caption, _enlarged(figure, picture), _enlarged(figure, error)


def _enlarged(figure: Figure, picture: U8) -> U8:
    """The picture with its inset, twice as large, in the lower right corner."""
    if figure.inset is None:
        return picture
    height, width = picture.shape[:2]
    left, top, right, bottom = (round(share * side) for share, side in zip(figure.inset, (width, height) * 2,
                                                                          strict=True))
    whole = Image.fromarray(picture)
    part = whole.crop((left, top, right, bottom)).resize(((right - left) * 3 // 2, (bottom - top) * 3 // 2),
                                                         Image.Resampling.BICUBIC)
    pen = ImageDraw.Draw(whole)
    pen.rectangle((left, top, right, bottom), outline=(255, 60, 40))
    place = (width - part.width - 2, height - part.height - 2)
    whole.paste(part, place)
    pen.rectangle((place[0] - 1, place[1] - 1, width - 2, height - 2), outline=(255, 60, 40), width=2)
    return np.asarray(whole)


def _montage(columns: Sequence[Column], gain: float) -> Image.Image:
    """Pictures side by side, captions below, errors below them."""
    height, width = columns[0][1].shape[:2]
    sheet = Image.new("RGB", (GAP + len(columns) * (width + GAP), 3 * GAP + 2 * height + CAPTION), PAPER)
    pen = ImageDraw.Draw(sheet)
    for n, (caption, picture, error) in enumerate(columns):
        left = GAP + n * (width + GAP)
        sheet.paste(Image.fromarray(picture), (left, GAP))
        for line, text in enumerate(caption):
            face: Any = ImageFont.load_default(16 if line == 0 else 13)
            top = GAP + height + 3 + 16 * line + (5 if line else 0)
            pen.text((left + 2, top), text, DIM if line else INK, face)
        below = 2 * GAP + height + CAPTION
        if error is not None:
            sheet.paste(Image.fromarray(error), (left, below))
        else:
            _legend(sheet, pen, (left, below + height // 3), width, gain)
    return sheet


def _legend(sheet: Image.Image, pen: ImageDraw.ImageDraw, place: tuple[int, int], width: int, gain: float) -> None:
    """What the colours of the errors mean."""
    left, top = place
    small: Any = ImageFont.load_default(13)
    pen.text((left + 2, top), "error", INK, ImageFont.load_default(16))
    ramp = heat_colours(np.broadcast_to(np.linspace(0, 1, width - 40), (14, width - 40)))
    sheet.paste(Image.fromarray(ramp), (left + 2, top + 26))
    pen.text((left + 2, top + 44), "0", DIM, small)
    most = f"{100 / gain:.3g} % of white"
    pen.text((left + width - 38 - small.getlength(most), top + 44), most, DIM, small)


def main() -> None:
    """Read the command line and draw."""
    parser = argparse.ArgumentParser(description="Pictures like the paper's figures 5 to 9.")
    parser.add_argument("--output", type=Path, default=Path("gallery-output"), help="folder for the pictures")
    parser.add_argument("--data", type=Path, default=os.environ.get("HMKCTA_DATA"), help="folder of real data (.npz)")
    parser.add_argument("--only", help="draw this one only")
    wanted = parser.parse_args()
    figures = [*SYNTHETIC, *(real_figures(Path(wanted.data)) if wanted.data else [])]
    wanted.output.mkdir(parents=True, exist_ok=True)
    for figure in figures:
        if wanted.only in (None, figure.name):
            for path in draw(figure, wanted.output):
                sys.stdout.write(f"{path}\n")
                sys.stdout.flush()


if __name__ == "__main__":
    main()
