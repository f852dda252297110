"""How commands end: documented exit codes, and one sentence on stderr for whatever went wrong."""

from __future__ import annotations

import re
from contextlib import suppress
from enum import IntEnum
from typing import IO, Any

import click

from ..errors import HmkctaError
from .output import JSON, emit


class Exit(IntEnum):
    """Exit codes that are not a `Kind`'s, or are needed without one."""

    UNEXPECTED = 1
    IO = 3
    RESOURCE = 6
    TARGET_MISSED = 7


EXIT_CODES = {
    0: "done",
    1: "unexpected failure",
    2: "wrong usage or argument",
    3: "input unreadable or no .hmk file, or output cannot be written",
    4: "corrupt file",
    5: "version or value transform of the file is not known",
    6: "resource limit",
    7: "target not reached: the file is written, and is the best found",
    8: "the source changed while it was read: nothing is written",
    9: "verify --against: the source is not the array the file was made from",
    130: "interrupted (143: by SIGTERM); what is finished is kept for --resume",
}


def by_options(sentence: str) -> str:
    """A sentence that names an option only, where it names the argument of a function, too.

    >>> by_options("replace it by overwrite=True or --overwrite, or allow more with max_memory or --max-memory")
    'replace it by --overwrite, or allow more with --max-memory'
    """
    return re.sub(r"\b([a-z_]+)(?:=True)? or (--[a-z-]+)",
                  lambda found: found[2] if found[2][2:].replace("-", "_") == found[1] else found[0], sentence)


class Failure(click.ClickException):
    """Ends the program with a sentence on stderr, an exit code, and with --json an object on stdout."""

    def __init__(self, sentence: str, exit_code: int, cause: HmkctaError | None = None) -> None:
        super().__init__(sentence)
        # Click declares it for the class, and reads the instance's.
        self.exit_code = int(exit_code)  # pyright: ignore[reportAttributeAccessIssue]
        self.cause = cause
        context = click.get_current_context(silent=True)
        self.as_json = bool(context and context.meta.get(JSON))

    def show(self, file: IO[Any] | None = None) -> None:
        """Write the sentence."""
        del file
        with suppress(OSError):  # nobody listens any more
            self._say()

    def _say(self) -> None:
        click.echo(f"hmkcta: {self.message}", err=True)
        if self.as_json:
            report: dict[str, Any] = {"sentence": self.message, "exit_code": self.exit_code}
            if self.cause is not None:
                report |= {"kind": self.cause.kind.label, "reason": self.cause.reason, "where": self.cause.where}
            emit({"error": report})
