"""Pictures: y, x, and a channel axis where there are several; numbers as they are in the file, gamma-coded mostly.

Pillow decodes 8 bits a channel, imagecodecs all other depths, and PNG; what both would change is refused by name.
"""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import name_axes
from ..labels import with_axes
from ..support.optional import library
from . import netpbm
from .heard import heard
from .picture_header import FILMED, J2K, JP2, JPEG, JXL, JXL_BOX, PNG, RADIANCE, Header, header_of
from .source import Layout, check_layout, guarded, io_error, opened
from .unpacked import Unpacker

#: Told by their first bytes; others of Pillow's formats by their ending.
MAGICS = ((0, PNG), (0, JPEG), (0, b"GIF8"), (8, b"WEBP"), (0, JP2), (0, J2K), (0, JXL), (0, JXL_BOX), (0, b"DDS "),
          *FILMED, *netpbm.MAGICS, *((0, magic) for magic in RADIANCE))
ENDINGS = (".png", ".jpg", ".jpeg", ".gif", ".webp", ".jp2", ".j2k", ".jxl", ".avif", ".heic", ".dds",
           ".ppm", ".pgm", ".pbm", ".pnm", ".pam", ".pfm", ".hdr")
OTHER_ENDINGS = (".bmp", ".tga")
#: Pillow's names of the formats that it is let to take a file for.
_FORMATS = ("JPEG", "GIF", "WEBP", "DDS", "BMP", "TGA")
#: Its modes whose numbers are those of the file.
_MODES = ("1", "L", "LA", "RGB", "RGBA")
_WHOLE = "if nothing of it is missing, save it as PNG or TIFF"


def open_picture(path: Path, unpacker: Unpacker) -> NDArray[Any]:
    """Open a picture: numbers as the file has them; palettes are looked up, black and white is boolean.

    Raises:
        HmkctaError: Pillow or imagecodecs is missing, the file is damaged, an animation, or of a depth or in colours
            that neither library gives as they are.
    """
    pillow = library("PIL.Image", "pillow", "images", "pictures")
    with guarded(path, "picture", _WHOLE):
        data = _bytes(path)
        header = header_of(data, path.suffix.lower())
        if header.unread:
            raise _unread(path, header.unread)
        unpacker.check_widened(path, header.nbytes)
        if header.decoder == "netpbm":
            picture = netpbm.read_netpbm(path, data)
        elif header.decoder == "pillow":
            picture = _pixels(pillow, data, path, unpacker)
        else:
            codecs = library("imagecodecs", "imagecodecs", "images", f"{header.decoder.upper()} of {header.depth}")
            with heard() as said:
                picture = np.asarray(getattr(codecs, f"{header.decoder}_decode")(data))
                picture = _few_bits(picture, header)
                if "IDAT" in said() and "xtra" not in said():  # a checksum; other words are of tags
                    raise ValueError(said())
        check_layout(Layout(picture.shape, picture.dtype), str(path))
        if picture.ndim not in (2, 3):
            raise _unread(path, f"{len(picture)} pictures in one file")
        if header.exposure != 1:
            picture = picture / np.float32(header.exposure)
        names = ("y", "x", "rgb" if picture.shape[-1] in (3, 4) else "channel")[:picture.ndim]
        return with_axes(picture, name_axes(picture.shape, names), header.notes)


def picture_depth(path: Path) -> str:
    """The depth of a picture's numbers, of which a stack has one: ``12 bits``, ``0 to 1023``.

    Raises:
        HmkctaError: the file is damaged.
    """
    with guarded(path, "picture", _WHOLE):
        return header_of(_bytes(path), path.suffix.lower()).depth


def _bytes(path: Path) -> bytes:
    with opened(path) as file:
        return file.read()


def _unread(path: Path, what: str) -> Exception:
    advice = ("write each as a file, and open their folder" if "animation" in what or "pictures" in what
              else "save it as PNG or TIFF, in gray or RGB, of 8 or 16 bits a channel")
    return io_error("source-format", str(path), f"{what}, which is not read",
                    "a single picture in black and white, gray or RGB, with or without alpha", advice)


def _pixels(pillow: Any, data: bytes, path: Path, unpacker: Unpacker) -> NDArray[Any]:
    pillow.init()  # else it does not know all of these formats
    try:
        with warnings.catch_warnings():
            # Of tags that are not understood, and of pictures above 90 megapixels, which are what somebody may have.
            warnings.simplefilter("ignore")
            with pillow.open(io.BytesIO(data), formats=_FORMATS) as image:
                if getattr(image, "is_animated", False) and image.format in ("GIF", "WEBP"):
                    raise _unread(path, f"an animation of {image.n_frames} pictures")
                unpacker.check_widened(path, image.width * image.height * len(image.getbands()))
                clear = "transparency" in image.info or image.mode == "PA"
                if image.mode in ("P", "PA"):
                    image = image.convert("RGBA" if clear else "RGB")
                elif image.mode == "L" and clear:  # a GIF whose palette is gray
                    image = image.convert("LA")
                if image.mode not in _MODES:
                    raise _unread(path, f"a picture in {image.mode}")
                return np.asarray(image)
    except pillow.DecompressionBombError as error:
        raise io_error("source-too-large", str(path), error, "pictures that Pillow opens", "save it as TIFF") from error


def _few_bits(values: NDArray[Any], header: Header) -> NDArray[Any]:
    """The numbers of a PNG file of less than 8 bits, which the library spreads over 8."""
    if header.decoder != "png" or header.depth not in ("1 bit", "2 bits", "4 bits"):
        return values
    return values > 0 if header.depth == "1 bit" else values // np.uint8(85 if header.depth == "2 bits" else 17)
