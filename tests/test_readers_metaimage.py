"""MetaImage against metaimageio, and against ITK where it is there: numbers, positions, lengths, refusals."""

from __future__ import annotations

import zlib
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli_tools import report
from hmkcta.errors import Kind
from hmkcta.labels import labels_of
from hmkcta.readers import open_array
from reader_tools import (
    VALUES,
    axes_of,
    coords_of,
    needed,
    refusal,
    refused_wherever_cut,
    same,
    survives_damage,
)

TYPES = ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"]


def written(path: Path, values: Any = VALUES, **fields: Any) -> Path:
    """A MetaImage of values ``[x, y, z]`` as metaimageio writes it."""
    needed("metaimageio").write(path, np.ascontiguousarray(values.T), **fields)
    return path


@pytest.mark.parametrize(("ending", "packed", "dtype"), list(product((".mha", ".mhd"), (False, True), TYPES)))
def test_metaimages_are_what_metaimageio_reads(tmp_path: Path, ending: str, packed: bool, dtype: str) -> None:
    if packed and dtype in ("i8", "u8"):
        pytest.skip("packed numbers do not tell how long a LONG is")
    path = written(tmp_path / f"a{ending}", VALUES.astype(dtype), CompressedData=packed)
    expected, _ = needed("metaimageio").read(path)
    same(path, expected.T, VALUES.astype(dtype).dtype, mapped=not packed)


def test_positions_become_coordinates(tmp_path: Path) -> None:
    array = open_array(written(tmp_path / "a.mha", Offset=[-10, 5, 0.5], ElementSpacing=[0.5, 2, 3]))
    assert [(axis.name, axis.role, axis.unit) for axis in axes_of(array).values()] == [
        (name, "space", "mm") for name in "xyz"]
    assert coords_of(array) == [
        [-10, -9.5, -9], [5, 7, 9, 11], [0.5, 3.5, 6.5, 9.5, 12.5]]
    turned = open_array(written(tmp_path / "b.mha", TransformMatrix=[[0, 1, 0], [-1, 0, 0], [0, 0, 1]]))
    assert coords_of(turned) == []
    assert "askew" in labels_of(turned).notes[0]


@pytest.mark.parametrize("packed", [False, True])
def test_metaimages_are_what_itk_writes(tmp_path: Path, packed: bool) -> None:
    itk: Any = pytest.importorskip("SimpleITK", reason="ITK is no dependency")
    for ending, is_vector, dtype in product((".mha", ".mhd"), (False, True), TYPES):
        values = np.arange(120).reshape(5, 4, 3, 2).astype(dtype)  # z, y, x, channel
        image = itk.GetImageFromArray(values if is_vector else values[..., 0], isVector=is_vector)
        image.SetSpacing((0.5, 2.0, 3.0))
        image.SetOrigin((1.0, -2.0, 3.5))
        path = tmp_path / f"{dtype}{is_vector}{ending}"
        itk.WriteImage(image, str(path), packed)
        same(path, np.swapaxes(values, 0, 2) if is_vector else values[..., 0].T, mapped=not packed)
        array = open_array(path)
        assert list(axes_of(array)) == ["x", "y", "z", "channel"][:array.ndim]
        assert coords_of(array)[1] == [image.TransformIndexToPhysicalPoint((0, n, 0))[1] for n in range(4)]


HEADER = "ObjectType = Image\nNDims = 3\nDimSize = 3 4 5\n"


def test_byte_orders_text_and_bytes_before(tmp_path: Path) -> None:
    numbers = VALUES.tobytes("F")
    cases = (
        ("ElementByteOrderMSB = True\nElementType = MET_FLOAT\n", VALUES.astype(">f4").tobytes("F"), True),
        ("BinaryData = False\nElementType = MET_FLOAT\n", " ".join(map(str, VALUES.ravel("F"))).encode(), False),
        ("HeaderSize = 7\nElementType = MET_FLOAT\n", b"1234567" + numbers, True),
        ("HeaderSize = -1\nElementType = MET_FLOAT\n", b"any number of bytes" + numbers, True))
    for fields, data, mapped in cases:
        (tmp_path / "a.mhd").write_text(f"{HEADER}{fields}ElementDataFile = a.raw\n")
        (tmp_path / "a.raw").write_bytes(data)
        same(tmp_path / "a.mhd", VALUES, ">f4" if "MSB" in fields else "f4", mapped=mapped)


def test_metaimages_are_as_long_as_they_say(tmp_path: Path) -> None:
    for ending, packed in product((".mha", ".mhd"), (False, True)):
        path = written(tmp_path / f"a{ending}", CompressedData=packed)
        data = path if ending == ".mha" else path.with_suffix(".zraw" if packed else ".raw")
        whole = data.read_bytes()
        for changed, reason in ((whole[:-1], "source-truncated"), (whole + b"\0", "source-too-long")):
            data.write_bytes(changed)
            error = refusal(path)
            assert (error.kind, error.reason) == (Kind.IO, reason)
        data.unlink()
        assert refusal(path).reason == "unreadable"


@pytest.mark.parametrize(("count", "reason"), [(59, "source-truncated"), (61, "source-too-long")])
def test_packed_numbers_are_as_many_as_the_header_says(tmp_path: Path, count: int, reason: str) -> None:
    data = zlib.compress(np.arange(count, dtype="f4").tobytes())
    fields = f"CompressedData = True\nCompressedDataSize = {len(data)}\nElementType = MET_FLOAT\n"
    (tmp_path / "a.mha").write_bytes(f"{HEADER}{fields}ElementDataFile = LOCAL\n".encode() + data)
    assert refusal(tmp_path / "a.mha").reason == reason


@pytest.mark.parametrize(("change", "reason"), [
    ("ElementDataFile = LIST", "source-format"), ("ElementDataFile = a%02d.raw 1 5 1", "source-format"),
    ("ElementType = MET_STRING", "source-format"), ("ObjectType = Mesh", "source-format"), ("NDims = 2",
    "source-damaged"), ("DimSize = 3 4", "source-damaged"), ("DimSize = 3 0 5", "source-shape"),
    ("DimSize = 3 4 5000000000000", "source-truncated"), ("ElementType =", "source-damaged"),
    ("DimSize = a b c", "source-damaged"),
])
def test_what_headers_of_metaimages_may_not_say(tmp_path: Path, change: str, reason: str) -> None:
    lines = [*HEADER.splitlines(), "ElementType = MET_FLOAT", "ElementDataFile = LOCAL"]
    name = change.partition(" =")[0]
    text = "\n".join(change if line.startswith(name) else line for line in lines) + "\n"
    (tmp_path / "a.mha").write_bytes(text.encode() + VALUES.tobytes())
    assert refusal(tmp_path / "a.mha").reason == reason


def test_cut_and_damaged_metaimages(tmp_path: Path) -> None:
    for packed in (False, True):
        path = written(tmp_path / f"{packed}.mha", CompressedData=packed)
        refused_wherever_cut(path, 7)
        survives_damage(path)


def test_a_metaimage_end_to_end(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mhd", Offset=[1, 2, 3], CompressedData=True)
    report("compress", path, "-o", tmp_path / "a.hmk", "--plan", "R=2,2,2")
    found = report("info", tmp_path / "a.hmk")
    assert found["kind"] == "volume"
    assert [axis["name"] for axis in found["axes"]] == ["x", "y", "z"]
