"""Fitted nodes as the file's flat arrays (`docs/format.md`, section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arrays import F32
from .cells import round_cores
from .core_parameters import core_parameters
from .fitting.hierarchy import Node
from .narrow import U8
from .packed import F16, PackedLevel
from .parameters import BELOW_ONE, bytes_of, from_whole, most_of_core, of_columns, whole_of_core
from .streaming.pieces import places_of

Ragged = list[NDArray[Any]]
#: Entries of a node's columns, mode by mode, its core numbers, and the factor of each of its cells.
Cores = tuple[list[U8 | None], F16, F32]


def pack_levels(
    levels: Sequence[Sequence[Node]], undecomposed: Sequence[int], bits: Sequence[int], unit: float = 1.0
) -> tuple[PackedLevel, ...]:
    """Every level's nodes in order, as stored.

    `undecomposed`: mode numbers, `bits`: of each level's numbers, `unit`: what cores are multiples of.
    """
    return tuple(
        _pack(nodes, undecomposed, unit, own, last=nodes is levels[-1])
        for nodes, own in zip(levels, bits, strict=False)
    )


def _pack(nodes: Sequence[Node], undecomposed: Sequence[int], unit: float, bits: int, *, last: bool) -> PackedLevel:
    order = len(nodes[0].rows) if nodes else 0
    stored = [n not in undecomposed for n in range(order)]
    shape = np.zeros((len(nodes), 3, order), np.uint32)
    for s, node in enumerate(nodes):
        if node.cells is not None:
            shape[s] = node.cells.spec.clusters, node.cells.spec.mixture, node.cells.ranks
            shape[s, 1, [not kept for kept in stored]] = 0
    fewer = any(node.cells is not None and node.cells.spec.packed for node in nodes)
    rounded = [_coded(node, stored) if fewer else _plain(node, bits) for node in nodes]
    core, core_offset = _ragged([numbers for _, numbers, _ in rounded], np.float16)
    scale, cell_offset = _ragged([factors for *_, factors in rounded], np.float32)
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
        bits=bits,
        rice=_entries([columns for columns, *_ in rounded], stored) if fewer else (),
    )


def _plain(node: Node, bits: int) -> Cores:
    """Those of a node of a level that is not packed."""
    if node.cells is None:
        return [], np.zeros(0, np.float16), np.zeros(0, np.float32)
    return [], *round_cores(node.cells.cores, bits)


def _coded(node: Node, stored: Sequence[bool]) -> Cores:
    """Those of a node of a packed level; no entries of a mode that is not stored."""
    if node.cells is None:
        return [np.zeros(0, np.uint8) if kept else None for kept in stored], *_plain(node, 8)[1:]
    whole, step = whole_of_core(node.cells.cores)
    columns = [None if own is None else bytes_of(of_columns(basis), own)
               for basis, own in zip(node.cells.bases, core_parameters(whole, stored), strict=True)]
    most = most_of_core(columns, np.array([node.cells.ranks]))
    return columns, from_whole(whole, most), np.ldexp(step, int(most[0]) + BELOW_ONE).astype(np.float32)


def _entries(columns: Sequence[Sequence[U8 | None]], stored: Sequence[bool]) -> tuple[U8 | None, ...]:
    """Entries of the columns of all nodes, mode by mode."""
    each = [[own for node in columns if (own := node[n]) is not None] for n in range(len(stored))]
    return tuple(_joined([*own], np.uint8) if kept else None for own, kept in zip(each, stored, strict=True))


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
