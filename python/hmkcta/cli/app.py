"""The `hmkcta` command: its commands, and one sentence with a documented exit code for every way to fail."""

from __future__ import annotations

import errno
import os
import signal
import sys
import traceback
from collections.abc import Generator
from contextlib import contextmanager
from types import FrameType
from typing import Any

import click

from ..errors import HmkctaError
from .compress import compress_command
from .decompress import decompress_command
from .demo import demo_command
from .failure import EXIT_CODES, Exit, Failure
from .info import info_command
from .options import CONTEXT, VERBOSE, examples_first
from .plan import plan_command
from .verify import verify_command
from .versions import version_option

EXAMPLES = (
    "hmkcta plan wood.npy --snr 27",
    "hmkcta compress wood.npy -o wood.hmk --snr 27",
    "hmkcta info wood.hmk",
)


STOPPING = b"hmkcta: stopping as soon as the part at hand is done; once more to stop at once.\n"


class Hmkcta(click.Group):
    """The group of all commands; turns exceptions into sentences and exit codes."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command that was asked for."""
        try:
            with _interruptible():
                return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort):
            raise
        except HmkctaError as error:
            raise Failure(str(error), error.kind.exit_code, error) from error
        except KeyboardInterrupt:
            raise Failure("interrupted; nothing is left half written.", Exit.INTERRUPTED) from None
        except MemoryError as error:
            raise Failure("the memory ran out. Next: give --max-memory, a smaller part, or a coarser plan.",
                          Exit.RESOURCE) from error
        except Exception as error:
            raise _unforeseen(error, bool(ctx.meta.get(VERBOSE))) from error

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Examples, usage, commands, exit codes."""
        examples_first(formatter, EXAMPLES)
        super().format_help(ctx, formatter)

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The exit codes."""
        del ctx
        with formatter.section("Exit codes"):
            formatter.write_dl([(str(code), meaning) for code, meaning in EXIT_CODES.items()])


@click.group(cls=Hmkcta, context_settings=CONTEXT)
@version_option
def main() -> None:
    """Compress visual data so that any element can be decoded on its own."""


for _command in (compress_command, plan_command, info_command, verify_command, decompress_command, demo_command):
    main.add_command(_command)


@contextmanager
def _interruptible() -> Generator[None]:
    """Ctrl-C, and a scheduler's SIGTERM, clean up and end; the second one ends at once.

    Native code finishes the part it is at before the first one takes effect.
    """
    def stop(number: int, frame: FrameType | None) -> None:
        for each in before:
            signal.signal(each, _end)
        os.write(2, STOPPING)  # not click.echo: the signal may have come in the middle of one
        raise KeyboardInterrupt(number, frame)

    before: dict[signal.Signals, Any] = {}
    try:
        for each in (signal.SIGINT, signal.SIGTERM):
            before[each] = signal.signal(each, stop)
    except ValueError:  # not in the main thread, where nobody can set it
        pass
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


def _end(number: int, frame: FrameType | None) -> None:
    """No clean-up: at worst a temporary file stays behind, whose name begins with a dot and ends with .tmp."""
    del number, frame
    os._exit(Exit.INTERRUPTED)


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
