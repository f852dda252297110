"""Fitted nodes as the file's flat arrays (`docs/format.md`, section 3)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bitstream import bits_needed, stream_bytes
from .cells import round_cores
from .fitting.hierarchy import Node
from .narrow import BASIS_NUMBERS, U8, narrowed
from .packed import F16, U32, LevelBounds, PackedLevel, number_bits
from .streaming.pieces import places_of

Ragged = list[NDArray[Any]]


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


def bounds(level: PackedLevel, scheme: str) -> LevelBounds:
    """The largest C, K, R of any node of the level."""
    top = level.shape.max(axis=0) if level.nodes else np.zeros((3, level.order), np.uint32)
    clusters, mixture, ranks = (tuple(int(v) for v in row) for row in top)
    return LevelBounds(clusters, mixture, ranks, scheme)


def _pack(nodes: Sequence[Node], undecomposed: Sequence[int], unit: float, bits: int, *, last: bool) -> PackedLevel:
    order = len(nodes[0].rows) if nodes else 0
    stored = [n not in undecomposed for n in range(order)]
    shape = np.zeros((len(nodes), 3, order), np.uint32)
    for s, node in enumerate(nodes):
        if node.cells is not None:
            shape[s] = node.cells.spec.clusters, node.cells.spec.mixture, node.cells.ranks
    rounded = [None if node.cells is None else round_cores(node.cells.cores, bits) for node in nodes]
    core, core_offset = _ragged([np.zeros(0) if r is None else r[0] for r in rounded], np.float16)
    scale, cell_offset = _ragged([np.zeros(0) if r is None else r[1] for r in rounded], np.float32)
    scale = (scale * unit).astype(np.float32)
    cluster = [
        _ragged([_members(node, n) for node in nodes], np.uint16) if stored[n] else (None, None) for n in range(order)
    ]
    basis = [
        _ragged([_basis(node, n) for node in nodes], np.float16) if stored[n] else (None, None) for n in range(order)
    ]
    inner = [stored[n] and not last for n in range(order)]
    fewer = any(node.cells is not None and node.cells.spec.own_bits > 0 for node in nodes)
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
        part=tuple(_joined([_part(node, n) for node in nodes], np.uint16) if inner[n] else None for n in range(order)),
        local=tuple(
            _joined([_local(node, n) for node in nodes], np.uint32) if inner[n] else None for n in range(order)
        ),
        bits=bits,
        width=tuple(_widths(b, o, shape[:, 2, n]) for n, (b, o) in enumerate(basis)) if fewer else (),
    )


def _widths(basis: F16 | None, offsets: U32 | None, ranks: U32) -> U8 | None:
    """Bits of each node's columns; None where packing them saves nothing."""
    if basis is None or offsets is None or not basis.size:
        return None
    stored = narrowed(basis, BASIS_NUMBERS)
    parts = zip(offsets[:-1], offsets[1:], ranks, strict=True)
    width = np.concatenate([bits_needed(stored[begin:end].reshape(-1, rank)) for begin, end, rank in parts if rank])
    packed = int(number_bits(width, ranks, np.diff(offsets.astype(np.int64))).sum(dtype=np.int64))
    return width if stream_bytes(packed) + width.size < basis.size else None


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
