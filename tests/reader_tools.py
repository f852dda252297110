"""What the tests of readers share: arrays that no two formats may mix up, refusals, libraries that must be there."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hmkcta.axes import Axis
from hmkcta.errors import HmkctaError, Kind
from hmkcta.labels import labels_of
from hmkcta.readers import open_array
from hmkcta.support import memory

#: No two axes of one size, no two elements of one value, all below 128.
VALUES = np.arange(60, dtype=np.float32).reshape(3, 4, 5)
DTYPES = ["<f4", ">f4", "<f8", ">f8", "u1", "i1", "<i2", ">u2", "<i4", ">i4"]


def needed(module: str) -> Any:
    """The library of a format; without it the test is skipped, or fails in CI."""
    try:
        return import_module(module)
    except ImportError:
        if os.environ.get("CI") == "true":
            pytest.fail(f"CI must have {module}")
        pytest.skip(f"there is no {module} here")


def refusal(uri: str | Path, **options: Any) -> HmkctaError:
    """The error with which the reader refuses."""
    with pytest.raises(HmkctaError) as caught:
        open_array(uri, **options)
    assert str(caught.value).endswith(f"[{caught.value.kind.label}/{caught.value.reason}]")
    return caught.value


def same(uri: str | Path, expected: Any, dtype: Any = None, mapped: bool = False, **options: Any) -> None:
    """The file is opened as just this array, mapped or not."""
    array = open_array(uri, **options)
    assert np.array_equal(array, expected)
    assert array.dtype == (np.asarray(expected).dtype if dtype is None else np.dtype(dtype))
    assert isinstance(array, np.memmap) == mapped


def axes_of(array: NDArray[Any]) -> dict[str, Axis]:
    """Axes of what was opened, by their names."""
    axes = labels_of(array).axes
    assert axes is not None
    return {axis.name: axis for axis in axes}


def coords_of(array: NDArray[Any]) -> list[list[Any]]:
    """Coordinates of all axes of what was opened that have some, in their order."""
    return [axis.coords.tolist() for axis in axes_of(array).values() if axis.coords is not None]


def roles_of(array: NDArray[Any]) -> list[tuple[str, str]]:
    """Names and roles of all axes of what was opened."""
    return [(axis.name, axis.role) for axis in axes_of(array).values()]


def little_memory(monkeypatch: pytest.MonkeyPatch, available: int) -> None:
    """Let so many bytes be free for whatever asks."""
    monkeypatch.setattr(memory, "available_memory", lambda: available)


def refused_wherever_cut(path: Path, step: int, uri: Path | None = None) -> None:
    """Beginnings of the file are refused with a sentence, and never read as an array."""
    whole = path.read_bytes()
    for length in range(0, len(whole), step):
        path.write_bytes(whole[:length])
        error = refusal(uri or path)
        assert error.kind in (Kind.IO, Kind.INVALID_ARGUMENT), (length, error)
    path.write_bytes(whole)


def survives_damage(path: Path, count: int = 200) -> None:
    """With a byte changed, anywhere, the file is an array or refused with a sentence."""
    whole, draw = path.read_bytes(), np.random.default_rng(1)
    for _ in range(count):
        data = bytearray(whole)
        data[int(draw.integers(len(data)))] = int(draw.integers(256))
        path.write_bytes(data)
        try:
            assert np.asarray(open_array(path)).size > 0
        except HmkctaError as error:
            assert error.reason  # noqa: PT017 (either outcome is right)
