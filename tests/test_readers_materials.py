"""Measured materials: MERL and UTIA by their published layouts, tensor files by the library that writes them."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_tools import refused, report
from hmkcta.errors import HmkctaError, Kind
from hmkcta.labels import labels_of
from hmkcta.readers import open_array
from reader_tools import axes_of, coords_of, refusal, refused_wherever_cut, same, survives_damage

#: Number types of tensor files, from code 1 on.
TYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8")


def stored_merl(sizes: tuple[int, int, int] = (90, 90, 180)) -> NDArray[np.float64]:
    """Numbers of a BRDF as MERL stores them, a tenth of them invalid."""
    draw = np.random.default_rng(0)
    values = draw.random((3, *sizes))
    values[:, draw.random(sizes) < 0.1] = -1.0
    return values


def merl(path: Path, values: NDArray[np.float64]) -> Path:
    """The file as the database publishes it: three whole numbers, then red, green and blue in float64."""
    path.write_bytes(struct.pack("<3i", *values.shape[1:]) + values.astype("<f8").tobytes())
    return path


def test_merl_is_what_its_own_reader_looks_up(tmp_path: Path) -> None:
    values = stored_merl()
    array = open_array(merl(tmp_path / "steel.binary", values))
    assert array.shape == (90, 90, 180, 3)
    for channel, scale in enumerate((1 / 1500, 1.15 / 1500, 1.66 / 1500)):
        for half, difference, azimuth in ((0, 0, 0), (1, 2, 3), (89, 88, 179), (40, 7, 91)):
            at = azimuth + 180 * difference + 180 * 90 * half + channel * 90 * 90 * 180  # as BRDFRead.cpp has it
            stored = values.reshape(-1)[at]
            assert np.isnan(array[half, difference, azimuth, channel]) == (stored < 0)
            if stored >= 0:
                assert array[half, difference, azimuth, channel] == pytest.approx(stored * scale, rel=1e-15)


def test_axes_of_merl_are_the_angles_of_its_bins(tmp_path: Path) -> None:
    array = open_array(merl(tmp_path / "a.binary", stored_merl()))
    axes, (half, difference, azimuth) = axes_of(array), coords_of(array)
    assert list(axes) == ["theta_half", "theta_diff", "phi_diff", "rgb"]
    # Its reader takes the whole part of sqrt(theta / 90 degrees) * 90, so the bins begin at squares.
    assert [int(np.sqrt(angle / 90) * 90 + 1e-9) for angle in half] == list(range(90))
    assert (difference, azimuth) == (list(range(90)), list(range(180)))
    assert [axis.unit for axis in axes.values()] == ["degrees"] * 3 + [""]
    assert axes["rgb"].role == "channel"


def test_merl_of_another_length_is_refused(tmp_path: Path) -> None:
    path = merl(tmp_path / "a.binary", stored_merl())
    whole = path.read_bytes()
    for data, reason in ((whole[:-8], "source-truncated"), (whole + b"\0", "source-too-long"),
                         (whole[:7], "source-truncated"), (b"\1" * 500, "source-format")):
        path.write_bytes(data)
        error = refusal(path)
        assert (error.kind, error.reason) == (Kind.IO, reason)
    for sizes in ((0, 90, 180), (-90, -90, 180)):
        path.write_bytes(struct.pack("<3i", *sizes) + bytes(64))
        assert refusal(path).reason in ("source-format", "source-shape")


def test_merl_end_to_end(tmp_path: Path) -> None:
    path = merl(tmp_path / "a.binary", stored_merl((6, 5, 8)))  # as smaller tables are written for other readers
    words = ("compress", path, "-o", tmp_path / "a.hmk", "--plan", "R=2,2,2,2")
    assert "63 values that are NaN" in refused(*words, code=2)
    report(*words, "--nan", "fill=0")
    axes = report("info", tmp_path / "a.hmk")["axes"]
    assert [axis["name"] for axis in axes] == ["theta_half", "theta_diff", "phi_diff", "rgb"]


def test_utia_is_mapped_with_its_directions(tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((3, 6, 48, 6, 48))
    (tmp_path / "m001.bin").write_bytes(values.tobytes())
    same(tmp_path / "m001.bin", np.moveaxis(values, 0, -1), mapped=True)
    array = open_array(tmp_path / "m001.bin")
    # Place of a number by the reader of the database: plane, light's zenith and azimuth, view's zenith and azimuth.
    at = 2 * 288 * 288 + 288 * (48 * 3 + 17) + 48 * 4 + 31
    assert array[3, 17, 4, 31, 2] == values.reshape(-1)[at]
    axes = axes_of(array)
    assert [(axis.name, axis.role, axis.unit) for axis in axes.values()] == [
        ("theta_i", "light", "degrees"), ("phi_i", "light", "degrees"), ("theta_v", "view", "degrees"),
        ("phi_v", "view", "degrees"), ("rgb", "channel", "")]
    assert coords_of(array) == [[0, 15, 30, 45, 60, 75], np.arange(0, 360, 7.5).tolist()] * 2
    for data in (values.tobytes()[:-1], values.tobytes() + b"\0", b"abc"):
        (tmp_path / "m001.bin").write_bytes(data)
        error = refusal(tmp_path / "m001.bin")
        assert error.reason == "source-format"
        assert "--shape" in str(error)


def measured() -> dict[str, Any]:
    """Arrays of a small file as RGL's database has them."""
    draw = np.random.default_rng(0)
    return {
        "description": "a cloth", "phi_i": np.array([0, 0.5], "f4"), "theta_i": np.array([0, 0.3, 0.9], "f4"),
        "wavelengths": np.array([400, 500, 600, 700], "f4"), "spectra": draw.random((2, 3, 4, 6, 5)).astype("f4"),
        "luminance": draw.random((2, 3, 6, 5)).astype("f4"), "ndf": draw.random((7, 8)).astype("f4"),
        "jacobian": np.array([1], "u1"), "counts": np.arange(12).reshape(3, 4),
    }


def tensor_file(path: Path, arrays: dict[str, Any]) -> Path:
    """The file as RGL publishes the format: names, number types, places and shapes, then the numbers, 8 aligned."""
    tensors = {name: np.frombuffer(value.encode(), "u1") if isinstance(value, str) else np.asarray(value)
               for name, value in arrays.items()}
    at = 18 + sum(13 + len(name) + 8 * tensor.ndim for name, tensor in tensors.items())
    header, numbers = b"tensor_file\0" + struct.pack("<BBI", 1, 0, len(tensors)), b""
    for name, tensor in tensors.items():
        numbers += bytes(-(at + len(numbers)) % 8)
        header += struct.pack("<H", len(name)) + name.encode()
        header += struct.pack("<HBQ", tensor.ndim, TYPES.index(tensor.dtype.str[1:]) + 1, at + len(numbers))
        header += struct.pack(f"<{tensor.ndim}Q", *tensor.shape)
        numbers += tensor.tobytes()
    path.write_bytes(header + numbers)
    return path


def test_tensor_files_of_mitsuba(tmp_path: Path) -> None:
    mitsuba = pytest.importorskip("mitsuba.python.tensor_io", reason="Mitsuba is no dependency")
    mitsuba.write(str(tmp_path / "cloth.bsdf"), **measured())
    assert tensor_file(tmp_path / "ours.bsdf", measured()).read_bytes() == (tmp_path / "cloth.bsdf").read_bytes()
    for name, values in mitsuba.read(str(tmp_path / "cloth.bsdf")).items():
        same(f"{tmp_path}/cloth.bsdf:{name}", values, mapped=True)


def test_arrays_of_tensor_files(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tensor_file(tmp_path / "cloth.bsdf", measured())
    for name, values in measured().items():
        same(f"{path}:{name}", list(values.encode()) if isinstance(values, str) else values,
             "u1" if isinstance(values, str) else None, mapped=True)
    error = refusal(path)
    assert error.reason == "source-member"
    assert "spectra (2 x 3 x 4 x 6 x 5 of float32)" in str(error)
    assert refusal(f"{path}:rgb").reason == "source-member"
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("dtype", TYPES)
def test_number_types_of_tensor_files(tmp_path: Path, dtype: str) -> None:
    values = np.arange(60).reshape(3, 4, 5).astype(dtype)
    same(f"{tensor_file(tmp_path / 'a.bsdf', {'a': values})}", values, mapped=True)


def test_spectra_have_their_angles_and_wavelengths(tmp_path: Path) -> None:
    path, arrays = tensor_file(tmp_path / "cloth.bsdf", measured()), measured()
    array = open_array(f"{path}:spectra")
    assert [(axis.name, axis.role, axis.unit) for axis in axes_of(array).values()] == [
        ("phi_i", "light", "radians"), ("theta_i", "light", "radians"), ("wavelength", "channel", "nm"),
        ("v", "space", ""), ("u", "space", "")]
    assert coords_of(array) == [arrays[name].tolist() for name in ("phi_i", "theta_i", "wavelengths")]
    assert list(axes_of(open_array(f"{path}:ndf"))) == ["v", "u"]
    assert list(axes_of(open_array(f"{path}:counts"))) == ["axis0", "axis1"]


def test_coordinates_that_are_no_numbers_are_left_out(tmp_path: Path) -> None:
    arrays = measured() | {"theta_i": np.array([0, np.nan, 1], "f4")}
    labels = labels_of(open_array(f"{tensor_file(tmp_path / 'a.bsdf', arrays)}:spectra"))
    assert labels.axes is not None
    assert labels.axes[1].coords is None
    assert "theta_i" in labels.notes[0]


def test_tensor_files_end_where_they_say(tmp_path: Path) -> None:
    path = tensor_file(tmp_path / "a.bsdf", {"a": np.arange(60.0), "b": np.arange(7, dtype="u1")})
    whole = path.read_bytes()
    path.write_bytes(whole + b"\0")
    assert refusal(f"{path}:a").reason == "source-too-long"
    path.write_bytes(whole[:-1])
    assert refusal(f"{path}:b").reason == "source-truncated"
    path.write_bytes(whole)
    refused_wherever_cut(path, 3, Path(f"{path}:b"))


@pytest.mark.parametrize(("at", "byte"), [(12, 2), (18 + 2 + 1 + 2, 0), (18 + 2 + 1 + 2, 12), (18 + 2 + 1, 200)])
def test_headers_of_tensor_files_that_are_refused(tmp_path: Path, at: int, byte: int) -> None:
    path = tensor_file(tmp_path / "a.bsdf", {"a": np.arange(6.0)})
    data = bytearray(path.read_bytes())
    data[at] = byte  # the version; the number type, twice; the number of axes
    path.write_bytes(data)
    assert refusal(path).reason in ("source-format", "source-damaged")


def test_damaged_tensor_files_are_arrays_or_refused(tmp_path: Path) -> None:
    survives_damage(tensor_file(tmp_path / "a.bsdf", {"spectra": measured()["luminance"]}))
    path = tensor_file(tmp_path / "b.bsdf", measured())
    whole, draw = path.read_bytes(), np.random.default_rng(1)
    for _ in range(200):
        data = bytearray(whole)
        data[int(draw.integers(400))] = int(draw.integers(256))
        path.write_bytes(data)
        try:
            assert np.asarray(open_array(f"{path}:spectra")).size > 0
        except HmkctaError as error:
            assert error.reason  # noqa: PT017 (either outcome is right)


def test_tensor_files_end_to_end(tmp_path: Path) -> None:
    path = tensor_file(tmp_path / "cloth.bsdf", measured())
    report("compress", f"{path}:spectra", "-o", tmp_path / "a.hmk", "--plan", "R=2,2,2,2,2")
    axes = report("info", tmp_path / "a.hmk")["axes"]
    assert [axis["name"] for axis in axes] == ["phi_i", "theta_i", "wavelength", "v", "u"]
