"""Numbers that a container scales by what lies beside them: they are what is meant, or refused, or it is said."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hmkcta
from hmkcta.conventions import meant
from hmkcta.readers import open_array
from reader_tools import VALUES, needed, refusal, same

RAW = VALUES.astype("u1")


@pytest.fixture
def h5py() -> Any:
    """The library."""
    return needed("h5py")


def minc(h5py: Any, path: Path, least: Any, most: Any, dtype: str = "u1", **attributes: Any) -> Path:
    """An image of MINC 2."""
    with h5py.File(path, "w") as file:
        for name in ("zspace", "yspace", "xspace"):
            file[f"minc-2.0/dimensions/{name}"] = 0
        file["minc-2.0/dimensions/time-width"] = np.arange(5.0)
        group = file.create_group("minc-2.0/image/0")
        group["image"] = VALUES.astype(dtype)
        group["image"].attrs.update({"dimorder": np.bytes_("zspace,yspace,xspace"), **attributes})
        for name, limit in (("image-min", least), ("image-max", most)):
            group[name] = np.asarray(limit, np.float64)
            group[name].attrs["dimorder"] = np.bytes_(",".join(("zspace", "yspace")[:np.ndim(limit)]))
    return path


@pytest.mark.parametrize(("least", "most"), [
    (-1.0, 9.0), ([-1.0, 0, 1], [3.0, 5, 9]), (np.zeros((3, 4)), np.arange(1.0, 13).reshape(3, 4)),
])
@pytest.mark.parametrize(("dtype", "attributes"), [
    ("u1", {}), ("i2", {"valid_range": [0.0, 100.0]}), ("u1", {"valid_range": [10.0, 30.0]}),
])
def test_minc_is_scaled_slice_by_slice(
    h5py: Any, tmp_path: Path, least: Any, most: Any, dtype: str, attributes: dict[str, Any]
) -> None:
    path = minc(h5py, tmp_path / "a.mnc", least, most, dtype, **attributes)
    low, high = attributes.get("valid_range", (0, 255))
    floor, top = (np.reshape(limit, np.shape(limit) + (1,) * (3 - np.ndim(limit))) for limit in (least, most))
    expected = (np.clip(VALUES.astype(float), low, high) - low) / (high - low) * (top - floor) + floor
    for uri in (path, f"{path}:/minc-2.0/image/0/image"):
        array = open_array(uri)
        assert array.dtype == np.float64
        assert np.allclose(array, expected, rtol=1e-12, atol=1e-12)
    with h5py.File(path) as file:
        assert np.array_equal(meant(file["minc-2.0/image/0/image"]), array)
        file.close()
    with h5py.File(tmp_path / "link.h5", "w") as file:
        file["image"] = h5py.ExternalLink("a.mnc", "/minc-2.0/image/0/image")
    assert np.array_equal(open_array(tmp_path / "link.h5"), array)


def test_minc_of_floats_is_as_stored(h5py: Any, tmp_path: Path) -> None:
    same(minc(h5py, tmp_path / "a.mnc", 0.0, 5.0, "f4"), VALUES, mapped=True)


@pytest.mark.parametrize(("least", "most", "attributes"), [
    ([0.0, 1], [1.0, 2], {}), (0.0, [1.0, 1, 1], {}), (0.0, 1.0, {"valid_range": [0.0, 999.0]}),
    (0.0, 1.0, {"valid_range": [5.0, 5.0]}),
])
def test_minc_that_contradicts_itself_is_refused(
    h5py: Any, tmp_path: Path, least: Any, most: Any, attributes: dict[str, Any]
) -> None:
    error = refusal(minc(h5py, tmp_path / "a.mnc", least, most, **attributes))
    assert error.reason == "source-scaling"
    assert "nibabel" in str(error)


def nexus(h5py: Any, path: Path, **beside: float) -> Path:
    """A signal of NeXus with fields beside it."""
    with h5py.File(path, "w") as file:
        group = file.create_group("entry/data")
        group.attrs.update({"NX_class": "NXdata", "signal": "counts"})
        group["counts"] = RAW
        for name, number in beside.items():
            group[name] = number
    return path


@pytest.mark.parametrize(("beside", "expected"), [
    ({"counts_scaling_factor": 0.5, "counts_offset": 4.0}, (RAW + 4.0) * 0.5), ({"scaling_factor": 0.5}, RAW * 0.5),
    ({"offset": 4.0}, RAW + 4.0), ({"counts_scaling_factor": 0.25}, RAW * 0.25),
])
def test_fields_of_nexus_are_scaled(h5py: Any, tmp_path: Path, beside: dict[str, float], expected: Any) -> None:
    same(nexus(h5py, tmp_path / "a.nxs", **beside), expected.astype("f4"))


def test_fields_of_nexus_without_factors_are_mapped(h5py: Any, tmp_path: Path) -> None:
    same(nexus(h5py, tmp_path / "a.nxs", other_scaling_factor=2.0), RAW, mapped=True)
    error = refusal(nexus(h5py, tmp_path / "b.nxs", scaling_factor=2.0, offset=1.0))
    assert error.reason == "source-scaling"


@pytest.mark.parametrize("place", ["dataset1/data1/what", "dataset1/what"])
def test_radars_are_scaled(h5py: Any, tmp_path: Path, place: str) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.attrs["Conventions"] = np.bytes_("ODIM_H5/V2_2")
        file["dataset1/data1/data"] = RAW[0]
        file.create_group(place).attrs.update({"gain": 0.5, "offset": -32.0, "nodata": 7.0, "undetect": 0.0})
    values = RAW[0].astype("f4")
    expected = np.where((values == 7) | (values == 0), np.nan, values / 2 - 32)
    array = open_array(tmp_path / "a.h5")
    assert array.dtype == np.float32
    assert np.array_equal(array, expected, equal_nan=True)


@pytest.mark.parametrize(("attributes", "said"), [
    ({"ScaleFactor": 0.1, "Offset": 2.0}, "Offset and ScaleFactor"),
    ({"scale_factor": [1.0, 2.0, 3.0]}, "scale_factor"),
    ({"Slope": 0.02}, "Slope"), ({"SCALE FACTOR": 0.1}, "SCALE FACTOR"), ({"gain": np.float32(2)}, "gain"),
    ({"scale_factor": "0.1", "add_offset": "3"}, "add_offset and scale_factor"), ({"Slope": " 2e-2 "}, "Slope"),
])
@pytest.mark.parametrize("kind", ["h5", "zarr"])
def test_other_scaling_is_said_when_it_is_compressed(
    h5py: Any, tmp_path: Path, attributes: dict[str, Any], said: str, kind: str
) -> None:
    path = tmp_path / f"a.{kind}"
    if kind == "h5":
        with h5py.File(path, "w") as file:
            file.create_dataset("a", data=RAW).attrs.update(attributes)
    else:
        attributes = {name: np.asarray(value).tolist() for name, value in attributes.items()}
        needed("zarr").create_array(path, data=RAW, attributes=attributes)
    array = open_array(path)
    assert np.array_equal(array, RAW)
    with pytest.warns(UserWarning, match=f"^{said} of the source are not applied"):
        hmkcta.compress(array, "R=2")


def test_scaling_that_changes_nothing_is_not_said(h5py: Any, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        field = file.create_dataset("a", data=VALUES)
        field.attrs.update({"ScaleFactor": 1.0, "Offset": 0, "scale": "large", "HistogramMax": "255", "units": "K"})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hmkcta.compress(open_array(tmp_path / "a.h5"), "R=2")


def test_the_range_before_quantisation_is_said(tmp_path: Path) -> None:
    needed("nrrd").write(str(tmp_path / "a.nrrd"), RAW, {"encoding": "raw", "old min": 0.0, "old max": 2.5})
    array = open_array(tmp_path / "a.nrrd")
    assert np.array_equal(array, RAW)
    with pytest.warns(UserWarning, match=r"the range 0 to 2\.5 before quantisation"):
        hmkcta.compress(array, "R=2")


def test_calibrated_tiff_of_imagej_is_scaled(tmp_path: Path) -> None:
    """Signed numbers of 16 bits are stored as unsigned ones with an offset; others have a slope."""
    tifffile = needed("tifffile")
    values = VALUES.astype(np.uint16) + 32700
    signed, sloped = {"cf": 0, "c0": -32768, "c1": 1}, {"cf": 0, "c0": 3.5, "c1": 0.25}
    tifffile.imwrite(tmp_path / "a.tif", values, imagej=True, metadata={"axes": "ZYX", **signed})
    same(tmp_path / "a.tif", (values.astype(np.int32) - 32768).astype(np.int16))
    tifffile.imwrite(tmp_path / "b.tif", values, imagej=True, metadata={"axes": "ZYX", **sloped})
    same(tmp_path / "b.tif", (values * 0.25 + 3.5).astype(np.float32))
    tifffile.imwrite(tmp_path / "c.tif", values, imagej=True, metadata={"axes": "ZYX", "cf": 4, "c0": 1, "c1": 2})
    assert refusal(tmp_path / "c.tif").reason == "source-format"


def gdal(path: Path, values: Any, *items: tuple[str, int, float], missing: str = "") -> Path:
    """A TIFF file with items as GDAL writes them, and the number that stands for nothing."""
    tifffile = needed("tifffile")
    lines = "".join(f'<Item name="X" sample="{n}" role="{role}">{value}</Item>' for role, n, value in items)
    tags = [(42112, "s", 0, f"<GDALMetadata>{lines}</GDALMetadata>", True)]
    tags += [(42113, "s", 0, missing, True)] if missing else []
    tifffile.imwrite(path, values, extratags=tags, metadata=None, photometric="rgb" if values.ndim == 3 else None)
    return path


def test_tiff_of_gdal_is_scaled(tmp_path: Path) -> None:
    values = np.arange(20, dtype=np.int16).reshape(4, 5)
    found = open_array(gdal(tmp_path / "a.tif", values, ("scale", 0, 0.5), ("offset", 0, 10.0), missing="3"))
    expected = (values * 0.5 + 10).astype(np.float32)
    expected[values == 3] = np.nan
    assert found.dtype == np.float32
    assert np.array_equal(found, expected, equal_nan=True)
    same(gdal(tmp_path / "b.tif", values, ("unittype", 0, 1.0)), values, mapped=True)
    colours = np.stack([values, values, values], axis=2)
    for items in ([("scale", 0, 0.5), ("scale", 1, 0.25), ("scale", 2, 0.5)], [("offset", 1, 3.0)]):  # not of all
        assert refusal(gdal(tmp_path / "c.tif", colours, *items)).reason == "source-format"
    same(gdal(tmp_path / "d.tif", colours, *(("scale", n, 0.5) for n in range(3))), (colours * 0.5).astype("f4"))
