"""What a plan is chosen by: energies of HOSVD cores, hulls of choices; and that threads do not change the choice."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dense_reference import energy, snr, tucker_product
from fit_tools import noise
from hmkcta import HmkctaError, choose_plan, compress, parse_plan
from hmkcta.axes import Organisation
from hmkcta.choosing.candidates import Candidate, Scored
from hmkcta.choosing.growth import growth_of
from hmkcta.choosing.judging import CARES, Judged, Search
from hmkcta.choosing.racing import racing_of
from hmkcta.choosing.spectra import cores
from hmkcta.choosing.trial import Trial, trial_of
from hmkcta.choosing.tuning import _near_best  # pyright: ignore[reportPrivateUsage]
from hmkcta.fitting.fit import EFFORTS
from hmkcta.fitting.tucker import core_energies, full_core
from hmkcta.grids import allowed, few_grids, single_grids, uncut_grids
from hmkcta.ranks.allocation import allocate, choices_of, merged, pareto, ration, spectrum
from hmkcta.streaming.source import prepare
from hmkcta.synthetic import light_field

SHAPES = [(5, 6, 7), (60, 3, 4), (3, 4, 60), (4, 9), (9, 4), (7,), (1, 5, 1), (3, 3, 3, 3)]


def leading(tensor: NDArray[np.float32], n: int, rank: int) -> NDArray[np.float64]:
    unfolded = np.moveaxis(tensor, n, 0).reshape(tensor.shape[n], -1).astype(np.float64)
    return np.linalg.svd(unfolded, full_matrices=False)[0][:, :rank].T


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_energies_are_those_of_truncated_cores(shape: tuple[int, ...]) -> None:
    """At every choice of ranks, each mode decomposed or left as it is."""
    tensor, rng = noise(*shape), np.random.default_rng(0)
    for undecomposed in product([False, True], repeat=len(shape)):
        limits = [None if skip else min(size, 4) for size, skip in zip(shape, undecomposed, strict=True)]
        table = core_energies(tensor, limits, rng)
        for choice in np.ndindex(table.shape):
            bases = [np.eye(shape[n]) if limits[n] is None else leading(tensor, n, r + 1) for n, r in enumerate(choice)]
            assert table[choice] == pytest.approx(energy(tucker_product(tensor.astype(np.float64), bases)), rel=1e-4)


def test_a_core_is_no_longer_than_its_unfoldings_have_columns() -> None:
    core, scale = full_core(noise(6, 50, 3), (6, 50, 3), np.random.default_rng(0))
    assert core.shape == (6, 18, 3)
    assert scale == pytest.approx(1, rel=1e-5)


def test_errors_of_long_nearly_constant_modes_are_told_at_60_db() -> None:
    """Sums of a thousand like terms in float32 drift by as much as they leave."""
    rng = np.random.default_rng(0)
    low = rng.standard_normal((1500, 3), np.float32) @ rng.standard_normal((3, 600), np.float32)
    tensor = 1 + np.float32(3e-4) * low
    squares = np.linalg.svd(tensor.astype(np.float64), compute_uv=False) ** 2
    found = np.diag(core_energies(tensor, (8, 8), np.random.default_rng(0)))
    np.testing.assert_allclose(1 - found / squares.sum(), 1 - np.cumsum(squares[:8]) / squares.sum(), atol=1e-7)


def test_of_long_modes_few_vectors_are_found() -> None:
    rng = np.random.default_rng(0)
    low = np.einsum("ar,br->ab", rng.standard_normal((900, 3)), rng.standard_normal((1000, 3))).astype(np.float32)
    assert full_core(low, (8, None), rng)[0].shape == (8, 1000)
    table = core_energies(low, (8, None), rng)
    assert table.shape == (8, 1)
    assert table[2, 0] == pytest.approx(energy(low), rel=1e-5)


def test_fewer_vectors_do_where_they_leave_next_to_nothing() -> None:
    rng = np.random.default_rng(0)
    low = (rng.standard_normal((900, 3)) @ rng.standard_normal((3, 1000))).astype(np.float32)
    matrix = (low + 0.01 * rng.standard_normal((900, 1000))).astype(np.float32)  # of which 90 is noise
    every = core_energies(matrix, (200, None), np.random.default_rng(0))
    few = core_energies(matrix, (200, None), np.random.default_rng(0), 100.0)
    assert (len(every), len(few)) == (200, 50)
    np.testing.assert_allclose(few[:3, 0], every[:3, 0], rtol=1e-6)
    assert energy(matrix) - few[-1, 0] <= 100
    assert len(core_energies(matrix, (200, None), np.random.default_rng(0), 10.0)) == 200


def test_a_spectrums_steps_are_the_corners_of_its_hull() -> None:
    table = core_energies(noise(8, 9, 10), (8, 9, 10), np.random.default_rng(0))
    found = spectrum(table, float(table[-1, -1, -1]), (8, 9, 10), [False] * 3, 4096)
    nbytes, error = found.nbytes[found.steps], found.error[found.steps]
    slopes = np.diff(error) / np.diff(nbytes)
    assert all(before < after for before, after in pairwise(slopes))
    assert 4 < len(found.steps) < len(found.nbytes)
    below = np.interp(found.nbytes, nbytes, error) - 1e-6 * found.error[0]
    assert (found.error >= below).all()  # no choice lies below the hull


def test_ways_keep_their_numbers_where_one_stores_nothing() -> None:
    own = spectrum(core_energies(noise(8, 9), (8, 9), np.random.default_rng(0)), 72.0, (8, 9), [False] * 2, 4096)
    second, third = (replace(own, way=np.full_like(own.way, way)) for way in (1, 2))
    assert [set(merged(ways).way) for ways in ([third], [second, third])] == [{2}, {1}]


def test_few_nodes_use_their_bytes() -> None:
    """Steps along the hulls of two nodes are large ones: what the last leaves goes to choices off the hulls."""
    nodes = [noise(8, 9, 10), 3 * noise(9, 8, 10)]
    spectra = [
        spectrum(core_energies(node, node.shape, np.random.default_rng(0)), energy(node), node.shape, [False] * 3, 4096)
        for node in nodes
    ]
    for nbytes in (600.0, 1000.0, 1500.0, 2200.0):
        chosen = allocate(spectra, nbytes=nbytes)
        assert 0.97 * nbytes < chosen.nbytes <= nbytes
        each = list(zip(spectra, chosen.choice, strict=True))
        assert chosen.nbytes == pytest.approx(sum(s.nbytes[c] for s, c in each))
        assert chosen.error == pytest.approx(sum(s.error[c] for s, c in each))


# Many blocks at once


@pytest.mark.parametrize(("share", "kind"), [(s, k) for s in (0.1, 0.3, 0.6) for k in ("limit", "error")])
def test_bytes_are_rationed_among_nodes_as_allocated(share: float, kind: str) -> None:
    """One multiplier for tables of many nodes chooses what steps along their hulls do."""
    nodes = [(1 + scale) * np.cumsum(noise(8, 9, 10 + scale)[:, :, :10], 1) for scale in range(30)]
    tables = [core_energies(node, node.shape, np.random.default_rng(0)) for node in nodes]
    whole = [energy(node) for node in nodes]
    spectra = [spectrum(t, e, (8, 9, 10), [False] * 3, 4096) for t, e in zip(tables, whole, strict=True)]
    steps = tuple(tuple(range(1, n + 1)) for n in (8, 9, 10))
    choices = choices_of(steps, (8, 9, 10), (False,) * 3, 4096, (1, 1, 1))
    left = [e - t.reshape(-1)[choices.entry] for t, e in zip(tables, whole, strict=True)]
    errors = np.array([[e, *np.maximum(own, 0)] for own, e in zip(left, whole, strict=True)])
    goal = share * (30 * choices.nbytes[-1] if kind == "limit" else sum(whole))
    nbytes, error = ration(errors, choices.nbytes, np.ones(30), **{kind: goal})
    other = allocate(spectra, **{"nbytes" if kind == "limit" else "error": goal})
    assert (nbytes if kind == "limit" else error) == pytest.approx(goal, rel=1e-6)
    assert nbytes == pytest.approx(other.nbytes, rel=0.02)
    assert error == pytest.approx(other.error, rel=0.02)


def test_the_best_of_one_node_are_those_that_no_other_beats() -> None:
    nbytes, error = np.array([0.0, 1, 2, 3, 4]), np.array([9.0, 5, 6, 5, 1])
    assert pareto(nbytes, error).tolist() == [0, 1, 4]


def test_a_node_that_stands_for_two_is_rationed_as_two() -> None:
    errors = np.array([[9.0, 4.0, 1.0], [5.0, 2.0, 0.0]])
    nbytes = np.array([0.0, 10.0, 20.0])
    twice = ration(errors, nbytes, np.array([2.0, 1.0]), limit=35)
    assert twice == ration(errors[[0, 0, 1]], nbytes, np.ones(3), limit=35)


# Blocks that may be cut further


def half_noise() -> NDArray[np.float32]:
    """Two blocks: one of rank four, one that is another thing of rank four in each half."""
    rng = np.random.default_rng(0)

    def of_rank_four(*shape: int) -> NDArray[np.float64]:
        return np.einsum("ra,rb,rc->abc", *(rng.standard_normal((4, size)) for size in shape))

    halves = [of_rank_four(20, 20, 12) for _ in range(2)]
    return np.concatenate([of_rank_four(20, 20, 24), np.concatenate(halves, axis=2)]).astype(np.float32)


def test_a_node_is_cut_where_that_pays() -> None:
    """One way for each node; what is stored decodes to what was fitted, in the bytes that were asked for."""
    values = half_noise()
    plan, size = "R=1 grid=axis0:2 / R<=8 cut<=axis2:2", 11500
    model = compress(values, plan, size=size, threads=1)
    assert model.levels[-1].shape[:, 0].tolist() == [[1, 1, 1], [1, 1, 2]]
    assert model.nbytes <= size
    assert snr(values, energy(values - np.asarray(model, np.float64))) == pytest.approx(model.snr, abs=1e-3)
    assert model.snr > compress(values, "R=1 grid=axis0:2 / R<=8", size=size, threads=1).snr + 3
    whole = compress(values, plan, snr=40.0, threads=1)
    assert whole.snr >= 40


def test_cuts_are_written_and_read_back() -> None:
    modes = (("y",), ("x", "rgb"))
    plan = parse_plan("R=1 grid=y:2 / R<=8 cut<=y:2,x:6", modes)
    assert parse_plan(str(plan), modes) == plan
    assert [way.clusters for way in plan.levels[1].ways(modes)] == [(y, x) for y in (1, 2) for x in (1, 2, 3, 6)]


@pytest.mark.parametrize(
    ("plan", "reason"),
    [
        ("R=4 cut<=axis1:2", "plan-syntax"),
        ("R<=4 grid=axis1:2 cut<=axis1:2", "plan-syntax"),
        ("R<=4 cut<=axis1:0", "clusters-too-small"),
        ("R<=4 cut<=axis7:2", "plan-grid"),
        ("R<=4 cut<=axis1:840,axis2:840", "plan-grid"),
        ("R<=4,*,4 cut<=axis1:2", "undecomposed-clustered"),
    ],
)
def test_cuts_that_make_no_sense_are_refused(plan: str, reason: str) -> None:
    with pytest.raises(HmkctaError) as caught:
        compress(noise(6, 7, 8), plan, size=9000)
    assert caught.value.reason == reason


def test_judging_cuts_takes_the_best_way_of_each_block() -> None:
    source = prepare(half_noise(), None, "identity", None)
    trial = trial_of(source, 11500, None, 4096, 0)
    whole = Candidate((("axis0",), ("axis1",), ("axis2",)), (2, 1, 1), cuts=(1, 1, 1))
    worths = [trial.worth(replace(whole, cuts=cuts), 1 << 20, (2, 1, 1)) for cuts in ((1, 1, 1), (1, 1, 2), (1, 2, 2))]
    assert worths[1] > worths[0] + 3
    assert worths[2] >= worths[1] - 1e-6


@pytest.mark.parametrize(("snr", "size"), [(30.0, None), (None, 20000), (None, None)])
def test_a_choice_does_not_depend_on_threads(snr: float | None, size: int | None) -> None:
    data = light_field(views=3, size=32, frames=3)
    plans = [choose_plan(data.values, axes=data.axes, threads=threads, snr=snr, size=size) for threads in (1, 3)]
    assert plans[0] == plans[1]


def judged(monkeypatch: pytest.MonkeyPatch, array: NDArray[np.floating], **goal: float) -> list[tuple[Any, ...]]:
    """What was judged to choose a plan for the array: organisations, grids and samples."""
    seen: list[tuple[Any, ...]] = []
    worths = Trial.worths

    def counted(trial: Trial, *what: Any) -> Any:
        seen.append(what)
        return worths(trial, *what)

    monkeypatch.setattr(Trial, "worths", counted)
    choose_plan(array, bits=16, **goal)  # pyright: ignore[reportArgumentType]
    return seen


def test_many_axes_are_merged_step_by_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight axes have 4139 organisations."""
    array = np.random.default_rng(0).random((2, 3, 2, 3, 2, 3, 2, 3))
    organisations = {what[0] for what in judged(monkeypatch, array)}
    assert 100 < len(organisations) < 400
    assert {len(modes) for modes in organisations} == set(range(2, 9))
    assert {len(modes) for modes in {what[0] for what in judged(monkeypatch, array[0, 0, 0])}} == set(range(2, 6))


def test_axes_of_size_one_ride_along(monkeypatch: pytest.MonkeyPatch) -> None:
    array = np.random.default_rng(0).random((1, 4, 3, 1, 3, 2, 3, 2))
    for modes, *_ in judged(monkeypatch, array):
        assert {"axis0", "axis3"} <= set(modes[0])
        assert sorted(name for mode in modes for name in mode) == [f"axis{n}" for n in range(8)]


def test_grids_to_begin_with() -> None:
    """All axes that are not short are cut in one of them: time as well."""
    assert few_grids((48, 180, 320, 3)) == [(1, 1, 1, 1), (1, 3, 5, 1), (1, 6, 10, 1), (3, 11, 20, 1)]
    assert few_grids((9, 9)) == [(1, 1)]
    assert uncut_grids((48, 180, 320, 3)) == [
        (1, 1, 20, 1), (1, 11, 1, 1), (1, 11, 20, 1), (3, 1, 1, 1), (3, 1, 20, 1), (3, 11, 1, 1)]
    assert uncut_grids((9, 9)) == uncut_grids((9, 900)) == []
    assert allowed(2, 0, (1, 2, 2, 1), (72, 160, 160, 3))
    assert not allowed(19, 0, (1, 1, 1, 1), (72, 160, 160, 3))


def test_blocks_that_are_long_along_an_axis_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    array = np.random.default_rng(0).random((40, 48, 64))
    seen = {grid for modes, grid, *_ in judged(monkeypatch, array) if len(modes) == 3}
    assert seen >= set(uncut_grids(array.shape)) == {(1, 1, 4), (1, 3, 1), (1, 3, 4), (2, 1, 1), (2, 1, 4), (2, 3, 1)}


def test_what_cannot_be_cut_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """A vector; blocks of two or three rows, of which each needs a vector as long as itself."""
    assert len(judged(monkeypatch, np.random.default_rng(0).random(5000))) == 1
    for shape in [(2, 5000), (5000, 3)]:
        assert {what[1] for what in judged(monkeypatch, np.random.default_rng(0).random(shape))} == {(1, 1)}


@pytest.mark.parametrize("transform", ["identity", "log1p:2", "asinh:0.5", "sqrt"])
def test_a_goal_in_db_is_that_of_the_source_not_of_transformed_values(transform: str) -> None:
    """Noise of the squared error that a trial allows transformed values leaves the source's values that many dB."""
    rng = np.random.default_rng(0)
    values = 90 + 40 * rng.random((20, 30, 40))
    source = prepare(values, None, transform, None)
    trial = trial_of(source, None, 30.0, 4096, 0)
    assert trial.ceiling is not None
    allowed = 10 ** (-trial.ceiling / 10) * energy(source.values())
    noise = rng.standard_normal(values.shape) * np.sqrt(allowed / values.size)
    noisy = source.value_transform.inverse(source.unit * (source.values() + noise))
    assert snr(values, energy(values - noisy)) == pytest.approx(30.0, abs=0.3)


def test_rows_left_out_of_a_sample_do_not_flatter_ranks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six textures of noise: thinned, as many ranks as rows seem to be enough; the plan is to reach the goal itself."""
    rng, place = np.random.default_rng(0), np.linspace(0, 1, 20)
    weights = np.stack([np.cos(3 * k * place[:, None] + 2 * k * k * place) for k in range(1, 7)])
    values = np.einsum("klv,kyx->lvyx", weights, rng.standard_normal((6, 40, 40))).astype(np.float32)
    few = replace(CARES[EFFORTS["medium"]], survey=1 << 13, compare=(1 << 14,), refine=1 << 16)
    monkeypatch.setitem(CARES, EFFORTS["medium"], few)
    assert compress(values, snr=45.0).snr >= 45


def test_ranks_grow_with_the_rows_of_noise_and_not_with_those_of_waves() -> None:
    def grown(rows: NDArray[np.float64]) -> tuple[int, ...]:
        batch = rows[None, ::2].astype(np.float32)
        growth = growth_of(batch, cores(batch, (32, 32)), batch[:, ::2], (64, 400))
        return growth.unthinned([(1, 4, 8, 16, 32), (1,)])[0]

    place = np.linspace(0, 1, 64)[:, None]
    assert grown(np.sin(12 * place * np.linspace(0, 1, 400)))[:2] == (1, 4)
    assert grown(noise(64, 400).astype(np.float64)) == pytest.approx((2, 8, 16, 32, 64), rel=0.15, abs=1)


def test_modes_that_are_far_worse_undecomposed_are_not_tried_so_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A texture is many times as large with all its rows as with its two ranks."""
    lights, rows, columns = (np.linspace(0, 1, size) for size in (24, 120, 140))
    waves = [np.multiply.outer(np.cos(k * lights), np.multiply.outer(np.sin(3 * k * rows), columns**k)) for k in (1, 2)]
    plain = (("axis0",), ("axis1",), ("axis2",))
    seen = [what for what in judged(monkeypatch, waves[0] + waves[1]) if what[0] == plain]
    compared = [what[3] for what in seen if what[2] == CARES[EFFORTS["medium"]].compare[0]]
    assert seen[0][3] == ()
    assert compared
    assert all(kinds and set(kinds) < {(), (0,), (1,), (2,)} for kinds in compared)


def low_matrix() -> tuple[NDArray[np.float64], Organisation, Organisation]:
    """A matrix of rank two of four axes, two of them merged into each mode; and those modes, and a mode for each axis.

    Of it four modes tell little.
    """
    rng = np.random.default_rng(0)
    low = rng.standard_normal((576, 2)) @ rng.standard_normal((2, 576))
    merged, plain = (("axis0", "axis2"), ("axis1", "axis3")), tuple((f"axis{n}",) for n in range(4))
    return low.reshape(24, 24, 24, 24).transpose(0, 2, 1, 3), merged, plain


def test_what_lies_far_behind_on_small_samples_is_not_looked_at_on_large_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    array, merged, plain = low_matrix()
    care = replace(CARES[EFFORTS["medium"]], compare=(1 << 16,))
    monkeypatch.setitem(CARES, EFFORTS["medium"], care)
    seen = judged(monkeypatch, array)
    assert {merged, plain} <= {what[0] for what in seen if what[2] == care.survey}
    last = {what[0] for what in seen if what[2] == array.size}
    assert merged in last
    assert plain not in last


@pytest.mark.parametrize(("goal", "doubted"), [({"size": 20_000}, False), ({"snr": 50.0}, True)], ids=str)
def test_only_a_race_for_an_snr_lets_grids_far_behind_change(
    monkeypatch: pytest.MonkeyPatch, goal: dict[str, float], doubted: bool
) -> None:
    """The bytes that it judges by come from a survey; and in every race few grids of unmerged modes are tried again."""
    array, _, plain = low_matrix()
    samples = 1 << 16, 1 << 17
    monkeypatch.setitem(CARES, EFFORTS["medium"], replace(CARES[EFFORTS["medium"]], compare=samples))
    seen, few = judged(monkeypatch, array, **goal), set(few_grids(array.shape))
    begun = few | set(uncut_grids(array.shape)) | set(single_grids(array.shape))
    first, second = ({what[1] for what in seen if (what[0], what[2]) == (plain, sample)} for sample in samples)
    assert first >= begun
    assert (first > begun) == doubted
    assert second >= few


def test_a_race_begins_with_modes_undecomposed_in_other_ways() -> None:
    """A grid that suits all modes decomposed would be lost where another kind is the best with every grid it has."""
    plain, grids = (("axis0",), ("axis1",), ("axis2",)), [(1, 1, 1), (1, 2, 2)]
    trial = trial_of(prepare(noise(8, 24, 24), None, "identity", None), 4000, None, 4096, 0)
    search = Search(trial, trial, plain, 1, CARES[EFFORTS["medium"]], 1 << 20, 0)
    kinds = [Candidate(plain, grid, undecomposed) for grid, undecomposed in product(grids, [(0,), (), (1,)])]
    for number, grid in enumerate(grids):
        worths = 30.0 - number, 29.2 + number / 2, 28.9
        found = [Scored(worth, kinds[3 * number + n]) for n, worth in enumerate(worths)]
        search.seen[Judged(plain, grid, 4608, 4000)] = found
    racing = racing_of(search.every(list(product([plain], grids)), 4608))
    assert [(worth, each.grid, each.undecomposed) for worth, each in racing] == [
        (30.0, (1, 1, 1), (0,)),
        (29.7, (1, 2, 2), ()),
    ]


@pytest.mark.parametrize(("effort", "size", "behind", "found"), [
    ("medium", 4000, 0.4, [(1, 2, 2), (1, 3, 2)]),
    ("medium", 4000, 1.6, [(1, 2, 2)]),
    ("medium", 300, 1.4, [(1, 2, 2), (1, 3, 4), (1, 3, 2)]),
    ("fast", 4000, 0.4, []),
])
def test_what_is_judged_next_to_the_best_is_fitted_too(
    effort: str, size: int, behind: float, found: list[tuple[int, ...]]
) -> None:
    """Of what was judged on the largest sample, with the cuts of the best left out; the more, the fewer the bytes."""
    plain = (("axis0",), ("axis1",), ("axis2",))
    trial = trial_of(prepare(noise(8, 24, 24), None, "identity", None), size, None, 4096, 0)
    search = Search(trial, trial, plain, 1, CARES[EFFORTS[effort]], 1 << 20, 0, settled=size)
    judged = {(1, 1, 1): 30.0, (1, 2, 2): 29.9, (1, 3, 2): 30.0 - behind, (1, 3, 3): 28.0}
    if size < 4000:
        judged[1, 3, 4] = 29.0
    for grid, worth in judged.items():
        alike = Scored(worth - 0.1, Candidate(plain, grid, (0,)))
        search.seen[Judged(plain, grid, 4608, size)] = [Scored(worth, Candidate(plain, grid)), alike]
    search.seen[Judged(plain, (1, 4, 4), 1000, size)] = [Scored(35.0, Candidate(plain, (1, 4, 4)))]
    best = Candidate(plain, (1, 1, 1), cuts=(1, 1, 2))
    assert [each.grid for each in _near_best(search, best)] == found
