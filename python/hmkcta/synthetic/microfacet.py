"""A procedural material: the maps of `maps.py` under a microfacet model, for all pairs of light and view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .dataset import Dataset, checked_count, svbrdf_axes
from .directions import hemisphere_directions
from .maps import MaterialMaps, brocade_maps

Array = NDArray[np.float32]

#: Views grazing the tilted microfacets would divide by 0; no texel faces the viewer less than this (cosine).
LEAST_COSINE = 0.02


def material(lights: int = 24, views: int = 24, size: int = 96, seed: int = 0) -> Dataset:
    """A brocade, gold threads in crimson silk: SVBRDF times cosine, ``[light, view, y, x, rgb]`` float32.

    GGX with Smith shadowing and Schlick's Fresnel term over Lambert, on a normal map of threads that sparkle; no
    parallax and no shadows from thread to thread. Coordinates of the axes `light` and `view` are their directions.
    The default is 63.7 MB, the paper's layout 72 x 24 x 96 x 96 once ``light+rgb`` are one mode.

    Args:
        lights: directions of light.
        views: directions of view.
        size: texels along y and along x, at least 2.
        seed: the same one makes the same material.

    Raises:
        HmkctaError: reason ``size-too-small``.

    >>> small = material(lights=3, views=2, size=8)
    >>> small.values.shape, small.axis("view").coords.shape
    ((3, 2, 8, 8, 3), (2, 3))
    """
    maps = brocade_maps(checked_count("size", size, 2), seed)
    # Half a golden turn between the spirals keeps lights off the views, as in a measurement.
    light_dirs = hemisphere_directions(checked_count("lights", lights))
    view_dirs = hemisphere_directions(checked_count("views", views), turn=1.2)
    axes = svbrdf_axes(light_dirs, view_dirs, size, size)
    return Dataset(evaluate(maps, light_dirs, view_dirs), axes, "svbrdf")


def evaluate(maps: MaterialMaps, lights: Array, views: Array) -> Array:
    """Reflected radiance ``[light, view, y, x, rgb]`` under unit irradiance across the light's direction.

    >>> up = np.array([[0, 0, 1]], np.float32)
    >>> evaluate(brocade_maps(4, seed=1), up, up).shape
    (1, 1, 4, 4, 3)
    """
    facing = np.maximum(_dot(views, maps.normal), LEAST_COSINE)  # n.v [view, y, x]
    values = np.empty((len(lights), len(views), *maps.roughness.shape, 3), np.float32)
    for light, picture in zip(lights, values, strict=True):
        lit = np.maximum(_dot(light[None], maps.normal), 0.0)  # n.l [1, y, x]
        half = light + views
        half /= np.linalg.norm(half, axis=1, keepdims=True)
        lobe = ggx(_dot(half, maps.normal), lit, facing, maps.roughness)  # [view, y, x]
        schlick = ((1.0 - (half * views).sum(axis=1)) ** 5)[:, None, None]
        for c in range(3):
            fresnel = maps.specular[:, :, c] * (1.0 - schlick) + schlick
            np.multiply(maps.albedo[:, :, c] / np.float32(np.pi) + lobe * fresnel, lit, out=picture[..., c])
    return values


def ggx(halfway: Array, lit: Array, facing: Array, roughness: Array) -> Array:
    """D G / (4 n.l n.v) of the GGX distribution for n.h `halfway`, n.l `lit`, n.v `facing` and its width `roughness`.

    Facing the light, viewed from it, all of it is D / 4 = 1 / (4 pi roughness^2):

    >>> one = np.ones(1, np.float32)
    >>> float(ggx(one, one, one, 0.5 * one)[0] * np.pi)
    1.0
    """
    square = roughness * roughness
    spread = halfway * halfway * (square - 1.0) + 1.0
    distribution = square / (np.float32(np.pi) * spread * spread)
    masked = lit * np.sqrt(facing * facing * (1.0 - square) + square)
    shadowed = facing * np.sqrt(lit * lit * (1.0 - square) + square)
    return np.asarray(distribution * (0.5 / (masked + shadowed)), np.float32)


def _dot(directions: Array, normal: Array) -> Array:
    """Cosines ``[direction, y, x]`` between directions ``[direction, 3]`` and normals ``[y, x, 3]``."""
    return np.moveaxis(normal @ directions.T, 2, 0).copy()
