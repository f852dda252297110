"""Cluster subsets and subdivisions against brute force in data space, row by row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, pairwise
from math import ceil

import numpy as np
import pytest
from numpy.typing import NDArray

from dense_reference import energy, node_rows, unfold
from hmkcta import backends as kernels
from hmkcta import compress
from hmkcta.cells import Cells, dense_basis, empty_cells
from hmkcta.fitting import fit as fitting
from hmkcta.fitting import projection
from hmkcta.fitting.fit import EFFORTS, fit_level, left_by
from hmkcta.fitting.matrix_free import rows_by_sets
from hmkcta.fitting.memberships import start_candidates
from hmkcta.fitting.search import OVER_RELAXED, all_products, choose_rows, refit_cores, right_sides
from hmkcta.fitting.subdivision import CAP, subdivide
from hmkcta.fitting.swaps import exchange, extend, fill_slot
from hmkcta.plan import GRAM_CELLS, OPTIMAL_SUBSETS, LevelSpec, Plan, parse_level, parse_plan
from hmkcta.streaming.budget import with_searches
from test_special_cases import MODES, shuffled, smooth

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U16 = NDArray[np.uint16]

TENSORS = [
    ((8, 6, 7), "R=2,1,2 C=4,2,2 K=2,1,2"),
    ((9, 5, 6), "R=1,2,2 C=4,1,3 K=3,1,2"),
    ((8, 5, 7), "R=2,*,2 C=4,1,2 K=2,1,1"),
    ((20, 25), "R=1,1 C=5,3 K=2,2"),
]


def fit(tensor: F32, text: str, quality: str = "medium") -> Cells:
    return fit_level(tensor, parse_level(text, MODES[: tensor.ndim]), EFFORTS[quality], np.random.default_rng(0))


def dictionaries(cells: Cells, n: int) -> list[F64]:
    """D_n,k for each cluster subset k of mode n: columns vec(Z_c x_{m != n} U_m,c), of all cells with c_n = k."""
    bases = [
        np.stack([np.eye(size)] * cells.spec.cells) if rank is None else dense_basis(cells, m).astype(np.float64)
        for m, (rank, size) in enumerate(zip(cells.spec.ranks, cells.sizes, strict=True))
    ]
    columns: dict[int, list[F64]] = {k: [] for k in range(cells.spec.clusters[n])}
    for c, cell in enumerate(np.ndindex(*cells.spec.clusters)):
        core = cells.cores[c].astype(np.float64)
        for m, basis in enumerate(bases):
            if m != n:
                core = np.moveaxis(np.tensordot(basis[c], core, (1, m)), 0, m)
        columns[cell[n]].append(unfold(core, n).T)
    return [np.concatenate(parts, axis=1) for parts in columns.values()]


def brute_force(cells: Cells, tensor: F32, n: int, mixture: int) -> tuple[list[tuple[int, ...]], F64]:
    """The best subset of every row over all of them, and the least squared errors `[I_n, subsets]`."""
    blocks, slices = dictionaries(cells, n), unfold(tensor, n).T
    subsets = list(combinations(range(cells.spec.clusters[n]), mixture))
    errors: list[F64] = []
    for subset in subsets:
        system = np.concatenate([blocks[k] for k in subset], axis=1)
        left = slices - system @ np.linalg.lstsq(system, slices, rcond=1e-9)[0]
        errors.append(np.square(left).sum(axis=0))
    return subsets, np.stack(errors, axis=1)


def joint_rows(cells: Cells, tensor: F32, n: int, mixture: int, search: str) -> None:
    """New subsets and rows of one mode, the columns not made orthonormal: part of a sweep."""
    seen = right_sides(cells, kernels.project_cells(cells, tensor, n), n)
    choose_rows(cells, all_products(cells), seen, n, mixture, search)


def row_errors(cells: Cells, tensor: F32, n: int) -> F64:
    """Squared error of every slice of mode n."""
    return np.square(unfold(left_by(cells, tensor), n)).sum(axis=1)


@pytest.mark.parametrize(("shape", "text"), TENSORS)
def test_the_optimal_search_is_brute_force(shape: Sequence[int], text: str) -> None:
    tensor = shuffled(smooth(*shape, noise=0.3))
    start = fit(tensor, text, "fast")
    for n, mixture in enumerate(start.spec.mixture):
        if start.spec.clusters[n] == 1 and start.spec.ranks[n] is None:
            continue
        cells = replace(start, bases=[b.copy() for b in start.bases], members=list(start.members))
        subsets, errors = brute_force(cells, tensor, n, mixture)
        joint_rows(cells, tensor, n, mixture, "optimal")
        found = row_errors(cells, tensor, n)
        slack = 1e-5 * energy(tensor) / shape[n]  # the ridge, and float32
        assert np.all(found <= errors.min(axis=1) + slack)
        assert np.all(found >= errors.min(axis=1) - slack)
        for i, members in enumerate(cells.members[n]):
            chosen = errors[i, subsets.index(tuple(int(k) for k in members))]
            assert chosen <= errors[i].min() + slack


@pytest.mark.parametrize(("shape", "text"), TENSORS)
def test_cores_are_fitted_together(shape: Sequence[int], text: str) -> None:
    tensor = shuffled(smooth(*shape, noise=0.3))
    cells = fit(tensor, text, "fast")
    n = next(n for n, rank in enumerate(cells.spec.ranks) if rank is not None)
    before = energy(left_by(cells, tensor))
    rng = np.random.default_rng(1)
    cells.cores *= rng.uniform(0.5, 1.5, cells.cores.shape).astype(np.float32)
    spoiled = energy(left_by(cells, tensor))
    for _ in range(60):
        refit_cores(cells, all_products(cells), kernels.project_cells(cells, tensor, n), n)
    assert spoiled > 1.05 * before
    assert energy(left_by(cells, tensor)) <= before * 1.0001


@pytest.mark.parametrize(("shape", "text"), TENSORS)
@pytest.mark.parametrize("search", ["optimal", "greedy", "fixed"])
def test_no_search_raises_the_error(shape: Sequence[int], text: str, search: str) -> None:
    tensor = shuffled(smooth(*shape, noise=0.3))
    cells = fit(tensor, text, "fast")
    before = energy(left_by(cells, tensor))
    for n, mixture in enumerate(cells.spec.mixture):
        if cells.spec.ranks[n] is None:
            continue
        subsets, members = {tuple(row) for row in cells.members[n]}, cells.members[n].copy()
        joint_rows(cells, tensor, n, mixture, search)
        after = energy(left_by(cells, tensor))
        if search == "fixed":
            assert np.array_equal(cells.members[n], members)
            assert {tuple(row) for row in cells.members[n]} == subsets
        assert after <= before * 1.0001
        kernels.orthonormalise(cells, n)
        assert energy(left_by(cells, tensor)) == pytest.approx(after, rel=1e-4)
        before = energy(left_by(cells, tensor))


@pytest.mark.parametrize(("shape", "text"), [case for case in TENSORS if "*" not in case[1]])
def test_the_greedy_search_lies_between_one_cluster_and_the_optimum(shape: Sequence[int], text: str) -> None:
    tensor = shuffled(smooth(*shape, noise=0.3))
    start = fit(tensor, text, "fast")
    mixture = start.spec.mixture[0]
    assert mixture > 1

    def searched(k: int, search: str) -> float:
        cells = replace(start, bases=list(start.bases), members=list(start.members))
        joint_rows(cells, tensor, 0, k, search)
        return energy(left_by(cells, tensor))

    one, greedy, optimal = searched(1, "optimal"), searched(mixture, "greedy"), searched(mixture, "optimal")
    assert optimal * 0.9999 <= greedy <= one
    assert greedy <= 1.1 * optimal


def test_projections_larger_than_the_tensor_are_not_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(projection, "LARGEST", 0)
    tensor = np.random.default_rng(0).standard_normal((40, 2, 6, 5), np.float32)
    for rank, fits in ((2, True), (40, False)):  # of a long mode: lanes for each number of its bases
        spec = LevelSpec((rank, 1, 1, 1), (2, 1, 1, 1), (2, 1, 1, 1))
        members = [
            np.tile(np.arange(k, dtype=np.uint16), (i, 1)) for k, i in zip(spec.mixture, tensor.shape, strict=True)
        ]
        cells = empty_cells(tensor.shape, spec, members, np.random.default_rng(1))
        seen = projection.project(cells, tensor, (0, 1))
        assert (seen.pair is not None) == fits
        for n in (0, 1):
            expected = kernels.project_cells(cells, tensor, n)
            assert seen.onto(cells, n) == pytest.approx(expected, rel=1e-4, abs=1e-4)


def test_greedy_and_fast_searches_are_reached() -> None:
    assert LevelSpec((1, 1), (4, 1), (2, 1)).search == "optimal"
    assert LevelSpec((1, 1), (12, 1), (3, 1)).search == "greedy"  # 220 subsets
    assert LevelSpec((1, 1), (40, 40), (2, 1)).search == "fast"
    assert LevelSpec((8, 8), (16, 16), (2, 2)).search == "greedy"
    assert LevelSpec((9, 8), (16, 16), (2, 2)).search == "fast"  # H would have 2304^2 numbers
    assert LevelSpec((9, 8), (16, 16), (1, 1)).search == "optimal"  # nothing to search
    assert LevelSpec((1, 1), (40, 40), (1, 1)).search == "optimal"
    assert OPTIMAL_SUBSETS < 220
    assert GRAM_CELLS < 1600


@pytest.mark.parametrize(
    ("shape", "plan", "search"),
    [
        ((40, 30), "R=1 C=12,1 K={},1", "greedy"),
        ((40, 30), "R=1,* C=12,1 K={},1", "greedy"),
        ((48, 44), "R=1 C=9,8 K={}", "fast"),
        ((14, 12, 15), "R=1 C=12,12,12 K={}", "fast"),
    ],
)
def test_searches_for_many_clusters_pay(shape: Sequence[int], plan: str, search: str) -> None:
    """Every mixture cluster more is better, and the model is what a search of its own found."""
    tensor = shuffled(smooth(*shape, noise=0.3))
    snrs = [compress(tensor, plan.format(k), threads=1, quality="fast", search=search).snr for k in (1, 2, 3)]
    assert snrs[0] + 0.5 < snrs[1] < snrs[2]


def test_rows_take_the_best_further_cluster_and_exchange_only_for_better_ones() -> None:
    tensor = shuffled(smooth(12, 9, 10, noise=0.3))
    cells = fit(tensor, "R=2,1,2 C=4,2,2")
    left = left_by(cells, tensor)
    errors = [energy(left)]
    for n in (0, 2):
        extend(cells, left, n)
        errors.append(energy(left))
    assert cells.spec.mixture == (2, 1, 2)
    assert [m.shape[1] for m in cells.members] == [2, 1, 2]
    for _ in range(3):
        exchange(cells, left)
        errors.append(energy(left))
        for members in cells.members:
            assert np.all(np.diff(members.astype(int), axis=1) > 0)  # distinct and ascending
    assert all(after < before for before, after in pairwise(errors))
    assert np.abs(left_by(cells, tensor) - left).max() < 1e-5


def test_an_exchange_finds_the_best_cluster_beside_the_others() -> None:
    """That of least error by brute force, in the one slot that is looked at last."""
    tensor = shuffled(smooth(10, 8, 9, noise=0.3))
    cells = fit(tensor, "R=1,2,2 C=4,2,2 K=2")
    kept, left = cells.copy(), left_by(cells, tensor)
    fill_slot(cells, left, 0, 1)
    blocks, slices = dictionaries(kept, 0), np.asarray(unfold(tensor, 0), np.float64)
    for i, members in enumerate(kept.members[0].astype(int)):
        first = np.asarray(slices[i] - blocks[members[0]] @ kept.bases[0][i, 0].reshape(-1), np.float64)
        least = min(energy(first - block @ np.asarray(np.linalg.lstsq(block, first)[0], np.float64))
                    for k, block in enumerate(blocks) if k != members[0])
        assert energy(left[i]) == pytest.approx(least, rel=1e-3)


def test_joint_rows_of_one_set_after_another_are_those_of_all() -> None:
    """The sets kept, as `choose_rows` finds them from H of all cells."""
    tensor = shuffled(smooth(14, 9, 10, noise=0.3))
    cells = fit(tensor, "R=2,1,2 C=3,2,2 K=2")
    cells.bases[0] += 0.1
    apart, left = cells.copy(), left_by(cells, tensor)
    rows_by_sets(apart, left, 0, 1.0)
    b = right_sides(cells, kernels.project_cells(cells, tensor, 0), 0)
    choose_rows(cells, all_products(cells), b, 0, 2, "fixed")
    assert energy(left) == pytest.approx(energy(left_by(cells, tensor)), rel=1e-4)
    assert np.abs(left_by(apart, tensor) - left).max() < 1e-4


@pytest.mark.parametrize("plan", ["R=2 C=3,3,3 K=2", "R=2,2,* C=4,3,1 K=2,2,1"])
def test_the_fast_search_ends_near_the_optimal_one(plan: str) -> None:
    tensor = shuffled(smooth(24, 20, 22, noise=0.1))
    optimal, fast = (compress(tensor, plan, search=search, threads=1).snr for search in ("optimal", "fast"))
    assert fast > optimal - 1


def test_memory_decides_between_joint_and_fast_searches() -> None:
    plan = parse_plan("R=1 C=40,40 K=2", MODES[:2])
    assert [with_searches(plan, (64, 64), room, None).levels[0].search for room in (2**20, 2**30)] == ["fast", "greedy"]
    asked = Plan(plan.organisation, (replace(plan.levels[0], asked="fast"),))
    assert with_searches(asked, (64, 64), 2**30, None) == asked


# Subdivision


def lone_errors(cells: Cells, tensor: F32, n: int) -> F64:
    """`[I_n, K_n]` squared error of each slice by one of its cluster subsets alone."""
    blocks, slices = dictionaries(cells, n), unfold(tensor, n)
    errors = np.empty(cells.members[n].shape)
    for (i, slot), k in np.ndenumerate(cells.members[n]):
        row = cells.bases[n][i, slot].reshape(-1).astype(np.float64)
        errors[i, slot] = energy(slices[i] - blocks[k] @ row)
    return errors


@pytest.mark.parametrize("most_cells", [GRAM_CELLS, 1], ids=["by inner products", "by what is left"])
@pytest.mark.parametrize(("shape", "text"), TENSORS)
def test_most_and_least_significant_parts_are_brute_force(
    shape: Sequence[int], text: str, most_cells: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    tensor = shuffled(smooth(*shape, noise=0.3))
    cells = fit(tensor, text)
    monkeypatch.setattr("hmkcta.plan.GRAM_CELLS", most_cells)  # of more the inner products are not looked at
    most, least = subdivide(cells, tensor, "most"), subdivide(cells, tensor, "least")
    for n, (members, mixture) in enumerate(zip(cells.members, cells.spec.mixture, strict=True)):
        if mixture == 1:
            assert np.array_equal(most[n], members[:, 0])
            assert np.array_equal(least[n], members[:, 0])
            continue
        errors = lone_errors(cells, tensor, n)
        assert_best_with_room(most[n], members, errors, cells.spec.clusters[n])
        assert_best_with_room(least[n], members, -errors, cells.spec.clusters[n])
        assert np.any(most[n] != least[n])


def assert_best_with_room(parts: NDArray[np.intp], members: U16, errors: F64, clusters: int) -> None:
    """Every row in its best subset, unless that is full of rows that would lose more elsewhere."""
    sizes = np.bincount(parts, minlength=clusters)
    most = ceil(CAP * len(parts) / clusters)
    assert sizes.max() <= most
    margins = np.diff(np.sort(errors, axis=1)[:, :2], axis=1)[:, 0]
    best = np.take_along_axis(members, errors.argmin(axis=1)[:, None], axis=1)[:, 0]
    for i in np.nonzero(parts != best)[0]:
        assert sizes[best[i]] == most
        assert parts[i] in members[i] or (sizes[members[i]] == most).all()
        assert margins[(parts == best[i]) & (best == best[i])].min() >= margins[i] * (1 - 1e-9)


def test_rows_that_share_a_cluster_are_divided_all_the_same() -> None:
    """The first subset says nearly everything of every row; each row's second one differs."""
    tensor = smooth(12, 10, 9)
    cells = fit(tensor, "R=2 C=3,1,1 K=2,1,1")
    cells.members[0] = np.stack([np.zeros(12), np.arange(12) % 2 + 1], axis=1).astype(np.uint16)
    cells.bases[0][:, 1] *= 1e-3
    assert np.bincount(subdivide(cells, tensor, "most")[0], minlength=3).max() == 5


def test_over_relaxed_rows_go_beyond_the_best_and_never_raise_the_error() -> None:
    tensor = shuffled(smooth(9, 8, 7, noise=0.3))
    cells = fit(tensor, "R=2 C=3,2,2 K=2,2,1", "fast")
    best, beyond = cells.copy(), cells.copy()
    seen = right_sides(cells, kernels.project_cells(cells, tensor, 0), 0)
    choose_rows(best, all_products(best), seen, 0, 2, "fixed")
    choose_rows(beyond, all_products(beyond), seen, 0, 2, "fixed", OVER_RELAXED)
    expected = cells.bases[0] + OVER_RELAXED * (best.bases[0] - cells.bases[0])
    np.testing.assert_allclose(beyond.bases[0], expected, rtol=1e-4, atol=1e-5)
    errors = [energy(left_by(each, tensor)) for each in (best, beyond, cells)]
    assert errors[0] < errors[1] < errors[2]


def test_rows_of_new_subsets_are_not_relaxed() -> None:
    tensor = shuffled(smooth(9, 8, 7, noise=0.3))
    cells = fit(tensor, "R=2 C=3,2,2 K=2,2,1", "fast")
    cells.members[0][:4] = cells.members[0][[5, 6, 7, 8]]  # wrong ones
    best, beyond = cells.copy(), cells.copy()
    seen = right_sides(cells, kernels.project_cells(cells, tensor, 0), 0)
    choose_rows(best, all_products(best), seen, 0, 2, "optimal")
    choose_rows(beyond, all_products(beyond), seen, 0, 2, "optimal", OVER_RELAXED)
    moved = (best.members[0] != cells.members[0]).any(axis=1)
    assert 0 < np.count_nonzero(moved) < len(moved)
    assert np.array_equal(best.members[0], beyond.members[0])
    assert np.array_equal(best.bases[0][moved], beyond.bases[0][moved])
    assert not np.allclose(best.bases[0][~moved], beyond.bases[0][~moved])


def test_over_relaxed_sweeps_get_further(monkeypatch: pytest.MonkeyPatch) -> None:
    tensor = smooth(20, 18, 16, noise=0)
    monkeypatch.setattr(fitting, "GRAM_VISITS", 0)  # joint rows alone
    relaxed = energy(left_by(fit(tensor, "R=2 C=3,3,3 K=2"), tensor))
    monkeypatch.setattr(fitting, "OVER_RELAXED", 1.0)
    assert energy(left_by(fit(tensor, "R=2 C=3,3,3 K=2"), tensor)) > 1.25 * relaxed


@pytest.mark.parametrize("mixture", [1, 2])
def test_uniform_parts_are_the_papers_blocks(mixture: int) -> None:
    """Footnote 1: ceil(I / C) rows a part, and one less in the last ones where C does not divide I."""
    shape, clusters = (10, 13, 12), (4, 3, 2)
    tensor = smooth(*shape, noise=0.3)
    cells = fit(tensor, f"R=1 C=4,3,2 K={mixture}", "fast")
    for size, count, parts in zip(shape, clusters, subdivide(cells, tensor, "uniform"), strict=True):
        assert np.all(np.diff(parts) >= 0)  # blocks of neighbours
        longest = -(-size // count)
        lengths = np.bincount(parts, minlength=count)
        shorter = count * longest - size
        assert lengths.tolist() == [longest] * (count - shorter) + [longest - 1] * shorter


@pytest.mark.parametrize("scheme", ["most", "least", "uniform"])
def test_the_tree_follows_its_subdivision(scheme: str) -> None:
    """Every element of the tensor is in exactly one node of each level; undecomposed modes are not divided."""
    tensor = shuffled(smooth(12, 5, 10, noise=0.3))
    model = compress(tensor, "R=2,*,2 C=3,1,2 K=2 / R=1,*,1 C=2,1,2 K=2 / R=1,*,1", scheme=scheme, threads=1)
    assert len(model.levels) == 3
    assert [level.scheme for level in model.bounds][:2] == [scheme] * 2
    for nodes in node_rows(model):
        count = np.zeros(tensor.shape, int)
        for rows in nodes:
            count[np.ix_(*rows)] += 1
            assert len(rows[1]) == 5
        assert np.all(count == 1)


def test_a_single_start_is_of_like_rows() -> None:
    """As `fast` has it: uniform blocks would part rows without order by chance."""
    kinds = np.random.default_rng(2).permutation(np.repeat(np.arange(4), 10))
    rows = np.random.default_rng(3).standard_normal((4, 30))[kinds] + 0.01 * np.arange(40)[:, None]
    spec = LevelSpec((3, None), (4, 1), (1, 1))
    for overlap in (False, True):
        ((labels, columns),) = start_candidates(rows, spec, 1, np.random.default_rng(0), overlap=overlap)
        assert all(len(set(labels[kinds == kind])) == 1 for kind in range(4))
        assert not columns.any()
    uniform, *others, _ = start_candidates(rows, spec, 3, np.random.default_rng(0), overlap=True)
    assert uniform[0].tolist() == sorted(uniform[0])
    assert len(others) == 2
