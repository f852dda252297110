"""The image as `docs/rendering.md` has it: a reader of nothing but its words finds every element."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import prod

import numpy as np
import pytest

from hmkcta.decode import decode_elements
from hmkcta.packed import level_ends
from hmkcta.render.image import LEAF, U32, pack_image
from literal_decode import flat
from random_models import Shapes, random_model

SIZES = (7, 3, 6, 5)


def without(numbers: list[int], n: int) -> list[int]:
    """All but number n."""
    return [*numbers[:n], *numbers[n + 1 :]]


class Words:
    """A decoder by the text of `docs/rendering.md`, section The image."""

    def __init__(self, words: U32) -> None:
        self.words = [int(word) for word in words]

    def half(self, address: int) -> float:
        """A float16 number."""
        word = self.words[address >> 1]
        bits = word >> 16 if address & 1 else word & 0xFFFF
        return float(np.uint16(bits).view(np.float16))

    def modes(self, node: int) -> list[list[int]]:
        """C, K, R, address of the row records and of the basis, mode by mode."""
        order = len(SIZES)
        return [self.words[node + 3 + 5 * n : node + 8 + 5 * n] for n in range(order)]

    def element(self, index: Sequence[int], levels: int) -> float:
        """One element, in the domain of the value transform."""
        node, place, value = 0, list(index), 0.0
        for _ in range(levels):
            modes = self.modes(node)
            if modes[0][0] == 0:
                break
            if modes[0][2]:  # no cut
                value += self.added(node, place)
            if self.words[node] == LEAF:
                break
            parts = [0] * len(modes)
            for n, (clusters, mixture, _, rows, _) in enumerate(modes):
                if clusters > 1:
                    record = rows + place[n] * (2 + mixture)
                    parts[n], place[n] = self.words[record], self.words[record + 1]
            node = self.words[node] + flat(parts, [mode[0] for mode in modes]) * (3 + 5 * len(modes))
        return value

    def added(self, node: int, place: Sequence[int]) -> float:
        """What a node adds to the element at these places in it."""
        clusters, mixtures, ranks, rows, bases = ([mode[i] for mode in self.modes(node)] for i in range(5))
        value = 0.0
        for choice in product(*(range(max(1, mixture)) for mixture in mixtures)):
            cluster = [0 if not mixtures[n] else self.words[rows[n] + place[n] * (2 + mixtures[n]) + 2 + k]
                       for n, k in enumerate(choice)]
            factors: list[list[float]] = []
            for n, k in enumerate(choice):
                others = flat(without(cluster, n), without(clusters, n))
                subset = (place[n] * mixtures[n] + k) * prod(without(clusters, n)) + others
                factors.append([float(r == place[n]) if not mixtures[n] else
                                self.half(bases[n] + subset * ranks[n] + r) for r in range(ranks[n])])
            cell = flat(cluster, clusters)
            scale = float(np.uint32(self.words[self.words[node + 2] + cell]).view(np.float32))
            core = self.words[node + 1] + cell * prod(ranks)
            value += scale * sum(self.half(core + flat(r, ranks)) * prod(f[i] for f, i in zip(factors, r, strict=True))
                                 for r in product(*map(range, ranks)))
        return value


@pytest.mark.parametrize(("undecomposed", "shapes", "cuts"), [
    ((), Shapes(zero=0.1, leaf=0.1), ()), ((1,), Shapes(zero=0.1, leaf=0.1), ()), ((0, 3), Shapes(), ()),
    ((), Shapes(own=0.4), ()), ((), Shapes(own=0.4), (1,)), ((1,), Shapes(own=0.2), (2,)), ((), Shapes(), (1, 2)),
])
def test_words_alone_tell_every_element(undecomposed: tuple[int, ...], shapes: Shapes, cuts: tuple[int, ...]) -> None:
    _, stages = random_model(np.random.default_rng(3), SIZES, 3, undecomposed, shapes=shapes, cuts=cuts)
    words = Words(pack_image(stages).words)
    coords = np.random.default_rng(4).integers(SIZES, size=(40, len(SIZES)))
    for upto, end in enumerate(level_ends(stages), 1):
        found = [words.element(index, end) for index in coords.tolist()]
        expected = decode_elements(stages, SIZES, coords, upto, np.float64)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_an_undecomposed_mode_has_neither_rows_nor_numbers() -> None:
    _, stages = random_model(np.random.default_rng(3), SIZES, 2, (1,))
    with_rows = pack_image(stages)
    assert Words(with_rows.words).modes(0)[1][:3] == [1, 0, SIZES[1]]
    rows = sum(int(offset[-1]) * 2 + cluster.size for stage in stages
               for n, (offset, cluster) in enumerate(zip(stage.row_offset, stage.cluster, strict=True)) if n != 1)
    empty = sum(2 * int(offset[s + 1] - offset[s]) for stage in stages for s in np.flatnonzero(~stage.has_cells)
                for n, offset in enumerate(stage.row_offset) if n != 1)
    assert with_rows.scales - with_rows.rows == rows - empty
