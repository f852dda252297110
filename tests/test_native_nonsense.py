"""Native functions called with arguments that contradict each other: an exception, never a panic, a fault or a hang."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hmkcta import Model, _native
from hmkcta._example import example_level, example_metadata
from hmkcta.backends.decoding import _flat_arrays  # pyright: ignore[reportPrivateUsage]
from hmkcta.errors import HmkctaError
from hmkcta.packed import PackedLevel

TESTS = Path(__file__).parent
CRATE = TESTS.parent / "crates" / "hmkcta-kernels"
NOTHING = np.zeros(0, np.float32)
NO_DOUBLES = np.zeros(0)


def test_random_nonsense(tmp_path: Path) -> None:
    """In a process of its own, so that one that dies says of what."""
    log, paths = tmp_path / "last call", os.pathsep.join([str(TESTS), str(TESTS.parent / "python")])
    command = [sys.executable, str(TESTS / "native_nonsense.py"), "5", "6000", str(log)]
    environment = {**os.environ, "PYTHONPATH": paths, "RUST_BACKTRACE": "0"}
    done = subprocess.run(command, timeout=300, capture_output=True, text=True, env=environment)
    last = log.read_text(encoding="utf-8").strip()
    assert (done.returncode, last) == (0, "done"), f"{last}: {done.stderr[-2000:]}"
    assert "panicked" not in done.stderr


def wide(order: int = 4) -> tuple[Any, list[Any]]:
    """A node whose tensor has 2^64 elements, which 64 bits count as none."""
    ones = [1] * order
    return ([2**16] * order, ones, ones, ones, [False] * order), [np.zeros(2**16, np.uint16)] * order


def small() -> tuple[Any, list[Any]]:
    return ([2, 3], [1, 1], [1, 1], [1, 1], [False, False]), [np.zeros(2, np.uint16), np.zeros(3, np.uint16)]


def read_only(count: int, dtype: Any = np.float32) -> Any:
    array = np.zeros(count, dtype)
    array.flags.writeable = False
    return array


def bases(*sizes: int) -> list[Any]:
    return [np.ones(size, np.float32) for size in sizes]


def overlapping_scatter() -> None:
    tensor = np.zeros(6, np.float32)
    _native.scatter(tensor, [6], [np.arange(3, dtype=np.uint32)], tensor[1:4])


def misaligned() -> Any:
    return np.frombuffer(bytearray(4 * 6 + 1), np.uint8)[1:].view(np.float32)


ONE = np.zeros(1, np.float32)
CALLS: dict[str, Callable[[], object]] = {
    "tensor wraps": lambda: _native.accumulate(*wide(), NOTHING, bases(*[2**16] * 4), ONE, 1.0),
    "tensor wraps, projected": lambda: _native.project_cells(*wide(), NOTHING, bases(*[2**16] * 4), 0),
    "tensor wraps, fitted": lambda: _native.fit_cells(*wide(), NOTHING, bases(*[2**16] * 4), ONE, 1, 1),
    "members wrap": lambda: _native.dense_basis(
        ([2**63], [2], [2], [1], [False]), [np.zeros(0, np.uint16)], 0, NOTHING),
    "clusters without end": lambda: _native.dense_basis(
        ([1], [2**40], [1], [1], [False]), [np.zeros(1, np.uint16)], 0, ONE),
    "result without end": lambda: _native.project_cells(
        ([1, 1], [1, 1], [1, 1], [1, 2**40], [False, False]), [np.zeros(1, np.uint16)] * 2, ONE, [ONE, ONE], 0),
    "lanes wrap": lambda: _native.contract_lanes(NOTHING, NOTHING, (2**32, 2**32, 1), 1, 1),
    "sums without end": lambda: _native.contract_lanes(NOTHING, NOTHING, (2**30, 0, 2**30), 1, 1),
    "gathered sizes wrap": lambda: _native.gather(NOTHING, [2**32, 2**32], [np.array([7], np.uint32)] * 2),
    "rows beyond": lambda: _native.gather(ONE, [1], [np.array([1], np.uint32)]),
    "rows descend": lambda: _native.gather(np.zeros(3, np.float32), [3], [np.array([1, 0], np.uint32)]),
    "misaligned tensor": lambda: _native.gather(misaligned(), [6], [np.arange(6, dtype=np.uint32)]),
    "read-only tensor": lambda: _native.scatter(read_only(3), [3], [np.arange(3, dtype=np.uint32)], bases(3)[0]),
    "block within the tensor": overlapping_scatter,
    "read-only residual": lambda: _native.fit_cells(*small(), read_only(6), bases(2, 3), ONE, 1, 1),
    "read-only basis": lambda: _native.orthonormalise(*small(), 0, read_only(2), ONE.copy()),
    "read-only out": lambda: _native.collect((np.zeros(2, np.uint8), read_only(2, np.uint8)), [np.arange(2)]),
    "not in one piece": lambda: _native.accumulate(*small(), np.zeros(12, np.float32)[::2], bases(2, 3), ONE, 1.0),
    "doubles": lambda: _native.magnitudes(np.zeros(3)),  # pyright: ignore[reportArgumentType]
    "offsets wrap": lambda: _native.collect(
        (np.zeros(2, np.uint8), np.zeros(1, np.uint8)), [np.array([-2**63]), np.array([-2**63])]),
    "offsets cancel": lambda: _native.collect(
        (np.zeros(2, np.uint8), np.zeros(1, np.uint8)), [np.array([2**62]), np.array([-2**62])]),
    "offset below": lambda: _native.collect((np.zeros(2, np.uint8), np.zeros(1, np.uint8)), [np.array([-1])]),
    "inner products wrap": lambda: _native.dictionary_gram((2**32, 2**32), [NO_DOUBLES] * 2, NOTHING, 0),
    "ranks of none": lambda: _native.solve_cores((0, 1), [NO_DOUBLES] * 2, NOTHING, NO_DOUBLES, 1),
    "rounds without end": lambda: _native.fit_cells(*small(), bases(6)[0], bases(2, 3), ONE.copy(), 2**62, 1),
    "no number of rounds": lambda: _native.solve_cores(
        (1,), [np.ones(1)], ONE.copy(), np.ones(1), float("nan")),  # pyright: ignore[reportArgumentType]
    "no round": lambda: _native.cluster_rows(np.zeros(2), np.zeros(1), 1, 2, 0),
    "no width": lambda: _native.cluster_rows(np.zeros(2), np.zeros(1), 0, 2, 1),
    "no room": lambda: _native.nearest_with_room(np.zeros(6), 2, 1),
    "sides wrap": lambda: _native.code_rows(NO_DOUBLES, NO_DOUBLES, [2**32, 2**32], 0, 1, None, 1, "greedy"),
    "no rows to code": lambda: _native.code_rows(np.ones(1), NO_DOUBLES, [1], 0, 1, None, 1, "optimal"),
    "subsets without end": lambda: _native.code_rows(
        np.eye(40).reshape(-1), np.ones(40), [40], 0, 1, None, 20, "optimal"),
    "levels without end": lambda: _native.decode_block(
        [_flat_arrays(example_level())] * 100_000, [np.zeros(1, np.int64)] * 2, 0, ONE.copy()),
    "modes without end": lambda: _native.accumulate(
        ([1] * 10**5, [1] * 10**5, [1] * 10**5, [1] * 10**5, [False] * 10**5), [np.zeros(1, np.uint16)] * 10**5,
        ONE.copy(), [ONE] * 10**5, ONE, 1.0),
    "threads of none": lambda: _native.set_threads(-1),
}


@pytest.mark.parametrize("name", CALLS)
def test_contradictions_are_exceptions(name: str) -> None:
    with pytest.raises((ValueError, TypeError, OverflowError, MemoryError, RuntimeError)):
        CALLS[name]()


def table(*numbers: int) -> Any:
    return np.array(numbers, np.uint32)


def large_shape(*shape: int) -> Any:
    return np.array(shape, np.uint32).reshape(1, 3, 2)


#: Levels that no file has, and that nothing but the kernels looks at.
LEVELS: dict[str, Callable[[PackedLevel], PackedLevel]] = {
    "core size wraps": lambda level: replace(
        level, shape=large_shape(2**31, 2**31, 1, 1, 2**31, 2**31), core=level.core[:0], core_offset=table(0, 0),
        core_scale=level.core_scale[:0], cell_offset=table(0, 0)),
    "cells wrap": lambda level: replace(level, shape=large_shape(2**32 - 1, 2**32 - 1, 1, 1, 1, 1)),
    "mixtures without end": lambda level: replace(
        level, shape=large_shape(1, 1, 2**31, 2**31, 1, 1), row_offset=(table(0, 0), table(0, 0)),
        cluster=(level.cluster[0][:0], level.cluster[0][:0]),  # pyright: ignore[reportOptionalSubscript]
        cluster_offset=(table(0, 0),) * 2, basis_offset=(table(0, 0),) * 2,
        basis=(level.basis[0][:0], level.basis[0][:0])),  # pyright: ignore[reportOptionalSubscript]
    "more subsets than clusters": lambda level: replace(level, shape=large_shape(1, 1, 2, 2, 1, 1)),
    "offsets descend": lambda level: replace(level, row_offset=(table(2, 0), table(3, 0))),
    "offsets beyond": lambda level: replace(level, core_offset=table(0, 2**32 - 1)),
    "no cluster of that number": lambda level: replace(
        level, cluster=(np.full(2, 9, np.uint16), np.full(3, 9, np.uint16))),
    "short tables": lambda level: replace(level, cluster_offset=(table(0), table(0))),
    "no tables": lambda level: replace(level, cluster=(None, None)),
    "children beyond": lambda level: replace(level, child=table(7, 8)),
    "parts beyond": lambda level: replace(
        level, child=table(0, 1), part=(np.full(2, 9, np.uint16),) * 2, local=(table(0, 0),) * 2),
    "parts too few": lambda level: replace(
        level, child=table(0, 1), part=(np.zeros(0, np.uint16),) * 2, local=(table(),) * 2),
    "local rows beyond": lambda level: replace(
        level, child=table(0, 1), part=(np.zeros(2, np.uint16), np.zeros(3, np.uint16)),
        local=(table(9, 9), table(9, 9, 9))),
    "other number types": lambda level: replace(level, shape=level.shape.astype(np.float64)),
    "wide numbers": lambda level: replace(level, core=level.core.astype(np.float32)),
    "no arrays": lambda level: replace(level, core=None),
    "lists": lambda level: replace(level, core_offset=[0, 1]),
}


@pytest.mark.parametrize("name", LEVELS)
@pytest.mark.parametrize("deep", [False, True])
def test_models_made_by_hand_are_refused_where_they_are_decoded(name: str, deep: bool) -> None:
    broken = LEVELS[name](example_level())
    below = example_level()
    metadata = example_metadata()
    levels = [broken, below] if deep else [broken]
    both = replace(metadata, stages=metadata.stages * len(levels), quality=metadata.quality * len(levels))
    model = Model(both, levels)
    leads_down = ("children beyond", "parts beyond", "parts too few", "local rows beyond")
    if name in leads_down and not deep:
        return  # nothing is looked for below the last level
    for decode in (lambda: model[...], lambda: model[1, 2], lambda: model[[0, 1], [2, 0]]):
        with pytest.raises(HmkctaError, match="level-arrays"):
            decode()


def test_rows_are_not_taken_for_others() -> None:
    """Those that 32 bits do not count were another element's."""
    from hmkcta.backends.decoding import add_block, decode_batches

    for row in (-1, 2**32, 2**32 + 1, -2**63, 2**63 - 1):
        with pytest.raises(HmkctaError, match=r"has (a|no) row"):
            decode_batches([example_level()], np.array([[row, 0]]), np.zeros(1, np.float32))
        with pytest.raises(HmkctaError, match=r"has (a|no) row"):
            add_block([example_level()], [np.array([row]), np.array([0])], np.zeros((1, 1), np.float32))


def test_more_threads_than_help_are_not_made() -> None:
    program = ("from hmkcta import _native; import numpy as np, os\n_native.set_threads(2**40)\n"
               "n = 10**6\nnode = ([n], [1], [1], [1], [False]), [np.zeros(n, np.uint16)]\n"
               "one = np.ones(n, np.float32)\n_native.accumulate(*node, np.zeros(n, np.float32), [one], one[:1], 1)\n"
               "print(len(os.listdir('/proc/self/task')) if os.path.exists('/proc/self/task') else 1)")
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60,
                          env={**os.environ, "PYTHONPATH": str(TESTS.parent / "python")})
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 8 * (os.cpu_count() or 1) + 40


def test_every_function_is_called_with_nonsense() -> None:
    from native_nonsense import CALLS as called

    functions = {name for name in dir(_native) if not name.startswith("_")}
    assert functions == set(called)
    texts = [path.read_text(encoding="utf-8") for path in (CRATE / "src").glob("*.rs")]
    declared = re.compile(r"#\[py(?:function|class).*\]\n(?:#\[.*\n)*(?:pub )?(?:fn|struct) (\w+)")
    assert {name for text in texts for name in declared.findall(text)} == functions


def test_no_kernel_runs_where_a_panic_would_get_out() -> None:
    """All run by `guard::run`; and linters and the tests' profile see to what unsafe code promises."""
    for path in (CRATE / "src").glob("*.rs"):
        assert path.name == "guard.rs" or ".detach(" not in path.read_text(encoding="utf-8"), path.name
    settings = (CRATE / "Cargo.toml").read_text(encoding="utf-8")
    for line in ('undocumented_unsafe_blocks = "deny"', "debug-assertions = true", "overflow-checks = true"):
        assert line in settings
