"""What to fit: organisation, levels, ranks, clusters, mixtures; printable and priced before hours are spent.

``R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2 / R=2,2,3,3 C=3,3,4,4 K=2`` is WH4 of the paper's table 2: one level a part,
one number stands for all modes, ``R=*`` leaves a mode undecomposed.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import comb, prod
from numbers import Integral

from .axes import Organisation, check_modes
from .errors import expect, invalid
from .goals import check_goal
from .grids import divisors
from .narrow import BITS

#: What parts the words of a level, with the spaces beside it.
_SPACED = re.compile(r"\s*(<=|[=,:])\s*")

SCHEMES = ("most", "least", "uniform")

#: Beyond this many cluster subsets in a mode the optimal search gives way to the greedy one (docs/design-notes.md).
OPTIMAL_SUBSETS = 64

#: Most ranks of a mode that a file may have.
HIGHEST_RANK = 1024
#: Most ranks of a mode that a chosen plan may have: of one that is decomposed alone, and of several.
MOST_RANKS_ALONE, MOST_RANKS = 640, 160

#: Beyond this many cells, or columns PC R_n of all their bases of a mode, joint least squares give way to Gauss-Seidel
#: alone: their Gram matrix H_n has (PC R_n)^2 numbers, and each takes the contraction of two cores.
GRAM_CELLS, GRAM_COLUMNS = 1536, 2048


@dataclass(frozen=True)
class LevelSpec:
    """R_n (None: undecomposed), C_n and K_n of one level, and how its residual is subdivided for the next.

    `grid` lists axes that are cut into equal blocks, which then are the clusters; with `own` set every node gets
    ranks of its own up to R, by one Lagrange multiplier over the level (`ranks.allocation`), as the plan's goal allows.
    `fewest` are numbers of blocks for axes of the grid: of so many up to those of the grid the goal takes what pays.
    `cuts` lists axes that each such node may be cut along into so many equal blocks, or a divisor of that, as pays: its
    cells, which then all have the same ranks. `bits` are those of each core and basis number in the file, and
    `bits_written` tells whether a text said them: by themselves, 16 may be said or left out.

    >>> LevelSpec((2, 2, None), (4, 3, 1), (2, 2, 1)).search
    'optimal'
    """

    ranks: tuple[int | None, ...]
    clusters: tuple[int, ...]
    mixture: tuple[int, ...]
    scheme: str = "most"
    grid: tuple[tuple[str, int], ...] = ()
    own: bool = False
    cuts: tuple[tuple[str, int], ...] = ()
    fewest: tuple[tuple[str, int], ...] = ()
    bits: int = 16
    bits_written: bool = field(default=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        if self.scheme not in SCHEMES:
            raise invalid("unknown-scheme", "scheme", self.scheme, ", ".join(SCHEMES))
        if self.bits not in BITS:
            raise invalid("bits", "bits of the level", self.bits, " or ".join(map(str, BITS)))
        if any(count < 1 for _, count in self.cuts):
            raise invalid("clusters-too-small", "cut<=", _grid_text(self.cuts, {}), "1 or more of each axis")
        if not len(self.ranks) == len(self.clusters) == len(self.mixture):
            found = f"{len(self.ranks)} R, {len(self.clusters)} C, {len(self.mixture)} K"
            raise invalid("level-modes", "level", found, "as many of each as there are modes")
        for n, (rank, clusters, mixture) in enumerate(zip(self.ranks, self.clusters, self.mixture, strict=True)):
            mode = f"mode {n + 1}"
            expect(f"R of {mode}", rank, Integral | None, "a whole number, or None for an undecomposed mode")
            expect(f"C of {mode}", clusters, Integral, "a whole number")
            expect(f"K of {mode}", mixture, Integral, "a whole number")
            if rank is not None and rank < 1:
                raise invalid("rank-too-small", f"R of {mode}", rank, "1 or more, or * for an undecomposed mode")
            if clusters < 1:
                raise invalid("clusters-too-small", f"C of {mode}", clusters, "1 or more")
            if not 1 <= mixture <= min(clusters, 8):
                raise invalid(
                    "mixture-out-of-range", f"K of {mode}", mixture, f"1 to {min(clusters, 8)} (C is {clusters})",
                    "a row is in K of C clusters: lower K, or raise C",
                )
            if rank is None and clusters > 1:
                raise invalid(
                    "undecomposed-clustered", f"C of {mode}", clusters, "1, as R=* leaves the mode undecomposed"
                )

    @classmethod
    def of_one_cell(cls, most: Sequence[int | None], bits: int = 16, scheme: str = "most") -> LevelSpec:
        """Whose nodes are one cell with ranks of their own, up to so `most` (``R<=..``)."""
        ones = (1,) * len(most)
        return cls(tuple(most), ones, ones, scheme, own=True, bits=bits)

    @property
    def order(self) -> int:
        """N, the number of modes."""
        return len(self.ranks)

    def ways(self, organisation: Organisation) -> list[LevelSpec]:
        """What a node may become: one spec, or one for each choice of blocks, the fewest first.

        >>> [way.clusters for way in parse_level("R<=8 cut<=y:4", (("y",), ("x",))).ways((("y",), ("x",)))]
        [(1, 1), (2, 1), (4, 1)]
        >>> [way.clusters for way in parse_level("R<=8 grid=y:3-4,x:2", (("y",), ("x",))).ways((("y",), ("x",)))]
        [(3, 2), (4, 2)]
        """
        if not self.cuts and not self.fewest:
            return [self]
        names, counts = zip(*self.block_counts, strict=True)
        grids = (tuple((name, n) for name, n in zip(names, grid, strict=True) if n > 1) for grid in product(*counts))
        return [replace(self, cuts=()).cut_into(grid, organisation) for grid in grids]

    @property
    def block_counts(self) -> list[tuple[str, Sequence[int]]]:
        """The numbers of blocks that a way may have along each axis."""
        if self.fewest:
            least = dict(self.fewest)
            return [(axis, range(least.get(axis, most), most + 1)) for axis, most in self.grid]
        return [(axis, divisors(most)) for axis, most in self.cuts]

    def cut_into(
        self, grid: tuple[tuple[str, int], ...], organisation: Organisation, fewest: tuple[tuple[str, int], ...] = ()
    ) -> LevelSpec:
        """The spec with these blocks, or as many as pay from the `fewest` on."""
        return replace(self, clusters=clusters_of_grid(grid, organisation), grid=grid, fewest=fewest)

    @property
    def search(self) -> str:
        """How cluster subsets are found: over all binom(C, K) of them, greedily where they explode, or by the fast
        search where the Gram matrix of all cells would not fit."""
        if max(self.mixture) > 1 and (self.cells > GRAM_CELLS or self.columns > GRAM_COLUMNS):
            return "fast"
        subsets = max(comb(c, k) for c, k in zip(self.clusters, self.mixture, strict=True))
        return "optimal" if subsets <= OPTIMAL_SUBSETS else "greedy"

    @property
    def cells(self) -> int:
        """PC, the number of clusters c = (c_1..c_N) of a node."""
        return prod(self.clusters)

    @property
    def columns(self) -> int:
        """PC R_n, all cells' basis columns of a mode, where those are most."""
        return self.cells * max((rank for rank in self.ranks if rank is not None), default=0)

    @property
    def products_bytes(self) -> int:
        """Bytes of the inner products `M_n(c, c')` of all pairs of cells, in float64."""
        return 8 * sum((self.cells * rank) ** 2 for rank in self.ranks if rank is not None)

    @property
    def disjoint(self) -> bool:
        """Whether the cells are the blocks of a grid, which share no element and are parted as they are."""
        return self.cells > 1 and bool(self.grid) and max(self.mixture) == 1 and self.scheme != "uniform"

    def alone(self, sizes: Sequence[int]) -> LevelSpec:
        """The spec of one of the cells, of these sizes, as a node of its own."""
        ones = (1,) * self.order
        return replace(self, clusters=ones, mixture=ones, grid=()).clamped(sizes)

    def decode_cost(self) -> int:
        """Multiply-adds for one scattered element, prod R_n K_n; an undecomposed mode is only indexed.

        >>> LevelSpec((2, 2, 3, 3), (4, 3, 4, 4), (2, 2, 2, 2)).decode_cost()
        576
        """
        return prod(r * k for r, k in zip(self.ranks, self.mixture, strict=True) if r is not None)

    def clamped(self, sizes: Sequence[int]) -> LevelSpec:
        """The spec for a node of these sizes: C <= I, K <= C, R <= I, and R of its own what a file may have."""
        most = HIGHEST_RANK if self.own else max(1, *sizes)
        clusters = tuple(min(c, max(i, 1)) for c, i in zip(self.clusters, sizes, strict=True))
        return LevelSpec(
            tuple(None if r is None else min(r, most, max(i, 1)) for r, i in zip(self.ranks, sizes, strict=True)),
            clusters,
            tuple(min(k, c) for k, c in zip(self.mixture, clusters, strict=True)),
            self.scheme,
            self.grid,
            self.own,
            bits=self.bits,
        )

    def __str__(self) -> str:
        def joined(values: Iterable[int | None]) -> str:
            texts = ["*" if value is None else str(value) for value in values]
            return texts[0] if len(set(texts)) == 1 else ",".join(texts)

        text = ("R<=" if self.own else "R=") + ",".join("*" if r is None else str(r) for r in self.ranks)
        if self.cuts:
            text += f" cut<={_grid_text(self.cuts, {})}"
        elif self.grid:
            text += f" grid={_grid_text(self.grid, dict(self.fewest))}"
        elif self.cells > 1:
            text += f" C={','.join(map(str, self.clusters))}"
        if max(self.mixture) > 1:
            text += f" K={joined(self.mixture)}"
        return text if self.bits == BITS[0] else f"{text} bits={self.bits}"


def _grid_text(grid: Sequence[tuple[str, int]], fewest: Mapping[str, int]) -> str:
    return ",".join(f"{axis}:{f'{fewest[axis]}-' if axis in fewest else ''}{count}" for axis, count in grid)


def clusters_of_grid(grid: Sequence[tuple[str, int]], organisation: Organisation) -> tuple[int, ...]:
    """Blocks of each mode, of the counts along axes."""
    counts = dict(grid)
    return tuple(prod(counts.get(axis, 1) for axis in mode) for mode in organisation)


def multiply_adds(cost: int) -> str:
    """A decode cost for people.

    >>> multiply_adds(1), multiply_adds(576)
    ('1 multiply-add', '576 multiply-adds')
    """
    return f"{cost} multiply-add{'' if cost == 1 else 's'}"


def parse_level(text: str, organisation: Organisation, scheme: str = "most") -> LevelSpec:
    """Read one level, e.g. ``R=2,2,3,* C=4,3,4,1 K=2``, ``R=1 grid=y:4,x:6`` or ``R<=8,8,8,* bits=8``.

    One number stands for all modes, K for those that have clusters: ``K=2`` leaves unclustered modes alone,
    ``K=2,2`` says of each what it is to be. Spaces beside ``=``, ``<=``, ``,`` and ``:`` say nothing.

    >>> modes = (("light", "rgb"), ("view",), ("y",), ("x",))
    >>> parse_level("R=2,2,3,* C=4,3,4,1 K=2", modes).mixture
    (2, 2, 2, 1)
    >>> parse_level("R=1 grid=y:4,x:6", modes).clusters
    (1, 1, 4, 6)
    >>> parse_level("R = 2, 2, 3, *", modes).ranks
    (2, 2, 3, None)
    """
    if not text.strip():
        raise invalid("plan-syntax", "plan", "an empty level", "R=.. or R<=.. in each, levels parted by /")
    order = len(organisation)
    words: dict[str, str] = {}
    for word in _SPACED.sub(r"\1", text).split():
        key, equals, values = word.partition("=")
        if not equals or key not in ("R", "R<", "C", "K", "grid", "cut<", "bits") or key in words:
            allowed = "R=.., R<=.., C=.., K=.., grid=.., cut<=.., bits=.. once a level, levels parted by /"
            raise invalid("plan-syntax", "plan", repr(word), allowed)
        words[key] = values
    own = "R<" in words
    if ("R" in words) == own or len({"C", "grid", "cut<"} & words.keys()) > 1 or ("cut<" in words and not own):
        allowed = "either R=.. or R<=.. in each level, one of C=.., grid=.. and cut<=.. at most, the last with R<="
        raise invalid("plan-syntax", "plan", repr(text.strip()), allowed)
    ranks = tuple(
        None if word == "*" else _number("R", word) for word in _words("R", words.get("R", words.get("R<", "")), order)
    )
    grid, fewest = _grid(words.get("grid", ""), organisation)
    cuts, none = _grid(words.get("cut<", ""), organisation)
    if none or (fewest and not own):
        raise invalid("plan-grid", "blocks of the plan", repr(text.strip()), "ranges, AXIS:FEWEST-MOST, with R<= grid=")
    clusters = clusters_of_grid(grid, organisation)
    if "C" in words:
        clusters = tuple(_number("C", word) for word in _words("C", words["C"], order))
    given = words.get("K", "1")
    mixture = tuple(_number("K", word) for word in _words("K", given, order))
    if "," not in given and max(clusters) > 1:
        mixture = tuple(min(k, 1) if c == 1 else k for k, c in zip(mixture, clusters, strict=True))
    bits = _number("bits", words.get("bits", str(BITS[0])))
    scheme = "most" if grid else scheme
    return LevelSpec(ranks, clusters, mixture, scheme, grid, own, cuts, fewest, bits, bits_written="bits" in words)


def _grid(
    text: str, organisation: Organisation
) -> tuple[tuple[tuple[str, int], ...], tuple[tuple[str, int], ...]]:
    """Most blocks along each axis, and the fewest along those that have a range."""
    axes = [axis for mode in organisation for axis in mode]
    grid: list[tuple[str, int]] = []
    fewest: list[tuple[str, int]] = []
    for word in text.split(",") if text else []:
        axis, _, count = word.partition(":")
        least, dash, most = count.partition("-")
        if axis not in axes or axis in dict(grid):
            allowed = f"AXIS:COUNT, each axis of {', '.join(axes)} at most once"
            raise invalid("plan-grid", "blocks of the plan", repr(word), allowed)
        grid.append((axis, _number("grid", most if dash else least)))
        if dash:
            fewest.append((axis, _number("grid", least)))
            if not 1 <= fewest[-1][1] <= grid[-1][1]:
                raise invalid("plan-grid", "blocks of the plan", repr(word), "AXIS:FEWEST-MOST, the smaller one first")
    return tuple(grid), tuple(fewest)


def _words(key: str, text: str, order: int) -> list[str]:
    words = text.split(",")
    if len(words) == 1:
        words *= order
    if len(words) != order:
        raise invalid("plan-modes", f"{key} of the plan", f"{len(words)} values ({text})", f"1 or {order}, one a mode")
    return words


def _number(key: str, word: str) -> int:
    if not (word.isascii() and word.isdigit()) or len(word) > 9:
        raise invalid(
            "plan-number", f"{key} of the plan", repr(word), "whole numbers" + (" or *" if key == "R" else "")
        )
    return int(word)


@dataclass(frozen=True)
class Plan:
    """Levels and the organisation of axes into modes; goals that the levels with node shapes of their own are cut to.

    `size` bounds the bytes of the whole file, `snr` is met and not much exceeded; both None: fit exactly the levels.
    `expected` are bytes that a plan chosen for an SNR took on the sample that it was chosen on, as far as it tells.
    """

    organisation: Organisation
    levels: tuple[LevelSpec, ...]
    snr: float | None = None
    size: int | None = None
    expected: int | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        check_modes(self.organisation)
        for level in self.levels:
            expect("level of the plan", level, LevelSpec, "a LevelSpec")
        check_goal(self.snr, self.size, " of the plan")

    def __str__(self) -> str:
        return " / ".join(str(level) for level in self.levels)

    def decode_cost(self) -> int:
        """Multiply-adds for one scattered element: sum over levels of prod R_n K_n (paper, section 4.3)."""
        return sum(level.decode_cost() for level in self.levels)


def parse_plan(text: str, organisation: Organisation, scheme: str = "most") -> Plan:
    """Read levels parted by ``/``; see `parse_level`."""
    expect("plan", text, str, "text such as R=4,4,6,6")
    if "=" not in text:
        is_path = "." in text
        hint = "a file is written by Model.save, or by -o FILE" if is_path else "give R of each level, R<=.. for a goal"
        raise invalid("plan-syntax", "plan", repr(text), "levels such as R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2", hint)
    return Plan(organisation, tuple(parse_level(part, organisation, scheme) for part in text.split("/")))
