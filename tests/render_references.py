"""Reference pictures of the renderers: ``python tests/render_references.py`` makes them again, to be looked at."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "python"))

import hmkcta  # noqa: E402 - found through the path above
from hmkcta import synthetic  # noqa: E402
from hmkcta.render import Camera, Light, Look, Renderer, Scene, Surface, Tone, Viewpoint  # noqa: E402

FOLDER = Path(__file__).parent / "references"
SIZE = (64, 48)

#: Scenes by the names of their pictures, without the suffix; what comes before the first hyphen is the data.
SCENES = {
    "material-sphere": Scene(*SIZE, tone=Tone(white=0.5)),
    "material-cloth": Scene(*SIZE, surface=Surface("cloth", (2.0, 2.0)), tone=Tone(white=0.5, curve="filmic"),
                            lights=(Light(80, 35), Light(position=(0.5, -0.5, 1.5), colour=(0.4, 0.6, 1.0)))),
    "material-plane": Scene(*SIZE, surface=Surface("plane"), camera=Camera(25, 20), tone=Tone(white=0.4)),
    "lightfield-between": Scene(*SIZE, viewpoint=Viewpoint(0.4, 1.7, focus=0.5), time=0.5, tone=Tone(white=1.0)),
    "lightfield-aperture": Scene(*SIZE, viewpoint=Viewpoint(aperture=1.5, zoom=1.3), tone=Tone(white=1.0)),
    "volume-shaded": Scene(*SIZE, time=1.5, volume=Look(window=(0.0, 0.9))),
    "volume-iso": Scene(*SIZE, volume=Look("iso", "viridis", window=(0.0, 1.0), iso=0.3, clip_high=(1.0, 1.0, 0.7))),
    "volume-maximum": Scene(*SIZE, camera=Camera(-60, 40, 3.5), volume=Look("maximum", "ice", window=(0.0, 1.0))),
}


def originals() -> dict[str, synthetic.Dataset]:
    """The data that the scenes show."""
    return {"material": synthetic.material(16, 12, 24), "lightfield": synthetic.light_field(3, 32, 2),
            "volume": synthetic.volume((16, 16, 24), frames=3)}


def picture(name: str, data: dict[str, synthetic.Dataset]) -> NDArray[np.uint8]:
    """A picture of the data itself, so that nothing but the renderer decides about it."""
    shown = data[name.partition("-")[0]]
    coarse = hmkcta.compress(shown.values, "R=1", axes=shown.axes, kind=shown.kind, quality="fast")
    return Renderer(coarse, original=shown.values, backend="numpy").original_picture(SCENES[name])


if __name__ == "__main__":
    from hmkcta.render.outputs import save_picture

    FOLDER.mkdir(exist_ok=True)
    made = originals()
    for each in SCENES:
        save_picture(FOLDER / f"{each}.png", picture(each, made), overwrite=True)
