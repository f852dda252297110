"""The plan that a model's levels follow."""

from __future__ import annotations

from collections.abc import Sequence

from .packed import Metadata, PackedLevel, undecomposed_modes
from .plan import AUTO, SCHEMES, LevelSpec, Plan


def plan_of(metadata: Metadata, stages: Sequence[PackedLevel]) -> Plan:
    """The plan with the largest R, C and K of any node; parts of cuts are named as clusters of the level behind them.

    >>> from hmkcta._example import example_level, example_metadata
    >>> print(plan_of(example_metadata(), [example_level()]))
    R=1,1
    """
    whole, levels = undecomposed_modes(stages), list[LevelSpec]()
    cuts = [1] * len(metadata.organisation)
    for bounds in metadata.stages:
        clusters = [cut * c for cut, c in zip(cuts, bounds.clusters, strict=True)]
        cuts = clusters if bounds.is_cut else [1] * len(cuts)
        if bounds.is_cut or not all(bounds.clusters):
            continue
        ranks = (None if n in whole and clusters[n] == 1 else r for n, r in enumerate(bounds.ranks))
        mixture = (max(1, k) for k in bounds.mixture)
        scheme = bounds.scheme if bounds.scheme in SCHEMES else AUTO
        levels.append(LevelSpec(tuple(ranks), tuple(clusters), tuple(mixture), scheme))
    return Plan(metadata.organisation, tuple(levels))
