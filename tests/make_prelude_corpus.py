"""Write `corpus-render/prelude.json`: preludes and images that the Python package and the viewer must make alike.

Run as ``python tests/make_prelude_corpus.py`` when the prelude or the image changes on purpose.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from math import ceil, log2
from pathlib import Path
from typing import Any
from zlib import crc32

from hmkcta.hmkfile import load
from hmkcta.render.contraction import uniform_levels
from hmkcta.render.image import pack_image
from hmkcta.render.prelude import Options, decoder_uniform, image_pages, prelude

HERE = Path(__file__).parent
CORPUS = HERE / "corpus-render" / "prelude.json"

#: Fixture, options; a page shift of 0 stands for the one that makes four pages or fewer.
CASES = (
    ("v1.0-small.hmk", Options()),
    ("v1.0-small.hmk", Options(picks=(2, 2), page_shift=0)),
    ("v1.0-merged.hmk", Options()),
    ("v1.0-merged.hmk", Options(picks=(3, 2, 2, 3), channels=3)),
    ("v1.0-merged.hmk", Options(picks=(1, 2, 2, 1), contracted=(2,))),
    ("v1.0-merged.hmk", Options(page_shift=0)),
)


def case(file: str, options: Options) -> dict[str, Any]:
    """What both languages must make of a file."""
    metadata, levels = load(HERE / "fixtures" / file)
    image = pack_image(levels)
    if not options.page_shift:
        options = Options(options.picks, options.channels, options.contracted, ceil(log2(image.words.size / 4)))
    pages = image_pages(image.words.size, options.page_shift)
    uniform = uniform_levels(metadata, levels)
    return {"file": file, "options": asdict(options), "pages": pages, "uniform_levels": uniform,
            "text": prelude(metadata, pages, options, uniform),
            "words": image.words.size, "crc32": crc32(image.words.astype("<u4").tobytes()), "rows": image.rows,
            "scales": image.scales, "coefficients": image.coefficients,
            "uniform": decoder_uniform(metadata, len(levels)).hex()}


def corpus() -> str:
    """The text of the corpus."""
    return json.dumps([case(file, options) for file, options in CASES], indent=1) + "\n"


if __name__ == "__main__":
    CORPUS.write_text(corpus(), encoding="utf-8")
