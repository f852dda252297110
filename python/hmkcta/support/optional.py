"""Libraries that come with an extra of the package: loaded when something needs them."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ..errors import invalid, sentence


def library(module: str, package: str, extra: str, where: str) -> Any:
    """The module of a library, or an error that says how to get it.

    Args:
        module: as it is imported.
        package: the library's name, for people; in small letters it begins the error's reason.
        extra: of hmkcta, with which the library comes.
        where: what needs it: the argument or the work.

    Raises:
        HmkctaError: it is not installed, or cannot be loaded; the reason is the package's name and ``-missing``.

    >>> library("math", "Math", "demo", "pictures").sqrt(4.0)
    2.0
    >>> library("no_such_module", "NoSuch", "demo", "pictures")
    Traceback (most recent call last):
        ...
    hmkcta.errors.HmkctaError: pictures: found no NoSuch in this Python. Next: pip install "hmkcta[demo]". \
[InvalidArgument/nosuch-missing]
    """
    try:
        return import_module(module)
    except Exception as error:  # a package that is there but broken raises what it likes
        broken = not isinstance(error, ModuleNotFoundError)
        found = f"{package} cannot be loaded: {sentence(error)}" if broken else f"no {package} in this Python"
        hint = f'pip install "hmkcta[{extra}]"'
        raise invalid(f"{package.lower()}-missing", where, found, hint=hint) from error
