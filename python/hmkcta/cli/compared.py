"""The array that `verify`, `render` and `view` compare a file with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click

from ..readers import WatchedSource
from .progress import Progress


def opened(option: str, uri: str | None, source: Mapping[str, Any], quiet: bool = False) -> WatchedSource | None:
    """What an option names, as the values of `source_options` describe it; None where it names nothing.

    Raises:
        click.UsageError: there is a description, and nothing that it is of.
        HmkctaError: what `open_array` raises.
    """
    if uri is not None:
        with Progress(quiet) as progress:
            return WatchedSource(uri, **source, progress=progress)
    defaults = {param.name: param.default for param in click.get_current_context().command.params}
    given = [f"--{name}" for name, value in source.items() if value not in (None, defaults[name])]
    if given:
        raise click.UsageError(f"{given[0]} says how an array is read, and {option} names none.")
    return None
