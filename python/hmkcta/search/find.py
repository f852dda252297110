"""A model for a goal: the search, its layout as stages, and the quality of what is stored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, log, log10
from time import monotonic, perf_counter

from ..axes import Organisation
from ..errors import invalid
from ..filesize import metadata_of
from ..fitting.run import Run
from ..measure import measure_both
from ..metrics import noise_at
from ..model import Model
from ..packed import LevelQuality, PackedLevel, bounds_of
from ..streaming.budget import PROCESS
from ..streaming.source import Source
from ..support.memory import memory_budget
from ..wanted import Wanted
from .engine import EFFORTS, Found, Goal, Score, Search
from .layout import Modes
from .roots import meet
from .second_level import again, two_levels
from .stages import stages_of
from .values import Values

#: What a header takes besides the code, until it is known: 400 to 900 bytes on data sets of three to five axes.
HEADER_BYTES = 600
#: A file is coded again for a goal that its own header or a value transform made it miss, at most so often.
MOST_REPEATS = 4
#: An SNR of values that were transformed is overshot by at most this many dB.
OVERSHOT_TRANSFORMED = 0.05
#: Bytes of memory for each byte of an array whose blocks' HOSVDs are held: values, cores and bases of two layouts, and
#: what is made of them (measured: 16 MB of fMRI take 350 MB beside the process).
HELD = 20
#: Attempts that the step of a goal takes, about; by these the time of a finalist is estimated.
ATTEMPTS = 4


@dataclass(frozen=True)
class Estimate:
    """What `compress` would make for a goal, as samples of the array tell it; nothing is coded yet.

    Attributes:
        organisation: axes merged into modes, of the layout that is best by samples.
        blocks: how many blocks the grid has along each axis.
        undecomposed: the sets of modes (numbers from 0) that blocks leave undecomposed, most used first.
        nbytes: estimated bytes of the file.
        snr: estimated SNR in dB, in the domain of the value transform.
        seconds: estimated time of `compress`.
    """

    organisation: Organisation
    blocks: tuple[int, ...]
    undecomposed: tuple[tuple[int, ...], ...]
    nbytes: int
    snr: float
    seconds: float


def find_model(
    source: Source, wanted: Wanted, goal: Goal, *, quality: str, kind: str, run: Run, seconds: float | None = None
) -> Model:
    """The best model found for a size in bytes or an SNR in dB, of layouts that are looked at within some seconds.

    Raises:
        HmkctaError: reason ``size-too-small``: header and tables alone take more.
    """
    begun = monotonic()
    search = _search(source, wanted, goal, quality, run)
    search.enough = lambda: run.enough() or (seconds is not None and monotonic() > begun + seconds)
    found = search.run()
    if wanted.ceiling is not None and found.snr > wanted.ceiling:
        goal = Goal(snr=wanted.ceiling)
    else:  # of this header, and not of one of the usual length
        search.overhead = _with_metadata(source, found, kind, run.seed).nbytes - (found.nbytes - HEADER_BYTES)

    def model_of(found: Found) -> Model:
        return _model(source, found, kind, run)

    found, model = _closest(search, again(search, found, goal), goal, model_of)
    if goal.snr is not None and model.metadata.is_transformed:
        if abs(model.snr - goal.snr) > OVERSHOT_TRANSFORMED / 2:
            model = _met_untransformed(search, found, goal.snr, model_of)
    elif _ends(model, found, goal) and found.coder.parting is None:
        _, deeper = _closest(search, two_levels(search, found, goal), goal, model_of)
        model = min(model, deeper, key=lambda made: Score.of(goal, made.nbytes, made.snr))
    if goal.size is not None and model.nbytes > goal.size:
        raise invalid("size-too-small", "size", f"{goal.size} bytes", f"at least {model.nbytes} bytes",
                      "ask for more bytes")
    return model


def _closest(search: Search, found: Found, goal: Goal, model_of: Callable[[Found], Model]) -> tuple[Found, Model]:
    """Coded again where a header or the rounding of stored numbers made it miss the goal, and its model."""
    model = model_of(found)
    for _ in range(MOST_REPEATS):
        short = _short_of(model, goal, found)
        if short is None:
            break
        found = again(search, found, short)
        model = model_of(found)
    return found, model


def estimate_model(source: Source, wanted: Wanted, goal: Goal, *, quality: str, run: Run) -> Estimate:
    """What `find_model` would end with, by samples."""
    begun = perf_counter()
    search = _search(source, wanted, goal, quality, run)
    step, finalists = search.explore()
    layout, explored = finalists[0], perf_counter() - begun
    nbytes, snr = search.estimated(layout, step)
    begun = perf_counter()
    seen = search.judge.verdict(layout, step * 1.01, search.effort.elements[1])
    each = (perf_counter() - begun) / min(search.effort.elements[1], search.values.size)
    coding = each * search.values.size * (1 + ATTEMPTS) * min(search.effort.coded, len(finalists)) / run.threads
    return Estimate(_organisation(source, layout.modes), layout.blocks(source.shape), seen.sets, round(nbytes), snr,
                    explored + coding)


def _search(source: Source, wanted: Wanted, goal: Goal, quality: str, run: Run) -> Search:
    modes = None if wanted.organisation is None else modes_of(source, source.organisation(wanted.organisation))
    values = _values(source, wanted.max_memory)
    return Search(values, goal, wanted.decode_cost, EFFORTS[quality], modes, HEADER_BYTES, run.threads, run.progress,
                  run.best, run.journal.settled)


def _values(source: Source, memory: int | None) -> Values:
    """The values in memory, or read from the source where memory does not hold them with their HOSVDs."""
    budget = memory_budget(memory) - PROCESS
    if HELD * 4 * source.array.size <= budget:
        return Values.of_array(source.values())
    return Values(source.shape, source.values, budget)


def modes_of(source: Source, organisation: Organisation) -> Modes:
    """Numbers of the axes of each mode.

    The order of axes in a mode, and of the modes, is that of the organisation.
    """
    numbers = {axis.name: number for number, axis in enumerate(source.axes)}
    return tuple(tuple(numbers[name] for name in mode) for mode in organisation)


def _short_of(model: Model, goal: Goal, found: Found) -> Goal | None:
    """The goal that the search should have had, for the file to meet its own; None: it does."""
    if goal.size is not None:
        over = model.nbytes - found.nbytes  # of the header
        return None if model.nbytes <= goal.size else Goal(size=max(1, goal.size - over))
    assert goal.snr is not None, "a goal has one of the two"
    left = noise_at(goal.snr) - _rounding(model, found)
    met = model.snr >= goal.snr - 0.005 or model.metadata.is_transformed
    return None if met or left <= 0 else Goal(snr=-10 * log10(left))


def _rounding(model: Model, found: Found) -> float:
    """The share that rounding stored numbers to float16 adds to the error of whole numbers times steps."""
    return max(0.0, noise_at(model.snr) - noise_at(found.snr))


def _ends(model: Model, found: Found, goal: Goal) -> bool:
    """Whether it is the rounding to float16 that a goal, or more of it, cannot be had for."""
    return _rounding(model, found) > noise_at(found.snr) and (goal.snr is None or model.snr < goal.snr)


def _met_untransformed(search: Search, found: Found, snr: float, model_of: Callable[[Found], Model]) -> Model:
    """The model whose values, before the transform, have an SNR in dB: met by way of that of the transformed ones."""
    def attempt(step: float) -> tuple[float, Model]:
        model = model_of(search.again(found, Goal(snr=max(log(step), 0.1))))
        return snr - model.snr, model

    return meet(attempt, exp(found.snr), OVERSHOT_TRANSFORMED, -1.0).result


def _organisation(source: Source, modes: Modes) -> Organisation:
    return tuple(tuple(source.axes[axis].name for axis in mode) for mode in modes)


def _model(source: Source, found: Found, kind: str, run: Run) -> Model:
    """The model of what was found, with its quality."""
    model = _with_metadata(source, found, kind, run.seed)
    quality = measure_both(model, source.array, nan=source.nan, progress=run.progress)
    return _with_metadata(source, found, kind, run.seed, model.stages, quality)


def _with_metadata(
    source: Source, found: Found, kind: str, seed: int, stages: Sequence[PackedLevel] | None = None,
    quality: tuple[Sequence[LevelQuality], Sequence[LevelQuality]] | None = None,
) -> Model:
    stages = stages_of(found.coder, found.levels, source.unit) if stages is None else tuple(stages)
    bounds = [bounds_of(stage, "none" if stage.is_cut else "most") for stage in stages]
    organisation = _organisation(source, found.modes)
    return Model(metadata_of(source, organisation, bounds, kind, seed, *(quality or ())), stages)
