"""Data of the paper's sizes as .npy files, made piece by piece: never more than some 100 MB of memory for 6 GB."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import open_memmap
from numpy.typing import NDArray

from hmkcta.synthetic import SheetMaps, brocade_maps, hemisphere_directions, load_sheet, svbrdf_from_parameters
from hmkcta.synthetic.noise import power_law, wavenumber

#: Names the folder of measured data, with the steel sheet's parameter maps; without it a sheet of synthetic maps takes
#: their place.
SHEET_VARIABLE = "HMKCTA_BENCH_DATA"
SHEET_FILE = "steel_svbrdf_parameters.npz"


def sheet(path: Path, height: int, width: int, folder: Path | None) -> str:
    """The sheet under 58 lights and as many views, ``[light, view, y, x, rgb]``; says which maps it was made of."""
    maps, directions, name = _maps(height, width, folder)
    shape = (len(directions), len(directions), *maps.shape, 3)
    _once(path, shape, lambda out: svbrdf_from_parameters(maps, directions, out=out))
    return name


def _maps(height: int, width: int, folder: Path | None) -> tuple[SheetMaps, NDArray[Any], str]:
    source = folder or (Path(os.environ[SHEET_VARIABLE]) if os.environ.get(SHEET_VARIABLE) else None)
    if source is not None:
        maps, directions = load_sheet(source / SHEET_FILE)
        step = max(1, min(maps.shape[0] // height, maps.shape[1] // width))
        thin = SheetMaps(*(values[::step, ::step] for values in (maps.diffuse, maps.specular, maps.roughness)))
        return thin.cropped(height, width), directions, "steel sheet"
    made = brocade_maps(max(height, width))
    maps = SheetMaps(made.albedo, made.specular, np.clip(made.roughness, 0.05, None)).cropped(height, width)
    return maps, hemisphere_directions(58), "synthetic sheet"


def turbulence(path: Path, sizes: Sequence[int], frames: int, seed: int = 0) -> str:
    """A cloud of eddies of all sizes that turn at their own pace, ``[time, z, y, x]``, one frame after the other.

    Kolmogorov's spectrum, k^-11/6 in amplitude, below which the large eddies are equally strong; empty towards the rim.
    """
    shape = tuple(sizes)
    _once(path, (frames, *shape), lambda out: _turbulence(out, shape, seed))
    return "turbulent volume"


def _turbulence(out: NDArray[np.float32], shape: tuple[int, ...], seed: int) -> None:
    white = np.random.default_rng(seed).standard_normal(shape, np.float32)
    spectrum = (np.fft.rfftn(white) * power_law(shape, 11 / 6, low=4.0)).astype(np.complex64)
    turning = (0.15 * wavenumber(shape) ** (2 / 3)).astype(np.float32)
    grids = np.meshgrid(*(np.linspace(-1, 1, n, dtype=np.float32) for n in shape), indexing="ij", sparse=True)
    envelope = np.exp(-3.0 * sum(grid**2 for grid in grids)).astype(np.float32)
    spread = 0.0
    for number, frame in enumerate(out):
        turned = spectrum * np.exp(np.complex64(1j * number) * turning)
        field = np.fft.irfftn(turned, shape, axes=(0, 1, 2)).astype(np.float32)
        spread = spread or float(field.std())
        frame[...] = envelope * np.maximum(0.4 + 0.4 * field / spread, 0.0)


def _once(path: Path, shape: tuple[int, ...], fill: Callable[[NDArray[np.float32]], object]) -> None:
    """Make the file unless it is there with that shape; half a file never has its name."""
    if path.exists() and np.load(path, mmap_mode="r").shape == shape:
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(path.name + ".part")
    out = open_memmap(unfinished, mode="w+", dtype=np.float32, shape=shape)
    fill(out)
    out.flush()
    del out
    unfinished.replace(path)
