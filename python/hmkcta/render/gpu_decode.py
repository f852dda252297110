"""Elements decoded on the GPU: what Model's indexing does, by the shaders that the renderers use."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from ..decode import check_indices
from ..errors import HmkctaError, Kind, invalid
from ..model import Model
from ..support.memory import check_memory
from .device import Device, shared_device, spread
from .prelude import PAGE_SHIFT, Options, channel_axis, compose, compose_picked
from .software import MOST_TURNS, loop_turns
from .upload import DecoderBuffers
from .weighted import Picks

#: Invocations of a workgroup in `elements.wgsl` and `picked.wgsl`.
_GROUP = 64
#: Elements decoded by one dispatch: bounds the buffers beside the model.
_BATCH = 1 << 20


@final
class GpuDecoder:
    """A model's elements, decoded on the GPU.

    Args:
        model: what to decode.
        device: where; the shared device by default.
        page_shift: logarithm of the words of a page of the image.

    Raises:
        HmkctaError: there is no adapter, or the model does not fit.

    >>> from hmkcta import Model
    >>> from hmkcta._example import example_level, example_metadata
    >>> from hmkcta.render.device import find_device
    >>> model = Model(example_metadata(), [example_level()])
    >>> [6.0, 3.0] if find_device() is None else GpuDecoder(model).elements([[1, 2], [0, 2]]).tolist()
    [6.0, 3.0]
    """

    def __init__(self, model: Model, device: Device | None = None, page_shift: int = PAGE_SHIFT) -> None:
        self.model = model
        self.device = shared_device() if device is None else device
        self.buffers = DecoderBuffers(self.device, model, Options(page_shift=page_shift))
        self._elements = ListPass(self.device, self.buffers, "decode_elements",
                               compose(self.buffers.prelude(), "image", "decode", "elements"))
        self._sums: dict[tuple[tuple[int, ...], int], ListPass] = {}

    def elements(self, indices: Any, level: int | None = None) -> NDArray[np.float32]:
        """Scattered elements.

        Args:
            indices: of the source axes, [B, axes].
            level: the last level to add, all by default.

        Returns:
            Source values, [B].

        Raises:
            HmkctaError: not that many axes, no integers, an index or a level out of range; a software adapter would
                not finish (`refusal`).
        """
        wanted = np.asarray(indices)
        shape = self.model.shape
        if wanted.ndim != 2 or wanted.shape[1] != len(shape):
            raise invalid("coords-shape", "indices", f"shape {wanted.shape}", f"[elements, {len(shape)}]")
        for axis, size in enumerate(shape):
            check_indices(wanted[:, axis], size, f"indices of axis {self.model.metadata.axes[axis].name}")
        self._check(None, level)
        group = self.buffers.bind_group(level)
        batches = [self._elements.run(wanted[start : start + _BATCH].astype(np.uint32), group)
                   for start in range(0, len(wanted), _BATCH)]
        return np.concatenate([np.empty(0, np.float32), *batches])

    def submit(self, indices: NDArray[np.integer[Any]]) -> None:
        """Submit the decoding of elements with valid indices [B, axes], and wait for nothing: for measuring speed."""
        self._elements.submit(indices, self.buffers.bind_group())

    def refusal(self, picks: Sequence[int] | None = None, level: int | None = None) -> HmkctaError | None:
        """Why a software adapter would not finish an element, or a sum with `picks` an axis; None if it would."""
        counts = picks or (1,) * len(self.model.shape)
        turns = loop_turns(self.model, counts, level or len(self.model.levels)) if self.device.software else 0
        if turns <= MOST_TURNS:
            return None
        return HmkctaError(Kind.RESOURCE_LIMIT, "software-loops", f"decoding by {self.device.name}",
                           found=f"up to {turns} turns of the shader's loops", allowed=f"{MOST_TURNS} in software",
                           hint="use the NumPy decoder (the model itself), or a lower level")

    def reconstruct(self, level: int | None = None) -> NDArray[np.float32]:
        """All elements, in the source's shape.

        Raises:
            HmkctaError: the level is out of range, or the memory does not suffice.
        """
        shape = self.model.shape
        check_memory(4 * prod(shape), f"all {prod(shape)} elements", "decode a part with elements()")
        values = np.empty(prod(shape), np.float32)
        for start in range(0, values.size, _BATCH):
            flat = np.arange(start, min(start + _BATCH, values.size))
            values[start : start + _BATCH] = self.elements(np.stack(np.unravel_index(flat, shape), axis=1), level)
        return values.reshape(shape)

    def picked(self, picks: Sequence[Picks], level: int | None = None) -> NDArray[np.float32]:
        """Weighted sums of elements, for interpolation: what `weighted.decode_picked` does, with its arguments.

        Weights of three channels are those of the first axis of role `channel`: one index each.

        Raises:
            HmkctaError: as there; a mode would have more than 32 rows; other weights of three channels.
        """
        if len(picks) != len(self.model.shape):
            raise invalid("picks", "picks", f"{len(picks)} entries", f"{len(self.model.shape)}, one a source axis")
        for axis, (index, _) in enumerate(picks):
            name = self.model.metadata.axes[axis].name
            check_indices(np.asarray(index), self.model.shape[axis], f"indices of axis {name}")
        counts = tuple(index.shape[1] for index, _ in picks)
        channels = _colours(self.model, picks)
        self._check(counts, level)
        if (counts, channels) not in self._sums:
            options = Options(picks=counts, channels=channels, page_shift=self.buffers.options.page_shift)
            head = self.buffers.prelude(options)
            self._sums[counts, channels] = ListPass(
                self.device, self.buffers, "decode_sums", compose_picked(head, "picked"))
        wanted = picked_words(picks, max(counts))
        group, work = self.buffers.bind_group(level), self._sums[counts, channels]
        batches = [work.run(wanted[start : start + _BATCH], group, channels) for start in range(0, len(wanted), _BATCH)]
        values = np.concatenate([np.empty(0, np.float32), *batches])
        return values.reshape(-1, 3) if channels == 3 else values


    def _check(self, picks: Sequence[int] | None, level: int | None) -> None:
        refusal = self.refusal(picks, level)
        if refusal is not None:
            raise refusal


@final
class ListPass:
    """A pass with a list of what is wanted and a list of the results."""

    def __init__(self, device: Device, buffers: DecoderBuffers, entry: str, code: str) -> None:
        self._device = device
        self._sent: tuple[Any, Any, Any] | None = None
        self._layout = device.layout(entry, ["read-only-storage", "storage"])
        self._pipeline = device.pipeline(entry, code, [buffers.layout, self._layout])

    def run(self, wanted: NDArray[np.uint32], group: Any, numbers: int = 1) -> NDArray[np.float32]:
        """The results, `numbers` for each entry of `wanted`."""
        self._sent = None
        return self._device.read(self.submit(wanted, group, numbers)).view(np.float32)

    def submit(self, wanted: NDArray[np.integer[Any]], group: Any, numbers: int = 1) -> Any:
        """The buffer that will hold the results; the array of the last call is not sent again."""
        if self._sent is None or self._sent[0] is not wanted:
            entries = self._device.buffer("wanted", np.ascontiguousarray(wanted, np.uint32))
            values = self._device.room("decoded", 4 * numbers * len(wanted))
            self._sent = wanted, values, self._device.group("lists", self._layout, [entries, values])
        _, values, own = self._sent
        self._device.dispatch(self._pipeline, [group, own], spread(-(-len(wanted) // _GROUP)))
        return values


def picked_words(picks: Sequence[Picks], most: int) -> NDArray[np.uint32]:
    """What `picked.wgsl` reads, [P, axes, most, 2]."""
    points = max(len(index) for index, _ in picks)
    words = np.zeros((points, len(picks), most, 2), np.uint32)
    for axis, (index, weight) in enumerate(picks):
        count = index.shape[1]
        words[:, axis, :count, 0] = index
        numbers = np.asarray(weight, np.float32)
        if numbers.ndim == 3:  # red, green and blue, which the shader knows
            numbers = np.ones(numbers.shape[:2], np.float32)
        words[:, axis, :count, 1] = np.ascontiguousarray(numbers).view(np.uint32)
    return words


def _colours(model: Model, picks: Sequence[Picks]) -> int:
    """Channels of some picks: 3 if those of the first axis of role `channel` are red, green and blue.

    Raises:
        HmkctaError: weights of three channels on another axis, or that are not one for each channel.
    """
    tinted = [axis for axis, (_, weight) in enumerate(picks) if np.ndim(weight) == 3]
    if not tinted:
        return 1
    weights = np.asarray(picks[tinted[0]][1])
    if tinted != [channel_axis(model.metadata)] or weights.shape[1:] != (3, 3) or (weights != np.eye(3)).any():
        named = ", ".join(str(axis) for axis in tinted)
        raise invalid("picks-colours", f"weights of axes {named}", "three channels each",
                      "on the first axis of role channel: three indices with the weights 1,0,0 and 0,1,0 and 0,0,1")
    return 3
