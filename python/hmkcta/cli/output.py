"""What commands print: plain tables for people, one JSON object for programs."""

from __future__ import annotations

import json
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from math import isfinite
from typing import TYPE_CHECKING, Any, cast
from warnings import catch_warnings, simplefilter

import click

from ..errors import GoalMissed

if TYPE_CHECKING:
    from ..packed import PackedLevel

#: Key of `click.Context.meta` that is true with --json.
JSON = "hmkcta.json"


def emit(report: Mapping[str, Any]) -> None:
    """One JSON object on stdout; numbers that JSON cannot hold become null."""
    click.echo(json.dumps(_plain(report), indent=2))


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in cast("Mapping[object, Any]", value).items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in cast("Sequence[Any]", value)]
    return None if isinstance(value, float) and not isfinite(value) else value


@contextmanager
def warnings_as_notes() -> Generator[list[str]]:
    """The sentences that `compress` warns with inside, once it is left; not of a goal that is missed, which commands
    say with what to do next, and not what NumPy makes of flags."""
    said: list[str] = []
    with catch_warnings(record=True) as warned:
        simplefilter("ignore")
        simplefilter("always", UserWarning)
        simplefilter("ignore", GoalMissed)
        yield said
    said += [str(each.message) for each in warned]


def number_bits(level: PackedLevel, size: int) -> float:
    """Bits of a core or basis number in the file; on average, where the level's `size` bytes are a code.

    >>> from hmkcta._example import example_level
    >>> number_bits(example_level(), 100)
    16
    """
    return 8 * size / level.numbers() if level.step is not None and level.numbers() else 16


def shown_bits(bits: float) -> str:
    """Bits of a number, for people.

    >>> shown_bits(16), shown_bits(5.26)
    ('16', '5.3')
    """
    return str(bits) if isinstance(bits, int) else f"{bits:.1f}"


def table(header: Sequence[str], rows: Sequence[Sequence[str]], indent: str = "", left: Sequence[int] = ()) -> str:
    """Aligned columns: numbers to the right; names in the first column, and the columns `left`, to the left.

    >>> for line in table(["level", "SNR dB"], [["1", "7.31"], ["2", "16.26"]]).splitlines():
    ...     line
    'level  SNR dB'
    '    1    7.31'
    '    2   16.26'
    >>> table(["data", "n"], [["wood", "1"]])
    'data  n\\nwood  1'
    """
    grid = [list(header), *(list(row) for row in rows)]
    widths = [max(len(row[n]) for row in grid) for n in range(len(header))]
    named = {0} if not all(row[0][:1].isdigit() for row in grid[1:]) else set[int]()
    lines = ["  ".join(cell.ljust(width) if n in named.union(left) else cell.rjust(width)
                       for n, (cell, width) in enumerate(zip(row, widths, strict=True))) for row in grid]
    return "\n".join((indent + line).rstrip() for line in lines)


def decibels(snr: float) -> str:
    """An SNR for people.

    >>> decibels(27.041), decibels(float("inf"))
    ('27.04', 'exact')
    """
    return f"{snr:.2f}" if isfinite(snr) else "exact" if snr > 0 else "none"


def transformed_column(transform: str, levels: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """The column of the SNR of transformed values: its header, and its cell of each level; empty if no level has one.

    >>> transformed_column("log1p", [{"transformed_snr_db": 27.041}, {"transformed_snr_db": None}])
    (['SNR of log1p'], [['27.04'], ['unknown']])
    >>> transformed_column("identity", [{"transformed_snr_db": None}])
    ([], [[]])
    """
    told = [level["transformed_snr_db"] for level in levels]
    if not any(told):
        return [], [[] for _ in told]
    return [f"SNR of {transform}"], [["unknown" if snr is None else decibels(snr)] for snr in told]


def mebibytes(count: int) -> str:
    """Bytes in MiB for tables, with the digits that small files need.

    >>> mebibytes(23_373_000), mebibytes(4096)
    ('22.29', '0.0039')
    """
    size = count / 2**20
    return f"{size:.2f}" if size >= 1 else f"{size:.2g}" if size < 0.01 else f"{size:.3f}"


def ratio(times: float) -> str:
    """How many times smaller than the source, with the digits that a file larger than its source needs.

    >>> ratio(304.52), ratio(0.026)
    ('304.5', '0.026')
    """
    return f"{times:.1f}" if times >= 1 else f"{times:.2g}"


def share(times: float) -> str:
    """How large something is that is `times` times smaller than another.

    >>> share(16.04), share(0.4)
    ('1/16.0 of', '2.5 times')
    """
    return f"1/{times:.1f} of" if times >= 1 else f"{1 / times:.1f} times"


def seconds(time: float) -> str:
    """A duration for people.

    >>> seconds(3.14), seconds(75), seconds(7322)
    ('3.1 s', '1 min 15 s', '2 h 02 min')
    """
    if time < 59.95:
        return f"{time:.1f} s"
    minutes, rest = divmod(round(time), 60)
    return f"{minutes} min {rest:02d} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"
