"""Frame contraction: modes that stand still for a frame are summed into the cores once a frame (`contract.wgsl`).

A light field or a volume at one time, say, then costs what a model without the time mode costs, and reads cores that
lie close together: an undecomposed time mode scatters them over all time steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from ..model import Model
from ..packed import Metadata, PackedLevel
from .device import Device, spread
from .image import Image
from .prelude import (
    MOST_ROWS,
    PAGE_SHIFT,
    Options,
    axis_places,
    channel_axis,
    colour_mode,
    compose,
    node_words,
    prelude,
    rooms,
)
from .tree import Tree, tree_of

U32 = NDArray[np.uint32]

#: For each axis its indices and their weights.
AxisPicks = Mapping[int, tuple[Sequence[int], Sequence[float]]]

#: Invocations of a workgroup of `contract.wgsl`.
_GROUP = 64
#: Words of a mode in `fixed_rows`.
_FIXED_WORDS = 1 + 2 * MOST_ROWS


def contractable(model: Model, still: Sequence[int], folds: int = 1) -> tuple[int, ...]:
    """The modes to contract where these source axes stand still for a whole dispatch.

    A mode is among them if all its axes are. There is none if `folds` times their contracted cores would not fit into
    one binding.

    >>> from hmkcta._example import example_level, example_metadata
    >>> contractable(Model(example_metadata(), [example_level()]), [1])
    (1,)
    """
    modes, _ = axis_places(model.metadata)
    found = tuple(n for n in range(len(model.metadata.organisation))
                  if all(axis in still for axis, mode in enumerate(modes) if mode == n))
    return found if _words(model.stages, found, folds) <= 1 << PAGE_SHIFT else ()


def contraction_constants(tree: Tree, stages: Sequence[PackedLevel], image: Image, options: Options) -> dict[str, int]:
    """The constants that `contract.wgsl` needs beside the prelude of the same model with nothing contracted."""
    room = rooms(tree.metadata, options)
    most = max((int(count) for stage in stages for count in _numbers(stage, options.contracted)), default=1)
    folded = sum(tree.most(n, room[n]) for n in options.contracted)
    lanes = min(_GROUP, 1 << max(0, most - 1).bit_length())
    return {"FOLDED": sum(1 << n for n in options.contracted), "FOLD_SUM": max(1, folded), "LANES": lanes,
            "FOLD_CHANNELS": fold_channels(tree.metadata, options),
            "SET_NUMBERS": set_numbers(stages, options.contracted),
            "NODES": sum(stage.nodes for stage in stages), "SCALES": image.scales,
            "CELLS": image.coefficients[0] - image.scales}


def contraction_shader(head: str, constants: Mapping[str, int]) -> str:
    """The text of the pass, from the prelude with nothing contracted and `contraction_constants`."""
    lines = "".join(f"const {name} = {value}u;\n" for name, value in constants.items())
    return compose(head + lines, "image", "contract")


def fold_channels(metadata: Metadata, options: Options) -> int:
    """Of a number of the contracted cores: 3 where they hold colours."""
    return 3 if colour_mode(metadata, options)[1] else 1


def set_numbers(levels: Sequence[PackedLevel], contracted: Sequence[int]) -> int:
    """Numbers of all contracted cores."""
    return sum(int((_cells(level) * _numbers(level, contracted)).sum()) for level in levels)


def core_starts(levels: Sequence[PackedLevel], contracted: Sequence[int], channels: int = 1) -> U32:
    """For each node of all levels the start of its contracted cores, behind all these, in units of `channels` words."""
    sizes = np.concatenate([_cells(level) * _numbers(level, contracted) for level in levels])
    return (-(-len(sizes) // channels) + np.cumsum(sizes) - sizes).astype(np.uint32)


def parent_table(levels: Sequence[PackedLevel]) -> U32:
    """For each node of all levels the address of its parent's record and its number among the children, [nodes, 2]."""
    words = node_words(levels[0].order)
    tables = [np.zeros((1, 2), np.int64)]
    first = 0
    for level in levels[:-1]:
        assert level.child is not None
        counts = np.diff(level.child.astype(np.int64))
        parent = np.repeat(np.arange(level.nodes), counts)
        number = np.arange(len(parent)) - level.child[:-1].astype(np.int64)[parent]
        tables.append(np.stack([(first + parent) * words, number], axis=1))
        first += level.nodes
    return np.concatenate(tables).astype(np.uint32)


def fixed_rows(metadata: Metadata, contracted: Sequence[int], picks: AxisPicks) -> U32:
    """What `contract.wgsl` reads: for each mode the rows that its axes' picks make, and their weights.

    Args:
        metadata: the model's.
        contracted: the modes.
        picks: for each source axis of these modes its indices and their weights.

    >>> from hmkcta._example import example_metadata
    >>> table = fixed_rows(example_metadata(), (1,), {1: ([0, 2], [0.25, 0.75])})
    >>> table[65:68].tolist(), table[65 + 33 : 65 + 35].view(np.float32).tolist()
    ([2, 0, 2], [0.25, 0.75])
    """
    modes, strides = axis_places(metadata)
    table = np.zeros((len(metadata.organisation), _FIXED_WORDS), np.uint32)
    for n in contracted:
        rows, weights = np.zeros(1, np.int64), np.ones(1, np.float32)
        for axis in (axis for axis, mode in enumerate(modes) if mode == n):
            index, weight = picks[axis]
            rows = (rows[:, None] + np.asarray(index) * strides[axis]).reshape(-1)
            weights = (weights[:, None] * np.asarray(weight, np.float32)).reshape(-1)
        table[n, 0] = len(rows)
        table[n, 1 : 1 + len(rows)] = rows
        table[n, 1 + MOST_ROWS : 1 + MOST_ROWS + len(rows)] = weights.astype(np.float32).view(np.uint32)
    return table.reshape(-1)


def split_colours(metadata: Metadata, picks: AxisPicks, channels: int) -> list[AxisPicks]:
    """The picks of each channel of the contracted cores: of red, green and blue, or the picks themselves."""
    if channels == 1:
        return [picks]
    axis = channel_axis(metadata)
    assert axis is not None, "colours are along an axis"
    return [{**picks, axis: ([index], [1.0])} for index in picks[axis][0]]


@final
class FrameContraction:
    """The contracted cores of a model on the GPU, and the pass that fills them.

    Args:
        device: where.
        model: what.
        image: of the model.
        options: with the contracted modes, and `picks` that leave room for their axes'.
        layout: of group 0 without the contracted cores.
        pages: of the image.

    Attributes:
        cores: the buffer `frame` of the shaders that decode; another one after `reserve` made room.
        stride: numbers from one set to the next: `frame_first` of set s is s times that.
    """

    def __init__(self, device: Device, model: Model, image: Image, options: Options, layout: Any, pages: int) -> None:
        self._device = device
        self._model = model
        self._metadata = model.metadata
        self._contracted = options.contracted
        self._channels = fold_channels(model.metadata, options)
        self.stride = set_numbers(model.stages, options.contracted)
        self._parents = device.buffer("hmkcta parents", parent_table(model.stages))
        own = device.layout("hmkcta contraction", ["read-only-storage", "read-only-storage", "storage"])
        self._own, self._sets = own, 0
        self.reserve(1)
        tree = replace(tree_of(model.metadata, model.stages), uniform=())
        head = prelude(tree, pages, Options(page_shift=options.page_shift))
        constants = contraction_constants(tree, model.stages, image, options)
        self._pipeline = device.pipeline("contract_frame", contraction_shader(head, constants), [layout, own])
        self._counts = spread(-(-constants["CELLS"] * constants["LANES"] // _GROUP))

    def fits(self, sets: int) -> bool:
        """Whether that many `sets` of cores fit into one binding."""
        return _words(self._model.stages, self._contracted, sets * self._channels) <= 1 << PAGE_SHIFT

    def reserve(self, sets: int) -> bool:
        """Have room for that many `sets` of cores; whether there is a new buffer for it."""
        if sets <= self._sets:
            return False
        self._sets = sets
        words = _words(self._model.stages, self._contracted, sets * self._channels)
        self.cores = self._device.room("hmkcta contracted cores", 4 * words, "STORAGE|COPY_DST|COPY_SRC")
        starts = core_starts(self._model.stages, self._contracted, self._channels)
        self._device.gpu.queue.write_buffer(self.cores, 0, starts)
        folds = sets * self._channels
        order = len(self._metadata.organisation)
        self._fixed = self._device.room("hmkcta fixed rows", 4 * folds * _FIXED_WORDS * order)
        self._group = self._device.group("hmkcta contraction", self._own, [self._fixed, self._parents, self.cores])
        return True

    def run(self, decoder: Any, sets: Sequence[AxisPicks]) -> None:
        """Contract the cores with these indices and weights of the axes of the contracted modes.

        Args:
            decoder: group 0 without the contracted cores.
            sets: for each set of cores and each axis of the contracted modes; that of the colours has those of red,
                green and blue.
        """
        folds = [each for picks in sets for each in split_colours(self._metadata, picks, self._channels)]
        rows = np.concatenate([fixed_rows(self._metadata, self._contracted, picks) for picks in folds])
        self._device.gpu.queue.write_buffer(self._fixed, 0, rows)
        self._device.dispatch(self._pipeline, [decoder, self._group], (*self._counts[:2], len(folds)))


def _cells(level: PackedLevel) -> NDArray[np.int64]:
    """PC of each node, 0 where the shape is zero."""
    return np.diff(level.cell_offset.astype(np.int64))


def _numbers(level: PackedLevel, contracted: Sequence[int]) -> NDArray[np.int64]:
    """Numbers of a node's contracted core."""
    kept = [n for n in range(level.order) if n not in contracted]
    return level.shape[:, 2, kept].astype(np.int64).prod(axis=1)


def _words(levels: Sequence[PackedLevel], contracted: Sequence[int], folds: int = 1) -> int:
    """Words of the table of starts, with what rounds it up, and of all contracted cores, `folds` times."""
    return sum(level.nodes for level in levels) + 2 + folds * set_numbers(levels, contracted)
