"""The last level cut to a goal: every node has ranks of its own, so that bytes are filled and an SNR is just met."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf

import numpy as np

from ..errors import invalid
from ..fitting.hierarchy import Hierarchy, LabelsOf, Run
from ..fitting.memberships import by_subspaces, start_candidates
from ..metrics import noise_at
from ..plan import LevelSpec
from ..streaming.streamed import Streamed
from .allocation import Spectrum, merged
from .examining import EXAMINING, Goal, Way, examined
from .last_level import LastLevel, with_ranks
from .to_size import to_size
from .to_snr import to_snr


def fit_to_goal(tree: Hierarchy, ways: Sequence[Way], goal: Goal, decode_cost: int, run: Run) -> None:
    """Fit the deepest level with node shapes of its own, again with corrected ranks until the goal is met."""
    nodes = tree.levels[-1]
    run.progress(EXAMINING, 0.0)  # finding the clusters to start from takes its time already
    ways = [each for spec, labels in ways for each in _starts(tree, spec, labels, run)]
    spectra = examined(tree, ways, goal, decode_cost, run)
    further = _parted_anew(tree, ways, spectra[0], goal, run)
    if further:
        spectra[0] += examined(tree, further, goal, decode_cost, run, first=len(ways))[0]
        ways += further
    found = [(s, merged(own, hull=len(nodes) > 1)) for s, own in enumerate(spectra) if own]
    if found:
        level = LastLevel(tree, found, ways, goal, run)
        to_size(level, goal.size) if goal.size is not None else to_snr(level, goal.snr or 0.0)


def _parted_anew(
    tree: Hierarchy, ways: Sequence[Way], spectra: Sequence[Spectrum], goal: Goal, run: Run
) -> list[Way]:
    """The way that promises most, with its clusters found anew by K-subspaces of the ranks it would have.

    Before the ways were examined these ranks were not known. None for blocks, single cells, and streamed tensors.
    """
    if isinstance(tree.residual, Streamed) or not spectra or ways[0][0].cells == 1 or ways[0][0].grid:
        return []
    choices = merged(spectra, hull=False)
    within = inf if goal.size is None else float(goal.size)
    beyond = 0.0 if goal.snr is None else noise_at(goal.snr, goal.energy)
    affordable = np.flatnonzero((choices.nbytes <= within) & (choices.error >= beyond))
    if not len(affordable):
        return []
    best = affordable[np.argmin(choices.error[affordable])]
    if choices.nbytes[best] == choices.nbytes[0]:  # nothing is stored
        return []
    spec, _ = ways[int(choices.way[best])]
    told, rng = with_ranks(spec, choices.ranks[best]), np.random.default_rng(run.seed)
    return [(spec, lambda _, found=found: found) for found in by_subspaces(tree.residual, told, rng)]


def _starts(tree: Hierarchy, spec: LevelSpec, labels: LabelsOf, run: Run) -> list[Way]:
    """The way itself, or where its cells are clusters of the data one for each start that the effort allows.

    Raises:
        HmkctaError: clusters of a tensor that memory does not hold.
    """
    if spec.cells == 1 or spec.grid:
        return [(spec, labels)]
    if isinstance(tree.residual, Streamed):
        allowed = "R=.. with the clusters of an array that is not worked on in one piece"
        raise invalid("own-ranks-clusters", "level 1", str(spec), allowed, "give ranks, or raise --max-memory")
    starts = start_candidates(tree.residual, spec, run.effort.candidates, np.random.default_rng(run.seed))
    return [(spec, lambda _, found=found: found) for found in starts]
