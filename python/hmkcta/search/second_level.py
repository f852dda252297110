"""A second level of the same blocks, where float16 numbers of one level do not keep what a goal asks for.

Stored numbers are widened to float16, whose 11 bits end at an SNR of 65 to 75 dB. A first level of few bytes, and its
residual (paper, section 4) by a step of its own, reach twice that.
"""

from __future__ import annotations

from dataclasses import replace
from math import log10

import numpy as np
from numpy.typing import NDArray

from ..arrays import F32
from ..backends.decoding import add_block
from ..metrics import snr_db as decibels
from ..packed import PackedLevel
from .blocks import Slices, axis_order
from .coded import LayoutCoder
from .engine import Found, Goal, Search
from .layout import Layout
from .stages import stages_of
from .values import Values

#: SNR in dB of a first level, which float16 keeps.
FIRST_SNR = 55.0


def again(search: Search, found: Found, goal: Goal) -> Found:
    """The same layout in as many levels for another goal."""
    return two_levels(search, found, goal) if found.above else search.again(found, goal)


def two_levels(search: Search, found: Found, goal: Goal) -> Found:
    """Two levels of the layout of what was found, each with half of the decode cost."""
    layout, cost = found.layout, search.decode_cost // 2
    upper = replace(search, goal=Goal(snr=FIRST_SNR), decode_cost=cost)
    coder = LayoutCoder(search.values, layout, found.coder.sets, cost, threads=search.threads, filled=True)
    first = upper.meet(layout, found.coded.step, coder)
    residual = _residual(search.values, layout, stages_of(coder, first.levels))
    below = goal if goal.snr is None else Goal(snr=goal.snr - 10 * log10(search.energy / residual.energy))
    lower = replace(search, values=residual, goal=below, decode_cost=cost, overhead=first.nbytes)
    second = lower.meet(layout, min(first.coded.step, 0.1 * lower.rms))
    return replace(second, above=first.levels, snr=decibels(search.energy, second.coded.error))


def _residual(values: Values, layout: Layout, stages: tuple[PackedLevel, ...]) -> Values:
    """What stages leave of the values, in memory where these are."""
    def read(part: Slices) -> F32:
        return values.read(part) - decoded(stages, layout, values.shape, part)

    if values.in_memory:
        return Values.of_array(read(tuple(slice(0, size) for size in values.shape)))
    return Values(values.shape, read, values.memory)


def decoded(stages: tuple[PackedLevel, ...], layout: Layout, shape: tuple[int, ...], part: Slices) -> F32:
    """A part of what stages of a layout decode to, in the array's axes."""
    rows: list[NDArray[np.intp]] = []
    for mode in layout.modes:
        inside = np.ix_(*(np.arange(shape[axis])[part[axis]] for axis in mode))
        rows.append(np.ravel_multi_index(inside, [shape[axis] for axis in mode]).reshape(-1))
    block = np.zeros([len(own) for own in rows], np.float32)
    add_block(stages, rows, block)
    order = axis_order(layout.modes)
    split = block.reshape([part[axis].stop - part[axis].start for axis in order])
    return np.ascontiguousarray(split.transpose(np.argsort(order)))
