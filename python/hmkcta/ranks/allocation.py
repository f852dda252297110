"""Ranks of every node's own by one global Lagrange multiplier: least error for the bytes spent.

Each node picks, from what HOSVD captures at every choice of ranks (`tucker.core_energies`), the ranks that minimise
error + multiplier * bytes; the multiplier is bisected until the level meets its bytes or its error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

#: Fewest bits that numbers take on average.
FEWEST_BITS, MOST_BITS = 2.0, 14.0
#: How many choices are at most changed to some off the convex hulls, once the multiplier is found: the last step along
#: the hulls leaves some of the goal unused.
TRIMS = 8
#: Nodes beyond which none is changed so for a size: the last step is small then.
FEW = 256
#: The bisection ends where the bytes that two multipliers spend differ by this share.
CLOSE = 0.01
#: A choice is left out that, taken by all nodes, leaves more than so many times the error of a cheaper one.
ASIDE = 2.0
#: Bits that a number of a packed level takes on average at 0 dB, and how many more for each dB; and where no SNR tells.
BITS_AT, BITS_UNTOLD = (2.9, 0.045), 4.5
#: Shapes of nodes whose choices are kept: those of a grid differ by a row along each mode.
SHAPES = 16


def stored_bits(bits: int, snr: float | None) -> float:
    """Bits that a number takes, on average, of a level of ranks of its own with so many `bits`, for an SNR in dB.

    >>> stored_bits(16, 30.0), stored_bits(8, 30.0)
    (16, 4.25)
    """
    if bits == 16:
        return bits
    return BITS_UNTOLD if snr is None else min(max(BITS_AT[0] + BITS_AT[1] * snr, FEWEST_BITS), MOST_BITS)


def empty_node_bytes(order: int, stored: int, bits: float = 16) -> float:
    """Table entries of every node, also one that carries nothing: shape and offsets; of short tables shape alone."""
    return 8.0 + 16 * order + 8 * stored if bits == 16 else 3.0 * order


def row_bytes(clusters: int, bits: float = 16) -> float:
    """Table entry of a row in a node with so many clusters and K_n = 1: its cluster number."""
    if bits == 16 or clusters > 256:
        return 2.0
    return float(clusters > 1)


@dataclass(frozen=True)
class Spectrum:
    """One node's choices: what it would leave and cost at every choice of ranks that no other beats in both.

    Attributes:
        error: squared error left, `[choices]`, descending; the first choice is to store nothing.
        nbytes: bytes in the file, `[choices]`, ascending.
        ranks: `[choices, N]`.
        steps: indices of the choices that a multiplier may pick.
        way: number of the way to cut the node into cells, `[choices]`.
    """

    error: F64
    nbytes: F64
    ranks: NDArray[np.int32]
    steps: NDArray[np.intp]
    way: NDArray[np.intp]


def node_bytes(
    sizes: Sequence[float],
    ranks: NDArray[np.int32],
    undecomposed: Sequence[bool],
    clusters: Sequence[int],
    bits: float = 16,
) -> F64:
    """Bytes of a node with K_n = 1: numbers of so many bits, and its entries of tables; ranks `[.., N]`."""
    stored = [n for n in range(len(sizes)) if not undecomposed[n]]
    cells = float(np.prod(clusters))
    basis = sum(ranks[..., n] * (sizes[n] * cells / clusters[n]) for n in stored)
    numbers = cells * np.prod(ranks.astype(np.float64), axis=-1) + basis
    rows = sum(row_bytes(clusters[n], bits) * sizes[n] for n in stored)
    widths = 0.0 if bits == 16 else ranks[..., stored].sum(axis=-1)
    return bits / 8 * numbers + 4.0 * cells + rows + widths + empty_node_bytes(len(sizes), len(stored), bits)


def spectrum(
    table: F64,
    energy: float,
    sizes: Sequence[int],
    undecomposed: Sequence[bool],
    decode_cost: int,
    clusters: Sequence[int] | None = None,
    *,
    hull: bool = True,
    bits: float = 16,
) -> Spectrum:
    """The choices among all ranks within the decode cost.

    Args:
        table: captured energy by ranks, from `tucker.core_energies`.
        energy: the node's squared norm.
        sizes: its mode sizes.
        undecomposed: modes that keep their identity basis.
        decode_cost: largest prod R_n over decomposed modes.
        clusters: cells of the node along each mode, which all get the same ranks; None: one cell.
        hull: steps are those on the lower convex hull of (bytes, error) only, else all of them.
        bits: of a number in the file, on average.
    """
    steps = tuple(tuple(range(1, extent + 1)) for extent in table.shape)
    cells = tuple(clusters or [1] * len(sizes))
    choices = choices_of(steps, tuple(sizes), tuple(undecomposed), decode_cost, cells, bits)
    error = np.concatenate([[energy], np.maximum(energy - table.reshape(-1)[choices.entry], 0.0)])
    kept = pareto(choices.nbytes, error)
    error, nbytes = error[kept], choices.nbytes[kept]
    every = np.arange(len(kept))
    return Spectrum(error, nbytes, choices.ranks[kept], _hull(nbytes, error) if hull else every, np.zeros_like(every))


def merged(ways: Sequence[Spectrum], *, hull: bool = True) -> Spectrum:
    """The choices of a node that can be cut in several ways; `hull`: as of `spectrum`."""
    if len(ways) == 1:
        return ways[0]
    error, nbytes, ranks, way = (
        np.concatenate([getattr(own, of) for own in ways]) for of in ("error", "nbytes", "ranks", "way")
    )
    order = np.lexsort((-error, nbytes))
    order = order[pareto(nbytes[order], error[order])]
    error, nbytes = error[order], nbytes[order]
    return Spectrum(error, nbytes, ranks[order], _hull(nbytes, error) if hull else np.arange(len(order)), way[order])


@dataclass(frozen=True)
class Choices:
    """All ranks within a decode cost by ascending bytes: first to store nothing, then one for each table entry."""

    ranks: NDArray[np.int32]
    nbytes: F64
    entry: NDArray[np.intp]


@lru_cache(maxsize=SHAPES)
def choices_of(
    steps: tuple[tuple[int, ...], ...],
    sizes: tuple[float, ...],
    undecomposed: tuple[bool, ...],
    decode_cost: int,
    clusters: tuple[int, ...],
    bits: float = 16,
) -> Choices:
    """What can be chosen of the ranks in a table, `steps` of each mode, and what it costs."""
    grid = np.meshgrid(*(np.array(own, np.int32) for own in steps), indexing="ij")
    ranks = np.stack([axis.reshape(-1) for axis in grid], axis=1)
    ranks[:, list(undecomposed)] = np.array(sizes)[list(undecomposed)]
    cost = np.prod(ranks[:, [not flag for flag in undecomposed]].astype(np.float64), axis=1)
    allowed = np.flatnonzero(cost <= decode_cost)
    nbytes = node_bytes(sizes, ranks[allowed], undecomposed, clusters, bits)
    order = np.argsort(nbytes, kind="stable")
    empty = empty_node_bytes(len(sizes), len(sizes) - sum(undecomposed), bits)
    nothing = np.zeros((1, len(sizes)), np.int32)
    return Choices(
        np.concatenate([nothing, ranks[allowed][order]]), np.concatenate([[empty], nbytes[order]]), allowed[order]
    )


def _hull(nbytes: F64, error: F64) -> NDArray[np.intp]:
    """Indices of the lower convex hull; bytes ascend, errors descend.

    Points on or above the line between their neighbours are no corners; without them others lie above such lines.
    """
    kept = np.arange(len(nbytes))
    while len(kept) > 2:
        slopes = np.diff(error[kept]) / np.diff(nbytes[kept])
        corners = np.concatenate([[True], slopes[1:] > slopes[:-1], [True]])
        if corners.all():
            break
        kept = kept[corners]
    return kept


def pareto(nbytes: F64, error: F64) -> NDArray[np.intp]:
    """Indices of the choices with less error than any cheaper one; choices come by ascending bytes."""
    best = np.minimum.accumulate(error)
    kept = np.flatnonzero(np.concatenate([[True], best[1:] < best[:-1]]))
    return kept[np.append(np.diff(nbytes[kept]) > 0, True)]  # of equal bytes the last, best one


@dataclass(frozen=True)
class Allocation:
    """The choices of all nodes.

    Attributes:
        choice: number of each node's choice in its `Spectrum`, `[nodes]`.
        nbytes: what they take together.
        error: squared error that they leave together.
    """

    choice: NDArray[np.intp]
    nbytes: float
    error: float


def allocate(spectra: Sequence[Spectrum], *, nbytes: float | None = None, error: float | None = None) -> Allocation:
    """Choose the ranks of all nodes: those of least error within `nbytes`, or of fewest bytes that leave up to `error`.

    All nodes begin with the first of their choices. Steps along their convex hulls are taken in the order of error
    saved a byte, until the goal is met: that is what one Lagrange multiplier for all nodes chooses.
    """
    step_bytes = [np.diff(s.nbytes[s.steps]) for s in spectra]
    step_error = [np.diff(s.error[s.steps]) for s in spectra]
    node = np.repeat(np.arange(len(spectra)), [len(steps) for steps in step_bytes])
    dearer, better = np.concatenate(step_bytes), np.concatenate(step_error)
    # One node alone takes its choices in their order, whether or not they are convex.
    order = np.argsort(better / dearer, kind="stable") if len(spectra) > 1 else np.arange(len(dearer))
    spent = sum(float(s.nbytes[0]) for s in spectra) + np.concatenate([[0.0], np.cumsum(dearer[order])])
    left = sum(float(s.error[0]) for s in spectra) + np.concatenate([[0.0], np.cumsum(better[order])])
    if nbytes is not None:
        taken = int(np.searchsorted(spent, nbytes, side="right")) - 1
    else:
        assert error is not None
        taken = int(np.argmax(left <= error)) if left[-1] <= error else len(order)
    taken = max(taken, 0)
    counts = np.bincount(node[order[:taken]], minlength=len(spectra))
    choice = np.array([s.steps[count] for s, count in zip(spectra, counts, strict=True)], np.intp)
    chosen = Allocation(choice, float(spent[taken]), float(left[taken]))
    return chosen if nbytes is None or len(spectra) == 1 else _filled(spectra, chosen, nbytes)


def _filled(spectra: Sequence[Spectrum], chosen: Allocation, nbytes: float) -> Allocation:
    """Better choices off the hulls for a few nodes, as far as no more than `nbytes` are spent.

    Hulls of a few nodes come in steps of several percent of all bytes, and the next one may not fit.
    """
    choice, spent, left = chosen.choice.copy(), chosen.nbytes, chosen.error
    for _ in range(TRIMS if len(spectra) <= FEW else 0):
        slack, best, node, other = nbytes - spent, 0.0, -1, -1
        for number, (s, now) in enumerate(zip(spectra, choice, strict=True)):
            dearest = int(np.searchsorted(s.nbytes, s.nbytes[now] + slack, side="right")) - 1
            saved = float(s.error[now] - s.error[max(dearest, now)])
            if saved > best:
                best, node, other = saved, number, dearest
        if node < 0:
            break
        spent += float(spectra[node].nbytes[other] - spectra[node].nbytes[choice[node]])
        left -= best
        choice[node] = other
    return Allocation(choice, spent, left)


def trimmed(spectra: Sequence[Spectrum], chosen: Allocation, error: float) -> Allocation:
    """Cheaper choices off the hulls for a few nodes, as far as no more than the error is left.

    Hulls of a few nodes come in steps of several dB; what their last step leaves unused buys bytes back.
    """
    choice, nbytes, left = chosen.choice.copy(), chosen.nbytes, chosen.error
    for _ in range(TRIMS):
        slack, best, node = error - left, 0.0, -1
        for number, (s, now) in enumerate(zip(spectra, choice, strict=True)):
            other = int(np.searchsorted(-s.error, -(s.error[now] + slack)))
            saved = float(s.nbytes[now] - s.nbytes[min(other, now)])
            if saved > best:
                best, node = saved, number
        if node < 0:
            break
        s, now = spectra[node], choice[node]
        choice[node] = np.searchsorted(-s.error, -(s.error[now] + slack))
        left += float(s.error[choice[node]] - s.error[now])
        nbytes -= best
    return Allocation(choice, nbytes, left)


def plausible(errors: F64) -> NDArray[np.intp]:
    """Choices, of errors `[nodes, choices]` by ascending bytes, that may be those of some node."""
    total = errors.sum(axis=0)
    return np.flatnonzero(total <= ASIDE * np.minimum.accumulate(total))


def ration(
    errors: F64, nbytes: F64, weights: F64, *, limit: float | None = None, error: float | None = None
) -> tuple[float, float]:
    """Bytes and error of many nodes with the same choices, by one multiplier; between two of its steps, on a line.

    Args:
        errors: squared error that each node is left with by each choice, `[nodes, choices]`.
        nbytes: what the choices cost, `[choices]`, ascending.
        weights: how many nodes each of them stands for.
        limit: bytes to spend; or
        error: squared error to leave.
    """
    kept = plausible(errors)
    errors, nbytes, rows = errors[:, kept], nbytes[kept], np.arange(len(errors))

    def chosen(multiplier: float) -> tuple[float, float]:
        picked = np.argmin(errors + multiplier * nbytes, axis=1)
        return float(weights @ nbytes[picked]), float(weights @ errors[rows, picked])

    def enough(found: tuple[float, float]) -> bool:
        return found[0] > limit if limit is not None else found[1] <= (error or 0.0)

    high = float(errors.max()) + 1e-300
    low = 1e-15 * high
    poor, rich = chosen(high), chosen(low)
    if enough(poor) or not enough(rich):
        return poor if enough(poor) else rich
    while rich[0] - poor[0] > CLOSE * rich[0] and high > 1.0001 * low:
        middle = (low * high) ** 0.5
        found = chosen(middle)
        low, high = (middle, high) if enough(found) else (low, middle)
        poor, rich = (poor, found) if enough(found) else (found, rich)
    if limit is not None:
        part = (limit - poor[0]) / (rich[0] - poor[0])
    else:
        part = (poor[1] - (error or 0.0)) / (poor[1] - rich[1])
    return poor[0] + part * (rich[0] - poor[0]), poor[1] + part * (rich[1] - poor[1])


def best_of_one(
    nbytes: F64, errors: F64, *, limit: float | None = None, error: float | None = None
) -> tuple[float, float]:
    """Bytes and error of one node: of what `pareto` leaves the best choice, or the cheapest that is good enough."""
    if limit is not None:
        at = max(0, int(np.searchsorted(nbytes, limit, side="right")) - 1)
    else:
        at = min(int(np.searchsorted(-errors, -(error or 0.0))), len(errors) - 1)
    return float(nbytes[at]), float(errors[at])
