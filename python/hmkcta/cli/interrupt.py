"""Ctrl-C, a scheduler's SIGTERM and a closed terminal end the program in a second, whatever it is at."""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from time import monotonic
from types import FrameType
from typing import Any

#: Seconds to clean up in. Native code cannot be interrupted and may take minutes.
GRACE = 1.0
#: Seconds within which a signal after the first is the same one: `timeout` and other wrappers send it twice, to their
#: child and to its group.
ECHO = 0.25


class Patience:
    """What the first Ctrl-C asks for, while somebody would rather finish early than end."""

    def __init__(self, told: Callable[[], None], begun: Callable[[], bool]) -> None:
        self.asked = False
        self._told, self._begun = told, begun
        self._first: dict[str, float] = {}

    def bears(self, number: int, who: str) -> bool:
        """Whether a signal is the first Ctrl-C, or an echo of it, for one of those who hear it."""
        if number != signal.SIGINT or not (self._first or self._begun()):
            return False
        first = self._first.setdefault(who, monotonic())
        return monotonic() - first <= ECHO

    def ask(self) -> None:
        """Note the wish."""
        if not self.asked:
            self.asked = True
            self._told()


#: Who is patient now, at most one; state of the process, as signals are.
_patient: list[Patience] = []


@contextmanager
def patient(told: Callable[[], None], begun: Callable[[], bool]) -> Generator[Patience]:
    """Take the first Ctrl-C as a wish to finish early, which `asked` says; the second ends as ever.

    Args:
        told: called when the wish comes.
        begun: whether there is anything yet to finish early; else the first Ctrl-C ends.
    """
    patience = Patience(told, begun)
    _patient.append(patience)
    try:
        yield patience
    finally:
        _patient.remove(patience)


class Interrupted(KeyboardInterrupt):
    """A signal asked the program to end."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@contextmanager
def interruptible(farewell: Callable[[int], None]) -> Generator[None]:
    """Raise `Interrupted` in the main thread when a signal comes; end the process if that takes too long.

    Python sees a signal only between two of its own instructions, so a thread listens for them as well.

    Args:
        farewell: says why the process ends; called with the signal's number, from that thread, and only if the main
            thread has not left the block after `GRACE` seconds. A second signal, unless it is an echo of the first,
            ends the process without it.
    """
    if threading.current_thread() is not threading.main_thread():  # only that one can set handlers
        yield
        return
    before: dict[int, Any] = {each: signal.getsignal(each) for each in _handled()}
    heard, told = socket.socketpair()
    told.setblocking(False)
    listener = threading.Thread(target=_listen, args=(heard, before.keys(), farewell), daemon=True)
    former = signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False)
    for each in before:
        signal.signal(each, _stop)
    listener.start()
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
        signal.set_wakeup_fd(former)
        told.close()  # which the listener hears as the end
        listener.join()
        heard.close()


def _stop(number: int, frame: FrameType | None) -> None:
    del frame
    if _patient and _patient[-1].bears(number, "main"):
        _patient[-1].ask()
        return
    for each in _handled():  # the next one is for the listener, and must not disturb the cleaning up
        signal.signal(each, _again)
    raise Interrupted(number)


def _again(number: int, frame: FrameType | None) -> None:
    """Nothing, from Python: the listener ends the process."""


def _handled() -> list[signal.Signals]:
    """What is ignored stays so: nohup, and a script's background jobs."""
    wanted = [signal.Signals[name] for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    return [each for each in wanted if signal.getsignal(each) is not signal.SIG_IGN]


def _listen(heard: socket.socket, numbers: Any, farewell: Callable[[int], None]) -> None:
    number = 0
    while number not in numbers:  # other signals are heard as well
        byte = heard.recv(1)
        if not byte:
            return
        number = 0 if _patient and _patient[-1].bears(byte[0], "listener") else byte[0]
    began = monotonic()
    while (passed := monotonic() - began) < GRACE:
        heard.settimeout(GRACE - passed)
        try:
            if not heard.recv(1):
                return
        except TimeoutError:
            break
        if monotonic() - began > ECHO:
            os._exit(128 + number)
    farewell(number)
    os._exit(128 + number)
