"""Coded runs: the native coder and its readable twin write the same bytes and read the same numbers from them."""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from coded_stages import random_stage, root_places
from hmkcta import _native as native
from hmkcta.storage import Node, Place, decode_run, encode_run
from hmkcta.storage.range_coder import CodeError

Array = NDArray[Any]
Case = tuple[int, dict[str, Any], dict[str, Array]]


def random_case(seed: int, stages: int, *, coded: bool = True) -> list[Case]:
    """Number of modes, arrays and places of each stage of a random tree."""
    rng = np.random.default_rng(seed)
    order = int(rng.integers(1, 5))
    extents = [[int(size) for size in rng.integers(1, 6, int(rng.integers(1, 4)))] for _ in range(order)]
    places, cases = root_places(extents), list[Case]()
    for t in range(stages):
        last = t == stages - 1
        stage = random_stage(rng, places, order, last=last, coded=coded, cells=0.3 if not last else 0.7)
        cases.append((order, stage, places))
        if last:
            break
        places = native.next_stage(stage["shape"], stage["children"], stage["part"], places)
        if not len(places["rows"]):
            break
    return cases


def places_of(order: int, places: dict[str, Array]) -> list[Place]:
    """Where each node lies."""
    own = [tuple(places["extents"][a:b].tolist()) for a, b in zip(places["ends"], places["ends"][1:], strict=False)]
    return [Place(tuple(own[s : s + order])) for s in range(0, len(own), order)]


def nodes_of(order: int, stage: dict[str, Any], places: list[Place]) -> list[Node]:
    """The nodes of flat arrays."""
    rest = {key: [iter(own.tolist()) for own in stage[key]] for key in ("cluster", "part", "column", "basis")}
    cores = iter(stage["core"].tolist())

    def take(source: Any, *shape: int) -> Array:
        return np.array([next(source) for _ in range(prod(shape))], np.int64).reshape(shape)

    nodes: list[Node] = []
    for s, place in enumerate(places):
        clusters, mixture, ranks = stage["shape"].reshape(-1, 3, order)[s].tolist()
        rows, adds = place.rows, max(ranks) > 0
        node = Node(
            int(adds) if adds or not max(clusters) else 2,
            int(adds and stage["children"][s] > 0),
            clusters,
            mixture,
            ranks,
        )
        cells = prod(clusters)
        node.core = take(cores, cells, *ranks) if adds and stage["coded"] else np.zeros(0)
        for n in range(order):
            of_part = take(rest["part"][n], rows[n]) if not stage["last"] else np.zeros(0)
            node.parts.append(of_part if stage["children"][s] else np.zeros(0))
            node.members.append(take(rest["cluster"][n], rows[n], mixture[n]))
            shape = (rows[n], mixture[n], cells // max(clusters[n], 1), ranks[n])
            has = adds and mixture[n] and stage["coded"]
            node.columns.append(take(rest["column"][n], cells, ranks[n]) if has else np.zeros(0))
            node.basis.append(take(rest["basis"][n], *shape) if has else np.zeros(0))
            node.grids.append(grid_of(node.parts[n], clusters[n], place.extents[n]) if node.kind == 2 else [])
        nodes.append(node)
    return nodes


def grid_of(parts: Array, clusters: int, extents: tuple[int, ...]) -> list[int]:
    """The rule of a grid by which rows go to their parts, if there is one; slowly."""
    from itertools import product

    from hmkcta.storage.run_code import grid_parts

    for grid in product(*(range(1, extent + 1) for extent in extents)):
        if prod(grid) == clusters and np.array_equal(grid_parts(grid, extents), parts):
            return list(grid)
    return []


def stated(order: int, stage: dict[str, Any], following: dict[str, Array] | None) -> dict[str, Any]:
    """What the header says of a stage."""
    largest = stage["shape"].reshape(-1, 3, order).max(axis=0, initial=0)
    rows = np.zeros((0, order), np.int64) if following is None else following["rows"].reshape(-1, order).astype(int)
    return {
        "last": stage["last"],
        "step": 0.37 if stage["coded"] else None,
        "raw": False,
        "largest": largest.reshape(-1).astype(np.uint32),
        "next": (len(rows), rows.sum(0).tolist()),
    }


def widened(order: int, nodes: list[Node]) -> tuple[Array, Array, list[Array]]:
    """Core, scales and bases as float16, by the text of the format."""
    core, scale = list[Array]([np.zeros(0)]), list[Array]([np.zeros(0)])
    basis = [list[Array]([np.zeros(0)]) for _ in range(order)]
    for node in nodes:
        if node.kind != 1:
            continue
        e = 0
        while np.abs(node.core).max(initial=0) * 2.0**-e > 2047:
            e += 1
        core.append((node.core.astype(np.float32) * np.float32(2.0**-e)).reshape(-1))
        scale.append(np.full(prod(node.clusters), np.float32(np.float32(0.37) * np.float32(2.0**e))))
        for n in range(order):
            if not node.mixture[n]:
                continue
            k = node.columns[n].reshape(*node.clusters, node.ranks[n])
            unit = np.where(k % 2 == 0, np.float32(1), np.float32(0.70710678118654752)) * np.float32(2.0) ** -(k // 2)
            own = np.moveaxis(unit, n, 0).reshape(node.clusters[n], -1, node.ranks[n]).astype(np.float32)
            basis[n].append((node.basis[n].astype(np.float32) * own[node.members[n]]).reshape(-1))
    with np.errstate(over="ignore"):
        flat = [np.concatenate(own).astype(np.float32).astype(np.float16) for own in basis]
        return (
            np.concatenate(core).astype(np.float32).astype(np.float16),
            np.concatenate(scale).astype(np.float32),
            flat,
        )


@pytest.mark.parametrize("seed", range(40))
def test_both_coders_write_the_same_bytes_and_read_the_same_numbers(seed: int) -> None:
    for order, stage, places in random_case(seed, 1 + seed % 3, coded=seed % 5 > 0):
        flags = {"last": stage["last"], "coded": stage["coded"]}
        runs = native.encode_stage(stage, places, 40 if seed % 2 else 10**6)
        own = places_of(order, places)
        nodes, at = nodes_of(order, stage, own), 0
        for data, counts in runs:
            part = slice(at, at + counts[0])
            assert encode_run(nodes[part], own[part], **flags) == data
            for read, node in zip(decode_run(data, own[part], **flags), nodes[part], strict=True):
                assert (read.kind, read.parted, read.clusters, read.mixture, read.ranks, read.grids) == (
                    node.kind,
                    node.parted,
                    node.clusters,
                    node.mixture,
                    node.ranks,
                    node.grids,
                )
                for name in ("members", "parts", "columns", "basis"):
                    for a, b in zip(getattr(read, name), getattr(node, name), strict=True):
                        assert np.array_equal(np.ravel(a), np.ravel(b)), name
                assert np.array_equal(np.ravel(read.core), np.ravel(node.core))
            at += counts[0]
        assert native.count_stage(stage, places, 40 if seed % 2 else 10**6) == sum(len(data) for data, _ in runs)


@pytest.mark.parametrize("seed", range(40))
def test_a_decoded_stage_is_what_was_coded_widened(seed: int) -> None:
    for order, stage, places in random_case(seed, 1 + seed % 3):
        following = _following(stage, places)
        runs = native.encode_stage(stage, places, 60)
        out = native.decode_stage(
            stated(order, stage, following), places, [(np.frombuffer(data, np.uint8), counts) for data, counts in runs]
        )
        for name in ("shape", "children"):
            assert np.array_equal(out[name], stage[name])
        for name in ("cluster", "column", *([] if stage["last"] else ["part"])):
            assert all(np.array_equal(a, b) for a, b in zip(out[name], stage[name], strict=True)), name
        core, scale, basis = widened(order, nodes_of(order, stage, places_of(order, places)))
        assert np.array_equal(out["core"].view(np.float16), core)
        assert np.array_equal(out["core_scale"], scale)
        assert all(np.array_equal(a.view(np.float16), b) for a, b in zip(out["basis"], basis, strict=True))
        if following is not None:
            assert all(np.array_equal(out["next"][name], following[name]) for name in ("rows", "extents", "ends"))
            assert all(map(np.array_equal, out["next"]["local"], following["local"]))


@pytest.mark.parametrize("seed", range(20))
def test_a_damaged_run_is_refused(seed: int) -> None:
    """A code ends with 0 and its last byte, so there is hardly any other."""
    rng = np.random.default_rng(seed)
    for order, stage, places in random_case(seed, 2):
        following = _following(stage, places)
        head = stated(order, stage, following)
        for data, counts in native.encode_stage(stage, places):
            for _ in range(10):
                bad = np.frombuffer(data, np.uint8).copy()
                bad[rng.integers(len(bad))] ^= 1 << rng.integers(8)
                bad = bad[: rng.integers(len(bad) + 1)] if rng.random() < 0.3 else bad
                with pytest.raises(ValueError, match=r"[a-z]+-[a-z]+"):
                    native.decode_stage(head, places, [(bad, [counts[0], len(bad), *counts[2:]])])


def test_a_code_of_anything_is_refused() -> None:
    for data in (b"", b"\xff" * 40, b"\0" * 3):
        with pytest.raises(CodeError):
            decode_run(data, [Place(((3,), (4,)))], last=True, coded=True)


def _following(stage: dict[str, Any], places: dict[str, Array]) -> dict[str, Array] | None:
    """Where the children lie."""
    if stage["last"]:
        return None
    return native.next_stage(stage["shape"], stage["children"], stage["part"], places)


@pytest.mark.parametrize(("extent", "grid"), [((7,), (3,)), ((5,), (5,)), ((4, 6), (2, 4)), ((1, 3), (1, 2))])
def test_segments_of_a_grid_are_as_equal_as_can_be(extent: tuple[int, ...], grid: tuple[int, ...]) -> None:
    from hmkcta.storage.run_code import grid_parts

    parts = grid_parts(grid, extent)
    shape = np.array([[[prod(grid)], [0], [0]]], np.uint32).reshape(-1)
    places = root_places([list(extent)])
    following = native.next_stage(shape, np.array([prod(grid)], np.uint32), [parts.astype(np.uint16)], places)
    assert np.array_equal(following["rows"], np.bincount(parts, minlength=prod(grid)))
    sides = following["extents"].reshape(-1, len(extent))
    assert np.array_equal(sides.prod(1), following["rows"])
    assert (np.ptp(sides, axis=0) <= 1).all()
