"""Measure a model against its source: SNR, RMSE and largest error up to each level, slab by slab.

Errors are summed in float64; values are decoded in float32 where no level is above `FINE` dB, else in float64.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from .arrays import F64
from .axes import mode_rows, organise
from .conventions import meant
from .decode import add_level
from .errors import invalid
from .metrics import noise_at, snr_db
from .model import Model
from .packed import LevelQuality
from .streaming.steady import Steady
from .support.cut_short import whole_map
from .support.memory import drop_pages, memory_for
from .support.progress import Progress
from .support.slabs import slabs
from .transform import from_json

#: Elements measured at once: some 40 bytes each.
SLAB = 1 << 21
#: Up to this SNR in dB the rounding of decoding in float32 is nothing beside the errors; above, float64 tells them.
FINE = 40.0


@dataclass(eq=False)
class Sums:
    """Squares of the values and, for each level, of the errors; the largest error of each level."""

    levels: int
    signal: float = 0.0
    count: int = 0
    noise: list[float] = field(init=False)
    largest: list[float] = field(init=False)

    def __post_init__(self) -> None:
        self.noise, self.largest = [0.0] * self.levels, [0.0] * self.levels

    def add(self, level: int | None, squares: float, largest: float = 0.0, count: int = 0) -> None:
        """Count sums of squares and the largest error of a level, from 0; of values for None."""
        if level is None:
            self.signal, self.count = self.signal + squares, self.count + count
        else:
            self.noise[level] += squares
            self.largest[level] = max(self.largest[level], largest)

    def add_values(self, values: F64) -> None:
        """Count values of the source."""
        self.add(None, float(np.square(values).sum()), count=values.size)

    def add_error(self, level: int, error: F64) -> None:
        """Count errors of a level, from 0."""
        largest = max(float(error.max(initial=0.0)), -float(error.min(initial=0.0)))
        self.add(level, float(np.square(error).sum()), largest)

    def merge(self, other: Sums) -> None:
        """Add what was counted elsewhere."""
        self.signal, self.count = self.signal + other.signal, self.count + other.count
        self.noise = [a + b for a, b in zip(self.noise, other.noise, strict=True)]
        self.largest = [max(a, b) for a, b in zip(self.largest, other.largest, strict=True)]

    def quality(self) -> tuple[LevelQuality, ...]:
        """An exact reconstruction has an infinite SNR, whatever its signal."""
        return tuple(LevelQuality(snr_db(self.signal, noise), (noise / self.count) ** 0.5, most)
                     for noise, most in zip(self.noise, self.largest, strict=True))


def measure(model: Model, source: Any, *, nan: float | None = None, progress: Progress | None = None,
            slab: int = SLAB) -> tuple[LevelQuality, ...]:
    """Quality up to each level, as the file states it: on the stored numbers, against the source's values.

    Args:
        model: what to measure.
        source: an array of the model's shape that NumPy can slice; it is read once, in slabs.
        nan: value that stands for NaN and infinity in the source.
        progress: called with a stage's name and the fraction done.
        slab: elements to work on at once.

    Raises:
        HmkctaError: the source has another shape, or values that are not finite and `nan` is None; or it changed while
            it was read (kind `SourceChanged`).

    >>> from hmkcta._example import example_level, example_metadata
    >>> m = Model(example_metadata(), [example_level()])
    >>> quality = measure(m, np.array([[1, 2, 3], [2, 4, 7]]))[0]
    >>> round(quality.snr_db, 2), round(quality.rmse, 2), quality.max_abs_error
    (19.19, 0.41, 1.0)
    """
    return measure_both(model, source, nan=nan, progress=progress, slab=slab)[0]


def measure_both(model: Model, source: Any, *, nan: float | None = None, progress: Progress | None = None,
                 slab: int = SLAB) -> tuple[tuple[LevelQuality, ...], tuple[LevelQuality, ...]]:
    """As `measure`: quality in the domain of the source values, and in that of the value transform."""
    if tuple(source.shape) != model.shape:
        raise invalid("source-shape", "shape of the source", tuple(source.shape), f"{model.shape}, that of the file")
    source = meant(source)
    with whole_map(source), memory_for("a slab that is measured", "give a smaller slab=, or close what takes memory"):
        steady = Steady(cast("NDArray[Any]", source)) if isinstance(source, np.ndarray) else None
        sums = _summed(model, source, nan, progress, slab, np.float32) or _summed(
            model, source, nan, progress, slab, np.float64
        )
        if steady is not None:
            steady.check()
    assert sums is not None
    plain, transformed = sums
    found = transformed.quality()
    return (plain.quality() if model.metadata.is_transformed else found), found


def _float32_tells(sums: Sums) -> bool:
    """Whether errors of all levels are so large that float32 tells them."""
    return all(np.isfinite(noise) and noise > noise_at(FINE, sums.signal) for noise in sums.noise)


def _summed(
    model: Model, source: Any, nan: float | None, progress: Progress | None, slab: int, dtype: type[np.floating[Any]]
) -> tuple[Sums, Sums] | None:
    """Sums in both domains, in float64 whatever the type the model is decoded in; plain errors only if they differ.

    None where float32 does not tell the errors, of which the first slab mostly warns.
    """
    metadata = model.metadata
    transform = from_json(metadata.transform)
    plain, transformed = Sums(len(model.levels)), Sums(len(model.levels))
    parts = list(slabs(model.shape, slab))
    for part in parts:
        values = _finite(np.asarray(source[part], np.float64), nan, part)
        axes = [replace(axis, size=size, coords=None) for axis, size in zip(metadata.axes, values.shape, strict=True)]
        tensor = organise(values, axes, metadata.organisation)
        fitted = np.asarray(transform.forward(tensor), np.float64)
        transformed.add_values(fitted)
        if not transform.is_identity:
            plain.add_values(tensor)
        rows = mode_rows(metadata.axes, metadata.organisation, part)
        decoded = np.zeros(tensor.shape, dtype)
        for level in range(len(model.levels)):
            add_level(model.stages, rows, decoded, level + 1)
            transformed.add_error(level, fitted - decoded)
            if not transform.is_identity:
                plain.add_error(level, tensor - np.asarray(transform.inverse(decoded.astype(np.float64)), np.float64))
        drop_pages(source)
        if dtype is np.float32 and part in (parts[0], parts[-1]) and not _float32_tells(transformed):
            return None
        if progress is not None:
            progress("measuring", transformed.count / model.size)
    return plain, transformed


def _finite(values: F64, nan: float | None, part: tuple[slice, ...]) -> F64:
    bad = ~np.isfinite(values)
    if not bad.any():
        return values
    if nan is not None:
        return np.where(bad, nan, values)
    start = [span.start for span in part] + [0] * (values.ndim - len(part))
    first = tuple(int(i) + at for i, at in zip(np.argwhere(bad)[0], start, strict=True))
    raise invalid("not-finite", "source", f"values that are infinite or no number, the first at index {first}",
                  "finite numbers", "give the value that replaced them, nan=0 or --nan fill=0")
