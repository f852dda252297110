"""PCA, clustered PCA, HOSVD, CTA, K-CTA, MK-CTA and HMK-CTA are one model: each against a dense reference."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import prod
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dense_reference import (
    energy,
    equation_2,
    hooi_error,
    mode_sizes,
    node_rows,
    snr,
    st_hosvd_error,
    svd_error,
    tucker_bound,
    unfold,
)
from hmkcta import Model, compress
from hmkcta.axes import organise
from hmkcta.cells import Cells, dense_basis
from hmkcta.fitting.fit import EFFORTS, fit_level, left_by
from hmkcta.packed import undecomposed_modes
from hmkcta.plan import LevelSpec, parse_level
from random_models import Shapes, random_model

F32 = NDArray[np.float32]
MODES = tuple((name,) for name in "abcdef")


def smooth(*shape: int, seed: int = 0, noise: float = 0.03) -> F32:
    """Waves that no low rank captures, and a little noise."""
    rng = np.random.default_rng(seed)
    grid = np.meshgrid(*(np.linspace(0, 1, size) for size in shape), indexing="ij")
    waves = [
        np.sin(sum(rng.uniform(0.5, 9) * axis for axis in grid) + rng.uniform(0, 6)) / (1 + number)
        for number in range(6)
    ]
    return np.asarray(1.0 + sum(waves) + noise * rng.standard_normal(shape), np.float32)


def shuffled(tensor: F32, seed: int = 0) -> F32:
    """The same with the indices of every mode shuffled: neighbours tell nothing."""
    rng = np.random.default_rng(seed)
    return np.ascontiguousarray(tensor[np.ix_(*(rng.permutation(size) for size in tensor.shape))])


def fitted(array: NDArray[Any], plan: str, **options: Any) -> Model:
    return compress(array, plan, threads=1, **options)


def error_of(model: Model, array: NDArray[Any]) -> float:
    """Squared error by equation 2."""
    tensor = organise(array, model.metadata.axes, model.metadata.organisation)
    return energy(tensor.astype(np.float64) - equation_2(model))


# PCA


@pytest.mark.parametrize("plan", ["R=3", "R=3,*", "R=*,3"])
@pytest.mark.parametrize("shape", [(40, 30), (25, 60)])
def test_pca_is_the_truncated_svd(plan: str, shape: tuple[int, int]) -> None:
    matrix = smooth(*shape)
    model, best = fitted(matrix, plan), svd_error(matrix, 3)
    # No matrix of rank 3 is better (Eckart and Young); float16 costs next to nothing at this SNR.
    assert best * (1 - 1e-9) <= error_of(model, matrix) <= best * 1.001
    assert undecomposed_modes(model.stages) == tuple(n for n, r in enumerate(plan[2:].split(",")) if r == "*")


def test_pca_of_merged_modes_is_the_truncated_svd_of_their_matrix() -> None:
    tensor = smooth(6, 7, 9, 3)
    model = fitted(tensor, "R=4", axes=["light", "y", "x", "rgb"], organisation="light+rgb, y+x")
    matrix = tensor.transpose(0, 3, 1, 2).reshape(18, 63)
    best = svd_error(matrix, 4)
    assert best * (1 - 1e-9) <= error_of(model, tensor) <= best * 1.001


@pytest.mark.parametrize(("plan", "mode"), [("R=2 C=1,4", 1), ("R=2 C=3,1", 0), ("R=*,2 C=1,4", 1), ("R=2,* C=3,1", 0)])
@pytest.mark.parametrize(("quality", "slack"), [("medium", 0.05), ("thorough", 0.002)])
def test_clustered_pca_is_a_truncated_svd_of_every_cluster(plan: str, mode: int, quality: str, slack: float) -> None:
    matrix = shuffled(smooth(30, 48))
    model = fitted(matrix, plan, quality=quality)
    cluster = model.levels[0].cluster[mode]
    assert cluster is not None
    parts = [np.compress(cluster == c, matrix, axis=mode) for c in np.unique(cluster)]
    assert len(parts) > 1
    best = sum(svd_error(part, 2) for part in parts)
    assert best * (1 - 1e-9) <= error_of(model, matrix) <= best * (1 + slack)
    assert best < 0.9 * svd_error(matrix, 2)  # clusters pay


# HOSVD


@pytest.mark.parametrize(
    ("shape", "ranks"), [((12, 10, 14), (3, 2, 4)), ((8, 9, 7, 6), (2, 3, 2, 3)), ((30, 4, 5), (2, 2, 2))]
)
def test_hooi_lies_between_its_bound_and_st_hosvd(shape: Sequence[int], ranks: tuple[int, ...]) -> None:
    tensor = smooth(*shape, noise=0.1)
    error = error_of(fitted(tensor, f"R={','.join(map(str, ranks))}", quality="thorough"), tensor)
    assert tucker_bound(tensor, ranks) * (1 - 1e-9) <= error <= st_hosvd_error(tensor, ranks) * 1.0001
    assert error == pytest.approx(hooi_error(tensor, ranks), rel=2e-3)


def one_level(tensor: F32, text: str, quality: str = "medium") -> Cells:
    spec = parse_level(text, MODES[: tensor.ndim])
    effort = EFFORTS[quality].at(1, 1, tensor.size, 1)
    return fit_level(tensor, spec, effort, np.random.default_rng([0, 1, 0]))  # as level 1 of `compress`


@pytest.mark.parametrize("text", ["R=3,2,4", "R=2 C=2,2,1", "R=3,2,2 C=1,2,3", "R=2,*,3 C=2,1,2"])
def test_bases_are_orthonormal_and_cores_projections(text: str) -> None:
    """Before rounding and for disjoint clusters: U^T U = I and Z = T x_n U_n^T for every cell."""
    tensor = smooth(12, 10, 14, noise=0.1)
    cells = one_level(tensor, text)
    bases = [
        np.broadcast_to(np.eye(i), (cells.spec.cells, i, i)) if r is None else dense_basis(cells, n).astype(np.float64)
        for n, (r, i) in enumerate(zip(cells.spec.ranks, cells.sizes, strict=True))
    ]
    for c, core in enumerate(cells.cores):
        for basis in bases:
            assert np.abs(basis[c].T @ basis[c] - np.eye(basis.shape[2])).max() < 1e-5
        projected = np.einsum("abc,ax,by,cz->xyz", tensor, *(basis[c] for basis in bases), optimize=True)
        assert np.abs(core - projected).max() < 1e-4 * np.abs(core).max()


# Clustered tensors


def cluster_errors(model: Model, tensor: F32, ranks: Sequence[int]) -> tuple[float, float]:
    """Sums over disjoint cells: no better than the bound, about as good as converged HOOI."""
    level = model.levels[0]
    stored = zip(tensor.shape, level.cluster, strict=True)
    labels = [cluster.astype(int) if cluster.size else np.zeros(size, int) for size, cluster in stored]  # K = 0: none
    bound = best = 0.0
    for cell in product(*(np.unique(part) for part in labels)):
        block = tensor[np.ix_(*(np.flatnonzero(part == c) for part, c in zip(labels, cell, strict=True)))]
        bound += tucker_bound(block, ranks)
        best += hooi_error(block, ranks)
    return bound, best


@pytest.mark.parametrize(
    ("plan", "ranks"),
    [
        ("R=2 C=3,1,1", (2, 2, 2)),  # CTA: one clustered mode
        ("R=2,1,3 C=1,1,4", (2, 1, 3)),
        ("R=2 C=2,3,2", (2, 2, 2)),  # several clustered modes
        ("R=2,*,2 C=3,1,2", (2, 11, 2)),
    ],
)
def test_disjoint_clusters_are_each_as_good_as_converged_hooi(plan: str, ranks: Sequence[int]) -> None:
    tensor = shuffled(smooth(18, 11, 20))
    model = fitted(tensor, plan, quality="thorough")
    bound, best = cluster_errors(model, tensor, ranks)
    error = error_of(model, tensor)
    assert bound * (1 - 1e-9) <= error <= best * 1.02
    assert error < tucker_bound(tensor, ranks)  # beyond any HOSVD of these ranks


@pytest.mark.parametrize("plan", ["R=2 C=4,1,1 K={},1,1", "R=1,2,2 C=4,1,4 K={0},1,{0}", "R=2,*,2 C=4,1,3 K={0},1,{0}"])
def test_more_mixture_clusters_are_better(plan: str) -> None:
    """K-CTA and MK-CTA: every further mixture cluster pays."""
    tensor = shuffled(smooth(18, 11, 20, noise=0.1))
    errors = [error_of(fitted(tensor, plan.format(k)), tensor) for k in (1, 2, 3)]
    assert errors[1] < 0.95 * errors[0]
    assert errors[2] < 0.98 * errors[1]


@pytest.mark.parametrize("text", ["R=2 C=3,1,1 K=2,1,1", "R=1,2,2 C=3,2,2 K=2", "R=2,*,2 C=3,1,2 K=2"])
def test_cores_of_overlapping_clusters_are_near_their_joint_optimum(text: str) -> None:
    """Alternating least squares: with all bases given no cores do much better than the fitted ones."""
    tensor = shuffled(smooth(12, 9, 14, noise=0.1))
    model = fitted(tensor, text, quality="thorough")
    cells = one_level(tensor, text, "thorough")
    columns = list[NDArray[np.float64]]()
    for c in range(cells.spec.cells):
        product_: NDArray[np.float64] = np.ones((1, 1))
        for n, (rank, size) in enumerate(zip(cells.spec.ranks, cells.sizes, strict=True)):
            basis = np.eye(size) if rank is None else dense_basis(cells, n)[c]
            product_ = np.kron(product_, basis).astype(np.float64)
        columns.append(product_)
    system, target = np.hstack(columns), tensor.reshape(-1).astype(np.float64)
    joint = energy(target - system @ np.linalg.lstsq(system, target, rcond=1e-10)[0])
    reached = energy(target - system @ cells.cores.reshape(-1).astype(np.float64))
    assert joint <= reached <= 1.05 * joint
    assert error_of(model, tensor) == pytest.approx(reached, rel=0.02)  # compress adds only the rounding


# Everything at once

PLANS = [
    ((9, 8, 10), "R=2 C=2,2,2 K=2 / R=1 C=2,1,2 K=1"),
    ((12, 8, 10), "R=3,2,3 / R=2,2,1 C=3,2,1 K=2,1,1 / R=1 C=1,2,2 K=2"),
    ((9, 7, 10), "R=2,*,2 C=2,1,3 K=2,1,2 / R=1,*,2 C=2,1,1 K=2,1,1 / R=1,*,1"),
    ((14, 12), "R=2 / R=1 C=3,2 K=2,1 / R=1 C=2,2 K=1,2"),
    ((5, 4, 6, 5, 3), "R=2,2,3,2,1 C=2,1,2,1,1 K=2 / R=1 C=1,2,1,2,1"),
    ((4, 3, 5, 3, 4, 2), "R=2,1,2,1,2,1 / R=1 C=2,1,2,1,2,1 K=2"),
    ((7, 1, 6, 1), "R=2,1,2,1 C=2,1,2,1 K=2 / R=1"),
    ((1, 9, 8), "R=*,2,2 C=1,3,2 K=2 / R=*,1,1"),
    ((5, 6, 7), "R=2 C=2,2,2 K=2 / R=4 C=4,4,4 K=2 / R=3 C=2,2,2 K=2"),  # nodes of two or three rows
]


@pytest.mark.parametrize(("shape", "plan"), PLANS, ids=[plan for _, plan in PLANS])
def test_levels_are_what_equation_2_says(shape: Sequence[int], plan: str) -> None:
    tensor = smooth(*shape, noise=0.3)
    model = fitted(tensor, plan)
    assert len(model.levels) == plan.count("/") + 1
    before = 0.0
    for number in range(1, len(model.levels) + 1):
        coarse, sum_ = np.asarray(model.at_level(number), np.float64), equation_2(model, number)
        assert np.abs(coarse - sum_).max() < 1e-5 * np.abs(tensor).max()
        reported = model.quality[number - 1]
        if reported.snr_db < 60:
            assert reported.snr_db == pytest.approx(snr(tensor, energy(tensor - sum_)), abs=1e-6)
        if reported.snr_db < 50:  # beyond, float32 decoding shows
            assert reported.snr_db == pytest.approx(snr(tensor, energy(tensor - coarse)), abs=2e-5)
        assert reported.snr_db > before  # every level adds something
        before = reported.snr_db


@pytest.mark.parametrize(("shape", "plan"), PLANS, ids=[plan for _, plan in PLANS])
def test_shapes_are_the_plans_clamped_to_each_node(shape: Sequence[int], plan: str) -> None:
    tensor = smooth(*shape, noise=0.3)
    model = fitted(tensor, plan, quality="fast")
    for text, level, nodes in zip(plan.split("/"), model.levels, node_rows(model), strict=True):
        spec = parse_level(text, MODES[: len(shape)])
        for stored, rows in zip(level.shape, nodes, strict=True):
            if not stored.any():
                continue
            for n, owned in enumerate(rows):
                clusters, mixture, rank = stored[:, n]
                assert 1 <= clusters == min(spec.clusters[n], len(owned))
                assert mixture == (0 if spec.ranks[n] is None else min(spec.mixture[n], clusters))
                assert rank == (len(owned) if spec.ranks[n] is None else min(spec.ranks[n] or 0, len(owned)))
        owners = sum((prod(map(len, rows)) for rows in nodes), 0)
        assert owners == (tensor.size if level is model.levels[0] else owners) <= tensor.size


def test_a_merged_organisation_is_indexed_in_source_axes() -> None:
    tensor = smooth(5, 6, 7, 3)
    model = fitted(
        tensor,
        "R=3,2,4 / R=2,1,2 C=2,1,3 K=2,1,2",
        axes=["light", "y", "x", "rgb"],
        organisation="x, light, rgb+y",
    )
    assert model.shape == tensor.shape
    assert mode_sizes(model) == (7, 5, 18)
    source = equation_2(model).reshape(7, 5, 3, 6).transpose(1, 3, 0, 2)
    assert np.abs(np.asarray(model) - source).max() < 1e-5
    for key in [(2,), (slice(None), 3), (1, 2, 3, 0), (..., 1), ([0, 4], slice(1, 5, 2), -1)]:
        assert np.abs(model[key] - source[key]).max() < 1e-5
    assert snr(tensor, energy(tensor - source)) == pytest.approx(model.snr, abs=1e-6)
    assert model.snr > 15


# Data that the model holds exactly


def assert_recovered(array: F32, plan: str, **options: Any) -> None:
    model = fitted(array, plan, **options)
    assert model.snr > 55, f"{model.snr:.1f} dB of data that {plan} holds exactly"


@pytest.mark.parametrize(
    ("sizes", "undecomposed"),
    [((20, 15), ()), ((9, 8, 10), ()), ((6, 7, 5, 8), ()), ((9, 8, 10), (1,)), ((12, 9), (0,))],
)
def test_a_tucker_tensor_is_recovered(sizes: tuple[int, ...], undecomposed: tuple[int, ...]) -> None:
    shapes = Shapes(max_clusters=1, max_mixture=1, max_rank=3, zero=0.0, leaf=0.0)
    packed = random_model(np.random.default_rng(4), sizes, 1, undecomposed, shapes=shapes)
    array = np.asarray(equation_2(Model(*packed)), np.float32)
    ranks = ",".join("*" if n in undecomposed else "3" for n in range(len(sizes)))
    assert_recovered(array, f"R={ranks}")


def blocks(shape: Sequence[int], clusters: Sequence[int], rank: int, seed: int = 0) -> F32:
    """Every equal block a Tucker tensor of its own."""
    rng = np.random.default_rng(seed)
    edges = [size // count for size, count in zip(shape, clusters, strict=True)]
    out = np.empty(shape, np.float32)
    for block in np.ndindex(*clusters):
        values = rng.standard_normal([rank] * len(shape))
        for n, edge in enumerate(edges):
            values = np.moveaxis(np.tensordot(rng.standard_normal((edge, rank)), values, (1, n)), 0, n)
        out[tuple(slice(b * e, (b + 1) * e) for b, e in zip(block, edges, strict=True))] = values
    return out


def test_blocks_are_recovered_as_clusters() -> None:
    assert_recovered(blocks((12, 12, 8), (3, 2, 1), 2), "R=2 C=3,2,1")
    assert_recovered(blocks((12, 12, 8), (3, 2, 1), 2), "R=2 grid=axis0:3,axis1:2")
    assert_recovered(blocks((12, 12, 8), (3, 2, 2), 2), "R=1 grid=axis0:3,axis1:2,axis2:2 / R=2")


def test_shuffled_clusters_are_recovered() -> None:
    """Clusters of rows, each of them along a direction of its own."""
    rng = np.random.default_rng(5)
    directions = rng.standard_normal((4, 60))
    labels = rng.permutation(np.repeat(np.arange(4), 10))
    matrix = np.asarray(rng.uniform(0.5, 2.0, (40, 1)) * directions[labels], np.float32)
    model = fitted(matrix, "R=1,* C=4,1")
    assert model.snr > 55
    found = model.levels[0].cluster[0]
    assert found is not None
    assert len(set(zip(labels.tolist(), found.tolist(), strict=True))) == 4  # the same partition


def test_a_sum_of_two_levels_is_recovered() -> None:
    """A Tucker tensor plus blocks orthogonal to it; level 2's nodes are the cells of level 1."""
    coarse, fine = blocks((12, 12, 8), (1, 1, 1), 2, seed=1), blocks((12, 12, 8), (3, 2, 2), 1, seed=2)
    assert_recovered(10 * coarse + fine, "R=3 grid=axis0:3,axis1:2,axis2:2 / R=1")


def test_blocks_of_a_merged_mode_may_outnumber_a_nodes_rows() -> None:
    """16 nodes of 2 x 2 texels, to be cut by 4 x 4 again: each texel is a block, of rank one."""
    options = {"axes": ["light", "y", "x"], "organisation": "light, y+x"}
    tensor = np.random.default_rng(0).random((6, 8, 8)).astype(np.float32)
    assert fitted(tensor, "R=1 grid=y:4,x:4 / R=1 grid=y:4,x:4", **options).snr > 60


def test_unfolding_of_the_reference_is_the_papers() -> None:
    """A check of the reference itself: the norm of a mode's unfolding is the tensor's, its rows are the mode's."""
    tensor = smooth(3, 4, 5)
    for n in range(3):
        assert np.allclose(unfold(tensor, n)[1], np.take(tensor, 1, axis=n).reshape(-1))
    assert LevelSpec((2, 2, 2), (1, 1, 1), (1, 1, 1)).cells == 1


def test_fits_of_almost_nothing_are_finite() -> None:
    """Overlapping clusters of a row or two explain everything; what is left for some is zero, or next to it."""
    spec = parse_level("R=3 C=2,2,2 K=2", MODES[:3])
    tiny = np.array([-1.5137281e-05, -3.4198165e-06, 1.1111843e-07], np.float32)
    for seed in range(60):
        cells = fit_level(tiny.reshape(3, 1, 1), spec, EFFORTS["medium"], np.random.default_rng(seed))
        left = left_by(cells, tiny.reshape(3, 1, 1))
        assert all(np.isfinite(array).all() for array in (cells.cores, left, *cells.bases))
        assert energy(left) < 1e-8 * energy(tiny)
