"""OpenEXR pictures: y, x, and a channel axis in the order R, G, B, A, then by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..labels import named
from ..support.natural import natural
from ..support.optional import library
from .heard import heard
from .source import Layout, check_layout, choose, guarded, io_error, opened
from .unpacked import Unpacker

MAGIC = b"\x76\x2f\x31\x01"
#: Channels of a layer come in this order, any others by name behind.
ORDER = "RGBAXYZUVW"


def open_exr(path: Path, member: str | None, unpacker: Unpacker) -> NDArray[Any]:
    """Open the channels of an EXR file, or those of a layer: ``file.exr:diffuse``; one channel has no axis for it.

    Raises:
        HmkctaError: OpenEXR is missing, the file is damaged, deep, of several parts, or has channels of several sizes.
    """
    exr = library("OpenEXR", "OpenEXR", "exr", "EXR")
    _check_parts(path)
    with guarded(path, "EXR file"), heard() as said:
        unpacker.check_widened(path, _widened(exr, path))
        file = exr.File(str(path), separate_channels=True)
        if not file.parts or "EXR_ERR" in said() or "Exception" in said():
            raise ValueError(said() or "no part")
        channels = {str(name): np.asarray(channel.pixels) for name, channel in file.channels().items()}
        names = _ordered(_layer(channels, str(path), member))
        sizes = {channels[name].shape for name in names}
        if len(sizes) != 1:
            found = ", ".join(" x ".join(map(str, size)) for size in sorted(sizes, reverse=True))
            raise io_error("source-format", str(path), f"channels of {found}", "channels of one size",
                           f"choose one by {path}:NAME, or resample them")
        picture = np.stack([channels[name] for name in names], axis=-1)
        check_layout(Layout(picture.shape, picture.dtype), str(path))
        if len(names) == 1:
            return named(picture[..., 0], ("y", "x"))
        return named(picture, ("y", "x", "rgb" if _is_colour(names) else "channel"))


def _widened(exr: Any, path: Path) -> int:
    """Bytes that the numbers of a file take, as its header says."""
    with exr.File(str(path), header_only=True) as file:
        header = file.parts[0].header
        low, high = (np.asarray(corner, np.int64) for corner in header["dataWindow"])
        return int(np.prod(np.maximum(high - low + 1, 1).astype(object))) * 4 * len(header["channels"])


def _check_parts(path: Path) -> None:
    """Refuse what the version field says is no single flat picture (OpenEXR file layout)."""
    with opened(path) as file:
        flags = int.from_bytes(file.read(8)[4:], "little")
    deep, parts = flags & 0x800, flags & 0x1000
    if deep:
        raise io_error("source-format", str(path), "a deep EXR picture, of any number of samples a pixel",
                       "flat pictures", "flatten it: oiiotool IN.exr --flatten -o OUT.exr")
    if parts:
        raise io_error("source-format", str(path), "an EXR file of several parts", "one part",
                       "write each part as a file: oiiotool IN.exr --subimage 0 -o OUT.exr")


def _is_colour(names: list[str]) -> bool:
    return [name.rpartition(".")[2].upper() for name in names] in ([*"RGB"], [*"RGBA"])


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
    >>> _ordered(["1000nm", "900nm", "l10.R", "l9.R"])
    ['900nm', '1000nm', 'l9.R', 'l10.R']
    """
    def key(name: str) -> tuple[Any, ...]:
        layer, _, channel = name.rpartition(".")
        colour = ORDER.find(channel.upper()) % (len(ORDER) + 1) if len(channel) == 1 else len(ORDER)
        return natural(layer), colour, natural(channel)

    return sorted(names, key=key)
