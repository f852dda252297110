"""The native kernels of the search, called with arrays of blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32, F64
from ..support.extension import native
from .rate_model import MODEL, RateModel

I32 = NDArray[np.int32]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]


def best_boxes(
    cores: F32, decomposed: Sequence[bool], step: float, decode_cost: float, model: RateModel = MODEL
) -> tuple[F64, U32]:
    """As `rank_boxes.best_boxes`, in Rust and on threads."""
    rate = (model.trade, model.core_bits, model.core_octave_bits, model.column_bits)
    costs, ranks = native.rank_boxes(
        np.ascontiguousarray(cores).reshape(-1), list(cores.shape[1:]), list(decomposed), step, rate, decode_cost)
    return costs, ranks.reshape(len(cores), -1)


@dataclass(frozen=True, eq=False)
class CodedBatch:
    """Whole numbers of blocks, one block behind the other; see `block_code.BlockCode`."""

    exponents: tuple[U8, ...]
    bases: tuple[I32, ...]
    core: I32
    errors: F64


def code_blocks(
    values: F32, cores: F32, bases: Sequence[F32 | None], ranks: U32, step: float, model: RateModel = MODEL
) -> CodedBatch:
    """As `block_code.code_block` for each block, in Rust and on threads."""
    none = np.zeros(0, np.float32)
    given = [none if basis is None else np.ascontiguousarray(basis).reshape(-1) for basis in bases]
    exponents, whole, core, errors = native.code_blocks(
        np.ascontiguousarray(values).reshape(-1), np.ascontiguousarray(cores).reshape(-1), given,
        list(values.shape[1:]), [basis is not None for basis in bases],
        np.ascontiguousarray(ranks, np.uint32).reshape(-1), step, model.dead_zone)
    return CodedBatch(tuple(exponents), tuple(whole), core, errors)
