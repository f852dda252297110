"""Hierarchical multiway K-clustered tensor approximation: compress visual data, decode any element on its own.

`compress` makes a `Model` of an array, `Model.save` and `open` write and read its file, and indexing the model decodes.
`parse_plan` reads a written `Plan`. What goes wrong is an `HmkctaError`, and an SNR that is out of reach the
warning `GoalMissed`. Axes, levels and modes are named as in the paper: `docs/notation.md`.

>>> import hmkcta
>>> light_field = hmkcta.synthetic.light_field(views=2, size=8, frames=1)
>>> model = hmkcta.compress(light_field.values, "R=2,2,8,8,1", axes=light_field.axes)
>>> model.shape, model[0, 1, 3, 5, 0].dtype, model.decode_cost
((2, 2, 8, 8, 1), dtype('float32'), 256)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from ._version import __version__

if TYPE_CHECKING:
    from .axes import Axis
    from .encode import compress, estimate
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
    "compress",
    "estimate",
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
    "compress": "encode",
    "estimate": "encode",
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
