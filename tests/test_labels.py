"""Names and coordinates that come with an array: kept where a file can keep them, else it is said that they are not."""

from __future__ import annotations

import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hmkcta
from cli_tools import run
from hmkcta import Axis
from hmkcta.labels import labels_of
from hmkcta.readers import open_array
from reader_tools import VALUES, needed

TIMES = np.array(["2020-01-01", "2020-01-02", "2020-01-04"], "datetime64[ns]")


class DataArray:
    """What one of xarray's looks like from outside."""

    def __init__(self, values: Any, dims: Any, coords: dict[str, Any]) -> None:
        self.values, self.dims, self.shape = np.asarray(values), dims, np.shape(values)
        self.coords = {
            name: SimpleNamespace(dims=(along,) if isinstance(along, str) else along, values=np.asarray(numbers),
                                  attrs=dict(attrs))
            for name, (along, numbers, *attrs) in coords.items()
        }

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        return np.array(self.values, dtype, copy=copy)


def compressed(array: Any, **options: Any) -> tuple[dict[str, Axis], list[str]]:
    """Axes of the model of an array, and what was warned of."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        model = hmkcta.compress(array, "R=2", **options)
    assert all(each.filename == __file__ for each in warned)
    return {axis.name: axis for axis in model.metadata.axes}, [str(each.message) for each in warned]


def listed(axis: Axis) -> list[float]:
    """Its coordinates."""
    return np.asarray(axis.coords).tolist()


def test_coordinates_of_xarray_are_kept() -> None:
    coords = {"time": ("time", TIMES), "y": ("y", [1, 2, 4, 8], ("units", "m")), "x": ("x", np.arange(5) / 4)}
    axes, said = compressed(DataArray(VALUES, ("time", "y", "x"), coords))
    assert said == []
    assert listed(axes["time"]) == [1577836800.0, 1577923200.0, 1578096000.0]
    assert (axes["time"].unit, axes["time"].role) == ("seconds since 1970-01-01", "time")
    assert (listed(axes["y"]), axes["y"].unit) == ([1, 2, 4, 8], "m")
    assert listed(axes["x"]) == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_names_that_are_given_keep_the_coordinates() -> None:
    array = DataArray(VALUES, ("t", "y", "x"), {"y": ("y", [1, 2, 4, 8], ("units", "m"))})
    axes, said = compressed(array, axes="light,view,x")
    assert said == []
    assert (listed(axes["view"]), axes["view"].unit, axes["light"].coords) == ([1, 2, 4, 8], "m", None)
    axes, said = compressed(array, axes=["light", Axis("view", 4, "view"), "x"])
    assert axes["view"].coords is None


@pytest.mark.parametrize(("name", "along", "numbers"), [
    ("area", ("y", "x"), VALUES[0]), ("height", (), 2.0), ("label", ("t",), list("abc")), ("t", ("t",), list("abc")),
    ("t", ("t",), [0, 1, np.nan]), ("other", ("t",), [1, 2, 3]), ("t", ("t",), [2**60, 2**60 + 1, 0]),
])
def test_coordinates_that_no_file_keeps_are_said(name: str, along: Any, numbers: Any) -> None:
    axes, said = compressed(DataArray(VALUES, ("t", "y", "x"), {name: (along, numbers)}))
    assert len(said) == 1
    assert f"coordinates {name} are not kept" in said[0]
    assert list(axes) == ["t", "y", "x"]
    assert axes["t"].coords is None


def test_coordinates_that_would_take_most_of_a_file_are_said() -> None:
    signal = np.sin(np.arange(3000.0) / 9).astype("f4")
    axes, said = compressed(DataArray(signal, ("t",), {"t": (("t",), np.arange(3000) / 7)}))
    assert axes["t"].coords is None
    assert [sentence for sentence in said if "24000 bytes of the file" in sentence and "Axis(" in sentence]


def netcdf(path: Path, **attributes: Any) -> Path:
    """A file as netCDF-4 has it: scales of its axes, one without numbers, one packed."""
    with needed("h5py").File(path, "w") as file:
        field = file.create_dataset("field", data=VALUES)
        field.attrs.update(attributes)
        for number, (name, numbers) in enumerate({"time": [0, 1, 3], "y": np.zeros(4), "x": np.arange(5, dtype="i2")
                                                  }.items()):
            file[name] = np.asarray(numbers)
            said = f"This is a netCDF dimension but not a netCDF variable. {4:10}" if name == "y" else name
            file[name].make_scale(said)
            field.dims[number].attach_scale(file[name])
        file["time"].attrs["units"] = np.bytes_("days since 2000-01-01")
        file["x"].attrs.update({"scale_factor": 0.5, "add_offset": 10.0, "units": "km"})
    return path


def test_coordinates_of_netcdf_are_kept(tmp_path: Path) -> None:
    path = netcdf(tmp_path / "a.nc")
    array = open_array(path)
    assert isinstance(array, np.memmap)
    assert labels_of(array[1:]).axes is None  # a part of it has others
    assert labels_of(array * 2).axes is None
    axes, said = compressed(array)
    assert said == []
    assert list(axes) == ["time", "y", "x"]
    assert (listed(axes["time"]), axes["time"].unit) == ([0, 1, 3], "days since 2000-01-01")
    assert axes["y"].coords is None
    assert (listed(axes["x"]), axes["x"].unit) == ([10, 10.5, 11, 11.5, 12], "km")
    with needed("h5py").File(path) as file:
        assert listed(compressed(file["field"])[0]["time"]) == [0, 1, 3]


def test_the_command_line_keeps_and_says(tmp_path: Path) -> None:
    path = netcdf(tmp_path / "a.nc", coordinates=np.bytes_("lat lon"))
    done = run("compress", path, "-o", tmp_path / "a.hmk", "--plan", "R=2", "--axes", "t,v,w", "--unit", "w=m")
    assert "coordinates lat, lon are not kept" in done.stderr
    axes = {axis.name: axis for axis in hmkcta.open(tmp_path / "a.hmk").metadata.axes}
    assert (listed(axes["t"]), listed(axes["w"]), axes["w"].unit) == ([0, 1, 3], [10, 10.5, 11, 11.5, 12], "m")


@pytest.mark.parametrize("version", [2, 3])
def test_coordinates_of_zarr_are_kept(tmp_path: Path, version: int) -> None:
    zarr = needed("zarr")
    group = zarr.open_group(tmp_path / "a.zarr", mode="w", zarr_format=version)

    def add(name: str, values: NDArray[Any], *dims: str, **attributes: Any) -> None:
        names = {"dimension_names": dims} if version == 3 else {"fill_value": -1}
        made = group.create_array(name, data=values, **names)
        made.attrs.update(attributes if version == 3 else {**attributes, "_ARRAY_DIMENSIONS": list(dims)})

    add("field", VALUES, "time", "y", "x", coordinates="area")
    add("time", np.array([0, 1, 3]), "time", units="s")
    add("x", np.arange(5, dtype="i2"), "x", scale_factor=0.5)
    add("area", VALUES[0], "y", "x")
    axes, said = compressed(open_array(tmp_path / "a.zarr"))
    assert (listed(axes["time"]), axes["time"].unit, listed(axes["x"])) == ([0, 1, 3], "s", [0, 0.5, 1, 1.5, 2])
    assert axes["y"].coords is None
    assert len(said) == 1
    assert "coordinates area are not kept" in said[0]
    assert listed(compressed(group["field"])[0]["time"]) == [0, 1, 3]


def test_stacks_of_files_have_other_coordinates_than_each(tmp_path: Path) -> None:
    for number in range(2):
        netcdf(tmp_path / f"{number}.nc")
    axes, said = compressed(open_array(f"{tmp_path}/*.nc"))
    assert len(said) == 1
    assert "coordinates time, x of single files are not kept" in said[0]
    assert list(axes) == ["file", "time", "y", "x"]


def test_open_variables_of_netcdf_libraries_are_said() -> None:
    class Variable(DataArray):
        dimensions = ("time", "y", "x")

    variable = Variable(VALUES, None, {})
    axes, said = compressed(variable)
    assert list(axes) == ["time", "y", "x"]
    assert len(said) == 1
    assert "open_array" in said[0]
