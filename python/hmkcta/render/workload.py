"""Models with the paper's parameters (tables 1 to 4) and random numbers: what the speed of rendering is measured on.

Neither time nor memory accesses of a decoder depend on the numbers themselves. They depend on which rows share
clusters: here runs of `RUN` neighbouring rows do, and go to the same part, as smooth data would have it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import prod

import numpy as np
from numpy.typing import NDArray

from ..axes import Axis, Organisation, mode_sizes
from ..cells import Cells, zero_cells
from ..errors import invalid
from ..fitting.hierarchy import Node
from ..fitting.pack import pack_levels
from ..model import Model
from ..packed import LevelQuality, Metadata, bounds_of
from ..plan import LevelSpec, parse_plan
from ..support.grouping import rows_of_parts
from ..synthetic.directions import hemisphere_directions

#: Neighbouring rows that share their clusters.
RUN = 8
#: Of the random cores: values come out near 1.
_SCALE = 0.2


@dataclass(frozen=True)
class Configuration:
    """A column of the paper's tables.

    Attributes:
        name: as in the table.
        kind: renderer.
        sizes: of the axes as the table has them; the mode of an SVBRDF's lights has three rows a direction, red, green
            and blue.
        plan: the levels.
        mebibytes: of the approximated data, as the table has it.
        rate: frames a second in the paper, on a TITAN RTX.
    """

    name: str
    kind: str
    sizes: tuple[int, int, int, int]
    plan: str
    mebibytes: float
    rate: float


def _wood(name: str, plan: str, mebibytes: float, rate: float) -> Configuration:
    return Configuration(name, "svbrdf", (58, 58, 400, 380), plan, mebibytes, rate)


_DEEP = "R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2 / R=2,2,3,3 C=3,3,4,4 K=2"
_TEXELS = "/ R={r} C={a} K=2 / R={r} C={b} K=2"
CONFIGURATIONS = (
    _wood("WM1", "R=2,2,3,3 C=12,9,16,16 K=2", 21.74, 72.06),
    _wood("WM2", "R=2,2,3,3 C=12,9,16,16 K=3", 31.66, 14.92),
    _wood("WH1", "R=2,2,3,3 C=3 K=2 / R=2,2,3,3 C=3 K=2", 8.56, 38.14),
    _wood("WH2", "R=2,2,3,3 C=4,3,4,4 K=2 / R=2,2,3,3 C=3,3,4,4 K=2", 22.30, 37.65),
    _wood("WH3", "R=2,2,3,3 C=4,3,4,4 K=2 / R=2,2,3,3 C=4,3,4,4 K=2", 28.53, 37.16),
    _wood("WH4", _DEEP, 22.31, 36.82),
    _wood("WH7", "R=4,4,8,8 / R=2,2,4,4 C=4,3,4,4 K=2 / R=2,2,4,4 C=3,3,4,4 K=2", 29.09, 22.34),
    Configuration("Dove", "svbrdf", (58, 58, 510, 470),
                  "R=6,6,10,10" + _TEXELS.format(r="3,3,5,5", a="4,3,4,4", b="3,3,4,4"), 51.97, 4.56),
    Configuration("Season Greetings", "svbrdf", (58, 58, 500, 523),
                  "R=6,6,8,12" + _TEXELS.format(r="3,3,4,6", a="4,4,4,4", b="4,3,4,4"), 90.89, 4.31),
    Configuration("Wallpaper2", "svbrdf", (58, 58, 310, 390),
                  "R=6,6,10,12" + _TEXELS.format(r="3,3,5,6", a="4,3,4,4", b="3,3,4,4"), 47.50, 7.42),
    Configuration("Animated Bunnies", "lightfield", (81, 840, 525, 89),
                  "R=2,4,4,* / R=1,2,2,* C=6,10,10,1 K=2,2,2,1 / R=1,2,2,* C=6,9,6,1 K=2,2,2,1", 161.65, 470.83),
    Configuration("Turbulent Jet", "volume", (258, 258, 208, 150),
                  "R=2,2,2,* / R=1,1,1,* C=6,6,8,1 K=2,2,2,1 / R=1,1,1,* C=6,6,8,1 K=2,2,2,1", 23.53, 364.28),
)


def configuration(name: str) -> Configuration:
    """The configuration of this name.

    Raises:
        HmkctaError: there is none.

    >>> configuration("WH4").rate
    36.82
    """
    found = {one.name: one for one in CONFIGURATIONS}
    if name not in found:
        raise invalid("unknown-configuration", "configuration", repr(name), ", ".join(found))
    return found[name]


def random_model(config: Configuration, seed: int = 0) -> Model:
    """A model with a configuration's parameters and random numbers.

    >>> model = random_model(Configuration("small", "volume", (8, 6, 6, 4), "R=2,2,2,* C=2,2,2,1 K=1", 0.0, 0.0))
    >>> model.shape, model.plan.levels[0].clusters
    ((8, 6, 6, 4), (2, 2, 2, 1))
    """
    axes, organisation = _axes(config)
    plan = parse_plan(config.plan, organisation)
    sizes = mode_sizes(axes, organisation)
    rng = np.random.default_rng(seed)
    nodes = [Node(tuple(np.arange(size) for size in sizes))]
    levels = [nodes]
    for number, spec in enumerate(plan.levels, start=1):
        for node in nodes:
            _fill(node, spec, rng, last=number == len(plan.levels))
        if number < len(plan.levels):
            nodes = [child for node in nodes for child in node.children]
            levels.append(nodes)
    undecomposed = tuple(n for n, rank in enumerate(plan.levels[0].ranks) if rank is None)
    packed = pack_levels(levels, undecomposed)
    quality = tuple(LevelQuality(0.0, 1.0, 1.0) for _ in packed)
    metadata = Metadata("float32", axes, organisation, tuple(bounds_of(level, "most") for level in packed),
                        kind=config.kind, quality=quality, writer="random numbers")
    return Model(metadata, packed)


def _axes(config: Configuration) -> tuple[tuple[Axis, ...], Organisation]:
    """Source axes and the paper's organisation: colour in the light mode, time as it is."""
    a, b, c, d = config.sizes
    if config.kind == "svbrdf":
        spread = hemisphere_directions(a), hemisphere_directions(b, turn=1.2)
        axes = (Axis("light", a, "light", spread[0]), Axis("rgb", 3, "channel"), Axis("view", b, "view", spread[1]),
                Axis("y", c, "space"), Axis("x", d, "space"))
        return axes, (("light", "rgb"), ("view",), ("y",), ("x",))
    if config.kind == "lightfield":
        axes = Axis("view", a, "view"), Axis("y", b, "space"), Axis("x", c, "space"), Axis("time", d, "time")
    else:
        axes = Axis("z", a, "space"), Axis("y", b, "space"), Axis("x", c, "space"), Axis("time", d, "time")
    return axes, tuple((axis.name,) for axis in axes)


def _fill(node: Node, spec: LevelSpec, rng: np.random.Generator, *, last: bool) -> None:
    """Random cells of a node, and its children."""
    sizes = tuple(len(rows) for rows in node.rows)
    if not prod(sizes):
        return
    cells = zero_cells(sizes, spec)
    shapes = zip(sizes, cells.spec.clusters, cells.spec.mixture, strict=True)
    subsets = [_runs(size, c, k, rng) for size, c, k in shapes]
    cells.members = [np.sort(chosen, axis=1) for chosen in subsets]
    _randomise(cells, rng)
    node.cells = cells
    if last:
        return
    node.parts = [chosen[:, 0].astype(np.intp) for chosen in subsets]
    of_part = [[rows[at] for at in rows_of_parts(part, c)] for rows, part, c
               in zip(node.rows, node.parts, cells.spec.clusters, strict=True)]
    node.children = [Node(tuple(rows)) for rows in product(*of_part)]


def _randomise(cells: Cells, rng: np.random.Generator) -> None:
    cells.bases = [rng.standard_normal(basis.shape, np.float32) for basis in cells.bases]
    cells.cores = _SCALE * rng.standard_normal(cells.cores.shape, np.float32)


def _runs(size: int, clusters: int, mixture: int, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Distinct subsets of each row [size, K], the same along runs of rows; each subset comes first about as often."""
    runs = -(-size // RUN) if clusters > 1 else 1
    runs = max(runs, min(size, clusters))
    chosen = np.stack([rng.permutation(clusters)[:mixture] for _ in range(runs)])
    chosen[:, 0] = rng.permutation(np.arange(runs) % clusters)
    for run in chosen:
        others = np.setdiff1d(np.arange(clusters), run[:1])
        run[1:] = rng.permutation(others)[: mixture - 1]
    return chosen[np.arange(size) * runs // size].astype(np.uint16)
