"""VTK's images and rectilinear grids: by the format's definition, and by VTK itself where it is there."""

from __future__ import annotations

import struct
import zlib
from base64 import b64encode
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cli_tools import report
from hmkcta.errors import Kind
from hmkcta.labels import labels_of
from hmkcta.readers import open_array
from reader_tools import VALUES, coords_of, refusal, refused_wherever_cut, roles_of, same, survives_damage

TYPES = {"Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4", "UInt32": "u4", "Int64": "i8",
         "UInt64": "u8", "Float32": "f4", "Float64": "f8"}
ENCODINGS = ("ascii", "base64", "raw", "appended base64")


def packed(numbers: NDArray[Any], encoding: str, count: str, block: int) -> bytes:
    """Numbers as VTK's XML format has them: how many bytes, or blocks and their lengths, then they."""
    data = numbers.tobytes()
    if not block:
        whole = struct.pack(count, len(data)) + data
        return whole if encoding == "raw" else b64encode(whole)
    parts = [data[at:at + block] for at in range(0, len(data), block)]
    last = len(data) % block
    blocks = [zlib.compress(part) for part in parts]
    sizes = struct.pack(f"{count[0]}{3 + len(parts)}{count[1]}", len(parts), block, last, *map(len, blocks))
    body = b"".join(blocks)
    return sizes + body if encoding == "raw" else b64encode(sizes) + b64encode(body)


def grid(path: Path, arrays: Sequence[tuple[str, str, NDArray[Any]]], encoding: str = "raw", block: int = 0,
         order: str = "<", wide: bool = False, extent: str = "0 4 0 3 0 2", more: str = "") -> Path:
    """A file of arrays ``(place, name, [z, y, x])``; of cells and coordinates these have fewer axes or indices."""
    kind = "RectilinearGrid" if path.suffix == ".vtr" else "ImageData"
    count, appended = order + ("Q" if wide else "I"), b""
    elements = {"PointData": b"", "CellData": b"", "Coordinates": b""}
    names = {value: name for name, value in TYPES.items()}
    for place, name, numbers in arrays:
        tuples = f' NumberOfComponents="{numbers.shape[-1]}"' if numbers.ndim == 4 else ""
        tag = f'<DataArray type="{names[numbers.dtype.str[1:]]}" Name="{name}"{tuples} '
        stored = numbers.astype(numbers.dtype.newbyteorder(">" if order == ">" else "<"))
        text = b" ".join(str(number).encode() for number in numbers.ravel().tolist())
        if encoding in ("ascii", "base64"):
            form = "ascii" if encoding == "ascii" else "binary"
            body = b"\n  " + (text if form == "ascii" else packed(stored, encoding, count, block)) + b"\n  "
            tag += f'format="{form}">'
            elements[place] += tag.encode() + body + b"</DataArray>\n"
        else:
            elements[place] += (tag + f'format="appended" offset="{len(appended)}"/>\n').encode()
            appended += packed(stored, encoding.removeprefix("appended "), count, block)
    compressor = ' compressor="vtkZLibDataCompressor"' if block else ""
    begin = (f'<?xml version="1.0"?>\n<VTKFile type="{kind}" version="1.0" '
             f'byte_order="{"Little" if order == "<" else "Big"}Endian" header_type="UInt{64 if wide else 32}"'
             f'{compressor}>\n<{kind} WholeExtent="{extent}" {more}>\n<Piece Extent="{extent}">\n')
    inside = b"".join(f"<{name}>\n".encode() + each + f"</{name}>\n".encode() for name, each in elements.items())
    behind = (f'<AppendedData encoding="{encoding.split()[-1]}">\n _'.encode() + appended + b"\n</AppendedData>\n"
              if appended else b"")
    path.write_bytes(begin.encode() + inside + f"</Piece>\n</{kind}>\n".encode() + behind + b"</VTKFile>")
    return path


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("block", [0, 32, 240, 32768])
@pytest.mark.parametrize(("order", "wide"), [("<", False), ("<", True), (">", False)])
def test_numbers_in_every_encoding(tmp_path: Path, encoding: str, block: int, order: str, wide: bool) -> None:
    vectors = np.arange(180, dtype="f8").reshape(3, 4, 5, 3)
    path = grid(tmp_path / "a.vti", [("PointData", "rho", VALUES), ("PointData", "flow", vectors)], encoding, block,
                order, wide)
    is_mapped, stored = encoding == "raw" and not block, "=" if encoding == "ascii" else order
    same(f"{path}:rho", VALUES, f"{stored}f4", mapped=is_mapped)
    same(f"{path}:flow", vectors, f"{stored}f8", mapped=is_mapped)
    error = refusal(path)
    assert error.reason == "source-member"
    assert "flow (3 x 4 x 5 x 3 of float64), rho (3 x 4 x 5 of float32)" in str(error)


@pytest.mark.parametrize(("encoding", "name"), list(product(ENCODINGS, TYPES)))
def test_number_types_of_vtk(tmp_path: Path, encoding: str, name: str) -> None:
    values = VALUES.astype(TYPES[name])
    same(grid(tmp_path / "a.vti", [("PointData", "a", values)], encoding), values, mapped=encoding == "raw")


def test_positions_of_points_and_cells(tmp_path: Path) -> None:
    cells = np.arange(24, dtype="u1").reshape(2, 3, 4)
    path = grid(tmp_path / "a.vti", [("PointData", "a", VALUES), ("CellData", "b", cells), ("CellData", "a", cells)],
                extent="2 6 0 3 -1 1", more='Origin="1 2 3" Spacing="0.5 1 2"')
    same(f"{path}:b", cells, mapped=True)
    same(f"{path}:CellData/a", cells, mapped=True)
    points, middles = open_array(f"{path}:a"), open_array(f"{path}:b")
    assert coords_of(points) == [[1, 3, 5], [2, 3, 4, 5], [2, 2.5, 3, 3.5, 4]]
    assert coords_of(middles) == [[2, 4], [2.5, 3.5, 4.5], [2.25, 2.75, 3.25, 3.75]]
    assert roles_of(points) == [(name, "space") for name in "zyx"]
    turned = open_array(grid(path, [("PointData", "a", VALUES)], more='Direction="0 1 0 1 0 0 0 0 1"'))
    assert coords_of(turned) == []
    assert "askew" in labels_of(turned).notes[0]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_rectilinear_grids_have_their_positions(tmp_path: Path, encoding: str) -> None:
    along = {"x": [0, 1, 3, 7, 15], "y": [-2, -1, 1, 2], "z": [0.5, 0.75, 4]}
    arrays = [("Coordinates", name, np.array(values, "f8")) for name, values in along.items()]
    cells = np.arange(24, dtype="i2").reshape(2, 3, 4)
    path = grid(tmp_path / "a.vtr", [("PointData", "a", VALUES), ("CellData", "b", cells), *arrays], encoding)
    same(f"{path}:a", VALUES, mapped=encoding == "raw")
    assert coords_of(open_array(f"{path}:a")) == [along["z"], along["y"], along["x"]]
    assert coords_of(open_array(f"{path}:b"))[2] == [0.5, 2, 5, 11]


def test_what_vtk_writes(tmp_path: Path) -> None:
    pytest.importorskip("vtkmodules", reason="VTK is no dependency")
    vtk: Any = pytest.importorskip("vtkmodules.vtkIOXML")
    data: Any = pytest.importorskip("vtkmodules.vtkCommonDataModel")
    numpy_to_vtk: Any = pytest.importorskip("vtkmodules.util.numpy_support").numpy_to_vtk
    vectors = np.random.default_rng(0).random((40, 30, 20, 3))
    for mode, is_packed, order, image in product(("Ascii", "Binary", "Appended"), (0, 1), ("Little", "Big"), (0, 1)):
        made = data.vtkImageData() if image else data.vtkRectilinearGrid()
        made.SetDimensions(20, 30, 40)
        if not image:
            for axis, size in zip("XYZ", (20, 30, 40), strict=True):
                getattr(made, f"Set{axis}Coordinates")(numpy_to_vtk(np.arange(size)**2.0, deep=True))
        for name, values in (("a b", vectors), ("n", np.arange(24000, dtype="i2").reshape(40, 30, 20))):
            array = numpy_to_vtk(values.reshape(24000, *values.shape[3:]), deep=True)
            array.SetName(name)
            made.GetPointData().AddArray(array)
        for encoded in (0, 1):
            path = tmp_path / ("a.vti" if image else "a.vtr")
            writer = vtk.vtkXMLImageDataWriter() if image else vtk.vtkXMLRectilinearGridWriter()
            writer.SetInputData(made)
            writer.SetFileName(str(path))
            getattr(writer, f"SetDataModeTo{mode}")()
            getattr(writer, f"SetByteOrderTo{order}Endian")()
            writer.SetCompressorTypeToZLib() if is_packed else writer.SetCompressorTypeToNone()
            writer.SetEncodeAppendedData(encoded)
            writer.Write()
            found = open_array(f"{path}:a b")
            assert np.allclose(found, vectors, rtol=1e-5 if mode == "Ascii" else 0, atol=0)
            assert np.array_equal(open_array(f"{path}:n").ravel(), np.arange(24000))
            assert image or coords_of(found)[2] == (np.arange(20)**2).tolist()


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("block", [0, 100])
def test_vtk_files_are_as_long_as_they_say(tmp_path: Path, encoding: str, block: int) -> None:
    for extent, reason in (("0 4 0 3 0 3", "source-truncated"), ("0 4 0 3 0 1", "source-too-long"),
                           ("0 4 0 3 0 2000000000", "source-truncated")):
        path = grid(tmp_path / "a.vti", [("PointData", "a", VALUES)], encoding, block, extent=extent)
        error = refusal(path)
        assert (error.kind, error.reason) == (Kind.IO, reason)
    refused_wherever_cut(grid(tmp_path / "b.vti", [("PointData", "a", VALUES)], encoding, block), 5)
    path.write_bytes((tmp_path / "b.vti").read_bytes() + b"more")
    assert refusal(path).reason in ("source-truncated", "source-damaged")


@pytest.mark.parametrize(("change", "reason"), [
    ((b'type="ImageData"', b'type="UnstructuredGrid"'), "source-format"),
    ((b"vtkZLib", b"vtkLZ4"), "source-format"), ((b"<Piece", b"<Piece/><Piece"), "source-format"),
    ((b'Piece Extent="0 4', b'Piece Extent="0 2'), "source-format"), ((b"Float32", b"String"), "source-damaged"),
    ((b'offset="0"', b'offset="-50"'), ""), ((b'offset="0"', b'offset="999999"'), "source-truncated"),
    ((b"0 4 0 3 0 2", b"0 4 0 3 0 -2"), "source-damaged"), ((b'format="appended"', b'format="none"'), ""),
    ((b"<Point", b"<!DOCTYPE a [<!ENTITY b 'c'>]><Point"), "source-damaged"),
    ((b'version="1.0"?>', b'version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]>'), "source-damaged"),
])
def test_what_vtk_files_may_not_say(tmp_path: Path, change: tuple[bytes, bytes], reason: str) -> None:
    path = grid(tmp_path / "a.vti", [("PointData", "a", VALUES)], block=100)
    assert change[0] in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(*change))
    assert reason in refusal(path).reason


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("block", [0, 100])
def test_damaged_vtk_files_are_arrays_or_refused(tmp_path: Path, encoding: str, block: int) -> None:
    path = grid(tmp_path / "a.vti", [("PointData", "a", VALUES)], encoding, block)
    survives_damage(path, 300)


def test_a_grid_end_to_end(tmp_path: Path) -> None:
    path = grid(tmp_path / "a.vti", [("PointData", "a", VALUES)], block=100, more='Origin="1 2 3"')
    report("compress", path, "-o", tmp_path / "a.hmk", "--plan", "R=2,2,2")
    found = report("info", tmp_path / "a.hmk")
    assert found["kind"] == "volume"
    assert [axis["name"] for axis in found["axes"]] == ["z", "y", "x"]
