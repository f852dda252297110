"""K-subspaces: rows that lie in a few subspaces are told apart whatever their sign, and fits start from that."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hmkcta import compress
from hmkcta.fitting.memberships import start_candidates
from hmkcta.fitting.subspaces import ROWS, subspace_clusters
from hmkcta.plan import parse_level

F32 = NDArray[np.float32]


def united(clusters: int, dimension: int, rows: int = 2000, columns: int = 256, *, signs: bool = False) -> F32:
    """Rows drawn from so many random subspaces, or plus or minus a row of each, with a little noise."""
    rng = np.random.default_rng(0)
    bases, of = rng.standard_normal((clusters, dimension, columns)), rng.integers(clusters, size=rows)
    places = rng.choice([-1.0, 1.0], (rows, dimension)) if signs else rng.standard_normal((rows, dimension))
    values: NDArray[np.float64] = np.einsum("nd,ndk->nk", places, bases[of])
    return (values + 0.02 * rng.standard_normal(values.shape)).astype(np.float32)


@pytest.mark.parametrize(
    ("clusters", "dimension", "signs", "plan", "least"),
    [
        (8, 3, False, "R=3,* C=8,1", 38),
        (8, 1, True, "R=1,* C=8,1", 33),
        (40, 2, False, "R=2,* C=40,1", 36),
        (8, 3, False, "R=3,* C=8,1 K=2,1", 38),
    ],
)
def test_rows_of_a_few_subspaces_are_parted_by_them(
    clusters: int, dimension: int, signs: bool, plan: str, least: float
) -> None:
    """By rows of like values alone, 3 to 12 dB."""
    assert compress(united(clusters, dimension, signs=signs), plan, threads=1).snr > least


def test_columns_and_lone_modes_of_many_are_parted_too() -> None:
    rows = united(8, 3)
    assert compress(np.ascontiguousarray(rows.T), "R=*,3 C=1,8", threads=1).snr > 38
    assert compress(rows.reshape(2000, 16, 16), "R=3,*,16 C=8,1,1", threads=1).snr > 38


def test_rows_beyond_the_sample_are_assigned_as_well() -> None:
    rows = united(6, 2, rows=2 * ROWS + 5, columns=60)
    labels = subspace_clusters(rows, 6, 2, np.random.default_rng(1))
    parts = [rows[labels == c].astype(np.float64) for c in range(6)]
    left = sum(float(np.linalg.eigvalsh(part.T @ part)[:-2].sum()) for part in parts)
    assert left < 1e-3 * float(np.square(rows, dtype=np.float64).sum())


@pytest.mark.parametrize("rows", [np.zeros((9, 5), np.float32), np.full((9, 5), 1e30, np.float32)])
def test_every_cluster_has_a_row(rows: F32) -> None:
    """Where all rows are alike, too."""
    labels = subspace_clusters(rows, 4, 2, np.random.default_rng(0))
    assert np.bincount(labels, minlength=4).all()


def test_other_candidates_stay_as_they_are_where_several_modes_have_clusters() -> None:
    """K-subspaces come last, of one mode alone, and not where a single start is asked for."""
    rows = united(4, 2, rows=120, columns=40)

    def found(level: str, count: int) -> list[list[list[int]]]:
        spec = parse_level(level, (("a",), ("b",)))
        starts = start_candidates(rows, spec, count, np.random.default_rng(0))
        return [[part.tolist() for part in labels] for labels in starts]

    assert [len(found(level, 3)) for level in ("R=2 C=4,1", "R=2 C=4,2")] == [4, 3]
    assert len(found("R=2 C=4,1", 1)) == 1
    assert found("R=2 C=4,1", 3)[:3] == found("R=39,40 C=4,1", 3)[:3]


def test_few_rows_have_subspaces_of_no_more_dimensions() -> None:
    """Than the rows span: of six long ones any six, where more were asked for."""
    rows = np.random.default_rng(0).standard_normal((6, 500)).astype(np.float32)
    labels = subspace_clusters(rows, 3, 8, np.random.default_rng(0))
    assert sorted(set(labels.tolist())) == [0, 1, 2]
