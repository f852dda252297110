"""The fitted model: an array of the source's shape that is decoded where it is looked at."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import product
from math import nan, prod
from numbers import Integral
from typing import Any, Final, final

import numpy as np
from numpy.typing import DTypeLike, NDArray

from .axes import axis_order, mode_sizes
from .decode import decode_block, decode_elements
from .errors import expect, invalid
from .goals import memory_given
from .hmkfile import DEFAULT_LIMITS, Limits, encoded_size, load, save
from .indexing import Index, Selection, cut, occurring, positions, select
from .metrics import all_finite
from .packed import LevelBounds, LevelQuality, Metadata, PackedLevel, level_ends
from .plan import Plan, multiply_adds
from .planned import plan_of
from .support.memory import available_memory, check_memory, format_bytes, memory_for
from .support.slabs import slabs
from .transform import from_json, nearest

Floats = NDArray[np.float32]

#: Elements of an array decoded at once: bounds memory beside the result to some 100 MB.
_SLAB = 1 << 24
#: Elements decoded at once straight into the result, which takes no memory; it stops only between slabs, though.
_IN_PLACE = 1 << 28
#: Elements decoded together where each needs its coordinates.
_SCATTERED = 1 << 20
#: Walking the tree for one more block costs about as much as this many scattered elements.
_BLOCK_WORTH = 512
#: As many elements of one block around all take no longer than one that is decoded on its own, or in one of many.
_AROUND_ELEMENTS, _AROUND_BLOCKS = 32, 8
#: What to do where the result of an index does not fit into memory.
_LESS, _INTO = "index a smaller part, or reconstruct into a numpy.memmap", "give a numpy.memmap as out, or index a part"


@final
class Model:
    """A compressed array of float32 values with the shape and the axes of its source.

    Indexing follows NumPy, but for a lone True or False, and decodes only what is asked for. NumPy functions work on a
    model by decoding all of it, and ``np.asarray(model, np.uint8)`` rounds its values, and cuts them off, to the
    nearest of a type of integers.

    Args:
        metadata: axes, organisation, value transform, quality; kept as the attribute `metadata`.
        stages: one for each in `metadata.stages`; kept as the attribute `stages`. Those with numbers are the levels.

    Raises:
        HmkctaError: reason ``level-count``: there are no stages, not as many as the metadata say, or the last is a cut.

    >>> from hmkcta._example import example_level, example_metadata
    >>> m = Model(example_metadata(), [example_level()])  # [[1, 2, 3], [2, 4, 6]] as the outer product of two vectors
    >>> m.shape, m.ndim, m.size, len(m), str(m.dtype), m.snr, m.quality[0].rmse, m.decode_cost
    ((2, 3), 2, 6, 2, 'float32', 90.0, 0.0001, 1)
    >>> m[1, ::-1], float(m.sample([0.5, 1.0]))
    (array([6., 4., 2.], dtype=float32), 3.0)
    >>> m.reconstruct().tolist() == m.at_level(1)[...].tolist() == np.asarray(m, np.uint8).tolist()
    True
    """

    def __init__(self, metadata: Metadata, stages: tuple[PackedLevel, ...] | list[PackedLevel]) -> None:
        if not stages or len(stages) != len(metadata.stages):
            raise invalid("level-count", "levels", len(stages), f"{max(1, len(metadata.stages))}, as the metadata say")
        if stages[-1].is_cut:
            raise invalid("level-count", "levels", "a cut as the last stage", "a stage with numbers")
        self.metadata: Final = metadata
        self.stages: Final = tuple(stages)
        self._shape: Final = tuple(axis.size for axis in metadata.axes)
        self._transform: Final = from_json(metadata.transform)
        self._sizes: Final = mode_sizes(metadata.axes, metadata.organisation)
        order = iter(axis_order(metadata.axes, metadata.organisation))
        self._axes_of_mode: Final = [[next(order) for _ in mode] for mode in metadata.organisation]
        #: The written plan by which `compress` made the model, for another array like it; None of a search and a file.
        self.made_by: Plan | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Sizes of the source axes."""
        return self._shape

    @property
    def ndim(self) -> int:
        """Number of source axes."""
        return len(self.shape)

    @property
    def size(self) -> int:
        """Number of elements."""
        return prod(self.shape)

    @property
    def dtype(self) -> np.dtype[np.float32]:
        """Type of the decoded values; the source's is `metadata.source_dtype`."""
        return np.dtype(np.float32)

    def __len__(self) -> int:
        return self.shape[0]

    @cached_property
    def levels(self) -> tuple[PackedLevel, ...]:
        """The stages that have numbers: what `at_level` and `quality` count. Cuts before one belong to it."""
        return tuple(stage for stage in self.stages if not stage.is_cut)

    @property
    def quality(self) -> tuple[LevelQuality, ...]:
        """SNR in dB, RMSE and largest error of the first 1, 2, .. L levels, measured when the model was made."""
        return self.metadata.quality

    @property
    def snr(self) -> float:
        """SNR in dB of all levels together; NaN where it was not measured."""
        return self.quality[-1].snr_db if self.quality else nan

    @cached_property
    def nbytes(self) -> int:
        """Exact size of the model's file in bytes."""
        return encoded_size(self.metadata, self.stages)

    @property
    def bounds(self) -> tuple[LevelBounds, ...]:
        """The largest C_n, K_n and R_n of any node, one entry a level."""
        return self.metadata.levels

    @property
    def plan(self) -> Plan:
        """The plan that the levels follow, with the largest R, C and K of any node; blocks are named as clusters."""
        return plan_of(self.metadata, self.stages)

    @property
    def decode_cost(self) -> int:
        """Multiply-adds for one scattered element: over levels, the sum of the largest prod R_n K_n of any node."""
        return sum(stage.decode_cost for stage in self.stages)

    def __repr__(self) -> str:
        axes = " ".join(f"{axis.name}={axis.size}" for axis in self.metadata.axes)
        levels = "1 level" if len(self.levels) == 1 else f"{len(self.levels)} levels"
        return (f"<hmkcta.Model {axes}: {levels}, {self.snr:.2f} dB, {format_bytes(self.nbytes)}, "
                f"{multiply_adds(self.decode_cost)} an element>")

    def save(self, path: str | os.PathLike[str], overwrite: bool = False) -> None:
        """Write the file, whole or not at all; with `overwrite` also in the place of one that is there. See `open`.

        Raises:
            HmkctaError: there is a file already and `overwrite` is false; it cannot be written.
        """
        expect("path", path, str | bytes | os.PathLike, "the path of a file")
        save(path, self.metadata, self.stages, overwrite=overwrite)

    def at_level(self, level: int) -> Model:
        """The model of the first `level` levels (paper, figure 7), sharing this one's arrays; it can be saved as well.

        Raises:
            HmkctaError: `level` is no whole number from 1 to L.
        """
        expect("level", level, Integral, "a whole number")
        if not 1 <= level <= len(self.levels):
            raise invalid("level-out-of-range", "level", level, f"1 to {len(self.levels)}")
        if level == len(self.levels):
            return self
        absent = (None,) * len(self._sizes)
        end = level_ends(self.stages)[level - 1]
        last = replace(self.stages[end - 1], child=None, part=absent, local=absent)
        return Model(self.metadata.upto(level), (*self.stages[: end - 1], last))

    @memory_for("the elements of an index", _LESS)
    def __getitem__(self, key: Any) -> Any:
        """Decode the elements that NumPy would return for this key, as float32 (a scalar for a single element).

        Raises:
            IndexingError: a key that does not fit; it is an IndexError too.
            HmkctaError: the result does not fit into memory.
        """
        chosen = select(key, self.shape)
        check_memory(4 * prod(chosen.shape), f"{' x '.join(map(str, chosen.shape))} elements", _LESS)
        values = np.empty(chosen.shape, np.float32)
        self._decode(chosen, values)
        return values if values.ndim else values[()]

    def __iter__(self) -> Iterator[Any]:
        return (self[i] for i in range(len(self)))

    @memory_for("all elements", "index a part")
    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """All elements; what NumPy calls to use the model as an array.

        Of integers and of float16 the nearest, as in `reconstruct`: a cast makes 0 of 256, infinity of 65536.
        """
        if copy is False:
            raise ValueError("a model is decoded into a new array: copy=False cannot be")
        wanted = self.dtype if dtype is None else np.dtype(dtype)
        if wanted.kind not in "iubf" or (wanted.kind == "f" and wanted.itemsize >= 4):
            return self.reconstruct().astype(wanted, copy=False)
        check_memory(wanted.itemsize * self.size, f"all {self.size} elements", "index a part")
        return self.reconstruct(np.empty(self.shape, wanted))

    @memory_for("interpolated values", "ask for fewer positions at once")
    def sample(self, coords: Any) -> Any:
        """Multilinear interpolation between the elements.

        Args:
            coords: positions in units of indices, [.., ndim], each from 0 to the axis's size - 1.

        Returns:
            Values, [..], float32.

        Raises:
            HmkctaError: a position outside, NaN or masked, or not `ndim` numbers each.
        """
        points = positions(coords, self.shape, [axis.name for axis in self.metadata.axes])
        flat = points.reshape(-1, self.ndim)
        values = np.empty(len(flat), np.float32)
        step = max(1, _SCATTERED >> self.ndim)
        for start in range(0, len(flat), step):
            values[start : start + step] = self._interpolate(flat[start : start + step])
        return values.reshape(points.shape[:-1])[()]

    @memory_for("all elements", _INTO)
    def reconstruct(self, out: NDArray[Any] | None = None, max_memory: int | str | None = None) -> NDArray[Any]:
        """Decode all elements, slab by slab along the first axis.

        Args:
            out: array to fill, of the source's shape, for instance a `numpy.memmap`; a new float32 array by default.
                Of integers, say of the type `metadata.source_dtype`, or float16 it gets the nearest ones.
            max_memory: bytes to allocate at most, or a text such as ``"200MB"``; what is available by default.

        Returns:
            `out`, or the new array.

        Raises:
            HmkctaError: `out` has another shape, other numbers or is read-only; the memory does not suffice.
        """
        expect("out", out, np.ndarray | None, "an array")
        if out is not None and (out.shape != self.shape or out.dtype.kind not in "fiub" or not out.flags.writeable):
            kept = "" if out.flags.writeable else "read-only "
            raise invalid("out-shape", "out", f"{kept}{out.dtype} of shape {out.shape}",
                          f"floats or integers of shape {self.shape}, to be written to")
        limit = available_memory() if max_memory is None else memory_given(max_memory)
        own = 0 if out is not None else 4 * self.size
        # A slab and the decoder's working arrays take up to four times its elements.
        slab = _SLAB if limit is None else min(_SLAB, (limit - own) // 16)
        check_memory(own + 16 * min(1 << 16, self.size), f"all {self.size} elements", _INTO, limit)
        result = np.empty(self.shape, np.float32) if out is None else out
        if result.dtype.kind == "f" and result.itemsize >= 4:
            self._decode(select((), self.shape), result, slab)
        else:
            for part in slabs(self.shape, slab):
                result[part] = nearest(self[part], result.dtype)
        return result

    def _decode(self, chosen: Selection, out: NDArray[Any], slab: int = _SLAB) -> None:
        """Decode a selection into `out`, slab by slab."""
        if out.size and self._decode_in_place(chosen, out):
            return
        for part in slabs(chosen.shape, slab) if out.size else ():
            self._decode_slab(self._in_modes(cut(chosen.axes, part)), out[(*part, ...)])

    def _decode_in_place(self, chosen: Selection, out: NDArray[Any]) -> bool:
        """Decode straight into `out` where its numbers need neither be moved nor changed; if they do, False."""
        modes = self._in_modes(chosen.axes)
        along = [d for index in modes for d, length in enumerate(index.shape) if length > 1]
        if along != sorted(set(along)) or not self._transform.is_identity:
            return False
        if out.dtype != np.float32 or not (out.flags.c_contiguous and out.flags.aligned):
            return False
        for part in slabs(chosen.shape, _IN_PLACE):
            rows = [index.reshape(-1) for index in self._in_modes(cut(chosen.axes, part))]
            block = out[(*part, ...)].reshape([len(index) for index in rows])
            if not all_finite(decode_block(self.stages, self._sizes, rows, out=block)):
                return False
        return True

    def _in_modes(self, axes: Sequence[Index]) -> list[Index]:
        """Indices of the modes from those of the source axes: C-order flattening of the mode's axes."""
        modes: list[Index] = []
        for members in self._axes_of_mode:
            index = axes[members[0]]
            for axis in members[1:]:
                index = index * self.shape[axis] + axes[axis]
            modes.append(index)
        return modes

    def _decode_slab(self, modes: list[Index], out: NDArray[Any]) -> None:
        """Fill `out` by blocks where the modes vary independently, else by one around all, or element by element.

        The indices of each mode can be broadcast to the shape of `out`.
        """
        shape = out.shape
        along = [{d for d, length in enumerate(index.shape) if length > 1} for index in modes]
        shared = sorted({d for n, dims in enumerate(along) for other in along[:n] for d in dims & other})
        apart = bool(shared) and prod(length for d, length in enumerate(shape) if d not in shared) < _BLOCK_WORTH
        around = (_AROUND_ELEMENTS if apart else _AROUND_BLOCKS) * out.size
        if shared and out.size > _BLOCK_WORTH and self._decode_around(modes, around, out):
            return
        if apart:
            flat = np.empty(out.size, np.float32)
            spread = [index.reshape(-1) if index.shape == shape else np.broadcast_to(index, shape).flat
                      for index in modes]
            for start in range(0, out.size, _SCATTERED):
                part = slice(start, min(start + _SCATTERED, out.size))
                flat[part] = self._elements(np.stack([index[part] for index in spread], axis=1))
            out[...] = flat.reshape(shape)
            return
        # A block for each combination of the indices that several modes share; one, where they share none.
        for point in product(*(range(shape[d]) for d in shared)):
            at = {d: slice(i, i + 1) for d, i in zip(shared, point, strict=True)}
            rows = [index[tuple(at.get(d, slice(None)) if length > 1 else slice(None)
                                for d, length in enumerate(index.shape))] for index in modes]
            part = tuple(at.get(d, slice(None)) for d in range(len(shape)))
            out[part] = self._block(rows).reshape(out[part].shape)

    def _decode_around(self, modes: list[Index], most: int, out: NDArray[Any]) -> bool:
        """Decode all combinations of the rows that occur, and take from them; where these are more than most, False."""
        found = occurring(modes, most)
        if found is None:
            return False
        rows, places = found
        if prod(map(len, rows)) <= _SLAB:
            out[...] = self._source_values(
                lambda dtype: decode_block(self.stages, self._sizes, rows, dtype=dtype)[tuple(places)])
            return True
        longest = int(np.argmax(out.shape))
        for half in (slice(out.shape[longest] // 2), slice(out.shape[longest] // 2, None)):
            part = (*[slice(None)] * longest, half)
            self._decode_slab(cut(modes, part), out[part])
        return True

    def _block(self, modes: list[Index]) -> Floats:
        """Decode the outer product of the modes' indices; its dimensions longer than 1, in ascending order."""
        rows = [index.reshape(-1) for index in modes]
        block = self._source_values(lambda dtype: decode_block(self.stages, self._sizes, rows, dtype=dtype))
        split = [(d, length) for index in modes for d, length in enumerate(index.shape) if length > 1]
        in_order = sorted(range(len(split)), key=lambda i: split[i][0])
        return block.reshape([length for _, length in split]).transpose(in_order)

    def _elements(self, coords: Index) -> Floats:
        """Decode elements by their mode indices, [B, N]."""
        return self._source_values(lambda dtype: decode_elements(self.stages, self._sizes, coords, dtype=dtype))

    def _source_values(self, decode: Callable[[DTypeLike], NDArray[Any]]) -> Floats:
        """Decode and undo the value transform; numbers too large for float32 become its largest."""
        values = self._transform.inverse(decode(np.float32))
        if all_finite(values):
            return values
        largest = np.finfo(np.float32).max
        return np.clip(self._transform.inverse(decode(np.float64)), -largest, largest).astype(np.float32)

    def _interpolate(self, points: NDArray[np.float64]) -> Floats:
        """`sample` for valid points [B, ndim]: the weighted sum of the 2^d elements around each."""
        low = np.minimum(points.astype(np.intp), np.maximum(np.array(self.shape) - 2, 0))
        fraction = (points - low).astype(np.float32)
        between = np.flatnonzero(fraction.any(axis=0)).tolist()  # axes along which any point is off the grid
        corners, weights = [low], [np.ones(len(points), np.float32)]
        for axis in between:
            step = np.zeros(self.ndim, np.intp)
            step[axis] = 1
            weights = [w * f for f in (1 - fraction[:, axis], fraction[:, axis]) for w in weights]
            corners = [*corners, *(corner + step for corner in corners)]
        indices = np.concatenate(corners)
        modes = self._in_modes([indices[:, axis] for axis in range(self.ndim)])
        values = self._elements(np.stack(modes, axis=1)).reshape(len(corners), -1)
        return np.einsum("cb,cb->b", np.stack(weights), values)


@memory_for("the arrays of the file", "close what else takes memory, or take a machine that has more")
def open(path: str | os.PathLike[str], verify: bool = True, limits: Limits = DEFAULT_LIMITS) -> Model:
    """Open a file as a `Model`: it is checked and decoded into memory, and not needed any more then.

    Replace a file by `Model.save`, or by renaming another one: writing into it while it is opened is found as damage.

    Args:
        path: the file.
        verify: compare its checksums.
        limits: the largest sizes taken; more only of files that are trusted: ``Limits(rank=2048)``.

    Raises:
        HmkctaError: it is missing, damaged, of a later version, or beyond the limits.

    >>> import tempfile
    >>> from hmkcta._example import example_level, example_metadata
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     Model(example_metadata(), [example_level()]).save(f"{folder}/small.hmk")
    ...     print(open(f"{folder}/small.hmk").plan)
    R=1,1
    """
    expect("path", path, str | bytes | os.PathLike, "the path of an .hmk file")
    return Model(*load(path, verify=verify, limits=limits))
