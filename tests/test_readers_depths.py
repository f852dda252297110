"""Pictures of every depth keep their numbers, as the field's libraries have them, or are refused by name."""

from __future__ import annotations

import importlib.util
import io
import itertools
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hmkcta.errors import HmkctaError
from hmkcta.labels import labels_of
from hmkcta.readers import open_array
from reader_tools import needed, refusal, same

SHAPES = [(4, 5), (4, 5, 2), (4, 5, 3), (4, 5, 4)]
#: PNG's colour types by the number of channels.
COLOUR_TYPES = {1: 0, 2: 4, 3: 2, 4: 6}


def numbers(bits: int, shape: tuple[int, ...] = (4, 5, 3), signed: bool = False) -> NDArray[Any]:
    """Numbers of so many bits, the least and the largest among them."""
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    values = np.random.default_rng(bits).integers(low, high, shape, endpoint=True)
    values.flat[:2] = low, high
    return values.astype(f"{'i' if signed else 'u'}{1 if bits <= 8 else 2}")


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(values: NDArray[Any], bits: int, colours: int, clear: bytes = b"", before: bytes = b"") -> bytes:
    """A PNG file of any depth, which no library here writes."""
    rows = b""
    for row in values.reshape(len(values), -1):
        text = "".join(format(int(number), f"0{bits}b") for number in row)
        rows += b"\0" + int(text.ljust(-(-len(text) // 8) * 8, "0"), 2).to_bytes(-(-len(text) // 8), "big")
    head = struct.pack(">IIBBBBB", values.shape[1], values.shape[0], bits, colours, 0, 0, 0)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + before + (chunk(b"tRNS", clear) if clear else b"")
            + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def put(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("bits", [1, 2, 4, 8, 16])
def test_png_of_every_depth(tmp_path: Path, bits: int) -> None:
    needed("imagecodecs")
    for shape in SHAPES if bits >= 8 else SHAPES[:1]:
        values = numbers(bits, shape)
        channels = shape[2] if len(shape) > 2 else 1
        same(put(tmp_path / "a.png", png(values, bits, COLOUR_TYPES[channels])), values > 0 if bits == 1 else values)


@pytest.mark.parametrize("bits", [1, 2, 4, 8, 16])
def test_png_has_as_many_rows_as_it_says(tmp_path: Path, bits: int) -> None:
    needed("imagecodecs")
    palette = chunk(b"PLTE", bytes(range(255, 255 - 3 * min(1 << bits, 85), -1)))
    for colours in {1: (0, 3), 2: (0, 3), 4: (0, 3), 8: (0, 2, 3), 16: (0, 2)}[bits]:
        values = numbers(min(bits, 6) if colours == 3 else bits, (8, 5, 3) if colours == 2 else (8, 5))
        data = png(values, bits, colours, before=palette if colours == 3 else b"")
        open_array(put(tmp_path / "a.png", data))
        for rows in (9, 7, 1):  # of which there are too few, or too many
            head = struct.pack(">IIBBBBB", 5, rows, bits, colours, 0, 0, 0)
            said = data[:8] + chunk(b"IHDR", head) + data[33:]
            assert refusal(put(tmp_path / "a.png", said)).reason == "source-damaged", (colours, rows)


def test_a_gray_palette_with_a_clear_number(tmp_path: Path) -> None:
    values = numbers(8, (30, 20))
    needed("PIL.Image").fromarray(values).save(tmp_path / "a.gif", optimize=False, transparency=7)
    same(tmp_path / "a.gif", np.stack([values, np.where(values == 7, 0, 255).astype("u1")], axis=2))


@pytest.mark.parametrize("bits", [1, 2, 4, 8, 16])
def test_a_number_that_is_clear_makes_an_alpha_channel(tmp_path: Path, bits: int) -> None:
    needed("imagecodecs")
    for shape in SHAPES[:3:2] if bits >= 8 else SHAPES[:1]:
        values = numbers(bits, shape)
        key = values[1, 1]
        alpha = (values != key).reshape(4, 5, -1).any(axis=2) * ((1 << bits) - 1)
        expected = np.concatenate([values.reshape(4, 5, -1), alpha[..., None]], axis=2)
        data = png(values, bits, 0 if len(shape) == 2 else 2, np.atleast_1d(key).astype(">u2").tobytes())
        assert np.array_equal(open_array(put(tmp_path / "a.png", data)), expected)


def test_palettes_are_looked_up_whatever_the_format(tmp_path: Path) -> None:
    pillow, tifffile = needed("PIL.Image"), needed("tifffile")
    indices = numbers(8, (4, 5))
    image = pillow.fromarray(indices)
    image.putpalette(numbers(8, (256, 3)).tobytes())
    colours = np.asarray(image.convert("RGB"))
    for ending in ("png", "gif", "bmp", "tga", "tif"):
        image.save(tmp_path / f"a.{ending}")
        assert np.array_equal(open_array(tmp_path / f"a.{ending}"), colours), ending
    image.save(tmp_path / "b.png", transparency=int(indices[0, 0]))
    assert np.array_equal(open_array(tmp_path / "b.png")[..., 3], np.where(indices == indices[0, 0], 0, 255))
    deep = numbers(16, (3, 256))
    tifffile.imwrite(tmp_path / "c.tif", np.stack([indices, indices[::-1]]), photometric="palette", colormap=deep,
                     compression="zlib")
    same(tmp_path / "c.tif", deep.T[np.stack([indices, indices[::-1]])])


def netpbm(values: NDArray[Any], most: int) -> Iterator[tuple[str, bytes]]:
    """All of Netpbm's forms of a picture."""
    rows, columns, channels = *values.shape[:2], values.shape[2] if values.ndim > 2 else 1
    raw = values.astype(">u2" if most > 255 else "u1").tobytes()
    text = b" ".join(b"%d" % number for number in values.reshape(-1).tolist())
    if channels in (1, 3):
        ending, letter = ("pgm", 0) if channels == 1 else ("ppm", 1)
        head = b"# by hand\n%d %d\n%d\n" % (columns, rows, most)
        yield ending, b"P%d\n" % (5 + letter) + head + raw
        yield ending, b"P%d\n" % (2 + letter) + head + text
    yield "pam", b"P7\nWIDTH %d\nHEIGHT %d\nDEPTH %d\nMAXVAL %d\nENDHDR\n" % (columns, rows, channels, most) + raw


@pytest.mark.parametrize("most", [2, 15, 100, 255, 256, 1023, 4095, 65535])
def test_netpbm_of_every_depth(tmp_path: Path, most: int) -> None:
    for shape in SHAPES:
        values = np.random.default_rng(most).integers(0, most, shape, endpoint=True)
        for ending, data in netpbm(values, most):
            same(put(tmp_path / f"a.{ending}", data), values.astype("u2" if most > 255 else "u1"))


def test_black_and_white_and_floats_of_netpbm(tmp_path: Path) -> None:
    ink = numbers(1, (4, 11))
    same(put(tmp_path / "a.pbm", b"P4\n11 4\n" + np.packbits(ink, axis=1).tobytes()), ink == 0)
    same(put(tmp_path / "b.pbm", b"P1\n11 4\n" + "".join(map(str, ink.ravel().tolist())).encode()), ink == 0)
    for shape, order in itertools.product([(4, 5), (4, 5, 3)], "<>"):
        floats = np.random.default_rng(0).normal(size=shape).astype("f4")
        head = b"P%s\n5 4\n%s1.0\n" % (b"F" if len(shape) > 2 else b"f", b"-" if order == "<" else b"")
        same(put(tmp_path / "a.pfm", head + floats[::-1].astype(f"{order}f4").tobytes()), floats)


def radiance(values: NDArray[np.float32], fields: bytes = b"", rle: bool = True) -> bytes:
    """A Radiance picture whose header has more fields."""
    head = b"#?RADIANCE\n# of a test\n%sFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (fields, *values.shape[:2])
    whole: bytes = needed("imagecodecs").rgbe_encode(values, header=rle, rle=rle)  # by runs it writes none without one
    return head + (whole.split(b"\n\n", 1)[1].split(b"\n", 1)[1] if rle else whole)


@pytest.mark.parametrize("rle", [False, True])
def test_radiance_pictures_are_radiances(tmp_path: Path, rle: bool) -> None:
    values = np.repeat(np.random.default_rng(0).random((6, 3, 3), np.float32) * np.float32(1000), 3, axis=1)
    stored = needed("imagecodecs").rgbe_decode(radiance(values, rle=rle))
    assert np.allclose(stored, values, atol=5)
    same(put(tmp_path / "a.hdr", radiance(values, rle=rle)), stored)
    fields = b"EXPOSURE=4.0\nSOFTWARE=ours\nEXPOSURE=0.5\n"  # which multiply
    same(put(tmp_path / "b.hdr", radiance(values, fields, rle)), stored / 2)
    assert open_array(f"{tmp_path}/*.hdr").shape == open_array(tmp_path).shape == (2, 6, 9, 3)
    whole = radiance(values, rle=rle)
    for data in (whole[:-1], whole + b"\0", whole[:30]):
        assert refusal(put(tmp_path / "a.hdr", data)).reason == "source-damaged"


@pytest.mark.parametrize(("change", "reason", "said"), [
    ((b"rle_rgbe", b"rle_xyze"), "source-format", "xyze"), ((b"-Y 6 +X", b"+Y 6 +X"), "source-format", "rows"),
    ((b"-Y 6 +X 9", b"+X 9 -Y 6"), "source-format", "rows"),
    ((b"FORMAT=32-bit_rle_rgbe\n", b""), "source-format", "no format"),
    ((b"-Y 6", b"-Y 600000000"), "source-too-large", "MiB"), ((b"# of", b"EXPOSURE=0\n# of"), "source-damaged", "0.0"),
    ((b"# of", b"EXPOSURE=dark\n# of"), "source-damaged", "dark"),
])
def test_radiance_pictures_that_are_refused(tmp_path: Path, change: tuple[bytes, bytes], reason: str, said: str
                                            ) -> None:
    whole = radiance(np.ones((6, 9, 3), np.float32))
    assert change[0] in whole
    error = refusal(put(tmp_path / "a.hdr", whole.replace(*change)))
    assert error.reason == reason
    assert said in str(error)


def test_a_scale_of_floats_is_said_not_applied(tmp_path: Path) -> None:
    floats = np.arange(20, dtype="<f4").reshape(4, 5)
    for scale, count in ((b"-1.0", 0), (b"-0.003922", 1)):
        array = open_array(put(tmp_path / "a.pfm", b"Pf\n5 4\n%s\n" % scale + floats[::-1].tobytes()))
        assert np.array_equal(array, floats)
        notes = labels_of(array).notes
        assert len(notes) == count
        assert all("0.003922" in note for note in notes)


@pytest.mark.parametrize(("data", "reason"), [
    (b"P5\n5 4\n255\n" + bytes(19), "source-truncated"), (b"P5\n5 4\n255\n" + bytes(21), "source-too-long"),
    (b"P2\n2 2\n255\n1 2 3", "source-truncated"), (b"P5\n2 2\n3\n\1\2\3\4", "source-damaged"),
    (b"P2\n2 2\n3\n1 2 3 -1", "source-damaged"), (b"P5\n2 2\n70000\n" + bytes(8), "source-damaged"),
    (b"P5\n999999999 999999999\n255\n" + bytes(8), "source-truncated"), (b"P6\n2", "source-damaged")])
def test_netpbm_that_is_not_what_it_says(tmp_path: Path, data: bytes, reason: str) -> None:
    assert refusal(put(tmp_path / "a.pgm", data)).reason == reason


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("bits", [1, 4, 8, 10, 12, 15, 16])
def test_jpeg_2000_of_every_depth(tmp_path: Path, bits: int, signed: bool) -> None:
    codecs = needed("imagecodecs")
    for shape, kind in itertools.product(SHAPES, ["jp2", "j2k"]):
        if signed and bits < 8:
            continue
        values = numbers(bits, shape, signed)
        data = codecs.jpeg2k_encode(values, level=0, reversible=True, bitspersample=bits, codecformat=kind)
        same(put(tmp_path / f"a.{kind}", data), values)


@pytest.mark.parametrize("bits", [8, 10, 12])
def test_avif_of_every_depth(tmp_path: Path, bits: int) -> None:
    codecs = needed("imagecodecs")
    for shape in (SHAPES[0], *SHAPES[2:]):
        values = numbers(bits, shape)
        data = codecs.avif_encode(values, level=100, bitspersample=bits)
        same(put(tmp_path / "a.avif", data), codecs.avif_decode(data))
        assert np.array_equal(codecs.avif_decode(data), values)


@pytest.mark.parametrize("bits", [1, 4, 8, 10, 12, 16])
def test_jpeg_xl_of_every_depth(tmp_path: Path, bits: int) -> None:
    codecs = needed("imagecodecs")
    for shape in SHAPES:
        values = numbers(bits, shape)
        data = codecs.jpegxl_encode(values, lossless=True, bitspersample=bits)
        same(put(tmp_path / "a.jxl", data), values)
    floats = np.random.default_rng(0).random((4, 5, 3)).astype("f2" if bits < 8 else "f4") * 3
    same(put(tmp_path / "a.jxl", codecs.jpegxl_encode(floats, lossless=True)), floats)


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_jpeg_of_every_depth(tmp_path: Path, bits: int) -> None:
    codecs = needed("imagecodecs")
    for shape, lossless in itertools.product([(16, 16), (16, 16, 3)], [False, True]):
        if bits == 16 and not lossless:
            continue
        data = codecs.jpeg8_encode(numbers(bits, shape), level=95, bitspersample=bits, lossless=lossless)
        same(put(tmp_path / "a.jpg", data), codecs.jpeg8_decode(data))


def test_tiff_of_every_depth(tmp_path: Path) -> None:
    tifffile = needed("tifffile")
    for bits in (1, 8, 10, 12, 14, 16):
        values = numbers(bits, (4, 8))
        tifffile.imwrite(tmp_path / "a.tif", values > 0 if bits == 1 else values, bitspersample=bits,
                         photometric="minisblack")
        same(tmp_path / "a.tif", tifffile.imread(tmp_path / "a.tif"), mapped=bits in (8, 16))
        assert np.array_equal(open_array(tmp_path / "a.tif"), values), bits
    few = np.zeros((4, 5, 3), np.uint8)
    tifffile.imwrite(tmp_path / "b.tif", few, photometric="rgb")
    data = bytearray((tmp_path / "b.tif").read_bytes())
    at = data.index(struct.pack("<3H", 8, 8, 8))
    data[at:at + 6] = struct.pack("<3H", 5, 6, 5)
    assert "5, 6, 5 bits" in str(refusal(put(tmp_path / "b.tif", bytes(data))))


@pytest.mark.parametrize(("other", "said"), [
    (("pgm", b"P5\n5 4\n1023\n" + bytes(40)), "0 to 1023"), (("png", png(numbers(2, (4, 5)), 2, 0)), "2 bits")])
def test_a_stack_has_one_depth(tmp_path: Path, other: tuple[str, bytes], said: str) -> None:
    ending, data = other
    whole = {"pgm": b"P5\n5 4\n4095\n" + bytes(40), "png": png(numbers(8, (4, 5)), 8, 0)}[ending]
    put(tmp_path / f"1.{ending}", whole)
    put(tmp_path / f"2.{ending}", data)
    for uri in (tmp_path, f"{tmp_path}/*.{ending}"):
        error = refusal(uri)
        assert error.reason == "series-mixed"
        assert said in str(error)


def test_stacks_of_other_formats_have_one_depth(tmp_path: Path) -> None:
    codecs, tifffile = needed("imagecodecs"), needed("tifffile")
    for bits in (10, 12):
        values = numbers(bits, (4, 8))
        put(tmp_path / f"{bits}.jp2", codecs.jpeg2k_encode(values, level=0, bitspersample=bits))
        put(tmp_path / f"{bits}.avif", codecs.avif_encode(values, level=100, bitspersample=bits))
        put(tmp_path / f"{bits}.jxl", codecs.jpegxl_encode(values, lossless=True, bitspersample=bits))
        tifffile.imwrite(tmp_path / f"{bits}.tif", values, bitspersample=bits)
    for ending in ("jp2", "avif", "jxl", "tif"):
        error = refusal(f"{tmp_path}/*.{ending}")
        assert (error.reason, error.found) == ("series-mixed", "numbers of 12 bits"), ending


def dds(code: bytes, tail: bytes) -> bytes:
    head = struct.pack("<7I", 124, 0x1007, 4, 4, 16, 0, 0) + bytes(44)
    pixels = struct.pack("<2I4s5I", 32, 4, code, 0, 0, 0, 0, 0)
    return b"DDS " + head + pixels + struct.pack("<5I", 0x1000, 0, 0, 0, 0) + tail


def bmp(bits: int) -> bytes:
    body = bytes(4 * 4 * bits // 8)
    return (b"BM" + struct.pack("<IHHI", 54 + len(body), 0, 0, 54)
            + struct.pack("<IiiHHIIiiII", 40, 4, 4, 1, bits, 0, len(body), 0, 0, 0, 0) + body)


def saved(mode: str, ending: str) -> bytes:
    file = io.BytesIO()
    needed("PIL.Image").new(mode, (8, 8)).save(file, ending)
    return file.getvalue()


def refused() -> Iterator[tuple[str, bytes, str]]:
    """Pictures that a library would rescale, cut, or show in other colours."""
    for kind in (94, 95, 96):
        yield "dds", dds(b"DX10", struct.pack("<5I", kind, 3, 0, 1, 0) + bytes(16)), "BC6H"
    yield "dds", dds(b"BC5U", bytes(16)), "BC5U"
    yield "bmp", bmp(16), "BMP of 16 bits"
    yield "tga", bytes([0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 4, 0, 4, 0, 16, 0]) + bytes(32), "5 bits a channel"
    yield "jpg", saved("CMYK", "JPEG"), "CMYK"
    codecs = needed("imagecodecs")
    yield "jls", codecs.jpegls_encode(numbers(10, (8, 8))), "JPEG-LS"
    yield "jxl", codecs.jpegxl_encode(np.stack([numbers(8)] * 3), lossless=True), "animation"
    yield "jxr", codecs.jpegxr_encode(numbers(8, (16, 16, 3))), "JPEG XR"
    yield "qoi", codecs.qoi_encode(numbers(8)), "QOI"
    yield "heic", struct.pack(">I", 24) + b"ftypheic\0\0\0\0mif1heic" + bytes(40), "HEIF"
    yield "psd", b"8BPS\0\1" + bytes(40), "Photoshop"
    yield "ico", saved("RGB", "ICO"), "icon"
    frames = chunk(b"acTL", struct.pack(">II", 2, 0))
    yield "png", png(numbers(16), 16, 2, before=frames), "animation"


def test_what_no_library_gives_as_it_is_is_refused_by_name(tmp_path: Path) -> None:
    for number, (ending, data, said) in enumerate(refused()):
        error = refusal(put(tmp_path / f"{number}.{ending}", data))
        assert error.reason == "source-format", (ending, error)
        assert said in str(error), error
        assert "not read" in str(error)
        assert "fetch" not in str(error), error


def test_a_small_file_cannot_be_a_huge_picture(tmp_path: Path) -> None:
    codecs = needed("imagecodecs")
    data = bytearray(codecs.jpeg2k_encode(numbers(12), level=0, bitspersample=12, codecformat="j2k"))
    data[8:16] = struct.pack(">II", 1 << 20, 1 << 20)
    assert refusal(put(tmp_path / "a.j2k", bytes(data))).reason == "source-too-large"
    huge = bytearray(png(numbers(16), 16, 2))
    huge[16:33] = chunk(b"IHDR", struct.pack(">IIBBBBB", 1 << 15, 1 << 15, 16, 2, 0, 0, 0))[8:]
    error = refusal(put(tmp_path / "a.png", bytes(huge)))
    assert error.reason == "source-too-large"
    assert "--max-memory 6144MiB" in str(error)


SHIPPED = ("PIL", "imagecodecs", "tifffile", "imageio", "scipy", "skimage", "matplotlib", "numpy")
ENDINGS = {".png", ".jpg", ".jpeg", ".gif", ".webp", ".bmp", ".tif", ".tiff", ".ppm", ".pgm", ".tga", ".jp2", ".avif",
           ".dds", ".jxl", ".exr", ".ico", ".psd", ".hdr", ".fits"}


def shipped() -> list[Path]:
    """Pictures that installed packages bring along."""
    folders = [Path(spec.origin).parent for spec in map(importlib.util.find_spec, SHIPPED) if spec and spec.origin]
    return [path for folder in folders for path in folder.rglob("*") if path.suffix.lower() in ENDINGS]


def generated(folder: Path) -> Iterator[Path]:
    """What Pillow writes, in every mode that it has for a format."""
    pillow = needed("PIL.Image")
    pillow.init()
    base = pillow.fromarray(numbers(8, (16, 16, 3)))
    for name, ending in ((name, ending) for ending, name in pillow.EXTENSION.items() if name in pillow.SAVE):
        for mode in ("1", "L", "LA", "P", "RGB", "RGBA", "CMYK", "YCbCr", "I", "F", "I;16"):
            image = pillow.new(mode, (16, 16)) if mode in ("I;16", "F") else base.convert(mode)
            path = folder / f"{mode.replace(';', '_')}{ending}"
            try:
                image.save(path, name)
            except (OSError, ValueError, KeyError, TypeError, AttributeError, RuntimeError):
                path.unlink(missing_ok=True)
                continue
            yield path


def by_the_library(path: Path) -> NDArray[Any]:
    """The picture as Pillow has it, with palettes looked up; TIFF as tifffile has it."""
    with needed("PIL.Image").open(path) as image:
        if image.mode == "P":
            return np.asarray(image.convert("RGBA" if "transparency" in image.info else "RGB"))
        return np.asarray(image) if image.format != "TIFF" else needed("tifffile").imread(path)


@pytest.mark.filterwarnings("ignore")
def test_pictures_of_other_packages_open_to_the_same_numbers_or_are_refused(tmp_path: Path) -> None:
    opened = 0
    for path in [*shipped(), *generated(tmp_path)]:
        try:
            array = open_array(path)
        except HmkctaError as error:
            assert error.reason in ("source-format", "source-damaged", "unreadable"), (path, error)  # noqa: PT017
            continue
        expected = by_the_library(path)
        assert np.array_equal(array, expected), path
        opened += 1
    assert opened >= 25
