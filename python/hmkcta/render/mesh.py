"""Surfaces with texture coordinates and tangents: sphere, plane, draped cloth, and meshes from files.

Positions are world coordinates (z up), texture coordinates count repeats of the texels, v along growing rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError, Kind, invalid
from ..support.optional import library
from .gltf import prepared
from .scene import Surface

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

SPHERE_QUADS = (128, 64)
CLOTH_QUADS = (128, 128)
FILES = (".obj", ".gltf", ".glb", ".ply")
MOST_TRIANGLES = 2_000_000


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of a surface.

    Attributes:
        position, normal: ``[vertices, 3]``, float32.
        tangent: ``[vertices, 4]``: along growing u; its last number h says that ``h * cross(normal, tangent)`` points
            along growing v.
        uv: ``[vertices, 2]``.
        triangles: vertex numbers, ``[triangles, 3]``, uint32.
    """

    position: F32
    normal: F32
    tangent: F32
    uv: F32
    triangles: NDArray[np.uint32]

    def vertices(self) -> F32:
        """What `gbuffer.wgsl` reads: position, normal, tangent, uv of each vertex, ``[vertices, 12]``."""
        return np.ascontiguousarray(np.concatenate([self.position, self.normal, self.tangent, self.uv], axis=1))


def make_mesh(surface: Surface, rows: int, columns: int) -> Mesh:
    """The surface of a scene; a plane gets the shape of the ``rows x columns`` texels.

    >>> make_mesh(Surface("plane"), 10, 20).position[0].tolist()
    [0.0, -1.0, 0.5]

    Raises:
        HmkctaError: the shape is unknown, or its file cannot be read or has no texture coordinates.
    """
    if surface.shape == "sphere":
        return sphere(surface.repeat)
    if surface.shape == "plane":
        return plane(surface.repeat, rows * surface.repeat[1] / (columns * surface.repeat[0]))
    if surface.shape == "cloth":
        return cloth(surface.repeat)
    if Path(surface.shape).suffix.lower() in FILES:
        return load_mesh(Path(surface.shape), surface.repeat)
    raise invalid("unknown-shape", "surface.shape", repr(surface.shape),
                  f"sphere, plane, cloth, or a file that ends with {', '.join(FILES)}")


def sphere(repeat: tuple[float, float] = (1.0, 1.0)) -> Mesh:
    """Unit sphere with poles along z; the texels come twice as often around as from pole to pole."""
    u, v, triangles = _quads(*SPHERE_QUADS)
    azimuth, polar = 2 * np.pi * (u - 0.5), np.pi * v
    flat = np.sin(polar)
    normal = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.cos(polar)], axis=1)
    tangent = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros_like(u), -np.ones_like(u)], axis=1)
    return _mesh(normal, normal, tangent, np.stack([2 * repeat[0] * u, repeat[1] * v], axis=1), triangles)


def plane(repeat: tuple[float, float] = (1.0, 1.0), height: float = 1.0) -> Mesh:
    """Upright rectangle 2 wide and ``2 height`` high at x = 0 that faces +x."""
    u, v, triangles = _quads(1, 1)
    position = np.stack([np.zeros_like(u), 2 * u - 1, height * (1 - 2 * v)], axis=1)
    normal = np.broadcast_to([1.0, 0.0, 0.0], position.shape)
    tangent = np.broadcast_to([0.0, 1.0, 0.0, -1.0], (len(u), 4))
    return _mesh(position, normal, tangent, np.stack([repeat[0] * u, repeat[1] * v], axis=1), triangles)


def cloth(repeat: tuple[float, float] = (1.0, 1.0)) -> Mesh:
    """A cloth draped over something round: flat in the middle, falling in folds around it."""
    u, v, triangles = _quads(*CLOTH_QUADS)
    step = 1e-4
    along_u = (_drape(u + step, v) - _drape(u - step, v)) / (2 * step)
    along_v = (_drape(u, v + step) - _drape(u, v - step)) / (2 * step)
    normal = np.cross(along_v, along_u)
    tangent = np.concatenate([along_u, -np.ones((len(u), 1))], axis=1)
    uv = np.stack([repeat[0] * u, repeat[1] * v], axis=1)
    return _mesh(_drape(u, v), normal, tangent, uv, triangles)


def load_mesh(path: Path, repeat: tuple[float, float] = (1.0, 1.0)) -> Mesh:
    """A mesh of a file with texture coordinates; its y axis (up) becomes z, its largest half extent 1.

    Raises:
        HmkctaError: trimesh is missing, the file cannot be read, is too large or has no texture coordinates.
    """
    reader = library("trimesh", "trimesh", "mesh", "surface.shape")
    if not path.is_file():
        raise HmkctaError(Kind.IO, "unreadable", str(path), found="no such file", allowed="a mesh",
                          told="cannot be read: no such file")
    try:
        loaded = _loaded(reader, path)
        uv = np.asarray(getattr(loaded.visual, "uv", None), np.float64)
        corners = np.asarray(loaded.faces, np.uint32)
        position, normal = (np.asarray(a, np.float64)[:, [2, 0, 1]] for a in (loaded.vertices, loaded.vertex_normals))
    except HmkctaError:
        raise
    except Exception as error:  # any of trimesh's many readers' exceptions: the file is at fault
        raise invalid("bad-mesh", str(path), f"{type(error).__name__}: {error}", "a mesh that trimesh reads") from error
    if uv.shape != (len(position), 2):
        raise invalid("no-texture-coordinates", str(path), f"{len(position)} vertices without texture coordinates",
                      "a mesh with texture coordinates", "unwrap it in a modeller")
    if not 0 < len(corners) <= MOST_TRIANGLES or not (np.isfinite(position).all() and np.isfinite(uv).all()):
        raise invalid("bad-mesh", str(path), f"{len(corners)} triangles", f"1 to {MOST_TRIANGLES}, of finite numbers")
    middle = (position.min(axis=0) + position.max(axis=0)) / 2
    position = (position - middle) / max(float(np.abs(position - middle).max()), 1e-12)
    uv = np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1)  # files count v from the bottom
    tangent = _tangents(position, normal, uv, corners)
    return _mesh(position, normal, tangent, uv * repeat, corners)


def _loaded(reader: Any, path: Path) -> Any:
    """What trimesh makes of a file."""
    if path.suffix.lower() not in (".gltf", ".glb"):
        return reader.load(str(path), force="mesh", process=False)
    kind = "glb" if path.read_bytes()[:4] == b"glTF" else "gltf"
    return reader.load(BytesIO(prepared(path, MOST_TRIANGLES)), file_type=kind, force="mesh", process=False,
                       resolver=reader.resolvers.FilePathResolver(str(path)))


def _drape(u: F64, v: F64) -> F64:
    """The cloth's point at (u, v), ``[b, 3]``."""
    x, y = 1.3 * (2 * v - 1), 1.3 * (2 * u - 1)
    angle = np.arctan2(y, x)
    share = np.clip((np.hypot(x, y) - 0.45) / (1.6 - 0.45), 0, 1)
    fall = share * share * (3 - 2 * share)
    folds = 0.15 * np.cos(6 * angle + 0.5) + 0.05 * np.cos(11 * angle)
    return np.stack([x, y, 0.7 + fall * (folds - 1.15)], axis=1)


def _quads(across: int, down: int) -> tuple[F64, F64, NDArray[np.uint32]]:
    """u, v of a grid's vertices, and the two triangles of each of its ``across x down`` quads."""
    v, u = (a.reshape(-1) for a in np.meshgrid(np.linspace(0, 1, down + 1), np.linspace(0, 1, across + 1),
                                               indexing="ij"))
    corner = (np.arange(down)[:, None] * (across + 1) + np.arange(across)).reshape(-1, 1)
    below = corner + across + 1
    triangles = np.concatenate([corner, below, corner + 1, corner + 1, below, below + 1], axis=1).reshape(-1, 3)
    return u, v, triangles.astype(np.uint32)


def _tangents(position: F64, normal: F64, uv: F64, triangles: NDArray[np.uint32]) -> F64:
    """Tangents of a mesh, the triangles' averaged at each vertex, with handedness (Lengyel 2001)."""
    edge = position[triangles[:, 1:]] - position[triangles[:, :1]]
    step = uv[triangles[:, 1:]] - uv[triangles[:, :1]]
    area = step[:, 0, 0] * step[:, 1, 1] - step[:, 1, 0] * step[:, 0, 1]
    inverse = np.where(np.abs(area) > 1e-20, 1 / np.where(area == 0, 1, area), 0)[:, None]
    along_u = (edge[:, 0] * step[:, 1:, 1] - edge[:, 1] * step[:, :1, 1]) * inverse
    along_v = (edge[:, 1] * step[:, :1, 0] - edge[:, 0] * step[:, 1:, 0]) * inverse
    sums = np.zeros((2, len(position), 3))
    for corner in range(3):
        np.add.at(sums[0], triangles[:, corner], along_u)
        np.add.at(sums[1], triangles[:, corner], along_v)
    side = np.einsum("vk,vk->v", np.cross(normal, sums[0]), sums[1])
    return np.concatenate([sums[0], np.where(side < 0, -1.0, 1.0)[:, None]], axis=1)


def _mesh(position: F64, normal: F64, tangent: F64, uv: F64, triangles: NDArray[np.uint32]) -> Mesh:
    """Unit normals, unit tangents across them, float32."""
    unit = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    across = tangent[:, :3] - np.einsum("vk,vk->v", tangent[:, :3], unit)[:, None] * unit
    lost = np.linalg.norm(across, axis=1) < 1e-9  # no direction of u: any one will do
    other = np.cross(unit[lost], np.where(np.abs(unit[lost, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
    across[lost] = other
    across = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    full = np.concatenate([across, tangent[:, 3:]], axis=1)
    places, normals, tangents, texture = (np.ascontiguousarray(a, np.float32) for a in (position, unit, full, uv))
    return Mesh(places, normals, tangents, texture, np.ascontiguousarray(triangles))
