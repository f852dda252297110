"""A fitted model of a written plan, its numbers rounded to whole ones of a step D and coded: D is what the goal takes.

Ranks, clusters and memberships are the plan's; only the precision of numbers follows the goal. The core of a cell is
refitted to its bases as rounded, by the fitted cell alone, so that the source is not needed until the file is measured.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import log, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32, F64
from ..errors import invalid
from ..filesize import metadata_of
from ..fitting.run import Run
from ..hmkfile import root_places
from ..measure import measure_both
from ..metrics import noise_at
from ..model import Model
from ..packed import PackedLevel
from ..streaming.source import Source
from ..support.extension import native
from .block_code import I32, MOST_EXPONENT, U8, rounded
from .engine import LEAST_STEP, Goal
from .hosvd import mode_product
from .roots import OVERSHOT, USED, meet
from .stages import widened

#: D begins at this share of the root mean square of the values.
FIRST_STEP = 0.02
#: Rounding that adds less than this share of what it may add is taken to add just that.
_LEAST = 0.1


@dataclass(frozen=True, eq=False)
class NodeCode:
    """Whole numbers of a node's cells; exponents `[PC, R_n]`, bases `[I_n, K_n, PC_-n, R_n]`, cores `[PC, R_1, ..]`."""

    exponents: tuple[U8, ...]
    bases: tuple[I32, ...]
    core: I32


def code_node(
    cores: F32, members: list[NDArray[np.uint16]], bases: list[F32 | None], clusters: tuple[int, ...], step: float
) -> NodeCode:
    """Round the cells of a node at a step D.

    Args:
        cores: `[PC, R_1, .., R_N]`.
        members: for each mode the cluster subsets of its rows, `[I_n, K_n]`.
        bases: for each mode `[I_n, K_n, PC_-n, R_n]`, of orthonormal columns in each cell; None: it is undecomposed.
        clusters: C.
        step: D.

    >>> basis = np.array([0.6, 0.8], np.float32).reshape(2, 1, 1, 1)
    >>> code = code_node(np.full((1, 1), 50, np.float32), [np.zeros((2, 1), np.uint16)], [basis], (1,), 1.0)
    >>> code.exponents[0].item(), code.bases[0].ravel().tolist(), code.core.item()
    (11, [27, 36], 50)
    """
    order = len(clusters)
    core: F64 = cores.astype(np.float64)
    exponents, whole = [np.zeros(0, np.uint8)] * order, [np.zeros(0, np.int32)] * order
    for n, basis in enumerate(bases):
        if basis is None:
            continue
        others = tuple(1 + m for m in range(order) if m != n)
        energies: F64 = np.square(core).sum(axis=others) / step**2  # [PC, R_n]
        exponents[n] = np.clip(np.round(np.log2(np.maximum(energies, 1.0))), 0, MOST_EXPONENT).astype(np.uint8)
        scale = np.moveaxis(np.exp2(exponents[n] / 2).reshape(*clusters, -1), n, 0)  # [C_n, .., R_n]
        whole[n], change = _rounded_basis(basis, members[n], scale.reshape(clusters[n], -1, scale.shape[-1]))
        own: F64 = np.moveaxis(change.reshape(*scale.shape, -1), 0, n).reshape(len(core), core.shape[1 + n], -1)
        core = mode_product(own, core, n)
    return NodeCode(tuple(exponents), tuple(whole), np.asarray(rounded(core / step), np.int32))


def _rounded_basis(basis: F32, members: NDArray[np.uint16], scale: F64) -> tuple[I32, F64]:
    """Whole numbers of a mode's basis of these scales `[C_n, PC_-n, R_n]`, and how cores change with it.

    Cores are multiplied by the latter, `[C_n, PC_-n, R_n, R_n]`, so that the cell stays as close as can be to itself.
    """
    whole = np.zeros(basis.shape, np.int32)
    change = np.zeros((*scale.shape, scale.shape[-1]))
    for c in range(len(scale)):
        at = members == c
        columns: F64 = basis[at].transpose(1, 0, 2).astype(np.float64)  # [PC_-n, rows, R_n]
        numbers: F64 = np.asarray(rounded(columns * scale[c][:, None]), np.float64)
        whole[at] = numbers.transpose(1, 0, 2)
        decoded = numbers / scale[c][:, None]
        gram = decoded.swapaxes(1, 2) @ decoded + 1e-9 * np.eye(scale.shape[-1])
        change[c] = np.linalg.solve(gram, decoded.swapaxes(1, 2) @ columns)
    return whole, change


class FittedCode:
    """The stages of a fitted model, float16, and their code at any step."""

    def __init__(self, model: Model) -> None:
        """Nothing is coded yet."""
        self.model = model
        self.stages = model.stages
        self.root = root_places(model.metadata.axes, model.metadata.organisation)

    @property
    def rms(self) -> float:
        """Root mean square of the values, about: of orthonormal columns the cores have all energy."""
        cores = (core for stage in self.stages for core, _ in _cells(stage))
        energy = sum(float(np.square(core, dtype=np.float64).sum()) for core in cores)
        return sqrt(energy / self.model.size)

    def at(self, step: float) -> tuple[PackedLevel, ...]:
        """All stages at a step D, as a reader widens them from the file."""
        step = float(np.float32(step))
        coded: list[tuple[dict[str, Any], dict[str, Any]]] = []
        places = self.root
        for stage in self.stages:
            own = _coded(stage, step)
            coded.append((own, places))
            if stage.child is not None:
                places = native.next_stage(own["shape"], own["children"], own["part"], places)
        after = [*(at for _, at in coded[1:]), None]
        return tuple(widened(stage, at, following, step) for (stage, at), following in zip(coded, after, strict=True))


def _cells(stage: PackedLevel) -> Iterator[tuple[F32, int]]:
    """Cores `[PC, R_1, .., R_N]` of every node that has some, and its number."""
    for s in np.flatnonzero(stage.has_cells).tolist():
        ranks = stage.shape[s, 2].tolist()
        scale = stage.core_scale[stage.cell_offset[s] : stage.cell_offset[s + 1]]
        core = stage.core[stage.core_offset[s] : stage.core_offset[s + 1]].astype(np.float32)
        yield core.reshape(len(scale), *ranks) * scale.reshape(-1, *[1] * len(ranks)), s


def _coded(stage: PackedLevel, step: float) -> dict[str, Any]:
    """What the native coder takes of a stage at a step D."""
    nodes = [_node(stage, core, s, step) for core, s in _cells(stage)]

    def joined(arrays: list[NDArray[Any]], dtype: Any) -> NDArray[Any]:
        return np.concatenate([np.zeros(0, dtype), *(array.reshape(-1) for array in arrays)], dtype=dtype)

    return {
        "last": stage.child is None,
        "coded": True,
        "shape": np.ascontiguousarray(stage.shape).reshape(-1),
        "children": np.zeros(stage.nodes, np.uint32) if stage.child is None else np.diff(stage.child).astype(np.uint32),
        "cluster": list(stage.cluster),
        "part": [array for array in stage.part if array is not None],
        "column": [joined([node.exponents[n] for node in nodes], np.uint8) for n in range(stage.order)],
        "core": joined([node.core for node in nodes], np.int32),
        "basis": [joined([node.bases[n] for node in nodes], np.int32) for n in range(stage.order)],
    }


def _node(stage: PackedLevel, core: F32, s: int, step: float) -> NodeCode:
    clusters, mixture, ranks = stage.shape[s].tolist()
    members = [own[start[s] : start[s + 1]].reshape(-1, max(1, k))
               for own, start, k in zip(stage.cluster, stage.cluster_offset, mixture, strict=True)]
    bases: list[F32 | None] = []
    for n, k in enumerate(mixture):
        own = stage.basis[n][stage.basis_offset[n][s] : stage.basis_offset[n][s + 1]]
        bases.append(own.astype(np.float32).reshape(-1, k, len(core) // clusters[n], ranks[n]) if k else None)
    return code_node(core, members, bases, tuple(clusters), step)


def coded_for(model: Model, source: Source, goal: Goal, run: Run) -> Model:
    """The fitted model coded at the largest step that meets the goal; as it is, where that does, or the fit does not.

    Raises:
        HmkctaError: reason ``size-too-small``: no step makes it so small.
    """
    if (goal.size is not None and model.nbytes <= goal.size) or (goal.snr is not None and model.snr < goal.snr):
        return model
    fitted = FittedCode(model)
    rms = fitted.rms
    if rms == 0:
        return model
    by_size = goal.size is not None

    def attempt(step: float) -> tuple[float, Model]:
        coded = _with_quality(model, fitted.at(step), source, None if by_size else run)
        return _excess(coded, model, goal), coded

    bounds = LEAST_STEP * rms, 4 * rms * sqrt(model.size)
    tolerance, slope = (-log(USED), -1.0) if by_size else (_tolerance(goal, model), 1.5)
    found = meet(attempt, FIRST_STEP * rms, tolerance, slope, bounds=bounds)
    if found.excess > 0 and by_size:
        allowed = f"at least {found.result.nbytes} bytes for this plan"
        raise invalid("size-too-small", "size", f"{goal.size} bytes", allowed,
                      "leave the plan out, and one is found for the size")
    if found.excess > 0:  # float16 numbers keep more
        return model
    return _with_quality(model, found.result.stages, source, run) if by_size else found.result


def _excess(coded: Model, fitted: Model, goal: Goal) -> float:
    """How far above the goal a file is, as a logarithm: by its bytes, or by what rounding adds to the fit's error.

    The error of the fit is there at any step: what rounding adds alone follows D.
    """
    if goal.size is not None:
        return log(coded.nbytes / goal.size)
    assert goal.snr is not None, "a goal has one of the two"
    added, allowed = noise_at(coded.snr) - noise_at(fitted.snr), noise_at(goal.snr) - noise_at(fitted.snr)
    return log(max(added, _LEAST * allowed) / allowed) if allowed > 0 else float(added > 0)


def _tolerance(goal: Goal, fitted: Model) -> float:
    """How far below the goal what rounding adds may be for an SNR that is overshot by no more than `OVERSHOT` dB."""
    assert goal.snr is not None, "a goal has one of the two"
    allowed = noise_at(goal.snr) - noise_at(fitted.snr)
    share = (noise_at(goal.snr) - noise_at(goal.snr + OVERSHOT)) / allowed if allowed > 0 else 1.0
    return -log(max(1 - share, _LEAST))


def _with_quality(model: Model, stages: tuple[PackedLevel, ...], source: Source, run: Run | None) -> Model:
    """A model of these stages, and of what else the fitted one is; measured where there is a run to tell of it."""
    metadata = model.metadata

    def made(*quality: Any) -> Model:
        own = metadata_of(source, metadata.organisation, metadata.stages, metadata.kind, metadata.seed, *quality)
        found = Model(replace(own, writer=metadata.writer), stages)
        found.made_by = model.made_by
        return found

    coded = made()
    return coded if run is None else made(*measure_both(coded, source.array, nan=source.nan, progress=run.progress))
