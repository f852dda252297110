"""What anybody does with an installed package, by the standard library and what the package brings.

`try_wheel.py` runs it in the environments that it makes: `python -I wheel_smoke.py`, in an empty folder.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path

import numpy as np

import hmkcta
from hmkcta import backends
from hmkcta.synthetic import material

#: Of the material that is compressed, in dB.
SNR = 30.0


def check_environment() -> None:
    """The package is the installed one, its kernels are native, and what builds them is out of reach."""
    assert Path(hmkcta.__file__).is_relative_to(sys.prefix), f"{hmkcta.__file__} is not of {sys.prefix}"
    assert backends.name == "native"
    assert hmkcta.__version__ == distribution("hmkcta").version
    for tool in ("cargo", "rustc", "node"):
        assert shutil.which(tool) is None, f"{tool} is on the path"


def check_page() -> None:
    """The viewer's page has come with the package, with all that it loads."""
    page = files("hmkcta") / "viewer_page"
    loaded = re.findall(r'(?:src|href)="\./([^"]+)"', (page / "index.html").read_text(encoding="utf-8"))
    assert {name.rpartition(".")[2] for name in loaded} >= {"js", "css"}
    for name in (*loaded, "hmkcta.js", "hmkcta.d.ts"):
        assert (page / name).is_file(), f"the page lacks {name}"


def check_model(folder: Path) -> None:
    """Compress, save, open and index: elements are those of the whole array, and as near as was asked for."""
    data = material(lights=6, views=5, size=16)
    hmkcta.compress(data.values, axes=data.names, snr=SNR, quality="fast").save(folder / "a.hmk")
    model = hmkcta.open(folder / "a.hmk")
    whole = model.reconstruct()
    error = np.square(whole.astype(np.float64) - data.values).sum()
    assert model.shape == data.values.shape
    assert 10 * np.log10(np.square(data.values, dtype=np.float64).sum() / error) >= SNR
    np.testing.assert_allclose(model[3, :, 10, 5], whole[3, :, 10, 5], rtol=1e-5, atol=1e-5)
    np.save(folder / "whole.npy", whole)


def command(folder: Path, *words: str) -> str:
    """What the installed command prints."""
    program = shutil.which("hmkcta", path=str(Path(sys.executable).parent))
    assert program, f"no hmkcta beside {sys.executable}"
    done = subprocess.run([program, *words], cwd=folder, capture_output=True, text=True, encoding="utf-8", timeout=300)
    assert done.returncode == 0, f"hmkcta {' '.join(words)}: {done.stdout}{done.stderr}"
    return done.stdout


def check_commands(folder: Path) -> None:
    """The command line reads the file and decodes the same numbers."""
    assert hmkcta.__version__ in command(folder, "--version")
    assert "light 6 (light), view 5 (view)" in command(folder, "info", "a.hmk")
    command(folder, "decompress", "a.hmk", "-o", "b.npy")
    np.testing.assert_array_equal(np.load(folder / "b.npy"), np.load(folder / "whole.npy"))


if __name__ == "__main__":
    check_environment()
    check_page()
    check_model(Path.cwd())
    check_commands(Path.cwd())
