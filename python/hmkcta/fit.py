"""One level on one node: MK-CTA (paper, section 3.2; equation 2).

A disjoint start, cluster subsets and rows by joint least squares in the Gram domain, then Gauss-Seidel sweeps of HOOI
over the cells. Each step lowers the error or leaves it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from . import backends as kernels
from .cells import Cells, empty_cells
from .memberships import start_candidates, strided_sample
from .plan import LevelSpec
from .search import extend, joint_rows, orthonormalise
from .tucker import st_hosvd

F32 = NDArray[np.float32]


@dataclass(frozen=True)
class Effort:
    """How much time a fit may take.

    Attributes:
        candidates: disjoint starts tried for each node's memberships.
        searches: rounds of joint rows with a search for cluster subsets.
        sweeps: Gauss-Seidel sweeps after them; HOOI rounds where nothing is clustered (0: plain HOSVD).
        backfits: rounds in which every level is refitted to what the others leave.
    """

    candidates: int = 3
    searches: int = 2
    sweeps: int = 2
    backfits: int = 1

    @property
    def sweeps_alone(self) -> int:
        """Sweeps where there is nothing to search: in the place of all searches but the first."""
        return self.sweeps + self.searches - 1


EFFORTS = {"fast": Effort(2, 2, 1, 0), "medium": Effort(4, 2, 3, 1), "thorough": Effort(13, 3, 6, 4)}

#: Subspace iterations of a cell's mode update: at a random start, and when it is warm.
COLD, WARM = 4, 2


Labels = Sequence[NDArray[np.intp]]


def fit_level(
    tensor: F32,
    spec: LevelSpec,
    effort: Effort,
    rng: np.random.Generator,
    labels: Labels | None = None,
    *,
    own: bool = False,
) -> tuple[Cells, F32]:
    """Fit one level to a node's (residual) tensor of shape I_1 x .. x I_N.

    Args:
        tensor: what to approximate.
        spec: R, C, K; clamped to the node.
        effort: how long to try.
        rng: for starts.
        labels: the disjoint memberships to start from; None: the best of several candidates.
        own: the tensor is not needed any more, and may be overwritten.

    Returns:
        The cells in float32, not yet rounded, and what they leave of the tensor.
    """
    spec = spec.clamped(tensor.shape)
    if spec.cells == 1:
        return _hooi(tensor, spec, effort, rng)
    labels = labels or _best_labels(tensor, spec, effort, rng)
    searched = spec.search != "fast" and max(spec.mixture) > 1  # on the tensor, which has to stay then
    cells, residual = _disjoint_start(tensor if own and not searched else tensor.copy(), spec, labels, rng)
    if spec.search == "fast":
        _extend_memberships(cells, spec, residual)
    elif searched:
        for _ in range(effort.searches):
            for n in (n for n in range(spec.order) if spec.ranks[n] is not None):
                joint_rows(cells, tensor, n, spec.mixture[n], spec.search)
                orthonormalise(cells, n)
        residual[...] = tensor
        kernels.accumulate(cells, residual, -1.0)
    kernels.fit_cells(cells, residual, effort.sweeps if searched else effort.sweeps_alone, WARM)
    return cells, residual


def left_by(cells: Cells, tensor: F32) -> F32:
    """The tensor minus the cells' reconstruction."""
    residual = np.array(tensor, np.float32, order="C")
    kernels.accumulate(cells, residual, -1.0)
    return residual


def _hooi(tensor: F32, spec: LevelSpec, effort: Effort, rng: np.random.Generator) -> tuple[Cells, F32]:
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
    residual = left_by(cells, tensor)
    kernels.fit_cells(cells, residual, effort.sweeps_alone, WARM)
    return cells, residual


def _best_labels(tensor: F32, spec: LevelSpec, effort: Effort, rng: np.random.Generator) -> Labels:
    """The best of several disjoint memberships (K = 1), judged on a sample by the energy their blocks capture."""
    sample = strided_sample(tensor, spec.clusters)
    best_error, best = np.inf, None
    single = replace(spec, mixture=(1,) * spec.order)
    seed = int(rng.integers(2**63))
    for labels in start_candidates(tensor, spec.clusters, effort.candidates, np.random.default_rng(seed)):
        cells = empty_cells(sample.tensor.shape, single, sample.members(labels), np.random.default_rng(seed))
        residual = sample.tensor.copy()
        kernels.fit_cells(cells, residual, 1, COLD)
        error = float(np.vdot(residual, residual))
        if error < best_error or best is None:
            best_error, best = error, labels
    assert best is not None
    return best


def _disjoint_start(tensor: F32, spec: LevelSpec, labels: Labels, rng: np.random.Generator) -> tuple[Cells, F32]:
    """Truncated HOSVD of every block, by subspace iteration from random bases; the tensor becomes the residual."""
    single = replace(spec, mixture=(1,) * spec.order)
    members = [part[:, None].astype(np.uint16) for part in labels]
    cells = empty_cells(tensor.shape, single, members, rng)
    kernels.fit_cells(cells, tensor, 1, COLD)
    return cells, tensor


def _extend_memberships(cells: Cells, spec: LevelSpec, residual: F32) -> None:
    """The fast search for many clusters: memberships grow one by one, each followed by a sweep."""
    while cells.spec.mixture != spec.mixture:
        for n in range(spec.order):
            if cells.spec.mixture[n] < spec.mixture[n]:
                extend(cells, residual, n)
                kernels.fit_cells(cells, residual, 1, WARM)
