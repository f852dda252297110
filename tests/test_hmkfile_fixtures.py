"""Files of released versions decode to what was written down when they were made, for ever."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hmk_corpus import FIXTURES, Parts
from hmkcta.axes import mode_sizes
from hmkcta.bitstream import I32, U8, from_unary
from hmkcta.errors import HmkctaError
from hmkcta.hmkfile import VERSION, encode, load, prefix
from hmkcta.packed import F16, Metadata, PackedLevel
from hmkcta.parameters import BELOW_ONE, most_of_core
from hmkcta.rice import MOST, MOST_ZEROS, RAW, decoded, folded
from literal_decode import element
from make_fixture import (
    any_bits,
    eight_model,
    lone_model,
    mixed_model,
    packed_model,
    parameters_of,
    partly_model,
    write_fixtures,
)

#: SHA-256 of every committed fixture: a fixture that changes is no evidence any more.
DIGESTS = {
    "v1.0-merged.hmk": "33f8c3adaf1f4db36abf82b8d01b72814f4bfd7a0340271bd06f2ad132dd3fd9",
    "v1.0-small.hmk": "d69c92e8e0f00e017123e3b499e2df2e28ade57a25853e8db7b25f2e4e4a2d56",
    "v1.1-eight.hmk": "805998aebb4956ab83967db51ad6aafe336158f1bfb2276e2c69a1d2de25cca6",
    "v1.1-mixed.hmk": "36f0ef600a09e11d39c3a0a6cbc4ae7b3f07187674c000f521fcd13b2c695825",
    "v1.2-eight.hmk": "c40d21a3d4cb6a7827eea81e2f39cd7e4bc81deb6fa7c2609da7a37f07668945",
    "v1.2-lone.hmk": "2de87a0a64e0c6e424e9787dc78872efe08404d450e3148c85b00aa1d3a55f22",
    "v1.2-mixed.hmk": "dfa07b4c27dddb781bf943f708b18d16672f6115bcae8131d7eba8e0f8fe79d9",
    "v1.4-bits.hmk": "e184f28f71a298d5423ed299cdaf87d947e84e4503823b6716375083ccd6db3e",
    "v1.4-packed.hmk": "15f0015938d8970e428ae694e687cf37cb80dd683ea825f67b058d6c282bf635",
    "v1.4-partly.hmk": "16a6c16b9eb8f51b2c267e0193f3ecf57ba280605361c911f37955bcb93c01a1",
}


def test_fixtures_are_there_and_unchanged() -> None:
    found = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(FIXTURES.glob("v*.hmk"))}
    assert found == DIGESTS
    assert all(path.stat().st_size < 20_000 for path in FIXTURES.glob("v*.hmk"))


@pytest.mark.parametrize("name", DIGESTS)
def test_fixture_decodes_to_its_expectations(name: str) -> None:
    metadata, levels = load(FIXTURES / name)
    expected: dict[str, Any] = json.loads((FIXTURES / name).with_suffix(".json").read_text(encoding="utf-8"))
    assert list(mode_sizes(metadata.axes, metadata.organisation)) == expected["mode_sizes"]
    assert [level.nodes for level in levels] == expected["nodes"]
    assert [level.numbers() for level in levels] == expected["numbers"]
    found = [[element(levels, index, upto) for upto in range(1, len(levels) + 1)] for index in expected["indices"]]
    np.testing.assert_allclose(found, expected["values"], rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(("name", "bits"), [("v1.0-merged", [16] * 3), ("v1.1-eight", [8, 8]),
                                            ("v1.1-mixed", [16, 8, 8]), ("v1.2-eight", [8, 8]),
                                            ("v1.2-mixed", [16, 8, 8]), ("v1.2-lone", [8] * 3),
                                            ("v1.4-packed", [8, 8]), ("v1.4-partly", [16, 8, 8]),
                                            ("v1.4-bits", [8, 8])])
def test_fixtures_of_bytes_have_them(name: str, bits: list[int]) -> None:
    _, levels = load(FIXTURES / f"{name}.hmk")
    assert [level.bits for level in levels] == bits
    assert all(level.core.dtype == np.float16 and not level.core.flags.writeable for level in levels)


@dataclass(frozen=True, eq=False)
class Codes:
    """An array of a packed level: of each number the parameter, bits of 0, the whole number, and what it stands for."""

    parameters: U8
    steps: NDArray[np.int64]  # parameters that the steps of numbers go with
    zeros: I32
    whole: I32
    numbers: F16

    @property
    def ends(self) -> tuple[int, int]:
        """How many bits of their last bytes the two sequences take; 0 is all."""
        rest = np.where(self.zeros < MOST_ZEROS, self.parameters, RAW)
        return (int(self.zeros.sum()) + self.zeros.size) % 8, int(rest.sum()) % 8

    @property
    def range(self) -> tuple[int, int]:
        """The least parameter and the largest."""
        return int(self.parameters.min()), int(self.parameters.max())


def codes(name: str) -> list[Codes]:
    """Those of all arrays of the packed levels of a fixture, in their order."""
    path, found = FIXTURES / f"{name}.hmk", list[Codes]()
    arrays = Parts.split(path.read_bytes()).arrays
    for level, packed in enumerate(load(path)[1], 1):
        for array, numbers in packed.wide() if packed.rice else ():
            own, stored = parameters_of(packed, array), np.frombuffer(arrays[prefix(level) + array][2], np.uint8)
            steps = own
            if array == "core":
                most = most_of_core(packed.rice, packed.shape[:, 2])
                steps = np.repeat(most, np.diff(packed.core_offset.astype(np.int64)))
            zeros, whole = from_unary(stored, own.size), decoded(stored, own)
            found.append(Codes(own, steps.astype(np.int64), zeros, whole, numbers))
    return found


def entries(name: str) -> list[list[list[int] | None]]:
    """Of the columns of a fixture, level by level and mode by mode."""
    return [[None if own is None else own.tolist() for own in level.rice] for level in load(FIXTURES / name)[1]]


def test_the_fixture_of_packed_levels_has_them() -> None:
    """Parameters from 0 to 15, nodes of different ranks and of none, sequences that end in a byte and at one."""
    assert entries("v1.4-packed.hmk") == [[[191, 0, 234], None], [[49, 100, 137, 36, 249], None]]
    assert load(FIXTURES / "v1.4-packed.hmk")[1][1].shape[:, 2, 0].tolist() == [2, 0, 3]
    found = codes("v1.4-packed")
    assert [own.ends for own in found] == [(1, 1), (6, 0), (1, 1), (3, 5)]
    assert [own.range for own in found] == [(0, 14), (0, 15), (2, 15), (1, 9)]
    assert [own.zeros.max() for own in found] == [6, 12, 12, 12]


def test_the_fixture_of_partly_packed_levels_has_them() -> None:
    """A level between one of F16 and one of I8, with nodes of several clusters for a row and one that is zero."""
    assert entries("v1.4-partly.hmk") == [[], [[147, 6, 174, 238, 68], [16, 219, 67, 246], None], []]
    _, levels = load(FIXTURES / "v1.4-partly.hmk")
    assert (levels[1].shape == 0).all(axis=(1, 2)).tolist() == [False, True, False, False]
    assert [level.shape[:, 1].max() for level in levels] == [2, 2, 1]
    found = codes("v1.4-partly")
    assert [own.ends for own in found] == [(0, 0), (4, 0), (3, 2)]
    assert [own.range for own in found] == [(0, 14), (3, 14), (0, 11)]
    assert [own.zeros.max() for own in found] == [12, 12, 7]


def test_the_fixture_of_any_bits_has_codes_that_are_not_written() -> None:
    """Small numbers in 16 bits, some of more in fewer, and some that float16 rounds."""
    found = codes("v1.4-bits")
    assert [own.range for own in found] == [(2, 9), (9, 13), (3, 3), (1, 8), (0, 15), (0, 15), (0, 15), (0, 11)]
    assert [own.zeros.max() for own in found] == [12] * 8
    small, large, rounded = 0, 0, 0
    for own in found:
        small += int((folded(own.whole) >> own.parameters < MOST_ZEROS)[own.zeros == MOST_ZEROS].sum())
        large += int((own.whole > MOST).sum())
        rounded += int((np.ldexp(own.numbers.astype(np.float64), own.steps + BELOW_ONE) != own.whole).sum())
    assert (small, large, rounded) == (4, 13, 120)


@pytest.mark.parametrize(("version", "name", "model"), [
    ("1.2", "eight", eight_model()), ("1.2", "mixed", mixed_model()), ("1.2", "lone", lone_model()),
    ("1.4", "packed", packed_model()), ("1.4", "partly", partly_model())],
    ids=["eight", "mixed", "lone", "packed", "partly"])  # fmt: skip
def test_fixtures_of_versions_that_are_written_are_written_as_they_are(
    version: str, name: str, model: tuple[Metadata, tuple[PackedLevel, ...]]
) -> None:
    assert b"".join(encode(*model)) == (FIXTURES / f"v{version}-{name}.hmk").read_bytes()


@pytest.mark.parametrize("name", ["eight", "mixed"])
def test_short_tables_are_those_of_the_version_before(name: str) -> None:
    (_, before), (_, short) = (load(FIXTURES / f"v{version}-{name}.hmk") for version in ("1.1", "1.2"))
    for level, other in zip(short, before, strict=True):
        for (_, found), (_, expected) in zip(level.tables(), other.tables(), strict=True):
            assert found.dtype == expected.dtype
            np.testing.assert_array_equal(found, expected)


def test_the_fixture_of_any_bits_is_made_as_it_was() -> None:
    assert any_bits() == (FIXTURES / "v1.4-bits.hmk").read_bytes()


def test_merged_fixture_has_every_kind_of_node() -> None:
    _, levels = load(FIXTURES / "v1.0-merged.hmk")
    kinds: set[str] = set()
    for level in levels:
        rows = np.stack([np.diff(offsets.astype(np.int64)) for offsets in level.row_offset], axis=1)
        zero, empty = (level.shape == 0).all(axis=(1, 2)), (rows == 0).any(axis=1)
        children = np.zeros(level.nodes) if level.child is None else np.diff(level.child.astype(np.int64))
        found = {"empty": empty, "zero": zero & ~empty, "mixture": (level.shape[:, 1] > 1).any(axis=1),
                 "early leaf": (children == 0) & ~zero & (level.child is not None),
                 "only child": children == 1, "children": children > 1}
        kinds |= {kind for kind, nodes in found.items() if nodes.any()}
    assert kinds == {"empty", "zero", "mixture", "early leaf", "only child", "children"}


def test_generator_refuses_to_overwrite(tmp_path: Path) -> None:
    write_fixtures(tmp_path)
    with pytest.raises(HmkctaError) as caught:
        write_fixtures(tmp_path)
    assert caught.value.reason == "output-exists"
    assert sorted(os.listdir(tmp_path)) == sorted(path.name for path in FIXTURES.glob(f"v{VERSION}-*"))
