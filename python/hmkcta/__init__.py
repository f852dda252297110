"""Hierarchical multiway K-clustered tensor approximation: compress visual data, decode any element on its own."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._version import __version__
from .axes import Axis
from .errors import HmkctaError
from .model import Model, open
from .plan import LevelSpec, Plan, parse_plan

if TYPE_CHECKING:
    from .encode import choose_plan, compress
    from .journal import Journal

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


#: What only fitting needs, by its module: whoever decodes does not wait for it.
_FITTING = {"choose_plan": "encode", "compress": "encode", "Journal": "journal"}


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> Any:
    """`hmkcta.render`, `hmkcta.serve` and what fits are loaded when they are first used."""
    if name in ("render", "serve"):
        return import_module(f".{name}", __name__)
    if name in _FITTING:
        return getattr(import_module(f".{_FITTING[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
