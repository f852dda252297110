"""Scratch files: blocks lie where they belong, and nothing is left of them."""

from __future__ import annotations

from math import prod
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hmkcta.errors import HmkctaError
from hmkcta.streaming.pieces import Piece, put
from hmkcta.streaming.scratch import Scratch


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_blocks_are_put_where_they_belong(data: st.DataObject) -> None:
    sizes = data.draw(st.lists(st.integers(1, 5), min_size=1, max_size=4).map(tuple))
    places = [np.array(sorted(data.draw(st.sets(st.integers(0, size - 1), min_size=1)))) for size in sizes]
    lengths = [len(place) for place in places]
    values = np.arange(1, 1 + prod(lengths), dtype=np.float32).reshape(lengths)
    piece = Piece(tuple(np.arange(size) for size in sizes), 3)
    with Scratch(piece.elements + 5) as scratch:
        put(scratch, piece, places, values)
        found, expected = scratch.read(0, scratch.count), np.zeros(sizes, np.float32)
    expected[np.ix_(*places)] = values
    assert np.array_equal(found[3:-2].reshape(sizes), expected)
    assert not found[:3].any()
    assert not found[-2:].any()


# Scratch space


def test_scratch_files_have_no_name(tmp_path: Path) -> None:
    with Scratch(1000, tmp_path) as scratch:
        scratch.write(0, np.ones(1000, np.float32))
        assert list(tmp_path.iterdir()) == []


def test_no_room_for_scratch_is_said_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(HmkctaError, match="TMPDIR"):
        Scratch(1 << 60, tmp_path)
    with pytest.raises(HmkctaError, match="TMPDIR"):
        Scratch(10, tmp_path / "not there")
