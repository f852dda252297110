"""Fitted nodes as the flat arrays of stages, in float16."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cells import round_cores
from ..packed import PackedLevel
from ..streaming.pieces import places_of
from .hierarchy import Node

Ragged = list[NDArray[Any]]


def pack_levels(
    levels: Sequence[Sequence[Node]], undecomposed: Sequence[int], unit: float = 1.0
) -> tuple[PackedLevel, ...]:
    """Every level's nodes in order, as stored.

    `undecomposed`: mode numbers, `unit`: what cores are multiples of.
    """
    return tuple(_pack(nodes, undecomposed, unit, last=nodes is levels[-1]) for nodes in levels)


def _pack(nodes: Sequence[Node], undecomposed: Sequence[int], unit: float, *, last: bool) -> PackedLevel:
    order = len(nodes[0].rows) if nodes else 0
    stored = [n not in undecomposed for n in range(order)]
    shape = np.zeros((len(nodes), 3, order), np.uint32)
    for s, node in enumerate(nodes):
        if node.cells is not None:
            shape[s] = node.cells.spec.clusters, node.cells.spec.mixture, node.cells.ranks
            shape[s, 1, [not kept for kept in stored]] = 0
    rounded = [round_cores(node.cells.cores) for node in nodes if node.cells is not None]
    counts = [0 if node.cells is None else node.cells.cores.size for node in nodes]
    cells = [0 if node.cells is None else len(node.cells.cores) for node in nodes]
    core, core_offset = _joined([numbers for numbers, _ in rounded], np.float16), _offsets(counts)
    scale, cell_offset = _joined([factors for _, factors in rounded], np.float32), _offsets(cells)
    scale = (scale * unit).astype(np.float32)
    none: Ragged = [np.zeros(0)] * len(nodes)
    cluster = [_ragged([_members(node, n) for node in nodes] if stored[n] else none, np.uint16) for n in range(order)]
    basis = [_ragged([_basis(node, n) for node in nodes] if stored[n] else none, np.float16) for n in range(order)]
    return PackedLevel(
        shape=shape,
        child=None if last else _offsets([len(node.children) for node in nodes]),
        row_offset=tuple(_offsets([len(node.rows[n]) for node in nodes]) for n in range(order)),
        core=core,
        core_offset=core_offset,
        core_scale=scale,
        cell_offset=cell_offset,
        cluster=tuple(c for c, _ in cluster),
        cluster_offset=tuple(o for _, o in cluster),
        basis=tuple(b for b, _ in basis),
        basis_offset=tuple(o for _, o in basis),
        part=tuple(None if last else _joined([_part(node, n) for node in nodes], np.uint16) for n in range(order)),
        local=tuple(None if last else _joined([_local(node, n) for node in nodes], np.uint32) for n in range(order)),
    )


def _members(node: Node, n: int) -> NDArray[np.uint16]:
    return np.zeros(0, np.uint16) if node.cells is None else node.cells.members[n]


def _basis(node: Node, n: int) -> NDArray[np.float32]:
    return np.zeros(0, np.float32) if node.cells is None else node.cells.bases[n]


def _part(node: Node, n: int) -> NDArray[np.intp]:
    return np.zeros(len(node.rows[n]), np.intp) if node.parts is None else node.parts[n]


def _local(node: Node, n: int) -> NDArray[np.intp]:
    """Position of each row among the rows of its part, in order; 0 in a leaf."""
    return np.zeros(len(node.rows[n]), np.intp) if node.parts is None else places_of(node.parts[n])


def _joined(pieces: Ragged, dtype: Any) -> NDArray[Any]:
    # Rounded on the way: all numbers of a level in float32, or wider, would be the most that memory ever holds.
    flat = [piece.reshape(-1) for piece in pieces] or [np.zeros(0)]
    return np.concatenate(flat, dtype=dtype, casting="unsafe")


def _offsets(lengths: Sequence[int]) -> NDArray[np.uint32]:
    return np.concatenate([[0], np.cumsum(lengths)]).astype(np.uint32)


def _ragged(pieces: Ragged, dtype: Any) -> tuple[NDArray[Any], NDArray[np.uint32]]:
    return _joined(pieces, dtype), _offsets([piece.size for piece in pieces])
