"""The order in which people count: 2 before 10."""

from __future__ import annotations

import re


def natural(name: object) -> tuple[list[str | int], str]:
    """Key to sort names by: whole numbers in them count as numbers; names alike but for zeros ahead keep one order.

    >>> sorted(["img10.png", "img2.png", "img02.png"], key=natural)
    ['img02.png', 'img2.png', 'img10.png']
    """
    words = re.split(r"([0-9]+)", str(name))
    return [int(word) if number % 2 else word for number, word in enumerate(words)], str(name)
