"""What tests of tensors that memory does not hold fit, and how little it holds."""

from __future__ import annotations

from typing import Any

import pytest

from hmkcta import Model, compress
from hmkcta.streaming import budget

WH4_LIKE = "R=3,3,4,4 / R=2,2,2,2 C=2,2,3,3 K=2 / R=1,1,2,2 C=2 K=2"
MODES = "light+rgb, view, y, x"


def fitted(data: Any, monkeypatch: pytest.MonkeyPatch, workset: int, plan: str = WH4_LIKE, **options: Any) -> Model:
    """With tensors of up to `workset` elements held in memory."""
    monkeypatch.setattr(budget, "WORKSET", workset)
    settings: dict[str, Any] = {"scheme": "most", "quality": "fast", "threads": 2, "organisation": MODES, **options}
    return compress(data.values, plan, axes=data.axes, **settings)
