"""Files of many plans, read by a reader that knows `docs/format.md` and nothing else."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hmkcta
from format_reader import Reader, nearest_half, of_codes
from hmk_corpus import FIXTURES
from hmkcta.model import Model
from hmkcta.transform import TRANSFORMS
from literal_decode import element
from random_models import Shapes, random_model

SHAPE, AXES = (5, 4, 9, 8, 3), ("light", "view", "y", "x", "rgb")
FORMAT = Path(__file__).parent.parent / "docs" / "format.md"

CASES: list[dict[str, Any]] = [
    {"plan": "R=2"},
    {"plan": "R=2 C=2 K=2"},
    {"plan": "R=2,2,2,2,*"},
    {"plan": "R=*"},
    {"plan": "R=2,2,3,3 / R=2 C=3,3,3,3 K=2 / R=1 C=2 K=2", "organisation": "light+rgb, view, y, x"},
    {"plan": "R=2,2,2,* / R=2,2,2,* C=2,3,2,1 K=2 / R=1,1,1,*", "organisation": "rgb+light, x, y, view"},
    {"plan": "R=1 C=2,2,3,3,1 / R=2 / R=1 C=2,2,2,2,1 K=2", "scheme": "least"},
    {"plan": "R=3,* C=4,1 K=2", "organisation": "light+view+rgb, y+x"},
    {"plan": "R=1 grid=y:3,x:2 / R<=4", "size": 15000},
    {"size": 9000},
    {"snr": 25.0, "transform": "log1p:0.5"},
    {"snr": 25.0, "transform": "asinh:0.5"},
    {"snr": 25.0, "transform": "sqrt"},
]


@pytest.mark.parametrize("options", CASES, ids=str)
def test_a_reader_by_the_text_alone_agrees(options: dict[str, Any], tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    place = np.meshgrid(*(np.linspace(0, 1, size) for size in SHAPE), indexing="ij", sparse=True)
    values = sum(np.sin(3 * (n + 2) * x) for n, x in enumerate(place)) * np.exp(-place[2] * place[3])
    values = np.abs(values + 0.1 * rng.standard_normal(SHAPE))
    hmkcta.compress(values, axes=AXES, quality="fast", **options).save(tmp_path / "a.hmk")
    reader, model = Reader(tmp_path / "a.hmk"), hmkcta.open(tmp_path / "a.hmk")
    for level in range(1, len(model.levels) + 1):
        decoded = np.asarray(model.at_level(level))
        for index in rng.integers(0, SHAPE, (30, 5)).tolist():
            assert reader.value(index, level) == pytest.approx(float(decoded[tuple(index)]), abs=1e-5)


@pytest.mark.parametrize("packed_share", [0.0, 0.6, 1.0])
@pytest.mark.parametrize("eight_from", [1, 2, 3])
@pytest.mark.parametrize("shapes", [Shapes(leaf=0.0, zero=0.0), Shapes(3, 1, 3, zero=0.1, leaf=0.1, tidy=True)])
def test_a_reader_by_the_text_alone_agrees_on_bytes(
    eight_from: int, shapes: Shapes, packed_share: float, tmp_path: Path
) -> None:
    sizes, rng = (5, 4, 6), np.random.default_rng(eight_from)
    model = Model(
        *random_model(rng, sizes, 3, (1,), shapes=shapes, eight_from=eight_from, packed_share=packed_share)
    )
    model.save(tmp_path / "a.hmk")
    reader, opened = Reader(tmp_path / "a.hmk"), hmkcta.open(tmp_path / "a.hmk")
    packed = [bool(level.rice) for level in model.levels]
    assert packed_share == 0.6 or any(packed) == bool(packed_share)
    assert reader.metadata["version"] == ("1.4" if any(packed) else "1.2")
    assert packed == [f"level/{level}/rice/0" in reader.arrays for level in (1, 2, 3)]
    for level in range(1, 4):
        decoded = np.asarray(opened.at_level(level))
        assert np.abs(decoded).max() > 0.1
        for index in np.ndindex(*sizes):
            value = reader.value(index, level)
            assert value == pytest.approx(element(model.levels, index, level), abs=1e-9)
            assert value == pytest.approx(float(decoded[index]), abs=1e-4)


@pytest.mark.parametrize("path", sorted(FIXTURES.glob("v*.json")), ids=lambda path: path.stem)
def test_a_reader_by_the_text_alone_agrees_on_fixtures(path: Path) -> None:
    reader, expected = Reader(path.with_suffix(".hmk")), json.loads(path.read_text(encoding="utf-8"))
    for mode_index, values in zip(expected["indices"], expected["values"], strict=True):
        place: dict[str, int] = {}
        for mode, i in zip(reader.modes, mode_index, strict=True):
            for axis in reversed(mode):
                i, place[axis] = divmod(i, reader.sizes[axis])
        for level, value in enumerate(values, 1):
            found = reader.value([place[axis] for axis in reader.sizes], level)
            assert found == pytest.approx(value, rel=1e-12, abs=1e-9)


def test_the_example_of_the_text_is_packed_so() -> None:
    """The bytes and the numbers are those of section 3, packed levels."""
    text = FORMAT.read_text(encoding="utf-8").replace("\n", " ")
    assert "columns of parameters 1 and 0 and the numbers 0.25, -0.25, -0.5, 0.75 of two rows of a basis" in text
    assert "are q = 2, -1, -4, 3, that is z = 4, 1, 7, 6 and u = 2, 1, 3, 6: the first sequence" in text
    assert "`001 01 0001 0000001`, the second one, of the first column alone, `0 1`; the bytes" in text
    assert "the bytes 0x14, 0x81 and 0x02." in text
    assert of_codes([0x14, 0x81, 0x02], [1, 0, 1, 0]) == (2, -1, -4, 3)
    assert [nearest_half(q, k) for q, k in ((2, 1), (-1, 0), (-4, 1), (3, 0))] == [0.25, -0.25, -0.5, 0.75]


@pytest.mark.parametrize(("stored", "parameters", "numbers"), [
    ([], [], ()),
    ([0xFF], [0] * 8, (0,) * 8),  # no second sequence
    ([0xFF, 0xFF], [1] * 8, (-1,) * 8),  # both end at the end of a byte
    ([0x00, 0xF0, 0x05, 0x00], [3], (-3,)),  # a small number in 16 bits, spare bits of 1
    ([0x00, 0x10, 0xFF, 0xFF], [0], (-32768,)),
    ([0x00, 0x08, 0xFF, 0x7F], [15], (-196608,)),  # the largest one without
])  # fmt: skip
def test_codes_at_their_limits(stored: list[int], parameters: list[int], numbers: tuple[int, ...]) -> None:
    assert of_codes(stored, parameters) == numbers


@pytest.mark.parametrize(("stored", "parameters", "error"), [
    ([0x00, 0x20, 0x00, 0x00], [0], AssertionError),  # 13 bits of 0
    ([0x0F], [0] * 5, IndexError),  # four codes
    ([0x01], [4], AssertionError),  # no second sequence
    ([0x01, 0x00], [0], AssertionError),  # a byte too many
])  # fmt: skip
def test_codes_that_are_none(stored: list[int], parameters: list[int], error: type[Exception]) -> None:
    with pytest.raises(error):
        of_codes(stored, parameters)


def test_halves_of_whole_numbers_are_those_of_numpy() -> None:
    """All that a core number in 16 bits may be, of which those above 2048 lose digits, and the largest without."""
    for k, most in ((15, 196608), (12, 32768), (5, 32768), (0, 32768)):
        whole = range(-most, most)
        expected = (np.array(whole, np.float64) / 2.0 ** (k + 2)).astype(np.float16)
        assert [nearest_half(q, k) for q in whole] == expected.tolist()


def test_the_text_says_how_every_transform_is_undone() -> None:
    text = FORMAT.read_text(encoding="utf-8")
    for name, constants in TRANSFORMS.items():
        fields = "".join(f', "{constant}": a' for constant in constants)
        assert f'| `{{"name": "{name}"{fields}}}` |' in text
