"""Numbers that lie elsewhere: behind links, in raw files beside, in the sources of virtual datasets, in TIFF files.

Whatever the path that was given, what counts is the file in which a dataset lies.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hmkcta
from hmkcta.errors import HmkctaError, Kind
from hmkcta.readers import open_array
from hmkcta.readers.source import watched_by
from hmkcta.readers.watched import WatchedSource
from hmkcta.streaming.steady import fingerprint_of
from reader_tools import VALUES, needed, refusal, same, survives_damage


@pytest.fixture
def h5py() -> Any:
    """The library."""
    return needed("h5py")


def away(h5py: Any, folder: Path, block: int = 0) -> Path:
    """A file in a folder of its own, and one beside the folder that links to all of it."""
    (folder / "sub").mkdir()
    with h5py.File(folder / "sub" / "b.h5", "w", userblock_size=block) as file:
        file["group/x"] = VALUES
        file["group/deeper/y"] = VALUES[0].astype("u2")
        file["soft"] = h5py.SoftLink("/group/x")
        file.create_dataset("group/chunked", data=VALUES + 1, chunks=(1, 4, 5))
    with h5py.File(folder / "a.h5", "w") as file:
        file["own"] = np.full(VALUES.shape, 99, "f4")  # where the other file's numbers would be
        file["padding"] = np.full(5000, 77, "f4")
        file["far"] = h5py.ExternalLink("sub/b.h5", "/group/x")
        file["far_soft"] = h5py.ExternalLink("sub/b.h5", "/soft")
        file["far_group"] = h5py.ExternalLink("sub/b.h5", "/group")
        file["soft"] = h5py.SoftLink("/far_group/x")
        file["near/soft_group"] = h5py.SoftLink("/far_group/deeper")
    return folder / "a.h5"


@pytest.mark.parametrize("block", [0, 512, 16384])
def test_a_dataset_is_read_from_the_file_in_which_it_lies(
    h5py: Any, tmp_path: Path, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = away(h5py, tmp_path, block)
    for member in ("far", "far_soft", "far_group/x", "soft"):
        same(f"{path}:{member}", VALUES, mapped=True)
    for member in ("near/soft_group/y", "near/soft_group", "far_group/deeper"):
        same(path, VALUES[0], "u2", mapped=True, member=member)
    same(f"{path}:far_group/chunked", VALUES + 1)
    monkeypatch.chdir(tmp_path / "sub")
    same("../a.h5:/far", VALUES, mapped=True)


def test_a_file_that_is_itself_a_link(h5py: Any, tmp_path: Path) -> None:
    path = away(h5py, tmp_path)
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "a.h5").symlink_to(path)
    same(f"{tmp_path}/elsewhere/a.h5:far", VALUES, mapped=True)


def test_links_through_several_files(h5py: Any, tmp_path: Path) -> None:
    away(h5py, tmp_path)
    with h5py.File(tmp_path / "c.h5", "w") as file:
        file["again"] = h5py.ExternalLink("a.h5", "/soft")
        file["all"] = h5py.ExternalLink("a.h5", "/")
    same(f"{tmp_path}/c.h5:again", VALUES, mapped=True)
    same(f"{tmp_path}/c.h5:all/far_group/x", VALUES, mapped=True)


def test_what_is_behind_links_is_listed_once(h5py: Any, tmp_path: Path) -> None:
    error = refusal(away(h5py, tmp_path))
    assert error.reason == "source-member"
    listed = str(error.found)
    assert "/own (3 x 4 x 5 of float32), /padding" in listed
    assert listed.count("3 x 4 x 5 of float32") == 3  # own, x, chunked: whatever leads to them
    assert listed.count("4 x 5 of uint16") == 1
    assert "far" in listed


def test_a_file_of_one_link_opens_it(h5py: Any, tmp_path: Path) -> None:
    away(h5py, tmp_path)
    with h5py.File(tmp_path / "master.h5", "w") as file:
        file["data"] = h5py.ExternalLink("sub/b.h5", "/group/x")
    same(tmp_path / "master.h5", VALUES, mapped=True)
    model = hmkcta.compress(open_array(tmp_path / "master.h5"), "R=3,4,5")
    assert np.allclose(np.asarray(model), VALUES, atol=0.1)


def test_links_in_circles_end(h5py: Any, tmp_path: Path) -> None:
    for own, other in (("a", "b"), ("b", "a")):
        with h5py.File(tmp_path / f"{own}.h5", "w") as file:
            file[f"data_{own}"] = VALUES
            file["round"] = h5py.ExternalLink(f"{other}.h5", "/")
            file["group/up"] = h5py.SoftLink("/")
            file["self"] = h5py.SoftLink("/self")
    error = refusal(tmp_path / "a.h5")
    assert "/data_a (3 x 4 x 5 of float32)" in str(error)
    assert "/round/data_b (3 x 4 x 5 of float32)" in str(error)
    assert "/self (not read: a link to /self, which is not there)" in str(error)


def test_links_to_what_is_not_there_are_listed_with_why(h5py: Any, tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["own"] = VALUES
        file["gone"] = h5py.ExternalLink("gone.h5", "/x")
        file["soft"] = h5py.SoftLink("/nowhere")
    error = refusal(tmp_path / "a.h5")
    assert "/gone (not read: a link to /x in gone.h5, which cannot be opened), /own (3 x 4" in str(error)
    same(f"{tmp_path}/a.h5:own", VALUES, mapped=True)
    error = refusal(f"{tmp_path}/a.h5:gone")
    assert (error.kind, error.reason) == (Kind.IO, "source-incomplete")
    assert "gone.h5" in str(error)


@pytest.mark.parametrize("pieces", [[240], [100, 140], [8, 8, 224]])
@pytest.mark.parametrize("linked", [False, True])
def test_numbers_in_raw_files_beside(
    h5py: Any, tmp_path: Path, pieces: list[int], linked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which HDF5 looks for in the folder at hand, and reads as zeros where they end too early."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sub").mkdir()
    data, external, at = VALUES.tobytes(), list[tuple[str, int, int]](), 0
    for number, size in enumerate(pieces):
        (tmp_path / "sub" / f"{number}.raw").write_bytes(b"abc" + data[at:at + size])
        external.append((f"{number}.raw", 3, size))
        at += size
    with h5py.File("sub/e.h5", "w") as file:
        file.create_dataset("e", shape=VALUES.shape, dtype="f4", external=external)
    with h5py.File("a.h5", "w") as file:
        file["far"] = h5py.ExternalLink("sub/e.h5", "/e")
    path = tmp_path / ("a.h5" if linked else "sub/e.h5")
    same(path, VALUES, mapped=len(pieces) == 1)
    last = tmp_path / "sub" / f"{len(pieces) - 1}.raw"
    last.write_bytes(last.read_bytes()[:-4])
    assert refusal(path).reason == "source-truncated"
    last.unlink()
    error = refusal(path)
    assert error.reason == "source-incomplete"
    assert last.name in str(error)


def test_raw_files_of_one_name_are_not_mixed_up(h5py: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sub").mkdir()
    VALUES.tofile(tmp_path / "sub" / "x.raw")
    (tmp_path / "x.raw").write_bytes(bytes(240))
    with h5py.File(tmp_path / "sub" / "e.h5", "w") as file:
        file.create_dataset("e", shape=VALUES.shape, dtype="f4", external=[("x.raw", 0, h5py.h5f.UNLIMITED)])
    monkeypatch.chdir(tmp_path)
    assert refusal("sub/e.h5").reason == "source-incomplete"
    monkeypatch.setenv("HDF5_EXTFILE_PREFIX", "${ORIGIN}")
    same("sub/e.h5", VALUES, mapped=True)


def virtual(h5py: Any, path: Path, file_name: str, name: str, shape: tuple[int, ...] = VALUES.shape) -> None:
    """A file with a virtual dataset that is all of another dataset."""
    layout = h5py.VirtualLayout(shape, "f4")
    layout[...] = h5py.VirtualSource(file_name, name, shape)
    with h5py.File(path, "w") as file:
        file.create_virtual_dataset("v", layout, fillvalue=-1)


def test_virtual_datasets_behind_links(h5py: Any, tmp_path: Path) -> None:
    away(h5py, tmp_path)
    virtual(h5py, tmp_path / "sub" / "v.h5", "b.h5", "group/x")
    virtual(h5py, tmp_path / "sub" / "w.h5", "v.h5", "v")
    with h5py.File(tmp_path / "m.h5", "w") as file:
        file["one"], file["two"] = h5py.ExternalLink("sub/v.h5", "/v"), h5py.ExternalLink("sub/w.h5", "/v")
    same(f"{tmp_path}/m.h5:one", VALUES)
    same(f"{tmp_path}/m.h5:two", VALUES)
    shutil.move(tmp_path / "sub" / "b.h5", tmp_path / "b.h5")  # where the path is that was given
    for uri in ("m.h5:one", "m.h5:two", "sub/w.h5"):
        error = refusal(f"{tmp_path}/{uri}")
        assert error.reason == "source-incomplete"
        assert "b.h5" in str(error)


def test_a_virtual_dataset_of_what_is_not_in_its_source(h5py: Any, tmp_path: Path) -> None:
    away(h5py, tmp_path)
    virtual(h5py, tmp_path / "v.h5", "sub/b.h5", "group/z")
    assert refusal(tmp_path / "v.h5").reason == "source-incomplete"
    virtual(h5py, tmp_path / "w.h5", "sub/b.h5", "group/x", (3, 4, 6))
    assert refusal(tmp_path / "w.h5").kind in (Kind.IO, Kind.INVALID_ARGUMENT)


def test_detached_headers_name_files_beside_themselves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sub").mkdir()
    needed("nrrd").write(str(tmp_path / "sub" / "a.nhdr"), VALUES, {"encoding": "raw"})
    (tmp_path / "a.nhdr").symlink_to(tmp_path / "sub" / "a.nhdr")
    monkeypatch.chdir(tmp_path)
    same("sub/a.nhdr", VALUES, mapped=True)
    same("a.nhdr", VALUES, mapped=True)


def test_pairs_of_nifti_are_looked_for_where_a_link_leads(tmp_path: Path) -> None:
    nibabel = needed("nibabel")
    (tmp_path / "sub").mkdir()
    nibabel.save(nibabel.Nifti1Pair(VALUES, np.eye(4)), tmp_path / "sub" / "a.hdr")
    for ending in ("hdr", "img"):
        (tmp_path / f"{ending}.{ending}").symlink_to(tmp_path / "sub" / f"a.{ending}")
        same(tmp_path / f"{ending}.{ending}", VALUES, mapped=True)
    (tmp_path / "sub" / "a.img").unlink()
    assert refusal(tmp_path / "hdr.hdr").reason == "unreadable"


def test_links_in_zarr_folders_are_listed_like_others(tmp_path: Path) -> None:
    zarr = needed("zarr")
    zarr.create_array(tmp_path / "b.zarr", data=VALUES)
    group = zarr.open_group(tmp_path / "a.zarr", mode="w")
    group.create_array("own", data=VALUES[0])
    (tmp_path / "a.zarr" / "far").symlink_to(tmp_path / "b.zarr")
    (tmp_path / "a.zarr" / "round").symlink_to(tmp_path / "a.zarr")
    assert "far (3 x 4 x 5 of float32), own (4 x 5 of float32)" in str(refusal(tmp_path / "a.zarr"))
    same(f"{tmp_path}/a.zarr:far", VALUES)
    assert os.path.islink(tmp_path / "a.zarr" / "far")


def test_damage_in_either_file_is_refused_or_an_array(h5py: Any, tmp_path: Path) -> None:
    away(h5py, tmp_path)
    with h5py.File(tmp_path / "m.h5", "w") as file:
        file["data"] = h5py.ExternalLink("sub/b.h5", "/soft")
    survives_damage(tmp_path / "m.h5")
    whole, draw = (tmp_path / "sub" / "b.h5").read_bytes(), np.random.default_rng(2)
    for _ in range(200):
        data = bytearray(whole)
        data[int(draw.integers(len(data)))] = int(draw.integers(256))
        (tmp_path / "sub" / "b.h5").write_bytes(data)
        try:
            assert open_array(tmp_path / "m.h5").size > 0
        except hmkcta.HmkctaError as error:
            assert error.reason  # noqa: PT017 (either outcome is right)


#: OME-XML of a file: its name as a number, and its images.
OME = ('<?xml version="1.0"?>'
       '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" UUID="urn:uuid:{}">{}</OME>')
UUIDS = {"a.ome.tif": f"{1:032x}", "b.ome.tif": f"{2:032x}"}


def image(number: int, planes: list[tuple[str, int]]) -> str:
    """An image of OME, of pages of files."""
    data = "".join(f'<TiffData IFD="{page}" FirstZ="{z}" PlaneCount="1"><UUID FileName="{name}">urn:uuid:{UUIDS[name]}'
                   "</UUID></TiffData>" for z, (name, page) in enumerate(planes))
    return (f'<Image ID="Image:{number}"><Pixels ID="Pixels:{number}" DimensionOrder="XYZCT" Type="uint16" SizeX="5" '
            f'SizeY="4" SizeZ="{len(planes)}" SizeC="1" SizeT="1"><Channel ID="Channel:{number}:0"/>{data}</Pixels>'
            "</Image>")


def two_files(folder: Path, images: str, **how: Any) -> dict[str, Any]:
    """Two files of OME-TIFF which both tell of all images; what is in each."""
    values = {"a.ome.tif": VALUES.astype("u2"), "b.ome.tif": VALUES.astype(">u2") + 200}
    for name, own in values.items():
        needed("tifffile").imwrite(folder / name, own, description=OME.format(UUIDS[name], images), metadata=None,
                                   photometric="minisblack", byteorder=own.dtype.byteorder.replace("=", "<"), **how)
    return values


@pytest.mark.parametrize("how", [{}, {"compression": "zlib"}])
def test_images_of_tiff_are_read_from_the_file_in_which_they_lie(
    tmp_path: Path, how: dict[str, Any], recwarn: pytest.WarningsRecorder
) -> None:
    images = image(0, [("a.ome.tif", n) for n in range(3)]) + image(1, [("b.ome.tif", n) for n in range(3)])
    first, second = two_files(tmp_path, images, **how).values()
    for name in UUIDS:
        for number, values in enumerate((first, second)):
            assert np.array_equal(open_array(f"{tmp_path / name}:{number}"), values), (name, number)
    both = image(0, [(name, n) for name in UUIDS for n in range(3)])
    two_files(tmp_path, both, **how)
    assert np.array_equal(open_array(tmp_path / "b.ome.tif"), np.concatenate([first, second]))
    assert not recwarn.list


def test_pages_of_two_tiff_files_that_seem_to_follow_one_another(tmp_path: Path) -> None:
    """Where they lie in the second file is where they would lie in the first."""
    values = two_files(tmp_path, image(0, [("a.ome.tif", 0), ("b.ome.tif", 1), ("b.ome.tif", 2)]))
    expected = [values["a.ome.tif"][0], *values["b.ome.tif"][1:]]
    assert np.array_equal(open_array(tmp_path / "a.ome.tif"), np.stack(expected))


def test_every_tiff_file_is_watched(tmp_path: Path) -> None:
    two_files(tmp_path, image(0, [("a.ome.tif", 0), ("b.ome.tif", 0)]))
    noted: list[Path] = []
    with watched_by(noted.append):
        open_array(tmp_path / "a.ome.tif")
    assert set(noted) == {tmp_path / name for name in UUIDS}
    source = WatchedSource(str(tmp_path / "a.ome.tif"))
    data = (tmp_path / "b.ome.tif").read_bytes()
    (tmp_path / "b.ome.tif").write_bytes(data.replace(b"\0\xc9", b"\0\xca"))
    with pytest.raises(HmkctaError, match="source-changed"):
        source.check(fingerprint_of(source.array))
