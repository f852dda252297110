"""Files read by a reader that knows `docs/format.md` and nothing else, whose code is that of the text."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from format_reader import TEXT, Reader
from hmkcta.hmkfile import REASONS, WRITER_REASONS, encode
from hmkcta.model import Model
from literal_decode import element
from make_fixture import FIXTURES, MODELS
from random_models import Shapes, random_model


@pytest.mark.parametrize("name", MODELS)
def test_fixtures_hold_what_was_written_down(name: str) -> None:
    reader = Reader(FIXTURES / f"v1-{name}.hmk")
    expected: dict[str, Any] = json.loads((FIXTURES / f"v1-{name}.json").read_text(encoding="utf-8"))
    order = expected["modes"]
    for row in expected["elements"]:
        for stage, value in enumerate(row[order:], 1):
            assert reader.element(row[:order], stage) == pytest.approx(value, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("seed", range(12))
def test_random_files_read_by_the_text_alone(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    sizes = tuple(int(size) for size in rng.integers(1, 7, int(rng.integers(2, 4))))
    stages = int(rng.integers(1, 4))
    shapes = Shapes(3, 3, 3, 8, zero=0.1, leaf=0.2, cut=0.3, own=0.3)
    metadata, levels = random_model(
        rng, sizes, stages, shapes=shapes, coded=0.7, cuts=(1,) if stages > 1 and seed % 2 else ()
    )
    Model(metadata, levels).save(tmp_path / "a.hmk")
    reader = Reader(tmp_path / "a.hmk")
    for point in rng.integers(0, sizes, (12, len(sizes))).tolist():
        for stage in range(1, stages + 1):
            assert reader.element(point, stage) == pytest.approx(element(levels, point, stage), rel=1e-6, abs=1e-6)


def test_the_tables_of_reasons_are_those_of_the_code() -> None:
    rows = re.findall(r"^\| `([a-z0-9-]+)` \| (\w+) \| (.*) \|$", TEXT, re.MULTILINE)
    found = {code: (kind, sentence) for code, kind, sentence in rows if code in {**REASONS, **WRITER_REASONS}}
    expected = {**REASONS, **WRITER_REASONS}
    assert found == {code: (reason.kind.value[0], reason.sentence) for code, reason in expected.items()}


def test_the_small_file_in_the_text_is_the_fixture() -> None:
    """In hexadecimal, 16 bytes a line, with what they are beside them."""
    section = TEXT[TEXT.index("## 10. A small file") : TEXT.index("# Part II")]
    lines = re.findall(r"^([0-9a-f]{4}) ((?: [0-9a-f]{2})+)", section, re.MULTILINE)
    data = bytes.fromhex("".join(line for _, line in lines))
    assert data == (FIXTURES / "v1-small.hmk").read_bytes()


@pytest.mark.parametrize("name", MODELS)
def test_fixtures_are_made_by_their_models(name: str) -> None:
    assert b"".join(encode(*MODELS[name]())) == (FIXTURES / f"v1-{name}.hmk").read_bytes()
