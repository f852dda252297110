"""Host of `display.wgsl`: the 8-bit picture of radiance, by the shader that the viewer uses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .colours import heat_table
from .device import Device
from .display import Display
from .gpu_pass import ComputePass, Slot, out_texture, picture_texture, read_texture, tiles
from .prelude import shader
from .scene import COMPARISONS, CURVES

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

FRAME = np.dtype([
    ("width", "u4"), ("height", "u4"), ("mode", "u4"), ("flags", "u4"),
    ("exposure", "f4"), ("split", "f4"), ("gain", "f4"), ("curve", "u4"),
    ("background", "f4", 4),
])
FLAG_SRGB, FLAG_PREMULTIPLIED = 1, 2
SLOTS = (Slot("uniform"), Slot("texture"), Slot("texture"), Slot("storage"), Slot("out", format="rgba8unorm"))


def show_on_gpu(device: Device, one: F32, two: F32, display: Display) -> U8:
    """The picture ``[height, width, 3]`` of radiance ``[height, width, 4]``, next to or minus `two`."""
    height, width = one.shape[:2]
    out = out_texture(device, "display", (width, height, 1), "rgba8unorm")
    first = picture_texture(device, "picture a", one)
    second = first if two is one else picture_texture(device, "picture b", two)
    work = ComputePass(device, "show", shader("display"), SLOTS)
    resources = (device.buffer("display", _frame(width, height, display).tobytes(), "UNIFORM"), first, second,
                 device.buffer("heat", heat_table()), out)
    work.run(resources, tiles(width, height))
    return np.ascontiguousarray(read_texture(device, out, "u1", 4)[:, :, :3])


def _frame(width: int, height: int, display: Display) -> NDArray[np.void]:
    frame = np.zeros((), FRAME)
    frame["width"], frame["height"] = width, height
    frame["mode"] = COMPARISONS.index(display.mode)
    frame["flags"] = FLAG_SRGB * display.srgb + FLAG_PREMULTIPLIED * display.premultiplied
    frame["exposure"], frame["split"], frame["gain"] = display.exposure, display.split * width, display.gain
    frame["curve"] = CURVES.index(display.curve)
    frame["background"][:3] = display.background
    return frame
