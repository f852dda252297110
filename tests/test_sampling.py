"""What a plan is judged on: blocks that stand for all, and what their samples tell."""

from __future__ import annotations

from itertools import product
from math import prod

import numpy as np
import pytest

from hmkcta.choosing.blocks import parts_of, representatives, sampled_blocks
from hmkcta.choosing.candidates import Candidate, bytes_beside, clusters_of
from hmkcta.choosing.detail import Detail, detail_of
from hmkcta.choosing.organisations import organisations
from hmkcta.choosing.trial import trial_of
from hmkcta.streaming.source import prepare
from test_choosing import noise

#: Nothing happens anywhere.
DETAIL = Detail(np.zeros((2, 2)))


def test_few_busy_blocks_and_many_quiet_ones_are_both_represented() -> None:
    """Each stands for as many as its run has; where all are asked for, each for itself."""
    detail = np.concatenate([np.full(90, 1.0), np.full(10, 100.0)])
    places, weights = representatives(detail[::-1], 20)
    busy = places < 10
    assert weights.sum() == 100
    assert 4 <= busy.sum() <= 10
    assert weights[busy].sum() == pytest.approx(10, abs=3)
    assert len(set(places.tolist())) == len(places)
    assert representatives(detail, 100)[1].tolist() == [1.0] * 100


def test_detail_is_what_neighbours_differ_by() -> None:
    values = np.zeros((40, 60), np.float32)
    values[:20, :30] = noise(20, 30)
    source = prepare(values, None, "identity", None)
    found = detail_of(source, source.values()).of((2, 2))
    assert found[0, 0] > 0.9 * found.sum() > 0
    assert found.sum() == pytest.approx(detail_of(source, None).of((5, 3)).sum())
    assert detail_of(prepare(np.ones((9, 9)), None, "identity", None), None).of((3, 2)).tolist() == [[0.0] * 2] * 3


def test_a_small_sample_tells_what_is_reached_where_little_happens_almost_everywhere() -> None:
    """One part of sixteen is busy, and leaves nearly all of the error."""
    waves = np.cumsum(np.cumsum(noise(64, 128, 128), 1), 2) / 1000
    waves[:, :32, :32] += noise(64, 32, 32)
    source = prepare(waves + 4, None, "identity", None)
    trial = trial_of(source, 40_000, None, 4096, 0)
    modes = (("axis0",), ("axis1",), ("axis2",))
    judged = [max(worth for worth, _ in trial.worths(modes, (4, 8, 8), sample)) for sample in (1 << 16, 1 << 20)]
    assert judged[0] == pytest.approx(judged[1], abs=1.0)


def test_bytes_of_header_and_tables_are_a_candidates_own() -> None:
    """Digits that another of its kind has would depend on which of them a thread came to first."""
    source = prepare(noise(6, 40, 30, 3), None, "identity", None)
    grids = ((1, 1, 1, 1), (1, 4, 3, 1), (2, 8, 2, 1))
    asked = [
        Candidate(modes, grid, undecomposed, carried)
        for grid, modes, undecomposed, carried in product(grids, organisations(source.axes), ((), (0,)), (False, True))
        if (not carried or prod(grid) > 1) and not (undecomposed and clusters_of(source.axes, grid, modes)[0] > 1)
    ]
    first, second = (trial_of(source, 40_000, None, 4096, 0) for _ in range(2))
    forwards = [first.beside(each) for each in asked]
    assert [second.beside(each) for each in reversed(asked)] == forwards[::-1]
    assert forwards[-1] == bytes_beside(source, asked[-1], 0)


def test_a_sample_of_all_blocks_holds_every_element() -> None:
    """Blocks of 4 and 3 rows: all have 4, and the shorter ones share a row."""
    values = np.arange(10 * 9, dtype=np.float32).reshape(10, 9) + 1
    source = prepare(values, None, "identity", None)
    for held in (None, source.values()):
        blocks = sampled_blocks(source, held, DETAIL, (3, 2), values.size)
        assert (blocks.values.shape, blocks.weights.tolist(), blocks.thinned) == ((6, 4, 5), [1.0] * 6, False)
        assert set((blocks.values * source.unit).reshape(-1).tolist()) == set(values.reshape(-1).tolist())
    few = sampled_blocks(source, None, DETAIL, (1, 1), 20)
    assert few.thinned
    assert few.values.size <= 80
    eight = sampled_blocks(source, None, DETAIL, (5, 3), 24)
    assert len(eight.weights) == 8
    assert eight.weights.sum() == 15


def test_parts_of_a_block_hold_all_of_it() -> None:
    blocks = sampled_blocks(prepare(noise(12, 10), None, "identity", None), None, DETAIL, (2, 1), 120)
    parts = parts_of(blocks, (2, 1), (4, 3))
    assert parts.values.shape == (12, 3, 4)
    assert parts.edges == (3, 4)
    assert parts.overlap == 12 * 12 / 120
    assert set(parts.values.reshape(-1)) == set(blocks.values.reshape(-1))


@pytest.mark.parametrize("elements", [1 << 18, 1 << 17, 1 << 16])
def test_thinned_blocks_tell_what_whole_ones_reach(elements: int) -> None:
    """Four textures of noise under smooth lights: half the columns of a texture need half the ranks."""
    rng, place = np.random.default_rng(0), np.linspace(0, 1, 48)
    lights = np.exp(-np.array([1.0, 3.0, 9.0, 27.0])[:, None] * place)
    textures = rng.standard_normal((4, 64, 64, 3)) * np.array([1, 0.3, 0.1, 0.03])[:, None, None, None]
    source = prepare(np.einsum("kl,kyxc->lyxc", lights, textures).astype(np.float32), None, "identity", None)
    trial = trial_of(source, 20000, None, 4096, 0)
    modes = (("axis0",), ("axis1", "axis3"), ("axis2",))

    def judged(sample: int) -> dict[tuple[int, ...], float]:
        found = trial.worths(modes, (1, 1, 1, 1), sample, ((), (2,)))
        return {each.undecomposed: worth for worth, each in found}

    assert judged(elements) == pytest.approx(judged(prod(source.shape)), abs=1.0)
