"""OpenEXR pictures: y, x, and a channel axis in the order R, G, B, A, then by name."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..support.optional import library
from .source import Layout, check_layout, choose, guarded, io_error

MAGIC = b"\x76\x2f\x31\x01"
#: Channels of a layer come in this order, any others by name behind.
ORDER = "RGBAXYZUVW"


def open_exr(path: Path, member: str | None) -> NDArray[Any]:
    """Open the channels of an EXR file, or those of a layer: ``file.exr:diffuse``; one channel has no axis for it.

    Raises:
        HmkctaError: OpenEXR is missing, the file is damaged, deep, of several parts, or has channels of several sizes.
    """
    exr = library("OpenEXR", "OpenEXR", "exr", "EXR")
    said = StringIO()  # the library prints what it cannot decode, and goes on without
    with guarded(path, "EXR file"), redirect_stdout(said), exr.File(str(path), separate_channels=True) as file:
        if not file.parts:
            raise ValueError(said.getvalue())
        if len(file.parts) != 1:
            raise io_error("source-format", str(path), f"{len(file.parts)} parts", "one part", "write one part a file")
        channels = {str(name): np.asarray(channel.pixels) for name, channel in file.channels().items()}
        names = _ordered(_layer(channels, str(path), member))
        sizes = {channels[name].shape for name in names}
        if len(sizes) != 1:
            found = ", ".join(" x ".join(map(str, size)) for size in sorted(sizes, reverse=True))
            raise io_error("source-format", str(path), f"channels of {found}", "channels of one size",
                           f"choose one by {path}:NAME, or resample them")
        picture = np.stack([channels[name] for name in names], axis=-1)
        check_layout(Layout(picture.shape, picture.dtype), str(path))
        return picture if len(names) > 1 else picture[..., 0]


def _layer(channels: dict[str, NDArray[Any]], where: str, member: str | None) -> list[str]:
    if member is None:
        return list(channels)
    layers = {name: "" for channel in channels for name in (channel, channel.rpartition(".")[0]) if name}
    wanted = choose(where, layers, member)
    return [name for name in channels if name == wanted or name.startswith(f"{wanted}.")]


def _ordered(names: list[str]) -> list[str]:
    """Names by layer, the one without a name first, and colours in their order.

    >>> _ordered(["A", "B", "G", "R", "Z", "depth", "diffuse.B", "diffuse.R"])
    ['R', 'G', 'B', 'A', 'Z', 'depth', 'diffuse.R', 'diffuse.B']
    """
    def key(name: str) -> tuple[str, int, str]:
        layer, _, channel = name.rpartition(".")
        return layer, ORDER.find(channel.upper()) % (len(ORDER) + 1) if len(channel) == 1 else len(ORDER), channel

    return sorted(names, key=key)
