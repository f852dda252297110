"""What the ranks of every node may be: its choices, each with the bytes it takes and the error it leaves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import inf, prod

import numpy as np
from numpy.typing import NDArray

from ..fitting.disjoint import energy_table, summed
from ..fitting.fit import Labels
from ..fitting.hierarchy import (
    Hierarchy,
    LabelsOf,
    Node,
    Run,
    gather,
    in_parallel,
    level_within,
    sampled,
    streamed_for,
    told_within,
)
from ..fitting.tucker import core_energies
from ..metrics import squared_norm
from ..plan import HIGHEST_RANK, LevelSpec
from ..streaming.streamed import Streamed
from ..support.executors import in_order
from ..support.grouping import rows_of_parts
from ..support.progress import Told, share_of
from .allocation import FEWEST_BITS, Spectrum, spectrum, stored_bits

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

#: The stage before the fit.
EXAMINING = "ranks of each node"
#: A way to fit a node: highest ranks and clusters, and the memberships that its cells start from.
Way = tuple[LevelSpec, LabelsOf]
#: Most choices of ranks in the table of a node.
TABLE_ENTRIES = 60_000
#: The same of a node that is the only one of its level.
LONE_ENTRIES = 400_000
#: Most elements of the ways, or of the blocks of one, that are examined side by side.
BESIDE = 1 << 25


@dataclass
class Goal:
    """What the last level is cut to: bytes of the whole file, or an SNR in dB; with how both are measured.

    Attributes:
        size: largest file size in bytes, or None.
        snr: least SNR in dB, or None.
        energy: squared norm of the tensor.
        file_bytes: exact size of the file that a hierarchy would make.
        snr_now: SNR in dB of a hierarchy in the domain of the source values.
        memory: bytes to work in, if they are given; None: half of what is free.
        untold: squared error that is little beside what the SNR allows: ranks that leave less need not be told apart.
        most: bytes of another model that reaches the SNR; a plan that would take more need not be fitted.
    """

    size: int | None
    snr: float | None
    energy: float
    file_bytes: Callable[[Hierarchy], int]
    snr_now: Callable[[Hierarchy], float]
    memory: int | None = None
    untold: float = 0.0
    most: float = inf


def examined(
    tree: Hierarchy, ways: Sequence[Way], goal: Goal, decode_cost: int, run: Run, first: int = 0
) -> list[list[Spectrum]]:
    """For every node of the deepest level its choices of ranks, a `Spectrum` for each way to cut it into cells.

    Ways are numbered from `first` on. A node in which there is nothing to store has none.
    """
    nodes, told = tree.levels[-1], told_within(tree.levels[-1], EXAMINING, run)
    spectra: list[list[Spectrum]] = [[] for _ in nodes]
    # What is streamed shares out its own work, and where memory is given there is none for more at once.
    alone = isinstance(tree.residual, Streamed) or goal.memory is not None
    threads = 1 if alone else max(1, run.threads // len(nodes))

    def examine(s: int) -> None:
        def of(way: int) -> Spectrum | None:
            part = share_of(told, way, len(ways))
            found = _spectrum_of(tree, nodes[s], ways[way], goal, decode_cost, run.seed, part, threads // workers)
            return None if found is None else replace(found, way=np.full_like(found.way, first + way))

        workers = max(1, min(threads, len(ways), BESIDE // max(1, nodes[s].elements)))
        spectra[s] += [own for own in in_order(of, range(len(ways)), workers) if own is not None]

    if ways:
        in_parallel(examine, nodes, EXAMINING, run, tree.residual)
    return spectra


def _spectrum_of(
    tree: Hierarchy, node: Node, way: Way, goal: Goal, decode_cost: int, seed: int, told: Told, threads: int
) -> Spectrum | None:
    """A node's choices of ranks if it is fitted in this way; None where there is nothing to store."""
    (spec, labels), alone, nbytes = way, len(tree.levels[-1]) == 1, goal.size or inf
    bits = stored_bits(spec.bits, goal.snr)
    part, outside = labels(node), streamed_for(tree, node)
    if outside is not None and part is not None and spec.disjoint:
        level = level_within(node, len(tree.levels))
        return outside_spectrum(
            outside, level, spec, part, decode_cost, seed, told, alone=alone, nbytes=nbytes, bits=bits
        )
    sample, untold = sampled(tree, node, spec), goal.untold / len(tree.levels[-1])
    if outside is None or sample is None:
        return node_spectrum(
            gather(tree.residual, node), spec, decode_cost, seed, part,
            alone=alone, nbytes=nbytes, bits=bits, untold=untold, threads=threads,
        )
    tensor, steps = sample
    part = None if part is None else [own[::step] for own, step in zip(part, steps, strict=True)]
    energy = goal.energy if len(tree.levels) == 1 else outside.error
    whole = (node.sizes, energy)
    return node_spectrum(
        tensor, spec, decode_cost, seed, part, alone=alone, nbytes=nbytes, bits=bits, untold=untold, sample_of=whole
    )


def table_limits(
    sizes: Sequence[int],
    spec: LevelSpec,
    nbytes: float = inf,
    stored: Sequence[int] | None = None,
    entries: int = TABLE_ENTRIES,
) -> list[int | None]:
    """Ranks to examine of each mode: up to R, what the node has, what the table holds, and what `nbytes` can store.

    `stored` are the sizes that bytes are counted by, where the node is thinned.
    """
    limits, least = list[int | None](), spec.bits if spec.bits == 16 else FEWEST_BITS
    for n, rank in enumerate(spec.ranks):
        rest = int(min(prod(float(size) for m, size in enumerate(sizes) if m != n), 2.0**31))
        affordable = int(min(8 * nbytes / (least * (stored or sizes)[n]), HIGHEST_RANK)) + 1
        limits.append(None if rank is None else min(rank, sizes[n], rest, HIGHEST_RANK, affordable))
    while prod(limit or 1 for limit in limits) > entries:
        longest = max(range(len(limits)), key=lambda n: limits[n] or 0)
        limits[longest] = max(1, (limits[longest] or 1) * 7 // 8)
    return limits


def node_spectrum(
    tensor: F32,
    spec: LevelSpec,
    decode_cost: int,
    seed: int,
    labels: Labels | None = None,
    *,
    alone: bool = False,
    nbytes: float = inf,
    bits: float = 16,
    untold: float = 0.0,
    sample_of: tuple[Sequence[int], float] | None = None,
    threads: int = 1,
) -> Spectrum | None:
    """The node's choices of ranks, its cells' being the same; None where there is nothing to store.

    `labels` are the disjoint memberships of its cells, `bits` those of a number on average; a node that is `alone` in
    its level needs no convex choices. The tensor may be a `sample_of` a node of these sizes and this squared norm.
    Errors below `untold` may be left out.
    """
    own = squared_norm(tensor)
    if tensor.size == 0 or own == 0:
        return None
    full, energy = (tensor.shape, own) if sample_of is None else sample_of
    blocks = [tensor] if labels is None else cell_blocks(tensor, labels, spec.clusters)
    sizes = [max(block.shape[n] for block in blocks) for n in range(tensor.ndim)]
    stored = [-(-size * long // max(1, short)) for size, long, short in zip(sizes, full, tensor.shape, strict=True)]
    limits = table_limits(sizes, spec, nbytes, stored, LONE_ENTRIES if alone else TABLE_ENTRIES)
    # Shares of the sample's energy are taken for those of the node's: as errors they would miss what it has more of.
    enough = untold * own / energy / len(blocks)

    def judged(block: F32) -> F64:
        return core_energies(block, limits, np.random.default_rng(seed), enough)

    workers = max(1, min(threads, BESIDE // prod(sizes)))
    table = energy / own * summed(in_order(judged, [block for block in blocks if block.size], workers))
    undecomposed = [r is None for r in spec.ranks]
    return spectrum(
        table, energy, full, undecomposed, decode_cost, spec.clusters if labels else None, hull=not alone,
        bits=bits,
    )


def outside_spectrum(
    outside: Streamed, number: int, spec: LevelSpec, labels: Labels, decode_cost: int, seed: int, told: Told,
    *, alone: bool, nbytes: float, bits: float,
) -> Spectrum | None:
    """As `node_spectrum`, of a node whose blocks, which share no element, are read one by one."""

    def limits(sizes: Sequence[int]) -> list[int | None]:
        return table_limits(sizes, spec, nbytes, entries=LONE_ENTRIES if alone else TABLE_ENTRIES)

    table, energy = energy_table(outside, number, spec, labels, limits, seed, told)
    undecomposed = [r is None for r in spec.ranks]
    choices = spectrum(
        table, energy, outside.shape, undecomposed, decode_cost, spec.clusters, hull=not alone, bits=bits
    )
    return choices if energy else None


def cell_blocks(tensor: F32, labels: Labels, clusters: Sequence[int]) -> list[F32]:
    """The disjoint sub-tensors of a node's cells."""
    blocks = [tensor]
    for n, (part, count) in enumerate(zip(labels, clusters, strict=True)):
        if count > 1:
            rows = rows_of_parts(part, count)
            blocks = [block.take(chosen, axis=n) for block in blocks for chosen in rows]
    return blocks
