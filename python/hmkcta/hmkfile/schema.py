"""Which arrays a file holds, their number types and, where the tables do not decide them, their shapes.

The names are those of `docs/format.md`, section 3, with ``level/<l>/`` before them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..axes import MOST_COORDS
from ..narrow import BASIS_NUMBERS, CORE_NUMBERS, F16, widened
from ..packed import Metadata, PackedLevel
from .header import ITEM_SIZES
from .limits import Limits, check_limit
from .reasons import fault

NUMPY_TYPES = {"I8": "i1", "U8": "u1", "F16": "<f2", "F32": "<f4", "F64": "<f8", "U16": "<u2", "U32": "<u4"}
TYPE_NAMES = {np.dtype(code): name for name, code in NUMPY_TYPES.items()}
_RAGGED = -1  # a length that the tables decide

#: The number types that core and basis numbers may have, by the version of the file; the newest version comes last.
NUMBER_TYPES: Mapping[str, tuple[str, ...]] = {
    "1.0": ("F16",), "1.1": ("F16", "I8"), "1.2": ("F16", "I8"), "1.4": ("F16", "I8"),
}
#: The versions that leave out what follows from other arrays (`short.py`), and the last that has all of them.
SHORT, WHOLE = ("1.2", "1.4"), "1.1"
#: The versions whose levels may be packed.
PACKED = ("1.4",)
#: Arrays that short versions may leave out, and the types that tables may have there, by the one in memory.
OPTIONAL, NARROWER = ("cluster", "part", "local"), {"U32": ("U8", "U16", "U32"), "U16": ("U8", "U16")}


class ArrayInfo(NamedTuple):
    """Number type and shape of an array."""

    dtype: str
    shape: tuple[int, ...]


def prefix(level: int) -> str:
    """The start of the names of a level's arrays; levels count from 1.

    >>> prefix(2)
    'level/2/'
    """
    return f"level/{level}/"


def version_of(arrays: Mapping[str, ArrayInfo]) -> str:
    """The version that is written of these arrays: where all readers could read it, the oldest.

    >>> core, rice = ArrayInfo("I8", (8,)), ArrayInfo("U8", (2,))
    >>> version_of({"level/1/core": core}), version_of({"level/1/core": core, "level/1/rice/0": rice}), version_of({})
    ('1.2', '1.4', '1.0')
    """
    if any(_kind(name) == "rice" for name in arrays):
        return PACKED[0]
    return SHORT[0] if any(info.dtype == "I8" for info in arrays.values()) else next(iter(NUMBER_TYPES))


def is_number(name: str) -> bool:
    """Whether an array of this name holds core or basis numbers; all others are tables.

    >>> is_number("level/1/basis/0"), is_number("level/1/core"), is_number("level/1/core_scale")
    (True, True, False)
    """
    return _kind(name) in ("core", "basis")


def _kind(name: str) -> str:
    """The name of a level's array without level and mode; of another one nothing."""
    return name.split("/")[2] if name.startswith("level/") else ""


def level_schema(order: int, undecomposed: Sequence[int], nodes: int, last: bool, bits: int = 16, *,
                 short: bool = False, packed: bool = False) -> Iterator[tuple[str, ArrayInfo]]:
    """Names (without prefix) and infos of the arrays of a level with S = `nodes`; -1 for a ragged length.

    Core and basis numbers have that many `bits`. Arrays of one number type come in the order of the file. If `short`
    without offsets, and with all that may be left out, in the types of memory. If `packed` with parameters.

    >>> sum(1 for _ in level_schema(4, (), 12, last=False)), sum(1 for _ in level_schema(4, (3,), 12, last=True))
    (34, 21)
    >>> sum(1 for _ in level_schema(4, (), 12, last=False, short=True))
    20
    """
    for name, info in _whole_schema(order, undecomposed, nodes, last, bits):
        if packed and name.split("/")[0] in ("core", "basis"):
            yield name, ArrayInfo("U8", info.shape)
        elif not (short and is_offset(name)):
            yield name, info
        if packed and name == "core_scale":
            yield from ((f"rice/{n}", ArrayInfo("U8", (_RAGGED,))) for n in range(order) if n not in undecomposed)


def is_offset(name: str) -> bool:
    """Whether an array of this name, with or without prefix, is running sums of what nodes own.

    >>> is_offset("level/1/core_offset"), is_offset("basis_offset/0"), is_offset("level/1/basis/0")
    (True, True, False)
    """
    return "_offset" in name


def _whole_schema(order: int, undecomposed: Sequence[int], nodes: int, last: bool, bits: int
                  ) -> Iterator[tuple[str, ArrayInfo]]:
    offsets, indices, ragged = ArrayInfo("U32", (nodes + 1,)), ArrayInfo("U16", (_RAGGED,)), (_RAGGED,)
    yield "shape", ArrayInfo("U32", (nodes, 3, order))
    if not last:
        yield "child", offsets
    numbers = ArrayInfo("I8" if bits == 8 else "F16", ragged)
    yield from (("core", numbers), ("core_offset", offsets))
    yield from (("cell_offset", offsets), ("core_scale", ArrayInfo("F32", ragged)))
    for n in range(order):
        yield f"row_offset/{n}", offsets
        if n in undecomposed:
            continue
        yield from ((f"cluster/{n}", indices), (f"cluster_offset/{n}", offsets))
        yield from ((f"basis/{n}", numbers), (f"basis_offset/{n}", offsets))
        if not last:
            yield from ((f"part/{n}", indices), (f"local/{n}", ArrayInfo("U32", ragged)))


#: The number type of each array of a level in memory, by its name without level and mode.
LEVEL_TYPES = {name.split("/")[0]: info.dtype for name, info in level_schema(1, (), 0, last=False)}
LEVEL_TYPES["rice"] = "U8"


def check_schema(metadata: Metadata, version: str, coords: Mapping[int, str], arrays: Mapping[str, ArrayInfo],
                 limits: Limits) -> None:
    """The arrays must be exactly those that the metadata calls for; `coords` names coordinate arrays by axis number.

    Where the version has bytes, the type of a level's core is that of its bases; no F16 follows a level of bytes or of
    packed numbers.
    """
    expected: dict[str, ArrayInfo] = {}
    order, depth, nodes, bits = len(metadata.organisation), len(metadata.levels), 0, 16
    for level in range(1, depth + 1):
        name = prefix(level) + "shape"
        _require(name, arrays)
        count = arrays[name].shape[0] if arrays[name].shape else 0
        nodes += count
        check_limit("nodes-limit", name, nodes, limits.nodes)
        core = arrays.get(prefix(level) + "core")
        packed = core is not None and core.dtype == "U8" and version in PACKED and len(metadata.undecomposed) < order
        if packed or (core is not None and core.dtype == "I8" and "I8" in NUMBER_TYPES[version]):
            bits = 8
        schema = level_schema(
            order, metadata.undecomposed, count, level == depth, bits, short=version in SHORT, packed=packed
        )
        expected.update((prefix(level) + part, info) for part, info in schema)
    for name, info in expected.items():
        if version in SHORT and name not in arrays and name.split("/")[2] in OPTIONAL:
            continue
        _require(name, arrays)
        allowed = NARROWER.get(info.dtype) if version in SHORT else None
        _check_info(name, arrays[name], allowed or (info.dtype,), info.shape)
    for n, name in coords.items():
        _require(name, arrays)
        size = metadata.axes[n].size
        width = arrays[name].shape[1:2]
        _check_info(name, arrays[name], ("F32", "F64"), (size, *width))
        if width and not 1 <= width[0] <= MOST_COORDS:
            raise fault("array-shape", name, list(arrays[name].shape), f"1 to {MOST_COORDS} numbers an index")
    _check_names(arrays, {*expected, *coords.values()})


def _require(name: str, arrays: Mapping[str, ArrayInfo]) -> None:
    if name not in arrays:
        raise fault("array-missing", name, "no such array", "an array")


def _check_names(arrays: Mapping[str, ArrayInfo], expected: set[str]) -> None:
    for name in arrays:
        if name not in expected:
            raise fault("array-unexpected", name, "an array", "no such array")


def _check_info(name: str, found: ArrayInfo, dtypes: tuple[str, ...], shape: tuple[int, ...]) -> None:
    if found.dtype not in dtypes:
        raise fault("array-dtype", name, found.dtype, " or ".join(dtypes))
    same = len(found.shape) == len(shape) and all(
        allowed in (size, _RAGGED) for size, allowed in zip(found.shape, shape, strict=True))
    if not same:
        shown = ["any length" if size == _RAGGED else size for size in shape]
        raise fault("array-shape", name, list(found.shape), shown)


def file_order(arrays: Iterable[tuple[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Arrays that go level by level in the order of the file: 1-, 8-, 4- and 2-byte tables, then numbers."""
    return dict(sorted(arrays, key=lambda item: _turn(item[0], item[1].dtype.itemsize)))


def in_file_order(arrays: Mapping[str, ArrayInfo]) -> dict[str, ArrayInfo]:
    """The order of `file_order`, for arrays of which only type and shape are known, level by level."""
    return dict(sorted(arrays.items(), key=lambda item: _turn(item[0], ITEM_SIZES[item[1].dtype])))


def _turn(name: str, itemsize: int) -> int:
    """Longer items first keeps every array aligned without padding; core and basis numbers come last.

    Single bytes are the exception: they come before all others, and the header ends so that they do not matter.
    """
    return 0 if is_number(name) else -16 if itemsize == 1 else -itemsize


def level_of(arrays: Mapping[str, NDArray[Any]], level: int, order: int) -> PackedLevel:
    """The level made of a file's arrays, which `check_schema` has let through; bytes become their numbers."""
    def get(name: str) -> NDArray[Any]:
        return arrays[prefix(level) + name]

    def find(name: str) -> NDArray[Any] | None:
        return arrays.get(prefix(level) + name)

    def modes(name: str) -> tuple[NDArray[Any] | None, ...]:
        return tuple(find(f"{name}/{n}") for n in range(order))

    narrow, packed = get("core").dtype == np.int8, any(find(f"rice/{n}") is not None for n in range(order))
    core = _numbers(get("core"), CORE_NUMBERS) if narrow else get("core")
    bases = tuple(_numbers(basis, BASIS_NUMBERS) if narrow and basis is not None else basis for basis in modes("basis"))
    return PackedLevel(
        shape=get("shape"), child=find("child"), row_offset=tuple(get(f"row_offset/{n}") for n in range(order)),
        core=core, core_offset=get("core_offset"), core_scale=get("core_scale"), cell_offset=get("cell_offset"),
        cluster=modes("cluster"), cluster_offset=modes("cluster_offset"), basis=bases,
        basis_offset=modes("basis_offset"), part=modes("part"), local=modes("local"),
        bits=8 if narrow or packed else 16, rice=modes("rice") if packed else (),
    )


def _numbers(stored: NDArray[Any], numbers: F16) -> F16:
    """What bytes stand for, as unchangeable as the views of the file that other arrays are."""
    wide = widened(stored, numbers)
    wide.setflags(write=False)
    return wide


def check_order(names: Sequence[str], infos: Mapping[str, ArrayInfo]) -> None:
    """In file order, all tables come before core and basis numbers, which go level by level."""
    level = 0
    for name in names:
        if 0 in infos[name].shape:
            continue  # an empty array stands nowhere in particular
        this = int(name.split("/")[1]) if is_number(name) else 0
        if this < level:
            raise fault("array-order", name, f"after core or basis numbers of level {level}",
                        "tables first, then core and basis numbers level by level")
        level = max(level, this)
