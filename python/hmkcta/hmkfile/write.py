"""Write a packed model: the same bytes for the same model, and never half a file at the target path."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Generator, Sequence
from contextlib import contextmanager

import numpy as np

from ..errors import HmkctaError, Kind, invalid
from ..packed import U32, Metadata, PackedLevel, bounds_of
from .coding import arrays_of, encode_stage, following, root_places
from .container import closed, prefix_of
from .limits import DEFAULT_LIMITS, Limits
from .metadata import coords_array, is_section, to_json
from .publish import check_output, published
from .read import by_level, loads
from .reasons import fault
from .stages import Run, Stage
from .text import format_json

#: Types of the arrays of a stage.
_TYPES = {"shape": np.uint32, "child": np.uint32, "row_offset": np.uint32, "core": np.float16, "core_offset": np.uint32,
          "core_scale": np.float32, "cell_offset": np.uint32, "cluster": np.uint16, "cluster_offset": np.uint32,
          "basis": np.float16, "basis_offset": np.uint32, "part": np.uint16, "local": np.uint32, "column": np.uint8}


#: Those of each mode, and those that the last stage does not have.
_OF_MODES = ("row_offset", "cluster", "cluster_offset", "basis", "basis_offset", "part", "local", "column")
_NOT_AT_LAST = ("child", "part", "local")


def encode(metadata: Metadata, levels: Sequence[PackedLevel]) -> list[bytes]:
    """The bytes of the file, in pieces. `save` also checks the model.

    Raises:
        HmkctaError: `InvalidArgument` where the model holds something that has no place in a file at all.
    """
    with _as_invalid_argument():
        coded = _coded(metadata, levels)
        stages = [_stage(level, metadata.stages[t].scheme, [run for _, run in runs])
                  for t, (level, runs) in enumerate(zip(levels, coded, strict=True))]
        header = _header(metadata, stages)
        coords = [coords_array(axis).tobytes() for axis in metadata.axes if is_section(axis)]
        sections = [*([array] for array in coords), *(pieces for runs in coded for pieces, _ in runs)]
        return [prefix_of(header), header, *(piece for section in sections for piece in closed(section))]


def file_digest(metadata: Metadata, levels: Sequence[PackedLevel]) -> str:
    """SHA-256 of the model's file."""
    digest = hashlib.sha256()
    for piece in encode(metadata, levels):
        digest.update(piece)
    return digest.hexdigest()


def encoded_size(metadata: Metadata, levels: Sequence[PackedLevel]) -> int:
    """Exact number of bytes of the file that `save` writes."""
    return sum(map(len, encode(metadata, levels)))


def level_sizes(metadata: Metadata, levels: Sequence[PackedLevel]) -> list[int]:
    """Bytes of each level's sections in the file, with those of the stages without numbers before it."""
    with _as_invalid_argument():
        sizes = [sum(len(piece) for pieces, _ in runs for piece in closed(pieces)) for runs in _coded(metadata, levels)]
    return by_level([level.is_cut for level in levels], sizes)


def save(path: str | os.PathLike[str], metadata: Metadata, levels: Sequence[PackedLevel], *, overwrite: bool = False,
         limits: Limits = DEFAULT_LIMITS) -> int:
    """Check the model and write it, atomically; return the number of bytes.

    Raises:
        HmkctaError: `InvalidArgument` with a reader's reason code if the model is not valid, `ResourceLimit` if it is
            beyond the limits, `Io` if the output is there already (``output-exists``), the disk is full
            (``disk-full``) or the folder cannot be written to (``unwritable``). The target is then as it was.
    """
    check_output(path, overwrite)
    data = b"".join(encode(metadata, levels))
    with _as_invalid_argument():
        _check_read(loads(data, verify=False, limits=limits)[1], levels)
    with published(path, overwrite) as file:
        file.write(data)
    return len(data)


def _coded(metadata: Metadata, levels: Sequence[PackedLevel]) -> list[list[tuple[list[bytes], Run]]]:
    """The runs of each stage."""
    if len(levels) != len(metadata.stages):
        raise fault("array-shape", "levels", f"{len(levels)} stages", f"{len(metadata.stages)}, as the metadata say")
    places = root_places(metadata.axes, metadata.organisation)
    coded: list[list[tuple[list[bytes], Run]]] = []
    for t, level in enumerate(levels):
        name = f"stages[{t}]"
        _check_arrays(level, name, last=level is levels[-1])
        _check_rows(level, places["rows"].reshape(-1, level.order), name)
        coded.append(encode_stage(level, places, name))
        if level is not levels[-1]:
            places = following(level, places, name)
    return coded


def _stage(level: PackedLevel, scheme: str, runs: Sequence[Run]) -> Stage:
    rows = tuple(int(offsets[-1]) for offsets in level.row_offset)
    half = level.step is None and not level.is_cut
    return Stage(level.nodes, bounds_of(level, scheme), level.step, half, rows, tuple(runs))


def _header(metadata: Metadata, stages: Sequence[Stage]) -> bytes:
    try:
        return format_json(to_json(metadata, stages)).encode()
    except (TypeError, ValueError, RecursionError) as error:
        raise fault("field-type", "header", error, "strings, finite numbers, lists and objects") from error


def _check_arrays(level: PackedLevel, name: str, *, last: bool) -> None:
    """Number types, and arrays where there must be some: without these there is no telling what a stage holds."""
    if level.shape.ndim != 3 or level.shape.shape[1] != 3:
        raise fault("array-shape", f"{name}.shape", list(level.shape.shape), "[nodes, 3, modes]")
    for field, dtype in _TYPES.items():
        absent = (last and field in _NOT_AT_LAST) or (field == "column" and level.step is None)
        arrays = arrays_of(level, field)
        modes = (0 if field == "column" and absent else level.order) if field in _OF_MODES else 1
        if len(arrays) != modes:
            raise fault("array-shape", f"{name}.{field}", f"{len(arrays)} modes", modes)
        for array in arrays:
            if (array is None) != absent:
                raise fault("array-shape", f"{name}.{field}", "no array" if array is None else "an array",
                            "none" if absent else "an array")
            if array is not None and array.ndim != (3 if field == "shape" else 1):
                raise fault("array-shape", f"{name}.{field}", f"{array.ndim} dimensions", 1)
            if array is not None and array.dtype != dtype:
                raise fault("array-dtype", f"{name}.{field}", array.dtype, np.dtype(dtype))


def _check_rows(level: PackedLevel, rows: U32, name: str) -> None:
    """A stage's nodes must own the rows that the stage before gives them."""
    for n, offsets in enumerate(level.row_offset):
        if not np.array_equal(np.diff(offsets.astype(np.int64)), rows[:, n].astype(np.int64)):
            raise fault("row-count", f"{name}.row_offset[{n}]", "other rows", "those that the parts of parents give")


def _check_read(read: Sequence[PackedLevel], levels: Sequence[PackedLevel]) -> None:
    """What a file leaves out must be in the arrays as a reader makes it: a model with other arrays would be another."""
    for t, (one, other) in enumerate(zip(read, levels, strict=True)):
        for field in ("shape", "child", "row_offset", "cluster", "part", "local", "core_offset", "basis_offset"):
            pairs = zip(arrays_of(one, field), arrays_of(other, field), strict=True)
            if any(a is not None and b is not None and not np.array_equal(a, b) for a, b in pairs):
                raise fault("array-shape", f"stages[{t}].{field}", "other numbers", "those that a reader finds")


@contextmanager
def _as_invalid_argument() -> Generator[None]:
    """Turn a reader's verdict on the file into one on the writer's arguments; limits stay limits."""
    try:
        yield
    except HmkctaError as error:
        if error.kind is Kind.RESOURCE_LIMIT:
            hint = "stay within it, as readers refuse more"
            raise HmkctaError(
                error.kind, error.reason, error.where, found=error.found, allowed=error.allowed, hint=hint
            ) from error
        raise invalid(error.reason, error.where, error.found, error.allowed, error.hint) from error
