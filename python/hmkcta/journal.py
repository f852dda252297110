"""What a run has finished, kept on disk: after an interruption finished nodes are read instead of fitted.

Fitting is deterministic, so a run that is begun again makes the same steps in the same order; the fitted cells of a
node are known by the number of the step and of the node. The residual is never stored: it follows from the cells.
A journal is a folder with `run.json` (all that decides the result), a file for each value that was settled on the way
(what memory allowed, what a search for a goal chose), `nodes.log` (`recordlog.py`) and, once the model is about to be
saved, `done.json`. `nodes.log` is bounded: of many nodes those fitted first are forgotten, and are fitted once more.
"""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from math import prod
from pathlib import Path
from time import sleep
from types import TracebackType
from typing import Any, TypeVar, cast

import numpy as np

from . import backends
from ._version import __version__
from .axes import format_organisation
from .cells import Cells
from .errors import DISK_FULL, HmkctaError, Kind
from .hmkfile import published
from .hmkfile.reasons import fault
from .journal_cells import fits, packed, unpacked
from .plan import LevelSpec, Plan
from .streaming.source import Source
from .support.recordlog import Busy, RecordLog, in_use

T = TypeVar("T")

RUN, NODES, DONE = "run.json", "nodes.log", "done.json"
#: What the names of settled values begin with that say what memory allowed: nothing is lost with them.
ALLOWED = ("budget", "limit-")
#: Bytes that finished nodes may take for each element of the array, and for all of it at the least.
ARRAY_KEPT, LEAST_KEPT = 2, 1 << 20
#: Seconds beyond which no process merely looks whether another is at work.
_LOOK = 0.05


@dataclass(frozen=True)
class Finished:
    """What became of a node in a step: its cells, or None where it keeps those it had."""

    cells: Cells | None


class NoJournal:
    """Nothing is kept: every node is fitted. `Journal` has the same methods, by which a fit asks and tells it.

    >>> NoJournal().settled("answer", lambda: 42, int), NoJournal().step()
    (42, 0)
    """

    def settled(self, name: str, choose: Callable[[], Any], read: Callable[[Any], T]) -> T:
        """What this run settled before under that name, or settles now.

        Args:
            name: of the file without its ending.
            choose: makes any JSON value.
            read: makes the result of it; raises `TypeError`, `ValueError` or `KeyError` for what `choose` never makes.
        """
        del name
        return read(choose())

    def step(self) -> int:
        """The number of the next step, the same in every run with the same fields."""
        return 0

    def recall(self, step: int, node: int, sizes: Sequence[int], spec: LevelSpec) -> Finished | None:
        """What became of a node; None: it is still to be fitted.

        Args:
            step: what `step` gave.
            node: its number in its level.
            sizes: its mode sizes I_n.
            spec: what it is fitted by.
        """
        del step, node, sizes, spec

    def keep(self, step: int, node: int, cells: Cells | None) -> None:
        """Write down a node's cells, whose numbers are rounded as stored ones are; None: it keeps those it had."""


class Journal(NoJournal):
    """The journal of one run of `compress`, in a folder of its own; a context manager.

    When the block ends, so that the model is saved, the folder is removed. When it ends by an error the folder stays,
    and the same call with ``resume=True`` goes on and ends in the same bytes. Killing the process does as well.

    Args:
        folder: where; made when the run begins. By custom the output's name with ``.partial`` behind it.
        resume: go on with what the folder holds; if it holds nothing, begin.
        overwrite: begin again; what the folder holds is lost.

    Attributes:
        folder: as given, a `Path`.
        found: how many finished nodes the run began with.

    Raises:
        HmkctaError: `Io`, reason ``partial-exists``: the folder holds an interrupted run and neither `resume` nor
            `overwrite` is given; ``partial-busy``: another process works on it; ``unwritable``: it is a file.

    >>> import tempfile, numpy as np
    >>> from hmkcta import compress
    >>> ramp = np.add.outer(np.arange(32.0), np.arange(24.0))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with Journal(f"{folder}/ramp.hmk.partial", resume=True) as journal:
    ...         model = compress(ramp, "R=2", journal=journal)
    ...         model.save(f"{folder}/ramp.hmk")
    ...     sorted(os.listdir(folder))
    ['ramp.hmk']
    """

    def __init__(self, folder: str | os.PathLike[str], *, resume: bool = False, overwrite: bool = False) -> None:
        self.folder = Path(folder)
        self._resume, self._overwrite = resume and not overwrite, overwrite
        self._log: RecordLog | None = None
        self._steps = 0
        #: Finished nodes that were found when the run began.
        self.found = 0
        self._refuse_others()

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._log is None:
            return
        # What was asked for cannot be, and will not be the next time; or what is kept is of several states of a source.
        vain = isinstance(error, HmkctaError) and error.kind in (Kind.INVALID_ARGUMENT, Kind.SOURCE_CHANGED)
        if error is None or vain:
            self._discard()
        else:
            self.close()

    @property
    def holds_work(self) -> bool:
        """Whether the folder holds anything that would have to be done again."""
        with self._as_io():
            nodes = self.folder / NODES
            settled = any(path.name not in (RUN, DONE) and not path.name.startswith(ALLOWED)
                          for path in self.folder.glob("*.json"))
            return settled or (nodes.exists() and nodes.stat().st_size > 0)

    def close(self) -> None:
        """Force everything to the disk and let go of it; a folder in which nothing stands is removed."""
        if self._log is None:
            return
        if not self.holds_work:
            self._discard()
            return
        with self._as_io():
            self._log.sync()
            self._log.close()
        self._log = None

    def begin(self, run: Mapping[str, Any]) -> None:
        """Make the folder, or compare what it holds with this run; `compress` calls it.

        Args:
            run: all that decides the result, of `decisive`.

        Raises:
            HmkctaError: `InvalidArgument`, reason ``partial-differs``, naming the fields; `Io` if another process, or
                this journal in another call, works on it (``partial-busy``), or the folder cannot be written to.
        """
        if self._log is not None:
            raise HmkctaError(Kind.IO, "partial-busy", str(self.folder), found="another call that this journal keeps",
                              allowed="one call a journal", hint="end its block first, or take another folder")
        with self._as_io():
            self._refuse_others()
            self.folder.mkdir(exist_ok=True)
            self._log = self._opened()
            try:
                if self._resume and self.holds_work:
                    self._compare(run)
                    self.found = len(self._log)
                else:
                    self._clear()
                    (self.folder / DONE).unlink(missing_ok=True)
                    self._write(RUN, run)
            except BaseException:
                self.close()
                raise
        self._log.most = max(LEAST_KEPT, ARRAY_KEPT * prod(run.get("shape", ())))
        self._steps = 0

    def about_to_publish(self, done: Mapping[str, Any]) -> None:
        """Note what tells that the output, once it is there, is this run's, as `done`."""
        with self._as_io():
            self._write(DONE, done)

    @property
    def done(self) -> dict[str, Any]:
        """What `about_to_publish` noted; empty: nothing."""
        with suppress(OSError, HmkctaError):
            return dict(self._read(DONE))
        return {}

    def remove(self) -> None:
        """Remove the folder before any run begins, as its output is there."""
        self._log = self._opened()
        self._discard()

    def settled(self, name: str, choose: Callable[[], Any], read: Callable[[Any], T]) -> T:
        """The interrupted run's value; else the one chosen now, which is written down.

        Raises:
            HmkctaError: `Corruption`, reason ``partial-damaged``: what is written down is no such value.
        """
        if (self.folder / f"{name}.json").exists():
            try:
                return read(self._read(f"{name}.json"))
            except (TypeError, ValueError, KeyError) as error:
                raise self._useless(f"{name}.json that is none", "the files of a run") from error
        value = choose()
        with self._as_io():
            self._write(f"{name}.json", value)
        return read(value)

    def step(self) -> int:
        """The number of the next step."""
        self._steps += 1
        return self._steps

    def recall(self, step: int, node: int, sizes: Sequence[int], spec: LevelSpec) -> Finished | None:
        """What is written down of a node in a step.

        Raises:
            HmkctaError: `Corruption`, reason ``partial-damaged``: it is of a node of other sizes or ranks.
        """
        assert self._log is not None
        with self._as_io():
            content = self._log.read((step, node))
        if content is None:
            return None
        cells = unpacked(content, spec) if content else None
        if cells is not None and not fits(cells, sizes, spec):
            raise self._useless(f"{cells.spec} for {cells.sizes} in step {step}, node {node}", f"{spec} for {sizes}")
        return Finished(cells)

    def keep(self, step: int, node: int, cells: Cells | None) -> None:
        """Write down what became of a node.

        Raises:
            HmkctaError: `Io`, ``disk-full`` or ``unwritable``; what was written before stays.
        """
        assert self._log is not None
        content = b"" if cells is None else packed(cells)
        with self._as_io():
            self._log.append((step, node), content)

    def _opened(self) -> RecordLog:
        try:
            return RecordLog(self.folder / NODES)
        except Busy:
            raise self._busy() from None

    def _busy(self) -> HmkctaError:
        return HmkctaError(Kind.IO, "partial-busy", str(self.folder), found="another process at work on it",
                           allowed="one at a time", hint="wait until it has ended")

    def _refuse_others(self) -> None:
        if self.folder.exists() and not self.folder.is_dir():
            raise fault("unwritable", str(self.folder), "a file", "a folder, or nothing", "move it away")
        with self._as_io():
            if in_use(self.folder / NODES):
                sleep(_LOOK)
                # Not of a process that looks just as this one does, for which it takes the lock for a moment.
                if in_use(self.folder / NODES):
                    raise self._busy()
        if not (self._resume or self._overwrite) and self.holds_work:
            raise HmkctaError(Kind.IO, "partial-exists", str(self.folder), found="the work of an interrupted run",
                              hint="go on with it by resume=True or --resume, "
                                   "or begin again with overwrite=True or --overwrite")

    def _compare(self, run: Mapping[str, Any]) -> None:
        stored = self._read(RUN)
        if not isinstance(stored, dict):
            raise self._useless(f"no fields in {RUN}", "the files of a run")
        before, now = cast("dict[str, Any]", stored), cast("dict[str, Any]", json.loads(_text(run)))
        differing = [name for name in {**before, **now} if before.get(name) != now.get(name)]
        if differing:
            found, allowed = (", ".join(f"{name} {json.dumps(fields.get(name))}" for name in differing)
                              for fields in (now, before))
            raise HmkctaError(
                Kind.INVALID_ARGUMENT, "partial-differs", str(self.folder), found=found,
                allowed=f"{allowed}, as the interrupted run had", hint="give what it was begun with, or --overwrite")

    def _read(self, name: str) -> Any:
        try:
            return json.loads((self.folder / name).read_text(encoding="utf-8"))
        except (FileNotFoundError, ValueError, RecursionError) as error:
            raise self._useless(f"no readable {name}", "the files of a run") from error

    def _write(self, name: str, content: Any) -> None:
        with published(self.folder / name, overwrite=True) as file:
            file.write(_text(content).encode())

    def _useless(self, found: str, allowed: str) -> HmkctaError:
        return HmkctaError(Kind.CORRUPTION, "partial-damaged", str(self.folder), found=found, allowed=allowed,
                           hint="begin again with --overwrite")

    def _clear(self) -> None:
        """Nodes before the choices and the run they belong to: a crash in between leaves nothing that counts."""
        assert self._log is not None
        self._log.clear()
        for path in (*self.folder.glob("*.json"), *self.folder.glob(".*.tmp")):
            if path.name != DONE:
                path.unlink(missing_ok=True)

    def _discard(self) -> None:
        """Remove the folder, unless somebody put files of their own there."""
        assert self._log is not None
        with self._as_io():
            self._clear()
            self._log.close()
            (self.folder / NODES).unlink(missing_ok=True)
            (self.folder / DONE).unlink(missing_ok=True)  # the last, as it says what to make of the others
        self._log = None
        with suppress(OSError):
            self.folder.rmdir()

    @contextmanager
    def _as_io(self) -> Generator[None]:
        """Turn what the operating system says into an `Io` error that says what to do."""
        try:
            yield
        except OSError as error:
            full = error.errno in DISK_FULL
            hint = "free some space, then go on by resume=True or --resume" if full else "check the folder"
            said = error.strerror or error
            raise fault("disk-full" if full else "unwritable", str(self.folder), said,
                        "a folder with room for what is finished", hint, told=f"cannot be written: {said}") from error


def decisive(source: Source, plan: Plan | None, **settings: Any) -> dict[str, Any]:
    """All that decides the result of a run: the array, the plan if it is given, the settings, and what computes.

    Different processors round differently, so BLAS's name for this one is among it; the number of threads is not.
    """
    from threadpoolctl import threadpool_info  # pyright: ignore[reportMissingTypeStubs] (it has none)

    libraries = cast("list[dict[str, Any]]", threadpool_info())
    blas = sorted({str(library.get("architecture")) for library in libraries if library["user_api"] == "blas"})
    axes = [[axis.name, axis.role, axis.unit, None if axis.coords is None else np.asarray(axis.coords).tolist()]
            for axis in source.axes]
    if plan is not None:
        settings |= {"plan": str(plan), "organisation": format_organisation(plan.organisation), "snr": plan.snr,
                     "size": plan.size, "scheme": [level.scheme for level in plan.levels],
                     "search": [level.asked for level in plan.levels]}
    return {
        "sha256 of the array": source.fingerprint["sha256"], "shape": list(source.shape), "dtype": source.dtype,
        "axes": axes, "transform": source.transform, "nan": source.nan, **settings,
        "hmkcta": __version__, "kernels": backends.name, "machine": " ".join([platform.machine(), *blas]),
    }


def _text(content: Any) -> str:
    """JSON, of NumPy's numbers as of Python's."""
    return json.dumps(content, indent=1, default=lambda number: number.item())
