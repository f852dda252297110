"""`hmkcta --version`: what to paste into a report of a problem."""

from __future__ import annotations

import platform

import click

from .._version import __version__

LIBRARIES = ("numpy", "click", "rich", "pillow", "wgpu", "cupy-cuda12x")


def versions() -> str:
    """Versions of hmkcta, Python and the libraries, and the machine."""
    from ..hmkfile import VERSION

    lines = [f"hmkcta {__version__}", f"python {platform.python_version()} ({platform.python_implementation()})"]
    lines += [f"{name} {_version(name)}" for name in LIBRARIES]
    return "\n".join([*lines, f"file format {VERSION}", platform.platform()])


def _version(name: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _show(ctx: click.Context, parameter: click.Parameter, value: bool) -> None:
    del parameter
    if value and not ctx.resilient_parsing:
        click.echo(versions())
        ctx.exit()


version_option = click.option("--version", is_flag=True, is_eager=True, expose_value=False, callback=_show,
                              help="Print the versions of hmkcta and its libraries.")
