"""A model on the GPU: its image in pages of a storage buffer, and the bind group that every decoding pass shares."""

from __future__ import annotations

from typing import Any, final

from ..model import Model
from .core_sums import FRAME_BINDING
from .device import Device
from .frame_contraction import AxisPicks, FrameContraction
from .image import Image, pack_image
from .prelude import PLAIN, Options, decoder_uniform, image_pages, prelude
from .tree import tree_of


@final
class DecoderBuffers:
    """Group 0 of a decoding shader: the uniform `Decoder` and the pages of the image.

    Args:
        device: where to.
        model: what.
        options: of the shader; those that share buffers can differ in picks and channels.
        shared: buffers of the same model, whose image serves for these, too.

    Raises:
        HmkctaError: the image does not fit into the storage buffers that WebGPU guarantees.

    Attributes:
        layout: bind group layout of group 0.
        pages: of the image.
    """

    def __init__(self, device: Device, model: Model, options: Options = PLAIN, shared: DecoderBuffers | None = None
                 ) -> None:
        image = pack_image(model.stages) if shared is None else shared._image
        self._image = image
        self.device = device
        self.metadata = model.metadata
        self.options = options
        self._tree = tree_of(model.metadata, model.stages) if shared is None else shared._tree
        self.pages = image_pages(image.words.size, options.page_shift)
        self._buffers = _paged(device, image, self.pages, options) if shared is None else shared._buffers
        kinds = dict(enumerate(["uniform", *["read-only-storage"] * self.pages]))
        self._whole = device.layout("hmkcta decoder", kinds)
        self.layout = self._whole
        self._contraction: FrameContraction | None = None
        if options.contracted:
            self.layout = device.layout("hmkcta decoder", {**kinds, FRAME_BINDING: "read-only-storage"})
            self._contraction = FrameContraction(device, model, image, options, self._whole, self.pages)
        self._uniforms: dict[int, Any] = {}
        self._groups: dict[int, Any] = {}

    def prelude(self, options: Options | None = None) -> str:
        """The prelude for these buffers; other options must have the same `page_shift` and contracted modes."""
        return prelude(self._tree, self.pages, self.options if options is None else options)

    def bind_group(self, levels: int | None = None) -> Any:
        """Group 0 for the first `levels` levels, all by default.

        Raises:
            HmkctaError: not 1 to L.
        """
        chosen = len(self.metadata.levels) if levels is None else levels
        if chosen not in self._groups:
            buffers = self._bound(chosen)
            if self._contraction is not None:
                buffers[FRAME_BINDING] = self._contraction.cores
            self._groups[chosen] = self.device.group("hmkcta decoder", self.layout, buffers)
        return self._groups[chosen]

    @property
    def stride(self) -> int:
        """Numbers from one set of contracted cores to the next."""
        return 0 if self._contraction is None else self._contraction.stride

    def fits(self, sets: int) -> bool:
        """Whether that many `sets` of contracted cores fit into one binding."""
        return self._contraction is None or self._contraction.fits(sets)

    def contract(self, *sets: AxisPicks) -> None:
        """Fill the contracted cores for a frame: for each axis of the contracted modes its indices and weights.

        What is decoded until the next call must pick the same indices and weights of these axes. Without contracted
        modes there is nothing to do.
        """
        if self._contraction is not None:
            levels = len(self.metadata.levels)
            if self._contraction.reserve(len(sets)):
                self._groups.clear()
            whole = self.device.group("hmkcta decoder", self._whole, self._bound(levels))
            self._contraction.run(whole, sets)

    def _bound(self, levels: int) -> dict[int, Any]:
        """The buffers of group 0 that every model has."""
        if levels not in self._uniforms:
            uniform = decoder_uniform(self.metadata, levels)
            self._uniforms[levels] = self.device.buffer("hmkcta levels", uniform, "UNIFORM")
        return dict(enumerate([self._uniforms[levels], *self._buffers]))


def _paged(device: Device, image: Image, pages: int, options: Options) -> list[Any]:
    """The image in storage buffers."""
    page = 1 << options.page_shift
    return [device.buffer(f"hmkcta image {number}", image.words[number * page : (number + 1) * page])
            for number in range(pages)]
