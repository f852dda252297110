"""What of a model's tree is in the text of its shaders; the viewer finds the same."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..packed import LevelBounds, Metadata, PackedLevel, undecomposed_modes


@dataclass(frozen=True)
class Tree:
    """A model's metadata, and what holds in all its nodes.

    Attributes:
        metadata: the model's.
        undecomposed: modes that are undecomposed in every node with numbers.
        mixed: modes that are so in some of these nodes.
        whole: modes with C = 1 in every node, whose rows keep their places all the way down.
        cuts: whether there are nodes that add nothing and have children.
        uniform: stages, from 0, whose nodes with numbers all have the ranks and the undecomposed modes of the metadata:
            loops over their cores have constant bounds.
        ranks: for each mode the largest R of a node in which it is decomposed; 0: there is none.
    """

    metadata: Metadata
    undecomposed: tuple[int, ...] = ()
    mixed: tuple[int, ...] = ()
    whole: tuple[int, ...] = ()
    cuts: bool = False
    uniform: tuple[int, ...] = ()
    ranks: tuple[int, ...] = ()

    @property
    def order(self) -> int:
        """N."""
        return len(self.metadata.organisation)

    def most(self, n: int, rows: int) -> int:
        """The most weights that mode n, of which `rows` are there at once, has in a cell."""
        whole = n in self.undecomposed or n in self.mixed
        return max(self.ranks[n], rows if whole else 1)

    def expected(self, stage: LevelBounds, n: int, rows: int) -> int:
        """As many as a stage's nodes mostly have."""
        return rows if not stage.mixture[n] else min(stage.ranks[n], self.ranks[n])


def tree_of(metadata: Metadata, stages: Sequence[PackedLevel]) -> Tree:
    """What holds in all nodes of a model.

    >>> from hmkcta._example import example_level, example_metadata
    >>> tree = tree_of(example_metadata(), [example_level()])
    >>> tree.uniform, tree.ranks, tree.undecomposed, tree.whole
    ((0,), (1, 1), (), (0, 1))
    """
    modes = range(stages[0].order)
    own = np.concatenate([stage.undecomposed for stage in stages])
    always = undecomposed_modes(stages)
    shapes = np.concatenate([stage.shape for stage in stages])
    ranks = (shapes[:, 2] * ~own).max(axis=0, initial=0)
    clusters = shapes[:, 0].max(axis=0, initial=0)
    return Tree(
        metadata, always, tuple(n for n in modes if n not in always and own[:, n].any()),
        tuple(n for n in modes if clusters[n] <= 1), any(bool(_is_cut(stage).any()) for stage in stages),
        tuple(number for number, (bounds, stage) in enumerate(zip(metadata.stages, stages, strict=True))
              if _is_uniform(bounds, stage)),
        tuple(int(rank) for rank in ranks))


def undecomposed_in(stage: LevelBounds) -> tuple[int, ...]:
    """Modes that are undecomposed in all nodes of a stage that has numbers."""
    return tuple(n for n, k in enumerate(stage.mixture) if not k and any(stage.ranks))


def _is_cut(stage: PackedLevel) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    return stage.shape[:, 0].any(axis=1) & ~stage.has_cells


def _is_uniform(bounds: LevelBounds, stage: PackedLevel) -> bool:
    """Whether all nodes with numbers, of which there are some or the stage is no cut, have these bounds."""
    ranks, kept = stage.shape[stage.has_cells, 2], stage.undecomposed[stage.has_cells]
    same = (ranks == bounds.ranks).all() and (kept == (np.array(bounds.mixture) == 0)).all()
    return bool(stage.nodes and not stage.is_cut and same)
