"""`hmkcta view`: the file in the browser, decoded on the GPU."""

from __future__ import annotations

from signal import SIGINT
from typing import Any

import click

from ..hmkfile import is_hmk
from ..serve import serve
from ..support.cut_short import whole_map
from .compared import opened
from .interrupt import Interrupted
from .options import Command, file_argument, nan_option, source_options, verbose_option

EXAMPLES = ("hmkcta view wood.hmk", "hmkcta view wood.hmk --original wood.npy",
            "hmkcta view wood.hmk --no-browser --port 8080")


@click.command("view", cls=Command, examples=EXAMPLES)
@file_argument
@click.option("--original", metavar="SRC", help="Compare with this: the source array, or another .hmk file.")
@source_options
@nan_option
@click.option("--port", type=click.IntRange(0, 65535), default=0, metavar="N",
              help="Port on 127.0.0.1 (default: any that is free).")
@click.option("--no-browser", is_flag=True, help="Print the address, open nothing.")
@verbose_option
def view_command(file: str, original: str | None, nan: float | None, port: int, no_browser: bool, verbose: bool,
                 **source: Any) -> None:
    """Show FILE in the browser, which needs WebGPU. Ctrl-C ends it.

    FILE is served on this computer only, to whoever has the address that is printed. It streams: level 1 first.
    """
    del verbose
    model = original if original is not None and is_hmk(original) else None
    watched = opened("--original", None if model else original, source)
    array = None if watched is None else watched.array
    with whole_map(array), serve(file, original=model or array, nan=nan, port=port) as server:
        try:
            click.echo(f"{server.url}\nCtrl-C ends it.")
            if not no_browser and not server.open_browser():
                click.echo("hmkcta: no browser could be opened; open the address in one.", err=True)
            server.wait()
        except Interrupted as signal:
            if signal.number != SIGINT:
                raise
