"""The GPU, or the software Vulkan that stands in for one, through wgpu.

wgpu's own types are incomplete: its objects are `Any` here, and everything but textures goes through `Device`.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from tempfile import gettempdir
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError, Kind

#: The sentence about what to do where there is no adapter.
REMEDY = ("install a Vulkan driver (Debian: apt-get install libvulkan1 mesa-vulkan-drivers, which work without a GPU), "
          "or use the NumPy decoder")

#: Limits that are asked for where an adapter has them; all shaders work with WebGPU's defaults.
_WANTED = ("max-buffer-size", "max-storage-buffer-binding-size", "max-texture-dimension-3d")
#: Workgroups that WebGPU guarantees along one dimension.
_MOST_GROUPS = 65535


@dataclass(frozen=True, eq=False)
class Device:
    """An opened adapter.

    Attributes:
        gpu: the wgpu device.
        name: of the adapter, for people.
        backend: Vulkan, Metal, D3D12 or OpenGL.
        software: whether a processor stands in for a GPU.
        limits: of the device, by WebGPU's names in kebab case.
    """

    gpu: Any
    name: str
    backend: str
    software: bool
    limits: dict[str, int] = field(default_factory=dict[str, int])

    def __str__(self) -> str:
        return f"{self.name} ({self.backend}{', in software' if self.software else ''})"

    def buffer(self, label: str, data: NDArray[Any] | bytes, usage: str = "STORAGE") -> Any:
        """A buffer with these bytes; `usage` are names of WebGPU's usages, joined by `|`."""
        return self.gpu.create_buffer_with_data(label=label, data=data, usage=usage)

    def room(self, label: str, size: int, usage: str = "STORAGE|COPY_SRC|COPY_DST") -> Any:
        """A buffer of `size` bytes, zeros."""
        return self.gpu.create_buffer(label=label, size=size, usage=usage)

    def layout(self, label: str, kinds: Sequence[str] | Mapping[int, str]) -> Any:
        """The layout of a compute pass's bind group of buffers: WebGPU's buffer types, from binding 0 or by binding."""
        entries = [{"binding": binding, "visibility": "COMPUTE", "buffer": {"type": kind}}
                   for binding, kind in _by_binding(kinds)]
        return self.gpu.create_bind_group_layout(label=label, entries=entries)

    def group(self, label: str, layout: Any, buffers: Sequence[Any] | Mapping[int, Any]) -> Any:
        """A bind group of whole buffers, from binding 0 or by binding."""
        entries = [{"binding": binding, "resource": {"buffer": buffer, "offset": 0, "size": buffer.size}}
                   for binding, buffer in _by_binding(buffers)]
        return self.gpu.create_bind_group(label=label, layout=layout, entries=entries)

    def pipeline(self, entry: str, code: str, layouts: Sequence[Any]) -> Any:
        """The compute pipeline of a shader's entry point, with the layouts of its bind groups."""
        module = self.gpu.create_shader_module(label=entry, code=code)
        return self.gpu.create_compute_pipeline(
            label=entry, layout=self.gpu.create_pipeline_layout(label=entry, bind_group_layouts=list(layouts)),
            compute={"module": module, "entry_point": entry})

    def dispatch(self, pipeline: Any, groups: Sequence[Any], counts: tuple[int, int, int]) -> None:
        """Run a compute pass with these bind groups and numbers of workgroups."""
        encoder = self.gpu.create_command_encoder(label="hmkcta")
        work = encoder.begin_compute_pass()
        work.set_pipeline(pipeline)
        for number, group in enumerate(groups):
            work.set_bind_group(number, group)
        work.dispatch_workgroups(*counts)
        work.end()
        self.gpu.queue.submit([encoder.finish()])

    def read(self, buffer: Any) -> NDArray[np.uint32]:
        """The words of a buffer, once all work on it is done."""
        return np.frombuffer(bytes(self.gpu.queue.read_buffer(buffer)), np.uint32)


def spread(groups: int) -> tuple[int, int, int]:
    """Numbers of workgroups in two dimensions, at least `groups`, for shaders that number them row by row.

    >>> spread(100), spread(100_000)
    ((100, 1, 1), (65535, 2, 1))
    """
    across = max(1, min(groups, _MOST_GROUPS))
    return across, -(-groups // across), 1


def _by_binding(listed: Sequence[Any] | Mapping[int, Any]) -> Iterable[tuple[int, Any]]:
    return listed.items() if isinstance(listed, Mapping) else enumerate(listed)


def open_device() -> Device:
    """The best adapter there is: a GPU before software.

    Raises:
        HmkctaError: wgpu is not installed, or finds no adapter; the sentence says what to install.
    """
    try:
        wgpu = import_module("wgpu")
    except ImportError:
        raise HmkctaError(Kind.IO, "no-wgpu", "rendering on the GPU", found="no package wgpu",
                          hint="pip install 'hmkcta[render]', or use the NumPy decoder") from None
    # Mesa complains on standard error where this is not set.
    os.environ.setdefault("XDG_RUNTIME_DIR", gettempdir())
    try:
        adapter = wgpu.gpu.request_adapter_sync(power_preference="high-performance")
    except RuntimeError:
        adapter = None
    if adapter is None:
        raise HmkctaError(Kind.IO, "no-adapter", "rendering on the GPU",
                          found="neither a GPU nor a software Vulkan", hint=REMEDY)
    limits = {name: adapter.limits[name] for name in _WANTED if name in adapter.limits}
    gpu = adapter.request_device_sync(label="hmkcta", required_limits=limits)
    info: dict[str, Any] = dict(adapter.info)
    return Device(gpu, str(info["device"]), str(info["backend_type"]), info["adapter_type"] == "CPU",
                  {name: int(value) for name, value in gpu.limits.items()})


@cache
def shared_device() -> Device:
    """The device that everything in this process shares, opened at the first call.

    Raises:
        HmkctaError: as `open_device`.
    """
    return open_device()


def find_device() -> Device | None:
    """`shared_device`, or None where there is none.

    >>> device = find_device()
    >>> device is None or bool(device.name)
    True
    """
    try:
        return shared_device()
    except HmkctaError:
        return None
