"""Simple compressors with random access, quantised and entropy coded as well as they allow.

Any element is decoded from the stored numbers in at most a given number of multiply-adds. All methods share one rate
model (`rates.py`) and one search (`search.py`); each layout is predicted first, and the best predicted are coded. What
is reported is always the error of the array as decoded, at bits that a decoder can follow.

Left out of the bytes are what an arithmetic coder wastes (some bytes a file) and pointers to bricks, so the peers are
charged slightly less than hmkcta, which is charged for its whole file.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from .layouts import describe
from .matrices import clustered_pca, pca
from .search import Found, Search
from .train import tensor_train
from .tucker import bricks, hosvd

#: Every method finds the best it can for each budget of a search; None: nothing fits.
METHODS: dict[str, Callable[[NDArray[np.float32], Search], list[Found | None]]] = {
    "pca": pca,
    "clustered_pca": clustered_pca,
    "tensor_train": tensor_train,
    "hosvd": hosvd,
    "hosvd_bricks": bricks,
}


def best_of(
    method: str, values: NDArray[np.float32], budgets: Sequence[int], decode_cost: int, names: Sequence[str]
) -> list[tuple[float, int, int, str] | None]:
    """What a method reaches at each budget in bytes.

    Args:
        method: a name of `METHODS`.
        values: the array.
        budgets: bytes.
        decode_cost: most multiply-adds of one element.
        names: of the axes, to describe layouts with.

    Returns:
        For each budget the squared error, bytes, multiply-adds of one element, and the layout in words; None where
        nothing fits.
    """
    search = Search.of(values, budgets, decode_cost)
    return [
        None if found is None else (found.coded.error, found.coded.nbytes, found.coded.cost,
                                    f"{describe(found.layout, names)}; {found.coded.ranks}")
        for found in METHODS[method](values, search)
    ]
