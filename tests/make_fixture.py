"""Write the fixtures of the format's version, and the values that readers must find in them.

Run as ``python tests/make_fixture.py``; what is there is replaced. Once the version is released, later code must decode
them to the values beside them, so they are then no longer made anew.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from hmkcta.axes import Axis, mode_sizes
from hmkcta.hmkfile import VERSION, encode
from hmkcta.packed import LevelQuality, Metadata, PackedLevel
from literal_decode import element
from random_models import Shapes, random_model

FIXTURES = Path(__file__).parent / "fixtures"

Model = tuple[Metadata, tuple[PackedLevel, ...]]


def small_model() -> Model:
    """Two modes, one stage, one node, one of its modes undecomposed: the least there is."""
    axes = (Axis("höhe", 4, "space", np.array([0.0, 0.5, 1.0, 2.5]), "µm"), Axis("t", 3, "time"))
    metadata, stages = random_model(
        np.random.default_rng(7),
        (4, 3),
        1,
        (1,),
        axes=axes,
        coded=1.0,
        organisation=(("höhe",), ("t",)),
        shapes=Shapes(1, 1, 2, zero=0.0),
    )
    exact = LevelQuality(float("inf"), 0.0, 0.0)
    return replace(metadata, kind="volume", seed=7, quality=(exact,), source={}), stages


def merged_model() -> Model:
    """Four axes in three modes, time undecomposed, a cut stage between two with clusters, coordinates as sections."""
    directions = np.random.default_rng(3).normal(size=(24, 3)).astype(np.float32)
    axes = (
        Axis("light", 24, "light", directions, "unit vectors"),
        Axis("texel", 6, "space"),
        Axis("frame", 2, "time", np.array([0.0, 0.04]), "s"),
        Axis("rgb", 3, "channel"),
    )
    organisation = (("light", "rgb"), ("texel",), ("frame",))
    metadata, stages = random_model(
        np.random.default_rng(4),
        mode_sizes(axes, organisation),
        3,
        (2,),
        axes=axes,
        organisation=organisation,
        shapes=Shapes(2, 2, 2, 4, 0.15, 0.25),
        coded=1.0,
        cuts=(2,),
    )
    return replace(metadata, kind="svbrdf", source_dtype="float16", source={"file": "a \\ \u00e9.npy"}), stages


def own_model() -> Model:
    """Modes undecomposed node by node, cut nodes among others, clusters of two and three, a transform."""
    axes = (Axis("y", 7, "space"), Axis("x", 5, "space"), Axis("light", 4, "light"))
    shapes = Shapes(3, 3, 3, 8, zero=0.1, leaf=0.2, cut=0.3, own=0.3)
    metadata, stages = random_model(np.random.default_rng(20), (7, 5, 4), 3, axes=axes, shapes=shapes, coded=1.0)
    return replace(metadata, kind="generic", transform={"name": "asinh", "scale": 0.5}), stages


def half_model() -> Model:
    """Float16 numbers at one stage, coded ones at the other, after a cut of the root."""
    axes = (Axis("y", 9, "space"), Axis("x", 7, "space"), Axis("t", 2, "time"))
    shapes = Shapes(3, 2, 2, 6, zero=0.1, leaf=0.2)
    metadata, stages = random_model(
        np.random.default_rng(7),
        (63, 2),
        3,
        (1,),
        axes=axes,
        cuts=(1,),
        organisation=(("y", "x"), ("t",)),
        shapes=shapes,
        coded=0.5,
    )
    return replace(metadata, kind="volume", seed=12), stages


MODELS: dict[str, Callable[[], Model]] = {
    "small": small_model,
    "merged": merged_model,
    "own": own_model,
    "half": half_model,
}


def values_of(metadata: Metadata, stages: tuple[PackedLevel, ...]) -> list[list[float]]:
    """Some elements of the tensor of modes: indices, then values up to each stage before the inverse transform."""
    sizes = mode_sizes(metadata.axes, metadata.organisation)
    rng = np.random.default_rng(0)
    points = [[int(rng.integers(size)) for size in sizes] for _ in range(20)]
    return [[*point, *(element(stages, point, upto) for upto in range(1, len(stages) + 1))] for point in points]


def write_fixtures() -> None:
    """All files, each with what to find in it."""
    FIXTURES.mkdir(exist_ok=True)
    for name, make in MODELS.items():
        metadata, stages = make()
        path = FIXTURES / f"v{VERSION}-{name}.hmk"
        path.write_bytes(b"".join(encode(metadata, stages)))
        shapes = [stage.shape.tolist() for stage in stages]
        expected = {"elements": values_of(metadata, stages), "shape": shapes, "modes": len(metadata.organisation)}
        path.with_suffix(".json").write_text(json.dumps(expected) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write_fixtures()
