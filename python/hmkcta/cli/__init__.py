"""The command line. A file for each command, loaded when the command is called."""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .app import main

__all__ = ["main"]


def __getattr__(name: str) -> Any:
    """`main`, loaded when it is asked for. That takes a moment, in which Ctrl-C ends the program quietly too."""
    if name != "main":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return import_module(".app", __name__).main
    except KeyboardInterrupt:
        sys.stderr.write("hmkcta: interrupted; nothing is left half written.\n")
        raise SystemExit(130) from None
