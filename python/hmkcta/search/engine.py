"""The search: layouts judged by J on samples of blocks at one step D, the best of them coded, each with a D of its own.

Everything that is chosen (organisation, grid, undecomposed modes, ranks) minimises J = error / D^2 + lambda * bits; the
goal is met by D alone. `docs/design-notes.md` says what is measured, and what was tried.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from math import exp, inf, isinf, log, log2, prod, sqrt
from typing import Any, Protocol, TypeAlias, TypeVar
from zlib import crc32

from ..arrays import F32
from ..metrics import snr_db as decibels
from ..support.executors import in_order
from ..support.progress import nobody
from .clusters import Labels, Parting, clusters_of, parted
from .coded import CodedBlocks, LayoutCoder
from .judging import Judge, Sample, Verdict
from .layout import Layout, Modes, first_layouts, neighbours, read_layout
from .rate_model import MODEL
from .roots import OVERSHOT, USED, meet
from .values import Values

T = TypeVar("T")
#: A layout, the step at which it was judged, and the elements of the sample.
Judged: TypeAlias = "tuple[Layout, float, int]"

#: D begins at this share of the root mean square, and is never less than that: it leaves some 110 dB, more than float32
#: arithmetic and float16 bases keep, and numbers of any block within 32 bits.
FIRST_STEP, LEAST_STEP = 0.1, 1e-5
#: Organisations whose J was this many times that of another on each grid where both were judged are not tried again.
HOPELESS_MODES = 1.5
#: The share of a search's time that goes by before finalists are coded (0.6 to 0.8 on four sets).
EXPLORING = 0.7
#: Layouts are judged at no step below this share of the root mean square: it leaves some 75 dB, where float16 ends.
EXPLORED_STEP = 3e-4
#: Rows of a cluster on the mean, at least.
ROWS_EACH = 4
#: Layouts are all judged again where the step changed by more than this, as log D.
FAR_STEP = 1.0
#: Layouts that are judged before the best of them becomes the bar of the next ones, whatever the threads.
AT_ONCE = 8


class Settled(Protocol):
    """What `read` makes of the JSON value that was chosen before under a name, else of what `choose` makes."""

    def __call__(self, name: str, choose: Callable[[], Any], read: Callable[[Any], T], /) -> T: ...


@dataclass(frozen=True)
class Effort:
    """How long a search looks.

    Attributes:
        elements: of a first sample of each layout (2^17 suffice), and of the one that ranks finalists.
        rounds: how often the best are varied.
        varied: how many of the best are varied in a round.
        finalists: how many are judged on the larger sample.
        coded: how many are coded.
        clusters: numbers of clusters that rows of a mode are parted into, for trial.
    """

    elements: tuple[int, int]
    rounds: int
    varied: int
    finalists: int
    coded: int
    clusters: tuple[int, ...] = ()


EFFORTS = {
    "fast": Effort((1 << 15, 1 << 17), 2, 1, 6, 1),
    "medium": Effort((1 << 17, 1 << 19), 6, 3, 12, 4, (8, 32, 128)),
    "thorough": Effort((1 << 18, 1 << 21), 10, 6, 24, 8, (4, 8, 16, 32, 64, 128, 256)),
}


@dataclass(frozen=True)
class Goal:
    """What a file is to be: `size` most bytes, or `snr` least dB; one of them."""

    size: int | None = None
    snr: float | None = None


@dataclass(frozen=True, order=True)
class Score:
    """How good a file is for a goal; the least is best.

    Attributes:
        missed: by how much, as a logarithm, the goal is missed; 0: it is met.
        first: -dB of a file for a size, bytes of one for an SNR.
        then: the other one.
    """

    missed: float
    first: float
    then: float

    @classmethod
    def of(cls, goal: Goal, nbytes: int, snr: float) -> Score:
        """The score of a file of so many bytes and dB.

        >>> Score.of(Goal(size=1000), 990, 30.0) < Score.of(Goal(size=1000), 900, 29.0)
        True
        >>> Score.of(Goal(snr=30), 990, 30.0) < Score.of(Goal(snr=30), 900, 29.0)
        True
        """
        if goal.size is not None:
            return cls(max(0.0, log(nbytes / goal.size)), -snr, nbytes)
        assert goal.snr is not None, "a goal has one of the two"
        return cls(0.0 if snr >= goal.snr else goal.snr - snr, nbytes, -snr)


@dataclass(frozen=True, eq=False)
class Found:
    """A layout with its code.

    Attributes:
        layout: modes and grid.
        coder: codes the same at other steps.
        coded: the blocks at the step that meets the goal.
        nbytes: of the code, with `overhead`.
        snr: in dB, of the values as decoded.
        above: levels whose residual is coded, the first of them of the values.
    """

    layout: Layout
    coder: LayoutCoder
    coded: CodedBlocks
    nbytes: int
    snr: float
    above: tuple[CodedBlocks, ...] = ()

    @property
    def modes(self) -> Modes:
        """The axes of the array by mode."""
        return self.layout.modes if self.coder.parting is None else self.coder.parting.modes

    @property
    def levels(self) -> tuple[CodedBlocks, ...]:
        """The blocks of every level."""
        return *self.above, self.coded


@dataclass(frozen=True, eq=False)
class Trial:
    """Rows of some modes in clusters: J with the labels, the search of the parted array, its layout, the labels."""

    cost: float
    search: Search
    layout: Layout
    labels: dict[int, Labels]


@dataclass(eq=False)
class Search:
    """A search for the layout that is best for a goal.

    Args:
        values: the array.
        goal: bytes or dB.
        decode_cost: bound on the multiply-adds of one element.
        effort: how long to look.
        modes: the axes that are merged; None: what is best.
        overhead: bytes of a file besides its code: header and metadata.
        threads: layouts that are judged at a time; the result does not depend on it.
        on_progress: called with a stage's name and the fraction of it that is done.
        on_best: called with the bytes and the SNR in dB of the best file so far.
        settled: the JSON value that an interrupted search chose under a name, else what the function given chooses.
        enough: asked between layouts; True: no further one is looked at.
        parting: whose `values` these are, where rows are in the order of clusters.
    """

    values: Values
    goal: Goal
    decode_cost: int = 4096
    effort: Effort = EFFORTS["medium"]
    modes: Modes | None = None
    overhead: int = 600
    threads: int = 1
    on_progress: Callable[[str, float], None] = nobody
    on_best: Callable[[int, float], None] = nobody
    settled: Settled = lambda _name, choose, read: read(choose())
    enough: Callable[[], bool] = lambda: False
    parting: Parting | None = None
    judged: dict[Judged, Verdict] = field(init=False, default_factory=dict["Judged", Verdict])
    done: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        self.energy, self.rms = self.values.energy, self.values.rms
        # Steps beyond which more digits are kept than float32 has, and from which on nothing is.
        self.steps = LEAST_STEP * self.rms, 4 * self.rms * sqrt(self.values.size)
        self.judge = Judge(self.values, self.decode_cost, threads=self.threads)

    def run(self) -> Found:
        """The best layout found, coded so that it meets the goal; the closest to it where none does."""
        step, finalists = self.explore()
        coded: list[tuple[Score, int, float]] = []  # with the place of the layout, and its step
        made: dict[int, Found] = {}
        finalists = [*self._clustered(finalists[0], step), *((self, layout) for layout in self._apart(finalists))]
        for place, (search, layout) in enumerate(finalists):
            self._tell(EXPLORING + (1 - EXPLORING) * place / len(finalists))
            score, step = search.score(layout, step, place, made)
            coded.append((score, place, step))
            if min(coded)[1] != place:  # only the best is held
                made.pop(place, None)
            elif place in made:
                self.on_best(made[place].nbytes, made[place].snr)
            if self.enough():
                break
        _, place, step = min(coded)
        search, layout = finalists[place]
        return made.get(place) or search.code(layout, step)

    def _clustered(self, best: Layout, step: float) -> list[tuple[Search, Layout]]:
        """Clusters of rows in place of blocks along some modes, with the search of them, where their J is less.

        One mode after another is parted, as long as that lowers J; the best are ranked by their code, as finalists are.
        """
        if not self.values.in_memory or self.enough():
            return []
        bar, labels = self.judge.verdict(best, step, self.effort.elements[0]).cost, dict[int, Labels]()
        least, tried = bar, list[Trial]()
        whole = self.values.read(tuple(slice(0, size) for size in self.values.shape))

        @cache
        def clusters(n: int, count: int) -> Labels:
            """The same whatever other modes are parted."""
            return clusters_of(whole, best.modes[n], count)

        for _ in best.modes:
            partings = self._partings(best, step, labels, least, whole, clusters)
            trials = sorted(partings, key=lambda trial: trial.cost)
            tried += trials[: self.effort.coded]
            if not trials or trials[0].cost >= least:
                break
            least, labels = trials[0].cost, trials[0].labels
        tried = sorted((trial for trial in tried if trial.cost < bar), key=lambda trial: trial.cost)
        by_code = [(trial.search.coded_cost(trial.layout, step), place)
                   for place, trial in enumerate(tried[: self.effort.coded])]
        if not by_code or min(by_code)[0] >= self.coded_cost(best, step):
            return []
        found = tried[min(by_code)[1]]
        return [(found.search, found.layout)]

    def _partings(self, best: Layout, step: float, labels: dict[int, Labels], bar: float, whole: F32,
                  clusters: Callable[[int, int], Labels]) -> list[Trial]:
        """One mode more parted into clusters, on the grid of a layout or on none."""
        trials: list[Trial] = []
        for n, mode in enumerate(best.modes):
            rows = prod(self.values.shape[axis] for axis in mode)
            for count in self.effort.clusters:
                if n in labels or rows < ROWS_EACH * count or self.enough():
                    continue
                parting = parted(whole, best.modes, {**labels, n: clusters(n, count)}, self.energy)
                search = replace(self, values=parting.values, modes=parting.inner, parting=parting)
                for edges in dict.fromkeys((self.values.shape, best.edges)):
                    layout = parting.layout(edges)
                    cost = search.judge.verdict(layout, step, self.effort.elements[0], bar).cost
                    trials.append(Trial(cost + MODEL.trade * parting.label_bits, search, layout, parting.labels))
        return trials

    def _tell(self, done: float) -> None:
        """Tell what fraction of the search is done; it never goes back."""
        self.done = max(self.done, done)
        self.on_progress("search", self.done)

    def _apart(self, finalists: Sequence[Layout]) -> list[Layout]:
        """The finalists to code: the best, and the best of other octaves of the number of blocks."""
        best = list(finalists[: max(1, 3 * self.effort.coded // 4)])
        octaves = {self._octave(layout) for layout in best}
        for layout in finalists:
            if len(best) < self.effort.coded and self._octave(layout) not in octaves:
                octaves.add(self._octave(layout))
                best.append(layout)
        return best

    def _octave(self, layout: Layout) -> int:
        return round(log2(prod(layout.blocks(self.values.shape))))

    def explore(self) -> tuple[float, list[Layout]]:
        """The step at which the best layouts meet the goal, and the finalists, best first."""
        def chosen() -> Any:
            step, ranked = self._explore(FIRST_STEP * self.rms)
            finalists = ranked[:1] if self.enough() else self._ranked_by_code(ranked[: self.effort.finalists], step)
            return [step, [[layout.modes, layout.edges] for layout in finalists]]

        return self.settled("explored", chosen, self._read_explored)

    def _read_explored(self, value: Any) -> tuple[float, list[Layout]]:
        """Step and layouts that `explore` wrote down.

        Raises:
            TypeError, ValueError: it did not.
        """
        step, finalists = value
        return self._read_step(step), [read_layout(self.values.shape, *layout) for layout in finalists]

    def _read_step(self, step: Any) -> float:
        if not isinstance(step, float) or not self.steps[0] / 2 <= step <= self.steps[1] * 2:
            raise ValueError("no step")
        return step

    def estimated(self, layout: Layout, step: float) -> tuple[float, float]:
        """Bytes of the file of a layout and its SNR in dB, by its J on the larger sample about a step."""
        bits, error = self._coder(layout, step).sampled(step, self.effort.elements[1])
        return bits / 8 + self.overhead, decibels(self.energy, error) if self.energy > 0 else inf

    def score(self, layout: Layout, step: float, place: int, made: dict[int, Found]) -> tuple[Score, float]:
        """The score of a finalist coded for the goal, and its step; `made` has it where it had to be coded now."""
        def chosen() -> Any:
            found = made[place] = self.meet(layout, step)
            return [found.nbytes, None if isinf(found.snr) else found.snr, found.coded.step]

        def read(value: Any) -> tuple[Score, float]:
            nbytes, snr, own = value
            return Score.of(self.goal, int(nbytes), inf if snr is None else float(snr)), self._read_step(own)

        # By the layout: which ones are coded hangs on when a search was told to end.
        return self.settled(f"coded-{crc32(repr(layout).encode()):08x}", chosen, read)

    def again(self, found: Found, goal: Goal) -> Found:
        """The same layout for another goal."""
        self.goal = goal
        return self.meet(found.layout, found.coded.step, found.coder)

    def _explore(self, step: float) -> tuple[float, list[Layout]]:
        """The step at which the best layouts meet the goal, and all layouts judged at it, best first."""
        layouts = self._held(first_layouts(self.values.shape, self.modes))
        ranked: list[Layout] = []
        for turn in range(self.effort.rounds):
            ranked = self._ranked(layouts, step, self.effort.elements[0], (turn, turn + 1))
            near = self._step_for(ranked[0], step)
            if abs(log(near / step)) > 0.1 and turn + 1 < self.effort.rounds:
                # Many layouts need not be judged again at a step nearby: those far behind stay there.
                ranked = ranked if abs(log(near / step)) > FAR_STEP else ranked[: self.effort.finalists]
                step = near
                ranked = self._ranked(ranked, step, self.effort.elements[0])
            behind = self._behind()
            varied = [other for place, layout in enumerate(ranked[: self.effort.varied])
                      for other in neighbours(layout, self.values.shape, organise=not place and self.modes is None)
                      if behind.get(other.modes, 0.0) < HOPELESS_MODES]
            layouts = list(dict.fromkeys([*ranked[: self.effort.finalists], *self._held(varied)]))
            judged = all((layout, step, self.effort.elements[0]) in self.judged for layout in layouts)
            if judged or self.enough():
                break
        return step, self._ranked(layouts, step, self.effort.elements[0])

    def _behind(self) -> dict[Modes, float]:
        """How many times the least J on a grid each organisation had so far, on the grid that suits it best."""
        least: dict[object, float] = {}
        for (layout, step, elements), verdict in self.judged.items():
            grid = layout.edges, step, elements
            least[grid] = min(verdict.cost, least.get(grid, inf))
        found: dict[Modes, float] = {}
        for (layout, step, elements), verdict in self.judged.items():
            least_here = least[layout.edges, step, elements]
            ratio = verdict.cost / least_here if least_here > 0 else 1.0
            found[layout.modes] = min(ratio, found.get(layout.modes, inf))
        return found

    def _held(self, layouts: Iterable[Layout]) -> list[Layout]:
        """The layouts whose blocks memory suffices for."""
        return [layout for layout in layouts if self.values.holds(layout.block(self.values.shape))]

    def _ranked(self, layouts: Iterable[Layout], step: float, elements: int, turns: tuple[int, int] = (0, 0)
                ) -> list[Layout]:
        """Layouts by J at a step, the least first; `turns`: how many rounds are over before and afterwards."""
        todo = [layout for layout in dict.fromkeys(layouts) if (layout, step, elements) not in self.judged]
        known = [found.cost for (_, at, of), found in self.judged.items() if (at, of) == (step, elements)]
        bar = min(known, default=inf)
        for first in range(0, len(todo), AT_ONCE):  # after each few the bar is higher
            own = todo[first : first + AT_ONCE]
            turn = turns[0] + (turns[1] - turns[0]) * first / len(todo)
            self._tell(EXPLORING * turn / self.effort.rounds)
            if bar < inf and self.enough():  # these are not looked at
                self.judged.update({(layout, step, elements): Verdict(inf, ((),)) for layout in own})
                continue
            largest = max(prod(layout.block(self.values.shape)) for layout in own)
            workers = min(self.threads, max(1, self.values.together // largest))
            judge = partial(self.judge.verdict, step=step, elements=elements, bar=bar)
            for layout, found in zip(own, in_order(judge, own, workers), strict=True):
                self.judged[layout, step, elements] = found
                bar = min(bar, found.cost)
        return sorted(dict.fromkeys(layouts), key=lambda layout: (self.judged[layout, step, elements].cost, layout))

    def _step_for(self, layout: Layout, step: float) -> float:
        """The step at which a layout meets the goal, by its J on a sample.

        J is least in everything but D, so its derivative by log D is -2 error / D^2, and J says bits and errors both.
        """
        sample = self.judge.kept(layout, self.effort.elements[0], step)

        def attempt(step: float) -> tuple[float, None]:
            bits, error = self._bits_and_error(sample, step)
            return self._excess(bits / 8 + self.overhead, error), None

        slope = -1.0 if self.goal.size is not None else 1.3
        return meet(attempt, step, 0.05, slope, bounds=(EXPLORED_STEP * self.rms, self.steps[1]), tries=6).step

    def _bits_and_error(self, sample: Sample, step: float) -> tuple[float, float]:
        """Bits of the code of a layout and its squared error: J(D) is least in everything else (envelope theorem)."""
        low, high = (sample.verdict(step * exp(by)).cost for by in (-0.05, 0.05))
        error = max((low - high) / 0.2, 1e-9)  # in units of D^2
        return max(((low + high) / 2 - error) / MODEL.trade, 8.0), error * step * step

    def _excess(self, nbytes: float, error: float) -> float:
        """How far above the goal, as a logarithm, so many bytes or such a squared error are."""
        if self.goal.size is not None:
            return log(max(nbytes - self.overhead, 1.0) / max(self.goal.size - self.overhead, 1))
        assert self.goal.snr is not None, "a goal has one of the two"
        # Without any error no step is needed that is smaller.
        return log(error / self.energy) + self.goal.snr * log(10) / 10 if error > 0 and self.energy > 0 else 0.0

    def _coder(self, layout: Layout, step: float) -> LayoutCoder:
        known = self.judged.get((layout, step, self.effort.elements[0]))
        sets = (known or self.judge.verdict(layout, step, self.effort.elements[0])).sets
        return LayoutCoder(self.values, layout, sets, self.decode_cost, threads=self.threads, parting=self.parting)

    def coded_cost(self, layout: Layout, step: float) -> float:
        """J of what the code takes and leaves of the larger sample; that of a model of the code is 6 to 15 % off."""
        bits, error = self._coder(layout, step).sampled(step, self.effort.elements[1])
        return error / step**2 + MODEL.trade * bits

    def _ranked_by_code(self, layouts: Sequence[Layout], step: float) -> list[Layout]:
        """Layouts by `coded_cost`."""
        costs = {layout: self.coded_cost(layout, step) for layout in layouts}
        return sorted(layouts, key=lambda layout: (costs[layout], layout))

    def code(self, layout: Layout, step: float, coder: LayoutCoder | None = None) -> Found:
        """A layout coded at a step."""
        coder = coder or self._coder(layout, step)
        coded = coder.code(step)
        return Found(layout, coder, coded, coder.bytes_of(coded) + self.overhead, decibels(self.energy, coded.error))

    def meet(self, layout: Layout, step: float, coder: LayoutCoder | None = None) -> Found:
        """A layout coded at the step that meets the goal, or comes closest to it."""
        coder = coder or self._coder(layout, step)
        best: list[tuple[Score, float, Found]] = []

        def attempt(step: float) -> tuple[float, Found]:
            found = self.code(layout, step, coder)
            best.append((Score.of(self.goal, found.nbytes, found.snr), step, found))
            best[:] = [min(best, key=lambda one: one[:2])]
            return self._excess(found.nbytes, found.coded.error), found

        by_size = self.goal.size is not None
        tolerance = -log(USED) if by_size else OVERSHOT * log(10) / 10
        slope = -1.0 if by_size else 1.3
        meet(attempt, max(step, self.steps[0]), tolerance, slope, bounds=self.steps)
        # Not the closest: where the decode cost bounds a layout, ever smaller steps end in numbers that are clipped.
        return best[0][2]
