"""Write `corpus-render/prelude.json`: preludes and images that the Python package and the viewer must make alike.

Run as ``python tests/make_prelude_corpus.py`` when the prelude or the image changes on purpose. The models are in it,
array by array.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from math import ceil, log2
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from hmkcta.axes import Axis, mode_sizes
from hmkcta.model import Model
from hmkcta.packed import LevelBounds, Metadata, PackedLevel
from hmkcta.render.frame_contraction import (
    contractable,
    contraction_constants,
    core_starts,
    fixed_rows,
    fold_channels,
    parent_table,
)
from hmkcta.render.image import Image, pack_image
from hmkcta.render.paying_modes import pixel_cost
from hmkcta.render.prelude import Options, axis_places, decoder_uniform, image_pages, prelude
from hmkcta.render.tree import Tree, tree_of
from literal_decode import element
from random_models import Shapes, random_model

CORPUS = Path(__file__).parent / "corpus-render" / "prelude.json"

#: Axes, organisation, stages, undecomposed modes, shapes, cuts.
_LIGHTS = (Axis("light", 4, "light"), Axis("y", 5, "space"), Axis("x", 4, "space"), Axis("rgb", 3, "channel"))
_THREE = (("light", "rgb"), ("y",), ("x",))
_TWO = (Axis("y", 7, "space"), Axis("x", 5, "space"))
_OWN = Shapes(2, 2, 3, 6, 0.1, 0.2, own=0.4)
MODELS: dict[str, tuple[Any, ...]] = {
    "small": (_TWO, (("y",), ("x",)), 2, (), Shapes(2, 2, 3, 4), ()),
    "merged": (_LIGHTS, _THREE, 3, (), Shapes(2, 2, 3, 6), ()),
    "colours undecomposed": (_LIGHTS, _THREE, 2, (0,), Shapes(2, 2, 3, 6), ()),
    "own undecomposed": (_LIGHTS, _THREE, 2, (), _OWN, ()),
    "blocks": (_LIGHTS, (("light", "rgb"), ("y", "x")), 2, (), Shapes(2, 1, 3, 8, 0, own=0.4), (1,)),
    "blocks below a level": (_LIGHTS, _THREE, 3, (2,), Shapes(2, 1, 3, 8, 0, own=0.2), (2,)),
}
#: Model, options (a page shift of 0 stands for the one that makes four pages or fewer), and stages to be taken for
#: uniform, if not those that are; a last entry is a rank that all modes of all stages are taken to have.
CASES: tuple[tuple[Any, ...], ...] = (
    ("small", Options(), None),
    ("small", Options(picks=(2, 2), page_shift=0), None),
    ("merged", Options(), None),
    ("merged", Options(picks=(3, 2, 2, 3), channels=3), None),
    ("merged", Options(picks=(1, 2, 2, 1), contracted=(2,)), None),
    ("merged", Options(page_shift=0), None),
    ("small", Options(picks=(1, 2), contracted=(1,)), None),
    ("merged", Options(picks=(2, 1, 1, 2), contracted=(0, 1)), None),
    ("merged", Options(picks=(3, 2, 2, 3), channels=3, contracted=(2,)), (0, 1, 2)),
    ("merged", Options(picks=(2, 2, 1, 2), contracted=(2,)), (1, 2)),
    ("small", Options(picks=(2, 2), contracted=(1,)), (0, 1)),
    ("small", Options(picks=(9, 2), contracted=(1,)), (0, 1), 5),
    ("merged", Options(picks=(3, 2, 2, 3), channels=3, contracted=(2,)), (0, 1, 2), 6),
    ("merged", Options(picks=(3, 1, 1, 3), channels=3, contracted=(0, 1)), None),
    ("merged", Options(picks=(3, 2, 2, 3), channels=3, contracted=(0,)), (0, 1, 2), 4),
    ("colours undecomposed", Options(picks=(3, 2, 2, 3), channels=3), None),
    ("colours undecomposed", Options(picks=(3, 2, 2, 3), channels=3), (0,)),
    ("colours undecomposed", Options(picks=(3, 2, 2, 3), channels=3, contracted=(0,)), (0, 1)),
    ("own undecomposed", Options(picks=(3, 2, 2, 3), channels=3), None),
    ("own undecomposed", Options(picks=(3, 2, 2, 3), channels=3, contracted=(0,)), None),
    ("blocks", Options(), None),
    ("blocks", Options(picks=(3, 2, 2, 3), channels=3), None),
    ("blocks", Options(picks=(3, 2, 2, 3), channels=3), (1,)),
    ("blocks", Options(picks=(2, 2, 2, 3), contracted=(1,)), None),
    ("blocks below a level", Options(picks=(3, 2, 2, 3), channels=3), None),
    ("blocks below a level", Options(picks=(3, 2, 2, 3), channels=3, contracted=(0, 2)), None),
)
#: Options, and the modes that are taken to be undecomposed, of a single cell with other ranks than its model's.
SINGLE: tuple[tuple[Options, tuple[int, ...]], ...] = (
    (Options(picks=(3, 2, 2, 3), channels=3), ()),
    (Options(picks=(3, 2, 2, 3), channels=3), (0,)),
    (Options(picks=(3, 2, 2, 1)), (1,)),
    (Options(picks=(3, 2, 2, 3), channels=3, contracted=(0,)), ()),
    (Options(picks=(3, 2, 2, 1), contracted=(1, 2)), ()),
    (Options(picks=(3, 2, 2, 3), channels=3, contracted=(0, 1, 2)), ()),
)
#: Elements of each model whose values are told.
_ELEMENTS = 12


def made(name: str) -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """A model of the corpus."""
    axes, organisation, stages, undecomposed, shapes, cuts = MODELS[name]
    rng = np.random.default_rng([*map(ord, name)])
    return random_model(rng, mode_sizes(axes, organisation), stages, undecomposed, axes=axes,
                        organisation=organisation, shapes=shapes, cuts=cuts)


def told(name: str) -> dict[str, Any]:
    """A model for the viewer: its metadata, its arrays, and some elements up to each stage."""
    metadata, stages = made(name)
    sizes = mode_sizes(metadata.axes, metadata.organisation)
    coords = np.random.default_rng(1).integers(sizes, size=(_ELEMENTS, len(sizes))).tolist()
    return {
        "axes": [{"name": axis.name, "size": axis.size, "role": axis.role} for axis in metadata.axes],
        "organisation": metadata.organisation, "sizes": sizes,
        "bounds": [_bounds(bounds) for bounds in metadata.stages], "stages": [_arrays(stage) for stage in stages],
        "elements": [{"rows": rows, "values": [element(stages, rows, upto) for upto in range(1, len(stages) + 1)]}
                     for rows in coords],
    }


def _bounds(bounds: LevelBounds) -> dict[str, Any]:
    return {"clusters": bounds.clusters, "mixture": bounds.mixture, "ranks": bounds.ranks, "scheme": bounds.scheme}


def _arrays(stage: PackedLevel) -> dict[str, Any]:
    def numbers(array: NDArray[Any] | None) -> list[Any] | None:
        if array is None:
            return None
        return (array.view(np.uint16) if array.dtype == np.float16 else array).reshape(-1).tolist()

    plain = {"shape": stage.shape, "child": stage.child, "core": stage.core, "coreOffset": stage.core_offset,
             "coreScale": stage.core_scale, "cellOffset": stage.cell_offset}
    modes = {"rowOffset": stage.row_offset, "cluster": stage.cluster, "clusterOffset": stage.cluster_offset,
             "basis": stage.basis, "basisOffset": stage.basis_offset, "part": stage.part, "local": stage.local}
    return {"nodes": stage.nodes, "order": stage.order, **{key: numbers(array) for key, array in plain.items()},
            **{key: [numbers(array) for array in arrays] for key, arrays in modes.items()}}


def case(name: str, options: Options, taken: tuple[int, ...] | None, rank: int | None = None) -> dict[str, Any]:
    """What both languages must make of a model."""
    metadata, stages = made(name)
    shown = metadata if rank is None else replace(metadata, stages=tuple(
        replace(stage, ranks=(rank,) * len(stage.ranks)) for stage in metadata.stages))
    image, found = pack_image(stages), tree_of(metadata, stages)
    tree = replace(found, metadata=shown, uniform=found.uniform if taken is None else taken,
                   ranks=found.ranks if rank is None else (rank,) * found.order)
    if not options.page_shift:
        options = Options(options.picks, options.channels, options.contracted, ceil(log2(image.words.size / 4)))
    pages = image_pages(image.words.size, options.page_shift)
    return {"model": name, "options": asdict(options), "pages": pages, "uniform_stages": found.uniform,
            "taken": tree.uniform, "rank": rank, "text": prelude(tree, pages, options),
            "words": image.words.size, "crc32": crc32(image.words.astype("<u4").tobytes()), "rows": image.rows,
            "scales": image.scales, "coefficients": image.coefficients,
            "uniform": decoder_uniform(metadata, len(metadata.levels)).hex(),
            "cost": None if options.picks is None else pixel_cost(tree, options),
            "contraction": contraction(found, stages, image, options) if options.contracted else None}


def contraction(tree: Tree, stages: Sequence[PackedLevel], image: Image, options: Options) -> dict[str, Any]:
    """What the contraction of a frame needs: for each axis of the modes its first indices stand still."""
    assert options.picks is not None
    metadata = tree.metadata
    modes, _ = axis_places(metadata)
    still = [axis for axis, mode in enumerate(modes) if mode in options.contracted]
    assert contractable(Model(metadata, tuple(stages)), still) == options.contracted
    channels = fold_channels(metadata, options)
    picks = {axis: (list(range(options.picks[axis])), [0.5 ** (1 + k) for k in range(options.picks[axis])])
             for axis in still}
    return {"still": still, "constants": contraction_constants(tree, stages, image, options),
            "starts": core_starts(stages, options.contracted, channels).tolist(),
            "parents": parent_table(stages).reshape(-1).tolist(),
            "fixed": crc32(fixed_rows(metadata, options.contracted, picks).astype("<u4").tobytes())}


def single(number: int, options: Options, undecomposed: tuple[int, ...]) -> dict[str, Any]:
    """The prelude of a model of one cell; it need not be that of a model that there is."""
    metadata, _ = made("merged")
    order = len(metadata.organisation)
    ranks = tuple((6 + number + 3 * n) for n in range(order))
    mixture = tuple(int(n not in undecomposed) for n in range(order))
    shown = replace(metadata, stages=(LevelBounds((1,) * order, mixture, ranks, "most"),))
    kept = tuple(rank * k for rank, k in zip(ranks, mixture, strict=True))
    tree = Tree(shown, undecomposed, (), tuple(range(order)), cuts=False, uniform=(0,), ranks=kept)
    text = prelude(tree, 1, options)
    assert "fn decode_picked(" in text
    return {"model": "merged", "options": asdict(options), "bounds": _bounds(shown.stages[0]), "kept": kept,
            "undecomposed": undecomposed, "text": text, "cost": pixel_cost(tree, options)}


def corpus() -> str:
    """The text of the corpus."""
    written = {"models": {name: told(name) for name in MODELS}, "heads": [case(*given) for given in CASES],
               "single": [single(number, *given) for number, given in enumerate(SINGLE)]}
    return json.dumps(written, indent=None, separators=(",", ":")).replace('{"model":', '\n{"model":') + "\n"


if __name__ == "__main__":
    CORPUS.write_text(corpus(), encoding="utf-8")
