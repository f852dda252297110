"""What to fit: organisation, levels, ranks, clusters, mixtures; printable and priced before hours are spent.

``R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2 / R=2,2,3,3 C=3,3,4,4 K=2`` is WH4 of the paper's table 2: one level a part,
one number stands for all modes, ``R=*`` leaves a mode undecomposed.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import comb, prod
from numbers import Integral

from .axes import Organisation, check_modes
from .errors import expect, invalid
from .goals import check_goal

#: What parts the words of a level, with the spaces beside it.
_SPACED = re.compile(r"\s*([=,:])\s*")

#: Subdivisions of the residual (paper, figure 4); `AUTO` stands for the best of them.
SCHEMES, AUTO = ("most", "least", "uniform"), "auto"

#: Searches for the cluster subsets of rows, the most thorough first; `AUTO` stands for what a level allows.
SEARCHES = ("optimal", "greedy", "fast")

#: Beyond this many cluster subsets in a mode the optimal search gives way to the greedy one (docs/design-notes.md).
OPTIMAL_SUBSETS = 64

#: Most ranks of a mode that a file may have.
HIGHEST_RANK = 1024

#: Beyond this many cells, or columns PC R_n of all their bases of a mode, joint least squares give way to Gauss-Seidel
#: alone: their Gram matrix H_n has (PC R_n)^2 numbers, and each takes the contraction of two cores.
GRAM_CELLS, GRAM_COLUMNS = 1536, 2048


@dataclass(frozen=True)
class LevelSpec:
    """One level of a plan: its R_n, C_n and K_n (paper, section 4.2), and how its residual is subdivided for the next.

    Args:
        ranks: reduced rank R_n of each mode; None: the mode stays undecomposed (``R=*``).
        clusters: C_n of each mode, 1 for an undecomposed one.
        mixture: K_n of each mode, 1 to 8, no more than C_n: how many clusters a row is in.
        scheme: ``most``, ``least`` or ``uniform`` subdivision of the residual (paper, figure 4), or ``auto``: that of
            the three after which a fast fit of the next level leaves least.
        grid: axes that are cut into equal blocks, with how many; these blocks are the clusters.
        asked: the search that is asked for, ``optimal``, ``greedy`` or ``fast``; ``auto``: by what the level allows.

    Raises:
        HmkctaError: R, C or K is out of range or of another type, they are not one for each mode, or the scheme is
            unknown.

    >>> level = LevelSpec((2, 2, None), (4, 3, 1), (2, 2, 1))
    >>> str(level), level.order, level.cells, level.search, level.decode_cost()
    ('R=2,2,* C=4,3,1 K=2,2,1', 3, 12, 'optimal', 16)
    >>> str(level.clamped((3, 1, 5))), LevelSpec((2, 2), (16, 1), (3, 1)).search  # of 560 sets of clusters
    ('R=2,1,* C=3,1,1 K=2,1,1', 'greedy')
    """

    ranks: tuple[int | None, ...]
    clusters: tuple[int, ...]
    mixture: tuple[int, ...]
    scheme: str = AUTO
    grid: tuple[tuple[str, int], ...] = ()
    asked: str = AUTO

    def __post_init__(self) -> None:
        if self.scheme not in (*SCHEMES, AUTO):
            raise invalid("unknown-scheme", "scheme", self.scheme, ", ".join((*SCHEMES, AUTO)))
        if self.asked not in (*SEARCHES, AUTO):
            raise invalid("unknown-search", "search", self.asked, ", ".join((*SEARCHES, AUTO)))
        if any(count < 1 for _, count in self.grid):
            raise invalid("clusters-too-small", "grid", _grid_text(self.grid), "1 or more of each axis")
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
                allowed, hint = f"1 to {min(clusters, 8)} (C is {clusters})", "lower K, or raise C"
                raise invalid("mixture-out-of-range", f"K of {mode}", mixture, allowed, hint)
            if rank is None and clusters > 1:
                allowed = "1, as R=* leaves the mode undecomposed"
                raise invalid("undecomposed-clustered", f"C of {mode}", clusters, allowed)

    @property
    def order(self) -> int:
        """N, the number of modes."""
        return len(self.ranks)

    @property
    def search(self) -> str:
        """How the K_n clusters of a row are found (paper, section 5: optimal search), by what the level allows.

        ``optimal`` looks at all binom(C_n, K_n) sets, ``greedy`` takes one cluster after another in every mode where
        one has more than 64 sets. ``fast`` is for K_n > 1 and more cells than the Gram matrix of their bases has room
        for: rows exchange one cluster at a time.
        """
        if max(self.mixture) > 1 and self.asked != AUTO:
            return self.asked
        if max(self.mixture) > 1 and (self.cells > GRAM_CELLS or self.columns > GRAM_COLUMNS):
            return "fast"
        return self.joint_search

    @property
    def joint_search(self) -> str:
        """The search where H fits: ``optimal``, or of many sets ``greedy``."""
        subsets = max(comb(c, k) for c, k in zip(self.clusters, self.mixture, strict=True))
        return "optimal" if subsets <= OPTIMAL_SUBSETS else "greedy"

    @property
    def search_said(self) -> str:
        """A sentence on how the clusters of rows are found."""
        if self.cells == 1:
            return "one cell, nothing to search"
        if self.grid:
            return "the blocks of the grid, nothing to search"
        if max(self.mixture) == 1:
            return "each row takes the cluster that explains most of it"
        return {"optimal": "optimal search: every set of K clusters is tried for every row",
                "greedy": "greedy search: the best cluster first, then the best beside it",
                "fast": "fast search: rows exchange one cluster at a time, as H of all cells is too large",
                }[self.search]

    @property
    def cells(self) -> int:
        """PC, the number of clusters c = (c_1..c_N) of a node."""
        return prod(self.clusters)

    @property
    def columns(self) -> int:
        """PC R_n: how many basis columns all cells have together in the mode where these are most."""
        return self.cells * max((rank for rank in self.ranks if rank is not None), default=0)

    @property
    def products_bytes(self) -> int:
        """Bytes of the inner products `M_n(c, c')` of all pairs of cells, in float64."""
        return 8 * sum((self.cells * rank) ** 2 for rank in self.ranks if rank is not None)

    @property
    def disjoint(self) -> bool:
        """Whether the cells are blocks of a grid, which share no element; they are then the next level's nodes, too."""
        return self.cells > 1 and bool(self.grid) and max(self.mixture) == 1 and self.scheme != "uniform"

    def alone(self, sizes: Sequence[int]) -> LevelSpec:
        """The spec by which one cell of these mode sizes is fitted as a node of its own: C = K = 1."""
        ones = (1,) * self.order
        return replace(self, clusters=ones, mixture=ones, grid=()).clamped(sizes)

    def decode_cost(self) -> int:
        """Multiply-adds for one scattered element, prod R_n K_n (paper, section 4.3) over the decomposed modes."""
        return prod(r * k for r, k in zip(self.ranks, self.mixture, strict=True) if r is not None)

    def clamped(self, sizes: Sequence[int]) -> LevelSpec:
        """The spec for a node of these mode sizes: C_n <= I_n, K_n <= C_n, R_n <= I_n."""
        clusters = tuple(min(c, max(i, 1)) for c, i in zip(self.clusters, sizes, strict=True))
        mixture = tuple(min(k, c) for k, c in zip(self.mixture, clusters, strict=True))
        ranks = tuple(None if r is None else min(r, max(i, 1)) for r, i in zip(self.ranks, sizes, strict=True))
        return replace(self, ranks=ranks, clusters=clusters, mixture=mixture)

    def __str__(self) -> str:
        def joined(values: Iterable[int | None]) -> str:
            texts = ["*" if value is None else str(value) for value in values]
            return texts[0] if len(set(texts)) == 1 else ",".join(texts)

        text = "R=" + ",".join("*" if r is None else str(r) for r in self.ranks)
        if self.grid:
            text += f" grid={_grid_text(self.grid)}"
        elif self.cells > 1:
            text += f" C={','.join(map(str, self.clusters))}"
        if max(self.mixture) > 1:
            text += f" K={joined(self.mixture)}"
        return text


def _grid_text(grid: Sequence[tuple[str, int]]) -> str:
    return ",".join(f"{axis}:{count}" for axis, count in grid)


def clusters_of_grid(grid: Sequence[tuple[str, int]], organisation: Organisation) -> tuple[int, ...]:
    """C_n of a grid: blocks of each mode, the product of the numbers along the axes that are merged in it."""
    counts = dict(grid)
    return tuple(prod(counts.get(axis, 1) for axis in mode) for mode in organisation)


def multiply_adds(cost: int) -> str:
    """A decode cost for people.

    >>> multiply_adds(1), multiply_adds(576)
    ('1 multiply-add', '576 multiply-adds')
    """
    return f"{cost} multiply-add{'' if cost == 1 else 's'}"


def parse_level(text: str, organisation: Organisation, scheme: str = AUTO) -> LevelSpec:
    """Read one level, e.g. ``R=2,2,3,* C=4,3,4,1 K=2`` or ``R=1 grid=y:4,x:6``.

    One number stands for all modes, K for those that have clusters: ``K=2`` leaves unclustered modes alone,
    ``K=2,2`` says of each what it is to be. Spaces beside ``=``, ``,`` and ``:`` say nothing.

    Raises:
        HmkctaError: ``plan-syntax``, ``plan-modes``, ``plan-number`` or ``plan-grid``; or what `LevelSpec` refuses.

    >>> modes = (("light", "rgb"), ("view",), ("y",), ("x",))
    >>> parse_level("R=2,2,3,* C=4,3,4,1 K=2", modes).mixture
    (2, 2, 2, 1)
    >>> parse_level("R=1 grid=y:4,x:6", modes).clusters
    (1, 1, 4, 6)
    >>> parse_level("R = 2, 2, 3, *", modes).ranks
    (2, 2, 3, None)
    """
    if not text.strip():
        raise invalid("plan-syntax", "plan", "an empty level", "R=.. in each, levels parted by /")
    order = len(organisation)
    words: dict[str, str] = {}
    for word in _SPACED.sub(r"\1", text).split():
        key, equals, values = word.partition("=")
        if not equals or key not in ("R", "C", "K", "grid") or key in words:
            allowed = "R=.., C=.., K=.., grid=.. once a level, levels parted by /"
            raise invalid("plan-syntax", "plan", repr(word), allowed)
        words[key] = values
    if "R" not in words or {"C", "grid"} <= words.keys():
        allowed = "R=.. in each level, and C=.. or grid=.., not both"
        raise invalid("plan-syntax", "plan", repr(text.strip()), allowed)
    ranks = tuple(None if word == "*" else _number("R", word) for word in _words("R", words["R"], order))
    grid = _grid(words.get("grid", ""), organisation)
    clusters = clusters_of_grid(grid, organisation)
    if "C" in words:
        clusters = tuple(_number("C", word) for word in _words("C", words["C"], order))
    given = words.get("K", "1")
    mixture = tuple(_number("K", word) for word in _words("K", given, order))
    if "," not in given and max(clusters) > 1:
        mixture = tuple(min(k, 1) if c == 1 else k for k, c in zip(mixture, clusters, strict=True))
    return LevelSpec(ranks, clusters, mixture, "most" if grid else scheme, grid)


def _grid(text: str, organisation: Organisation) -> tuple[tuple[str, int], ...]:
    """Blocks along each axis that is cut."""
    axes = [axis for mode in organisation for axis in mode]
    grid: list[tuple[str, int]] = []
    for word in text.split(",") if text else []:
        axis, _, count = word.partition(":")
        if axis not in axes or axis in dict(grid):
            allowed = f"AXIS:COUNT, each axis of {', '.join(axes)} at most once"
            raise invalid("plan-grid", "blocks of the plan", repr(word), allowed)
        grid.append((axis, _number("grid", count)))
    return tuple(grid)


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
    """What to fit: levels, the organisation of axes into modes, and a goal.

    `parse_plan` reads one from text, `compress` follows it.

    Args:
        organisation: names of the axes of each mode.
        levels: one `LevelSpec` for each level, the first for the whole tensor.
        snr: SNR in dB: levels beyond the one that reaches it are not fitted; None: all are.
        size: bytes beyond which the file is refused; None: it may have any size.

    Raises:
        HmkctaError: modes are no lists of names, a level is no `LevelSpec`, or a goal is not above 0.

    >>> level = LevelSpec((4, 6), (1, 1), (1, 1))
    >>> plan = Plan((("y",), ("x", "rgb")), (level,), snr=30)
    >>> str(plan), plan.decode_cost(), plan.snr
    ('R=4,6', 24, 30)
    """

    organisation: Organisation
    levels: tuple[LevelSpec, ...]
    snr: float | None = None
    size: int | None = None

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


def parse_plan(text: str, organisation: Organisation, scheme: str = AUTO) -> Plan:
    """Read a plan: levels parted by ``/``, each as `parse_level` reads it.

    Args:
        text: such as ``R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2`` (the table of plans in docs/guide.md has more).
        organisation: names of the axes of each mode.
        scheme: how all levels are subdivided, as `LevelSpec` says (paper, section 4.2); a grid by ``most``.

    Returns:
        The plan, without a goal.

    Raises:
        HmkctaError: no text, modes that are no lists of names, no level, or a level that `parse_level` refuses.

    >>> plan = parse_plan("R=4 / R=2 C=4,1 K=2", (("y",), ("x", "rgb")))
    >>> str(plan), plan.decode_cost()  # 4 * 4 + (2 * 2) * (2 * 1)
    ('R=4,4 / R=2,2 C=4,1 K=2,1', 24)
    """
    expect("plan", text, str, "text such as R=4,4,6,6")
    check_modes(organisation)
    if "=" not in text:
        is_path = "." in text
        hint = "a file is written by Model.save, or by -o FILE" if is_path else "give R of each level"
        raise invalid("plan-syntax", "plan", repr(text), "levels such as R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2", hint)
    return Plan(organisation, tuple(parse_level(part, organisation, scheme) for part in text.split("/")))
