"""What somebody should know of a result that its figures do not tell: that it is larger, or holds large values alone.

What `compress` warns of, such as an offset that hides what varies, is said beside these.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..axes import folded
from ..hmkfile import level_sizes
from ..model import Model
from ..offset import HIDDEN
from ..support.memory import drop_pages
from ..support.slabs import thinning
from .output import number_bits, shown_bits

#: Elements of which each is compared with what the model makes of it.
COMPARED = 1 << 12
#: Few values make the SNR where it is beyond `LOUD` dB and all values are `FEW` times as large as most of them.
LOUD, FEW = 20.0, 3.0
#: Most of them are as good as zero where they lie within this share of all of them.
ZERO = 1e-5
#: What whole numbers spread by is rounding, or noise of a sensor, up to so many steps; so it is of all of one byte.
STEPS = 4.0
#: So many lost channels are named; an axis of no known role may be of channels up to so many.
SOME, SHORT = 4, 16
#: Whole numbers may be labels where a sample of so many elements has up to so many values.
LOOKED_AT, LABELS = 1 << 16, 16
#: Samples of a signal side by side.
WINDOW = 256
#: Rows of one mode are most of a file from this share on.
MOSTLY = 0.5


def notes(model: Model, array: NDArray[Any], *, planned: bool = True) -> list[str]:
    """Sentences about a model of an array, each with what to do next; mostly none. `planned`: the plan was given.

    >>> import hmkcta
    >>> signal = np.sin(np.arange(3000) / 9)
    >>> notes(hmkcta.compress(signal, quality="fast"), signal)[0][:50]
    'one axis has nothing to share: every number takes '
    """
    found: list[str] = []
    if sum(size > 1 for size in array.shape) == 1 and array.size >= 2 * WINDOW:
        found.append(f"one axis has nothing to share: every number takes {_each(model)}. "
                     f"Next: make windows of a signal, array.reshape(-1, {WINDOW})")
    elif model.nbytes >= array.nbytes:
        why = _why_large(model, array, planned)
        found.append(f"the file is no smaller than its source of {array.nbytes} bytes; {why}")
    elif (windows := folded(array.shape)) is not None and (share := _share_of_longest(model)) > MOSTLY:
        found.append(f"the longest axis has more rows than all others together, which take {100 * share:.0f} % of "
                     f"the file. Next: where neighbours are alike, make windows of it, {windows}")
    lost = _lost_channels(model, array) or _few_loud(model, array)
    return found + lost + _labels(model, array) + _undirected(model)


def _share_of_longest(model: Model) -> float:
    """The share of a file that the bases of the mode with the longest axis take, were all numbers of a level alike."""
    longest = max(model.metadata.axes, key=lambda axis: axis.size).name
    n = next(n for n, mode in enumerate(model.metadata.organisation) if longest in mode)
    sizes = zip(model.levels, level_sizes(model.metadata, model.stages), strict=True)
    return sum(size * level.basis[n].size / max(1, level.numbers()) for level, size in sizes) / model.nbytes


def _why_large(model: Model, array: NDArray[Any], planned: bool) -> str:
    """What takes the bytes of a model that is no smaller than its source, and what to do."""
    numbers = sum(level_sizes(model.metadata, model.stages))
    if 2 * numbers < array.nbytes:
        return "header and tables alone take some hundred bytes. Next: compress more data as one array"
    fewer = ("give the plan smaller R or K, or a goal in its place" if planned else
             "ask for less, by --snr or --size, or leave noise as it is: it takes "
             f"{_each(model)} a number")
    return f"{numbers} are for its levels. Next: {fewer}"


def _each(model: Model) -> str:
    """What a number of the last level takes."""
    bits = number_bits(model.levels[-1], level_sizes(model.metadata, model.stages)[-1])
    return "two bytes" if bits == 16 else f"{shown_bits(bits)} bits"


def _lost_channels(model: Model, array: NDArray[Any]) -> list[str]:
    """Whether some channels are lost beside others of larger values, as of quantities that have units of their own.

    A short axis of no known role may be of such quantities, too.
    """
    if not LOUD < model.snr < np.inf:
        return []
    axes = list(enumerate(model.metadata.axes))
    named = [n for n, axis in axes if axis.role == "channel" and axis.size > 1]
    short = [n for n, axis in axes if axis.role == "other" and 1 < axis.size <= SHORT]
    lost = {n: _lost_along(model, array, n) for n in named or short}
    most = max(lost, key=lambda n: len(lost[n]), default=0)
    if not lost or not 0 < len(lost[most]) < array.shape[most]:
        return []
    more = f" and {len(lost[most]) - SOME} more" if len(lost[most]) > SOME else ""
    return [f"along {model.metadata.axes[most].name} the file holds little of index {', '.join(lost[most][:SOME])}"
            f"{more}, as others of larger values make the SNR. "
            "Next: divide each by its own deviation first, or compress them apart"]


def _lost_along(model: Model, array: NDArray[Any], n: int) -> list[str]:
    """The indices of axis n of which errors hide what varies, each with the two, told by a sample."""
    size = array.shape[n]
    steps = thinning([1 if m == n else rows for m, rows in enumerate(array.shape)], max(1, COMPARED // size))
    places = tuple(slice(None, None, 1 if m == n else step) for m, step in enumerate(steps))
    values, decoded = (np.moveaxis(np.asarray(each[places], np.float64), n, 0).reshape(size, -1)
                       for each in (array, model))  # fmt: skip
    drop_pages(array)
    told = np.isfinite(values).all(axis=0)
    if not told.any():
        return []
    deviation = values[:, told].std(axis=1)
    error = np.sqrt(np.square(values - decoded)[:, told].mean(axis=1))
    lost = np.flatnonzero((deviation > 0) & (error > HIDDEN * deviation))
    return [f"{i} (RMSE {error[i]:.2g}, values {deviation[i]:.2g} around their mean)" for i in lost]


def _few_loud(model: Model, array: NDArray[Any]) -> list[str]:
    """Whether a few large values make the SNR while most values are lost."""
    if not LOUD < model.snr < np.inf:
        return []
    places = tuple(slice(None, None, step) for step in thinning(array.shape, COMPARED))
    values, decoded = np.asarray(array[places], np.float64), np.asarray(model[places], np.float64)
    drop_pages(array)
    kept = np.isfinite(values)
    values, decoded = values[kept], decoded[kept]
    if not values.size:
        return []
    middle, error = float(np.median(values)), float(np.median(np.abs(values - decoded)))
    spread = float(np.median(np.abs(values - middle)))
    all_of_them = model.quality[-1].rmse * 10 ** (model.snr / 20)
    most = np.hypot(middle, spread)
    if array.dtype.itemsize == 1 or (spread <= STEPS and bool((values == np.rint(values)).all())):
        return []
    if not (error > HIDDEN * spread > 0 and most / ZERO > all_of_them > FEW * most):
        return []
    helps = ("clip them" if model.metadata.is_transformed else
             f"--transform asinh:{most:.1g}, which gives small values more weight, "
             "or clip the large ones")
    return [f"half of the values are off by {error:.2g} or more, though half of them lie within {spread:.2g} of their "
            f"median: a few large values make the SNR, and the others are lost. Next: {helps}"]


def _labels(model: Model, array: NDArray[Any]) -> list[str]:
    """Whether the values may be labels, of which some are decoded wrong."""
    if array.dtype.kind not in "iub" or not model.quality or model.quality[-1].max_abs_error < 0.5:
        return []
    places = tuple(slice(None, None, step) for step in thinning(array.shape, LOOKED_AT))
    count = len(np.unique(np.asarray(array[places])))
    drop_pages(array)
    if not 1 < count <= LABELS:
        return []
    return [f"a sample has {count} different values, all whole: if they are labels or a mask, what is decoded lies "
            "between them, and an SNR says nothing of how many are right. Next: keep labels in a lossless format"]


def _undirected(model: Model) -> list[str]:
    """Whether pictures of a material have to assume what it was lit and seen from."""
    if model.metadata.kind != "svbrdf":
        return []
    names = [axis.name for axis in model.metadata.axes if axis.role in ("light", "view") and axis.coords is None]
    if not names:
        return []
    given = " ".join(f"--coords {name}=FILE" for name in names)
    return [f"{' and '.join(names)}: no directions are given, so that render and view will assume a spiral. "
            f"Next: give what was measured, {given}"]
