"""Compute passes of the renderers: pipelines with an explicit layout of group 1, textures up and down."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from .device import Device
from .upload import DecoderBuffers

F32 = NDArray[np.float32]

TILE = 8  # pixels a side of a workgroup


@dataclass(frozen=True)
class Slot:
    """One binding: ``uniform``, ``storage``, ``texture`` (read by textureLoad) or ``out``; its dimension and format."""

    kind: str
    view: str = "2d"
    format: str = ""

    def entry(self, binding: int) -> dict[str, Any]:
        """What wgpu calls it."""
        kinds = {
            "uniform": {"buffer": {"type": "uniform"}},
            "storage": {"buffer": {"type": "read-only-storage"}},
            "texture": {"texture": {"sample_type": "unfilterable-float", "view_dimension": self.view}},
            "out": {"storage_texture": {"access": "write-only", "format": self.format, "view_dimension": self.view}},
        }
        return {"binding": binding, "visibility": "COMPUTE", **kinds[self.kind]}


@final
class ComputePass:
    """A pipeline with its own bindings in group 1, and a decoder's, or none, in group 0."""

    def __init__(self, device: Device, entry: str, code: str, slots: Sequence[Slot],
                 decoder: DecoderBuffers | None = None) -> None:
        self._device = device
        self._label = entry
        entries = [slot.entry(n) for n, slot in enumerate(slots)]
        self._own = device.gpu.create_bind_group_layout(label=entry, entries=entries)
        nothing = device.layout("nothing", [])
        self._nothing = device.group("nothing", nothing, [])
        self._pipeline = device.pipeline(entry, code, [decoder.layout if decoder else nothing, self._own])

    def run(self, resources: Sequence[Any], groups: tuple[int, int, int], decoder: Any = None) -> None:
        """Dispatch once; `resources` are buffers and textures in the order of the slots, `decoder` its bind group."""
        entries = [{"binding": n, "resource": _resource(resource)} for n, resource in enumerate(resources)]
        own = self._device.gpu.create_bind_group(label=self._label, layout=self._own, entries=entries)
        self._device.dispatch(self._pipeline, [decoder or self._nothing, own], groups)


def _resource(resource: Any) -> Any:
    """A buffer as wgpu binds it; a texture by a view of all of it."""
    if hasattr(resource, "create_view"):
        return resource.create_view()
    return {"buffer": resource, "offset": 0, "size": resource.size}


def tiles(width: int, height: int, depth: int = 1) -> tuple[int, int, int]:
    """Workgroups that cover a picture.

    >>> tiles(9, 8)
    (2, 1, 1)
    """
    return -(-width // TILE), -(-height // TILE), depth


def out_texture(device: Device, label: str, size: tuple[int, int, int], format: str, dimension: str = "2d") -> Any:
    """A texture that a pass writes and another one reads, or that is read back."""
    return device.gpu.create_texture(label=label, size=size, format=format, dimension=dimension,
                                     usage="STORAGE_BINDING|TEXTURE_BINDING|COPY_SRC")


def picture_texture(device: Device, label: str, picture: F32) -> Any:
    """A picture ``[height, width, 4]`` as a texture rgba32float."""
    height, width = picture.shape[:2]
    texture = device.gpu.create_texture(label=label, size=(width, height, 1), format="rgba32float",
                                        usage="TEXTURE_BINDING|COPY_DST")
    device.gpu.queue.write_texture({"texture": texture}, np.ascontiguousarray(picture, np.float32),
                                   {"bytes_per_row": 16 * width, "rows_per_image": height}, (width, height, 1))
    return texture


def read_texture(device: Device, texture: Any, dtype: str, channels: int) -> NDArray[Any]:
    """What a texture holds, ``[height, width, channels]``."""
    width, height = texture.size[:2]
    row = np.dtype(dtype).itemsize * channels * width
    data = device.gpu.queue.read_texture({"texture": texture}, {"bytes_per_row": row, "rows_per_image": height},
                                         (width, height, 1))
    return np.frombuffer(bytes(data), dtype).reshape(height, width, channels)
