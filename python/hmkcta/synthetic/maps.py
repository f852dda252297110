"""Parameter maps of a brocade: rosettes of gold weft over a ground of crimson silk.

Structure at every scale: rosettes over the whole sample, threads of a few texels, stains by fractal noise, pulled
threads as scratches, and fibres whose normals differ from texel to texel and sparkle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .noise import fractal_noise, smoothstep

Array = NDArray[np.float32]

THREAD_TEXELS = 4  # texels across one thread, as in a close-up measurement
SILK = ((0.30, 0.022, 0.035), (0.10, 0.06, 0.06))  # albedo, reflectance at normal incidence
GOLD = ((0.29, 0.165, 0.035), (0.50, 0.36, 0.14))
STAIN = (0.055, 0.05, 0.04)  # albedo that a stain adds
SILK_ROUGHNESS, GOLD_ROUGHNESS = 0.62, 0.49  # GGX widths: softened, no texel mirrors
ROUGHNESS_RANGE = (0.25, 0.8)
SCRATCHES = 6


@dataclass(frozen=True, eq=False)
class MaterialMaps:
    """Parameter maps of a material, one entry for each texel.

    Args:
        albedo: diffuse reflectance ``[y, x, rgb]``, 0..1.
        specular: reflectance at normal incidence ``[y, x, rgb]``, 0..1.
        normal: unit vectors ``[y, x, 3]``.
        roughness: GGX width ``[y, x]``.

    >>> brocade_maps(16).albedo.shape
    (16, 16, 3)
    """

    albedo: Array
    specular: Array
    normal: Array
    roughness: Array


def brocade_maps(size: int, seed: int = 0) -> MaterialMaps:
    """Maps of ``size x size`` texels; the same `seed` makes the same ones.

    >>> maps = brocade_maps(16)
    >>> maps.normal.shape, maps.roughness.dtype
    ((16, 16, 3), dtype('float32'))
    """
    rng = np.random.default_rng(seed)
    scratch = _scratches(rng, size)
    gold = np.asarray(_rosettes(rng, size) * (1.0 - 0.7 * scratch), np.float32)
    stain = smoothstep(0.5, 2.2, fractal_noise(rng, (size, size), 1.9))
    grain = fractal_noise(rng, (size, size), 0.8)

    # Colour: silk or gold, darker between the threads, dull where stained.
    warp, weft = _threads(rng, size)
    shade = 1.0 + 0.07 * grain + 0.16 * _mixed(warp, weft, gold)
    albedo = _colour(SILK[0], GOLD[0], gold) * (shade * (1.0 - 0.5 * stain))[:, :, None]
    albedo += np.asarray(STAIN) * stain[:, :, None]
    specular = _colour(SILK[1], GOLD[1], gold) * (shade * (1.0 - 0.6 * stain))[:, :, None]
    roughness = _mixed(SILK_ROUGHNESS, GOLD_ROUGHNESS, gold) + 0.2 * stain + 0.03 * grain
    return MaterialMaps(
        np.clip(albedo, 0.0, 1.0).astype(np.float32), np.clip(specular, 0.0, 1.0).astype(np.float32),
        _normals(rng, gold, scratch), np.clip(roughness, *ROUGHNESS_RANGE).astype(np.float32),
    )


def _threads(rng: np.random.Generator, size: int) -> tuple[Array, Array]:
    """Brightness -1..1 or so of the warp threads ``[1, x]`` and of the weft threads ``[y, 1]``: round, each its own."""
    place = (np.arange(size, dtype=np.float32) + 0.5) / THREAD_TEXELS
    crown = 1.0 - 2.0 * (2.0 * (place % 1.0) - 1.0) ** 2  # 1 on the thread's ridge, -1 between threads
    dye = rng.standard_normal((2, int(place[-1]) + 1)).astype(np.float32)[:, place.astype(np.int64)]
    return crown[None, :] + 0.6 * dye[0][None, :], crown[:, None] + 0.6 * dye[1][:, None]


def _rosettes(rng: np.random.Generator, size: int) -> Array:
    """How much gold the ornament shows, 0..1 ``[y, x]``: two rosettes a side with petals, rings and small stars."""
    petals, depth = int(rng.integers(5, 9)), float(rng.uniform(0.25, 0.4))
    turn, offset = float(rng.uniform(0, 2 * np.pi)), rng.uniform(0, 1, 2)
    place = (np.arange(size) + 0.5) / size * 2.0
    x, y = ((place + part) % 1.0 - 0.5 for part in offset)
    x, y = x[None, :], y[:, None]
    radius, angle = np.hypot(x, y), np.arctan2(y, x)

    # Signed distances (in rosettes, positive inside); an edge is one thread wide.
    petal = np.minimum(0.32 * (1.0 - depth + depth * np.cos(petals * angle + turn)) - radius, radius - 0.06)
    ring = 0.04 - abs(radius - 0.41)
    star = 0.11 - np.hypot(0.5 - abs(x), 0.5 - abs(y))
    inside = np.maximum(np.maximum(petal, ring), star).astype(np.float32)
    edge = THREAD_TEXELS / size
    return np.asarray(0.04 + 0.92 * smoothstep(-edge, edge, inside), np.float32)


def _scratches(rng: np.random.Generator, size: int) -> Array:
    """Pulled threads: thin arcs across the sample, 1 in their middle, ``[y, x]``."""
    place = (np.arange(size, dtype=np.float32) + 0.5) / size
    y, x = np.meshgrid(place, place, indexing="ij")
    worn = np.zeros((size, size), np.float32)
    for _ in range(SCRATCHES):
        angle, bend, middle = rng.uniform(0, np.pi), rng.uniform(-0.5, 0.5), rng.uniform(0.1, 0.9, 2)
        along = (x - middle[0]) * np.cos(angle) + (y - middle[1]) * np.sin(angle)
        across = (y - middle[1]) * np.cos(angle) - (x - middle[0]) * np.sin(angle) + bend * along**2
        reach = smoothstep(rng.uniform(0.25, 0.5), 0.1, abs(along))
        worn = np.maximum(worn, reach * np.exp(-((across * size / 0.9) ** 2)))
    return worn.astype(np.float32)


def _normals(rng: np.random.Generator, gold: Array, scratch: Array) -> Array:
    """Unit normals ``[y, x, 3]``: round threads, gold across the silk; cloth that is not flat; fibres that sparkle."""
    size = len(gold)
    side = 2.0 * (((np.arange(size, dtype=np.float32) + 0.5) / THREAD_TEXELS) % 1.0) - 1.0  # -1..1 across a thread
    slope = np.stack([0.18 * side[None, :] * (1.0 - gold), 0.18 * side[:, None] * gold])  # [x or y, y, x]
    for part in slope:
        part += 0.07 * fractal_noise(rng, gold.shape, 2.4)
    slope += (0.015 + 0.03 * gold + 0.08 * scratch) * rng.standard_normal(slope.shape, dtype=np.float32)
    normal = np.stack([slope[0], slope[1], np.ones_like(gold)], axis=2)
    return (normal / np.linalg.norm(normal, axis=2, keepdims=True)).astype(np.float32)


def _mixed(first: Array | float, second: Array | float, weight: Array) -> Array:
    """`first` where the weight is 0, `second` where it is 1."""
    return np.asarray(first + weight * (second - first), np.float32)


def _colour(first: tuple[float, ...], second: tuple[float, ...], weight: Array) -> NDArray[Any]:
    """Two rgb colours mixed by a map ``[y, x]``, as ``[y, x, rgb]``."""
    return np.asarray(first) + weight[:, :, None] * (np.asarray(second) - np.asarray(first))
