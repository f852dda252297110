"""The `hmkcta` command: its commands, and one sentence with a documented exit code for every way to fail."""

from __future__ import annotations

import errno
import os
import re
import signal
import sys
import traceback
from collections.abc import Iterator, Mapping
from functools import partial
from importlib import import_module
from typing import Any, cast

import click

from ..errors import ForeignFile, HmkctaError, Kind
from ..support.temporaries import remove_all
from .failure import EXIT_CODES, Exit, Failure, by_options
from .interrupt import Interrupted, interruptible
from .options import CONTEXT, VERBOSE, WORDS, ExamplesFirst
from .output import emit
from .resume import abandon, going_on, nothing_kept
from .versions import version_option

EXAMPLES = (
    "hmkcta plan wood.npy --snr 27",
    "hmkcta compress wood.npy -o wood.hmk --snr 27",
    "hmkcta info wood.hmk",
)
#: What each command does, in the order in which they are used.
SUMMARIES = {
    "compress": "Compress an array, volume or stack of pictures into a file.",
    "plan": "Show what compress would do, and what it would take.",
    "info": "Show axes, levels, quality and sizes of a file.",
    "verify": "Check a file, also against its source.",
    "decompress": "Decode a file into an array.",
    "view": "Show a file in the browser.",
    "render": "Make pictures and films of a file.",
    "bench": "Measure how fast this machine is.",
    "demo": "Compress synthetic data, with pictures.",
}


class Commands(Mapping[str, click.Command]):
    """The commands by name, each loaded when it is asked for: not every one has to wait for what the others need."""

    def __getitem__(self, name: str) -> click.Command:
        if name not in SUMMARIES:
            raise KeyError(name)
        return getattr(import_module(f".{name}", __package__), f"{name}_command")

    def __iter__(self) -> Iterator[str]:
        return iter(SUMMARIES)

    def __len__(self) -> int:
        return len(SUMMARIES)


class Hmkcta(ExamplesFirst, click.Group):
    """The group of all commands; turns exceptions into sentences and exit codes."""

    examples = EXAMPLES

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = cast("dict[str, click.Command]", Commands())  # click only reads it

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Their names, in the order in which they are used."""
        del ctx
        return list(self.commands)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """What each does, without loading it."""
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl(list(SUMMARIES.items()))

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command that was asked for."""
        try:
            with interruptible(partial(_leave, ctx)):
                return super().invoke(ctx)
        except click.UsageError as error:
            if "--json" in ctx.meta.get(WORDS, ()):
                emit({"error": {"sentence": error.format_message(), "exit_code": error.exit_code}})
            raise
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except HmkctaError as error:
            if isinstance(error, ForeignFile):
                raise Failure(str(error), Exit.IO, error) from error
            kept = going_on(ctx, then=bool(error.hint)) if may_go_on(ctx, error) else ""
            said = by_options(str(error).replace(f"Next: {error.hint}.", f"Next: {_possible(ctx, error)}."))
            raise Failure(f"{said} {kept}".rstrip(), error.kind.exit_code, error) from error
        except KeyboardInterrupt as error:
            raise _interruption(ctx, error.number if isinstance(error, Interrupted) else signal.SIGINT) from None
        except MemoryError as error:
            ran_out = HmkctaError(Kind.RESOURCE_LIMIT, "memory", "the memory", told="ran out", hint=_less_memory(ctx))
            kept = going_on(ctx, then=True)
            raise Failure(f"{ran_out} {kept}".rstrip(), Exit.RESOURCE, ran_out) from error
        except Exception as error:
            raise _unforeseen(error, bool(ctx.meta.get(VERBOSE))) from error

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The exit codes."""
        del ctx
        with formatter.section("Exit codes"):
            formatter.write_dl([(str(code), meaning) for code, meaning in EXIT_CODES.items()])


@click.group(cls=Hmkcta, context_settings=CONTEXT)
@version_option
def main() -> None:
    """Compress visual data so that any element can be decoded on its own."""


def _options(ctx: click.Context) -> set[str]:
    """The options of the command that runs."""
    command = main.get_command(ctx, ctx.invoked_subcommand or "")
    return {name for param in command.params for name in param.opts} if command is not None else set()


def _possible(ctx: click.Context, error: HmkctaError) -> str:
    """The advice of an error, but one about memory that the command cannot follow: that is for who calls functions."""
    followed = set(re.findall(r"--[a-z-]+", error.hint)) <= _options(ctx)
    of_functions = re.search(r"numpy|\bindex\b|\bpositions\b|=", error.hint)
    return error.hint if error.reason != "memory" or (followed and not of_functions) else _less_memory(ctx)


def _less_memory(ctx: click.Context) -> str:
    """How the command that runs can do with less memory."""
    ways = {"--plan": "a coarser --plan", "--max-memory": "a lower --max-memory", "--width": "a smaller --width and "
            "--height", "--level": "a lower --level"}
    held = _options(ctx)
    possible = ", ".join(way for option, way in ways.items() if option in held)
    return f"give {possible}, or close what else takes memory" if possible else (
        "close what else takes memory, or take a machine that has more")


def may_go_on(ctx: click.Context, error: HmkctaError) -> bool:
    """Whether the same command with --resume can end otherwise."""
    if error.kind is Kind.RESOURCE_LIMIT:  # with the same --max-memory it ends the same
        return not any(str(word).startswith("--max-memory") for word in ctx.meta.get(WORDS, ()))
    return error.kind is Kind.IO and error.reason != "partial-busy"


def _interruption(ctx: click.Context, number: int) -> Failure:
    name = "interrupted" if number == signal.SIGINT else f"interrupted by {signal.Signals(number).name}"
    after = going_on(ctx)
    return Failure(f"{name}. {after}" if after else f"{name}; {nothing_kept(ctx)}.", 128 + number)


def _leave(ctx: click.Context, number: int) -> None:
    """The last words of a program that cannot wait for what native code is at; it is ended after them."""
    remove_all()
    abandon(ctx)
    if sys.stderr.isatty():
        os.write(2, b"\x1b[2K\r\x1b[?25h")  # the progress bar away, the cursor back
    with ctx.scope(cleanup=False):
        _interruption(ctx, number).show()


def _unforeseen(error: Exception, verbose: bool) -> Exception:
    """The error to end with for one that hmkcta does not foresee."""
    if isinstance(error, OSError):
        if error.errno == errno.EPIPE:  # the reader of our output has gone; click ends quietly
            return error
        return Failure(f"{error.filename or 'input or output'}: {error.strerror or error}.", Exit.IO)
    if verbose:
        traceback.print_exception(error, file=sys.stderr)
    advice = "please report it with what hmkcta --version prints" if verbose else "run with -v for the traceback"
    first = next(iter(str(error).splitlines()), "").rstrip(".")
    return Failure(f"unexpected {type(error).__name__}: {first}. Next: {advice}.", Exit.UNEXPECTED)
