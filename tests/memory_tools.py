"""Memory that a process of its own takes, as peak memory never falls, and data to compress in it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

#: Compresses a file, or estimates that, and says what that took.
PROGRAM = """
import json, sys
import hmkcta
from hmkcta.support.memory import peak_memory
path, work, options = sys.argv[1:]
made = getattr(hmkcta, work)(hmkcta.open_array(path), **{"threads": 2} | json.loads(options))
print(json.dumps({"peak": peak_memory(), "snr": getattr(made, "snr", None)}))
"""

def printed(program: str, *words: object) -> str:
    """What a program says in a process of its own."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", program, *map(str, words)]
    return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, env=environment).stdout


def taken(work: str, path: Path, /, **options: object) -> dict[str, float]:
    """Most memory of `compress` or `estimate` on a file, and the SNR of what it finds."""
    return json.loads(printed(PROGRAM, path, work, json.dumps(options)))


def write_waves(path: Path, side: int) -> None:
    """A file of side^4 numbers: two separable waves and noise."""
    rng, shape = np.random.default_rng(0), (side,) * 4
    values = np.lib.format.open_memmap(path, mode="w+", dtype=np.float32, shape=shape)
    wave = [np.sin(np.linspace(0, 5 + n, side)) for n in range(8)]
    for i in range(side):
        values[i] = wave[0][i] * np.einsum("a,b,c->abc", *wave[1:4]) + wave[4][i] * np.einsum("a,b,c->abc", *wave[5:])
        values[i] += 0.1 * rng.standard_normal(shape[1:], np.float32)
    values.flush()
