"""Pictures by Pillow: y, x, and a channel axis where there are several; numbers as they are, gamma-coded mostly."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..support.optional import library
from .source import Layout, check_layout, guarded, io_error

PNG = b"\x89PNG\r\n\x1a\n"
#: Told by their first bytes; others of Pillow's formats by their ending.
MAGICS = ((0, PNG), (0, b"\xff\xd8\xff"), (0, b"GIF8"), (8, b"WEBP"))
ENDINGS = (".png", ".jpg", ".jpeg", ".gif", ".webp")
OTHER_ENDINGS = (".bmp", ".ppm", ".pgm", ".pnm", ".pfm", ".tga", ".jp2", ".avif", ".dds")


def open_picture(path: Path) -> NDArray[Any]:
    """Open a picture: uint8 or whatever it holds; palettes are looked up, black and white is boolean.

    Raises:
        HmkctaError: Pillow or imagecodecs is missing, the file is damaged, or is an animation.
    """
    pillow = library("PIL.Image", "pillow", "images", "pictures")
    with guarded(path, "picture"):
        if _is_deep_colour(path):
            codecs = library("imagecodecs", "imagecodecs", "images", "PNG of 16 bits and several channels")
            picture = np.asarray(codecs.png_decode(path.read_bytes()))
        else:
            picture = _pixels(pillow, path)
        check_layout(Layout(picture.shape, picture.dtype), str(path))
        return picture


def _pixels(pillow: Any, path: Path) -> NDArray[Any]:
    try:
        with warnings.catch_warnings():
            # Of pictures above 90 megapixels, which are what somebody may have; twice as large ones are refused.
            warnings.simplefilter("ignore", pillow.DecompressionBombWarning)
            with pillow.open(path) as image:
                if getattr(image, "is_animated", False) and image.format in ("GIF", "WEBP", "PNG"):
                    raise io_error("source-format", str(path), f"an animation of {image.n_frames} pictures",
                                   "a single picture", "write each as a file, and open their folder")
                if image.mode in ("P", "PA"):
                    clear = "transparency" in image.info or image.mode == "PA"
                    image = image.convert("RGBA" if clear else "RGB")
                return np.asarray(image)
    except pillow.DecompressionBombError as error:
        raise io_error("source-too-large", str(path), error, "pictures that Pillow opens", "save it as TIFF") from error


def _is_deep_colour(path: Path) -> bool:
    """Whether it is a PNG of 16 bits and several channels, of which Pillow would drop the lower 8."""
    with open(path, "rb") as file:
        start = file.read(26)
    return start.startswith(PNG) and len(start) == 26 and start[24] == 16 and start[25] in (2, 4, 6)
