"""The benchmarks count work as they say, and their tables and data are what they promise."""

from __future__ import annotations

import csv
from math import prod
from pathlib import Path

import numpy as np
import pytest
from benchmarks import compressing, data, decoding, kernels, work
from benchmarks.report import Limits, Row, markdown, write

from hmkcta.cells import Cells
from hmkcta.decode import decode_block, decode_elements
from hmkcta.plan import LevelSpec

LIMITS = Limits("a machine", {1: 1e9, 2: 2e9}, {1: 1e10, 2: 2e10})


def small_node() -> Cells:
    return kernels.random_node((3, 4, 5), LevelSpec((2, None, 3), (2, 1, 2), (2, 1, 1)))[0]


def test_work_of_mode_products_is_counted_by_definition() -> None:
    sizes, ranks, modes = (3, 4, 5), (2, 3, 4), [0, 1, 2]
    steps = [3 * 2 * 3 * 4, 3 * 4 * 3 * 4, 3 * 4 * 5 * 4]
    assert work.expansion(sizes, ranks, modes) == sum(steps)
    # Projection is the transpose: the same products the other way round.
    assert work.projection(sizes, ranks, modes[::-1]) == sum(steps)


def test_useful_work_counts_members_only() -> None:
    cells = small_node()
    visits = sum(prod(sizes) for sizes in work.blocks(cells))
    assert visits == 3 * 4 * 5 * 2
    last = 2 * visits * 3  # two flops for each of R_3 = 3 products of an element
    assert last < work.accumulate_flops(cells) < 2 * last
    assert work.sweep_flops(cells) > 2 * work.accumulate_flops(cells)
    assert work.project_flops(cells, 0) > 0


def test_the_balanced_model_is_the_paper_s() -> None:
    """As many numbers as the paper's table says, and of one mind with the decoders."""
    levels = decoding.balanced_model()
    assert sum(level.numbers() for level in levels) * 2 / 2**20 == pytest.approx(22.29, abs=0.01)
    coords = np.array([[0, 0, 0, 0], [173, 57, 399, 379]])
    rows = [np.unique(coords[:, n]) for n in range(4)]
    block = decode_block(levels, decoding.SIZES, rows)
    np.testing.assert_allclose(decode_elements(levels, decoding.SIZES, coords), [block[0, 0, 0, 0], block[1, 1, 1, 1]],
                               rtol=1e-4)


def test_tables_are_written(tmp_path: Path) -> None:
    kernel = Row("kernel", "a node", 2, 0.5, 0.8, 1e6, flops=4e9, moved=4e8)
    rows = [kernel, Row("fit", "data", 1, 2, 2, 1e6, snr=27.04)]
    path = write(rows, LIMITS, "some", tmp_path)
    assert path.read_text() == markdown(rows, LIMITS)
    assert "| kernel | a node | 2 | 0.5 | 0.8 | 2 | 50 % | 50 % |" in path.read_text()
    assert "read MiB" not in path.read_text(), "no row has it"
    with (tmp_path / "some.csv").open(newline="") as file:
        found = list(csv.DictReader(file))
    assert [row["what"] for row in found] == ["kernel", "fit"]
    assert float(found[1]["snr"]) == 27.04


def test_kernels_are_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels, "SECONDS", 0.0)
    monkeypatch.setitem(kernels.NODES, "tiny", ((5, 6, 7, 4), LevelSpec((2,) * 4, (2, 1, 2, 1), (1, 1, 2, 1))))
    rows = list(kernels.rows(["tiny"], [1]))
    assert [row.what for row in rows] == [
        "accumulate", *(f"project_cells, mode {n}" for n in (1, 2, 3, 4)), "project_pair, modes 1 and 2",
        "project_pair, modes 3 and 4", "fit_cells, a sweep"]  # fmt: skip
    assert all(row.rate > 0 and (row.of_sgemm(LIMITS) or 0) > 0 for row in rows)


def test_data_is_made_once_and_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(data.SHEET_VARIABLE, raising=False)
    volume, sheet = tmp_path / "volume.npy", tmp_path / "sheet.npy"
    data.turbulence(volume, (6, 8, 10), 3)
    assert data.sheet(sheet, 4, 5, None) == "synthetic sheet"
    assert np.load(sheet).shape == (58, 58, 4, 5, 3)
    frames = np.load(volume)
    assert frames.shape == (3, 6, 8, 10)
    assert np.isfinite(frames).all()
    assert (frames[0] != frames[2]).any()
    before = volume.stat().st_mtime_ns
    data.turbulence(volume, (6, 8, 10), 3)
    assert volume.stat().st_mtime_ns == before
    assert not list(tmp_path.glob("*.part"))


def test_a_fit_is_measured_in_a_process_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "volume.npy"
    data.turbulence(path, (6, 8, 10), 3)
    case = compressing.Case("fit", str(path), "R=*,2,2,2", compressing.VOLUME, backfits=0, threads=1)
    row = compressing.run(case, "a volume")
    assert row.elements == 3 * 6 * 8 * 10
    assert row.snr is not None
    assert row.snr > 0
    assert (row.memory or 0) > 2**20
    assert (row.size or 0) > 0
