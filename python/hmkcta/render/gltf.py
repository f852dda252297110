"""glTF documents before trimesh reads them: bounded, with a scene, and with a material for every primitive.

trimesh follows nodes wherever they lead, for minutes where they lie thousands deep, and places what a few bytes name as
often as they say; and it leaves the texture coordinates of a primitive without a material aside.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ..errors import HmkctaError, invalid

#: Nodes, and primitives, each counted as often as its mesh is placed; and how deep nodes may lie in nodes.
MOST_PARTS, DEEPEST = 20_000, 256

_MAGIC, _JSON_CHUNK = b"glTF", b"JSON"
_HEAD = struct.Struct("<4sIII4s")


def prepared(path: Path, most_triangles: int) -> bytes:
    """The bytes of a .glb or .gltf file, checked, to be given to trimesh.

    Raises:
        HmkctaError: nodes that are no trees, or parts, elements or triangles beyond what a surface may have.
        ValueError, KeyError, TypeError, IndexError, AttributeError, struct.error: this is no glTF document.
    """
    data = path.read_bytes()
    if data[:4] != _MAGIC:
        return json.dumps(_checked(json.loads(data), path, most_triangles)).encode()
    magic, version, _, length, kind = _HEAD.unpack_from(data)
    if kind != _JSON_CHUNK:
        raise ValueError("the first chunk is not JSON")
    text = json.dumps(_checked(json.loads(data[_HEAD.size : _HEAD.size + length]), path, most_triangles)).encode()
    text += b" " * (-len(text) % 4)
    rest = data[_HEAD.size + length :]
    return _HEAD.pack(magic, version, _HEAD.size + len(text) + len(rest), len(text), kind) + text + rest


def _checked(document: Any, path: Path, most_triangles: int) -> Any:
    """The document if it is bounded, with a scene, and with an empty material where a primitive has none."""
    if not document.get("scenes"):
        inside = {int(child) for node in document.get("nodes", []) for child in node.get("children", [])}
        roots = [number for number in range(len(document.get("nodes", []))) if number not in inside]
        document.update(scenes=[{"nodes": roots}], scene=0)
    for number, accessor in enumerate(document.get("accessors", [])):
        if not 0 <= int(accessor["count"]) <= 3 * most_triangles:
            raise _refused(path, f"{accessor['count']} elements in accessor {number}", f"at most {3 * most_triangles}")
    triangles = 0
    for parts, primitive in enumerate(_placed(document, path), start=1):
        triangles += _corners(document, primitive) // 3
        if parts > MOST_PARTS or triangles > most_triangles:
            raise _refused(path, f"more than {MOST_PARTS} parts" if parts > MOST_PARTS
                           else f"more than {most_triangles} triangles", "fewer: join or simplify them in a modeller")
    bare = [p for mesh in document.get("meshes", []) for p in mesh["primitives"] if "material" not in p]
    if bare:
        document.setdefault("materials", []).append({})
        for primitive in bare:
            primitive["material"] = len(document["materials"]) - 1
    return document


def _placed(document: Mapping[str, Any], path: Path) -> Iterator[Mapping[str, Any]]:
    """The primitives of all nodes of the scene, each as often as it is placed; glTF's nodes are trees."""
    nodes, meshes = document.get("nodes", []), document.get("meshes", [])
    if len(nodes) > MOST_PARTS:
        raise _refused(path, f"{len(nodes)} nodes", f"at most {MOST_PARTS}")
    visited: set[int] = set()
    waiting = [(int(root), 0) for root in document["scenes"][document.get("scene", 0)].get("nodes", [])]
    while waiting:
        number, depth = waiting.pop()
        if number in visited or depth > DEEPEST:
            found = (f"node {number} in several places, or inside itself" if number in visited
                     else f"node {number} more than {DEEPEST} nodes deep")
            raise _refused(path, found, f"nodes that are trees, at most {DEEPEST} deep")
        visited.add(number)
        waiting += [(int(child), depth + 1) for child in nodes[number].get("children", [])]
        if "mesh" in nodes[number]:
            yield from meshes[nodes[number]["mesh"]]["primitives"]


def _corners(document: Mapping[str, Any], primitive: Mapping[str, Any]) -> int:
    """The corners of all triangles of a primitive, from its indices or, without them, its vertices."""
    accessor = primitive.get("indices", primitive["attributes"].get("POSITION"))
    return 0 if accessor is None else int(document["accessors"][accessor]["count"])


def _refused(path: Path, found: str, allowed: str) -> HmkctaError:
    return invalid("bad-mesh", str(path), found, allowed)
