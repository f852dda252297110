"""Many mutants through both readers: what is new is changed further, what must not be is kept."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hmk_corpus import FIXTURES, Parts
from hmkcta.hmkfile import encode
from random_models import Shapes, random_model

from .mutants import mutated, pick
from .readers import Answer, Reader

#: Files that more are made from, at the most; and how often one of the first is taken all the same.
POOL, ORIGINAL = 2000, 0.3
#: Bytes of files that are changed further: larger ones take longer and show no more.
LARGEST = 1 << 16
#: Mode sizes, stages and undecomposed modes of the random models to begin with.
SHAPES: tuple[tuple[tuple[int, ...], int, tuple[int, ...]], ...] = (
    ((4,), 1, ()), ((3, 4), 2, ()), ((2, 3, 4), 3, (1,)), ((2, 3, 2, 3), 2, ()), ((5, 4), 2, (0,)),
)


@dataclass(frozen=True)
class Bounds:
    """What a reader may take for a mutant."""

    seconds: float = 1.0
    mebibytes: float = 256.0


@dataclass(frozen=True)
class Finding:
    """Something that must not be."""

    what: str
    change: str
    number: int
    data: bytes = field(repr=False)


def seeds(rng: np.random.Generator) -> list[bytes]:
    """Valid files to begin with: the fixtures, and random models of a few shapes."""
    found = [path.read_bytes() for path in sorted(FIXTURES.glob("*.hmk"))]
    for sizes, levels, fixed in SHAPES:
        for coded in (0.0, 1.0):
            for cuts in ((), (1,)) if levels > 1 else ((),):
                model = random_model(rng, sizes, levels, fixed, coded=coded, cuts=cuts, shapes=Shapes(own=0.2))
                found.append(b"".join(encode(*model)))
    return [data for data in found if len(data) <= LARGEST]


class Campaign:
    """Mutants of one generator through one pair of readers.

    Args:
        readers: by name.
        seed: all mutants follow from it, and from what the readers say.
        bounds: what a reader may take.
    """

    def __init__(self, readers: dict[str, Reader], seed: int, bounds: Bounds = Bounds()) -> None:
        self._readers, self._bounds = readers, bounds
        self._rng = np.random.default_rng(seed)
        self._first = seeds(self._rng)
        self._pool = list(self._first)
        self._seen = set[str]()
        self.findings = dict[str, Finding]()
        self.verdicts = Counter[str]()

    def run(self, count: int, told: Callable[[], None] = lambda: None) -> None:
        """Try so many mutants; `told` is called after each."""
        for number in range(1, count + 1):
            first = self._rng.random() < ORIGINAL
            parent = pick(self._rng, self._first if first else self._pool)
            change, data = mutated(self._rng, parent, self._first)
            self.examine(number, change, data)
            told()

    def examine(self, number: int, change: str, data: bytes) -> None:
        """Have the readers read a mutant, and look at what they say."""
        for reader in self._readers.values():
            reader.send(data)
        answers = {name: reader.answer() for name, reader in self._readers.items()}
        for name, answer in answers.items():
            self._look(name, answer, change, number, data)
        verdicts = {name: answer.verdict for name, answer in answers.items()}
        if len(set(verdicts.values())) > 1 and not any(answer.escape for answer in answers.values()):
            said = ", ".join(f"{name} says {verdict}" for name, verdict in verdicts.items())
            self._add(f"they disagree: {said}", change, number, data)
        self.verdicts.update(list(verdicts.values())[:1])
        self._keep(answers, data)

    def _look(self, name: str, answer: Answer, change: str, number: int, data: bytes) -> None:
        if answer.escape:
            self._add(f"{name}: {answer.escape.splitlines()[0]}", change, number, data)
        if answer.seconds > self._bounds.seconds:
            self._add(f"{name} takes more than {self._bounds.seconds:g} s ({answer.verdict})", change, number, data)
        if answer.mebibytes > self._bounds.mebibytes:
            self._add(f"{name} takes more than {self._bounds.mebibytes:g} MiB ({answer.verdict})", change, number, data)

    def _add(self, what: str, change: str, number: int, data: bytes) -> None:
        """Keep the smallest mutant of each finding."""
        before = self.findings.get(what)
        if before is None or len(data) < len(before.data):
            self.findings[what] = Finding(what, change, number, data)

    def _keep(self, answers: dict[str, Answer], data: bytes) -> None:
        """What led to lines or words that none before led to is worth a further change."""
        said = " ".join(answer.verdict for answer in answers.values())
        new = said not in self._seen or any(answer.lines for answer in answers.values())
        self._seen.add(said)
        if new and len(data) <= LARGEST and self._splits(data):
            self._pool.append(data)
            if len(self._pool) > POOL:
                del self._pool[int(self._rng.integers(len(self._first), POOL))]

    @staticmethod
    def _splits(data: bytes) -> bool:
        try:
            Parts.split(data)
        except (ValueError, KeyError, TypeError, AttributeError, IndexError, AssertionError, struct.error):
            return False
        return True


def saved(findings: dict[str, Finding], folder: Path) -> list[Path]:
    """Write the mutants of findings to a folder, to be read one by one."""
    folder.mkdir(parents=True, exist_ok=True)
    paths: list[Path] = []
    for number, finding in enumerate(findings.values()):
        paths.append(folder / f"{number:03d}.hmk")
        paths[-1].write_bytes(finding.data)
    return paths
