"""The benchmark's peers recover exactly low-rank data, keep to their bounds, waste little, and are coded truthfully."""

from __future__ import annotations

from itertools import pairwise
from math import log10, prod
from pathlib import Path

import numpy as np
import pytest
from benchmarks import codecs, peers
from benchmarks.curves import draw
from benchmarks.peers import layouts, matrices, rates, tucker
from numpy.typing import NDArray
from PIL import Image

F32 = NDArray[np.float32]
SHAPE = (12, 10, 8, 3)
NAMES = ("time", "y", "x", "rgb")


def noise(shape: tuple[int, ...], seed: int = 0) -> NDArray[np.float64]:
    """Standard normal values: what nothing compresses."""
    return np.random.default_rng(seed).standard_normal(shape)


def of_ranks(shape: tuple[int, ...], ranks: tuple[int, ...], seed: int = 0) -> F32:
    """An array of exactly these multilinear ranks."""
    batch = noise((1, *ranks), seed)
    for mode, (size, rank) in enumerate(zip(shape, ranks, strict=True)):
        batch = tucker.mode_product(batch, noise((1, size, rank), seed + 1 + mode), mode)
    return np.ascontiguousarray(batch[0], np.float32)


def smooth() -> F32:
    """A compressible but not exactly low-rank array, far beyond float16's range."""
    axes = np.meshgrid(*(np.linspace(0, 1, size) for size in SHAPE), indexing="ij")
    return np.asarray(1e7 / (0.3 + axes[0] * axes[1] + (axes[2] - axes[3]) ** 2), np.float32)


def reached(method: str, values: F32, budget: int, decode_cost: int = 4096) -> tuple[float, int, int, str]:
    """SNR in dB, bytes, decode cost and layout of a method."""
    found = peers.best_of(method, values, [budget], decode_cost, NAMES[: values.ndim])[0]
    assert found is not None, f"{method} finds nothing for {budget} bytes"
    error, nbytes, cost, layout = found
    return 10 * log10(float(np.square(values, dtype=np.float64).sum()) / error), nbytes, cost, layout


def test_pca_recovers_a_matrix_in_the_right_split() -> None:
    matrix = noise((12 * 8, 2), 1) @ noise((30, 2), 2).T
    values = np.asarray(matrix.reshape(12, 8, 10, 3).transpose(0, 2, 1, 3), np.float32)
    snr, nbytes, cost, layout = reached("pca", values, 300)
    assert snr > 35
    assert nbytes <= 300
    assert cost == 2
    assert layout == "modes time+x, y+rgb; rank 2"


def test_clustered_pca_recovers_subspaces() -> None:
    lines = [noise((60, 1), 2 * k) @ noise((1, 24), 2 * k + 1) for k in range(16)]
    values = np.concatenate(lines).astype(np.float32)
    clustered, plain = reached("clustered_pca", values, 2000), reached("pca", values, 2000)
    assert clustered[0] > plain[0] + 6
    assert clustered[2] < plain[2]


def test_rows_of_different_lines_are_told_apart() -> None:
    rows = np.concatenate([noise((40, 1), 1) @ noise((1, 20), 2), noise((40, 1), 3) @ noise((1, 20), 4)])
    labels = matrices.cluster_rows(rows, 2, 1)
    assert len(set(labels[:40].tolist())) == len(set(labels[40:].tolist())) == 1
    assert labels[0] != labels[-1]


def test_hosvd_recovers_multilinear_ranks() -> None:
    snr, _, cost, layout = reached("hosvd", of_ranks((16, 14, 12, 3), (2, 3, 2, 1)), 300)
    assert snr > 25
    assert cost <= 24, layout


def test_tensor_train_recovers_its_ranks() -> None:
    cores = noise((12, 2)), noise((2, 10, 3), 1), noise((3, 8, 2), 2), noise((2, 3), 3)
    train = np.einsum("ia,ajb,bkc,cl->ijkl", *cores)
    snr, _, cost, _ = reached("tensor_train", train.astype(np.float32), 220)
    assert snr > 40
    assert cost <= 2 * 3 + 3 * 2 + 2


def test_bricks_recover_pieces_and_drop_empty_ones() -> None:
    values = np.zeros((32, 32, 4), np.float32)
    values[:16, :16] = of_ranks((16, 16, 4), (2, 2, 2), 1)
    values[16:] = of_ranks((16, 32, 4), (1, 1, 1), 2)
    bricks, whole = reached("hosvd_bricks", values, 350), reached("hosvd", values, 350)
    assert bricks[0] > whole[0] + 3
    assert bricks[1] <= 350


@pytest.mark.parametrize("decode_cost", [1, 20])
def test_bounds_hold(decode_cost: int) -> None:
    values = smooth()
    budgets = [values.nbytes // rate + 100 for rate in (300, 8)]
    for method in peers.METHODS:
        for budget, found in zip(budgets, peers.best_of(method, values, budgets, decode_cost, NAMES), strict=True):
            if found is None:
                # A train has a bond of one at least, which one multiply-add does not pay for.
                assert method == "tensor_train"
                assert decode_cost < values.ndim - 1
                continue
            error, nbytes, cost, _ = found
            assert 0 < nbytes <= budget, method
            assert cost <= decode_cost, method
            assert 0 < error <= float(np.square(values, dtype=np.float64).sum()), method


def test_more_bytes_leave_less() -> None:
    values = smooth()
    for method in peers.METHODS:
        found = peers.best_of(method, values, [200, 400, 800], 4096, NAMES)
        errors = [one[0] for one in found if one is not None]
        assert len(errors) == 3
        assert all(less < more for more, less in pairwise(errors)), method


def test_the_error_is_that_of_the_decoded_array() -> None:
    """A batch of bricks decoded here from what is said to be stored."""
    values = np.ascontiguousarray(smooth()[..., 0], np.float32)
    step = 0.02 * float(np.sqrt(np.square(values, dtype=np.float64).mean()))
    batch = tucker.Batch.of(values[None])
    ranks, _ = batch.choose(step, 4096)
    _, error, q, _ = batch.code(ranks, step)
    core = np.zeros(ranks[0])
    core[...] = q.reshape(ranks[0])
    decoded = step * core[None]
    squares = np.square(batch.core[(slice(None), *map(slice, ranks[0]))], dtype=np.float64)
    for mode, rank in enumerate(ranks[0]):
        others = tuple(1 + m for m in range(3) if m != mode)
        weight = rates.on_grid(np.sqrt(squares.sum(axis=others)) / step)
        basis = rates.quantise(batch.bases[mode][:, :, :rank] * weight[:, None]) / weight[:, None]
        decoded = tucker.mode_product(decoded, basis, mode)
    assert float(np.square(values - decoded[0]).sum()) == pytest.approx(error, rel=1e-6)


def test_bits_of_classes_are_near_the_entropy() -> None:
    rng = np.random.default_rng(0)
    q = np.round(rng.laplace(scale=1.5, size=20000))
    shares = np.unique(q, return_counts=True)[1] / q.size
    entropy = -float((shares * np.log2(shares)).sum()) * q.size
    bits = rates.class_bits(q, np.full(q.size, 2.0))
    assert entropy * 0.995 < bits < entropy * 1.02


def test_columns_are_charged_for_what_they_hold() -> None:
    small, large = np.ones((50, 1)), np.full((50, 1), 40.0)
    assert rates.column_bits(np.zeros((50, 1))) < rates.column_bits(small) < rates.column_bits(large)


@pytest.mark.parametrize("edges", [(5, 3, 8, 3), (12, 10, 8, 3)])
def test_cut_covers_every_element_once(edges: tuple[int, ...]) -> None:
    values = np.arange(prod(SHAPE), dtype=np.float64).reshape(SHAPE)
    batches = tucker.cut(values, edges)
    assert all(size <= edge for batch in batches for size, edge in zip(batch.shape[1:], edges, strict=True))
    assert np.array_equal(np.sort(np.concatenate([batch.ravel() for batch in batches])), values.ravel())


def test_organisations_come_once() -> None:
    found = layouts.partitions(4)
    assert len({frozenset(map(frozenset, groups)) for groups in found}) == len(found) == 14


@pytest.mark.parametrize("name", ["SPERR", "SZ3", "zfp", "x265"])
def test_codecs_keep_to_the_budget(name: str) -> None:
    t, y, x = np.mgrid[:6, :32, :40]
    waves = np.sin(0.2 * y + 0.3 * t) + np.cos(0.15 * x)
    values = np.ascontiguousarray(np.stack([waves, 0.8 * waves, 0.5 + waves], axis=-1), np.float32)
    found = codecs.best_within(codecs.CODECS[name], values, values.nbytes // 10)
    assert found is not None
    assert found[1] <= values.nbytes // 10
    assert 10 * log10(float(np.square(values, dtype=np.float64).sum()) / found[0]) > 15


def test_a_codec_that_is_missing_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(codecs.TTHRESH_VARIABLE, "no-such-program")
    with pytest.raises(codecs.Missing, match="TTHRESH"):
        codecs.tthresh(smooth(), 0.5)


def test_curves_are_drawn(tmp_path: Path) -> None:
    path = tmp_path / "curves.png"
    draw([("waves", "a", 1000, 20.0), ("waves", "a", 4000, 30.0), ("waves", "b", 1000, 10.0)], ["a", "b"], path)
    with Image.open(path) as picture:
        colours = {colour for _, colour in picture.convert("RGB").getcolors(1 << 20) or []}
    assert {(0, 0, 0), (31, 119, 180)} <= colours
