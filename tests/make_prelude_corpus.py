"""Write `corpus-render/prelude.json`: preludes and images that the Python package and the viewer must make alike.

Run as ``python tests/make_prelude_corpus.py`` when the prelude or the image changes on purpose.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from math import ceil, log2
from pathlib import Path
from typing import Any
from zlib import crc32

from hmkcta.hmkfile import load
from hmkcta.model import Model
from hmkcta.packed import LevelBounds, Metadata, PackedLevel
from hmkcta.render.core_sums import uniform_levels
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

HERE = Path(__file__).parent
CORPUS = HERE / "corpus-render" / "prelude.json"

#: Fixture, options (a page shift of 0 stands for the one that makes four pages or fewer), and levels to be taken for
#: uniform, if not those that are; a last entry is a rank that all modes of all levels are taken to have.
CASES: tuple[tuple[Any, ...], ...] = (
    ("v1.0-small.hmk", Options(), None),
    ("v1.0-small.hmk", Options(picks=(2, 2), page_shift=0), None),
    ("v1.0-merged.hmk", Options(), None),
    ("v1.0-merged.hmk", Options(picks=(3, 2, 2, 3), channels=3), None),
    ("v1.0-merged.hmk", Options(picks=(1, 2, 2, 1), contracted=(2,)), None),
    ("v1.0-merged.hmk", Options(page_shift=0), None),
    ("v1.0-small.hmk", Options(picks=(1, 2), contracted=(1,)), None),
    ("v1.0-merged.hmk", Options(picks=(2, 1, 1, 2), contracted=(0, 1)), None),
    ("v1.0-merged.hmk", Options(picks=(3, 2, 2, 3), channels=3, contracted=(2,)), (0, 1, 2)),
    ("v1.0-merged.hmk", Options(picks=(2, 2, 1, 2), contracted=(2,)), (1, 2)),
    ("v1.0-small.hmk", Options(picks=(2, 2), contracted=(1,)), (0, 1)),
    ("v1.0-small.hmk", Options(picks=(9, 2), contracted=(1,)), (0, 1), 5),
    ("v1.0-merged.hmk", Options(picks=(3, 2, 2, 3), channels=3, contracted=(2,)), (0, 1, 2), 6),
    ("v1.0-merged.hmk", Options(picks=(3, 1, 1, 3), channels=3, contracted=(0, 1)), None),
    ("v1.0-merged.hmk", Options(picks=(3, 2, 2, 3), channels=3, contracted=(0,)), (0, 1, 2), 4),
    ("v1.1-eight.hmk", Options(picks=(2, 2)), None),
    ("v1.1-mixed.hmk", Options(picks=(3, 2, 2, 3), channels=3), None),
)
#: Options, and the modes that are taken to be undecomposed, of a single cell with other ranks than its file's.
SINGLE: tuple[tuple[Options, tuple[int, ...]], ...] = (
    (Options(picks=(3, 2, 2, 3), channels=3), ()),
    (Options(picks=(3, 2, 2, 3), channels=3), (0,)),
    (Options(picks=(3, 2, 2, 1)), (1,)),
    (Options(picks=(3, 2, 2, 3), channels=3, contracted=(0,)), ()),
    (Options(picks=(3, 2, 2, 1), contracted=(1, 2)), ()),
    (Options(picks=(3, 2, 2, 3), channels=3, contracted=(0, 1, 2)), ()),
)



def case(file: str, options: Options, taken: tuple[int, ...] | None, rank: int | None = None) -> dict[str, Any]:
    """What both languages must make of a file."""
    metadata, levels = load(HERE / "fixtures" / file)
    shown = metadata if rank is None else replace(metadata, levels=tuple(
        replace(level, ranks=(rank,) * len(level.ranks)) for level in metadata.levels))
    image = pack_image(levels)
    if not options.page_shift:
        options = Options(options.picks, options.channels, options.contracted, ceil(log2(image.words.size / 4)))
    pages = image_pages(image.words.size, options.page_shift)
    uniform = uniform_levels(metadata, levels)
    return {"file": file, "options": asdict(options), "pages": pages, "uniform_levels": uniform,
            "taken": uniform if taken is None else taken, "rank": rank,
            "text": prelude(shown, pages, options, uniform if taken is None else taken),
            "words": image.words.size, "crc32": crc32(image.words.astype("<u4").tobytes()), "rows": image.rows,
            "scales": image.scales, "coefficients": image.coefficients,
            "uniform": decoder_uniform(metadata, len(levels)).hex(),
            "cost": None if options.picks is None else pixel_cost(shown, options),
            "contraction": contraction(metadata, levels, image, options) if options.contracted else None}


def contraction(metadata: Metadata, levels: Sequence[PackedLevel], image: Image, options: Options) -> dict[str, Any]:
    """What the contraction of a frame needs: for each axis of the modes its first indices stand still."""
    assert options.picks is not None
    modes, _ = axis_places(metadata)
    still = [axis for axis, mode in enumerate(modes) if mode in options.contracted]
    assert contractable(Model(metadata, tuple(levels)), still) == options.contracted
    channels = fold_channels(metadata, options)
    picks = {axis: (list(range(options.picks[axis])), [0.5 ** (1 + k) for k in range(options.picks[axis])])
             for axis in still}
    return {"still": still, "constants": contraction_constants(metadata, levels, image, options),
            "starts": core_starts(levels, options.contracted, channels).tolist(),
            "parents": parent_table(levels).reshape(-1).tolist(),
            "fixed": crc32(fixed_rows(metadata, options.contracted, picks).astype("<u4").tobytes())}


def single(number: int, options: Options, undecomposed: tuple[int, ...]) -> dict[str, Any]:
    """The prelude of a model of one cell; it need not be that of a file."""
    metadata, _ = load(HERE / "fixtures" / "v1.0-merged.hmk")
    order = len(metadata.organisation)
    ranks = tuple((6 + number + 3 * n) for n in range(order))
    bounds = LevelBounds((1,) * order, (1,) * order, ranks, "most")
    shown = replace(metadata, levels=(bounds,), undecomposed=undecomposed)
    text = prelude(shown, 1, options, (0,))
    assert "fn decode_picked(" in text
    return {"file": "v1.0-merged.hmk", "options": asdict(options), "ranks": ranks, "undecomposed": undecomposed,
            "text": text, "cost": pixel_cost(shown, options)}


def corpus() -> str:
    """The text of the corpus."""
    made = {"models": [case(*given) for given in CASES],
            "single": [single(number, *given) for number, given in enumerate(SINGLE)]}
    return json.dumps(made, indent=1) + "\n"


if __name__ == "__main__":
    CORPUS.write_text(corpus(), encoding="utf-8")
