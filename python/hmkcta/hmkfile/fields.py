"""Strict reading of JSON: the text, and the type and range of each field. Standard library only.

JSON to JSON: nothing is rounded, clamped, defaulted or ignored.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Collection, Iterable
from typing import TypeAlias, cast

from .limits import Limits, check_limit
from .reasons import fault

Json: TypeAlias = "bool | int | float | str | list[Json] | dict[str, Json] | None"

#: Whole numbers that JavaScript holds exactly.
SAFE_INTEGER = 2**53 - 1

_TEXT = re.compile(r'"(?:[^"\\]|\\.)*"')
_SURROGATE = re.compile("[\ud800-\udfff]")


def parse_json(text: str, where: str, limits: Limits) -> Json:
    """Parse a JSON text: no white space outside strings, no key twice, no NaN, no whole number beyond 2^53 - 1.

    >>> parse_json('{"a":[1,2.5,null]}', "example", Limits())
    {'a': [1, 2.5, None]}
    """
    def pairs(items: list[tuple[str, Json]]) -> dict[str, Json]:
        result = dict(items)
        if len(result) != len(items):
            raise fault("json-duplicate-key", where, repr(_first_twice(key for key, _ in items)), "each key once")
        return result

    def whole(digits: str) -> int:
        if len(digits) > 15 and abs(float(digits)) > SAFE_INTEGER:
            raise fault("json-number", where, digits[:40], "whole numbers up to 2^53 - 1")
        return int(digits)

    def number(digits: str) -> float:
        if not math.isfinite(float(digits)):
            raise fault("json-number", where, digits[:40], "finite numbers")
        return float(digits)

    if " " in _TEXT.sub("", text):
        raise fault("json-syntax", where, "white space outside strings", "none")
    try:
        return cast("Json", json.loads(text, object_pairs_hook=pairs, parse_int=whole, parse_float=number,
                                       parse_constant=number))
    except json.JSONDecodeError as error:
        raise fault("json-syntax", where, f"{error.msg} at character {error.pos}", "JSON") from error
    except RecursionError as error:  # the parser gives up somewhere beyond any depth that makes sense
        raise fault("json-depth", where, "more than the parser's depth", f"at most {limits.json_depth}") from error


def _first_twice(keys: Iterable[str]) -> str:
    seen: set[str] = set()
    return next(key for key in keys if key in seen or seen.add(key))


def check_sizes(value: Json, where: str, limits: Limits) -> None:
    """Bound the nesting and the length of every string, and refuse half a surrogate pair, which is not in UTF-8."""
    layer: list[Json] = [value]
    depth = 0
    while layer:
        strings = [item for item in layer if isinstance(item, str)]
        lists = [item for item in layer if isinstance(item, list)]
        objects = [item for item in layer if isinstance(item, dict)]
        depth += bool(lists or objects)
        check_limit("json-depth", where, depth, limits.json_depth)
        strings += [key for item in objects for key in item]
        check_limit("json-string", where, max(map(len, strings), default=0), limits.json_string)
        if bad := next(filter(_SURROGATE.search, strings), None):
            raise fault("json-encoding", where, ascii(bad), "characters that UTF-8 can hold")
        layer = [inner for item in lists for inner in item]
        layer += [inner for item in objects for inner in item.values()]


def type_name(value: object) -> str:
    """The JSON name of a value's type, for messages.

    >>> type_name(True), type_name(1), type_name(1.5)
    ('true or false', 'a whole number', 'a number')
    """
    names: dict[type, str] = {type(None): "null", bool: "true or false", int: "a whole number", float: "a number",
                              str: "a string", list: "a list", dict: "an object"}
    return names.get(type(value), type(value).__name__)


def as_object(value: Json, where: str, keys: Collection[str], optional: Collection[str] = ()) -> dict[str, Json]:
    """An object with exactly these keys, and any of the optional ones.

    >>> as_object({"C": 1}, "example", ("C",), ("K",))
    {'C': 1}
    """
    found = as_map(value, where)
    for key in keys:
        if key not in found:
            raise fault("field-missing", f"{where}.{key}", "nothing", "a value")
    for key in found:
        if key not in keys and key not in optional:
            raise fault("field-unknown", f"{where}.{key}", repr(key), ", ".join([*keys, *optional]))
    return found


def as_map(value: Json, where: str) -> dict[str, Json]:
    """An object with any keys."""
    if not isinstance(value, dict):
        raise fault("field-type", where, type_name(value), "an object")
    return value


def as_list(value: Json, where: str, length: int | None = None) -> list[Json]:
    """A list, of the given length if one is given."""
    if not isinstance(value, list):
        raise fault("field-type", where, type_name(value), "a list")
    if length is not None and len(value) != length:
        raise fault("field-value", where, f"{len(value)} items", f"{length} items")
    return value


def as_text(value: Json, where: str, allowed: Collection[str] | None = None) -> str:
    """A string, one of `allowed` if that is given."""
    if not isinstance(value, str):
        raise fault("field-type", where, type_name(value), "a string")
    if allowed is not None and value not in allowed:
        raise fault("field-value", where, repr(value), ", ".join(allowed))
    return value


def as_integer(value: Json, where: str, low: int = 0, high: int = SAFE_INTEGER) -> int:
    """A whole number written without fraction or exponent, in a closed range."""
    if not isinstance(value, int) or isinstance(value, bool):
        raise fault("field-type", where, type_name(value), "a whole number")
    if not low <= value <= high:
        raise fault("field-value", where, value, f"{low} to {high}")
    return value


def as_number(value: Json, where: str, low: float = -math.inf) -> float:
    """A number not below `low`, as a float64."""
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        raise fault("field-type", where, type_name(value), "a number")
    if not value >= low:
        raise fault("field-value", where, value, f"at least {low:g}")
    return float(value)
