"""Balanced k-means: the native kernel gives rows the labels of its twin, bit by bit, and these are as promised."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hmkcta import backends
from hmkcta.backends import native, reference
from hmkcta.backends.kmeans import most_rows
from hmkcta.errors import HmkctaError
from hmkcta.fitting import memberships
from hmkcta.fitting.memberships import balanced_clusters, uniform_blocks

F64 = NDArray[np.float64]
Rows = tuple[F64, int, float | None, int]

CAPS = [None, 1.0, 1.05, 1.2, 1.5]


@st.composite
def rows(draw: st.DrawFn) -> Rows:
    """Features of any shape with a number of clusters, a cap and a seed; equal rows, equal distances, zeros."""
    size, width = draw(st.integers(1, 90)), draw(st.integers(1, 15))
    clusters, cap, seed = draw(st.integers(1, 9)), draw(st.sampled_from(CAPS)), draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    features = rng.standard_normal((size, width))
    kind = draw(st.sampled_from(["generic", "rounded", "repeated", "zeros", "turned"]))
    if kind == "rounded":
        features = np.round(features)
    elif kind == "repeated":
        features = features[rng.integers(max(1, size // 4), size=size)]
    elif kind == "zeros":
        features[rng.random(size) < 0.6] = 0
    elif kind == "turned":
        features = np.asfortranarray(features)[:, ::-1]
    return features, clusters, cap, seed


def in_python(features: F64, centres: F64, cap: float | None, rounds: int) -> list[int]:
    """The same without arrays: in each round rows go one by one, those with the widest margins first."""
    centres, labels = centres.copy(), [0] * len(features)
    for _ in range(rounds):
        distance = np.array([[sum((row - centre) ** 2) for centre in centres] for row in features])
        margins = [0.0 if len(centres) == 1 else -np.subtract(*sorted(each)[:2]) for each in distance]
        room = [most_rows(len(features), len(centres), cap)] * len(centres)
        for i in sorted(range(len(features)), key=lambda i: -margins[i]):
            labels[i] = min((k for k in range(len(centres)) if room[k]), key=lambda k: distance[i, k])
            room[labels[i]] -= 1
        for k in set(labels):
            centres[k] = features[np.equal(labels, k)].mean(axis=0)
    return labels


@settings(max_examples=300, deadline=None)
@given(rows(), st.integers(1, 8))
def test_native_labels_are_those_of_the_twin(given_rows: Rows, rounds: int) -> None:
    features, clusters, cap, seed = given_rows
    centres = features[np.random.default_rng(seed + 1).integers(len(features), size=clusters)]
    found, cost = native.cluster_rows(features, centres, cap, rounds)
    expected, least = reference.cluster_rows(features, centres, cap, rounds)
    np.testing.assert_array_equal(found, expected, strict=True)
    assert cost == least
    assert np.bincount(found).max() <= most_rows(len(features), clusters, cap)


@settings(max_examples=300, deadline=None)
@given(rows())
def test_native_rows_go_where_the_twins_go(given_rows: Rows) -> None:
    features, _, cap, seed = given_rows
    distance = features.copy()
    distance[:, 2:][np.random.default_rng(seed).random(distance[:, 2:].shape) < 0.5] = np.inf
    labels = native.nearest_with_room(distance, cap)
    np.testing.assert_array_equal(labels, reference.nearest_with_room(distance, cap), strict=True)


@pytest.mark.parametrize("cap", CAPS)
def test_the_twin_does_as_it_says(cap: float | None) -> None:
    features = np.random.default_rng(0).standard_normal((31, 5))
    for clusters in (1, 2, 4):
        labels, cost = reference.cluster_rows(features, features[:clusters], cap, 6)
        assert labels.tolist() == in_python(features, features[:clusters], cap, 6)
        means = np.array([features[labels == k].mean(axis=0) for k in range(clusters)])
        assert cost == pytest.approx(float(np.square(features - means[labels]).sum()))


def test_more_rounds_never_cost_more() -> None:
    features = np.random.default_rng(1).standard_normal((3000, 12))
    costs = [native.cluster_rows(features, features[:20], None, rounds)[1] for rounds in (1, 2, 4, 8, 300, 301)]
    assert all(before >= after for before, after in pairwise(costs))
    assert costs[-2] == costs[-1]


def test_many_rows_get_the_same_labels_from_any_number_of_threads() -> None:
    features = np.random.default_rng(2).standard_normal((7003, 12))
    expected, cost = reference.cluster_rows(features, features[:30], 1.1, 3)
    for count in (1, 3):
        with backends.threads(count):
            labels, found = native.cluster_rows(features, features[:30], 1.1, 3)
        np.testing.assert_array_equal(labels, expected)
        assert found == cost


def test_what_has_no_room_or_other_features_is_refused() -> None:
    features = np.zeros((10, 3))
    with pytest.raises(ValueError, match="2 clusters of at most 4 rows have no room for 10"):
        native.cluster_rows(features, features[:2], 0.8, 1)
    with pytest.raises(ValueError, match="have no room for 10"):
        native.nearest_with_room(features, 0.8)
    with pytest.raises(HmkctaError, match=r"centres: found \(2, 2\), allowed \(C, 3\)"):
        native.cluster_rows(features, features[:2, :2], None, 1)


@settings(max_examples=100, deadline=None)
@given(rows())
def test_clusters_are_balanced_and_the_same_by_both_backends(given_rows: Rows) -> None:
    features, clusters, cap, seed = given_rows
    labels = balanced_clusters(features, clusters, cap, np.random.default_rng(seed))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(memberships, "kernels", reference)
        expected = balanced_clusters(features, clusters, cap, np.random.default_rng(seed))
    np.testing.assert_array_equal(labels, expected)
    if len(np.unique(features, axis=0)) < clusters and cap is None:
        np.testing.assert_array_equal(labels, uniform_blocks(len(features), clusters))
    assert np.bincount(labels).max() <= most_rows(len(features), clusters, cap)


def test_many_rows_are_parted_by_some_of_them() -> None:
    """Of 60,000 rows 32,768 are looked at; all go where these say."""
    rng, centres = np.random.default_rng(0), 10 * np.eye(4)
    own = rng.integers(4, size=60_000)
    labels = balanced_clusters(centres[own] + rng.standard_normal((60_000, 4)), 4, None, rng)
    assert len(labels) == 60_000
    pairs = np.unique(np.stack([own, labels]), axis=1)
    assert pairs.shape[1] == 4  # each centre has one label, and each label one centre
    assert len(set(pairs[1])) == 4


def test_of_many_rows_that_are_alike_the_clusters_are_blocks() -> None:
    labels = balanced_clusters(np.zeros((40_000, 2)), 3, None, np.random.default_rng(0))
    np.testing.assert_array_equal(labels, uniform_blocks(40_000, 3))
