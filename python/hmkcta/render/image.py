"""The image: all tables and float16 coefficients of a model in one flat array of words, as the shaders read it.

Sections follow one another without gaps: nodes, rows, scales, coefficients, each level by level. Addresses are
absolute, in words, those of float16 numbers in halves (2 a word, the low half first). A node's record is

    child, core, scale, then for each mode C_n, K_n, R_n, rows, basis

with the addresses of its first child's record (`LEAF` for none), its core (half), its core_scale, and for each mode its
row records and its basis (half). A row's record is

    part, local, cluster_0 .. cluster_{K_n - 1}

with the K_n of its node; modes with C_n = 1 and K_n = 0 have none, as all rows go to part 0 and keep their places. Each
float16 array starts at a whole word.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import HmkctaError, Kind
from ..packed import PackedLevel
from .prelude import node_words

U32 = NDArray[np.uint32]

#: A record's `child` where there is none.
LEAF = 0xFFFFFFFF
#: Halves are addressed by 32 bits.
_MOST_WORDS = 1 << 31


@dataclass(frozen=True, eq=False)
class Image:
    """An image and where its sections start.

    Attributes:
        words: all of it.
        rows: start of the row records, behind the nodes'.
        scales: start of the factors of the cores.
        coefficients: for each level the start of its float16 numbers; a last entry is the end.
    """

    words: U32
    rows: int
    scales: int
    coefficients: tuple[int, ...]


def pack_image(levels: Sequence[PackedLevel]) -> Image:
    """Lay out the arrays of a model for the shaders.

    >>> from hmkcta._example import example_level
    >>> image = pack_image([example_level()])
    >>> image.rows, image.scales, image.coefficients, image.words[:3].tolist()
    (13, 28, (29, 33), [4294967295, 58, 28])

    Raises:
        HmkctaError: it would have 2^31 words or more.
    """
    record = node_words(levels[0].order)
    nodes = np.cumsum([0, *(level.nodes * record for level in levels)])
    rows = np.cumsum([nodes[-1], *(_row_words(level, n) for level in levels for n in range(level.order))])
    scales = np.cumsum([rows[-1], *(level.core_scale.size for level in levels)])
    arrays = [[array for _, array in level.wide()] for level in levels]
    halves = [[-(-array.size // 2) for array in level] for level in arrays]
    coefficients = np.cumsum([scales[-1], *(sum(level) for level in halves)])
    if coefficients[-1] >= _MOST_WORDS:
        raise HmkctaError(Kind.RESOURCE_LIMIT, "image-too-large", "model", found=f"{coefficients[-1]} words",
                          allowed=f"fewer than {_MOST_WORDS}", hint="show fewer levels (model.at_level)")
    words = np.zeros(int(coefficients[-1]), np.uint32)
    for number, level in enumerate(levels):
        row_starts = [int(start) for start in rows[number * level.order :][: level.order]]
        array_starts = np.cumsum([coefficients[number], *halves[number]])
        words[nodes[number] : nodes[number + 1]] = _node_records(
            level, int(nodes[number + 1]), row_starts, int(scales[number]), array_starts).reshape(-1)
        for n, start in enumerate(row_starts):
            words[start : start + _row_words(level, n)] = _row_records(level, n)
        words[scales[number] : scales[number + 1]] = level.core_scale.view(np.uint32)
        for array, start in zip(arrays[number], array_starts, strict=False):
            words[start:].view(np.float16)[: array.size] = array
    return Image(words, int(nodes[-1]), int(rows[-1]), tuple(int(start) for start in coefficients))


def _node_records(level: PackedLevel, next_level: int, rows: Sequence[int], scale: int, arrays: NDArray[Any]) -> U32:
    """The records [S, 3 + 5N] of a level, given the starts of the next level's nodes and of its own sections."""
    size = node_words(level.order)
    records = np.zeros((level.nodes, size), np.int64)
    records[:, 0] = LEAF
    if level.child is not None:
        inner = level.child[1:] != level.child[:-1]
        records[inner, 0] = next_level + level.child[:-1][inner].astype(np.int64) * size
    records[:, 1] = 2 * arrays[0] + level.core_offset[:-1]
    records[:, 2] = scale + level.cell_offset[:-1]
    for n in range(level.order):
        mode = records[:, 3 + 5 * n : 8 + 5 * n]
        mode[:, :3] = level.shape[:, :, n]
        words = _row_lengths(level, n)
        mode[:, 3] = rows[n] + np.cumsum(words) - words
        mode[:, 4] = 2 * arrays[1 + n] + level.basis_offset[n][:-1]
    return records.astype(np.uint32)


def _row_lengths(level: PackedLevel, n: int) -> NDArray[np.int64]:
    """Words that the row records of mode n of each node take: 2 + K_n a row, or none, [S]."""
    clusters, mixture, _ = level.shape[:, :, n].T.astype(np.int64)
    return np.diff(level.row_offset[n].astype(np.int64)) * np.where((clusters > 1) | (mixture > 0), 2 + mixture, 0)


def _row_words(level: PackedLevel, n: int) -> int:
    """Words that the row records of mode n take."""
    return int(_row_lengths(level, n).sum())


def _row_records(level: PackedLevel, n: int) -> U32:
    """The row records of mode n of a level, one after the other."""
    part, local = level.part[n], level.local[n]
    counts = np.diff(level.row_offset[n].astype(np.int64))
    clusters, mixture = (np.repeat(level.shape[:, i, n].astype(np.int64), counts) for i in (0, 1))  # of each row
    kept = (clusters > 1) | (mixture > 0)
    records = np.zeros(_row_words(level, n), np.uint32)
    mixture = mixture[kept]
    starts = np.cumsum(2 + mixture) - (2 + mixture)
    if part is not None and local is not None:
        records[starts] = part[kept]
        records[starts + 1] = local[kept]
    # The clusters of all rows stand in the same order in the model and here, with two words before those of each row.
    behind = np.repeat(2 * np.arange(1, len(mixture) + 1), mixture)
    records[np.arange(level.cluster[n].size) + behind] = level.cluster[n]
    return records
