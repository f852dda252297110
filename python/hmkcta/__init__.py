"""Hierarchical multiway K-clustered tensor approximation: compress visual data, decode any element on its own."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._version import __version__

if TYPE_CHECKING:
    from .axes import Axis
    from .encode import choose_plan, compress
    from .errors import GoalMissed, HmkctaError
    from .hmkfile import Limits
    from .journal import Journal
    from .model import Model, open
    from .plan import LevelSpec, Plan, parse_plan
    from .readers import open_array

__all__ = [
    "Axis",
    "GoalMissed",
    "HmkctaError",
    "Journal",
    "LevelSpec",
    "Limits",
    "Model",
    "Plan",
    "__version__",
    "choose_plan",
    "compress",
    "open",
    "open_array",
    "parse_plan",
]

#: Public names by their modules, loaded when they are first used: whoever decodes does not wait for what fits, and the
#: command line is ready for Ctrl-C before NumPy is loaded.
_MODULES = {
    "Axis": "axes",
    "GoalMissed": "errors",
    "HmkctaError": "errors",
    "Journal": "journal",
    "LevelSpec": "plan",
    "Limits": "hmkfile",
    "Model": "model",
    "Plan": "plan",
    "choose_plan": "encode",
    "compress": "encode",
    "open": "model",
    "open_array": "readers",
    "parse_plan": "plan",
}
#: Modules that need no import of their own.
_SUBMODULES = ("axes", "backends", "errors", "model", "plan", "render", "serve", "synthetic")


def __dir__() -> list[str]:
    return sorted({*__all__, *_SUBMODULES, *(name for name in globals() if name.startswith("__"))})


def __getattr__(name: str) -> Any:
    """Public names and modules, loaded when they are first used."""
    if name in _SUBMODULES:
        return import_module(f".{name}", __name__)
    if name in _MODULES:
        return getattr(import_module(f".{_MODULES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
