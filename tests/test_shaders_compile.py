"""Every shader compiles with naga (wgpu) and with Tint (Dawn, as in Chromium), and Tint's gives the same values."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from gpu_tools import KINDS, Kind, adapter, job, random_indices, run_in_dawn
from hmkcta import Model
from hmkcta.render.device import spread
from hmkcta.render.frame_contraction import contraction_constants, contraction_shader
from hmkcta.render.gpu_decode import picked_words
from hmkcta.render.gpu_svbrdf import constants
from hmkcta.render.image import pack_image
from hmkcta.render.prelude import Options, compose, compose_picked, decoder_uniform, image_pages, prelude, shader
from hmkcta.render.tree import Tree, tree_of
from hmkcta.render.weighted import decode_picked
from make_prelude_corpus import CORPUS, corpus
from test_shaders import CLOSE, error, fitting, random_picks

SHADERS = Path(__file__).parent.parent / "python" / "hmkcta" / "shaders"


@dataclass(frozen=True)
class Pass:
    """What a pass is put together from before its own file: nothing, or the prelude and pieces of the decoder."""

    pieces: tuple[str, ...] = ()
    channels: tuple[int, ...] = (1,)


PLAIN, WEIGHTED = ("image", "decode"), ("image", "decode", "picks", "weighted")
PIECES = {*PLAIN, *WEIGHTED}
CONTRACTION = {"contract"}
PASSES = {
    "elements": Pass(PLAIN),
    "picked": Pass(WEIGHTED, (1, 3)),
    "svbrdf": Pass(WEIGHTED, (1, 3)),
    "grid": Pass(WEIGHTED),
    "gbuffer": Pass(),
    "lightfield": Pass(),
    "volume": Pass(),
    "display": Pass(),
    "peak": Pass(),
}
#: What a shader is built for decides about its text: all of these, for every pass that decodes.
BUILT_FOR = [kind for kind in KINDS if kind.name in
             ("one-mode", "pca", "order-8", "folded-colour", "merged-texels", "time-undecomposed", "blocks-merged")]


def plain_tree(model: Model) -> Tree:
    """The tree, without loops with constant bounds."""
    return replace(tree_of(model.metadata, model.stages), uniform=())


def contraction(kind: Kind) -> str:
    """The pass that contracts the last mode."""
    model = kind.model()
    options = Options(contracted=(len(model.metadata.organisation) - 1,))
    tree = plain_tree(model)
    constants = contraction_constants(tree, model.stages, pack_image(model.stages), options)
    return contraction_shader(prelude(tree, 1), constants)


def texts() -> dict[str, str]:
    """All shaders, put together for several models and options."""
    made = {f"contract of {kind.name}": contraction(kind) for kind in BUILT_FOR}
    for name, built in PASSES.items():
        if not built.pieces:
            made[name] = shader(name)
            continue
        for kind in BUILT_FOR:
            model = kind.model()
            picks = fitting(model, 3) if built.pieces == WEIGHTED else None
            for channels, pages in product(built.channels, (1, 5)):
                head = prelude(tree_of(model.metadata, model.stages), pages, Options(picks, channels))
                head += constants(angles=pages == 1, fixed=channels == 3) if name == "svbrdf" else ""
                made[f"{name} of {kind.name}, {channels} channels, {pages} pages"] = compose(head, *built.pieces, name)
    return made


def test_every_file_is_compiled() -> None:
    assert {path.stem for path in SHADERS.glob("*.wgsl")} == PIECES | CONTRACTION | PASSES.keys()


def test_naga_takes_every_shader(tmp_path: Path) -> None:
    adapter()
    # In a process of its own: naga has been seen to abort on a shader that it should have refused.
    listed = tmp_path / "shaders.json"
    listed.write_text(json.dumps(texts()), encoding="utf-8")
    program = (
        "import json, sys\n"
        "from hmkcta.render.device import open_device\n"
        "gpu = open_device().gpu\n"
        "for name, code in json.load(open(sys.argv[1])).items():\n"
        "    sys.stderr.write(f'compiling {name}\\n')\n"
        "    gpu.create_shader_module(label=name, code=code)\n"
    )
    done = subprocess.run([sys.executable, "-c", program, str(listed)], capture_output=True, text=True, timeout=170,
                          check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    assert done.stderr.count("compiling") == len(texts())


def test_tint_takes_every_shader(tmp_path: Path) -> None:
    run_in_dawn([job(code) for code in texts().values()], tmp_path)


def buffers(model: Model, level: int, page_shift: int = 25) -> tuple[int, list[tuple[str, bytes]]]:
    """Pages of the image, and group 0."""
    words = pack_image(model.stages).words
    pages = image_pages(words.size, page_shift)
    parts = [words[page << page_shift:(page + 1) << page_shift] for page in range(pages)]
    stored = [("read-only-storage", part.tobytes()) for part in parts]
    return pages, [("uniform", decoder_uniform(model.metadata, level)), *stored]


def test_tint_decodes_elements(tmp_path: Path) -> None:
    jobs: list[dict[str, Any]] = []
    expected: list[NDArray[np.float32]] = []
    for kind in KINDS:
        model = kind.model()
        indices = random_indices(model, 500)
        for level in range(1, len(model.levels) + 1):
            pages, decoder = buffers(model, level)
            head = prelude(tree_of(model.metadata, model.stages), pages)
            code = compose(head, "image", "decode", "elements")
            lists = [("read-only-storage", indices.astype(np.uint32).tobytes()), ("storage", bytes(4 * len(indices)))]
            jobs.append(job(code, "decode_elements", [decoder, lists], spread(-(-len(indices) // 64))))
            expected.append(model.at_level(level)[tuple(indices.T)])
    for found, values in zip(run_in_dawn(jobs, tmp_path), expected, strict=True):
        assert error(found.view(np.float32), values) <= CLOSE


@pytest.mark.parametrize("channels", [1, 3])
def test_tint_decodes_weighted_sums(tmp_path: Path, channels: int) -> None:
    jobs: list[dict[str, Any]] = []
    expected: list[NDArray[np.float32]] = []
    for kind in KINDS if channels == 1 else [kind for kind in KINDS if kind.sizes[4:5] == (3,)]:
        model = kind.model(seed=4)
        counts = fitting(model, 2) if channels == 1 else (3, 1, 2, 1, 3, 1)[: model.ndim]
        picks = random_picks(model, counts, 100, channel=4 if channels == 3 else None)
        pages, decoder = buffers(model, len(model.levels))
        head = prelude(plain_tree(model), pages, Options(counts, channels))
        wanted = picked_words(picks, max(counts))
        lists = [("read-only-storage", wanted.tobytes()), ("storage", bytes(400 * channels))]
        code = compose_picked(head, "picked")
        jobs.append(job(code, "decode_sums", [decoder, lists], (2, 1, 1)))
        expected.append(decode_picked(model, picks).reshape(-1))
    for found, values in zip(run_in_dawn(jobs, tmp_path), expected, strict=True):
        assert error(found.view(np.float32), values) <= CLOSE


def test_several_pages_in_tint(tmp_path: Path) -> None:
    model = Kind("paged", (7, 6, 5, 4)).model()
    words = pack_image(model.stages).words.size
    shift = int(np.ceil(np.log2(words / 3)))
    indices = random_indices(model, 300)
    pages, decoder = buffers(model, 3, shift)
    assert pages > 1
    code = compose(prelude(plain_tree(model), pages, Options(page_shift=shift)), "image", "decode", "elements")
    lists = [("read-only-storage", indices.astype(np.uint32).tobytes()), ("storage", bytes(4 * len(indices)))]
    found = run_in_dawn([job(code, "decode_elements", [decoder, lists], (5, 1, 1))], tmp_path)[0]
    assert error(found.view(np.float32), model[tuple(indices.T)]) <= CLOSE


def test_the_corpus_of_preludes_is_what_the_package_makes() -> None:
    assert CORPUS.read_text(encoding="utf-8") == corpus()
