"""Pieces that a streamed tensor is cut into hold what they should, whenever they are cut anew."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hmkcta.axes import separate
from hmkcta.metrics import squared_norm
from hmkcta.streaming import streamed
from hmkcta.streaming.source import prepare


@pytest.mark.usefixtures("small_slabs")
def test_pieces_that_were_not_collected_are_cut_anew(cloth: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the source: of new ones that are too large to be collected nothing lies in the scratch file yet."""
    monkeypatch.setattr(streamed, "stays_cached", (1 << 62).__ge__)
    source = prepare(cloth.values, cloth.axes, "identity", None)
    residual = streamed.Streamed(source, separate(source.axes), 2, cloth.values.size // 3)
    lights, views, *others = residual.shape
    counts = (2, 2, *(1 for _ in others))
    for first, place in ((lights // 2, streamed.Place.TO_COLLECT), (1, streamed.Place.SCRATCH)):
        parts = [np.arange(lights) >= first, np.arange(views) >= min(first, views // 2), *map(np.zeros, others)]
        residual.cut([part.astype(np.intp) for part in parts], counts, once=True)
        assert residual.place is place
    assert residual.error == pytest.approx(squared_norm(source.values()), rel=1e-6)
