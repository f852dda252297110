"""The adaptive binary range coder of stored numbers, decision by decision."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable
from dataclasses import dataclass, field

LEAST_RANGE = 1 << 24


class CodeError(ValueError):
    """A run that cannot be decoded; its text is the reason's code."""


@dataclass
class Model:
    """The probability of a 0 in 1/65536, and how many decisions it has seen, at most 254."""

    zero: int = 1 << 15
    seen: int = 0

    def learn(self, bit: int) -> None:
        """Move towards a decision, the less the more were seen."""
        rate = 65536 // (self.seen + 2)
        self.zero += -(self.zero * rate >> 16) if bit else (65536 - self.zero) * rate >> 16
        self.zero = min(max(self.zero, 32), 65504)
        self.seen = min(self.seen + 1, 254)


@dataclass
class Coder:
    """Either end of a code: an encoder codes the values it is handed, a decoder returns those it reads in their place.

    `models` are made as they are asked for, by what they depend on.
    """

    decodes = False
    models: defaultdict[Hashable, Model] = field(default_factory=lambda: defaultdict(Model))
    range: int = 2**32 - 1

    def bit(self, model: Hashable, bit: int = 0) -> int:
        """A decision with the probability of its model."""
        own = self.models[model]
        bound = (self.range >> 16) * own.zero
        bit = self._decide(bound, self.range - bound, bit)
        own.learn(bit)
        return bit

    def raw(self, bits: int, value: int = 0) -> int:
        """The lowest bits of a value, the highest one first, all equally likely."""
        read = 0
        for at in reversed(range(bits)):
            half = self.range >> 1
            read = read << 1 | self._decide(half, half, value >> at & 1)
        return read

    def _decide(self, bound: int, above: int, bit: int) -> int:
        """Take the part of the range below or above a bound."""
        raise NotImplementedError


@dataclass
class Encoder(Coder):
    """Writes bytes. `low` is as long as the code: Python's whole numbers carry by themselves."""

    low: int = 0
    shifts: int = 0

    def _decide(self, bound: int, above: int, bit: int) -> int:
        self.low += bound if bit else 0
        self.range = above if bit else bound
        while self.range < LEAST_RANGE:
            self.range <<= 8
            self.low <<= 8
            self.shifts += 1
        return bit

    def finish(self) -> bytes:
        """All bytes of the code."""
        return self.low.to_bytes(self.shifts + 4, "big")


@dataclass
class Decoder(Coder):
    """Reads what an encoder has written."""

    decodes = True
    data: bytes = b""
    next: int = 4
    code: int = 0

    def __post_init__(self) -> None:
        if len(self.data) < 4:
            raise CodeError("code-end")
        self.code = int.from_bytes(self.data[:4], "big")

    def _decide(self, bound: int, above: int, bit: int) -> int:
        bit = int(self.code >= bound)
        self.code -= bound if bit else 0
        self.range = above if bit else bound
        while self.range < LEAST_RANGE:
            if self.next == len(self.data):
                raise CodeError("code-end")
            self.range <<= 8
            self.code = (self.code << 8 | self.data[self.next]) & 0xFFFFFFFF
            self.next += 1
        return bit

    def finish(self) -> None:
        """Refuse a code that does not end here."""
        if self.next != len(self.data) or self.code != 0:
            raise CodeError("code-end")
