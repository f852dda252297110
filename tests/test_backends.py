"""HMKCTA_BACKEND: which kernels the CPU has, and that nothing is loaded that nobody asked for."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cli_tools import PYTHON, finish, saved, start


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return saved(tmp_path_factory.mktemp("source") / "values.npy", np.ones((4, 5, 6), np.float32))


def test_a_backend_that_is_none_ends_in_a_sentence(source: Path, tmp_path: Path) -> None:
    before = "import os; os.environ['HMKCTA_BACKEND'] = 'cuda'"
    code, out, err = finish(start("compress", source, "-o", tmp_path / "a.hmk", "--plan", "R=2", before=before))
    assert (code, out) == (2, "")
    assert "HMKCTA_BACKEND: found 'cuda', allowed native or reference." in err
    assert "Traceback" not in err
    assert not list(tmp_path.iterdir())
    code, out, _ = finish(start("--version", before=before))
    assert code == 0
    assert "cupy" in out


def test_kernels_that_are_missing_end_in_a_sentence(source: Path, tmp_path: Path) -> None:
    before = "import sys; sys.modules['hmkcta._native'] = None"
    code, _, err = finish(start("compress", source, "-o", tmp_path / "a.hmk", "--plan", "R=2", before=before))
    assert code == 2
    assert "hmkcta._native: found none that works" in err
    assert "Traceback" not in err


def test_nobody_loads_cupy_who_does_not_ask_for_it(tmp_path: Path) -> None:
    (tmp_path / "cupy.py").write_text("raise SystemExit('CuPy was loaded')")
    program = ("import numpy, hmkcta, hmkcta.cli\n"
               "print(hmkcta.compress(numpy.ones((4, 5)), 'R=1').snr)\n"
               "hmkcta.compress(numpy.ones((4, 5)), 'R=1', device='cuda')")  # fmt: skip
    path = os.pathsep.join([str(tmp_path), str(PYTHON), *sys.path])
    done = subprocess.run([sys.executable, "-c", program], env=os.environ | {"PYTHONPATH": path}, text=True,
                          capture_output=True, check=False, timeout=60)  # fmt: skip
    assert float(done.stdout) > 60
    assert done.stderr.strip() == "CuPy was loaded"
