"""Hierarchical multiway K-clustered tensor approximation: compress visual data, decode any element on its own."""

from importlib import import_module
from typing import Any

from ._version import __version__
from .axes import Axis
from .encode import choose_plan, compress
from .errors import HmkctaError
from .journal import Journal
from .model import Model, open
from .plan import LevelSpec, Plan, parse_plan

__all__ = [
    "Axis",
    "HmkctaError",
    "Journal",
    "LevelSpec",
    "Model",
    "Plan",
    "__version__",
    "choose_plan",
    "compress",
    "open",
    "parse_plan",
]


def __getattr__(name: str) -> Any:
    """`hmkcta.render` and `hmkcta.serve` are loaded when they are first used."""
    if name in ("render", "serve"):
        return import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
