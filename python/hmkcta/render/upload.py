"""A model on the GPU: its image in pages of a storage buffer, and the bind group that every decoding pass shares."""

from __future__ import annotations

from typing import Any, final

from ..model import Model
from .device import Device
from .image import pack_image
from .prelude import PLAIN, Options, decoder_uniform, image_pages, prelude


@final
class DecoderBuffers:
    """Group 0 of a decoding shader: the uniform `Decoder` and the pages of the image.

    Args:
        device: where to.
        model: what.
        options: of the shader; those that share buffers can differ in all but `page_shift`.

    Raises:
        HmkctaError: the image does not fit into the storage buffers that WebGPU guarantees.

    Attributes:
        layout: bind group layout of group 0.
        nbytes: bytes of the image.
        pages: of the image.
    """

    def __init__(self, device: Device, model: Model, options: Options = PLAIN) -> None:
        image = pack_image(model.levels)
        self.device = device
        self.metadata = model.metadata
        self.options = options
        self.nbytes = image.words.nbytes
        self.pages = image_pages(image.words.size, options.page_shift)
        page = 1 << options.page_shift
        self._buffers = [device.buffer(f"hmkcta image {number}", image.words[number * page : (number + 1) * page])
                         for number in range(self.pages)]
        self.layout = device.layout("hmkcta decoder", ["uniform", *["read-only-storage"] * self.pages])
        self._groups: dict[int, Any] = {}

    def prelude(self, options: Options | None = None) -> str:
        """The prelude for these buffers; other options than the buffers' own must have the same `page_shift`."""
        return prelude(self.metadata, self.pages, self.options if options is None else options)

    def bind_group(self, levels: int | None = None) -> Any:
        """Group 0 for the first `levels` levels, all by default.

        Raises:
            HmkctaError: not 1 to L.
        """
        chosen = len(self.metadata.levels) if levels is None else levels
        if chosen not in self._groups:
            uniform = self.device.buffer("hmkcta levels", decoder_uniform(self.metadata, chosen), "UNIFORM")
            self._groups[chosen] = self.device.group("hmkcta decoder", self.layout, [uniform, *self._buffers])
        return self._groups[chosen]
