"""What an adapter can do at most, measured: multiply-adds in registers, and bytes copied in its memory."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from .device import Device
from .prelude import shader

#: Invocations of the multiply-adding shader; operations of each: 256 turns, 4 chains of 4 lanes, 2 a multiply-add.
_INVOCATIONS, _OPERATIONS = 1 << 18, 256 * 4 * 4 * 2
#: Bytes of a copy: more than caches hold.
_COPIED = 1 << 26
#: How many times as much a GPU gets at once, as it would otherwise wait for what hands it the work.
_AT_ONCE = 16


@dataclass(frozen=True)
class Peak:
    """The most of an adapter: floating point operations and bytes (read plus written) a second."""

    flops: float
    nbytes: float


def measure_peak(device: Device, seconds: float) -> Peak:
    """Measure both, each for about `seconds`."""
    layout, times = device.layout("peak", ["storage"]), 1 if device.software else _AT_ONCE
    results = device.room("peak", 16 * _INVOCATIONS * times)
    group = device.group("peak", layout, [results])
    work = device.pipeline("multiply_add", shader("peak"), [layout])
    arithmetic = rate(device, lambda: device.dispatch(work, [group], (_INVOCATIONS // 64, times, 1)), seconds)
    source, target = device.room("source", _COPIED), device.room("target", _COPIED)
    copies = rate(device, lambda: _copy(device, source, target, times), seconds)
    return Peak(arithmetic * times * _INVOCATIONS * _OPERATIONS, 2 * copies * times * _COPIED)


def rate(device: Device, submit: Callable[[], None], seconds: float) -> float:
    """How often a second work is done, as a mean over about `seconds`, submitted in batches that double.

    The first run, which compiles and fills caches, does not count.
    """
    fence = device.room("fence", 4)
    submit()
    device.read(fence)
    count, batch, started = 0, 1, time.perf_counter()
    while True:
        for _ in range(batch):
            submit()
        device.read(fence)
        count, batch = count + batch, 2 * batch
        elapsed = time.perf_counter() - started
        if elapsed >= seconds:
            return count / elapsed


def _copy(device: Device, source: Any, target: Any, times: int) -> None:
    encoder = device.gpu.create_command_encoder(label="copy")
    for _ in range(times):
        encoder.copy_buffer_to_buffer(source, 0, target, 0, _COPIED)
    device.gpu.queue.submit([encoder.finish()])
