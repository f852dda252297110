"""Calls of every native function with arguments that contradict each other, in a process of its own.

Each call is made from one that is right by changing a few of its arguments, and it must return or raise an `Exception`.
What is called is written down before, so that who started the process knows of what it died.

    python tests/native_nonsense.py SEED CALLS LOG
"""

from __future__ import annotations

import mmap
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from coded_stages import random_stage, root_places
from hmkcta import _native
from hmkcta.backends.decoding import _flat_arrays  # pyright: ignore[reportPrivateUsage]
from random_models import random_model

Arguments: TypeAlias = list[Any]
Generator: TypeAlias = np.random.Generator

#: Numbers that wrap, alone or with one another; where rounds are counted the last ones only.
ODD: tuple[Any, ...] = (0, 1, 2, 3, -1, 7, 2**16, 2**16 + 1, 2**31, 2**32, 2**62, 2**63, 2**64 - 1, -2**63, 2**70,
                        float("nan"), 1.5, None, "x", True)
ROUNDS = (0, 1, 2, -1, 2**62, 2**70, float("nan"), None)
#: Memory of the process, so that what asks for all of the machine's fails.
MOST_BYTES = 3 << 30


class Rounds(int):
    """A count of rounds, which must not be made long."""


def some(rng: Generator, low: int, high: int, count: int) -> list[int]:
    """Whole numbers from low to high - 1."""
    return [int(number) for number in rng.integers(low, high, count)]


def floats(rng: Generator, count: int) -> NDArray[np.float32]:
    """Random numbers."""
    return rng.standard_normal(count).astype(np.float32)


def node(rng: Generator) -> tuple[Any, list[Any], list[int], int, list[Any]]:
    """Shape, members, basis sizes, numbers of the cores, bases of a small node."""
    order = int(rng.integers(1, 4))
    sizes = some(rng, 1, 6, order)
    clusters = some(rng, 1, 4, order)
    mixture = [int(rng.integers(1, c + 1)) for c in clusters]
    ranks = some(rng, 1, 4, order)
    flags = [bool(rng.random() < 0.2) for _ in sizes]
    for n in range(order):
        if flags[n]:
            clusters[n], mixture[n], ranks[n] = 1, 1, sizes[n]
    members = [np.concatenate([np.sort(rng.permutation(c)[:k]) for _ in range(size)]).astype(np.uint16)
               for size, c, k in zip(sizes, clusters, mixture, strict=True)]
    cells = int(np.prod(clusters))
    lengths = [0 if flags[n] else sizes[n] * mixture[n] * (cells // clusters[n]) * ranks[n] for n in range(order)]
    bases = [floats(rng, length) for length in lengths]
    return (sizes, clusters, mixture, ranks, flags), members, lengths, cells * int(np.prod(ranks)), bases


def cells_call(rng: Generator, name: str) -> Arguments:
    shape, members, _, numbers, bases = node(rng)
    sizes: list[int] = shape[0]
    tensor, cores = floats(rng, int(np.prod(sizes))), floats(rng, numbers)
    mode = int(rng.integers(0, len(bases)))
    return {
        "fit_cells": [shape, members, tensor, bases, cores, Rounds(1), Rounds(1)],
        "accumulate": [shape, members, tensor, bases, cores, 0.5],
        "project_cells": [shape, members, tensor, bases, mode],
        "project_pair": [shape, members, tensor, bases, (mode, (mode + 1) % len(bases))],
        "dense_basis": [shape, members, mode, bases[mode]],
        "orthonormalise": [shape, members, mode, bases[mode], cores],
    }[name]


def pairs_call(rng: Generator, name: str) -> Arguments:
    ranks, cells = some(rng, 1, 4, 2), int(rng.integers(1, 5))
    products = [rng.standard_normal((cells * r) ** 2) for r in ranks]
    cores = floats(rng, cells * int(np.prod(ranks)))
    if name == "dictionary_gram":
        return [ranks, products, cores, 0]
    return [ranks, products, cores, rng.standard_normal(cores.size), Rounds(2)]


def picked_call(rng: Generator, name: str) -> Arguments:
    sizes = some(rng, 1, 6, int(rng.integers(1, 4)))
    rows = [np.flatnonzero(rng.random(size) < 0.6).astype(np.uint32) for size in sizes]
    block = floats(rng, int(np.prod([len(r) for r in rows])))
    arguments: Arguments = [floats(rng, int(np.prod(sizes))), sizes, rows]
    return arguments if name == "gather" else [*arguments, block]


def collect_call(rng: Generator, name: str) -> Arguments:
    array = rng.integers(0, 9, rng.integers(1, 5, 2)).astype(np.uint32 if name == "collect" else np.float32)
    steps = (array.shape[1], 1)
    offsets = [np.arange(size, dtype=np.int64) * step for size, step in zip(array.shape, steps, strict=True)]
    pair = (array, np.zeros(array.size, array.dtype))
    return [pair, offsets] if name == "collect" else [pair, offsets, 2.0]


def lanes_call(rng: Generator, _: str) -> Arguments:
    before, size, after, rank, lanes = some(rng, 1, 4, 5)
    return [floats(rng, before * size * after * lanes), floats(rng, size * rank * lanes), (before, size, after), rank,
            lanes]


def rows_call(rng: Generator, _: str) -> Arguments:
    clusters, rank, rows = some(rng, 1, 4, 2), int(rng.integers(1, 3)), int(rng.integers(1, 5))
    side, mixture = int(np.prod(clusters)) * rank, int(rng.integers(1, clusters[0] + 1))
    h = rng.standard_normal((side, side))
    kept = np.tile(np.arange(mixture, dtype=np.uint16), rows)
    search = str(rng.choice(["optimal", "greedy", "fixed", "none"]))
    return [(h @ h.T).reshape(-1), rng.standard_normal(side * rows), clusters, 0, rank,
            kept if rng.random() < 0.7 else None, mixture, search]


def kmeans_call(rng: Generator, name: str) -> Arguments:
    rows, clusters, width = some(rng, 1, 6, 3)
    if name == "nearest_with_room":
        return [rng.random(rows * clusters), clusters, rows]
    return [rng.random(rows * width), rng.random(clusters * width), width, rows, Rounds(3)]


def model_call(rng: Generator, name: str) -> Arguments:
    sizes = some(rng, 2, 6, int(rng.integers(1, 4)))
    _, packed = random_model(rng, sizes, levels=int(rng.integers(1, 4)),
                             undecomposed=(0,) if rng.random() < 0.3 and len(sizes) > 1 else ())
    levels = [_flat_arrays(level) for level in packed]
    if name == "decode_block":
        rows = [rng.integers(0, size, 3) for size in sizes]
        return [levels, rows, 0, np.zeros(3 ** len(sizes), np.float32)]
    coords = np.stack([rng.integers(0, size, 5) for size in sizes], axis=1).reshape(-1)
    return [levels, coords, np.zeros(5, np.float32 if name.endswith("f32") else np.float64)]


def stage_call(rng: Generator, name: str) -> Arguments:
    """A stage of one node, coded or not, and what lies below it."""
    extents = [some(rng, 1, 4, int(rng.integers(1, 3))) for _ in range(int(rng.integers(1, 4)))]
    here, order, last = root_places(extents), len(extents), bool(rng.random() < 0.3)
    arrays = random_stage(rng, here, order, last=last, coded=bool(rng.random() < 0.7))
    if name in ("encode_stage", "count_stage"):
        return [arrays, here, 1 << 18]
    if name == "next_stage":
        part = arrays["part"] or [np.zeros(rows, np.uint16) for rows in here["rows"]]
        return [arrays["shape"], arrays["children"], part, here]
    coded = _native.encode_stage(arrays, here)
    below = _native.next_stage(arrays["shape"], arrays["children"], arrays["part"], here) if not last else None
    rows = [0] * order if below is None else below["rows"].reshape(-1, order).sum(axis=0).tolist()
    header: dict[str, Any] = {
        "last": last, "step": 0.25 if arrays["coded"] else None, "raw": False, "largest": arrays["shape"],
        "next": (0 if below is None else below["rows"].size // order, rows)}
    return [header, here, [(np.frombuffer(data, np.uint8), counts) for data, counts in coded]]


def whole_call(rng: Generator, _: str) -> Arguments:
    sizes = some(rng, 2, 6, int(rng.integers(1, 4)))
    level = random_model(rng, sizes, levels=1, coded=1.0)[1][0]
    arrays: dict[str, Any] = {
        "step": level.step or 1.0, "shape": level.shape.reshape(-1), "cluster": list(level.cluster),
        "column": list(level.column), "core": level.core.view(np.uint16), "core_scale": level.core_scale,
        "basis": [basis.view(np.uint16) for basis in level.basis]}
    return [arrays, root_places([[size] for size in sizes])]


def blocks_call(rng: Generator, name: str) -> Arguments:
    sizes, blocks = some(rng, 1, 5, int(rng.integers(1, 4))), int(rng.integers(0, 4))
    decomposed = [bool(rng.random() < 0.8) for _ in sizes]
    cores = floats(rng, blocks * int(np.prod(sizes)))
    if name == "rank_boxes":
        return [cores, sizes, decomposed, 0.1, (1.0, 1.0, 0.5, 2.0), 100.0]
    bases = [floats(rng, blocks * size * size if own else 0) for size, own in zip(sizes, decomposed, strict=True)]
    ranks = [int(rng.integers(1, size + 1)) if own else size for size, own in zip(sizes, decomposed, strict=True)]
    return [cores, cores.copy(), bases, sizes, decomposed, np.tile(np.array(ranks, np.uint32), blocks), 0.1, 0.1]


CALLS: dict[str, Callable[[Generator, str], Arguments]] = {
    **dict.fromkeys(["fit_cells", "accumulate", "project_cells", "project_pair", "dense_basis", "orthonormalise"],
                    cells_call),
    **dict.fromkeys(["dictionary_gram", "solve_cores"], pairs_call),
    **dict.fromkeys(["gather", "scatter"], picked_call),
    **dict.fromkeys(["collect", "collect_scaled"], collect_call),
    "contract_lanes": lanes_call, "code_rows": rows_call,
    "magnitudes": lambda rng, _: [floats(rng, int(rng.integers(0, 50)))],
    **dict.fromkeys(["nearest_with_room", "cluster_rows"], kmeans_call),
    **dict.fromkeys(["decode_scattered_f32", "decode_scattered_f64", "decode_block"], model_call),
    **dict.fromkeys(["encode_stage", "count_stage", "decode_stage", "next_stage"], stage_call),
    "whole_stage": whole_call,
    **dict.fromkeys(["rank_boxes", "code_blocks"], blocks_call),
    "set_threads": lambda _, __: [2],
    "MapWatch": lambda _, __: [mmap.mmap(-1, 1 << 14)],
}


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Where something is within arguments: of lists, tuples and mappings what is in them too."""
    found = [path] if path else []
    if isinstance(value, list | tuple):
        items: list[tuple[Any, Any]] = list(enumerate(cast("list[Any]", value)))
    else:
        items = list(cast("dict[str, Any]", value).items()) if isinstance(value, dict) else []
    for key, item in items:
        found += places(item, (*path, key))
    return found


def changed(value: Any, path: tuple[Any, ...], other: Any) -> Any:
    """The arguments with something else at a place."""
    if not path:
        return other
    key, rest = path[0], path[1:]
    if isinstance(value, dict):
        mapping = cast("dict[str, Any]", value)
        return {**mapping, key: changed(mapping[key], rest, other)}
    items: list[Any] = list(value)
    items[key] = changed(items[key], rest, other)
    return type(value)(items)


def odd_array(rng: Generator, array: NDArray[Any]) -> Any:
    """An array that is not what it should be, in one way."""
    flat = array.reshape(-1)
    if flat.dtype == object:  # of an earlier change
        return flat
    wild = flat.copy()
    if wild.size and wild.dtype.kind in "iu":
        info = np.iinfo(wild.dtype)
        places = rng.integers(0, wild.size, 1 + wild.size // 8)
        wild[places] = rng.choice([0, 1, 2, 5, info.max, info.min, info.max // 2])
    elif wild.size:
        wild[rng.integers(0, wild.size)] = rng.choice([np.nan, np.inf, -np.inf, 0, 1e38])
    locked = flat.copy()
    locked.flags.writeable = False
    shifted = np.frombuffer(bytearray(flat.nbytes + 1), np.uint8)[1:].view(flat.dtype)
    return [
        wild, wild, wild, locked, shifted, np.repeat(flat, 2)[::2], flat[::-1], flat[:-1], flat[:0],
        np.concatenate([flat, flat]), flat.astype(np.float64), flat.astype(">i8"), flat.astype(object), flat.tolist(),
        flat.reshape(1, -1), np.broadcast_to(flat[:1], flat.shape) if flat.size else flat, None,
    ][int(rng.integers(0, 17))]


def odd(rng: Generator, value: Any, pool: list[Any]) -> Any:
    """Something else in the place of a value."""
    if isinstance(value, np.ndarray):
        array = cast("NDArray[Any]", value)
        return pool[int(rng.integers(0, len(pool)))] if pool and rng.random() < 0.15 else odd_array(rng, array)
    if isinstance(value, Rounds):
        return ROUNDS[int(rng.integers(0, len(ROUNDS)))]
    if isinstance(value, list):
        items = cast("list[Any]", value)
        return [items[:-1], items + items, [], items[::-1], None, items * 40][int(rng.integers(0, 6))]
    if isinstance(value, dict):
        return {}
    return ODD[int(rng.integers(0, len(ODD)))]


def at(value: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        value = value[key]
    return value


def one_call(rng: Generator, name: str) -> Arguments:
    """Arguments of a call, a few of them wrong."""
    arguments = CALLS[name](rng, name)
    for _ in range(int(rng.choice([0, 1, 1, 1, 2, 3]))):
        found = places(arguments)
        pool: list[Any] = [item for path in found if isinstance(item := at(arguments, path), np.ndarray)]
        path = found[int(rng.integers(0, len(found)))]
        arguments = changed(arguments, path, odd(rng, at(arguments, path), pool))
    return arguments


def main(seed: int, calls: int, log: Path) -> None:
    names = list(CALLS)
    with log.open("w", encoding="utf-8") as file:
        for number in range(calls):
            rng = np.random.default_rng([seed, number])
            name = names[number % len(names)]
            file.seek(0)
            file.truncate()
            file.write(f"{name}, seed {seed}, call {number}\n")
            file.flush()
            arguments = one_call(rng, name)
            try:
                getattr(_native, name)(*arguments)
            except Exception:
                continue
        file.seek(0)
        file.truncate()
        file.write("done\n")


def limit_memory() -> None:
    """What would take all memory of the machine fails, as it should fail with an exception."""
    import resource  # not on Windows

    resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))


if __name__ == "__main__":
    limit_memory()
    main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
