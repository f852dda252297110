"""The metadata of a file that follows a plan."""

from __future__ import annotations

from collections.abc import Sequence
from math import isinf

from ._version import __version__
from .axes import Organisation
from .packed import LevelBounds, LevelQuality, Metadata
from .plan import Plan
from .streaming.source import Source

#: Stand-in for figures of quality that are not measured yet, as long as any.
UNKNOWN = LevelQuality(-99.999999, 1.234567e-05, 1.234567e-05)


def metadata_of(
    source: Source,
    organisation: Organisation,
    levels: Sequence[LevelBounds],
    kind: str,
    seed: int,
    quality: Sequence[LevelQuality] | None = None,
    transformed: Sequence[LevelQuality] | None = None,
) -> Metadata:
    """The metadata of a file of this organisation; `quality` of the values, `transformed` in the fitted domain."""
    facts = dict(source.fingerprint)
    if not source.value_transform.is_identity:
        measured = [level.snr_db for level in transformed or [UNKNOWN] * _with_numbers(levels)]
        facts["transformed_snr_db"] = [None if isinf(snr) else round(snr, 6) for snr in measured]
    return Metadata(
        source_dtype=source.dtype,
        axes=source.axes,
        organisation=organisation,
        stages=tuple(levels),
        kind=kind,
        transform=source.transform,
        quality=tuple(map(_rounded, quality or [UNKNOWN] * _with_numbers(levels))),
        source=facts,
        writer=f"hmkcta {__version__}",
        seed=seed,
    )


def undecomposed_in(plan: Plan) -> tuple[int, ...]:
    """Mode numbers, the same in every level."""
    return tuple(n for n, rank in enumerate(plan.levels[0].ranks) if rank is None)


def _rounded(quality: LevelQuality) -> LevelQuality:
    """A millionth of a dB and seven digits: more are noise, as sums in another order change them."""
    errors = (float(f"{error:.7g}") for error in (quality.rmse, quality.max_abs_error))
    return LevelQuality(round(quality.snr_db, 6), *errors)


def _with_numbers(stages: Sequence[LevelBounds]) -> int:
    return sum(not stage.is_cut for stage in stages)
