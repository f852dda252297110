"""Pictures and films as files: PNG, EXR (radiance), MP4 and GIF; none is ever half there."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from ..errors import invalid
from ..hmkfile import published
from ..support.optional import library

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

STILLS, FILMS = (".png", ".exr"), (".mp4", ".gif")
QUALITY = 8  # of MP4, 0 to 10: hardly to be told from the frames


def check_format(path: str | Path) -> str:
    """The suffix of an output, one of `STILLS` or `FILMS`.

    >>> check_format("frame.PNG")
    '.png'

    Raises:
        HmkctaError: another suffix.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (*STILLS, *FILMS):
        raise invalid("output-format", "output", repr(str(path)), f"a name that ends with {', '.join(STILLS + FILMS)}")
    return suffix


def save_picture(path: str | Path, picture: U8, overwrite: bool = False) -> None:
    """Write a picture ``[height, width, 3]`` as PNG.

    Raises:
        HmkctaError: Pillow is missing, or the file is there already or cannot be written.
    """
    image = library("PIL.Image", "pillow", "render", "output")
    with published(path, overwrite) as target:
        image.fromarray(picture).save(target, format="PNG")


def save_radiance(path: str | Path, radiance: F32, overwrite: bool = False) -> None:
    """Write radiance and coverage ``[height, width, 4]`` as EXR, float32, channels R, G, B, A.

    Raises:
        HmkctaError: OpenEXR is missing, or the file is there already or cannot be written.
    """
    exr = library("OpenEXR", "OpenEXR", "exr", "output")
    header = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    with TemporaryDirectory() as folder, published(path, overwrite) as target:
        name = str(Path(folder) / "radiance.exr")
        with exr.File(header, {"RGBA": np.ascontiguousarray(radiance, np.float32)}) as file:
            file.write(name)
        target.write(Path(name).read_bytes())


def film_size(path: str | Path, width: int, height: int) -> tuple[int, int]:
    """Width and height of a film of such frames: of an MP4 they are even, as its encoder has it.

    >>> film_size("orbit.mp4", 41, 30), film_size("orbit.gif", 41, 30)
    ((40, 30), (41, 30))

    Raises:
        HmkctaError: the suffix is of nothing that is written.
    """
    if check_format(path) != ".mp4":
        return width, height
    return max(2, width // 2 * 2), max(2, height // 2 * 2)


def save_film(path: str | Path, frames: Iterable[U8], fps: float = 25.0, overwrite: bool = False) -> int:
    """Write pictures ``[height, width, 3]`` of one size as MP4 (H.264) or GIF, by the path's suffix; their number.

    An MP4 has even sides (`film_size`): an odd last row or column is left out, a single one written twice.

    Raises:
        HmkctaError: there is no frame, a package is missing, or the file is there already or cannot be written.
    """
    writer = _write_gif if check_format(path) == ".gif" else _write_mp4
    with TemporaryDirectory() as folder, published(path, overwrite) as target:
        name = Path(folder) / f"film{Path(path).suffix.lower()}"
        count = writer(name, iter(frames), fps)
        if not count:
            raise invalid("no-frames", "frames", 0, "one or more")
        target.write(name.read_bytes())
    return count


def _write_mp4(path: Path, frames: Iterator[U8], fps: float) -> int:
    ffmpeg = library("imageio_ffmpeg", "imageio-ffmpeg", "video", "output")
    count, film = 0, None
    try:
        for frame in frames:
            width, height = film_size(path, frame.shape[1], frame.shape[0])
            even = frame[:height, :width].repeat(height // min(height, frame.shape[0]), axis=0)
            even = even.repeat(width // min(width, frame.shape[1]), axis=1)
            if film is None:
                film = ffmpeg.write_frames(str(path), (width, height), fps=fps, codec="libx264", quality=QUALITY,
                                           macro_block_size=1, pix_fmt_out="yuv420p", ffmpeg_log_level="error")
                film.send(None)
            film.send(np.ascontiguousarray(even).tobytes())
            count += 1
    finally:
        if film is not None:
            film.close()
    return count


def _write_gif(path: Path, frames: Iterator[U8], fps: float) -> int:
    image = library("PIL.Image", "pillow", "render", "output")
    pictures = [image.fromarray(frame) for frame in frames]
    if pictures:
        pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=round(1000 / fps), loop=0)
    return len(pictures)
