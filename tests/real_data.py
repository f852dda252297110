"""Measured data, which are no part of the project: in a folder that a variable of the environment names."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from benchmarks.data import SHEET_VARIABLE


def real_data(name: str) -> Path:
    """The file of that name; without it the test is skipped."""
    folder = os.environ.get(SHEET_VARIABLE)
    if folder is None or not (path := Path(folder, name)).exists():
        pytest.skip(f"{name} is measured data: {SHEET_VARIABLE} names the folder that has it")
    return path
