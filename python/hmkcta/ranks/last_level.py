"""The last level, whose nodes have ranks of their own: fitted with a choice of them, as often as a goal needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..cells import zero_cells
from ..errors import invalid
from ..fitting.fit import Labels
from ..fitting.hierarchy import Hierarchy, LabelsOf, Node, Run, backfit, fit_nodes, restore, saved
from ..goals import LEAST
from ..metrics import noise_at
from ..parameters import LEFT
from ..plan import LevelSpec
from ..streaming.budget import MODEL, PROCESS
from ..streaming.streamed import Streamed
from ..support.memory import check_memory, format_bytes, give_back_freed_memory
from .allocation import Allocation, allocate, stored_bits
from .examining import Goal, Way
from .reckoning import SHARE, Found, Reckoning

#: Share of the error that an SNR allows that the rounding of packed numbers is reckoned to take at most.
MOST_ROUNDING = 0.3


def with_ranks(spec: LevelSpec, ranks: NDArray[np.int32], share: float = 0.0) -> LevelSpec:
    """The level with these ranks instead of those it may choose among, and so much left by rounding (`own_bits`)."""
    given = tuple(None if most is None else int(rank) for rank, most in zip(ranks, spec.ranks, strict=True))
    return replace(spec, ranks=given, own=False, own_bits=share)


class Fitted(NamedTuple):
    """Choices that were fitted, the share of the error that rounding was to leave; bytes of the file, and the squared
    error, which is 0 for an SNR goal and float16 numbers."""

    chosen: Allocation
    share: float
    nbytes: int
    error: float

    def is_of(self, chosen: Allocation, share: float) -> bool:
        """Whether it is a fit of these."""
        return self.share == share and np.array_equal(self.chosen.choice, chosen.choice)


class LastLevel:
    """The fit before the last level, and the choices of ranks from which each attempt starts afresh."""

    def __init__(self, tree: Hierarchy, found: Found, ways: Sequence[Way], goal: Goal, run: Run) -> None:
        self.tree, self.found, self.ways, self.goal, self.run = tree, found, ways, goal, run
        self.spectra = [choices for _, choices in found]
        self.residual = saved(tree)
        self.cells = [[node.cells for node in nodes] for nodes in tree.levels]
        self._last: Fitted | None = None
        #: Squared error outside the nodes that have choices, and bytes beside what the choices count.
        own = sum(float(choices.error[0]) for choices in self.spectra)
        packed, beside = ways[0][0].bits == 8, goal.file_bytes(tree) - allocate(self.spectra, nbytes=0.0).nbytes
        self.reckoned = Reckoning(
            tree.levels[-1], found, ways, goal.energy, tree.error - own, beside, stored_bits(ways[0][0].bits, goal.snr),
            packed, SHARE if packed else 0.0,
        )  # fmt: skip
        self.reckoned.elsewhere += self._rounding(own) if packed else 0.0

    def _rounding(self, energy: float) -> float:
        """What packed numbers will leave of so much energy, but no more than a share of what an SNR allows."""
        allowed = inf if self.goal.snr is None else noise_at(self.goal.snr, self.goal.energy)
        of_columns = 0.0 if self.goal.snr is None else SHARE / (1 + SHARE) * allowed
        return min(energy * LEFT, MOST_ROUNDING * allowed) + of_columns

    def fit(self, chosen: Allocation, share: float | None = None) -> Fitted:
        """Fit these choices, from the residual before the level; rounding is to leave a `share` of the error.

        Without one, as much as is reckoned. What was fitted last is not fitted again.
        """
        self.reckoned.share = self.reckoned.share if share is None else share
        if self._last is not None and self._last.is_of(chosen, self.reckoned.share):
            return self._last
        self._fit(chosen)
        nbytes = self.goal.file_bytes(self.tree)
        self.reckoned.learn(chosen, nbytes)
        # Of a size alone is it asked for: the tensor may have to be read for it.
        error = self.tree.error if self.goal.size is not None and self.reckoned.packed else 0.0
        self._last = Fitted(chosen, self.reckoned.share, nbytes, error)
        return self._last

    def _fit(self, chosen: Allocation) -> None:
        if isinstance(self.tree.residual, Streamed):
            self._make_room(chosen)
        restore(self.tree, self.residual)
        for nodes, before in zip(self.tree.levels, self.cells, strict=True):
            for node, cells in zip(nodes, before, strict=True):
                node.cells = cells
        nodes, labels = self.tree.levels[-1], dict[int, LabelsOf]()
        for (s, choices), choice in zip(self.found, chosen.choice, strict=True):
            labels[id(nodes[s])] = self.ways[int(choices.way[int(choice)])][1]

        def labels_of(node: Node) -> Labels | None:
            return labels[id(node)](node)

        fit_nodes(self.tree, self._specs(chosen), self.run, labels_of)
        for _ in range(self.run.effort.backfits if len(self.tree.levels) > 1 else 0):
            backfit(self.tree, self.run)

    def _make_room(self, chosen: Allocation) -> None:
        """For a model beside a tensor that memory does not hold."""
        give_back_freed_memory()  # of the fit before, which lies where large arrays of this one do not
        if self.goal.memory is not None:
            what = f"a model of {format_bytes(int(chosen.nbytes))}"
            hint = "raise --max-memory, or ask for a lower SNR or fewer bytes"
            wide = max(chosen.nbytes, 2 * self.reckoned.numbers(chosen))  # float16, whatever the file has
            check_memory(PROCESS // 2 + int(MODEL * wide), what, hint, self.goal.memory)

    def _specs(self, chosen: Allocation) -> list[LevelSpec | None]:
        """Each node's chosen way and ranks."""
        specs: list[LevelSpec | None] = [None] * len(self.tree.levels[-1])
        for (s, choices), choice in zip(self.found, chosen.choice, strict=True):
            if choice:
                spec, _ = self.ways[int(choices.way[int(choice)])]
                specs[s] = with_ranks(spec, choices.ranks[choice], self.reckoned.share)
        return specs

    def within(self, size: float) -> Allocation:
        """The allocation whose file, tables and header counted exactly, is at most `size` bytes."""
        fitting, exact = None, 0
        for _ in range(4):
            chosen = allocate(self.spectra, nbytes=size - self.reckoned.beside)
            exact = self.goal.file_bytes(self._dressed(chosen))
            if exact <= size and (fitting is None or chosen.nbytes > fitting.nbytes):
                fitting = chosen
            self.reckoned.beside = exact - chosen.nbytes
        if len(self.tree.levels) == 1 and (fitting is None or not fitting.choice.any()):
            # A file in which nothing is stored would be no answer: one with the least that can be, or none.
            least = Allocation(np.ones(len(self.spectra), np.intp), 0.0, 0.0)
            exact = self.goal.file_bytes(self._dressed(least))
            fitting = least if exact <= size else None
        if fitting is None:
            allowed = f"at least {exact} bytes for this plan and organisation: {LEAST}"
            hint = "ask for more, merge axes or give a coarser plan"
            raise invalid("size-too-small", "size", f"{self.goal.size} bytes", allowed, hint)
        return fitting

    def _dressed(self, chosen: Allocation) -> Hierarchy:
        """The hierarchy as it will be shaped, its last level all zeros: enough to count bytes, at most."""
        last = [
            replace(node, cells=None if spec is None else zero_cells(node.sizes, replace(spec, own_bits=0.0)))
            for node, spec in zip(self.tree.levels[-1], self._specs(chosen), strict=True)
        ]
        return Hierarchy(self.tree.residual, [*self.tree.levels[:-1], last], self.tree.schemes)
