"""Measured data, which are no part of the project: in a folder that a variable of the environment names."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from benchmarks.data import SHEET_VARIABLE


def real_data(name: str) -> Path:
    """The file of that name; where no folder is named the test is skipped."""
    if not (folder := os.environ.get(SHEET_VARIABLE)):
        pytest.skip(f"{name} is measured data: {SHEET_VARIABLE} names the folder that has it")
    path = Path(folder, name)
    assert path.exists(), f"{path} is not there: {SHEET_VARIABLE} names another folder"
    return path
