"""FITS against astropy: images plain, scaled, packed and of several parts; names, coordinates, lengths."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_tools import report
from hmkcta.errors import Kind
from hmkcta.readers import open_array
from reader_tools import (
    VALUES,
    axes_of,
    coords_of,
    needed,
    refusal,
    refused_wherever_cut,
    roles_of,
    same,
    survives_damage,
)


def fits() -> Any:
    """The library."""
    return needed("astropy.io.fits")


def written(path: Path, values: Any = VALUES, **cards: Any) -> Path:
    """A file of one image with these cards in its header."""
    image = fits().PrimaryHDU(values)
    image.header.update(cards)
    image.writeto(path, overwrite=True)
    return path


@pytest.mark.parametrize("dtype", ["u1", "i1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"])
@pytest.mark.parametrize("packed", [False, True])
def test_number_types_of_fits(tmp_path: Path, dtype: str, packed: bool) -> None:
    span = np.iinfo(dtype) if dtype[0] in "iu" else np.finfo(dtype)
    values = VALUES.astype(dtype)
    values[0, 0, :2] = span.min, span.max
    if packed and dtype in ("i8", "u8", "i1"):
        pytest.skip("tiles hold no such numbers")
    made = fits().ImageHDU(values)
    if packed:
        made = fits().CompImageHDU(values, compression_type="GZIP_2", quantize_level=0)
    fits().HDUList([fits().PrimaryHDU(), made]).writeto(tmp_path / "a.fits")
    expected = fits().getdata(tmp_path / "a.fits")
    assert np.array_equal(expected, values)
    plain = not packed and (dtype in ("u1",) or (dtype[0] in "if" and dtype != "i1"))
    same(tmp_path / "a.fits", values, f">{dtype}" if plain else dtype, mapped=plain)


def test_scaled_and_blank_numbers_are_what_astropy_has(tmp_path: Path) -> None:
    for dtype, scale, zero in (("i2", 0.25, 100), ("u1", 1, -128.5), ("i4", 2.0, 0), ("f4", 0.1, 1), ("i2", 1, 7)):
        path = tmp_path / "a.fits"
        made = fits().PrimaryHDU(VALUES.astype(dtype), do_not_scale_image_data=True)
        made.header["BSCALE"], made.header["BZERO"] = scale, zero
        if dtype != "f4":
            made.header["BLANK"] = 7
        made.writeto(path, overwrite=True)
        expected = fits().getdata(path)
        assert np.isnan(expected).sum() == (dtype != "f4")
        array = open_array(path)
        assert array.dtype == expected.dtype.newbyteorder("=")
        assert np.allclose(array, expected, rtol=1e-6, atol=0, equal_nan=True)


def test_images_of_several_parts(tmp_path: Path) -> None:
    table = fits().BinTableHDU(np.zeros(3, [("a", "i4"), ("b", "f8")]))
    parts = [fits().PrimaryHDU(), fits().ImageHDU(VALUES, name="SCI"), table, fits().ImageHDU(VALUES[0], name="SCI"),
             fits().CompImageHDU(VALUES.astype("i2"), name="DQ", tile_shape=(1, 2, 5)), fits().ImageHDU(VALUES[1])]
    fits().HDUList(parts).writeto(tmp_path / "a.fits")
    error = refusal(tmp_path / "a.fits")
    assert error.reason == "source-member"
    for text in ("3 (4 x 5 of float32)", "5 (4 x 5 of float32)", "DQ (3 x 4 x 5 of int16)", "SCI (3 x 4 x 5"):
        assert text in str(error)
    for name, values in (("SCI", VALUES), ("3", VALUES[0]), ("5", VALUES[1])):
        same(f"{tmp_path}/a.fits:{name}", values, ">f4", mapped=True)
    for name in ("DQ", "4"):
        same(f"{tmp_path}/a.fits:{name}", VALUES.astype("i2"))
    for name in ("2", "6", "1.5"):
        assert refusal(f"{tmp_path}/a.fits:{name}").reason == "source-member"


def test_axes_of_cubes_have_their_spectra(tmp_path: Path) -> None:
    sky = {"CTYPE1": "RA---TAN", "CTYPE2": "DEC--TAN", "CDELT1": -1e-3, "CDELT2": 1e-3, "CUNIT1": "deg"}
    line = {"CTYPE3": "FREQ", "CRVAL3": 1.4e9, "CDELT3": 2e6, "CRPIX3": 2.0, "CUNIT3": "Hz"}
    array = open_array(written(tmp_path / "a.fits", **sky, **line))
    assert roles_of(array) == [("freq", "channel"), ("y", "space"), ("x", "space")]
    assert coords_of(array) == [[1.4e9 - 2e6, 1.4e9, 1.4e9 + 2e6]]  # those of the sky are on no straight lines
    assert axes_of(array)["freq"].unit == "Hz"
    assert coords_of(open_array(written(tmp_path / "a.fits", **line | {"CTYPE3": "FREQ-LOG"}))) == []
    assert coords_of(open_array(written(tmp_path / "a.fits", **line, PC3_1=0.1))) == []


def test_straight_axes_are_where_astropy_puts_them(tmp_path: Path) -> None:
    cards = {"CRVAL1": 5.0, "CDELT1": 0.5, "CRPIX1": 1.0, "CRVAL2": -1.0, "CDELT2": 2.0, "CRPIX2": 3.0}
    path = written(tmp_path / "a.fits", VALUES[0], **cards)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        wcs = needed("astropy.wcs").WCS(fits().getheader(path))
        expected = [[float(wcs.pixel_to_world_values(0, row)[1]) for row in range(4)],
                    [float(wcs.pixel_to_world_values(column, 0)[0]) for column in range(5)]]
    assert coords_of(open_array(path)) == expected
    assert list(axes_of(open_array(path))) == ["y", "x"]


def test_fits_files_are_as_long_as_they_say(tmp_path: Path) -> None:
    path = written(tmp_path / "a.fits")
    whole = path.read_bytes()
    for data, reason in ((whole[:-1], "source-truncated"), (whole + b"\0" * 3, "source-too-long"),
                         (whole[:-2880], "source-truncated")):
        path.write_bytes(data)
        error = refusal(path)
        assert (error.kind, error.reason) == (Kind.IO, reason)
    path.write_bytes(whole.replace(b"NAXIS3  =                    3", b"NAXIS3  =           2000000000"))
    assert refusal(path).reason == "source-truncated"


def test_cut_and_damaged_fits(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path / "a.fits")
    refused_wherever_cut(path, 111)
    survives_damage(path)
    fits().CompImageHDU(VALUES).writeto(tmp_path / "b.fits")
    survives_damage(tmp_path / "b.fits")
    assert capfd.readouterr() == ("", "")


def test_fits_end_to_end(tmp_path: Path) -> None:
    path = written(tmp_path / "a.fits", CTYPE3="VELO", CDELT3=100.0, CUNIT3="m/s")
    report("compress", path, "-o", tmp_path / "a.hmk", "--plan", "R=2,2,2")
    assert [axis["name"] for axis in report("info", tmp_path / "a.hmk")["axes"]] == ["velo", "y", "x"]


def test_tables_are_refused_by_name(tmp_path: Path) -> None:
    table = fits().BinTableHDU(np.zeros(3, [("a", "i4"), ("b", "f8")]))
    fits().HDUList([fits().PrimaryHDU(), table]).writeto(tmp_path / "a.fits")
    error = refusal(tmp_path / "a.fits")
    assert error.reason == "source-format"
    assert "no image" in str(error)
