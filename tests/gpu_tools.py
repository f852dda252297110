"""What tests of shaders need: an adapter, Dawn for Node with a software Vulkan, and models of every kind."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from base64 import b64decode, b64encode
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hmkcta import Model
from hmkcta.axes import mode_sizes, name_axes
from hmkcta.errors import HmkctaError
from hmkcta.render.device import Device, shared_device
from random_models import Shapes, random_model

ROOT = Path(__file__).parent.parent
#: The software Vulkan of Debian's package chromium.
SWIFTSHADER = Path("/usr/lib/chromium/vk_swiftshader_icd.json")
#: Dawn for Node, installed by the viewer's `npm install`.
DAWN = ROOT / "viewer" / "node_modules" / "webgpu" / "index.js"
#: The system's, or the one that the Makefile puts beside Python.
NODE = shutil.which("node") or shutil.which("node", path=str(Path(sys.executable).parent))


def absent(what: str) -> None:
    """Skip the test, or fail it in CI: a machine without this would hide every fault of the shaders there."""
    if os.environ.get("CI") == "true":
        pytest.fail(f"CI must have {what}")
    pytest.skip(f"there is no {what} here")


def adapter() -> Device:
    """The device of this machine, software or not."""
    try:
        return shared_device()
    except HmkctaError as error:
        absent(f"adapter ({error})")
        raise


def run_in_dawn(jobs: Sequence[dict[str, Any]], folder: Path) -> list[NDArray[np.uint32]]:
    """Compile and run shaders with Tint; for each job the words of its last buffer."""
    if not (DAWN.exists() and SWIFTSHADER.exists() and NODE):
        absent("Dawn for Node (npm install in viewer/) with the software Vulkan of the package chromium")
    listed = folder / "jobs.json"
    listed.write_text(json.dumps(jobs), encoding="utf-8")
    done = subprocess.run([str(NODE), str(Path(__file__).parent / "run_in_dawn.mjs"), DAWN.as_uri(), str(listed)],
                          env={**os.environ, "VK_DRIVER_FILES": str(SWIFTSHADER)}, capture_output=True, text=True,
                          timeout=170, check=False)
    assert done.returncode == 0, done.stderr
    return [np.frombuffer(b64decode(text), np.uint32) for text in json.loads(done.stdout)]


def job(code: str, entry: str = "", groups: Sequence[Sequence[tuple[str, bytes]]] = (),
        counts: Sequence[int] = (1, 1, 1)) -> dict[str, Any]:
    """A shader to compile, and to run unless it has no entry point; buffers are (WebGPU's buffer type, bytes)."""
    shown = [[{"type": kind, "data": b64encode(data).decode()} for kind, data in group] for group in groups]
    return {"code": code, "entry": entry, "groups": shown, "counts": list(counts)}


@dataclass(frozen=True)
class Kind:
    """A kind of model that the decoder must take."""

    name: str
    sizes: tuple[int, ...]
    organisation: tuple[tuple[str, ...], ...] | None = None
    undecomposed: tuple[int, ...] = ()
    transform: str = "identity"
    stages: int = 3
    cuts: tuple[int, ...] = ()  # stages, from 1, that have no numbers
    cut: float = 0.0  # chance of a cut among other nodes
    own: float = 0.0  # chance that a mode is undecomposed in a node
    coded: float = 0.0  # share of the stages with numbers that has whole ones of a step

    def model(self, seed: int = 0) -> Model:
        """A random model of this kind, with nodes of different shapes, empty nodes and leaves above the last level."""
        axes = name_axes(self.sizes, AXIS_NAMES[: len(self.sizes)])
        organisation = self.organisation or tuple((axis.name,) for axis in axes)
        metadata, levels = random_model(
            np.random.default_rng(seed), mode_sizes(axes, organisation), self.stages, self.undecomposed, axes=axes,
            organisation=organisation, shapes=Shapes(zero=0.1, leaf=0.2, cut=self.cut, own=self.own),
            coded=self.coded, cuts=self.cuts)
        scaled = {} if self.transform in ("identity", "sqrt") else {"scale": 0.25}
        return Model(replace(metadata, transform={"name": self.transform, **scaled}), levels)


AXIS_NAMES = ("light", "view", "y", "x", "rgb", "t", "z", "gloss")
KINDS = (
    Kind("one-mode", (9,)),
    Kind("pca", (12, 20), undecomposed=(1,)),
    Kind("order-3", (6, 7, 5)),
    Kind("order-4", (5, 4, 6, 3)),
    Kind("order-5", (4, 3, 4, 5, 3)),
    Kind("order-6", (3, 2, 4, 3, 3, 2)),
    Kind("order-8", (2, 2, 3, 2, 1, 2, 2, 3)),
    Kind("five-levels", (16, 12, 10), stages=5),
    Kind("folded-colour", (6, 5, 4, 4, 3), (("light", "rgb"), ("view",), ("y",), ("x",))),
    Kind("merged-texels", (6, 5, 4, 4, 3), (("light", "rgb"), ("view",), ("y", "x"))),
    Kind("merged-angles", (6, 5, 4, 4, 3), (("view", "light"), ("x", "y"), ("rgb",))),
    Kind("time-undecomposed", (1, 6, 5, 4, 3, 7), (("light", "view"), ("y",), ("x",), ("rgb",), ("t",)), (4,)),
    Kind("first-undecomposed", (7, 6, 5), undecomposed=(0,)),
    Kind("two-undecomposed", (4, 5, 6, 3), undecomposed=(1, 3)),
    Kind("log1p", (6, 5, 4), transform="log1p"),
    Kind("asinh", (6, 5, 4), transform="asinh"),
    Kind("sqrt", (6, 5, 4), transform="sqrt"),
    Kind("own-undecomposed", (6, 5, 4), own=0.4),
    Kind("blocks", (9, 8, 6), stages=2, cuts=(1,), own=0.4),
    Kind("blocks-of-blocks", (9, 8, 10), cuts=(1, 2), own=0.3),
    Kind("blocks-merged", (6, 5, 4, 4, 3), (("light", "rgb"), ("view",), ("y", "x")), stages=2, cuts=(1,), own=0.3),
    Kind("blocks-below-a-level", (6, 5, 7, 4), (("light",), ("view",), ("y", "x")), cuts=(2,), own=0.2),
    Kind("blocks-undecomposed", (6, 5, 4, 4, 3), (("light", "rgb"), ("view",), ("y", "x")), (0,), stages=2, cuts=(1,)),
    Kind("cuts-anywhere", (9, 8, 7), stages=4, cut=0.3, own=0.3),
    Kind("coded", (5, 4, 6, 3), coded=1.0),
    Kind("coded-blocks", (9, 8, 10), cuts=(1, 2), own=0.3, coded=0.7),
)


def random_indices(model: Model, count: int, seed: int = 1) -> NDArray[np.int64]:
    """Some elements' indices, [count, axes]; every element where there are fewer."""
    if prod(model.shape) <= count:
        return np.stack(np.unravel_index(np.arange(prod(model.shape)), model.shape), axis=1)
    return np.random.default_rng(seed).integers(np.array(model.shape), size=(count, model.ndim))
