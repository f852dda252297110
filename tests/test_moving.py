"""What moves: frames with ranks of their own, and pixels that belong together wherever they lie."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hmkcta import compress


def puffs() -> NDArray[np.float32]:
    """Twelve round clouds that drift through `[12, 24, 24, 24]`: of low ranks in every frame, of high ones in all."""
    rng, grid, size = np.random.default_rng(0), np.ogrid[:24, :24, :24], 24
    frames = np.zeros((12, size, size, size), np.float32)
    for centre, velocity, width in zip(
        rng.random((12, 3)) * size, rng.standard_normal((12, 3)), 1.5 + rng.random(12), strict=True
    ):
        for t, frame in enumerate(frames):
            now = (centre + t * velocity) % size
            frame += np.exp(-sum((axis - at) ** 2 for axis, at in zip(grid, now, strict=True)) / (2 * width**2))
    return frames


def disc() -> NDArray[np.uint8]:
    """A video `[30, 48, 64, 3]` of a disc that crosses a picture, with some noise."""
    rng, (y, x) = np.random.default_rng(0), np.mgrid[:48, :64]
    still = (128 + 60 * np.sin(x / 7) * np.cos(y / 11))[..., None] * [1, 0.8, 0.6]
    still += 15 * rng.standard_normal((48, 64, 1))
    frames = np.empty((30, 48, 64, 3))
    for t, frame in enumerate(frames):
        inside = (x - 10 - 1.5 * t) ** 2 + (y - 24 - 10 * np.sin(t / 4)) ** 2 < 8**2
        frame[:] = np.where(inside[..., None], [250, 30, 20], still) + 2 * rng.standard_normal((48, 64, 3))
    return np.clip(frames, 0, 255).astype(np.uint8)


def test_frames_are_cut_apart_where_each_has_low_ranks() -> None:
    """Blocks of four frames and more come to 47 and 58 dB."""
    small, large = (compress(puffs(), axes="time,z,y,x", size=size, threads=1) for size in (40_000, 80_000))
    assert small.snr > 50
    assert large.snr > 70  # more than float16 keeps of one level


def test_moving_pixels_are_merged() -> None:
    """A mode for each axis comes to 28.8 dB."""
    model = compress(disc(), axes="time,y,x,rgb", size=32_000, threads=1)
    assert model.snr > 31
    assert ("y", "x") in model.plan.organisation
