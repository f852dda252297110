"""Array in, model out: the whole way of the data (paper, figure 3), by a given plan or one chosen for a goal."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from math import prod
from numbers import Integral, Real
from threading import Lock
from typing import Any, cast
from warnings import warn

import numpy as np

from . import backends as kernels
from .axes import Axis, check_kind
from .backends import Device
from .errors import GoalMissed, expect, invalid, shown
from .fitting.fit import EFFORTS
from .fitting.hmkcta import FitRequest, fit_plan
from .fitting.run import Run
from .goals import misses, time_given
from .hmkfile import KINDS
from .journal import Journal, decisive
from .model import Model
from .offset import lost_beside_offset
from .plan import AUTO, SCHEMES, SEARCHES, Plan
from .search.engine import Goal
from .search.find import Estimate, estimate_model, find_model
from .search.written import coded_for
from .streaming.budget import check_least_memory
from .streaming.source import Source, prepare
from .support import bar
from .support.cut_short import whole_map
from .support.executors import thread_count
from .support.memory import keep_freed_memory
from .support.progress import Progress, nobody
from .wanted import Wanted, read_plan, the_goal, wanted_of

#: Default goal: this share of the float32 bytes, or `wanted.DEFAULT_SNR` where that takes fewer.
DEFAULT_RATIO = 100
#: A default goal is never below these: header and tables alone take several KiB, and a row of a mode, with the least
#: that can be stored of it (R = 1), up to five bytes. Few long modes leave nothing else to save.
SMALLEST_DEFAULT, ROW_BYTES = 16384, 5


def compress(
    array: Any,
    plan: Plan | str | None = None,
    *,
    axes: Sequence[Axis | str] | None = None,
    snr: float | None = None,
    size: int | str | None = None,
    decode_cost: int = 4096,
    quality: str = "medium",
    time: float | str | None = None,
    enough: Callable[[], bool] | None = None,
    organisation: str | Sequence[Sequence[str]] | None = None,
    scheme: str | None = None,
    search: str | None = None,
    transform: str | None = None,
    nan: float | None = None,
    kind: str | None = None,
    seed: int = 0,
    threads: int | None = None,
    max_memory: int | str | None = None,
    device: str | Device = "cpu",
    progress: Progress | None = None,
    journal: Journal | None = None,
) -> Model:
    """Approximate an array by HMK-CTA (paper, section 4), by a given plan, or for a goal by what a search finds.

    Args:
        array: real numbers or booleans of any dtype, order and layout, 1 to 8 axes; NumPy array or memory map.
        plan: levels as `parse_plan` reads them, or a `Plan`, whose goal counts unless `snr` or `size` says another;
            None: blocks, modes and ranks are searched for the goal.
        axes: names (``light``, or ``gloss:space`` with a role) or `Axis` objects, in array order; or the names as one
            text, ``"light, view, y, x"``; None: those of an xarray or a `Model`.
        snr: least SNR in dB of the stored numbers. With explicit levels: no deeper than needed.
        size: most bytes of the whole file, or a text such as ``"20MiB"``. Neither: 1/100 of the float32 bytes or
            50 dB, whichever is less.
        decode_cost: most multiply-adds for one scattered element of what is chosen. Written ranks are kept.
        quality: ``fast``, ``medium`` or ``thorough``: how long the fit tries.
        time: seconds, or a text such as ``"5min"``, after which a search for a goal takes the best layout found so far;
            that one is then coded to its end. What is found depends on the machine; None: as long as it takes.
        enough: asked now and then by a search for a goal; once it returns True, the search takes the best layout found
            so far, as with `time`. For a button that says "stop here".
        organisation: axes merged into modes, ``"light+rgb, view, y+x"``, or their names for each mode, as
            `Plan.organisation` has them; None: the `Plan`'s, chosen, or a mode for each axis.
        scheme: ``most``, ``least``, ``uniform`` or ``auto`` (the best of the three) subdivision of written levels;
            None: as a `Plan` says, ``auto`` of a text.
        search: for the K clusters of a row in written levels: ``optimal``, ``greedy``, ``fast``, or ``auto`` (the most
            thorough that a level and `max_memory` allow); None: as a `Plan` says, ``auto`` of a text.
        transform: value transform for high dynamic range, e.g. ``log1p``; None: identity.
        nan: value to put for NaN and infinity; None: refuse them.
        kind: ``svbrdf``, ``lightfield``, ``volume`` or ``generic``, whose roles the axes must have; None: what their
            roles make.
        seed: the same seed makes the same file.
        threads: how many at most; None, and any number beyond them: all cores.
        max_memory: bytes to work in, or a text such as ``"200MB"``; None: half of what is free. A tensor too large for
            it is streamed, by way of scratch files in the folder for temporary files (``TMPDIR``).
        device: ``cpu``; or ``cuda``, by which the kernels work on an NVIDIA GPU, through CuPy. Where there is none
            that works it is the CPU, with a warning that says what is missing. Files of another device differ, by
            rounding. Or what `backends.find_device` found, which then keeps count of kernel calls.
        progress: called with a stage's name and the fraction of it done, 0 to 1. A method `best` of it is called with
            the bytes and the SNR in dB of the best file that a search has found so far. None: a bar, if stderr is a
            terminal or this runs in a notebook.
        journal: keeps what is finished, so that an interrupted call can go on.

    Returns:
        The model; `Model.save` writes the file. `Model.made_by` is the plan that was given.

    Raises:
        HmkctaError: an argument is out of range, the array holds NaN or infinity, memory would not do, or the journal
            is of another call.

    Warns:
        GoalMissed: the SNR is out of reach; the model is the best found.
        UserWarning: a device is missing; the model is no better than zeros alone, of which the SNR is 0 dB; it holds an
            offset, and little of what varies around it.

    >>> import numpy as np
    >>> ramp = np.add.outer(np.arange(32.0), np.arange(24.0))
    >>> model = compress(ramp, "R=2")
    >>> model.shape, model.snr > 60
    ((32, 24), True)
    """
    device = _found(device)
    expect("enough", enough, Callable | None, "a function that returns whether to end")
    run = replace(_run(quality, decode_cost, seed, threads, progress), device=device.name)
    run = run if enough is None else replace(run, enough=enough)
    snr, size = the_goal(snr, size)
    time = time_given(time)
    _check_types(array, transform, nan)
    expect("plan", plan, Plan | str | None, "text such as R=4,4,6,6, or a Plan")
    expect("journal", journal, Journal | None, "a Journal")
    _check_names(scheme, search, kind)
    wanted = wanted_of(snr, size, decode_cost, organisation, max_memory)
    with _threads(run.threads), whole_map(array), bar.shown(progress) as listener:
        run = replace(run, progress=listener, best=getattr(listener, "best", nobody))
        source, run = _prepared(prepare(array, axes, transform, nan, run.threads), run)
        check_kind(source.axes, kind or source.kind)
        if plan is not None:
            plan = read_plan(plan, source, wanted, scheme, search)
            if time is not None:
                raise invalid("time", "time", "a time beside a plan", "no time", "a written plan takes what it takes")
        # Before anything is kept of a run that cannot be.
        check_least_memory(prod(source.shape), wanted.max_memory, choosing=plan is None)
        if journal is not None:
            run = replace(run, journal=journal)
            journal.begin(decisive(source, plan, kind=kind, quality=quality, seed=run.seed,
                                   device=device.described, **asdict(wanted)))

        with kernels.use(device):
            if plan is None:
                model = find_model(source, wanted, _goal(source, wanted), quality=quality, kind=kind or source.kind,
                                   run=run, seconds=time)
            else:
                model = fit_plan(FitRequest(source, plan, kind or source.kind, run, wanted.max_memory))
                if plan.snr is not None or plan.size is not None:
                    model = coded_for(model, source, Goal(plan.size, plan.snr), run)
        _check_steady(source)
    _warn_of(model, source, plan.snr if plan else wanted.snr)
    return model


def estimate(
    array: Any,
    *,
    axes: Sequence[Axis | str] | None = None,
    snr: float | None = None,
    size: int | str | None = None,
    decode_cost: int = 4096,
    quality: str = "medium",
    organisation: str | Sequence[Sequence[str]] | None = None,
    transform: str | None = None,
    nan: float | None = None,
    seed: int = 0,
    threads: int | None = None,
    max_memory: int | str | None = None,
    progress: Progress | None = None,
) -> Estimate:
    """Estimate by samples what `compress` would make for a goal, and how long it would take.

    Clusters of rows are not looked at: where rows have no order, `compress` may end higher.

    Args:
        All of them mean what they mean for `compress`, which describes them; so does the goal where neither `snr` nor
        `size` is given.

    Raises:
        HmkctaError: as `compress`.

    >>> import numpy as np
    >>> ramp = np.add.outer(np.arange(32.0), np.arange(24.0))
    >>> found = estimate(ramp, axes="y,x", snr=40, quality="fast")
    >>> found.organisation, found.snr > 35
    ((('y',), ('x',)), True)
    """
    run = _run(quality, decode_cost, seed, threads, progress)
    snr, size = the_goal(snr, size)
    _check_types(array, transform, nan)
    wanted = wanted_of(snr, size, decode_cost, organisation, max_memory)
    with _threads(run.threads), whole_map(array):
        source, run = _prepared(prepare(array, axes, transform, nan, run.threads), run)
        check_least_memory(prod(source.shape), wanted.max_memory, choosing=True)
        found = estimate_model(source, wanted, _goal(source, wanted), quality=quality, run=run)
        _check_steady(source)
    return found


def _prepared(source: Source, run: Run) -> tuple[Source, Run]:
    """The source, and the run that ends early where it turns out not to stay as it was."""
    return source, run if source.steady is None else replace(run, progress=source.steady.told(run.progress))


def _check_steady(source: Source) -> None:
    """Refuse what was made of a source that did not stay as it was: it is of none of its states."""
    if source.steady is not None:
        source.steady.check()


def _goal(source: Source, wanted: Wanted) -> Goal:
    """What is asked for; without a goal a hundredth of the float32 bytes."""
    if wanted.snr is not None:
        return Goal(snr=wanted.snr)
    return Goal(size=wanted.size or max(4 * prod(source.shape) // DEFAULT_RATIO, SMALLEST_DEFAULT))


def _warn_of(model: Model, source: Source, goal: float | None) -> None:
    """Warn, where `compress` was called, of what is not kept, of an SNR below the goal, of one that needs no file, and
    of one that is the offset's alone."""
    for note in source.notes:
        warn(note, stacklevel=3)
    if misses(model.snr, goal):
        said = f"the SNR is {model.snr:.2f} dB, below the {goal:g} dB asked for; the model is the best found"
        warn(said, GoalMissed, stacklevel=3)
    if model.snr <= 0:
        changed = model.metadata.is_transformed
        better = "another transform, or the same with a larger scale" if changed else "ask for more bytes"
        warn(f"an SNR of {model.snr:.1f} dB is no better than zeros alone. Next: {better}", stacklevel=3)
    elif lost := lost_beside_offset(model, source.array):
        warn(lost, stacklevel=3)


@contextmanager
def _threads(count: int) -> Generator[None]:
    """The kernels on as many threads as asked for, and BLAS on one; what BLAS flags as invalid is not warned of.

    Nodes and blocks run in threads already; BLAS threads beside them only fight, and would change sums. The flag says
    nothing: OpenBLAS computes on what lies beside a small matrix, too, and leaves it out. Arrays are looked through for
    NaN and infinity as they are read.
    """
    keep_freed_memory(count)
    with kernels.threads(count), _ONE_BLAS_THREAD, np.errstate(invalid="ignore"):
        yield


class _OneBlasThread:
    """BLAS on one thread while any call is inside: the number is the process's, so the last one out puts it back."""

    def __init__(self) -> None:
        self._lock, self._inside, self._put_back = Lock(), 0, nobody

    def __enter__(self) -> None:
        from threadpoolctl import threadpool_limits  # pyright: ignore[reportMissingTypeStubs] (it has none)

        with self._lock:
            limits = threadpool_limits(limits=1, user_api="blas")  # of this thread alone, where BLAS has one for each
            if not self._inside:
                self._put_back = limits.restore_original_limits
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                _let_any_thread_set_blas(force=True)  # whichever thread set it
                self._put_back()
                _let_any_thread_set_blas(force=False)


def _let_any_thread_set_blas(force: bool) -> None:
    """Clear the one thread that may set how many BLAS uses: all may, up to threadpoolctl 3.7."""
    import threadpoolctl  # pyright: ignore[reportMissingTypeStubs]

    clear = getattr(threadpoolctl.OpenBLASController, "clear_controlling_thread", None)
    if clear is not None:
        clear(force=force)


#: State of a module, as what it keeps is the state of the process.
_ONE_BLAS_THREAD = _OneBlasThread()


def _found(wanted: str | Device) -> Device:
    """The device, or the CPU with a warning."""
    if isinstance(wanted, Device):
        return wanted
    device = kernels.find_device(wanted)
    if device.missing:
        warn(device.fallback, stacklevel=3)  # where `compress` was called
    return device


def _run(quality: str, decode_cost: int, seed: int, threads: int | None, progress: Progress | None) -> Run:
    expect("quality", quality, str, ", ".join(EFFORTS))
    expect("progress", progress, Callable | None, "a function of a stage's name and the fraction done")
    if quality not in EFFORTS:
        raise invalid("unknown-quality", "quality", quality, ", ".join(EFFORTS))
    expect("threads", threads, Integral | None, "a whole number")
    expect("decode_cost", decode_cost, Integral, "a whole number")
    expect("seed", seed, Integral, "a whole number")
    if threads is not None and threads < 1:
        raise invalid("threads", "threads", threads, "1 or more")
    if decode_cost < 1:
        raise invalid("decode-cost", "decode_cost", decode_cost, "1 or more multiply-adds")
    if not 0 <= seed < 2**53:
        raise invalid("seed", "seed", seed, "0 to 2^53 - 1")
    return Run(EFFORTS[quality], int(seed), thread_count(threads), progress or nobody)


def _check_names(scheme: str | None, search: str | None, kind: str | None) -> None:
    if scheme not in (None, *SCHEMES, AUTO):
        raise invalid("unknown-scheme", "scheme", scheme, ", ".join((*SCHEMES, AUTO)))
    if search not in (None, *SEARCHES, AUTO):
        raise invalid("unknown-search", "search", search, ", ".join((*SEARCHES, AUTO)))
    if kind is not None and kind not in KINDS:
        raise invalid("unknown-kind", "kind", kind, ", ".join(KINDS))


def _check_types(array: object, transform: object, nan: object) -> None:
    if isinstance(array, str | bytes | os.PathLike):
        path = repr(os.fsdecode(cast("str | bytes | os.PathLike[str]", array)))
        raise invalid("array-is-path", "array", f"a path, {path}", "an array", f"open it: hmkcta.open_array({path})")
    if isinstance(array, Mapping) or hasattr(array, "array_keys"):  # of h5py, np.load, xarray; of Zarr
        names = [str(name) for name in cast("Iterable[object]", array)]
        found = f"a {type(cast(object, array)).__name__} of {shown(names)}"
        raise invalid("array-is-group", "array", found, "one array of it",
                      'give it by its name, array["NAME"], or by hmkcta.open_array("FILE:/NAME")')
    expect("transform", transform, str | None, 'text such as "log1p:0.5"')
    expect("nan", nan, Real | None, "a number")
