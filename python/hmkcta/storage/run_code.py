"""A run of nodes, coded and decoded by one text: an encoder's decisions come from the nodes, a decoder's make them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .contexts import code_integer, code_label
from .range_coder import CodeError, Coder, Decoder, Encoder
from .run_numbers import code_numbers

EMPTY, CELLS, CUT = 0, 1, 2

Array = NDArray[Any]


@dataclass(frozen=True)
class Place:
    """Rows of a node in each mode, and the extents that these are made of."""

    extents: tuple[tuple[int, ...], ...]

    @property
    def rows(self) -> tuple[int, ...]:
        """Rows of each mode."""
        return tuple(prod(own) for own in self.extents)


@dataclass
class Node:
    """One node of a stage; lists are indexed by mode. Arrays of modes without a basis are empty."""

    kind: int = EMPTY
    parted: int = 0
    clusters: list[int] = field(default_factory=list[int])
    mixture: list[int] = field(default_factory=list[int])
    ranks: list[int] = field(default_factory=list[int])
    members: list[Array] = field(default_factory=list[Array])  # [m, K_n]
    parts: list[Array] = field(default_factory=list[Array])  # [m], of a node with children
    grids: list[list[int]] = field(default_factory=list[list[int]])  # of a cut; empty: labels
    columns: list[Array] = field(default_factory=list[Array])  # [PC, R_n]
    basis: list[Array] = field(default_factory=list[Array])  # [m, K_n, PC_-n, R_n]
    core: Array = field(default_factory=lambda: np.zeros(0, np.int64))  # [PC, R_1, .., R_N]


def encode_run(nodes: Sequence[Node], places: Sequence[Place], *, last: bool, coded: bool) -> bytes:
    """The bytes of a run; `coded`: whether numbers are."""
    coder = Encoder()
    _Walk(coder, len(places[0].extents), last, coded).run(nodes, places)
    return coder.finish()


def decode_run(data: bytes, places: Sequence[Place], *, last: bool, coded: bool) -> list[Node]:
    """The nodes at these places."""
    coder = Decoder(data=data)
    nodes = [Node() for _ in places]
    _Walk(coder, len(places[0].extents), last, coded).run(nodes, places)
    coder.finish()
    return nodes


@dataclass
class _Walk:
    """What a run remembers from node to node."""

    coder: Coder
    order: int
    last: bool
    coded: bool

    def __post_init__(self) -> None:
        self.kind = self.parted = 0
        self.undecomposed, self.rank_length = [0] * self.order, [0] * self.order

    def run(self, nodes: Sequence[Node], places: Sequence[Place]) -> None:
        """All nodes in order; of one without rows in a mode nothing is coded."""
        for node, place in zip(nodes, places, strict=True):
            if self.coder.decodes:
                node.clusters, node.mixture, node.ranks = ([0] * self.order for _ in range(3))
                for arrays in (node.members, node.parts, node.columns, node.basis):
                    arrays[:] = [np.zeros(0, np.int64)] * self.order
                node.grids = [[] for _ in range(self.order)]
            if min(place.rows) > 0:
                self._node(node, place)

    def _node(self, node: Node, place: Place) -> None:
        self._kind(node)
        if node.kind == CUT:
            self._rules(node, place)
            self._cut_parts(node, place)
        elif node.kind == CELLS:
            self._shape(node, place)
            self._members(node, place)
            if node.parted:
                self._parts(node, place)
            if self.coded:
                if self.coder.decodes:
                    _make_room(node, place)
                code_numbers(self.coder, node, place)

    def _kind(self, node: Node) -> None:
        kind = self.coder.bit(("kind", self.kind, 0), int(node.kind == CELLS))
        if not kind and not self.last:
            kind = CUT * self.coder.bit(("kind", self.kind, 1), int(node.kind == CUT))
        self.kind = node.kind = kind
        if kind == CELLS and not self.last:
            self.parted = node.parted = self.coder.bit(("parted", self.parted), node.parted)

    def _shape(self, node: Node, place: Place) -> None:
        for n in range(self.order):
            alone = self.coder.bit(("undecomposed", n, self.undecomposed[n]), int(node.mixture[n] == 0))
            self.undecomposed[n] = alone
            if alone:
                node.clusters[n], node.mixture[n], node.ranks[n] = 1, 0, place.rows[n]
                continue
            node.clusters[n] = code_integer(self.coder, ("C", n), node.clusters[n] - 1) + 1
            several = node.clusters[n] > 1
            node.mixture[n] = code_integer(self.coder, ("K", n), node.mixture[n] - 1) + 1 if several else 1
            context = ("R", n, min(self.rank_length[n], 12))
            node.ranks[n] = code_integer(self.coder, context, node.ranks[n] - 1) + 1
            self.rank_length[n] = node.ranks[n].bit_length()
            if node.mixture[n] > node.clusters[n]:
                raise CodeError("node-shape")

    def _members(self, node: Node, place: Place) -> None:
        for n in range(self.order):
            if self.coder.decodes:
                node.members[n] = np.zeros((place.rows[n], node.mixture[n]), np.int64)
            if node.mixture[n] and node.clusters[n] > 1:
                self._subsets(("memb", n), node.members[n], node.clusters[n])

    def _subsets(self, name: tuple[str, int], subsets: Array, clusters: int) -> None:
        """Subsets of rows `[m, K]`, each as the row before or label by label."""
        was = 0
        for i, own in enumerate(subsets):
            if i:
                was = self.coder.bit((*name, "same", was), int(np.array_equal(own, subsets[i - 1])))
                if was:
                    own[:] = subsets[i - 1]
                    continue
            for j in range(len(own)):
                own[j] = code_label(self.coder, (*name, "label", min(j, 7)), clusters, int(own[j]))
                if j and own[j] <= own[j - 1]:
                    raise CodeError("cluster-order")

    def _labels(self, name: tuple[str, int], parts: Array, clusters: int) -> None:
        self._subsets(name, parts.reshape(-1, 1), clusters)

    def _parts(self, node: Node, place: Place) -> None:
        for n in range(self.order):
            members, mixture = node.members[n], node.mixture[n]
            if self.coder.decodes:
                node.parts[n] = np.zeros(place.rows[n], np.int64)
            if node.clusters[n] == 1:
                continue
            found = members == node.parts[n][:, None]
            if self.coder.bit(("slots", n), int(found.any(1).all())):
                for i, slots in enumerate(found):
                    slot = code_label(self.coder, ("slot", n), mixture, int(slots.argmax())) if mixture > 1 else 0
                    node.parts[n][i] = members[i, slot]
            else:
                self._labels(("part", n), node.parts[n], node.clusters[n])

    def _rules(self, node: Node, place: Place) -> None:
        for n in range(self.order):
            if self.coder.bit(("rule", n), int(not node.grids[n])):
                node.clusters[n] = code_integer(self.coder, ("G", n), node.clusters[n] - 1) + 1
                continue
            node.grids[n] = node.grids[n] or [0] * len(place.extents[n])
            node.grids[n] = [code_integer(self.coder, ("G", n), segments - 1) + 1 for segments in node.grids[n]]
            node.clusters[n] = prod(node.grids[n])
            if any(segments > extent for segments, extent in zip(node.grids[n], place.extents[n], strict=True)):
                raise CodeError("node-shape")
        if prod(node.clusters) < 2:
            raise CodeError("node-shape")

    def _cut_parts(self, node: Node, place: Place) -> None:
        for n in range(self.order):
            if node.grids[n]:
                node.parts[n] = grid_parts(node.grids[n], place.extents[n])
                continue
            if self.coder.decodes:
                node.parts[n] = np.zeros(place.rows[n], np.int64)
            if node.clusters[n] > 1:
                self._labels(("cut", n), node.parts[n], node.clusters[n])


def _make_room(node: Node, place: Place) -> None:
    cells = prod(node.clusters)
    node.core = np.zeros((cells, *node.ranks), np.int64)
    for n, mixture in enumerate(node.mixture):
        if mixture:
            others = cells // node.clusters[n]
            node.columns[n] = np.zeros((cells, node.ranks[n]), np.int64)
            node.basis[n] = np.zeros((place.rows[n], mixture, others, node.ranks[n]), np.int64)


def grid_parts(grid: Sequence[int], extents: Sequence[int]) -> Array:
    """The part of each row: each extent in segments as equal as can be, C order of the extents' segments."""
    parts = np.zeros(1, np.int64)
    for segments, extent in zip(grid, extents, strict=True):
        starts = np.arange(segments + 1) * extent // segments
        along = np.repeat(np.arange(segments), np.diff(starts))
        parts = (parts[:, None] * segments + along).reshape(-1)
    return parts
