"""Tensors that memory does not hold: what comes out is as good, whatever the threads, and leaves nothing behind."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from itertools import pairwise
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hmkcta import backends as kernels
from hmkcta import compress
from hmkcta.errors import HmkctaError
from hmkcta.fitting import workset
from hmkcta.fitting.fit import EFFORTS
from hmkcta.fitting.hierarchy import Run, backfit, descend, fit_nodes, whole
from hmkcta.fitting.projection import project_one
from hmkcta.fitting.search import project_model, right_sides
from hmkcta.fitting.workset import projected, sides
from hmkcta.measure import measure
from hmkcta.metrics import squared_norm
from hmkcta.plan import LevelSpec, parse_plan
from hmkcta.readers import open_array
from hmkcta.streaming import budget, streamed
from hmkcta.streaming.scratch import Scratch
from hmkcta.streaming.source import Source, prepare
from hmkcta.synthetic import volume
from streaming_tools import MODES, WH4_LIKE, fitted
from test_kernels import random_cells

F32 = NDArray[np.float32]

pytestmark = pytest.mark.usefixtures("small_slabs")


def set_cached(monkeypatch: pytest.MonkeyPatch, *, cached: bool) -> None:
    """Whether the source is taken to stay in the system's cache."""
    monkeypatch.setattr(streamed, "stays_cached", (1 << 62 if cached else -1).__ge__)


@pytest.fixture(params=["collected", "reordered"])
def pieces(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Pieces come from the source one by one where that stays in the system's cache, or are written in one pass."""
    set_cached(monkeypatch, cached=request.param == "collected")
    return request.param


@pytest.mark.usefixtures("pieces")
def test_streaming_is_as_good_as_memory(cloth: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The levels of the whole tensor are fitted otherwise, so bytes differ; nothing may be lost."""
    inside = fitted(cloth, monkeypatch, cloth.values.size)
    outside = fitted(cloth, monkeypatch, cloth.values.size // 3)
    assert outside.snr > inside.snr - 0.02
    assert outside.nbytes < 1.01 * inside.nbytes


@pytest.mark.usefixtures("pieces")
@pytest.mark.parametrize("share", [3, 40])
def test_threads_change_nothing(cloth: Any, monkeypatch: pytest.MonkeyPatch, share: int, tmp_path: Path) -> None:
    """Also where pieces themselves are too large for memory (a fortieth is less than the largest of 36)."""
    files: list[bytes] = []
    for threads in (1, 3):
        model = fitted(cloth, monkeypatch, cloth.values.size // share, threads=threads, plan=WH4_LIKE)
        model.save(tmp_path / f"{threads}.hmk")
        files.append((tmp_path / f"{threads}.hmk").read_bytes())
    assert files[0] == files[1]


@pytest.mark.usefixtures("pieces")
@pytest.mark.parametrize("plan", [WH4_LIKE, "R=2 C=2 K=2 / R=2 C=2 K=1 / R=1 C=1,1,2,2"])
@pytest.mark.parametrize("quality", ["fast", "medium"])
@pytest.mark.parametrize("transform", ["identity", "log1p"])
def test_what_is_stated_is_what_is_stored(
    cloth: Any, monkeypatch: pytest.MonkeyPatch, transform: str, quality: str, plan: str
) -> None:
    """What levels were seen to leave, and the streamed measurement after back-fitting, against the one that decodes."""
    model = fitted(cloth, monkeypatch, cloth.values.size // 3, plan=plan, transform=transform, quality=quality)
    decoded = measure(model, cloth.values)
    for stated, found in zip(model.quality, decoded, strict=True):
        assert stated.snr_db == pytest.approx(found.snr_db, abs=1e-3)
        assert stated.rmse == pytest.approx(found.rmse, rel=1e-3)
        assert stated.max_abs_error == pytest.approx(found.max_abs_error, rel=1e-3)


@pytest.mark.parametrize("plan", [WH4_LIKE, "R=2 C=2 K=1 / R=2 C=2 K=2 / R=1 C=1,1,2,2"])
@pytest.mark.parametrize("quality", ["fast", "medium"])
def test_pieces_are_written_only_if_somebody_reads_them(
    cloth: Any, monkeypatch: pytest.MonkeyPatch, pieces: str, quality: str, plan: str
) -> None:
    """A last level without back-fitting collects its pieces and is done with them; nobody measures it again."""
    made, stages = list[int](), set[str]()

    class Counted(Scratch):
        def __init__(self, count: int) -> None:
            super().__init__(count)
            made.append(count)

    def note(stage: str, _fraction: float) -> None:
        stages.add(stage)

    monkeypatch.setattr(streamed, "Scratch", Counted)
    fitted(cloth, monkeypatch, cloth.values.size // 3, plan=plan, quality=quality, progress=note)
    read_again = quality == "medium" or plan != WH4_LIKE
    assert made == ([cloth.values.size] if pieces == "reordered" or read_again else [])
    assert ("reordering" in stages) == (pieces == "reordered")
    assert ("measuring" in stages) == (quality == "medium")


@pytest.mark.usefixtures("pieces")
def test_back_fitting_lowers_the_error(cloth: Any) -> None:
    source = prepare(cloth.values, cloth.axes, "identity", None)
    plan = parse_plan(WH4_LIKE, source.organisation(MODES))
    run = Run(EFFORTS["fast"], 0, 2, lambda _stage, _fraction: None)
    tree = whole(streamed.Streamed(source, plan.organisation, 2, cloth.values.size // 3))
    for number, spec in enumerate(plan.levels):
        if number:
            descend(tree, "most", run, once=True)
        fit_nodes(tree, [spec] * len(tree.levels[-1]), run)
    errors = [tree.error]
    for _ in range(3):
        backfit(tree, run)
        errors.append(tree.error)
    assert all(after < before for before, after in pairwise(errors))
    assert errors[-1] < 0.95 * errors[0]
    # What is kept in pieces is what the nodes leave of the tensor.
    left = source.tensor(plan.organisation)
    for level in tree.levels:
        for node in level:
            if node.cells is not None:
                block = np.ascontiguousarray(left[np.ix_(*node.rows)])
                kernels.accumulate(node.cells, block, -1.0)
                left[np.ix_(*node.rows)] = block
    assert errors[-1] == pytest.approx(squared_norm(left), rel=1e-4)


@pytest.mark.usefixtures("pieces")
def test_a_streamed_fit_ends_at_the_level_that_reaches_its_snr(cloth: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    whole_plan = fitted(cloth, monkeypatch, cloth.values.size // 3)
    goal = (whole_plan.quality[0].snr_db + whole_plan.quality[1].snr_db) / 2
    model = fitted(cloth, monkeypatch, cloth.values.size // 3, snr=goal)
    assert len(model.quality) == 2
    assert model.snr >= goal
    assert model.snr == pytest.approx(measure(model, cloth.values)[-1].snr_db, abs=1e-3)


def test_a_streamed_volume_keeps_its_undecomposed_mode(monkeypatch: pytest.MonkeyPatch) -> None:
    data = volume((20, 24, 28), frames=6)
    plan = "R=*,2,2,2 / R=*,1,1,1 C=1,3,3,3 K=1,2,2,2 / R=*,1,1,1 C=1,2,2,2 K=1,2,2,2"
    inside, outside = (
        fitted(data, monkeypatch, data.values.size // share, plan, organisation=None) for share in (1, 3)
    )
    assert outside.snr > inside.snr - 0.3


MATRIX = "light+view+rgb, y+x"


@pytest.mark.parametrize(
    ("plan", "organisation"),
    [
        ("R=5,*", MATRIX),
        ("R=*,5", MATRIX),
        ("R=4,4,*", "light+rgb, view, y+x"),
        ("R=1,* C=3,1 / R=3,*", MATRIX),
        ("R=2,* / R=3,*", MATRIX),
    ],
)
def test_long_undecomposed_modes_are_fitted_on_a_part(
    cloth: Any, monkeypatch: pytest.MonkeyPatch, plan: str, organisation: str
) -> None:
    """Bases from every few rows of the mode, cores from all of them."""
    held: list[int] = []
    sample = streamed.Streamed.sample

    def noted(self: streamed.Streamed, steps: Sequence[int], without: int | None = None) -> F32:
        held.append((found := sample(self, steps, without)).size)
        return found

    monkeypatch.setattr(streamed.Streamed, "sample", noted)
    inside = fitted(cloth, monkeypatch, cloth.values.size, plan, organisation=organisation)
    assert not held
    outside = fitted(cloth, monkeypatch, cloth.values.size // 5, plan, organisation=organisation)
    assert held
    assert max(held) <= cloth.values.size // 5
    assert outside.snr > inside.snr - 0.3  # memberships are searched on the part, too: 0.25 dB


def test_what_memory_cannot_hold_is_refused_before_the_work(cloth: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Overlapping cells are fitted with all rows of an undecomposed mode."""
    plan, limit = "R=2,2,* C=2,2,1 K=2", budget.PROCESS + budget.WORKING * cloth.values.size // 2
    monkeypatch.setattr(budget, "SMALLEST", 1000)
    options: dict[str, Any] = {"organisation": "light+rgb, view, y+x", "max_memory": limit}
    with pytest.raises(HmkctaError, match=r"memory for level 1 .*raise --max-memory"):
        fitted(cloth, monkeypatch, cloth.values.size // 5, plan, **options)


def test_automatic_subdivision_of_a_streamed_tensor(cloth: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    schemes = {
        scheme: fitted(cloth, monkeypatch, cloth.values.size // 3, scheme=scheme).snr
        for scheme in ("auto", "most", "least", "uniform")
    }
    assert schemes["auto"] >= min(schemes["most"], schemes["uniform"])
    assert schemes["auto"] in [schemes[name] for name in ("most", "least", "uniform")]


def test_a_flat_level_of_many_cells_is_fitted_in_place(cloth: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the fast search there are only sweeps over a residual in memory."""
    flat = "R=1,1,2,2 C=2,2,3,3 K=2"
    inside = fitted(cloth, monkeypatch, cloth.values.size, flat, search="fast")
    outside = fitted(cloth, monkeypatch, cloth.values.size // 3, flat, search="fast")
    assert outside.snr == pytest.approx(inside.snr, abs=0.02)
    monkeypatch.setattr(budget, "FLAT", 50)
    with pytest.raises(HmkctaError, match="36 cells"):
        fitted(cloth, monkeypatch, cloth.values.size // 3, flat, search="fast",
               max_memory=budget.PROCESS + 2_100_000)


def test_many_cells_that_share_no_element_want_no_products_of_bases() -> None:
    """27,648 of them, of 149 GiB."""
    modes, sizes = (("light", "rgb"), ("view",), ("y",), ("x",)), (174, 58, 400, 380)
    flat, few = (parse_plan(f"R=2,2,3,3 C={clusters}", modes) for clusters in ("12,9,16,16", "4,3,4,4"))
    assert flat.levels[0].products_bytes > 100e9
    assert budget.memory_limit(flat, sizes, 10_000_000_000) == prod(sizes)
    assert budget.memory_limit(few, sizes, 1_000_000_000) < prod(sizes)


def test_cells_that_share_no_element_are_fitted_in_place(cloth: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    flat = "R=1,1,2,2 C=2,2,3,3"
    inside = fitted(cloth, monkeypatch, cloth.values.size, flat)
    monkeypatch.setattr(LevelSpec, "products_bytes", 10**12)
    outside = fitted(cloth, monkeypatch, cloth.values.size // 3, flat)
    assert outside.snr == pytest.approx(inside.snr, abs=0.02)


# The parts


@pytest.fixture(scope="module")
def source(cloth: Any) -> Source:
    """In Fortran order, so that the last axis is the slowest."""
    values = np.asfortranarray(cloth.values[:6, :5, :17, :13])
    return prepare(values, ["light", "view", "y", "x", "rgb"], "identity", None)


def test_sub_tensors_too_large_to_be_cut_are_refused_before_anything_is_fitted(
    cloth: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hmkcta.fitting.hmkcta.fit_nodes", None)
    with pytest.raises(HmkctaError, match="more clusters"):
        fitted(cloth, monkeypatch, cloth.values.size // 8, "R=1 C=1,1,1,2 K=1 / R=1 C=2 K=1 / R=1")


@pytest.mark.parametrize("steps", [(1, 1, 1, 1), (2, 1, 3, 1), (5, 2, 1, 4)])
@pytest.mark.parametrize("limit", [100, 700, 10**6])
def test_slabs_make_up_the_tensor(source: Source, steps: tuple[int, ...], limit: int) -> None:
    organisation = source.organisation(MODES)
    expected = source.tensor(organisation)[tuple(slice(None, None, step) for step in steps)]
    found = np.full(expected.shape, np.nan, np.float32)
    for part in source.parts(limit):
        rows, block = source.block(organisation, part, steps)
        if block.size:
            found[np.ix_(*rows)] = block
    assert np.array_equal(found, expected)


PAIRS = [
    ((9, 5, 8), LevelSpec((2, 2, 3), (2, 1, 3), (2, 1, 2)), LevelSpec((3, 2, 1), (3, 2, 2), (1, 2, 2))),
    ((4, 9, 8), LevelSpec((None, 2, 3), (1, 2, 3), (1, 2, 2)), LevelSpec((None, 3, 2), (1, 1, 1), (1, 1, 1))),
]


@pytest.mark.parametrize(("sizes", "spec", "other"), PAIRS)
def test_a_model_is_projected_in_closed_form(sizes: tuple[int, ...], spec: LevelSpec, other: LevelSpec) -> None:
    cells, model = random_cells(sizes, spec, 1), random_cells(sizes, other, 2)
    tensor = np.zeros(sizes, np.float32)
    kernels.accumulate(model, tensor, 1.0)
    for n in (n for n in range(3) if spec.ranks[n] is not None):
        expected = kernels.project_cells(cells, tensor, n)
        np.testing.assert_allclose(project_model(cells, model, n), expected, rtol=1e-3, atol=1e-3)


def test_a_part_of_cells_is_the_part_of_their_tensor() -> None:
    for sizes, spec, _ in PAIRS:
        cells, tensor = random_cells(sizes, spec, 3), np.zeros(sizes, np.float32)
        kernels.accumulate(cells, tensor, 1.0)
        rows = [np.array([0, 2, 3]), np.array([4]), np.arange(1, 7)]
        part = np.zeros((3, 1, 6), np.float32)
        kernels.accumulate(cells.part(rows), part, 1.0)
        np.testing.assert_allclose(part, tensor[np.ix_(*rows)], rtol=1e-5, atol=1e-5)


@pytest.mark.usefixtures("pieces")
def test_projections_are_summed_over_slabs_and_pieces(source: Source) -> None:
    organisation = source.organisation(MODES)
    tensor = source.tensor(organisation)
    spec = LevelSpec((2, 2, 2, 3), (2, 1, 3, 2), (2, 1, 2, 1))
    ones = (1, 1, 1, 1)
    cells, first = random_cells(tensor.shape, spec, 1), random_cells(tensor.shape, LevelSpec(ones, ones, ones), 5)
    residual = streamed.Streamed(source, organisation, 2, tensor.size // 3)
    residual.change(0, first)
    left = tensor.copy()
    kernels.accumulate(first, left, -1.0)
    expected = [kernels.project_cells(cells, left, n) for n in range(4)]
    for n in range(4):
        np.testing.assert_allclose(projected(residual, 1, cells, n), expected[n], rtol=1e-4, atol=1e-4)
        b = right_sides(cells, expected[n], n)
        np.testing.assert_allclose(sides(residual, 1, cells, n, [1] * 4), b, rtol=1e-4, atol=1e-4 * np.abs(b).max())
    parts: list[NDArray[np.intp]] = [np.arange(size) % 2 for size in tensor.shape]
    for piece in residual.cut(parts, (2, 2, 2, 2), once=True):
        with residual.holding(piece):
            held = residual.gather(piece.rows, piece, lent=False)
        np.testing.assert_allclose(held, left[np.ix_(*piece.rows)], atol=1e-5)
    residual.settle()
    assert residual.residual_norms[0].squares == pytest.approx(squared_norm(tensor), rel=1e-9)
    assert residual.residual_norms[1].largest == pytest.approx(np.abs(left).max(), rel=1e-5)
    for n in range(4):
        np.testing.assert_allclose(projected(residual, 1, cells, n), expected[n], rtol=1e-4, atol=1e-4)
        b = right_sides(cells, expected[n], n)
        np.testing.assert_allclose(sides(residual, 1, cells, n, [1] * 4), b, rtol=1e-4, atol=1e-4 * np.abs(b).max())
    assert residual.error == pytest.approx(squared_norm(left), rel=1e-5)


def test_projections_of_undecomposed_modes_stay_small(source: Source, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where they are summed up: of a slab they would be as many as it has elements, for every cell."""
    organisation, most = source.organisation(MODES), 500
    tensor = source.tensor(organisation)
    cells = random_cells(tensor.shape, LevelSpec((2, None, 2, None), (3, 1, 2, 1), (1, 1, 1, 1)), 1)
    sizes = list[int]()

    def watched(*given: Any) -> NDArray[np.float32]:
        made = project_one(*given)
        sizes.append(made.size)
        return made

    monkeypatch.setattr(workset, "PROJECTED", most)
    monkeypatch.setattr(workset, "project_one", watched)
    for n in (0, 2):
        b = right_sides(cells, kernels.project_cells(cells, tensor, n), n)
        found = sides(streamed.Streamed(source, organisation, 2, tensor.size // 3), 0, cells, n, [1] * 4)
        np.testing.assert_allclose(found, b, rtol=1e-4, atol=1e-4 * np.abs(b).max())
    assert len(sizes) > 4
    assert max(sizes) <= most


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("stage", ["level 2", "reordering", "level 3"])
def test_nothing_is_left_behind_by_an_interrupted_fit(
    cloth: Any, monkeypatch: pytest.MonkeyPatch, temporary: Path, stage: str
) -> None:
    before = len(os.listdir("/proc/self/fd")) if Path("/proc/self/fd").exists() else None
    set_cached(monkeypatch, cached=stage != "reordering")

    def interrupted(name: str, fraction: float) -> None:
        if name == stage and (fraction > 0 or stage == "reordering"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fitted(cloth, monkeypatch, cloth.values.size // 3, progress=interrupted)
    assert list(temporary.iterdir()) == []
    if before is not None:
        assert len(os.listdir("/proc/self/fd")) <= before


def test_a_mapped_file_is_read_in_slabs(cloth: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The same bytes as from memory."""
    np.save(tmp_path / "cloth.npy", cloth.values)
    mapped = open_array(tmp_path / "cloth.npy")
    assert isinstance(mapped, np.memmap)
    monkeypatch.setattr(budget, "WORKSET", mapped.size // 3)
    models = [
        compress(array, WH4_LIKE, axes=cloth.axes, organisation=MODES, scheme="most", quality="fast")
        for array in (cloth.values, mapped)
    ]
    for number, model in enumerate(models):
        model.save(tmp_path / f"{number}.hmk")
    assert (tmp_path / "0.hmk").read_bytes() == (tmp_path / "1.hmk").read_bytes()
