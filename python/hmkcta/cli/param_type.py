"""The base of what reads an option's text, `ParamType[T]`, under every click that is allowed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from click import ParamType as ParamType
else:

    class ParamType(click.ParamType):
        """`click.ParamType`, which takes the type of its values in brackets since click 8.4 alone."""

        def __class_getitem__(cls, _values: object) -> type:
            return cls
