"""The one JSON text that the writer makes of a value."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import cast


def _as_dict(value: object) -> object:
    """A mapping that is no dict as one, for JSON; nothing else is taken for an object."""
    if isinstance(value, Mapping):
        return dict(cast("Mapping[str, object]", value))
    raise TypeError(f"Object of type {type(value).__name__} is not JSON serializable")


_ENCODE = json.JSONEncoder(ensure_ascii=False, allow_nan=False, separators=(",", ":"), default=_as_dict).encode


def format_json(value: object) -> str:
    """A compact JSON text, keys in the given order, UTF-8 unescaped, numbers in the fewest digits.

    >>> format_json({"unit": "µm", "R": [1, 2], "rmse": 0.5})
    '{"unit":"µm","R":[1,2],"rmse":0.5}'
    """
    return _ENCODE(value)
