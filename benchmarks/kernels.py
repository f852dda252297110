"""Speed of the data-sized kernels on typical nodes.

``python -m benchmarks kernels [--threads N ..] [--reference | --device cuda]``. On a GPU all calls go to it, also those
that a fit leaves to the CPU, and copying to it and back counts.

Memberships are random, the hardest case for memory. Times are the best of several runs; on a machine that others use
too, processor seconds tell more than wall seconds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import prod

import numpy as np
from numpy.typing import NDArray

from benchmarks.machine import best_of
from benchmarks.report import Row
from benchmarks.work import accumulate_flops, pair_flops, project_flops, sweep_flops
from hmkcta.backends import Device, Kernels, native, reference
from hmkcta.backends.cuda import Cuda
from hmkcta.cells import Cells, empty_cells
from hmkcta.fitting.projection import passes, project
from hmkcta.plan import LevelSpec

#: Seconds and runs spent on a kernel at least, for the best run to be found.
SECONDS, RUNS = 0.5, 3

NODES = {
    "level 1, crop": ((35, 64, 64, 64), LevelSpec((4, 4, 4, 4), (2, 3, 3, 3), (2, 2, 2, 2))),
    "level 2 node": ((18, 8, 24, 24), LevelSpec((2, 2, 3, 3), (3, 3, 4, 4), (2, 2, 2, 2))),
    "level 2, WH4": ((87, 29, 100, 95), LevelSpec((2, 2, 3, 3), (4, 3, 4, 4), (2, 2, 2, 2))),
    "node of a volume": ((40, 44, 43, 35), LevelSpec((None, 1, 1, 1), (1, 6, 6, 8), (1, 2, 2, 2))),
    "cells apart, K=1": ((35, 64, 64, 64), LevelSpec((2, 2, 2, 2), (4, 4, 4, 4), (1, 1, 1, 1))),
    "PCA, R=14": ((216, 25600), LevelSpec((14, 14), (1, 1), (1, 1))),
    "HOSVD, R=16": ((35, 64, 64, 64), LevelSpec((16, 16, 16, 16), (1, 1, 1, 1), (1, 1, 1, 1))),
}
#: What `make bench` measures: a large clustered node, a small one, and one without clusters.
SMALL = ("level 2, WH4", "level 2 node", "HOSVD, R=16")


def random_node(sizes: tuple[int, ...], spec: LevelSpec) -> tuple[Cells, NDArray[np.float32]]:
    """Random memberships and noise above a smooth part."""
    rng = np.random.default_rng(0)
    members = [
        np.sort(np.argsort(rng.random((size, clusters)), axis=1)[:, :mixture], axis=1).astype(np.uint16)
        for size, clusters, mixture in zip(sizes, spec.clusters, spec.mixture, strict=True)
    ]
    waves = np.ones((), np.float32)
    for size in sizes:
        waves = np.multiply.outer(waves, (1 + np.sin(0.2 * np.arange(size))).astype(np.float32))
    waves += rng.standard_normal(sizes, np.float32)
    cells = empty_cells(sizes, spec, members, rng)
    cells.cores = rng.standard_normal(cells.cores.shape, np.float32)
    return cells, waves


def measure(name: str, threads: int, kernels: Kernels = native) -> Iterator[Row]:
    """All kernels on one node."""
    kernels.set_threads(threads)
    sizes, spec = NODES[name]
    cells, data = random_node(sizes, spec)
    elements, visits = prod(sizes), prod(sizes) * prod(spec.mixture)

    def row(kernel: str, seconds: tuple[float, float], flops: float, moved: float) -> Row:
        return Row(kernel, name, threads, *seconds, elements, flops, moved)

    yield row("accumulate", best_of(lambda: kernels.accumulate(cells, data, 1e-6), RUNS, SECONDS),
              accumulate_flops(cells), 8.0 * elements)
    for n in [m for m, skip in enumerate(cells.undecomposed) if not skip] if spec.cells > 1 else ():
        yield row(f"project_cells, mode {n + 1}",
                  best_of(lambda n=n: kernels.project_cells(cells, data, n), RUNS, SECONDS),
                  project_flops(cells, n), 4.0 * elements)
    # A single cell is fitted by HOOI, which is a sweep of `fit_cells`.
    seen = [project(cells, data, kept).pair for kept in passes(cells)] if spec.cells > 1 else []
    for pair in sorted(pair for pair in seen if pair is not None):
        yield row(f"project_pair, modes {pair[0] + 1} and {pair[1] + 1}",
                  best_of(lambda pair=pair: kernels.project_pair(cells, data, pair), RUNS, SECONDS),
                  pair_flops(cells, pair), 4.0 * elements)
    # Each cell changes the residual that the next one reads.
    yield row("fit_cells, a sweep", best_of(lambda: kernels.fit_cells(cells, data, 1, 2), RUNS, SECONDS),
              sweep_flops(cells), 8.0 * visits)


def rows(
    names: Sequence[str], threads: Sequence[int], *, readable: bool = False, device: Device | None = None
) -> Iterator[Row]:
    """All kernels on several nodes, with each number of threads; of the reference, or on a GPU."""
    kernels: Kernels = reference if readable else native if device is None else Cuda(device, native, always=True)
    for name in names:
        for count in threads:
            yield from measure(name, count, kernels)
    native.set_threads(0)
