"""Files that the readers' own libraries ship for their tests, and make in them: opened to equal numbers, or refused.

What is not installed is passed over. A refusal says what the file is, and of a whole file never that it is damaged on
its way.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hmkcta.errors import HmkctaError
from hmkcta.readers import open_array
from reader_tools import VALUES, needed

#: Packages that ship data, and where in them.
SHIPPED = {"nibabel": ".", "scipy": "io", "h5py": "tests", "zarr": ".", "nrrd": ".", "tifffile": ".", "OpenEXR": "."}
CODE = (".py", ".pyc", ".so", ".pyi", ".m", ".rst", ".txt", ".arff", ".build", ".typed", ".ini", "")
#: Files that are cut, or whose other half is not shipped.
INCOMPLETE = ("truncated", "nifti1.hdr", "nifti2.hdr")
NUMBERS = ["u1", "i1", "<u2", ">i2", "<i4", ">u4", "<i8", ">u8", "<f4", ">f4", "<f8", ">f8"]


def shipped(package: str) -> list[Path]:
    """Data files of an installed package."""
    found = find_spec(package)
    if found is None or not found.submodule_search_locations:
        return []
    root = Path(found.submodule_search_locations[0]) / SHIPPED[package]
    return [path for path in sorted(root.rglob("*")) if path.is_file() and path.suffix not in CODE]


def by_nibabel(path: Path) -> NDArray[Any]:
    """What nibabel makes of a file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return np.asanyarray(needed("nibabel").load(path).dataobj)


def expected_of(path: Path, array: NDArray[Any]) -> NDArray[Any]:
    """The numbers of a file, by its own library."""
    name = path.name.lower()
    if name.endswith((".nii", ".nii.gz", ".mnc", ".hdr", ".img")):
        return by_nibabel(path)
    if name.endswith(".mat"):  # the axes of MATLAB are in reverse
        with needed("h5py").File(path) as file:
            return next(item[()].T for item in file.values() if item.shape[::-1] == array.shape)
    pytest.fail(f"{path} is opened, and nobody says what it should be")


def tried(uri: Path | str) -> NDArray[Any] | str:
    """The array, or the sentence of the refusal."""
    try:
        return open_array(uri)
    except HmkctaError as error:
        return str(error)


def opened_or_refused(path: Path, capfd: pytest.CaptureFixture[str], expected: Any = None) -> bool:
    """Whether a file is opened; it has the numbers that its library finds, or is refused by a sentence that is true."""
    array = tried(path)
    assert capfd.readouterr() == ("", "")
    if isinstance(array, str):
        assert any(word in path.name for word in INCOMPLETE) or "fetch it again" not in array
        return False
    numbers = expected_of(path, array) if expected is None else expected
    assert array.shape == numbers.shape, path
    assert np.array_equal(array, numbers.astype(array.dtype), equal_nan=True), path
    return True


@pytest.mark.parametrize("package", SHIPPED)
def test_shipped_files(package: str, capfd: pytest.CaptureFixture[str]) -> None:
    files = shipped(package)
    if not files:
        pytest.skip(f"no data of {package} here")
    found = [opened_or_refused(path, capfd) for path in files]
    assert package != "nibabel" or (sum(found) >= 10 and len(found) > 80)


def every_path(h5py: Any, group: Any, before: str = "") -> Iterator[str]:
    """Paths of all that is in a group."""
    for name, item in group.items():
        yield before + name
        if isinstance(item, h5py.Group):
            yield from every_path(h5py, item, f"{before}{name}/")


def test_members_of_shipped_hdf5(capfd: pytest.CaptureFixture[str]) -> None:
    h5py = needed("h5py")
    paths = [path for package in ("h5py", "nibabel") for path in shipped(package) if h5py.is_hdf5(path)]
    for path in paths:
        with h5py.File(path) as file:
            for name in list[str](every_path(h5py, file)):
                if not isinstance(file[name], h5py.Dataset) or name.endswith("/image"):
                    continue
                array = tried(f"{path}:{name}")
                if isinstance(array, str):
                    assert "fetch it again" not in array
                else:
                    assert np.array_equal(array, file[name][()], equal_nan=True), (path, name)
    assert capfd.readouterr() == ("", "")


def written_by_nibabel(folder: Path) -> Iterator[tuple[Path, Any]]:
    """Each type in each kind of file, plain and scaled."""
    nibabel = needed("nibabel")
    kinds = (("Nifti1Image", ".nii"), ("Nifti2Image", ".nii"), ("Nifti1Image", ".nii.gz"), ("Nifti1Pair", ".img"))
    for (kind, ending), dtype, slope in product(kinds, NUMBERS, (None, 0.1)):
        made, values = getattr(nibabel, kind), VALUES.astype(dtype)
        header = made.header_class(endianness="<" if dtype[0] == "<" else ">")
        image = made(values, np.eye(4), header, dtype=values.dtype.newbyteorder("="))
        if slope is not None:
            image.header.set_slope_inter(slope, -2)
        path = folder / f"{kind}{NUMBERS.index(dtype)}{slope is None:d}{ending}"
        nibabel.save(image, path)
        yield path, by_nibabel(path)


def written_by_pynrrd(folder: Path) -> Iterator[tuple[Path, Any]]:
    """Each type in each encoding, with its header and beside it."""
    nrrd = needed("nrrd")
    for encoding, dtype, ending, order in product(("raw", "gzip", "bzip2", "ascii"), NUMBERS, ("nrrd", "nhdr"), "CF"):
        path = folder / f"{encoding}{NUMBERS.index(dtype)}{order}.{ending}"
        nrrd.write(str(path), VALUES.astype(dtype), {"encoding": encoding}, index_order=order)
        yield path, nrrd.read(str(path))[0]


def written_by_h5py(folder: Path) -> Iterator[tuple[Path, Any]]:
    """Each type in each layout that a dataset may have, its file behind blocks of many lengths, and behind a link."""
    h5py = needed("h5py")
    layouts: list[dict[str, Any]] = [
        {}, {"chunks": (2, 3, 2)}, {"chunks": True, "compression": "gzip"}, {"compression": "lzf", "shuffle": True},
        {"chunks": (1, 4, 5), "fletcher32": True}, {"maxshape": (None, 4, None)},
        {"chunks": (3, 4, 5), "scaleoffset": 0},
    ]
    for (number, layout), dtype, block in product(enumerate(layouts), [*NUMBERS, "<f2", "?"], (0, 8192)):
        if "scaleoffset" in layout and np.dtype(dtype).kind not in "iu":
            continue
        path = folder / f"{number}-{np.dtype(dtype).str[0] == '>':d}-{np.dtype(dtype)}-{block}.h5"
        with h5py.File(path, "w", userblock_size=block) as file:
            file.create_dataset("group/a", data=VALUES.astype(dtype), **layout)
        with h5py.File(folder / f"link-{path.name}", "w") as file:
            file["away"] = h5py.ExternalLink(path.name, "group")
        with h5py.File(path) as file:
            numbers = file["group/a"][()]
        yield path, numbers
        yield folder / f"link-{path.name}", numbers


def written_by_zarr(folder: Path) -> Iterator[tuple[Path, Any]]:
    """Each type in both versions, packed and split in several ways."""
    zarr = needed("zarr")
    codecs = zarr.codecs
    third: list[dict[str, Any]] = [
        {"compressors": None}, {"compressors": codecs.GzipCodec()}, {"compressors": codecs.BloscCodec()}, {},
        {"shards": (4, 4, 8)}, {"filters": codecs.TransposeCodec(order=(2, 0, 1))},
        {"serializer": codecs.BytesCodec(endian="big")},
    ]
    second: list[dict[str, Any]] = [{"compressors": None}, {"order": "F"}, {}]
    for version, options in ((2, second), (3, third)):
        for (number, option), dtype in product(enumerate(options), NUMBERS):
            path = folder / f"{version}-{number}-{NUMBERS.index(dtype)}.zarr"
            zarr.create_array(path, data=VALUES.astype(dtype), chunks=(2, 4, 4), zarr_format=version, **option)
            yield path, zarr.open_array(path, mode="r")[:]


@pytest.mark.parametrize("written", [written_by_nibabel, written_by_pynrrd, written_by_h5py, written_by_zarr])
def test_what_the_libraries_write(written: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the library that writes
        files: list[tuple[Path, Any]] = [(path, np.asarray(numbers)) for path, numbers in written(tmp_path)]
    assert len(files) >= 90
    for path, numbers in files:
        assert opened_or_refused(path, capfd, numbers), path
