"""The native kernels and their readable twin compute the same, and what they promise holds."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hmkcta.backends import Kernels, native, reference
from hmkcta.backends.coding import Dictionary
from hmkcta.cells import Cells, dense_basis
from hmkcta.errors import HmkctaError
from hmkcta.fitting.projection import Projection
from hmkcta.fitting.search import all_products
from hmkcta.plan import LevelSpec

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


def random_cells(sizes: tuple[int, ...], spec: LevelSpec, seed: int, *, empty: bool = False) -> Cells:
    """Random memberships, bases and cores; with `empty` the last cluster subset of each mode stays without rows."""
    rng = np.random.default_rng(seed)
    members: list[NDArray[np.uint16]] = []
    for size, clusters, mixture in zip(sizes, spec.clusters, spec.mixture, strict=True):
        usable = max(mixture, clusters - 1) if empty else clusters
        order = np.argsort(rng.random((size, usable)), axis=1)[:, :mixture]
        members.append(np.sort(order, axis=1).astype(np.uint16))
    ranks = [size if rank is None else rank for size, rank in zip(sizes, spec.ranks, strict=True)]
    bases: list[F32] = []
    for n, size in enumerate(sizes):
        shape = (size, spec.mixture[n], spec.cells // spec.clusters[n], ranks[n])
        undecomposed = spec.ranks[n] is None
        bases.append(np.zeros(0, np.float32) if undecomposed else rng.standard_normal(shape, np.float32))
    return Cells(sizes, spec, members, bases, rng.standard_normal((spec.cells, *ranks), np.float32))


def smooth_data(sizes: tuple[int, ...], seed: int) -> F32:
    """A few separable waves and some noise."""
    rng = np.random.default_rng(seed)
    x = 0.1 * rng.standard_normal(sizes)
    for _ in range(3):
        wave = np.ones(())
        for size in sizes:
            wave = np.multiply.outer(wave, np.sin(rng.uniform(0, 0.7) * np.arange(size) + rng.uniform(0, 6)))
        x += wave
    return x.astype(np.float32)


def energy(x: F32) -> float:
    return float(np.vdot(x.astype(np.float64), x))


def model_of(cells: Cells) -> F32:
    x = np.zeros(cells.sizes, np.float32)
    reference.accumulate(cells, x, 1.0)
    return x


Node = tuple[Cells, F32]


@st.composite
def nodes(draw: st.DrawFn) -> Node:
    """Cells of any shape with data: orders 1 to 6, undecomposed and size-1 modes, empty cells, ranks beyond rows."""
    order = draw(st.integers(1, 6))
    sizes = tuple(draw(st.lists(st.integers(1, (400, 40, 14, 8, 5, 4)[order - 1]), min_size=order, max_size=order)))
    clusters = [draw(st.integers(1, 3)) for _ in sizes]
    mixture = [draw(st.integers(1, c)) for c in clusters]
    ranks: list[int | None] = [draw(st.integers(1, 5 if order < 5 else 2)) for _ in sizes]
    for n in range(order):
        if draw(st.integers(0, 4)) == 0:
            ranks[n], clusters[n], mixture[n] = None, 1, 1
    spec = LevelSpec(tuple(ranks), tuple(clusters), tuple(mixture))
    seed = draw(st.integers(0, 2**32 - 1))
    data = smooth_data(sizes, seed)
    if draw(st.integers(0, 9)) == 0:
        data[:] = 0
    return random_cells(sizes, spec, seed, empty=draw(st.booleans())), data


#: Nodes that are cut into several slabs, columns, leaves and tasks.
LARGE = [
    ((9, 3000), LevelSpec((7, 20), (1, 2), (1, 1))),
    ((3000, 9), LevelSpec((20, None), (3, 1), (2, 1))),
    ((70, 40, 90), LevelSpec((3, 9, 4), (3, 2, 4), (2, 2, 2))),
    ((2, 3, 600, 500), LevelSpec((1, 2, 2, 3), (1, 2, 2, 2), (1, 1, 2, 1))),
    ((12, 300, 320), LevelSpec((2, None, 3), (3, 1, 3), (2, 1, 3))),
    ((30, 20, 25, 5, 8), LevelSpec((2, 3, 2, None, 2), (2, 2, 2, 1, 2), (2, 2, 2, 1, 1))),
]


def close(found: NDArray[np.floating], expected: NDArray[np.floating], tolerance: float) -> None:
    scale = float(np.abs(expected).max(initial=0.0)) + 1e-30
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=tolerance)


def check_same(cells: Cells, data: F32, kernels: Kernels = native) -> None:
    """All kernels of a backend and of the reference on the same node."""
    found, expected = data.copy(), data.copy()
    kernels.accumulate(cells, found, -0.75)
    reference.accumulate(cells, expected, -0.75)
    close(found, expected, 1e-5)
    products = all_products(cells)
    for n in range(cells.order):
        close(kernels.project_cells(cells, data, n), reference.project_cells(cells, data, n), 1e-4)
        close(kernels.dictionary_gram(cells, products, n), reference.dictionary_gram(cells, products, n), 1e-12)
    check_pairs(cells, data, kernels)


def check_coding(cells: Cells, data: F32, n: int) -> None:
    """Both find subsets that explain as much of each row, and coefficients that do explain it."""
    cores = np.moveaxis(cells.cores, n + 1, 1).reshape(cells.spec.cells, cells.ranks[n], -1)
    b = cores.astype(np.float64) @ reference.project_cells(cells, data, n).transpose(0, 2, 1)
    h = reference.dictionary_gram(cells, all_products(cells), n)
    clusters, mixture = cells.spec.clusters, cells.spec.mixture[n]
    dictionary = Dictionary.of(h, b, clusters, n)
    for search in ("optimal", "greedy", "fixed"):
        found, x = native.code_rows(h, b, clusters, n, cells.members[n], mixture, search)
        expected, _ = reference.code_rows(h, b, clusters, n, cells.members[n], mixture, search)
        gain = [float(dictionary.gain(tuple(s), np.array([i]))[0]) for i, s in enumerate(expected.tolist())]
        explained: list[float] = []
        for i, subset in enumerate(found.tolist()):
            scaled = (x[i] * dictionary.length[subset]).reshape(-1)
            h_ss = dictionary.h[subset][:, :, subset].reshape(len(scaled), -1)
            explained.append(float(2 * scaled @ dictionary.b[subset, :, i].reshape(-1) - scaled @ h_ss @ scaled))
        assert explained == pytest.approx(gain, rel=1e-3, abs=1e-4 * max(gain) + 1e-30)
        if search == "fixed":
            assert np.array_equal(found, cells.members[n])


def check_pairs(cells: Cells, data: F32, kernels: Kernels) -> None:
    """Projection on every two decomposed modes, as by the reference; with a further pass what `project_cells` says."""
    decomposed = [n for n, skip in enumerate(cells.undecomposed) if not skip]
    for pair in permutations(decomposed, 2):
        found = kernels.project_pair(cells, data, pair)
        close(found, reference.project_pair(cells, data, pair), 1e-4)
        for n in (n for n in decomposed if n not in pair):
            close(Projection(data, pair, found).onto(cells, n), reference.project_cells(cells, data, n), 1e-4)


@settings(max_examples=50, deadline=None)
@given(st.tuples(*[st.integers(1, 9)] * 5), st.integers(0, 99))
def test_lanes_are_contracted_alike(sizes: tuple[int, int, int, int, int], seed: int) -> None:
    before, size, after, rank, lanes = sizes
    rng = np.random.default_rng(seed)
    p = rng.standard_normal((before, size, after, lanes), np.float32)
    w = rng.standard_normal((size, rank, lanes), np.float32)
    close(native.contract_lanes(p, w), reference.contract_lanes(p, w), 1e-5)


@settings(max_examples=100, deadline=None)
@given(nodes())
def test_backends_agree(node: Node) -> None:
    check_same(*node)


@settings(max_examples=100, deadline=None)
@given(nodes())
def test_codings_agree(node: Node) -> None:
    cells, data = node
    for n in range(cells.order):
        if cells.spec.ranks[n] is not None:
            check_coding(cells, data, n)


@pytest.mark.parametrize(("clusters", "mixture"), [((12, 2), 3), ((3, 4), 2)])
def test_codings_of_many_clusters_agree(clusters: tuple[int, int], mixture: int) -> None:
    spec = LevelSpec((3, 2), clusters, (mixture, 1))
    check_coding(random_cells((60, 31), spec, 3), smooth_data((60, 31), 4), 0)


@pytest.mark.parametrize(("sizes", "spec"), LARGE, ids=[str(sizes) for sizes, _ in LARGE])
def test_backends_agree_on_large_nodes(sizes: tuple[int, ...], spec: LevelSpec) -> None:
    check_same(random_cells(sizes, spec, 1), smooth_data(sizes, 2))


def check_sweeps(kernels: Kernels, node: Node, iterations: int) -> None:
    """None raises the error."""
    cells, residual = node
    whole = energy(residual + model_of(cells))
    before = energy(residual)
    for _ in range(4):
        kernels.fit_cells(cells, residual, 1, iterations)
        after = energy(residual)
        assert after <= before + 1e-6 * whole
        before = after
    assert all(np.isfinite(x).all() for x in (*cells.bases, cells.cores))


@settings(max_examples=100, deadline=None)
@given(nodes(), st.integers(1, 3))
def test_no_sweep_raises_the_error(node: Node, iterations: int) -> None:
    check_sweeps(native, node, iterations)


SCALES = pytest.mark.parametrize("scale", [1e-18, 1.0, 1e15])


def check_scale(kernels: Kernels, scale: float) -> None:
    """Data times a number leave as large a share."""
    spec = LevelSpec((2, 2, 3), (2, 2, 2), (2, 1, 2))
    cells, data = random_cells((12, 10, 17), spec, 3), smooth_data((12, 10, 17), 3)
    cells.cores[:] = 0
    shares: list[float] = []
    for factor in (1.0, scale):
        residual = (data * factor).astype(np.float32)
        kernels.fit_cells(cells.copy(), residual, 3, 2)
        shares.append(energy((residual / np.float32(factor)).astype(np.float32)) / energy(data))
    assert shares[1] == pytest.approx(shares[0], rel=1e-3)


@SCALES
def test_scale_does_not_matter(scale: float) -> None:
    check_scale(native, scale)


def test_full_ranks_leave_nothing() -> None:
    sizes = (7, 9, 5)
    cells, data = random_cells(sizes, LevelSpec((7, 9, 5), (2, 1, 2), (1, 1, 1)), 4), smooth_data(sizes, 4)
    cells.cores[:] = 0
    residual = data.copy()
    native.fit_cells(cells, residual, 1, 1)
    assert energy(residual) < 1e-10 * energy(data)


def test_hosvd_of_a_single_cell_is_the_best_subspace() -> None:
    """An undecomposed mode beside a decomposed one is PCA."""
    data = smooth_data((40, 60), 5)
    cells = random_cells((40, 60), LevelSpec((4, None), (1, 1), (1, 1)), 5)
    cells.cores[:] = 0
    residual = data.copy()
    native.fit_cells(cells, residual, 30, 2)
    values = np.linalg.svd(data.astype(np.float64), compute_uv=False)
    assert energy(residual) == pytest.approx(float(np.square(values[4:]).sum()), rel=1e-4)


def test_zero_data_gives_a_zero_model() -> None:
    cells = random_cells((6, 5, 4), LevelSpec((2, 2, 2), (2, 2, 1), (2, 1, 1)), 6)
    cells.cores[:] = 0
    residual = np.zeros((6, 5, 4), np.float32)
    native.fit_cells(cells, residual, 2, 2)
    assert not residual.any()
    assert not cells.cores.any()


def explicit_dictionary(cells: Cells, n: int) -> F64:
    """Columns vec(Z_c[r] x_{m != n} U_{m,c}), written out: `[elements of a slice, PC R_n]`."""
    columns: list[F64] = []
    dense = [None if skip else dense_basis(cells, m) for m, skip in enumerate(cells.undecomposed)]
    for c in range(cells.spec.cells):
        x = cells.cores[c].astype(np.float64)
        for m, basis in enumerate(dense):
            if basis is not None and m != n:
                x = np.moveaxis(np.tensordot(basis[c], x, (1, m)), 0, m)
        columns.extend(np.moveaxis(x, n, 0).reshape(cells.ranks[n], -1))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("backend", [native, reference], ids=["native", "reference"])
def test_dictionary_gram_by_definition(backend: Kernels) -> None:
    cells = random_cells((6, 7, 3, 5), LevelSpec((2, 3, None, 2), (2, 3, 1, 2), (2, 2, 1, 1)), 7)
    for n in range(4):
        d = explicit_dictionary(cells, n)
        close(backend.dictionary_gram(cells, all_products(cells), n), d.T @ d, 1e-12)


@pytest.mark.parametrize(
    "spec",
    [
        LevelSpec((4, 3, 9), (3, 1, 2), (2, 1, 2)),  # few cells, each cut into slabs
        LevelSpec((2, 3, 3), (3, 4, 6), (2, 2, 3)),  # many cells, many pairs of them
    ],
    ids=str,
)
def test_threads_do_not_change_a_bit(spec: LevelSpec) -> None:
    sizes = (70, 64, 90)
    cells, data = random_cells(sizes, spec, 8), smooth_data(sizes, 8)
    products = all_products(cells)
    outcomes: list[list[NDArray[np.floating]]] = []
    try:
        for threads in (1, 2, 5, 0):
            native.set_threads(threads)
            fit, residual, total = cells.copy(), data.copy(), data.copy()
            native.fit_cells(fit, residual, 2, 2)
            native.accumulate(cells, total, 0.5)
            results: list[NDArray[np.floating]] = [residual, fit.cores, *fit.bases, total]
            results += [native.project_cells(cells, data, n) for n in range(3)]
            outcomes.append([*results, *(native.dictionary_gram(cells, products, n) for n in range(3))])
    finally:
        native.set_threads(0)
    for other in outcomes[1:]:
        for x, y in zip(outcomes[0], other, strict=True):
            np.testing.assert_array_equal(x, y)


def test_nodes_may_be_fitted_in_threads() -> None:
    spec = LevelSpec((4, 3, 5), (2, 1, 2), (2, 1, 1))

    def fitted(seed: int) -> F32:
        cells, residual = random_cells((60, 64, 70), spec, seed), smooth_data((60, 64, 70), seed)
        native.fit_cells(cells, residual, 2, 2)
        return residual

    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(fitted, range(6)))
    for seed, residual in enumerate(together):
        np.testing.assert_array_equal(residual, fitted(seed))


def test_arrays_are_worked_on_in_place_or_refused() -> None:
    cells, data = random_cells((6, 5), LevelSpec((2, 2), (2, 1), (1, 1)), 9), smooth_data((6, 5), 9)
    frozen = data.copy()
    frozen.flags.writeable = False
    for bad in (data[:, ::-1], frozen, data.astype(np.float64), np.asfortranarray(data)):
        with pytest.raises(HmkctaError, match="not-in-place"):
            native.accumulate(cells, bad, 1.0)  # pyright: ignore[reportArgumentType]
    with pytest.raises(HmkctaError, match="wrong-shape"):
        native.accumulate(cells, data.T.copy(), 1.0)
    with pytest.raises(HmkctaError, match="threads-negative"):
        native.set_threads(-1)
    # Bases and cores may be views or read-only: they are replaced.
    cells.bases = [np.asfortranarray(b) for b in cells.bases]
    cells.cores.flags.writeable = False
    cells.cores = np.zeros_like(cells.cores)
    expected = cells.copy()
    native.fit_cells(cells, data.copy(), 1, 1)
    native.fit_cells(expected, data.copy(), 1, 1)
    np.testing.assert_array_equal(cells.cores, expected.cores)


def test_broken_cells_are_refused() -> None:
    cells, data = random_cells((6, 5), LevelSpec((2, 2), (3, 1), (2, 1)), 10), smooth_data((6, 5), 10)
    cells.members[0][3] = (1, 1)
    with pytest.raises(ValueError, match="memberships of mode 1: row 3"):
        native.accumulate(cells, data, 1.0)
    cells.members[0][3] = (1, 3)
    with pytest.raises(ValueError, match="distinct numbers below 3"):
        native.fit_cells(cells, data, 1, 1)
    cells.members[0][3] = (1, 2)
    cells.bases[1] = cells.bases[1][:-1]
    with pytest.raises(ValueError, match="basis 2 must hold"):
        native.accumulate(cells, data, 1.0)
    with pytest.raises(ValueError, match="product 2 must hold 36 numbers, got 35"):
        native.dictionary_gram(cells, [None, np.zeros(35)], 0)


@settings(max_examples=60, deadline=None)
@given(nodes(), st.integers(0, 2**32 - 1))
def test_sub_tensors_are_gathered_and_put_back(node: Node, seed: int) -> None:
    data, rng = node[1], np.random.default_rng(seed)
    rows: list[NDArray[np.intp]] = [
        np.arange(size)[rng.permutation(size) < share * size]
        for size, share in zip(data.shape, rng.uniform(0.0, 1.2, data.ndim), strict=True)
    ]
    block = native.gather(data, rows)
    assert np.array_equal(block, reference.gather(data, rows))
    assert np.array_equal(native.gather(data.T, rows[::-1]), block.T)
    found, expected = data.copy(), data.copy()
    native.scatter(found, rows, block + 1)
    reference.scatter(expected, rows, block + 1)
    assert np.array_equal(found, expected)


def test_sub_tensors_outside_are_refused() -> None:
    data, inside = np.zeros((4, 5), np.float32), np.arange(4)
    for wrong in ([3, 4], [2, 1], [1, 1]):
        with pytest.raises(ValueError, match="ascending rows"):
            native.gather(data, [np.array(wrong), inside])
    with pytest.raises(ValueError, match="the block must hold 16"):
        native.scatter(data, [inside, inside], np.zeros(15, np.float32))
    data.flags.writeable = False
    with pytest.raises(HmkctaError, match="not-in-place"):
        native.scatter(data, [inside, inside], np.zeros(16, np.float32))


def backend_of(choice: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from hmkcta import backends; print(backends.name)"]
    environment = os.environ | {"HMKCTA_BACKEND": choice, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_the_environment_chooses_the_backend() -> None:
    assert [backend_of(choice).stdout.strip() for choice in ("", "native", "reference")] == [
        "native",
        "native",
        "reference",
    ]
    assert "HMKCTA_BACKEND: found 'cuda', allowed native or reference" in backend_of("cuda").stderr
