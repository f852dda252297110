"""What choices of ranks are reckoned to leave and to take, where a fit tells how many bits their numbers have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log, log2

import numpy as np

from ..fitting.hierarchy import Node
from ..metrics import snr_db
from .allocation import FEWEST_BITS, MOST_BITS, Allocation, Spectrum, allocate, stored_bits
from .examining import Way

#: What the rounding of columns leaves, as a share of what the ranks leave: where nothing tells, and the least and most.
SHARE, SHARES = 0.1, (0.05, 0.6)
#: The share of a size that is enough, and that is aimed at.
USED, AIMED = 0.98, 0.99
#: How many times the bytes tell what more of them would save of the error.
FURTHER = 1.2

#: Numbers of the nodes that have something to store, with their choices.
Found = Sequence[tuple[int, Spectrum]]


@dataclass
class Reckoning:
    """Bytes and error of choices for all nodes of a level.

    Attributes:
        nodes: of the level.
        found: the choices of those that have any.
        ways: to cut a node, of which choices tell the number.
        energy: squared norm of the tensor.
        elsewhere: squared error outside the choices.
        beside: bytes of the file beside what the choices count.
        counted: bits of a number that they count.
        packed: whether numbers have bits of their own.
        share: what rounding these is to leave, as a share of the error.
        more: by how many bits numbers were longer than was reckoned.
    """

    nodes: Sequence[Node]
    found: Found
    ways: Sequence[Way]
    energy: float
    elsewhere: float
    beside: float
    counted: float
    packed: bool
    share: float
    more: float = 0.0

    def snr(self, chosen: Allocation) -> float:
        """SNR in dB that the choices promise by their own errors, in the domain of the fit."""
        return snr_db(self.energy, max(self.elsewhere + chosen.error, 0.0))

    def nbytes(self, chosen: Allocation) -> float:
        """Bytes of the file that the choices should make."""
        counted = self.beside + chosen.nbytes
        return counted + (self._bits(chosen) - self.counted) / 8 * self.numbers(chosen) if self.packed else counted

    def _bits(self, chosen: Allocation) -> float:
        """Bits that a number should take: more for a higher SNR, as of fits before, and fewer for a larger share."""
        fewer = log2((self.share or SHARE) / SHARE) / 2
        return min(max(stored_bits(8, self.snr(chosen)) + self.more - fewer, FEWEST_BITS), MOST_BITS)

    def learn(self, chosen: Allocation, nbytes: int) -> None:
        """A fit of the choices made a file of so many bytes."""
        if self.packed and (numbers := self.numbers(chosen)):
            self.more += 8 * (nbytes - self.nbytes(chosen)) / numbers

    def numbers(self, chosen: Allocation) -> float:
        """Core and basis numbers of the choices."""
        numbers = 0.0
        for (s, choices), choice in zip(self.found, chosen.choice, strict=True):
            spec, ranks = self.ways[int(choices.way[int(choice)])][0], choices.ranks[choice].astype(np.float64)
            numbers += spec.cells * float(np.prod(ranks))
            for size, rank, most, c in zip(self.nodes[s].sizes, ranks, spec.ranks, spec.clusters, strict=True):
                numbers += 0 if most is None else size * float(rank) * (spec.cells // c)
        return numbers

    def longer(self, chosen: Allocation, nbytes: float, size: int) -> float:
        """By how many bits each number of the choices is longer than fills a size, in a file of so many bytes."""
        return 8 * (nbytes - AIMED * size) / max(self.numbers(chosen), 1)

    def filling(self, size: float) -> Allocation:
        """The choices that should make a file of so many bytes."""
        spectra = [choices for _, choices in self.found]
        low, high = 0.0, 2.0 * size
        while high - low > 0.002 * size:
            middle = (low + high) / 2
            enough = self.nbytes(allocate(spectra, nbytes=middle - self.beside)) > size
            low, high = (low, middle) if enough else (middle, high)
        return allocate(spectra, nbytes=low - self.beside)

    def share_of(self, chosen: Allocation) -> float:
        """What rounding should leave, as a share of the error: as much as makes bits of columns and ranks pay alike.

        Half a bit less of each number leaves twice as much, and so does, of the ranks, whatever saves as many bytes.
        """
        other = allocate([choices for _, choices in self.found], nbytes=FURTHER * chosen.nbytes)
        if other.nbytes <= chosen.nbytes or not chosen.error or not self.packed:
            return self.share
        saved = (chosen.error - other.error) / (other.nbytes - chosen.nbytes)
        share = self.numbers(chosen) / (16 * log(2)) * saved / (self.elsewhere + chosen.error)
        return min(max(share, SHARES[0]), SHARES[1])
