"""Clusters of alike rows in place of blocks of neighbours: memberships are searched, and stored (paper, section 3.2).

The rows of a mode are put in the order of their clusters. Then clusters are blocks, only of unequal sizes, and all that
is known of blocks holds for them: ranks of their own, undecomposed modes, J.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import prod

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32
from ..fitting.subspaces import subspace_clusters
from .blocks import Slices, axis_order
from .layout import Layout, Modes
from .values import Values

Labels = NDArray[np.intp]

#: Dimensions of the subspaces that rows are told apart by (4 and 12 end alike on multi-light data).
DIMENSION = 4
#: Numbers of a row that it is told apart by, about.
FEATURES = 1 << 10


@dataclass(frozen=True, eq=False)
class Parting:
    """An array whose rows of some modes are in the order of their clusters.

    Attributes:
        shape: of the array as it is.
        modes: its axes by mode.
        labels: for each mode that is parted the cluster of every row.
        values: the array in the other order; the axes of a parted mode are merged into one.
        inner: the modes of `values`.
        ends: where the clusters along each axis of `values` begin and end; none along others.
    """

    shape: tuple[int, ...]
    modes: Modes
    labels: dict[int, Labels]
    values: Values = field(repr=False)
    inner: Modes
    ends: tuple[tuple[int, ...], ...]

    def layout(self, edges: tuple[int, ...]) -> Layout:
        """Clusters along the parted modes, and blocks of these edges, of the array as it is, along other axes."""
        own = tuple(edges[axes[0]] if len(axes) == 1 else prod(self.shape[axis] for axis in axes)
                    for axes in _axes(self.modes, self.labels))
        return Layout(self.inner, tuple(min(edge, size) for edge, size in zip(own, self.values.shape, strict=True)),
                      self.ends)

    @property
    def label_bits(self) -> float:
        """Bits of the labels, by their entropy: neighbours often have the same, which codes them in less."""
        bits = 0.0
        for labels in self.labels.values():
            counts = np.bincount(labels)
            shares = counts[counts > 0] / len(labels)
            bits -= float((counts[counts > 0] * np.log2(shares)).sum())
        return bits


def _axes(modes: Modes, labels: dict[int, Labels]) -> list[tuple[int, ...]]:
    """The axes of the array that each axis of the parted one stands for, in the order of modes."""
    return [own for n, mode in enumerate(modes) for own in ([mode] if n in labels else [(axis,) for axis in mode])]


def parted(values: F32, modes: Modes, labels: dict[int, Labels], energy: float) -> Parting:
    """The array with the rows of each labelled mode in the order of their labels, rows of one label as they were.

    Nothing is copied but what is read. `energy`: the sum of its squares.

    >>> rows = np.arange(8, dtype=np.float32).reshape(4, 2)
    >>> found = parted(rows, ((0,), (1,)), {0: np.array([1, 0, 1, 0])}, 140.0)
    >>> found.values.read((slice(None), slice(0, 1))).ravel().tolist(), found.ends
    ([2.0, 6.0, 0.0, 4.0], ((0, 2, 4), ()))
    """
    axes = _axes(modes, labels)
    shape = tuple(prod(values.shape[axis] for axis in own) for own in axes)
    ends: list[tuple[int, ...]] = [()] * len(axes)
    orders: dict[int, Labels] = {}
    inner: list[tuple[int, ...]] = []
    at = 0
    for n, mode in enumerate(modes):
        if n in labels:
            orders[at] = np.argsort(labels[n], kind="stable")
            ends[at] = (0, *np.cumsum(np.bincount(labels[n])).tolist())
        count = 1 if n in labels else len(mode)
        inner.append(tuple(range(at, at + count)))
        at += count

    def read(part: Slices) -> F32:
        """Rows of parted modes are looked up in each of their axes."""
        indices: list[NDArray[np.intp]] = []
        for number, (own, span) in enumerate(zip(axes, part, strict=True)):
            rows = orders[number][span] if number in orders else np.arange(shape[number])[span]
            along = [-1 if other == number else 1 for other in range(len(axes))]
            indices += [index.reshape(along) for index in np.unravel_index(rows, [values.shape[axis] for axis in own])]
        return values.transpose(axis_order(modes))[tuple(indices)]

    ordered = Values(shape, read, known=energy)
    return Parting(values.shape, modes, labels, ordered, tuple(inner), tuple(ends))


def clusters_of(values: F32, mode: tuple[int, ...], clusters: int) -> Labels:
    """Labels of the rows of a mode, 0 to clusters - 1, by the nearest of so many subspaces of a sample of the others.

    The same array has the same labels: restarts are drawn from a fixed seed.
    """
    others = [axis for axis in range(values.ndim) if axis not in mode]
    sizes = [values.shape[axis] for axis in others]
    columns = prod(sizes)
    some = np.unravel_index(np.linspace(0, columns - 1, min(FEATURES, columns)).astype(np.intp), sizes)
    rows = values.transpose([*mode, *others])[(*[slice(None)] * len(mode), *some)]
    rows = np.ascontiguousarray(rows).reshape(prod(values.shape[axis] for axis in mode), -1)
    return subspace_clusters(rows, clusters, DIMENSION, np.random.default_rng(0), 1)
