"""Arrays that say what their axes are called, as xarray's do: `compress` takes `dims` where no names are given."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import NDArray


@final
class _Named(np.ndarray[Any, Any]):
    """An array with names of its axes; parts of it, and what is made of it, have none."""

    dims: tuple[str, ...] | None = None


def named(array: NDArray[Any], names: tuple[str, ...]) -> NDArray[Any]:
    """The array with names, if they differ; a map of a file stays one.

    >>> named(np.zeros((2, 3)), ("y", "x")).dims, named(np.zeros((2, 3)), ("y", "x")).T.dims
    (('y', 'x'), None)
    """
    if len(names) != array.ndim or len(set(names)) < len(names):
        return array
    view: Any = array.view() if isinstance(array, np.memmap) else array.view(_Named)
    view.dims = names
    return view


def names_of(array: NDArray[Any]) -> tuple[str, ...] | None:
    """The names of an array's axes, None where it says none."""
    return getattr(array, "dims", None)
