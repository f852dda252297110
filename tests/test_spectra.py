"""Cores of many blocks at once, and the energies told by them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from dense_reference import energy
from fit_tools import noise
from hmkcta.choosing.spectra import FIRST, WIDER, captured, cores, energies, ladders
from hmkcta.fitting.tucker import core_energies


@pytest.mark.parametrize("undecomposed", [(), (1,), (0, 2)], ids=str)
def test_energies_of_many_blocks_are_those_of_each(undecomposed: tuple[int, ...]) -> None:
    """Also of a block of zeros."""
    batch = np.stack([noise(9, 10, 11), 1e-3 * noise(9, 10, 11)[::-1], np.zeros((9, 10, 11), np.float32)])
    limits = [None if n in undecomposed else limit for n, limit in enumerate((9, 10, 11))]
    steps = [None if limit is None else tuple(range(1, limit + 1)) for limit in limits]
    tables = captured(cores(batch, limits), steps)
    np.testing.assert_allclose(energies(batch), [energy(block) for block in batch], rtol=1e-6)
    for block, table in zip(batch, tables, strict=True):
        found = core_energies(block, limits, np.random.default_rng(0))
        np.testing.assert_allclose(table, found, rtol=1e-4, atol=1e-12)


def test_a_truncated_core_captures_no_less() -> None:
    """Rotated into the leading vectors one mode after another, as ST-HOSVD does: each mode sees what the first left."""
    block = np.cumsum(np.cumsum(np.cumsum(noise(14, 15, 16), 0), 1), 2)
    table = captured(cores(block[None], (3, 4, 5)), [(3,), (4,), (5,)])[0]
    whole = core_energies(block, (3, 4, 5), np.random.default_rng(0))[-1, -1, -1]
    assert 0.999 * whole < table[0, 0, 0] < energy(block)


@pytest.mark.parametrize("shape", [(400, 500), (500, 400), (30, 700)], ids=str)
def test_long_modes_of_many_blocks_are_iterated(shape: tuple[int, int]) -> None:
    """Two factors and noise: the leading singular vectors are found, whichever side is the longer."""
    rng = np.random.default_rng(0)
    batch = np.stack([rng.standard_normal((shape[0], 2)) @ rng.standard_normal((2, shape[1])) for _ in range(2)])
    noisy = (batch + 0.01 * rng.standard_normal(batch.shape)).astype(np.float32)
    for block, table in zip(noisy, captured(cores(noisy, (8, 8)), [(1, 2, 8), (1, 2, 8)]), strict=True):
        squares = np.linalg.svd(block.astype(np.float64), compute_uv=False) ** 2
        assert table[0, 0] == pytest.approx(squares[0], rel=1e-4)
        assert table[1, 1] == pytest.approx(squares[:2].sum(), rel=1e-5)


def test_ladders_skip_high_ranks_only_where_there_are_too_many_choices() -> None:
    assert ladders([5, 6, 7]) == [tuple(range(1, n + 1)) for n in (5, 6, 7)]
    found = ladders([64, 64, 64, 64], blocks=100)
    assert np.prod([len(own) for own in found]) <= 10_000
    for own in found:
        assert (own[0], own[1], own[-1]) == (1, 2, 64)
        assert all(before < after for before, after in pairwise(own))


def test_a_table_of_some_ranks_is_part_of_that_of_all() -> None:
    core = cores(np.stack([noise(12, 13, 14), noise(12, 13, 14)[:, ::-1]]), (12, 13, 14))
    whole = captured(core, [tuple(range(1, n + 1)) for n in (12, 13, 14)])
    some = captured(core, [(1, 2, 5, 12), (3, 13), (1, 14)])
    np.testing.assert_allclose(some, whole[np.ix_([0, 1], [0, 1, 4, 11], [2, 12], [0, 13])], rtol=1e-6)


@pytest.mark.parametrize("shape", [(40, 3, 5), (3, 40, 5), (3, 5, 40), (2, 3, 4, 30), (19, 2, 2, 2)], ids=str)
def test_whichever_mode_comes_first_is_rotated_as_any(shape: tuple[int, ...]) -> None:
    """The mode that loses most is rotated first, wherever it is: energies by rank are those of the unfolding."""
    batch = np.stack([noise(*shape), 2 * noise(*shape)[::-1]])
    for n, size in enumerate(shape):
        limits = [2 if m == n else None for m in range(len(shape))]
        core = cores(batch, limits)
        assert core.shape == (2, *(2 if m == n else rows for m, rows in enumerate(shape)))
        for block, rotated in zip(batch, core, strict=True):
            unfolded = np.moveaxis(block, n, 0).reshape(size, -1)
            squares = np.linalg.svd(unfolded.astype(np.float64), compute_uv=False) ** 2
            assert energy(rotated) == pytest.approx(squares[:2].sum(), rel=1e-5)
            others = tuple(m for m in range(len(shape)) if m != n)
            sums = np.square(np.tensordot(block, rotated, (others, others)))
            assert sums.sum() == pytest.approx(np.square(squares[:2]).sum(), rel=1e-4)


@pytest.mark.parametrize(("enough", "rank"), [(0.0, 200), (1e-8, 200), (1e-3, FIRST)])
def test_ranks_end_where_little_is_left(enough: float, rank: int) -> None:
    """Forty factors and noise at 40 dB: a share that the noise exceeds asks for all ranks."""
    rng = np.random.default_rng(0)
    low = (rng.standard_normal((600, 40)) @ rng.standard_normal((40, 900))).astype(np.float32)
    block = low + 0.01 * np.sqrt(40, dtype=np.float32) * noise(600, 900)
    found = cores(block[None], (200, None), enough=enough)
    assert found.shape == (1, rank, 900)
    assert FIRST * WIDER <= 200
    left = 1 - energy(found[0]) / energy(block)
    assert left < max(enough, 1e-4)


@pytest.mark.parametrize("shape", [(400, 500), (90, 700)], ids=str)
def test_small_components_are_found_beside_large_ones(shape: tuple[int, int]) -> None:
    """Twelve, each 11 dB below the one before: in float64 all are told, whether iterated or not."""
    rng = np.random.default_rng(0)
    left, right = (np.linalg.qr(rng.standard_normal((rows, 12)))[0] for rows in shape)
    squares = 10.0 ** (-1.1 * np.arange(12))
    block = ((left * np.sqrt(squares)) @ right.T).astype(np.float32)[None]
    core = cores(block, (80, 80), np.float64)
    left_over = float(energies(block, np.float64)[0]) - np.diag(captured(core, [tuple(range(1, 81))] * 2)[0])
    np.testing.assert_allclose(left_over[:9], squares.sum() - np.cumsum(squares)[:9], rtol=0.02)
