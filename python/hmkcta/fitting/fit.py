"""One level on one node: MK-CTA (paper, section 3.2; equation 2).

It starts from disjoint clusters (K_n = 1). Sweeps follow: for one mode after another the K_n cluster subsets of every
row and its rows of the bases are found by joint least squares in the Gram domain, over-relaxed, and then all cores. On
small nodes, and where an element is in two cells at most, the second half of the sweeps is Gauss-Seidel HOOI instead,
one cell after another. Each step lowers the error or leaves it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from math import prod

import numpy as np
from numpy.typing import NDArray

from .. import backends as kernels
from ..arrays import F32
from ..cells import Cells, empty_cells
from ..metrics import squared_norm
from ..plan import LevelSpec
from .matrix_free import joint_sweep, sets_pay
from .memberships import start_candidates, strided_sample
from .reassign import assign_rows, search_memberships, with_all_rows
from .search import OVER_RELAXED, sweep
from .swaps import exchange, extend
from .tucker import st_hosvd


@dataclass(frozen=True)
class Effort:
    """How much time a fit may take.

    Attributes:
        candidates: disjoint starts that are compared where K_n = 1 in all modes, or the search is fast.
        starts: the same where some K_n > 1; a single one is taken as it is.
        sweeps: over all modes, where some K_n > 1; those of joint rows, which come first, search for cluster subsets.
        rounds: of the search for disjoint memberships, over all modes, from the best start; it may end sooner.
        hooi: HOOI rounds where K_n = 1 (0: plain HOSVD), or where the search is ``fast``.
        backfits: rounds in which every level is refitted to what the others leave.
        searched: whether disjoint memberships that were searched for are one more start where some K_n > 1.
    """

    candidates: int
    starts: int
    sweeps: int
    rounds: int
    hooi: int
    backfits: int
    searched: bool = True

    def at(self, level: int, levels: int, elements: int, nodes: int) -> Effort:
        """For a level (from 1) of so many, of a tensor of so many elements, that has so many nodes.

        Levels that others follow are swept twice as often: their nodes are few, and what they leave those below have to
        make up for. Small tensors are swept up to `MOST` times as often, in no more time than one of `SMALL` elements
        takes. Memberships are searched for before clusters overlap only in a single last node: in levels that others
        follow clusters of nearly equal size end as high, and take less time.
        """
        least = 1 if level == levels else 2
        times = max(least, min(MOST, SMALL // elements))
        return replace(self, sweeps=self.sweeps * times, searched=level == levels and nodes == 1)


#: Elements of tensors that are swept more often, and how many times as often at the most: on 2,000 to 6,000 elements
#: five times gain 1 to 14 dB.
SMALL, MOST = 1 << 20, 5

EFFORTS = {
    "fast": Effort(candidates=2, starts=1, sweeps=2, rounds=3, hooi=2, backfits=0),
    "medium": Effort(candidates=3, starts=3, sweeps=5, rounds=8, hooi=4, backfits=1),
    "thorough": Effort(candidates=13, starts=13, sweeps=12, rounds=20, hooi=8, backfits=4),
}

#: Elements that disjoint memberships are searched on; the other rows then follow.
SEARCHED = 1 << 20
#: Rounds over all modes after which searches from several starts are compared.
JUDGING = 2
#: Elements that starts are judged on by a joint sweep.
JUDGED = 1 << 19
#: What a joint sweep costs for each number of H, in visits of a Gauss-Seidel sweep to an element of a cell.
GRAM_VISITS = 20
#: The same for each element of the tensor.
PASS_VISITS = 4
#: How many Gauss-Seidel sweeps take the place of a joint one that costs more.
IN_PLACE = 2

#: Subspace iterations of a cell's mode update where its bases are random.
COLD = 4
#: The same where they were fitted before.
WARM = 2

Labels = Sequence[NDArray[np.intp]]


def fit_level(
    tensor: F32,
    spec: LevelSpec,
    effort: Effort,
    rng: np.random.Generator,
    labels: Labels | None = None,
    *,
    overwrite: bool = False,
) -> Cells:
    """Fit one level to a node's (residual) tensor of shape I_1 x .. x I_N.

    Args:
        tensor: what to approximate.
        spec: R, C, K; clamped to the node.
        effort: how long to try.
        rng: for starts.
        labels: the disjoint memberships to start from; None: the best of several candidates.
        overwrite: the tensor is not needed any more, and may be overwritten.

    Returns:
        The cells in float32, not yet rounded.
    """
    spec = spec.clamped(tensor.shape)
    if spec.cells == 1:
        return _hooi(tensor, spec, effort, rng, overwrite)
    if spec.search == "fast" or max(spec.mixture) == 1:
        return _sequential(tensor if overwrite else tensor.copy(), spec, effort, labels, rng)
    cells = _start(tensor, spec, effort, labels, rng)
    joint = effort.sweeps if _joint_pays(cells) else (effort.sweeps + 1) // 2
    omegas = [OVER_RELAXED if number < effort.sweeps else 1.0 for number in range(2, joint + 1)]
    sweep(cells, tensor, spec.mixture, spec.search, omegas)
    if joint < effort.sweeps:
        kernels.fit_cells(cells, left_by(cells, tensor), IN_PLACE * (effort.sweeps - joint), WARM)
    return cells


def _sequential(
    residual: F32, spec: LevelSpec, effort: Effort, labels: Labels | None, rng: np.random.Generator
) -> Cells:
    """Cell after cell: K = 1, or so many clusters that even H does not fit; then sets change by exchange."""
    cells = _disjoint(residual, spec, labels or _searched_labels(residual, spec, effort, rng), rng)
    while cells.spec.mixture != spec.mixture:
        for n in range(spec.order):
            if cells.spec.mixture[n] < spec.mixture[n]:
                extend(cells, residual, n)
                kernels.fit_cells(cells, residual, 1, WARM)
    for _ in range(effort.sweeps if max(spec.mixture) > 1 else 0):
        exchange(cells, residual)
        _sweep_by_residual(cells, residual)
    kernels.fit_cells(cells, residual, effort.hooi, WARM)
    return cells


def _sweep_by_residual(cells: Cells, residual: F32) -> None:
    """A sweep over cells whose H is too large: of joint rows, set by set, if that pays, or of Gauss-Seidel."""
    if sets_pay(cells):
        joint_sweep(cells, residual, OVER_RELAXED)
    else:
        kernels.fit_cells(cells, residual, 1, WARM)


def refit_level(cells: Cells, residual: F32) -> None:
    """Sweeps over fitted cells with the memberships they have; they and the residual they leave change in place."""
    if max(cells.spec.mixture) == 1:
        kernels.fit_cells(cells, residual, 1, WARM)
        return
    if cells.spec.search == "fast":
        _sweep_by_residual(cells, residual)
        return
    if not _joint_pays(cells):
        kernels.fit_cells(cells, residual, IN_PLACE, WARM)
        return
    kernels.accumulate(cells, residual, 1.0)
    sweep(cells, residual, cells.spec.mixture, "fixed", (OVER_RELAXED, 1.0))
    kernels.accumulate(cells, residual, -1.0)


def _joint_pays(cells: Cells) -> bool:
    """Whether a sweep of joint rows and cores costs no more than the Gauss-Seidel sweeps that get as far.

    It makes two passes over the tensor and factors H of every mode; Gauss-Seidel visits each element prod K_n times.
    """
    decomposed = [n for n, skip in enumerate(cells.undecomposed) if not skip]
    numbers = sum((cells.spec.cells * cells.ranks[n]) ** 2 for n in decomposed)
    visits = IN_PLACE * prod(cells.spec.mixture)
    return prod(cells.sizes) * (visits - PASS_VISITS) > GRAM_VISITS * numbers


def left_by(cells: Cells, tensor: F32) -> F32:
    """The tensor minus the cells' reconstruction."""
    residual = np.array(tensor, np.float32, order="C")
    kernels.accumulate(cells, residual, -1.0)
    return residual


def _hooi(tensor: F32, spec: LevelSpec, effort: Effort, rng: np.random.Generator, overwrite: bool) -> Cells:
    """C_n = 1 throughout: truncated HOSVD, then HOOI rounds (paper, section 3.1)."""
    members = [np.zeros((size, 1), np.uint16) for size in tensor.shape]
    cells = empty_cells(tensor.shape, spec, members, rng)
    bases, core = st_hosvd(tensor, spec.ranks, rng)
    for n, basis in enumerate(bases):
        if basis is not None:
            cells.bases[n][:] = 0
            cells.bases[n][:, 0, 0, : basis.shape[1]] = basis
    cells.cores[:] = 0
    cells.cores[(0, *map(slice, core.shape))] = core
    residual = tensor if overwrite else tensor.copy()
    kernels.accumulate(cells, residual, -1.0)
    kernels.fit_cells(cells, residual, effort.hooi, WARM)
    return cells


def _searched_labels(tensor: F32, spec: LevelSpec, effort: Effort, rng: np.random.Generator) -> Labels:
    """Disjoint memberships: the best of several starts after a search from each, on a sample, and then of all rows."""
    spec = replace(spec, mixture=(1,) * spec.order)
    sample = strided_sample(tensor, spec.clusters, SEARCHED)
    seed = int(rng.integers(2**63))

    def searched(labels: Labels) -> Cells:
        cells = _disjoint(sample.tensor.copy(), spec, sample.labels(labels), np.random.default_rng(seed))
        search_memberships(cells, sample.tensor, JUDGING)
        return cells

    starts = start_candidates(tensor, spec, effort.candidates, np.random.default_rng(seed))
    cells = max(map(searched, starts), key=lambda cells: squared_norm(cells.cores))  # which is what they explain
    search_memberships(cells, sample.tensor, effort.rounds)
    for n, step in enumerate(sample.steps):
        if step > 1 and not cells.undecomposed[n]:
            cells = with_all_rows(cells, n, tensor.shape[n], step)
            seen = [1 if own == size else step for own, size, step in zip(cells.sizes, tensor.shape, sample.steps,
                                                                          strict=True)]
            assign_rows(cells, tensor[tuple(slice(None, None, step) for step in seen)], n)
    whole = zip(cells.members, tensor.shape, strict=True)  # an undecomposed mode, of one cluster, may still be thinned
    return [np.resize(members[:, 0], size).astype(np.intp) for members, size in whole]


def _start(tensor: F32, spec: LevelSpec, effort: Effort, labels: Labels | None, rng: np.random.Generator) -> Cells:
    """Cells after a first sweep: the best of several disjoint memberships, judged by just that.

    The energy that disjoint blocks capture says little about how well two or more of them together will fit. Large
    tensors are judged on a sample, and start disjoint from the best labels.
    """

    def swept(tensor: F32, labels: Labels) -> Cells:
        cells = _disjoint(tensor.copy(), spec, labels, np.random.default_rng(seed))
        sweep(cells, tensor, spec.mixture, spec.search)
        return cells

    seed = int(rng.integers(2**63))
    if labels is None and effort.starts == 1:
        labels = next(start_candidates(tensor, spec, 1, rng, overlap=True))
    if labels is None:
        sample, starts = strided_sample(tensor, spec.clusters, JUDGED), np.random.default_rng(seed)
        searched = (_searched_labels(tensor, spec, effort, starts) for _ in range(effort.searched))
        candidates = chain(start_candidates(tensor, spec, effort.starts, starts, overlap=True), searched)
        tried = ((swept(sample.tensor, sample.labels(candidate)), candidate) for candidate in candidates)
        best, labels = min(tried, key=lambda start: squared_norm(left_by(start[0], sample.tensor)))
        if best.sizes == tensor.shape:
            return best
    return swept(tensor, labels)


def _disjoint(tensor: F32, spec: LevelSpec, labels: Labels, rng: np.random.Generator) -> Cells:
    """Truncated HOSVD of every block, by subspace iteration from random bases; the tensor becomes the residual."""
    single = replace(spec, mixture=(1,) * spec.order)
    members = [part[:, None].astype(np.uint16) for part in labels]
    cells = empty_cells(tensor.shape, single, members, rng)
    kernels.fit_cells(cells, tensor, 1, COLD)
    return cells
