"""Property tests draw the same examples in every run, so that a change of outcome is a change of the code.

Ctrl-C is heard also where tests run in the background of a shell, which has it ignored, by them and what they start.
"""

import signal
from typing import Any

import pytest
from hypothesis import settings

from hmkcta.synthetic import material

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def small_slabs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slabs that small data are larger than."""
    monkeypatch.setattr("hmkcta.streaming.streamed.SLAB", 15_000)
    monkeypatch.setattr("hmkcta.fitting.measure_streamed.SLAB", 40_000)


@pytest.fixture(scope="session")
def cloth() -> Any:
    """A material that tests of streaming fit."""
    return material(lights=6, views=8, size=32)
