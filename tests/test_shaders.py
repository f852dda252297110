"""The decoder in WGSL gives what the NumPy decoder gives, on whatever adapter there is (lavapipe in CI)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from gpu_tools import KINDS, Kind, adapter, random_indices
from hmkcta import Model, compress, synthetic
from hmkcta.axes import axis_order
from hmkcta.errors import HmkctaError
from hmkcta.render.gpu_decode import GpuDecoder, ListPass, picked_words
from hmkcta.render.image import pack_image
from hmkcta.render.prelude import MOST_ROWS, Options, compose_picked
from hmkcta.render.software import MOST_TURNS, loop_turns
from hmkcta.render.tree import tree_of
from hmkcta.render.upload import DecoderBuffers
from hmkcta.render.weighted import Picks, decode_picked
from hmkcta.render.workload import Configuration
from hmkcta.render.workload import random_model as workload_model
from hmkcta.transform import Transform

#: Largest error over the largest value.
CLOSE = 1e-5


def error(found: NDArray[np.float32], expected: NDArray[np.float32]) -> float:
    """The largest error in units of the largest value."""
    assert found.shape == expected.shape
    assert np.abs(expected).max() > 0, "a test on zeros tests nothing"
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def random_picks(model: Model, counts: tuple[int, ...], sums: int, channel: int | None = None) -> list[Picks]:
    """Random weighted indices for each axis; the channel axis, if any, goes to red, green and blue."""
    rng = np.random.default_rng(5)
    picks: list[Picks] = [
        (rng.integers(size, size=(sums, k)), rng.uniform(-1, 1, (sums, k)).astype(np.float32))
        for size, k in zip(model.shape, counts, strict=True)]
    if channel is not None:
        picks[channel] = (np.tile(np.arange(3), (sums, 1)), np.tile(np.eye(3, dtype=np.float32), (sums, 1, 1)))
    return picks


def fitting(model: Model, wanted: int) -> tuple[int, ...]:
    """As many picks an axis as wanted; fewer where a merged mode has too many rows, or software too much to do."""
    metadata = model.metadata
    order = iter(axis_order(metadata.axes, metadata.organisation))
    counts = [1] * model.ndim
    for mode in metadata.organisation:
        room = MOST_ROWS
        for axis in [next(order) for _ in mode]:
            counts[axis] = min(wanted, room)
            room //= counts[axis]
    for axis in reversed(range(2, len(counts))):
        if loop_turns(model, counts, len(model.levels)) <= MOST_TURNS:
            break
        counts[axis] = 1
    return tuple(counts)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_elements_at_every_level(kind: Kind) -> None:
    model = kind.model()
    decoder = GpuDecoder(model, adapter())
    indices = random_indices(model, 2000)
    for level in range(1, len(model.levels) + 1):
        expected = model.at_level(level)[tuple(indices.T)]
        assert error(decoder.elements(indices, level), expected) <= CLOSE


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_weighted_sums_at_every_level(kind: Kind) -> None:
    model = kind.model(seed=2)
    decoder = GpuDecoder(model, adapter())
    picks = random_picks(model, fitting(model, 2), 300)
    for level in range(1, len(model.levels) + 1):
        assert error(decoder.picked(picks, level), decode_picked(model, picks, level)) <= CLOSE


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.sizes[4:5] == (3,)], ids=lambda kind: kind.name)
def test_colours_in_one_walk(kind: Kind) -> None:
    model = kind.model(seed=3)
    counts = tuple(3 if size >= 3 and axis in (0, 4) else 1 for axis, size in enumerate(kind.sizes))
    picks = random_picks(model, counts, 200, channel=4)
    found = GpuDecoder(model, adapter()).picked(picks)
    assert found.shape == (200, 3)
    assert error(found, decode_picked(model, picks)) <= CLOSE


#: Levels whose nodes share their ranks, which are decoded by functions of their own: ranks even and odd, several
#: cells and one, colours in a mode of several, cores and rows that are looped over and such that are not.
UNIFORM = {
    "deep": Configuration("deep", "svbrdf", (14, 9, 24, 20),
                          "R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2 / R=2,2,3,3 C=3,3,4,4 K=2", 0, 0),
    "flat": Configuration("flat", "svbrdf", (14, 9, 24, 20), "R=2,1,3,5 C=5,2,3,4 K=3,2,3,3", 0, 0),
    "wide": Configuration("wide", "svbrdf", (14, 9, 24, 20), "R=6,2,10,3 C=3,2,2,2 K=2", 0, 0),
    "odd": Configuration("odd", "svbrdf", (9, 9, 12, 12), "R=3,3,5,5 C=2,1,2,1 K=1 / R=1,3,1,3 C=1,2,1,2 K=1", 0, 0),
}


@pytest.mark.parametrize("name", UNIFORM)
def test_uniform_levels(name: str) -> None:
    model = workload_model(UNIFORM[name], seed=4)
    assert tree_of(model.metadata, model.stages).uniform == tuple(range(len(model.levels)))
    decoder = GpuDecoder(model, adapter())
    for counts, channel in (((3, 3, 3, 2, 2), 1), ((2, 2, 2, 2, 2), None), ((1, 1, 1, 1, 1), None)):
        picks = random_picks(model, counts, 150, channel)
        for level in range(1, len(model.levels) + 1):
            assert error(decoder.picked(picks, level), decode_picked(model, picks, level)) <= CLOSE


def test_uniform_levels_of_a_contracted_frame() -> None:
    plan = "R=3,2,2,* / R=2,2,1,* C=3,2,2,1 K=2,2,1,1 / R=1,2,2,* C=2,2,2,1 K=1"
    model = workload_model(Configuration("frame", "volume", (9, 8, 7, 5), plan, 0, 0), seed=2)
    buffers = DecoderBuffers(adapter(), model, Options((2, 2, 2, 2), contracted=(3,)))
    code = compose_picked(buffers.prelude(), "picked")
    assert "cells_2x2x1x5" in code
    decode = ListPass(adapter(), buffers, "decode_sums", code)
    picks = random_picks(model, (2, 2, 2, 2), 200)
    picks[3] = (np.tile([1, 4], (200, 1)), np.tile(np.array([0.25, 0.75], np.float32), (200, 1)))
    buffers.contract({3: ([1, 4], [0.25, 0.75])})
    for level in (1, 2, 3):
        found = decode.run(picked_words(picks, 2), buffers.bind_group(level))
        assert error(found, decode_picked(model, picks, level)) <= CLOSE


#: Organisations and plans of one cell, which has a decoder of its own; `*` is a mode left undecomposed.
SINGLE = (
    ("light+rgb, view, y, x", "R=7,4,5,6"), ("light+view+rgb, y+x", "R=12,9"), ("light, view+rgb, y+x", "R=*,8,6"),
    ("light+view, y, x+rgb", "R=9,*,5"), ("light, view, y, x, rgb", "R=4,3,4,3,*"), ("light+view, y+x+rgb", "R=5,*"),
)


@pytest.mark.parametrize(("organisation", "plan"), SINGLE)
@pytest.mark.parametrize("channels", [1, 3])
def test_models_of_one_cell(organisation: str, plan: str, channels: int) -> None:
    data = synthetic.material(lights=9, views=8, size=8)
    model = compress(data.values, plan, axes=data.axes, organisation=organisation, kind=data.kind)
    counts = (2, 3, 2, 1, 3) if channels == 3 else (2, 1, 2, 2, 2)
    picks = random_picks(model, counts, 150, 4 if channels == 3 else None)
    assert "fn decode_picked(" in DecoderBuffers(adapter(), model, Options(counts, channels)).prelude()
    assert error(GpuDecoder(model, adapter()).picked(picks), decode_picked(model, picks)) <= CLOSE


def test_channels_have_weights_of_their_own() -> None:
    model = next(kind for kind in KINDS if kind.name == "folded-colour").model()
    decoder = GpuDecoder(model, adapter())
    picks = random_picks(model, (1, 1, 1, 1, 3), 2, channel=4)
    for axis, weights in ((0, np.ones((2, 1, 3))), (4, np.ones((2, 3, 3)))):
        wrong = [*picks[:axis], (picks[axis][0], weights), *picks[axis + 1:]]
        with pytest.raises(HmkctaError) as caught:
            decoder.picked(wrong)
        assert caught.value.reason == "picks-colours"


def test_images_of_several_pages() -> None:
    model = KINDS[3].model()
    words = pack_image(model.stages).words.size
    shift = int(np.ceil(np.log2(words / 4)))
    decoder = GpuDecoder(model, adapter(), page_shift=shift)
    assert decoder.buffers.pages > 2
    indices = random_indices(model, 1000)
    assert error(decoder.elements(indices), model[tuple(indices.T)]) <= CLOSE


def test_all_elements() -> None:
    model = KINDS[2].model()
    assert error(GpuDecoder(model, adapter()).reconstruct(), model.reconstruct()) <= CLOSE


@pytest.mark.parametrize(
    "transform", ["log1p", "log1p:1e-30", "log1p:1e30", "asinh", "asinh:1e-30", "asinh:1e30", "sqrt"])
def test_values_beyond_float32_stay_finite(transform: str) -> None:
    values = np.linspace(0.1, 1.0, 12, dtype=np.float32).reshape(4, 3)
    model = compress(values, "R=2", transform=transform)
    model.levels[0].core_scale[:] *= 1e36 if transform == "sqrt" else 1000 / np.abs(model.levels[0].core_scale).max()
    found = GpuDecoder(model, adapter()).reconstruct()
    assert np.isfinite(found).all()
    assert found.max() > 3.39e38


@pytest.mark.parametrize(("name", "scale", "size"), [
    *[(name, 1.0, size) for name in ("log1p", "asinh", "sqrt") for size in (1e-12, 1e-6, 1.0, 1e10)],
    *[(name, *each) for name in ("log1p", "asinh") for each in ((1e-30, 1e-20), (1e-30, 1e7), (1e30, 1e20))],
])
def test_values_far_from_the_scale_keep_their_digits(name: str, scale: float, size: float) -> None:
    transform = Transform(name, scale)
    values = np.random.default_rng(1).random((6, 5, 4)) * size
    model = compress(values.astype(np.float32), "R=5,5,4", transform=str(transform))
    # A relative error of the decoded logarithm is an absolute one of what it is the logarithm of.
    largest = float(transform.forward(values).max())
    assert error(GpuDecoder(model, adapter()).reconstruct(), model.reconstruct()) <= CLOSE * max(1.0, largest)


@pytest.mark.parametrize(("indices", "reason"), [
    ([[0, 0, 7]], "index-out-of-range"), ([[-1, 0, 0]], "index-out-of-range"), ([[0, 0]], "coords-shape"),
    ([[0.5, 0, 0]], "index-type"),
])
def test_bad_indices_are_refused(indices: list[list[float]], reason: str) -> None:
    decoder = GpuDecoder(Kind("small", (3, 4, 5)).model(), adapter())
    with pytest.raises(HmkctaError) as caught:
        decoder.elements(np.array(indices))
    assert caught.value.reason == reason


def test_too_many_rows_are_refused() -> None:
    model = KINDS[9].model()
    picks = random_picks(model, (6, 1, 1, 1, 6), 1)
    with pytest.raises(HmkctaError) as caught:
        GpuDecoder(model, adapter()).picked(picks)
    assert caught.value.reason == "picks-too-many"
