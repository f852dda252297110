"""What the headers of pictures say before they are decoded: size, depth, and what no library here decodes as it is.

Pillow's modes have 8 bits a channel for colours, and what has others it rescales or cuts without a word. So the header
says who decodes: Pillow what has 8 bits, imagecodecs all other depths, nobody what both would change.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from math import isfinite, prod

from . import netpbm

PNG = b"\x89PNG\r\n\x1a\n"
JPEG = b"\xff\xd8\xff"
JP2, J2K = b"\0\0\0\x0cjP  \r\n\x87\n", b"\xff\x4f\xff\x51"
JXL, JXL_BOX = b"\xff\x0a", b"\0\0\0\x0cJXL \r\n\x87\n"
RADIANCE = (b"#?RADIANCE", b"#?RGBE")
_RADIANCE_SIZE = re.compile(rb"-Y\s+([0-9]{1,9})\s+\+X\s+([0-9]{1,9})[ \t]*\n")
#: Pictures coded as films are: AVIF, which is read, and HEIF.
_BRANDS = (b"avif", b"avis", b"mif1", b"msf1", b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx")
FILMED = tuple((4, b"ftyp" + brand) for brand in _BRANDS)

#: Formats of Direct3D (DXGI_FORMAT) of 8 bits a channel: BC1 to BC4 without sign, BC7, and plain ones.
_DXGI = {*range(70, 81), 97, 98, 99, 27, 28, 29, 87, 88, 91, 93}
_FOURCC = (b"DXT1", b"DXT3", b"DXT5", b"ATI1", b"BC4U")
#: Colour spaces that a JPEG 2000 file may name (ISO 15444-1): sRGB and gray; the others would need to be converted.
_SPACES = {12: "CMYK", 14: "CIELab", 18: "YCC"}


@dataclass(frozen=True)
class Header:
    """What a picture's header says.

    Attributes:
        decoder: ``"pillow"``, ``"netpbm"``, or the word that begins the name of imagecodecs' function.
        depth: bits of a number, or another word for it; pictures of a stack have the same.
        nbytes: bytes that its numbers take, about, where imagecodecs decodes them.
        unread: what it is that is not decoded here; empty: it is.
        exposure: what radiances were multiplied with before they were stored.
        notes: sentences on what of it is not applied.
    """

    decoder: str
    depth: str
    nbytes: int = 0
    unread: str = ""
    exposure: float = 1.0
    notes: tuple[str, ...] = ()


def header_of(data: bytes, ending: str) -> Header:
    """The header of a file's bytes; `ending` is that of its name, for formats without magic bytes.

    >>> header_of(b"P5 2 2 4095 ........", ".pgm").depth
    '0 to 4095'

    Raises:
        ValueError, IndexError, struct.error: it is damaged.
    """
    for magic, read in ((PNG, _png), (JPEG, _jpeg), (JP2, _jpeg2k), (J2K, _jpeg2k), (JXL, _jxl), (JXL_BOX, _jxl),
                        (b"DDS ", _dds), (b"BM", _bmp), *((magic, _radiance) for magic in RADIANCE)):
        if data.startswith(magic):
            return read(data)
    if any(data.startswith(magic, at) for at, magic in FILMED):
        return _filmed(data)
    if any(data.startswith(magic, at) for at, magic in netpbm.MAGICS):
        found = netpbm.header_of(data)
        note = (f"the scale {found.scale:g} in its header is not applied, as some writers use it for display alone. "
                "Next: multiply by it, if it is meant")
        return Header("netpbm", f"0 to {found.most}" if found.most else "floats",
                      notes=() if found.scale == 1 else (note,))
    return _tga(data) if ending == ".tga" else Header("pillow", "8 bits")


def _bits(count: int) -> str:
    return "1 bit" if count == 1 else f"{count} bits"


def _png(data: bytes) -> Header:
    columns, rows, bits, colours = struct.unpack_from(">IIBB", data, 16)
    frames = "an animation" if b"acTL" in data[:data.find(b"IDAT")] else ""
    depth = "8 bits" if colours == 3 else _bits(bits)  # a palette has 8
    channels = (1, 1, 3, 3, 2, 2, 4, 4)[colours & 7]
    return Header("png", depth, rows * columns * channels * (2 if bits == 16 else 1), frames)


def _jpeg(data: bytes) -> Header:
    """The first frame header says precision and process (ISO 10918-1, B.2.2)."""
    at = 2
    while True:
        at = data.index(b"\xff", at)
        marker = data[at + 1]
        if marker in (0x00, 0xFF, 0x01) or 0xD0 <= marker <= 0xD8:
            at += 1
            continue
        if marker == 0xF7 or (0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC)):
            break
        at += 2 + int.from_bytes(data[at + 2:at + 4], "big")
    bits, rows, columns, channels = struct.unpack_from(">BHHB", data, at + 4)
    unread = ("JPEG-LS" if marker == 0xF7 else "a JPEG in CMYK" if channels == 4
              else f"a JPEG of {channels} channels" if channels not in (1, 3) else "")
    lossless = marker in (0xC3, 0xC7, 0xCB, 0xCF)
    decoder = "jpeg8" if lossless or bits != 8 else "pillow"
    return Header(decoder, _bits(bits), rows * columns * channels * (2 if bits > 8 else 1), unread)


def _jpeg2k(data: bytes) -> Header:
    """The codestream says precision and sampling of each channel (ISO 15444-1, A.5.1), boxes before it the colours."""
    at = data.index(J2K)
    right, down, left, top = struct.unpack_from(">4I", data, at + 8)
    channels = struct.unpack_from(">H", data, at + 40)[0]
    each = {data[at + 42 + 3 * n:at + 45 + 3 * n] for n in range(channels)}
    found = data.find(b"colr\x01", 0, at)
    space = struct.unpack_from(">I", data, found + 7)[0] if found >= 0 else 16
    unread = ("JPEG 2000 of channels that differ in size or depth" if len(each) > 1
              else "JPEG 2000 with a palette" if b"pclr" in data[:at]
              else f"JPEG 2000 in {_SPACES[space]}" if space in _SPACES else "")
    size = min(each)
    if not unread and size[1:] != b"\1\1":
        unread = "JPEG 2000 of subsampled channels"
    depth = _bits((size[0] & 0x7F) + 1) + (", signed" if size[0] & 0x80 else "")
    return Header("jpeg2k", depth, (right - left) * (down - top) * channels * (1 if size[0] & 0x7F < 8 else 2),
                  unread)


def _filmed(data: bytes) -> Header:
    """Boxes say the size and how the numbers are coded (AV1 in ISOBMFF, 2.3.3)."""
    if b"avi" not in data[8:int.from_bytes(data[:4], "big")]:
        return Header("heif", "", unread="HEIF (for which there is heif-convert)")
    flags = data[data.index(b"av1C") + 6]
    bits = (12 if flags & 0x20 else 10) if flags & 0x40 else 8
    columns, rows = struct.unpack_from(">II", data, data.index(b"ispe") + 8)
    return Header("avif", _bits(bits), rows * columns * (3 if bits == 8 else 6),
                  "an animation" if data[8:12] == b"avis" else "")


class _Bits:
    """Bits of a JPEG XL header, low ones first."""

    def __init__(self, data: bytes) -> None:
        self._value = int.from_bytes(data, "little")

    def take(self, count: int) -> int:
        """The next bits as a number."""
        found = self._value & ((1 << count) - 1)
        self._value >>= count
        return found

    def choice(self, *ways: tuple[int, int]) -> int:
        """A number written in one of four ways: a constant, and bits to be added."""
        least, count = ways[self.take(2)]
        return least + self.take(count)


def _jxl(data: bytes) -> Header:
    """The codestream begins with size and depth (ISO 18181-1, D.2 and D.3)."""
    if data.startswith(JXL_BOX):
        found = re.search(rb"jxlc|jxlp....", data, re.DOTALL)
        if found is None:
            raise ValueError("no codestream")
        data = data[found.end():found.end() + 64]
    bits = _Bits(data[2:64])
    columns, rows = _jxl_size(bits)
    depth, unread = "8 bits", ""
    if not bits.take(1):  # what is not said is 8 bits
        if bits.take(1):
            bits.take(3)
            if bits.take(1):
                _jxl_size(bits)
            unread = "a picture with a preview" if bits.take(1) else "an animation" if bits.take(1) else ""
        if not unread:
            floats = bits.take(1)
            depth = (f"floats of {_bits(bits.choice((32, 0), (16, 0), (24, 0), (1, 6)))}" if floats
                     else _bits(bits.choice((8, 0), (10, 0), (12, 0), (1, 6))))
    return Header("jpegxl", depth, rows * columns * (3 if depth == "8 bits" else 6), unread)


def _jxl_size(bits: _Bits) -> tuple[int, int]:
    small = bits.take(1)

    def side() -> int:
        return 8 * (1 + bits.take(5)) if small else bits.choice((1, 9), (1, 13), (1, 18), (1, 30))

    rows = side()
    ratio = bits.take(3)
    across, down = ((1, 1), (1, 1), (12, 10), (4, 3), (3, 2), (16, 9), (5, 4), (2, 1))[ratio]
    return side() if ratio == 0 else rows * across // down, rows


def _dds(data: bytes) -> Header:
    """Textures: those that Pillow decodes to 8 bits because they are."""
    flags, code, bits, *masks = struct.unpack_from("<I4s5I", data, 80)
    more = struct.unpack_from("<I", data, 112)[0]
    if more & 0x200200:
        unread = "a cube map" if more & 0x200 else "a volume"
    elif code == b"DX10" and flags & 4:
        kind, dimension, misc, count = struct.unpack_from("<4I", data, 128)
        plain = kind in _DXGI and dimension == 3 and not misc & 4 and count <= 1
        unread = "" if plain else "BC6H" if kind in (94, 95, 96) else f"DXGI format {kind}"
    elif flags & 4:
        unread = "" if code in _FOURCC else code.decode("ascii", "replace")
    else:
        whole = all(mask.bit_count() in (0, 8) for mask in masks)
        unread = "" if whole and bits in (8, 16, 24, 32) else f"{bits} bits a pixel"
    return Header("pillow", "8 bits", unread=unread and f"a DDS texture of another kind: {unread}")


def _bmp(data: bytes) -> Header:
    short = struct.unpack_from("<I", data, 14)[0] == 12
    bits = struct.unpack_from("<HHHH" if short else "<iiHH", data, 18)[3]
    unread = "a BMP of 16 bits a pixel, 5 or 6 a channel" if bits == 16 else ""
    if bits == 32 and struct.unpack_from("<I", data, 30)[0] in (3, 6):
        masks = struct.unpack_from("<3I", data, 54)
        unread = "" if all(mask.bit_count() == 8 for mask in masks) else "a BMP of other than 8 bits a channel"
    return Header("pillow", "1 bit" if bits == 1 else "8 bits", unread=unread)


def _radiance(data: bytes) -> Header:
    """Lines of text say how radiances are stored; the last one how large the picture is (Radiance, picture format)."""
    lines = data[:data.index(b"\n\n")].split(b"\n")
    fields = [line.partition(b"=") for line in lines if not line.startswith(b"#")]
    exposure = prod(float(value) for name, _, value in fields if name == b"EXPOSURE")
    kind = next((value.strip() for name, _, value in fields if name == b"FORMAT"), b"")
    size = _RADIANCE_SIZE.match(data, data.index(b"\n\n") + 2)
    unread = "" if kind == b"32-bit_rle_rgbe" else f"Radiance HDR of {kind.decode('ascii', 'replace') or 'no format'}"
    if size is None and not unread:
        unread = "Radiance HDR whose rows do not come from the top, left to right"
    if not (isfinite(exposure) and exposure > 0):
        raise ValueError(f"an exposure of {exposure}")
    rows, columns = (int(size[1]), int(size[2])) if size else (0, 0)
    return Header("rgbe", "floats", 12 * rows * columns, unread, exposure)


def _tga(data: bytes) -> Header:
    palette, bits = data[7], data[16]
    few = bits in (15, 16) and data[2] not in (3, 11)  # gray of 16 bits has alpha
    unread = "a TGA of 5 bits a channel" if few or (data[1] and palette in (15, 16)) else ""
    return Header("pillow", "8 bits", unread=unread)
