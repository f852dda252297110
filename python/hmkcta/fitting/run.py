"""What every step of a fit shares."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from ..journal import NoJournal
from ..plan import LevelSpec
from ..streaming.budget import side_by_side
from ..streaming.pieces import SubTensor
from ..support.progress import Best, Progress, nobody
from .fit import Effort


@dataclass(frozen=True)
class Run:
    """What every step of a fit shares.

    Attributes:
        effort: how long to try.
        seed: of all random starts.
        threads: how many work at once.
        progress: told each stage and the fraction of it done.
        best: told the best file that a search has found so far.
        enough: asked between steps of a search; True: it is to end with the best found so far.
        journal: keeps the nodes that are finished.
        device: ``cpu`` or ``cuda``, where the kernels work.
        room: bytes that nodes may take together while they are fitted; None: as many as they like.
    """

    effort: Effort
    seed: int
    threads: int
    progress: Progress
    journal: NoJournal = field(default_factory=NoJournal)
    device: str = "cpu"
    room: int | None = None
    best: Best = nobody
    enough: Callable[[], bool] = lambda: False

    def side_by_side(self, specs: Iterable[LevelSpec | None], nodes: Sequence[SubTensor]) -> int:
        """How many of the nodes are fitted side by side; what comes out does not depend on it."""
        if self.room is None or len(nodes) < 2:
            return self.threads
        largest = tuple(map(max, *(node.sizes for node in nodes)))
        return min((side_by_side(spec, largest, self.threads, self.room) for spec in set(specs) if spec), default=1)
