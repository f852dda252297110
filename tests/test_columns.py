"""Columns of a basis have steps as fine as they are worth: what rounding leaves is the share that was asked for."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hmkcta import compress
from hmkcta.arrays import F32
from hmkcta.cells import Cells, dense_basis, zero_cells
from hmkcta.fitting.columns import left_of, rounded_by_columns, whole_steps
from hmkcta.fitting.hierarchy import Node
from hmkcta.pack import pack_levels
from hmkcta.packed import PackedLevel
from hmkcta.parameters import whole_of_core
from hmkcta.plan import LevelSpec
from hmkcta.streaming import budget

SIZES = (24, 30, 16)
ONE, SEVERAL = (1, 1, 1), (2, 3, 1)


def make_cells(clusters: tuple[int, int, int], share: float, undecomposed: int | None = None, seed: int = 0) -> Cells:
    """Cells that share no element, of orthonormal columns, whose core numbers fall off with their indices."""
    rng = np.random.default_rng(seed)
    ranks = tuple(None if n == undecomposed else rank for n, rank in enumerate((5, 6, 4)))
    spec = LevelSpec(ranks, clusters, (1, 1, 1), "most", bits=8, own_bits=share)
    cells = zero_cells(SIZES, spec)
    cells.members = [(np.arange(size) * c // size)[:, None].astype(np.uint16)
                     for size, c in zip(SIZES, clusters, strict=True)]  # fmt: skip
    for n, basis in enumerate(cells.bases):
        if ranks[n] is None:
            continue
        for cluster in range(clusters[n]):
            rows = cells.members[n][:, 0] == cluster
            for other in range(basis.shape[2]):
                columns = rng.standard_normal((int(rows.sum()), cells.ranks[n]))
                basis[rows, 0, other] = np.linalg.qr(columns)[0]
    falling = sum(np.ogrid[tuple(slice(rank) for rank in cells.ranks)][n] for n in range(3) if n != undecomposed)
    cells.cores = (rng.standard_normal(cells.cores.shape) * 0.6**falling).astype(np.float32)
    return cells


def dense(cells: Cells) -> NDArray[np.float64]:
    """All elements of a model of three modes."""
    bases = [np.broadcast_to(np.eye(size), (cells.spec.cells, size, size)) if skip else dense_basis(cells, n)
             for n, (size, skip) in enumerate(zip(cells.sizes, cells.undecomposed, strict=True))]  # fmt: skip
    return np.einsum("cxyz,cix,cjy,ckz->ijk", cells.cores.astype(np.float64), *bases, optimize=True)


def packed(cells: Cells, bits: int = 8) -> PackedLevel:
    """The cells as the only node of a file."""
    node = Node(tuple(np.arange(size) for size in cells.sizes), cells)
    undecomposed = [n for n, skip in enumerate(cells.undecomposed) if skip]
    return pack_levels([[node]], undecomposed, [bits])[0]


def lost(cells: Cells, left: float) -> float:
    """Squared error that rounding makes."""
    return float(np.square(dense(rounded_by_columns(cells, left)) - dense(cells)).sum())


@pytest.mark.parametrize("clusters", [ONE, SEVERAL], ids=["one", "several"])
@pytest.mark.parametrize("share", [0.05, 0.3, 1.0])
@pytest.mark.parametrize("snr", [20, 40])
def test_rounding_leaves_about_its_share(clusters: tuple[int, int, int], share: float, snr: int) -> None:
    for undecomposed in (None, 1) if clusters == ONE else (None,):
        cells = make_cells(clusters, share, undecomposed)
        left = 10 ** (-snr / 10) * float(np.square(dense(cells)).sum())
        assert 0.5 < lost(cells, left) / (share * left) < 2


@pytest.mark.parametrize("clusters", [ONE, SEVERAL], ids=["one", "several"])
def test_a_larger_share_takes_no_more_bytes(clusters: tuple[int, int, int]) -> None:
    cells = make_cells(clusters, 1.0)
    sizes = list[int]()
    for share in np.exp2(np.arange(-20, 6, 0.5)).tolist():
        cells.spec = replace(cells.spec, own_bits=share)
        sizes.append(packed(rounded_by_columns(cells, 0.01)).number_bytes)
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > 2 * sizes[-1]


def test_what_is_left_is_what_cells_do_not_hold() -> None:
    for clusters in (ONE, SEVERAL):
        cells = make_cells(clusters, 1.0)
        held = float(np.square(dense(cells)).sum())
        assert left_of(cells, 1.5 * held) == pytest.approx(0.5 * held, rel=1e-5)
        assert left_of(cells, 0.5 * held) < 1e-12 * held


def test_columns_that_count_for_more_have_finer_steps() -> None:
    """Half as large for each factor of two."""
    rng, cells = np.random.default_rng(0), make_cells(ONE, 0.3)
    cells.cores[:] = 0
    for r, size in enumerate((8.0, 4.0, 2.0, 1.0)):
        cells.cores[0, r, r, r] = size
    for n, basis in enumerate(cells.bases):
        basis[:, 0, 0] = np.linalg.qr(rng.standard_normal((SIZES[n], basis.shape[-1])))[0]
    steps = list[float]()
    for column in rounded_by_columns(cells, 0.05).bases[2][:, 0, 0, :4].T:
        used = np.unique(np.abs(column[column != 0]))
        step = np.gcd.reduce(np.rint(used * 2**17).astype(np.int64)) / 2**17
        steps.append(float(step / np.linalg.norm(column)))
    np.testing.assert_allclose(np.diff(np.log2(steps)), 1, atol=0.1)


@pytest.mark.parametrize("clusters", [ONE, SEVERAL], ids=["one", "several"])
@pytest.mark.parametrize("undecomposed", [None, 1])
def test_packed_and_unpacked_they_are_the_rounded_numbers(
    clusters: tuple[int, int, int], undecomposed: int | None
) -> None:
    if undecomposed is not None:
        clusters = (clusters[0], 1, clusters[2])
    cells = rounded_by_columns(make_cells(clusters, 0.3, undecomposed), 0.01)
    level = packed(cells)
    stored: dict[str, Any] = dict(level.coefficients())
    for n, basis in enumerate(cells.bases):
        if n != undecomposed:
            np.testing.assert_array_equal(level.unpacked(f"basis/{n}", stored[f"basis/{n}"]), basis.reshape(-1))
    core = level.unpacked("core", stored["core"]).astype(np.float32).reshape(cells.cores.shape)
    scale = level.core_scale.reshape(-1, 1, 1, 1)
    np.testing.assert_array_equal(core * scale, cells.cores)


@pytest.mark.parametrize("left", [0.0, 1e-30, 1e30])
@pytest.mark.parametrize("factor", [1e-12, 1.0, 1e12])
def test_steps_end_at_their_limits(left: float, factor: float) -> None:
    """Where nothing is left as fine as float16 holds, where all is as coarse; packed they are what was rounded."""
    cells = make_cells(SEVERAL, 0.3)
    cells.cores *= np.float32(factor)
    rounded = rounded_by_columns(cells, left)
    assert np.isfinite(rounded.cores).all()
    level = packed(rounded)
    bases = [(f"basis/{n}", basis) for n, basis in enumerate(level.basis) if basis is not None]
    most = [np.abs(level.whole_numbers(name, basis)[0]).max() for name, basis in bases]
    assert min(most) > 1000 if left < 1 else max(most) <= 2
    np.testing.assert_array_equal(level.core.reshape(rounded.cores.shape) * level.core_scale.reshape(-1, 1, 1, 1),
                                  rounded.cores)
    if left < 1e-20:
        held = np.square(dense(cells)).sum()
        assert np.square(dense(rounded) - dense(cells)).sum() < 1e-5 * held


@pytest.mark.parametrize("peak", [1.0, 0.99999, 32767.0, -1.0])
def test_the_largest_cores_are_packed_whatever_their_peak(peak: float) -> None:
    """Powers of two, and what float16 rounds to one, have the code of the number below, which is read as the same."""
    cells = make_cells(ONE, 0.3)
    cells.cores *= np.float32(abs(peak) / 2 / np.abs(cells.cores).max())
    cells.cores[0, 0, 0, 0] = peak
    for basis in cells.bases:  # whose columns stay as they are
        basis[:] = np.where(basis < 0, -1, 1) * (1 - 2.0**-11)
    rounded = rounded_by_columns(cells, 0.0)
    level = packed(rounded)
    stored: dict[str, Any] = dict(level.coefficients())
    np.testing.assert_array_equal(level.unpacked("core", stored["core"]), level.core)
    np.testing.assert_array_equal(level.core.reshape(rounded.cores.shape) * level.core_scale[0], rounded.cores)


@pytest.mark.parametrize("clusters", [ONE, SEVERAL], ids=["one", "several"])
def test_columns_and_cores_of_zeros_stay_zero(clusters: tuple[int, int, int]) -> None:
    cells = make_cells(clusters, 0.3)
    cells.bases[0][..., 1] = 0
    cells.bases[1][cells.members[1][:, 0] == 0] = 0
    rounded = rounded_by_columns(cells, 0.01)
    assert not rounded.bases[0][..., 1].any()
    assert np.square(dense(rounded) - dense(cells)).sum() < 0.01
    cells.cores[:] = 0
    rounded = rounded_by_columns(cells, 0.01)
    assert not rounded.cores.any()
    level = packed(rounded)
    assert not level.core.any()
    assert level.core_bytes == -(-level.core.size // 8)  # a bit each


@pytest.mark.parametrize("clusters", [ONE, SEVERAL], ids=["one", "several"])
def test_rounding_twice_makes_little_more(clusters: tuple[int, int, int]) -> None:
    """Mostly nothing: what is on the grid stays on it, unless a step is near the next one."""
    cells = make_cells(clusters, 0.3)
    once = rounded_by_columns(cells, 0.01)
    twice = rounded_by_columns(once, 0.01)
    assert np.square(dense(twice) - dense(cells)).sum() < 1.25 * np.square(dense(once) - dense(cells)).sum()


def test_what_is_given_is_not_changed() -> None:
    cells = make_cells(SEVERAL, 0.3)
    before: list[F32] = [*(basis.copy() for basis in cells.bases), cells.cores.copy()]
    rounded_by_columns(cells, 0.01)
    for own, expected in zip([*cells.bases, cells.cores], before, strict=True):
        np.testing.assert_array_equal(own, expected)


def waves_in_noise() -> NDArray[np.float32]:
    z, y, x = np.indices((24, 24, 24)).astype(np.float64)
    noise = 0.05 * np.random.default_rng(0).standard_normal((24, 24, 24))
    return (np.sin(0.3 * z + 0.2 * y) * np.cos(0.01 * x * y) + noise).astype(np.float32)


@pytest.mark.parametrize("goal", [{"size": 9000}, {"snr": 21.0}], ids=["size", "snr"])
def test_blocks_that_are_refitted_outside_memory_take_bits_by_what_they_leave(
    goal: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are refitted without what they had: by all that they hold they would have had two bits each."""
    options: dict[str, Any] = {"plan": "R=1 / R<=12 grid=axis0:2 bits=8", "threads": 1, **goal}
    held = compress(waves_in_noise(), **options)
    monkeypatch.setattr(budget, "SMALLEST", 1000)
    monkeypatch.setattr(budget, "WORKSET", 8000)
    outside = compress(waves_in_noise(), **options)
    assert outside.snr >= goal.get("snr", held.snr - 0.5)


def test_ranks_that_reach_an_snr_with_more_bits_have_them() -> None:
    most = compress(waves_in_noise(), "R=3", threads=1).snr
    assert compress(waves_in_noise(), "R<=3 bits=8", snr=most - 0.1, threads=1).snr >= most - 0.1


def test_a_small_file_is_no_worse_for_widths() -> None:
    """These take some bytes, too: there is a byte for each number where that leaves less."""
    found = [compress(waves_in_noise(), "R<=8 bits=8", size=size, threads=1).snr for size in (1850, 1950, 2050, 2400)]
    assert found == sorted(found)


@pytest.mark.parametrize("size", [1e-36, 1e-30, 1e30])
def test_cores_of_any_size_stay_finite(size: float) -> None:
    rounded = whole_steps(np.array([[1.0, -0.3]], np.float32) * np.float32(size), np.array([size / 1000]))
    assert np.allclose(rounded / np.float32(size), [[1.0, -0.3]], atol=2e-3)


@settings(max_examples=300, deadline=None)
@given(
    st.lists(st.floats(-1, 1, width=32), min_size=1, max_size=20), st.floats(1e-6, 4), st.sampled_from([1, 1e-40, 1e30])
)
def test_cores_are_whole_steps_and_found_again(numbers: list[float], step: float, size: float) -> None:
    cores = (np.array([numbers, numbers[::-1]]) * size * [[1], [0.01]]).astype(np.float32)
    rounded, peak = whole_steps(cores, step * size * np.array([1, 0.01])), np.abs(cores).max(axis=1)
    off = np.abs(rounded - cores).max(axis=1)
    assert (off <= np.maximum(0.76 * step * size * np.array([1, 0.01]), 3e-3 * peak)).all()
    whole, found = whole_of_core(rounded)
    assert (np.abs(whole).max(axis=1) * step * size * [1, 0.01] <= 1.01 * peak + 2 * step * size).all()
    wide = (whole.astype(np.float16).astype(np.float64) * found[:, None]).astype(np.float32)
    assert np.array_equal(wide, rounded)


@pytest.mark.parametrize("value", [3.5, -1e-8, 1e9])
def test_core_numbers_that_are_alike_stay_as_they_are(value: float) -> None:
    """As those of constants are: the largest number is the one that steps are whole parts of."""
    cores = np.full((1, 3, 2), value, np.float32)
    np.testing.assert_allclose(whole_steps(cores, np.array([abs(value) / 5.3])), cores, rtol=2e-4)
