"""A model for a goal: the search, its layout as stages, and the quality of what is stored."""

from __future__ import annotations

from math import log10

from ..axes import Organisation
from ..errors import invalid
from ..filesize import metadata_of
from ..fitting.run import Run
from ..measure import measure_both
from ..model import Model
from ..packed import bounds_of
from ..streaming.source import Source
from .engine import EFFORTS, Found, Goal, Search
from .stages import stages_of

#: What a header takes besides the code, until it is known: 400 to 900 bytes on data sets of three to five axes.
HEADER_BYTES = 600
#: Searches for a size or an SNR of transformed values are repeated with what the last one missed by, at most so often.
MOST_REPEATS = 4
#: An SNR of the source's values is met when it is overshot by at most this many dB.
SNR_TOLERANCE = 0.05


def find_model(
    source: Source,
    goal: Goal,
    *,
    decode_cost: int,
    quality: str,
    kind: str,
    run: Run,
) -> Model:
    """The best model found for a size in bytes or an SNR in dB.

    Raises:
        HmkctaError: reason ``size-too-small``: header and tables alone take more.
    """
    values = source.values()
    search = Search(values, goal, decode_cost, EFFORTS[quality], HEADER_BYTES, run.threads, run.progress)
    found = search.run()
    for _ in range(MOST_REPEATS):
        model = _model(source, found, kind, run.seed)
        short = _short_of(model, goal, found)
        if short is None:
            return model
        found = search.again(found, short)
    raise invalid("size-too-small", "size", f"{goal.size} bytes", f"at least {model.nbytes} bytes",
                  "ask for more bytes") from None


def _short_of(model: Model, goal: Goal, found: Found) -> Goal | None:
    """The goal that the search should have had, for the file to meet its own; None: it does."""
    if goal.size is not None:
        over = model.nbytes - found.nbytes  # of the header
        return None if model.nbytes <= goal.size else Goal(size=goal.size - over)
    assert goal.snr is not None, "a goal has one of the two"
    return None if model.snr >= goal.snr - 0.005 else Goal(snr=found.snr + goal.snr - model.snr + 0.01)


def organisation_of(source: Source, found: Found) -> Organisation:
    """Names of the axes of each mode."""
    return tuple(tuple(source.axes[axis].name for axis in mode) for mode in found.layout.modes)


def _model(source: Source, found: Found, kind: str, seed: int) -> Model:
    stages = stages_of(found.coder, found.coded, source.unit)
    bounds = [bounds_of(stage, "none" if stage.is_cut else "most") for stage in stages]
    organisation = organisation_of(source, found)
    model = Model(metadata_of(source, organisation, bounds, kind, seed), stages)
    quality, transformed = measure_both(model, source.array, nan=source.nan)
    return Model(metadata_of(source, organisation, bounds, kind, seed, quality, transformed), stages)


def decibels(energy: float, error: float) -> float:
    """SNR in dB; infinite where nothing is lost."""
    return 10 * log10(energy / error) if error > 0 else float("inf")
