"""The order in which people count: 2 before 10, 0.25 before 0.5."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from typing import TypeVar

Name = TypeVar("Name")
#: A number with one point, which is no part of a version or a date (1.2.10).
_DECIMAL = re.compile(r"(?<![0-9.])[0-9]+\.([0-9]+)(?![0-9]|\.[0-9])")
_WHOLE, _EITHER = re.compile(r"([0-9]+)"), re.compile(r"((?<![0-9.])[0-9]+\.[0-9]+(?![0-9]|\.[0-9])|[0-9]+)")


def natural(name: object, *, decimals: bool = False) -> tuple[list[str | tuple[int, str]], str]:
    """Key to sort names by: numbers in them count as numbers; names alike but for zeros ahead keep one order.

    Args:
        name: the name.
        decimals: whether a point between digits is a decimal point; without, there are whole numbers on both sides.

    >>> sorted(["img10.png", "img2.png", "img02.png"], key=natural)
    ['img02.png', 'img2.png', 'img10.png']
    """
    words = (_EITHER if decimals else _WHOLE).split(str(name))
    return [_number(word) if number % 2 else word for number, word in enumerate(words)], str(name)


def _number(word: str) -> tuple[int, str]:
    whole, _, fraction = word.partition(".")
    return int(whole), fraction


def in_order(names: Iterable[Name]) -> list[Name]:
    """Names of files in natural order.

    What is on both sides of a point are decimals, unless one of them ends in 0: nobody writes 0.10 beside 0.5, while
    tile1.10 follows tile1.9. Where all have as many digits both are one order. The folder of all does not count.

    >>> in_order(["dark0.5.exr", "dark0.125.exr", "dark0.25.exr", "dark1.exr"])
    ['dark0.125.exr', 'dark0.25.exr', 'dark0.5.exr', 'dark1.exr']
    >>> in_order(["tile1.10.png", "tile1.9.png", "tile1.8.png"])
    ['tile1.8.png', 'tile1.9.png', 'tile1.10.png']
    """
    listed = list(names)
    texts = [str(name) for name in listed]
    folder = os.path.commonpath([os.path.dirname(text) for text in texts]) if texts else ""
    fractions = [digits for text in texts for digits in _DECIMAL.findall(text[len(folder):])]
    decimals = not any(len(digits) > 1 and digits.endswith("0") for digits in fractions)
    return sorted(listed, key=lambda name: natural(name, decimals=decimals))
