"""From linear radiance to display numbers 0..1: exposure, a curve, sRGB encoding; the twin of `display.wgsl`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]


def reinhard(light: F32) -> F32:
    """x / (1 + x), scaled so that 1 shows as 0.8: highlights roll off instead of clipping (Reinhard et al. 2002).

    >>> reinhard(np.array([0.0, 1.0], np.float32)).round(3).tolist()
    [0.0, 0.800000011920929]
    """
    x = np.float32(4.0) * light
    return np.asarray(x / (1 + x), np.float32)


def filmic(light: F32) -> F32:
    """Narkowicz's fit of the ACES film curve (2015), clipped to 0..1.

    >>> filmic(np.array([0.0, 100.0], np.float32)).tolist()
    [0.0, 1.0]
    """
    x = np.maximum(light, 0)
    mapped = x * (np.float32(2.51) * x + np.float32(0.03)) / (x * (np.float32(2.43) * x + np.float32(0.59))
                                                             + np.float32(0.14))
    return np.asarray(np.clip(mapped, 0, 1), np.float32)


def encode_srgb(light: F32) -> F32:
    """sRGB's transfer curve (IEC 61966-2-1) of light in 0..1.

    >>> encode_srgb(np.array([0.0, 0.5, 1.0], np.float32)).round(4).tolist()
    [0.0, 0.7354000210762024, 1.0]
    """
    curve = np.float32(1.055) * np.power(np.maximum(light, 1e-8), np.float32(1 / 2.4)) - np.float32(0.055)
    return np.asarray(np.where(light <= 0.0031308, np.float32(12.92) * light, curve), np.float32)


def tone_map(radiance: F32, exposure: float, curve: str, srgb: bool) -> F32:
    """Display numbers 0..1 of radiance of any shape; what is no number is black.

    >>> tone_map(np.array([0.5, 4.0], np.float32), 1.0, "linear", srgb=False).tolist()
    [0.5, 1.0]
    """
    exposed = radiance.astype(np.float64) * exposure
    light = np.asarray(np.clip(np.nan_to_num(exposed, posinf=3e38), 0, 3e38), np.float32)
    if curve == "reinhard":
        light = reinhard(np.minimum(light, np.float32(1e30)))
    elif curve == "filmic":
        light = filmic(np.minimum(light, np.float32(1e15)))
    light = np.clip(light, 0, 1)
    return encode_srgb(light) if srgb else np.asarray(light, np.float32)


def to_bytes(display: NDArray[Any]) -> NDArray[np.uint8]:
    """8-bit numbers of display numbers.

    >>> to_bytes(np.array([0.0, 0.5, 1.0])).tolist()
    [0, 128, 255]
    """
    return np.asarray(np.rint(np.clip(display, 0, 1) * 255), np.uint8)
