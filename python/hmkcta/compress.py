"""Array in, model out: the whole way of the data, and the plan chosen for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .axes import Axis
from .model import Model
from .plan import Plan

#: Called with the stage's name and the fraction of the whole work done, 0..1; raising in it interrupts the work.
Progress = Callable[[str, float], None]


def choose_plan(array: Any, *, axes: Any = None, snr: float | None = None, size: int | None = None, decode_cost: int = 4096,
                quality: str = "medium", organisation: str | None = None, scheme: str = "auto", transform: str = "identity", nan: float | None = None,
                seed: int = 0, threads: int | None = None, max_memory: int | None = None, progress: Progress | None = None) -> Plan:
    raise NotImplementedError


def compress(array: Any, plan: Plan | str | None = None, *, axes: Any = None, snr: float | None = None, size: int | None = None,
             decode_cost: int = 4096, quality: str = "medium", organisation: str | None = None, scheme: str = "auto", transform: str = "identity",
             nan: float | None = None, kind: str | None = None, seed: int = 0, threads: int | None = None, max_memory: int | None = None,
             progress: Progress | None = None) -> Model:
    raise NotImplementedError
