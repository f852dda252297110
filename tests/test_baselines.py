"""The baselines recover exactly low-rank data, keep to their bounds, and waste little."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

import baselines
from baselines import FloatArray

SHAPE = (12, 10, 8, 3)
# What float16 factors of exactly low-rank data are worth at least, in dB.
FLOAT16_DB = 60.0


def noise(shape: tuple[int, ...], seed: int = 0) -> FloatArray:
    """Standard normal values: what nothing compresses."""
    return np.random.default_rng(seed).standard_normal(shape)


def tucker(shape: tuple[int, ...], ranks: tuple[int, ...], seed: int = 0) -> FloatArray:
    """An array of exactly these multilinear ranks."""
    batch = noise((1, *ranks), seed)
    for mode, (size, rank) in enumerate(zip(shape, ranks, strict=True)):
        batch = baselines.mode_product(batch, noise((1, size, rank), seed + 1 + mode), mode)
    return batch[0]


@pytest.fixture
def smooth() -> NDArray[np.float32]:
    """A compressible but not exactly low-rank array, far beyond float16's range."""
    axes = np.meshgrid(*(np.linspace(0, 1, size) for size in SHAPE), indexing="ij")
    return np.asarray(1e7 / (0.3 + axes[0] * axes[1] + (axes[2] - axes[3]) ** 2), np.float32)


def test_every_two_way_split_comes_once() -> None:
    splits = list(baselines.two_way_splits(4))
    assert len({frozenset(split) for split in splits}) == 7
    assert all(sorted(split[0] + split[1]) == [0, 1, 2, 3] for split in splits)


def test_channel_merges_into_every_other_axis() -> None:
    found = baselines.organisations((5, 6, 3))
    assert found == [((0,), (1,), (2,)), ((0, 2), (1,)), ((0,), (1, 2))]


def test_pca_recovers_a_matrix_in_the_right_split() -> None:
    left, right = noise((12 * 8, 2), 1), noise((10 * 3, 2), 2)
    array = (left @ right.T).reshape(12, 8, 10, 3).transpose(0, 2, 1, 3)
    result = baselines.pca_splits(array, 2 * (96 + 30) * 2, 4096)
    assert result.snr_db > FLOAT16_DB
    assert result[1:] == (504, 2, "(0, 2) x (1, 3)")


def test_clustered_pca_recovers_two_subspaces() -> None:
    rows = np.concatenate([noise((40, 1), 1) @ noise((1, 20), 2), noise((40, 1), 3) @ noise((1, 20), 4)])
    budget = 2 * (80 + 2 * 20) + 2 * 80
    result = baselines.clustered_pca(rows, budget, 4096, clusters=2)
    assert result.snr_db > FLOAT16_DB
    assert (result.nbytes, result.cost) == (budget, 1)
    assert baselines.pca_splits(rows, budget, 1).snr_db < 20


def test_clusters_can_be_plain_vector_quantisation() -> None:
    rows = np.repeat(noise((4, 30)), 16, axis=0)
    result = baselines.clustered_pca(rows, 2 * 64 + 2 * 4 * 30, 4096, clusters=4)
    assert result.snr_db > FLOAT16_DB
    assert result.cost == 0


def test_hosvd_recovers_multilinear_ranks_at_their_bytes() -> None:
    result = baselines.hosvd_greedy(tucker((12, 10, 8, 5), (2, 3, 2, 1)), 10**6, 4096)
    assert result.snr_db > FLOAT16_DB
    assert result[1:3] == (2 * (12 + 12 * 2 + 10 * 3 + 8 * 2 + 5 * 1), 12)


def test_merged_channel_is_found() -> None:
    array = tucker((12, 10 * 3, 8), (2, 3, 2)).reshape(12, 10, 3, 8).transpose(0, 1, 3, 2)
    result = baselines.hosvd_greedy(array, 2 * (12 + 12 * 2 + 30 * 3 + 8 * 2), 12)
    assert result.snr_db > FLOAT16_DB
    assert result.detail.startswith("modes ((0,), (1, 3), (2,))")


def test_hosvd_of_a_matrix_does_not_stall_at_rank_one() -> None:
    matrix = np.diag([3.0, 2.0, 1.0])
    assert baselines.hosvd_greedy(matrix, 10**6, 4).cost == 4


def test_bricks_recover_pieces_and_drop_the_empty_one() -> None:
    array = np.zeros((32, 32, 4))
    array[:16, :16] = tucker((16, 16, 4), (2, 2, 2), 1)
    array[16:] = tucker((16, 32, 4), (1, 1, 1), 2)
    budget = 2 * (8 + 2 * 36) + 2 * 2 * (1 + 36)
    result = baselines.hosvd_bricks(array, budget, 8)
    assert result.snr_db > FLOAT16_DB
    assert result.nbytes <= budget
    assert result.snr_db > baselines.hosvd_greedy(array, budget, 8).snr_db + 20


@pytest.mark.parametrize("edges", [(5, 3, 8, 3), (12, 10, 8, 3)])
def test_cut_covers_every_element_once(edges: tuple[int, ...]) -> None:
    array = np.arange(math.prod(SHAPE), dtype=np.float64).reshape(SHAPE)
    batches = baselines.cut(array, edges)
    assert all(size <= edge for batch in batches for size, edge in zip(batch.shape[1:], edges, strict=True))
    assert np.array_equal(np.sort(np.concatenate([batch.ravel() for batch in batches])), array.ravel())


@pytest.mark.parametrize("divisor", [300, 100, 30, 8])
@pytest.mark.parametrize("decode_cost", [1, 20])
def test_bounds_hold_and_numbers_are_true(smooth: NDArray[np.float32], divisor: int, decode_cost: int) -> None:
    budget = smooth.nbytes // divisor
    for name, (snr, nbytes, cost) in baselines.best_baseline(smooth, budget, decode_cost).items():
        assert nbytes <= budget, name
        assert cost <= decode_cost, name
        assert 0.0 <= snr < 100.0, name
        assert (snr == 0.0) == (nbytes == 0), name


def test_bricks_are_never_far_below_one_brick(smooth: NDArray[np.float32]) -> None:
    budget = smooth.nbytes // 30
    bricks, whole = (f(smooth, budget, 64).snr_db for f in (baselines.hosvd_bricks, baselines.hosvd_greedy))
    assert bricks > whole - 1.0


def test_allocation_matches_brute_force_on_the_hull() -> None:
    """Two bricks, three truncations each: the best pair within budget lies on both convex hulls."""
    errors = np.array([[10.0, 4.0, 1.0], [20.0, 3.0, 2.0]])
    table = baselines.RateTable(errors, np.array([0, 10, 20]), np.zeros((3, 1), np.int64))
    (choice,) = baselines.allocate([table], 30)
    assert choice.tolist() == [2, 1]


def test_nothing_fits_in_no_bytes() -> None:
    assert baselines.best_baseline(noise(SHAPE), 0, 4096) == dict.fromkeys(baselines.METHODS, (0.0, 0, 0))
