"""Options that several commands share, and the texts they read: sizes, shapes, names, fill values."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from math import inf
from typing import Any, TypeVar

import click

from ..errors import HmkctaError, invalid
from ..goals import BYTES_ALLOWED, TIME_ALLOWED, read_bytes, time_given
from .output import JSON
from .param_type import ParamType

#: Key of `click.Context.meta` that is true with -v.
VERBOSE = "hmkcta.verbose"
#: Key of `click.Context.meta` under which the words stand that a command was given.
WORDS = "hmkcta.words"
CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 110}

Function = TypeVar("Function", bound=Callable[..., Any])


class ByteSize(ParamType[int]):
    """Bytes, with or without a unit.

    >>> ByteSize().convert("20MiB", None, None), ByteSize().convert("1.5 kB", None, None)
    (20971520, 1500)
    """

    name = "size"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Read it, or end with what is wrong."""
        if isinstance(value, int):
            return value
        number = read_bytes(str(value))
        if number is None:
            self.fail(f"{value!r} is no size: write {BYTES_ALLOWED}.", param, ctx)
        if not 1 <= number < inf:
            self.fail(f"a size is 1 byte or more, and not {number:g}.", param, ctx)
        return round(number)


class Duration(ParamType[float]):
    """Seconds, with or without a unit.

    >>> Duration().convert("2min", None, None)
    120.0
    """

    name = "time"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Read it, or end with what is wrong."""
        try:
            found = time_given(str(value))
        except HmkctaError:
            found = None
        if found is None:
            self.fail(f"{value!r} is no time: write {TIME_ALLOWED}.", param, ctx)
        return found


class File(click.Path):
    """A path; an empty one would be the folder at hand.

    >>> File().convert("wood.npy", None, None)
    'wood.npy'
    """

    name = "path"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Take it, or end with what is wrong."""
        if value in ("", b""):
            self.fail("the path is empty.", param, ctx)
        return super().convert(value, param, ctx)


class OutputFile(File):
    """A file to write; standard output cannot take the place of one, as files get their name when they are complete."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Take it, or end with what is wrong."""
        if value in ("-", "/dev/stdout"):
            self.fail("output goes to a file, not to standard output (a file of that name: ./-).", param, ctx)
        return super().convert(value, param, ctx)


class Shape(ParamType[tuple[int, ...]]):
    """Sizes parted by commas or x.

    >>> Shape().convert("64,64,3", None, None)
    (64, 64, 3)
    """

    name = "shape"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        """Read it, or end with what is wrong."""
        words = re.split(r"[,x]", str(value).replace(" ", ""))
        if not all(word.isascii() and word.isdigit() and len(word) < 20 for word in words):
            self.fail(f"{value!r} is no shape: write whole numbers parted by commas, e.g. 64,64,3.", param, ctx)
        return tuple(int(word) for word in words)


class Names(ParamType[list[str]]):
    """Names parted by commas.

    >>> Names().convert("light, view,y,x", None, None)
    ['light', 'view', 'y', 'x']
    """

    name = "names"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> list[str]:
        """Read it."""
        del param, ctx
        return [word.strip() for word in str(value).split(",")]


class Assignment(ParamType[tuple[str, str]]):
    """A name and what it gets: ``NAME=VALUE``.

    >>> Assignment().convert("light=directions.npy", None, None)
    ('light', 'directions.npy')
    """

    name = "assignment"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, str]:
        """Read it, or end with what is wrong."""
        name, _, given = str(value).partition("=")
        if not name.strip() or not given:
            self.fail(f"{value!r}: write the name of an axis, =, and what belongs to it.", param, ctx)
        return name.strip(), given


class Fill(ParamType[float]):
    """What to do with NaN and infinity: ``fill=VALUE``.

    >>> Fill().convert("fill=-1", None, None)
    -1.0
    """

    name = "fill=VALUE"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Read it, or end with what is wrong."""
        word, equals, number = str(value).partition("=")
        try:
            if word != "fill" or not equals:
                raise ValueError
            filling = float(number)
            if filling - filling != 0:  # NaN or infinity again
                raise ValueError
        except ValueError:
            self.fail(f"{value!r}: write fill=VALUE with a finite number, e.g. fill=0.", param, ctx)
        return filling


class Count(click.types.IntParamType):
    """A whole number from `least` up, which help does not say again for each option.

    >>> Count(1).convert("7", None, None)
    7
    """

    def __init__(self, least: int) -> None:
        super().__init__()
        self.least = least

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Read it, or end with what is wrong."""
        number = super().convert(value, param, ctx)
        if number < self.least:
            self.fail(f"{number} is too small: {self.least} or more.", param, ctx)
        return number


class ExamplesFirst(click.Command):
    """A command or a group whose help opens with examples to copy."""

    examples: Sequence[str] = ()

    def format_help(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Examples, then what click writes."""
        with formatter.section("Examples"):
            for example in self.examples:
                formatter.write(f"{'':>{formatter.current_indent}}{example}\n")
        formatter.write_paragraph()
        super().format_help(ctx, formatter)


class Command(ExamplesFirst):
    """A command that keeps the words it was given."""

    def __init__(self, *args: Any, examples: Sequence[str] = (), **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.examples = examples

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Note the words, then read them."""
        ctx.meta[WORDS] = list(args)
        return super().parse_args(ctx, args)


def together(*options: Callable[[Any], Any]) -> Callable[[Function], Function]:
    """Several options as one decorator; they come in help in the order given."""
    def decorate(function: Function) -> Function:
        for option in reversed(options):
            function = option(function)
        return function

    return decorate


def _remember(key: str) -> Callable[[click.Context, click.Parameter, Any], Any]:
    """A callback that puts an option's value where whatever ends the program finds it."""
    def callback(ctx: click.Context, parameter: click.Parameter, value: Any) -> Any:
        del parameter
        ctx.meta[key] = value
        return value

    return callback


#: Names of what `source_options` give, which are arguments of `open_array`.
SOURCE = ("member", "shape", "dtype", "order", "offset", "views", "names")
source_options = together(
    click.option("--member", metavar="NAME", help="One of several arrays; or FILE.h5:NAME."),
    click.option("--shape", type=Shape(), metavar="N,N,..", help="Shape of raw binary."),
    click.option("--dtype", metavar="TYPE", help="Numbers of raw binary: float32, uint8, >f4, .."),
    click.option("--order", type=click.Choice(["C", "F"]), default="C", metavar="C|F",
                 help="Raw: last axis fastest, or first (default C)."),
    click.option("--offset", type=Count(0), default=0, metavar="BYTES",
                 help="Bytes before raw binary (default 0)."),
    click.option("--views", metavar="NxN", help="Views of a light field: 17x17, 14x14:lenslets."),
    click.option("--names", metavar="TEXT", help="Grid by file names: 'out_{row}_{column}_*'."),
)
json_option = click.option("--json", "as_json", is_flag=True, is_eager=True, callback=_remember(JSON),
                           help="One JSON object on stdout; messages on stderr.")
quiet_option = click.option("--quiet", is_flag=True, help="No progress, no report.")
verbose_option = click.option("-v", "--verbose", is_flag=True, is_eager=True, callback=_remember(VERBOSE),
                              help="More about the work; tracebacks.")
memory_option = click.option("--max-memory", type=ByteSize(), metavar="SIZE",
                             help="Memory to work in; what needs more is refused.")
device_option = click.option("--device", type=click.Choice(("cpu", "cuda")), default="cpu", metavar="NAME",
                             help="cpu, or cuda for an NVIDIA GPU (default cpu).")
overwrite_option = click.option("--overwrite", is_flag=True, help="Replace an output that is there already.")
nan_option = click.option("--nan", type=Fill(), metavar="fill=VALUE",
                          help="Replace NaN and infinity, which are refused otherwise.")
file_argument = click.argument("file", type=File())


def apart(source: str, output: str) -> None:
    """Refuse an output that would replace its own input.

    Raises:
        HmkctaError: reason ``output-is-input``.
    """
    from ..readers import source_files

    for path in source_files(source):
        with suppress(OSError, ValueError):
            if os.path.samefile(path, output):
                raise invalid("output-is-input", "output", repr(output), "another file than the input")
