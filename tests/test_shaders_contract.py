"""Modes contracted once a frame: the weighted decoder gives the same values, on an adapter and in Tint."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from gpu_tools import KINDS, Kind, adapter, job, run_in_dawn
from hmkcta import Model
from hmkcta.render.device import spread
from hmkcta.render.frame_contraction import (
    FrameContraction,
    contractable,
    contraction_constants,
    contraction_shader,
    core_starts,
    fixed_rows,
    parent_table,
)
from hmkcta.render.gpu_decode import ListPass, picked_words
from hmkcta.render.image import pack_image
from hmkcta.render.prelude import Options, compose_picked, decoder_uniform, prelude
from hmkcta.render.tree import tree_of
from hmkcta.render.upload import DecoderBuffers
from hmkcta.render.weighted import Picks, decode_picked
from test_shaders import CLOSE, fitting

SUMS = 150


def interpolation(model: Model, still: tuple[int, ...]) -> list[Picks]:
    """Random indices of each axis with weights that add up to one, the same for all sums in axes that stand still."""
    rng = np.random.default_rng(8)
    picks: list[Picks] = []
    for axis, (size, k) in enumerate(zip(model.shape, fitting(model, 2), strict=True)):
        index = rng.integers(size, size=(SUMS, k))
        weight = rng.dirichlet(np.ones(k), SUMS).astype(np.float32)
        first = [0] * SUMS if axis in still else slice(None)
        picks.append((index[first], weight[first]))
    return picks


def standing(kind: Kind) -> list[tuple[int, ...]]:
    """Axes to stand still: each, some pairs, all."""
    axes = range(len(kind.sizes))
    return [*combinations(axes, 1), *list(combinations(axes, 2))[:4], tuple(axes)]


def fixed(picks: list[Picks], still: tuple[int, ...]) -> dict[int, tuple[list[int], list[float]]]:
    """The picks of the axes that stand still."""
    return {axis: (picks[axis][0][0].tolist(), picks[axis][1][0].tolist()) for axis in still}


def close(found: NDArray[np.float32], model: Model, picks: list[Picks], level: int) -> bool:
    """Whether sums are right, in units of the largest element."""
    largest = float(np.abs(model.at_level(level).reconstruct()).max())
    return bool(np.abs(found - decode_picked(model, picks, level)).max() <= CLOSE * largest)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_contracted_modes_change_nothing(kind: Kind) -> None:
    model, tried = kind.model(seed=2), 0
    for still in standing(kind):
        modes = contractable(model, still)
        if not modes:
            continue
        tried += 1
        picks = interpolation(model, still)
        buffers = DecoderBuffers(adapter(), model, Options(fitting(model, 2), contracted=modes))
        buffers.contract(fixed(picks, still))
        code = compose_picked(buffers.prelude(), "picked")
        decode = ListPass(adapter(), buffers, "decode_sums", code)
        for level in (1, len(model.levels)):
            assert close(decode.run(picked_words(picks, 2), buffers.bind_group(level)), model, picks, level)
    assert tried


def test_a_frame_can_be_contracted_again() -> None:
    kind = next(kind for kind in KINDS if kind.name == "time-undecomposed")
    model, time = kind.model(), 5
    counts = (1, 1, 1, 1, 1, 2)
    buffers = DecoderBuffers(adapter(), model, Options(counts, contracted=contractable(model, [time])))
    decode = ListPass(adapter(), buffers, "decode_sums",
                      compose_picked(buffers.prelude(), "picked"))
    rng = np.random.default_rng(3)
    where = [rng.integers(size, size=(SUMS, 1)) for size in model.shape]
    for frames, weights in (([0, 1], [0.25, 0.75]), ([5, 6], [1.0, 0.0])):
        buffers.contract({time: (frames, weights)})
        picks: list[Picks] = [(index, np.ones((SUMS, 1), np.float32)) for index in where]
        picks[time] = (np.tile(frames, (SUMS, 1)), np.tile(np.array(weights, np.float32), (SUMS, 1)))
        assert close(decode.run(picked_words(picks, 2), buffers.bind_group()), model, picks, 3)


@pytest.mark.parametrize("name", ["folded-colour", "merged-angles"])
def test_colours_are_contracted_for_several_sets(name: str) -> None:
    """A set of cores for each of two lights, of which all numbers are colours where their mode is contracted."""
    model = next(kind for kind in KINDS if kind.name == name).model(seed=3)
    still = (0, 4) if name == "folded-colour" else (4,)
    counts = (2 if 0 in still else 1, 1, 2, 1, 3)
    buffers = DecoderBuffers(adapter(), model, Options(counts, 3, contractable(model, still, 6)))
    assert buffers.options.contracted
    rng = np.random.default_rng(6)
    moving = [rng.integers(size, size=(SUMS, k)) for size, k in zip(model.shape, counts, strict=True)]
    moving[4] = np.tile([2, 0, 1], (SUMS, 1))
    lights = [((1, 3), (0.25, 0.75)), ((4, 0), (0.5, 0.5))]
    buffers.contract(*({0: light, 4: ((2, 0, 1), (1.0, 1.0, 1.0))} for light in lights))
    head = buffers.prelude()
    largest = float(np.abs(model.reconstruct()).max())
    for number, (index, weight) in enumerate(lights):
        set_chosen = f"  frame_first = {number * buffers.stride}u;\n  let value = vec3f("
        code = compose_picked(head, "picked").replace("  let value = vec3f(", set_chosen)
        picks: list[Picks] = [(each, np.ones(each.shape, np.float32) / each.shape[1]) for each in moving]
        if 0 in still:
            picks[0] = np.tile(index, (SUMS, 1)), np.tile(np.array(weight, np.float32), (SUMS, 1))
        picks[4] = moving[4], np.tile(np.eye(3, dtype=np.float32), (SUMS, 1, 1))
        decode = ListPass(adapter(), buffers, "decode_sums", code)
        found = decode.run(picked_words(picks, 3), buffers.bind_group(), 3).reshape(-1, 3)
        assert np.abs(found - decode_picked(model, picks)).max() <= CLOSE * largest


def test_only_modes_that_stand_still_altogether_are_contracted() -> None:
    model = next(kind for kind in KINDS if kind.name == "merged-texels").model()  # light+rgb, view, y+x
    assert contractable(model, [0]) == ()
    assert contractable(model, [0, 1, 4]) == (0, 1)
    assert contractable(model, [2, 3]) == (2,)


@pytest.mark.parametrize("name", ["order-4", "blocks-of-blocks"])
def test_tint_contracts_the_same(tmp_path: Path, name: str) -> None:
    kind = next(kind for kind in KINDS if kind.name == name)
    model, still = kind.model(seed=2), (1, 2)
    metadata, picks = model.metadata, interpolation(model, still)
    tree = replace(tree_of(metadata, model.stages), uniform=())
    options = Options(fitting(model, 2), contracted=contractable(model, still))
    image = pack_image(model.stages)
    group = [("uniform", decoder_uniform(metadata, len(model.levels))), ("read-only-storage", image.words.tobytes())]
    constants = contraction_constants(tree, model.stages, image, options)
    starts = core_starts(model.stages, options.contracted)
    device = adapter()
    whole = DecoderBuffers(device, model, replace(options, contracted=()))
    contraction = FrameContraction(device, model, image, options, whole.layout, whole.pages)
    contraction.reserve(1)
    contraction.run(whole.bind_group(), [fixed(picks, still)])
    expected = device.read(contraction.cores)
    fold = [("read-only-storage", fixed_rows(metadata, options.contracted, fixed(picks, still)).tobytes()),
            ("read-only-storage", parent_table(model.stages).tobytes()),
            ("storage", starts.tobytes() + bytes(expected.nbytes - starts.nbytes))]
    counts = spread(-(-constants["CELLS"] * constants["LANES"] // 64))
    code = contraction_shader(prelude(tree, 1), constants)
    found = run_in_dawn([job(code, "contract_frame", [group, fold], counts)], tmp_path)[0]
    assert (found[: starts.size] == starts).all()
    numbers, same = (words[starts.size:].view(np.float32) for words in (found, expected))
    assert len(numbers)
    assert np.abs(numbers).max() > 0
    np.testing.assert_allclose(numbers, same, rtol=0, atol=1e-6 * float(np.abs(same).max()))
