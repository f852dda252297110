"""What tests of fits share: noise, and the bytes of a model's file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hmkcta import Model


def noise(*shape: int) -> NDArray[np.float32]:
    """Normal numbers, always the same of a shape."""
    return np.random.default_rng(list(shape)).standard_normal(shape, np.float32)


def file_of(model: Model, folder: Path) -> bytes:
    """The bytes of the model's file, which is left in the folder."""
    path = folder / "model.hmk"
    model.save(path, overwrite=True)
    return path.read_bytes()
