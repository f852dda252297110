"""Files of released versions decode to what was written down when they were made, for ever."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hmk_corpus import FIXTURES
from hmkcta.axes import mode_sizes
from hmkcta.errors import HmkctaError
from hmkcta.hmkfile import VERSION, encode, load
from hmkcta.packed import Metadata, PackedLevel
from literal_decode import element
from make_fixture import any_bits, eight_model, lone_model, mixed_model, packed_model, partly_model, write_fixtures

#: SHA-256 of every committed fixture: a fixture that changes is no evidence any more.
DIGESTS = {
    "v1.0-merged.hmk": "33f8c3adaf1f4db36abf82b8d01b72814f4bfd7a0340271bd06f2ad132dd3fd9",
    "v1.0-small.hmk": "d69c92e8e0f00e017123e3b499e2df2e28ade57a25853e8db7b25f2e4e4a2d56",
    "v1.1-eight.hmk": "805998aebb4956ab83967db51ad6aafe336158f1bfb2276e2c69a1d2de25cca6",
    "v1.1-mixed.hmk": "36f0ef600a09e11d39c3a0a6cbc4ae7b3f07187674c000f521fcd13b2c695825",
    "v1.2-eight.hmk": "c40d21a3d4cb6a7827eea81e2f39cd7e4bc81deb6fa7c2609da7a37f07668945",
    "v1.2-lone.hmk": "2de87a0a64e0c6e424e9787dc78872efe08404d450e3148c85b00aa1d3a55f22",
    "v1.2-mixed.hmk": "dfa07b4c27dddb781bf943f708b18d16672f6115bcae8131d7eba8e0f8fe79d9",
    "v1.3-bits.hmk": "0b0b7d5cf65fa7c23cdd7d53f810f589889d9406bffa41a59c2a56a5eb29ed60",
    "v1.3-packed.hmk": "5f517e7674d5bf249b504ac55552a273a4444f2d91f4715c8929423c47a3d433",
    "v1.3-partly.hmk": "fa4378e045d2bfe0b1bc3dc2e1a8dd0e7bef841a3053a11d857a2b9d82911669",
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
                                            ("v1.3-packed", [8, 8]), ("v1.3-partly", [16, 8, 8]),
                                            ("v1.3-bits", [8, 8])])
def test_fixtures_of_bytes_have_them(name: str, bits: list[int]) -> None:
    _, levels = load(FIXTURES / f"{name}.hmk")
    assert [level.bits for level in levels] == bits
    assert all(level.core.dtype == np.float16 and not level.core.flags.writeable for level in levels)


def test_fixtures_of_packed_levels_have_them() -> None:
    """Columns of few and of many bits, nodes of different ranks and of none, spare bits, other levels beside packed."""
    _, levels = load(FIXTURES / "v1.3-packed.hmk")
    assert [tuple(None if own is None else own.tolist() for own in level.width) for level in levels] == [
        ([167], None), ([241, 164, 25, 55, 10], None)]
    assert levels[1].shape[:, 2, 0].tolist() == [2, 0, 3]
    assert [int(level.basis_bits(0).sum()) % 8 for level in levels] == [0, 3]
    assert [int(level.core_bits().sum()) % 8 for level in levels] == [3, 4]
    _, levels = load(FIXTURES / "v1.3-partly.hmk")
    assert [[width is not None for width in level.width] for level in levels] == [[], [True, True, False], []]
    assert (levels[1].shape == 0).all(axis=(1, 2)).tolist() == [False, False, True, False]
    assert levels[1].shape[:, 1].max() == 2
    assert levels[1].core_bits().max() == 12
    _, levels = load(FIXTURES / "v1.3-bits.hmk")
    assert [int(level.core_bits().max()) for level in levels] == [13, 13]


@pytest.mark.parametrize(("version", "name", "model"), [
    ("1.2", "eight", eight_model()), ("1.2", "mixed", mixed_model()), ("1.2", "lone", lone_model()),
    ("1.3", "packed", packed_model()), ("1.3", "partly", partly_model())],
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
    assert any_bits() == (FIXTURES / "v1.3-bits.hmk").read_bytes()


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
