"""Fits end at least as high as a plain implementation of the paper's MK-CTA that shares no code with them."""

from __future__ import annotations

from collections.abc import Callable
from statistics import median

import numpy as np
import pytest
from numpy.typing import NDArray

from hmkcta import compress
from hmkcta.fitting.fit import EFFORTS, fit_level
from hmkcta.plan import parse_level
from hmkcta.synthetic import volume
from plain_mkcta import plain_snr

F64 = NDArray[np.float64]

SIZES = (12, 11, 10)
AXES = ("z", "y", "x")


def planted(
    sizes: tuple[int, ...], rank: int, mixture: int, seed: int, noise: float = 0.01
) -> NDArray[np.float32]:
    """A model of random cells, three clusters a mode, with a little noise: an SNR of 40 dB is there to be found."""
    rng = np.random.default_rng(seed)
    sets = [np.array([rng.choice(3, mixture, replace=False) for _ in range(size)]) for size in sizes]
    total = np.zeros(sizes)
    for cell in np.ndindex(*[3] * len(sizes)):
        values: F64 = rng.standard_normal([rank] * len(sizes))
        for n, size in enumerate(sizes):
            basis = rng.standard_normal((size, rank)) * (sets[n] == cell[n]).any(axis=1)[:, None]
            values = np.moveaxis(np.tensordot(basis, values, (1, n)), 0, n)
        total += values
    total /= total.std()
    return (total + noise * rng.standard_normal(sizes)).astype(np.float32)


def bumps() -> F64:
    """Gaussian bumps of some widths."""
    rng = np.random.default_rng(0)
    z, y, x = np.meshgrid(*(np.linspace(0, 1, size) for size in SIZES), indexing="ij")
    total = np.zeros(SIZES)
    for _ in range(6):
        centre, width = rng.random(3), 0.08 + 0.2 * rng.random()
        squared = (z - centre[0]) ** 2 + (y - centre[1]) ** 2 + (x - centre[2]) ** 2
        total += rng.standard_normal() * np.exp(-squared / (2 * width**2))
    return total


def smooth() -> F64:
    """Waves that no few products of functions of one axis make."""
    z, y, x = np.meshgrid(*(np.linspace(0, 1, size) for size in SIZES), indexing="ij")
    return np.sin(6 * z * y) + np.cos(5 * x * y) * np.exp(-z * x) + 1 / (1 + x + y + z)


def crop() -> NDArray[np.float32]:
    """A corner of a volume that mimics measured ones."""
    return np.ascontiguousarray(volume((24, 24, 24), frames=1).values[0][4:16, 5:16, 6:16])


DATA: dict[str, Callable[[], NDArray[np.floating]]] = {
    "planted": lambda: planted(SIZES, 1, 2, 0), "bumps": bumps, "blocks": lambda: planted(SIZES, 1, 1, 0),
    "smooth": smooth, "crop": crop,
}


@pytest.mark.parametrize("name", DATA)
def test_medium_is_no_worse_than_the_plain_implementation(name: str) -> None:
    """Within 0.3 dB of its median, each the best of six starts of 25 sweeps; K = 2 of C = 3 in every mode."""
    values = DATA[name]()
    plain = median(plain_snr(values, 1, 3, 2, seed) for seed in range(3))
    found = median(compress(values, "R=1 C=3 K=2", axes=AXES, seed=seed, threads=1).snr for seed in range(3))
    assert found > plain - 0.3


@pytest.mark.parametrize("rank", [2, 3])
def test_disjoint_clusters_of_three_modes_are_found(rank: int) -> None:
    """On four of five seeds at the least; labels that only say what rows are like end at 2 to 3 dB."""
    found = [compress(planted((40, 36, 32), rank, 1, seed), f"R={rank} C=3", axes=AXES, seed=seed, threads=1).snr
             for seed in range(5)]
    assert sorted(found)[1] > 20


def test_a_grid_keeps_its_blocks() -> None:
    """Where blocks are asked for, their labels are not searched for."""
    values, blocks = planted((12, 11, 10), 2, 1, 0), [np.repeat(np.arange(2), [half, size - half])
                                                      for size, half in ((12, 6), (11, 6), (10, 5))]
    spec, rng = parse_level("R=2 C=2", tuple((axis,) for axis in AXES)), np.random.default_rng(0)
    kept, searched = (fit_level(values, spec, EFFORTS["medium"], rng, labels) for labels in (blocks, None))
    assert all(np.array_equal(own[:, 0], part) for own, part in zip(kept.members, blocks, strict=True))
    assert any(not np.array_equal(own[:, 0], part) for own, part in zip(searched.members, blocks, strict=True))
