"""Write the committed fixtures of the current format version; files that are there are never written again.

Run as ``python tests/make_fixture.py`` after a new version is released. Later code must decode them to the values
that were written down beside them, so they are evidence only as long as nobody regenerates them. Those of version 1.0
were made of `small_model` and `merged_model`, those of 1.1 of `eight_model` and `mixed_model`, those of 1.2 also
of `lone_model`. Version 1.3 was never released, so it has none.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hmk_corpus import apply_edit
from hmkcta.axes import Axis, mode_sizes
from hmkcta.hmkfile import VERSION, check_output, encode, loads, prefix, save
from hmkcta.narrow import U8
from hmkcta.packed import LevelQuality, Metadata, PackedLevel
from hmkcta.parameters import of_basis_numbers, of_core_numbers
from literal_decode import element
from random_models import Shapes, random_model

FIXTURES = Path(__file__).parent / "fixtures"


def small_model() -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """Two modes, one of them undecomposed, two levels, names and units beyond ASCII."""
    axes = (Axis("höhe", 4, "space", np.array([0.0, 0.5, 1.0, 2.5]), "µm"), Axis("t", 3, "time"))
    metadata, levels = random_model(np.random.default_rng(342), (4, 3), 2, (1,), axes=axes,
                                    organisation=(("höhe",), ("t",)), shapes=Shapes(max_rank=2, zero=0.3, leaf=0.0))
    exact = LevelQuality(float("inf"), 0.0, 0.0)
    return replace(metadata, kind="volume", seed=7, quality=(metadata.quality[0], exact)), levels


def merged_model() -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """Four axes in three modes, colour folded into light, time undecomposed, three levels, coordinates as arrays."""
    directions = np.random.default_rng(3).normal(size=(24, 3)).astype(np.float32)
    axes = (Axis("light", 24, "light", directions, "unit vectors"), Axis("texel", 6, "space"),
            Axis("frame", 2, "time", np.array([0.0, 0.04]), "s"), Axis("rgb", 3, "channel"))
    organisation = (("light", "rgb"), ("texel",), ("frame",))
    metadata, levels = random_model(np.random.default_rng(302), mode_sizes(axes, organisation), 3, (2,), axes=axes,
                                    organisation=organisation, shapes=Shapes(2, 2, 2, 4, 0.15, 0.25))
    return replace(metadata, kind="svbrdf", source_dtype="float16"), levels


def eight_model() -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """Two modes, one of them undecomposed, two levels, all numbers in eight bits."""
    axes = (Axis("x", 5, "space", np.array([0.0, 0.5, 1.0, 2.5, 3.0]), "mm"), Axis("t", 3, "time"))
    metadata, levels = random_model(np.random.default_rng(342), (5, 3), 2, (1,), axes=axes,
                                    organisation=(("x",), ("t",)), eight_from=1,
                                    shapes=Shapes(max_rank=2, zero=0.3, leaf=0.0))
    return replace(metadata, kind="volume", seed=8), levels


def mixed_model() -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """Four axes in three modes, one of them undecomposed, three levels, numbers in eight bits from level 2 on."""
    axes = (Axis("light", 8, "light"), Axis("texel", 7, "space"), Axis("frame", 2, "time"), Axis("rgb", 3, "channel"))
    organisation = (("light", "rgb"), ("texel",), ("frame",))
    metadata, levels = random_model(np.random.default_rng(306), mode_sizes(axes, organisation), 3, (2,), axes=axes,
                                    organisation=organisation, eight_from=2, shapes=Shapes(2, 2, 2, 4, 0.15, 0.25))
    return replace(metadata, kind="svbrdf"), levels


def lone_model() -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """Three modes, one of them undecomposed, three levels of bytes, each row in one cluster, all in order.

    So parts and positions are left out, and clusters where there is one.
    """
    axes = (Axis("y", 9, "space"), Axis("x", 7, "space"), Axis("t", 2, "time"))
    metadata, levels = random_model(np.random.default_rng(10), (9, 7, 2), 3, (2,), axes=axes, eight_from=1,
                                    shapes=Shapes(3, 1, 3, zero=0.2, leaf=0.2, tidy=True))
    return replace(metadata, kind="volume", seed=12), levels


def packed_model() -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """Two modes, one of them undecomposed, two packed levels, spare bits at the end.

    Nodes of one level have different ranks, one is zero; parameters are the least, the largest and others.
    """
    axes = (Axis("x", 5, "space", np.array([0.0, 0.5, 1.0, 2.5, 3.0]), "mm"), Axis("t", 3, "time"))
    metadata, levels = random_model(np.random.default_rng(12265), (5, 3), 2, (1,), axes=axes,
                                    organisation=(("x",), ("t",)), eight_from=1, packed_share=1.0,
                                    shapes=Shapes(max_rank=3, zero=0.3, leaf=0.0))
    return replace(metadata, kind="volume", seed=13), levels


def partly_model() -> tuple[Metadata, tuple[PackedLevel, ...]]:
    """As the mixed model, but level 2 is packed, level 3 in bytes."""
    axes = (Axis("light", 8, "light"), Axis("texel", 7, "space"), Axis("frame", 2, "time"), Axis("rgb", 3, "channel"))
    organisation = (("light", "rgb"), ("texel",), ("frame",))
    metadata, levels = random_model(np.random.default_rng(1971), mode_sizes(axes, organisation), 3, (2,), axes=axes,
                                    organisation=organisation, eight_from=2, packed_share=0.5,
                                    shapes=Shapes(2, 2, 2, 4, 0.15, 0.25))
    return replace(metadata, kind="svbrdf"), levels


def any_bits() -> bytes:
    """Three modes in two packed levels, whose core and basis numbers are any codes, spare bits too.

    So core numbers have more digits than float16, numbers of few bits are in 16, and what has more than these is not:
    no writer that begins with float16 numbers would write that.
    """
    shapes = Shapes(2, 2, 3, 4, zero=0.0, leaf=0.0)
    metadata, levels = random_model(np.random.default_rng(341), (6, 5, 4), 2, shapes=shapes, eight_from=1,
                                    packed_share=1.0)
    data, rng = b"".join(encode(replace(metadata, seed=14), levels)), np.random.default_rng(0)
    for level, packed in enumerate(levels, 1):
        for name, _ in packed.wide():
            codes = any_codes(rng, parameters_of(packed, name)).tolist()
            data = apply_edit(data, {"op": "array-set", "name": prefix(level) + name, "dtype": "U8",
                                     "shape": [len(codes)], "values": codes})
    return data


def any_codes(rng: np.random.Generator, parameters: U8) -> U8:
    """Codes of numbers of these parameters, any bits: the first sequence and the second, filled up to whole bytes."""
    zeros = rng.integers(13, size=parameters.size)
    places = np.cumsum(zeros + 1)
    first = np.isin(np.arange(places[-1] if places.size else 0), places - 1)
    second = rng.integers(2, size=int(np.where(zeros < 12, parameters, 16).sum()))
    filled = [np.append(bits, rng.integers(2, size=-bits.size % 8)).astype(np.uint8)
              for bits in (first.astype(np.int64), second)]
    return np.concatenate([np.packbits(bits, bitorder="little") for bits in filled])


def parameters_of(level: PackedLevel, name: str) -> U8:
    """The parameter of each number of an array of a packed level."""
    if name == "core":
        return of_core_numbers(level.rice, level.shape)
    n = int(name.split("/")[1])
    entries, starts = level.rice[n], level.basis_offset[n]
    assert entries is not None
    assert starts is not None
    return of_basis_numbers(entries, level.shape[:, 2, n], np.diff(starts.astype(np.int64)))


def expectations(metadata: Metadata, levels: tuple[PackedLevel, ...]) -> dict[str, Any]:
    """What a reader of any language must find: some elements up to each level, by section 4 of the specification."""
    sizes = mode_sizes(metadata.axes, metadata.organisation)
    rng = np.random.default_rng(0)
    indices = [[int(rng.integers(size)) for size in sizes] for _ in range(24)]
    values = [[element(levels, index, upto) for upto in range(1, len(levels) + 1)] for index in indices]
    return {"mode_sizes": list(sizes), "nodes": [level.nodes for level in levels],
            "numbers": [level.numbers() for level in levels], "indices": indices, "values": values}


def write_fixtures(folder: Path) -> None:
    """Write the fixtures with their expectations.

    Raises:
        HmkctaError: ``output-exists``, as a fixture once written stays as it is.
    """
    for name, model in (("packed", packed_model()), ("partly", partly_model()), ("bits", loads(any_bits()))):
        path = folder / f"v{VERSION}-{name}.hmk"
        if name == "bits":
            check_output(path, overwrite=False)
            path.write_bytes(any_bits())
        else:
            save(path, *model)
        path.with_suffix(".json").write_text(json.dumps(expectations(*model)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    write_fixtures(FIXTURES)
