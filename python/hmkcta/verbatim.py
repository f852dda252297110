"""An array as a model that leaves it as it is: one node, no mode decomposed, the numbers as float16 times one scale.

A decoder that shows a model next to its original needs no other way to read the original. Of numbers far from the
subnormal ones float16 keeps 11 bits, an SNR of about 73 dB.
"""

from __future__ import annotations

from math import frexp, prod
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .axes import deorganise, organise
from .errors import HmkctaError, Kind, invalid
from .metrics import snr_db
from .packed import LevelBounds, LevelQuality, Metadata, PackedLevel
from .streaming.source import as_array

#: What the viewer's GPU image may take, less than the 640 MiB of its five pages.
MOST_BYTES = 512 << 20


def verbatim(array: ArrayLike, like: Metadata, nan: float | None = None) -> tuple[Metadata, PackedLevel]:
    """Metadata and the one level of a model with the array's values, in the axes and modes of another model.

    Raises:
        HmkctaError: the array is none of real numbers, has another shape than the model, numbers that are not finite
            and `nan` does not stand for them, or more than `MOST_BYTES` as float16.

    >>> from hmkcta._example import example_metadata
    >>> metadata, level = verbatim(np.arange(6.0).reshape(2, 3), example_metadata())
    >>> metadata.stages[0].mixture, (level.core_scale[0] * level.core.astype(np.float32)).tolist()
    ((0, 0), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
    """
    if isinstance(shape := getattr(array, "shape", None), tuple):  # of a dataset, before it is read
        check_shape(cast("tuple[int, ...]", shape), like)
    elements = prod(axis.size for axis in like.axes)
    if 2 * elements > MOST_BYTES:
        raise HmkctaError(Kind.RESOURCE_LIMIT, "original-too-large", "original", found=f"{elements} elements",
                          allowed=f"at most {MOST_BYTES // 2}, which a GPU holds next to the model",
                          hint="compress a part of it, and compare that")
    numbers = as_array(array, "original")
    check_shape(numbers.shape, like)
    values = np.asarray(numbers, np.float32)
    if nan is not None:
        values = np.where(np.isfinite(values), values, np.float32(nan))
    peak = float(np.abs(values).max(initial=0))
    if not np.isfinite(peak):
        raise invalid("not-finite", "original", "NaN or infinity", "finite numbers",
                      "give the value that replaced them, nan=0 or --nan fill=0")
    scale = 2.0 ** (max(frexp(peak)[1], -100) - 15)
    core = organise(values / np.float32(scale), like.axes, like.organisation).astype(np.float16)
    stored = deorganise(core.astype(np.float32) * np.float32(scale), like.axes, like.organisation)
    metadata = Metadata(
        source_dtype=like.source_dtype, axes=like.axes, organisation=like.organisation,
        stages=(LevelBounds(*_bounds(core.shape), "most"),), kind=like.kind,
        quality=(_quality(values, values - stored),), writer=like.writer,
    )
    return metadata, _level(core, scale)


def check_shape(shape: tuple[int, ...], like: Metadata) -> None:
    """Refuse an original of another shape than the model; what its axes are called is of no account.

    Raises:
        HmkctaError: the sizes differ, or their order.
    """
    wanted = tuple(axis.size for axis in like.axes)
    if shape != wanted:
        raise invalid("original-shape", "original", shape, f"{wanted}, the model's",
                      "give the array that was compressed, or a file made of it, with its axes in this order")


def _bounds(sizes: tuple[int, ...]) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
    return (1,) * len(sizes), (0,) * len(sizes), sizes


def _level(core: NDArray[np.float16], scale: float) -> PackedLevel:
    none, empty = (None,) * core.ndim, (_offsets(0),) * core.ndim
    return PackedLevel(
        shape=np.array([_bounds(core.shape)], np.uint32), child=None,
        row_offset=tuple(_offsets(size) for size in core.shape), core=core.reshape(-1), core_offset=_offsets(core.size),
        core_scale=np.array([scale], np.float32), cell_offset=_offsets(1),
        cluster=(np.zeros(0, np.uint16),) * core.ndim, cluster_offset=empty,
        basis=(np.zeros(0, np.float16),) * core.ndim, basis_offset=empty, part=none, local=none,
    )


def _offsets(size: int) -> NDArray[np.uint32]:
    return np.array([0, size], np.uint32)


def _quality(values: NDArray[np.float32], difference: NDArray[np.float32]) -> LevelQuality:
    """Of what float16 makes of the values."""
    error = float(np.square(difference, dtype=np.float64).sum())
    power = float(np.square(values, dtype=np.float64).sum())
    return LevelQuality(snr_db(power, error), (error / values.size) ** 0.5, float(np.abs(difference).max(initial=0)))
