"""Raw binary: numbers without a header, described by the caller."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..errors import invalid, shown
from .source import Layout, check_layout, io_error, mapped, opened


def open_raw(
    path: Path, shape: Sequence[int] | None, dtype: DTypeLike | None, order: str, offset: int
) -> NDArray[Any]:
    """Map a raw file whose size must be exactly what shape, number type and offset say.

    Raises:
        HmkctaError: the description is not complete or not possible, or the file has another size.
    """
    if shape is None or dtype is None:
        missing = " and ".join(name for name, given in (("shape", shape), ("dtype", dtype)) if given is None)
        raise invalid("raw-description", missing, "none", "both shape and dtype, which raw binary needs",
                      f"give the {missing} too, or nothing of the kind for other formats")
    try:
        sizes = tuple(operator.index(size) for size in shape)
    except TypeError:
        raise invalid("argument-type", "shape", shown(shape), "whole numbers, one an axis: (64, 64, 3)") from None
    layout = Layout(sizes, _number_type(dtype), _is_fortran(order))
    check_layout(layout, str(path))
    if offset < 0:
        raise invalid("raw-offset", "offset", offset, "0 or more")
    with opened(path) as file:
        found = file.seek(0, 2) - offset
    if found != layout.nbytes:
        expected = f"{layout.nbytes} bytes for {layout}"
        after = f" after the first {offset}" if offset else ""
        hint = "check shape, dtype and offset"
        if found < layout.nbytes:
            held = f"{max(found, 0)} bytes{after}"
            raise io_error("raw-too-short", str(path), held, expected, f"{hint}, or fetch the file again")
        raise invalid("raw-too-long", str(path), f"{found} bytes{after}", expected, hint)
    return mapped(path, layout, offset)


def _number_type(dtype: DTypeLike) -> np.dtype[Any]:
    try:
        return np.dtype(dtype)
    except (TypeError, ValueError, SyntaxError) as error:
        raise invalid("raw-dtype", "dtype", repr(dtype), "a NumPy type such as float32, uint8 or >f4") from error


def _is_fortran(order: str) -> bool:
    if order not in ("C", "F"):
        raise invalid("raw-order", "order", repr(order), "C (last axis fastest) or F (first axis fastest)")
    return order == "F"
