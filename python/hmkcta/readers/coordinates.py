"""Coordinates along an axis, as laboratories keep them: an array, or a table of numbers as text."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .open_array import open_array
from .source import io_error, opened

#: Endings of tables, and what parts the numbers of a line; None: spaces.
TABLES = {".csv": ",", ".txt": None}


def read_coordinates(uri: str) -> NDArray[Any]:
    """Numbers for each index of an axis, such as light directions.

    Args:
        uri: what `open_array` takes; or a `.csv` or `.txt` table with a line for each index, `#` before comments; a
            first line of words names the columns.

    Raises:
        HmkctaError: the file cannot be read, or is no table of numbers.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(f"{folder}/lights.txt").write_text("# x y z\\n0 0 1\\n0.6 0 0.8\\n")
    ...     read_coordinates(f"{folder}/lights.txt").tolist()
    [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]]
    """
    path = Path(uri)
    ending = path.suffix.lower()
    if ending not in TABLES:
        return open_array(uri)
    with opened(path) as file:
        lines = file.read().decode("utf-8-sig", "replace").splitlines()
    rows = [line for line in lines if line.partition("#")[0].strip()]
    if rows and all(map(_is_name, rows[0].split(TABLES[ending]))):
        del rows[0]
    try:
        table = np.loadtxt(rows, delimiter=TABLES[ending], ndmin=2) if rows else np.empty((0, 1))
    except ValueError as error:
        found = str(error).partition(";")[0]
        allowed = f"numbers parted by {'commas' if TABLES[ending] else 'spaces'}, as many in each line"
        raise io_error("coords-table", uri, found, allowed) from error
    return table[:, 0] if table.shape[1] == 1 else table


def _is_name(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return any(letter.isalpha() for letter in text)
    return False
