"""Chunks of an HDF5 dataset, of which each must have the bytes that it should.

HDF5 does not look: where a chunk unpacks to fewer bytes, the rest of its numbers is whatever memory held before.
"""

from __future__ import annotations

import zlib
from itertools import product
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..packing import Part
from .source import Layout, too_long, too_short

#: Codes of HDF5's filters whose lengths can be told: gzip, exchanging bytes, and a checksum of 4 bytes behind the data.
_DEFLATE, _SHUFFLE, _FLETCHER32 = 1, 2, 3


class WholeChunks:
    """A chunked dataset of h5py that is read by parts of whole chunks, each of which is as long as it should be.

    Attributes:
        shape: sizes of the axes.
        dtype: of the numbers.
    """

    def __init__(self, dataset: Any, where: str) -> None:
        self.shape: tuple[int, ...] = tuple(dataset.shape)
        self.dtype: np.dtype[Any] = dataset.dtype
        self._dataset, self._where = dataset, where
        made = dataset.id.get_create_plist()
        self._filters = [int(made.get_filter(number)[0]) for number in range(made.get_nfilters())]
        self._nbytes = prod(dataset.chunks) * int(dataset.id.get_type().get_size())
        self._lengths: dict[tuple[int, ...], int] = {}
        dataset.id.chunk_iter(self._note)

    def _note(self, chunk: Any) -> None:
        self._lengths[tuple(chunk.chunk_offset)] = int(chunk.size)

    def __getitem__(self, part: Part) -> NDArray[Any]:
        """The numbers of a part.

        Raises:
            HmkctaError: a chunk is shorter or longer than it should be.
        """
        spans = (range(span.start - span.start % chunk, span.stop, chunk)
                 for span, chunk in zip(part, self._dataset.chunks, strict=True))
        for place in product(*spans):
            if place in self._lengths:  # of one that is not, HDF5 has the fill value
                self._check(place)
        return self._dataset[part]

    def _check(self, place: tuple[int, ...]) -> None:
        found = self._unpacked(place) if self._filters else self._lengths[place]
        if found is not None and found != self._nbytes:
            layout = Layout(tuple(self._dataset.chunks), self.dtype)
            wrong = too_short if found < self._nbytes else too_long
            raise wrong(f"{self._where}, chunk at {', '.join(map(str, place))}", f"{found} bytes of numbers", layout)

    def _unpacked(self, place: tuple[int, ...]) -> int | None:
        """Bytes that a chunk has once its filters are undone; None: it has others than those that are known here."""
        mask, data = self._dataset.id.read_direct_chunk(place)
        for number, code in reversed([*enumerate(self._filters)]):
            if mask >> number & 1:  # this chunk was left as it is
                continue
            if code == _DEFLATE:
                data = zlib.decompressobj().decompress(data, self._nbytes + 5)  # with the checksum, and a byte too many
            elif code == _FLETCHER32:
                data = data[:-4]
            elif code != _SHUFFLE:
                return None
        return len(data)
