"""The image as `docs/rendering.md` has it: a reader of nothing but its words finds every element."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import prod

import numpy as np
import pytest

from hmkcta.decode import decode_elements
from hmkcta.render.image import LEAF, U32, pack_image
from literal_decode import flat
from random_models import Shapes, random_model

SIZES = (7, 3, 6, 5)


def without(numbers: list[int], n: int) -> list[int]:
    """All but number n."""
    return [*numbers[:n], *numbers[n + 1 :]]


class Words:
    """A decoder by the text of `docs/rendering.md`, section The image, and of `docs/format.md`, section 4."""

    def __init__(self, words: U32, undecomposed: Sequence[int]) -> None:
        self.words, self.undecomposed = [int(word) for word in words], undecomposed

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
            value += self.added(node, place)
            if self.words[node] == LEAF:
                break
            parts = [0] * len(modes)
            for n, (_, mixture, _, rows, _) in enumerate(modes):
                if n not in self.undecomposed:
                    record = rows + place[n] * (2 + mixture)
                    parts[n], place[n] = self.words[record], self.words[record + 1]
            node = self.words[node] + flat(parts, [mode[0] for mode in modes]) * (3 + 5 * len(modes))
        return value

    def added(self, node: int, place: Sequence[int]) -> float:
        """What a node adds to the element at these places in it."""
        clusters, mixtures, ranks, rows, bases = ([mode[i] for mode in self.modes(node)] for i in range(5))
        value = 0.0
        for choice in product(*map(range, mixtures)):
            cluster = [0 if n in self.undecomposed else self.words[rows[n] + place[n] * (2 + mixtures[n]) + 2 + k]
                       for n, k in enumerate(choice)]
            factors: list[list[float]] = []
            for n, k in enumerate(choice):
                others = flat(without(cluster, n), without(clusters, n))
                subset = (place[n] * mixtures[n] + k) * prod(without(clusters, n)) + others
                factors.append([float(r == place[n]) if n in self.undecomposed else
                                self.half(bases[n] + subset * ranks[n] + r) for r in range(ranks[n])])
            cell = flat(cluster, clusters)
            scale = float(np.uint32(self.words[self.words[node + 2] + cell]).view(np.float32))
            core = self.words[node + 1] + cell * prod(ranks)
            value += scale * sum(self.half(core + flat(r, ranks)) * prod(f[i] for f, i in zip(factors, r, strict=True))
                                 for r in product(*map(range, ranks)))
        return value


@pytest.mark.parametrize(("undecomposed", "eight_from"), [((), None), ((1,), None), ((0, 3), 0), ((1,), 1)])
def test_words_alone_tell_every_element(undecomposed: tuple[int, ...], eight_from: int | None) -> None:
    _, levels = random_model(np.random.default_rng(3), SIZES, 3, undecomposed, eight_from=eight_from,
                             shapes=Shapes(zero=0.1, leaf=0.1))
    words = Words(pack_image(levels).words, undecomposed)
    coords = np.random.default_rng(4).integers(SIZES, size=(40, len(SIZES)))
    for upto in (1, 3):
        found = [words.element(index, upto) for index in coords.tolist()]
        expected = decode_elements(levels, SIZES, coords, upto, np.float64)
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_an_undecomposed_mode_has_no_addresses() -> None:
    _, levels = random_model(np.random.default_rng(3), SIZES, 2, (1,))
    node = Words(pack_image(levels).words, (1,)).modes(0)[1]
    assert node == [1, 1, SIZES[1], 0, 0]
