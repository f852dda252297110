"""Make the pictures of the README from synthetic data: ``python docs/pictures/make_pictures.py`` (a minute)."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER.parent.parent / "python"))

from hmkcta import compress, pictures, synthetic  # noqa: E402 - found through the path above

#: Shares of the float32 bytes to show.
SHARES = (400, 200, 100)


def material(path: Path) -> Path:
    """The original of a brocade, what files of three sizes make of it, and their errors."""
    data = synthetic.material(16, 12, 64)
    rows: list[tuple[str, Any]] = []
    for share in SHARES:
        model = compress(data.values, axes=data.axes, size=data.nbytes // share, seed=0)
        label = f"{model.nbytes / 1024:.0f} KiB, {data.nbytes / model.nbytes:.0f} times smaller, {model.snr:.1f} dB"
        rows.append((label, pictures.slice_image(model, data.axes, data.kind)))
    original = pictures.slice_image(data.values, data.axes, data.kind)
    title = f"One of 192 pictures of a material, {data.nbytes / 2**20:.1f} MiB as float32"
    return pictures.comparison_sheet(original, rows, path, title=title, kind=data.kind)


if __name__ == "__main__":
    material(FOLDER / "material.png")
