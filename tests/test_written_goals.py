"""A written plan's numbers are rounded as coarsely as its goal allows."""

from __future__ import annotations

import numpy as np
import pytest

from hmkcta import HmkctaError, Model, compress
from hmkcta import open as open_model
from hmkcta.arrays import F32
from hmkcta.model import Model as AnyModel
from hmkcta.search.block_code import code_block
from hmkcta.search.written import FittedCode, code_node

PLAN = "R=3,4,4 C=1,2,2 / R=2,3,3 C=1,3,3 K=1,2,2"


def waves() -> F32:
    """A smooth volume with some noise, 12 x 40 x 36."""
    t, y, x = np.meshgrid(*(np.linspace(0, 1, size) for size in (12, 40, 36)), indexing="ij")
    noise = np.random.default_rng(5).standard_normal(t.shape)
    return (np.sin(9 * x * (1 + t)) * np.cos(7 * y) + 0.3 * np.sin(40 * x * y) + 0.02 * noise).astype(np.float32)


@pytest.fixture(scope="module")
def exact() -> Model:
    """Without a goal numbers are float16."""
    model = compress(waves(), PLAN, quality="fast", threads=1)
    assert all(stage.step is None for stage in model.stages)
    return model


@pytest.mark.parametrize("share", [0.7, 0.4, 0.25])
def test_a_size_is_used_and_kept(exact: Model, share: float) -> None:
    size = int(share * exact.nbytes)
    model = compress(waves(), PLAN, quality="fast", threads=1, size=size)
    assert 0.985 * size <= model.nbytes <= size
    assert len(model.quality) == 2
    assert all(stage.step for stage in model.stages)


def test_half_the_bytes_lose_next_to_nothing(exact: Model) -> None:
    model = compress(waves(), PLAN, quality="fast", threads=1, size=exact.nbytes // 2)
    assert model.snr > exact.snr - 0.15


def test_a_file_that_is_small_enough_stays_as_it_is(exact: Model) -> None:
    same = compress(waves(), PLAN, quality="fast", threads=1, size=exact.nbytes)
    assert [stage.step for stage in same.stages] == [None, None]
    assert same.snr == exact.snr


@pytest.mark.parametrize("below", [0.05, 1.0, 4.0])
def test_an_snr_is_met_and_not_overshot(exact: Model, below: float) -> None:
    goal = exact.snr - below
    model = compress(waves(), PLAN, quality="fast", threads=1, snr=goal)
    assert goal <= model.snr <= goal + 0.03
    assert model.nbytes < 0.6 * exact.nbytes


def test_the_file_gives_the_same_numbers(exact: Model, tmp_path: pytest.TempPathFactory) -> None:
    model = compress(waves(), PLAN, quality="fast", threads=1, size=exact.nbytes // 2)
    path = f"{tmp_path}/levels.hmk"
    model.save(path)
    again = open_model(path)
    assert isinstance(again, AnyModel)
    assert np.array_equal(again.reconstruct(), model.reconstruct())
    assert np.isclose(20 * np.log10(np.linalg.norm(waves()) / np.linalg.norm(waves() - again.reconstruct())), again.snr,
                      atol=0.01)


def test_transformed_values_meet_their_snr() -> None:
    values = np.exp(3 * waves())
    fitted = compress(values, PLAN, quality="fast", threads=1, transform="log1p:1")
    model = compress(values, PLAN, quality="fast", threads=1, transform="log1p:1", snr=fitted.snr - 1)
    assert fitted.snr - 1 <= model.snr <= fitted.snr - 0.9


def test_too_few_bytes_are_refused() -> None:
    with pytest.raises(HmkctaError, match="size-too-small"):
        compress(waves(), PLAN, quality="fast", threads=1, size=200)


def test_finer_steps_leave_less(exact: Model) -> None:
    code, whole = FittedCode(exact), exact.reconstruct()
    errors = [np.linalg.norm(whole - Model(exact.metadata, code.at(step * code.rms)).reconstruct())
              for step in (0.3, 0.03, 0.003)]
    assert errors[0] > 4 * errors[1] > 16 * errors[2] > 0


def test_one_cell_is_coded_as_a_block() -> None:
    """A cell whose fit leaves nothing is coded as the search codes a block of these bases."""
    rng = np.random.default_rng(1)
    bases = [np.linalg.qr(rng.standard_normal((size, size)))[0].astype(np.float32) for size in (6, 5, 4)]
    core = (50 * rng.standard_normal((6, 5, 4))).astype(np.float32)
    values = np.einsum("abc,ia,jb,kc->ijk", core, *bases).astype(np.float32)
    members = [np.zeros((size, 1), np.uint16) for size in values.shape]
    node = code_node(core[None], members, [basis[:, None, None] for basis in bases], (1, 1, 1), 1.0)
    block = code_block(values, bases, core, (6, 5, 4), 1.0)
    for n in range(3):
        assert np.array_equal(node.exponents[n][0], block.exponents[n])
        assert np.array_equal(node.bases[n][:, 0, 0], block.bases[n])
    assert np.abs(node.core[0] - block.core).max() <= 1  # where a number is next to a bound
