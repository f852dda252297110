"""Speed of the four data-sized kernels on typical nodes: ``python benchmarks/kernels.py [--threads N] [--reference]``.

It prints a markdown table. A visit is one element of one cell: with K_n clusters mixed in every mode an element is
visited prod K_n times a sweep. Memberships are random, the hardest case for memory. Times are the best of several
runs; on a shared machine trust the processor time.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "python"))

from hmkcta.backends import native, reference
from hmkcta.cells import Cells, empty_cells
from hmkcta.plan import LevelSpec

#: Seconds and runs spent on a kernel at least, for the best run to be found.
SECONDS, RUNS = 0.5, 3

NODES = {
    "level 1, crop": ((35, 64, 64, 64), LevelSpec((4, 4, 4, 4), (2, 3, 3, 3), (2, 2, 2, 2))),
    "level 2 node": ((18, 8, 24, 24), LevelSpec((2, 2, 3, 3), (3, 3, 4, 4), (2, 2, 2, 2))),
    "level 1, WH4": ((87, 29, 100, 95), LevelSpec((2, 2, 3, 3), (4, 3, 4, 4), (2, 2, 2, 2))),
    "PCA, R=14": ((216, 25600), LevelSpec((14, 14), (1, 1), (1, 1))),
    "PCA, R=64": ((216, 25600), LevelSpec((64, 64), (1, 1), (1, 1))),
    "HOSVD, R=16": ((35, 64, 64, 64), LevelSpec((16, 16, 16, 16), (1, 1, 1, 1), (1, 1, 1, 1))),
}


@dataclass(frozen=True)
class Row:
    """One kernel on one node: wall and processor seconds; `work` counts visits, or pairs of dictionary columns."""

    node: str
    kernel: str
    seconds: tuple[float, float]
    work: float

    def __str__(self) -> str:
        wall, processor = self.seconds
        speed = self.work / processor / 1e6
        return f"| {self.node} | {self.kernel} | {1e3 * wall:.2f} | {1e3 * processor:.2f} | {speed:.0f} |"


def random_node(sizes: tuple[int, ...], spec: LevelSpec) -> tuple[Cells, NDArray[np.float32]]:
    """Random memberships and noise above a smooth part."""
    rng = np.random.default_rng(0)
    members = [
        np.sort(np.argsort(rng.random((size, clusters)), axis=1)[:, :mixture], axis=1).astype(np.uint16)
        for size, clusters, mixture in zip(sizes, spec.clusters, spec.mixture, strict=True)
    ]
    waves = np.ones(())
    for size in sizes:
        waves = np.multiply.outer(waves, 1 + np.sin(0.2 * np.arange(size)))
    data = (rng.standard_normal(sizes, np.float32) + waves).astype(np.float32)
    return empty_cells(sizes, spec, members, rng), data


def best(work: Callable[[], object]) -> tuple[float, float]:
    """Wall and processor seconds of the fastest of several runs, the first of which does not count."""
    work()
    walls: list[float] = []
    processors: list[float] = []
    while sum(walls) < SECONDS or len(walls) < RUNS:
        wall, processor = time.perf_counter(), time.process_time()
        work()
        walls.append(time.perf_counter() - wall)
        processors.append(time.process_time() - processor)
    return min(walls), min(processors)


def measure(name: str, *, readable: bool) -> Iterator[Row]:
    """All kernels on one node."""
    kernels = reference if readable else native
    sizes, spec = NODES[name]
    cells, data = random_node(sizes, spec)
    visits = prod(sizes) * prod(spec.mixture)
    yield Row(name, "fit_cells, a sweep", best(lambda: kernels.fit_cells(cells, data, 1, 2)), visits)
    yield Row(name, "accumulate", best(lambda: kernels.accumulate(cells, data, 1e-6)), visits)
    for n in range(len(sizes)) if spec.cells > 1 else ():
        work = visits * spec.clusters[n] / spec.mixture[n]
        yield Row(name, f"project_cells, mode {n + 1}", best(lambda n=n: kernels.project_cells(cells, data, n)), work)
    for n in range(len(sizes)) if spec.cells > 1 else ():
        pairs = (spec.cells * cells.ranks[n]) ** 2
        yield Row(name, f"dictionary_gram, mode {n + 1}", best(lambda n=n: kernels.dictionary_gram(cells, n)), pairs)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--threads", type=int, default=0, help="threads for large nodes; 0: all cores")
    parser.add_argument("--nodes", nargs="*", default=list(NODES), choices=list(NODES), help="only these nodes")
    parser.add_argument("--reference", action="store_true", help="the NumPy reference instead (slow)")
    given = parser.parse_args()
    native.set_threads(given.threads)
    sys.stdout.write("| node | kernel | ms | cpu-ms | M/cpu-s |\n| --- | --- | ---: | ---: | ---: |\n")
    for name in given.nodes:
        for row in measure(name, readable=given.reference):
            sys.stdout.write(f"{row}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
