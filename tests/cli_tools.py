"""Running the command line in tests, in this process and in one of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner, Result
from numpy.typing import NDArray

from hmkcta.cli import main

PYTHON = Path(__file__).parent.parent / "python"


def run(*words: object, code: int = 0) -> Result:
    """Run a command in this process; it must end with this exit code, and never with a traceback."""
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code == code, f"exit code {result.exit_code}: {result.output}"
    assert "Traceback" not in result.output
    return result


def refused(*words: object, code: int) -> str:
    """The one sentence on stderr with which a command fails; nothing is on stdout."""
    result = run(*words, code=code)
    assert result.stdout == ""
    sentences = [line for line in result.stderr.splitlines() if line.startswith("hmkcta: ")]
    assert len(sentences) == 1, result.stderr
    return sentences[0]


def report(*words: object, code: int = 0) -> dict[str, Any]:
    """The JSON object that a command prints."""
    return json.loads(run(*words, "--json", code=code).stdout)


def start(*words: object, before: str = "", **options: Any) -> subprocess.Popen[str]:
    """Start a command in a process of its own, after some Python statements `before`."""
    path = f"import sys\nsys.path.insert(0, {str(PYTHON)!r})"
    program = f"{path}\n{before}\nfrom hmkcta.cli import main\nmain(sys.argv[1:])\n"
    return subprocess.Popen([sys.executable, "-c", program, *map(str, words)], text=True, stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}, **options)


def finish(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a process."""
    out, err = process.communicate(timeout=60)
    return process.returncode, out, err


def smooth(*shape: int) -> NDArray[np.float32]:
    """A smooth array of no low rank."""
    place = sum((n + 1.0) * np.linspace(0, 1, size).reshape([-1 if m == n else 1 for m in range(len(shape))])
                for n, size in enumerate(shape))
    return np.asarray(1.0 / (0.2 + np.sin(place) ** 2), np.float32)


def saved(path: Path, array: NDArray[Any]) -> Path:
    """The array as a `.npy` file."""
    np.save(path, array)
    return path
