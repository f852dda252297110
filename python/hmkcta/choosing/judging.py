"""What a search has judged so far: candidates, each on a sample and by bytes of its own, side by side in threads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import inf, prod
from typing import NamedTuple

from ..axes import Organisation
from ..fitting.fit import EFFORTS
from ..support.executors import in_order
from ..support.progress import Told, nobody
from .candidates import Candidate, Scored
from .trial import Kinds, Trial

#: Modes are left undecomposed on trial again if that came so near before, in dB or octaves of bytes.
FAR = 2.0
#: How many of the best candidates are judged anew to tell the bytes that an SNR takes.
FIRSTS = 6
#: Where none of them reaches it, twice the bytes are reckoned to bring so many dB.
AN_OCTAVE = 3.0


@dataclass(frozen=True)
class Care:
    """How much is looked at, by effort. Elements are those of the sample that a candidate is judged on.

    Attributes:
        survey: elements to rank organisations.
        organisations: how many of them go on to races.
        compare: elements to rank grids, one race for each entry.
        finalists: how many candidates go on from each race.
        matrices: how many organisations in two modes (matrix PCA) are settled, too.
        clustered: how many of them are looked at with clusters of the data, and as many that a few rows tell.
        patience: how far those may lie behind the best, as a share of what `clustered.py` allows at the most.
        refine: elements to settle the blocks.
        far: how far a second start of that may lie behind the best, in dB or octaves of bytes.
        steps: grids that a climb may judge; beyond these it begins no further change.
        cuts: elements to find axes along which blocks are cut further, each as pays; 0: none.
    """

    survey: int
    organisations: int
    compare: tuple[int, ...]
    finalists: int
    matrices: int
    clustered: int
    patience: float
    refine: int
    far: float
    steps: int
    cuts: int


CARES = {
    EFFORTS["fast"]: Care(
        survey=1 << 15, organisations=3, compare=(1 << 18,), finalists=1, matrices=0,
        clustered=1, patience=0.25, refine=1 << 20, far=0.0, steps=4, cuts=0,
    ),
    EFFORTS["medium"]: Care(
        survey=1 << 15, organisations=4, compare=(1 << 17, 1 << 20), finalists=4, matrices=2,
        clustered=1, patience=1.0, refine=1 << 20, far=0.3, steps=4, cuts=1 << 20,
    ),
    EFFORTS["thorough"]: Care(
        survey=1 << 16, organisations=12, compare=(1 << 18, 1 << 21), finalists=8, matrices=6,
        clustered=3, patience=1.0, refine=1 << 23, far=1.0, steps=1000, cuts=1 << 23,
    ),
}

Ranked = list[Scored]
Choice = tuple[Organisation, tuple[int, ...]]


class Judged(NamedTuple):
    """What was judged: an organisation and a grid, on a sample of so many elements, by so many bytes."""

    organisation: Organisation
    grid: tuple[int, ...]
    sample: int
    size: int

    @property
    def means(self) -> tuple[int, int]:
        """How it was judged."""
        return self.sample, self.size


@dataclass
class Search:
    """Everything judged so far, each at the sample and the bytes it was judged on.

    Attributes:
        goal: the trial by all the bytes of the goal.
        trial: the one judged by at present, which may have fewer bytes.
        plain: the organisation that merges least.
        threads: how many judge at once.
        care: how much is looked at.
        together: most elements of all samples at work.
        clustered: how many matrices are looked at with clusters of the data.
        highest: worth that races ended with.
        settled: bytes by which blocks were settled.
        rivals: judged so near the best, and in so different a way, that only fits tell which is better.
        losses: what more (True) or fewer blocks along an axis lost in races, by organisation and undecomposed modes.
        seen: the candidates of each organisation and grid, on a sample of so many elements and by so many bytes.
    """

    goal: Trial
    trial: Trial
    plain: Organisation
    threads: int
    care: Care
    together: int
    clustered: int
    highest: float = -inf
    settled: int = 0
    rivals: list[Candidate] = field(default_factory=list[Candidate])
    losses: dict[tuple[Organisation, tuple[int, ...], int, bool], float] = field(
        default_factory=dict[tuple[Organisation, tuple[int, ...], int, bool], float]
    )
    seen: dict[Judged, Ranked] = field(default_factory=dict["Judged", Ranked])

    def anew(self, goal: Trial) -> Search:
        """A search for another goal, in which nothing has been judged."""
        return replace(self, goal=goal, trial=goal, highest=-inf, settled=0, rivals=[], losses={}, seen={})

    def best(
        self, choices: Sequence[Choice], sample: int, told: Told = nobody, kinds: Kinds = ()
    ) -> Ranked:
        """The best candidate with each organisation and grid; `told` hears which share of them is judged.

        `kinds` are the sets of undecomposed modes to look at; none: those that came near the best of their organisation
        so far, or, at first and at last, all that promise something.
        """
        sample, size = min(sample, self.most), self.trial.size
        new = list(dict.fromkeys(choice for choice in choices if Judged(*choice, sample, size) not in self.seen))
        again = sample < min(self.care.refine, self.most)
        known = {modes: kinds or (self.kinds(modes) if again else ()) for modes, _ in new}

        def judge(choice: Choice) -> Ranked:
            return self.trial.worths(*choice, sample, known[choice[0]])

        judged = in_order(judge, new, self.workers(sample))
        for number, (choice, ranked) in enumerate(zip(new, judged, strict=True), start=1):
            self.seen[Judged(*choice, sample, size)] = ranked
            told(number / len(new))
        nothing = {choice: Scored(0.0, Candidate(*choice, carried=False)) for choice in choices}
        return [max(self.seen[Judged(*each, sample, size)], key=worth_of, default=nothing[each]) for each in choices]

    def workers(self, sample: int) -> int:
        """How many samples are worked on side by side, as far as memory goes."""
        return max(1, min(self.threads, self.together // (2 * sample)))

    def every(self, choices: Sequence[Choice], sample: int) -> Ranked:
        """All candidates with these organisations and grids, judged before on this sample."""
        key = min(sample, self.most), self.trial.size
        return [item for choice in dict.fromkeys(choices) for item in self.seen[Judged(*choice, *key)]]

    def near(self, modes: Organisation, far: float) -> bool:
        """Whether the organisation was no more than so `far` behind the best on the largest sample it was judged by."""
        last = max(key.means for key in self.seen if key.organisation == modes)
        found = {key: max(map(worth_of, ranked)) for key, ranked in self.seen.items() if key.means == last and ranked}
        own = [worth for key, worth in found.items() if key.organisation == modes]
        return bool(own) and max(own) > max(found.values()) - far

    def kinds(self, modes: Organisation) -> Kinds:
        """Sets of undecomposed modes that came near the best with some grid and sample."""
        found = dict[tuple[int, ...], None]()
        for key in [key for key in self.seen if key.organisation == modes and self.seen[key]]:
            ranked = self.seen[key]
            found |= {each.undecomposed: None for worth, each in ranked if worth > max(map(worth_of, ranked)) - FAR}
        return tuple(found)

    @property
    def most(self) -> int:
        """Most elements of a sample."""
        return min(prod(self.trial.source.shape), self.together)

    def narrow(self, judged: Ranked, sample: int) -> None:
        """From now on judge by the bytes that the best candidate takes to reach the goal's SNR (its ceiling).

        By more bytes than that a candidate would count only if it reached the SNR, which coarse grids seldom do, as the
        decode cost bounds their ranks. By just these bytes whatever comes nearest to the SNR is worth most.

        Args:
            judged: what is known so far; the best of it are judged anew by all bytes of the goal.
            sample: elements to judge them on.
        """
        ceiling, size, nearest = self.goal.ceiling, self.trial.size, max(map(worth_of, judged))
        if ceiling is None:
            return
        self.trial = self.goal
        firsts = [(each.organisation, each.grid) for _, each in sorted(judged, key=worth_of)[: -1 - FIRSTS : -1]]
        worth = max(map(worth_of, self.best(list(dict.fromkeys(firsts)), sample)))
        if worth > ceiling:
            size = int(self.goal.size * 2 ** (ceiling - worth))
        elif size < self.goal.size:
            size = int(min(self.goal.size, size * 2 ** min(64, (ceiling - nearest) / AN_OCTAVE)))
        self.trial = replace(self.goal, size=size)

    def matrices(self) -> list[Organisation]:
        """The best organisations in two modes, those of matrix PCA, by a small sample.

        That tells too little of all of them, but as much too little of each.
        """
        every = list(dict.fromkeys(key.organisation for key in self.seen if len(key.organisation) == 2))
        if not self.care.matrices:
            return []
        whole = (1,) * len(self.trial.source.shape)
        # Grids may have cut both modes of what was seen: that says nothing of leaving one undecomposed.
        for modes in every:
            self.seen.pop(Judged(modes, whole, min(self.care.compare[0], self.most), self.trial.size), None)
        judged = self.best([(modes, whole) for modes in every], self.care.compare[0], kinds=((), (0,), (1,)))
        return [each.organisation for _, each in sorted(judged, key=worth_of, reverse=True)[: self.care.matrices]]


def worth_of(item: Scored) -> float:
    return item.worth
