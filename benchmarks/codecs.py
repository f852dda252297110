"""Codecs without random access to elements, at a byte budget: what storing alone may take.

TTHRESH, SPERR, SZ3 and zfp are what simulations are stored by, x265 is a video codec. None of them decodes a single
element by itself, so they are no peers of hmkcta, but say what random access costs. Each is used where its package or
program is there: SPERR, SZ3 and zfp come with imagecodecs, x265 with imageio-ffmpeg, and TTHRESH is a program that
``--tthresh PATH`` or the variable `HMKCTA_TTHRESH` names, or that is on the path.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from importlib import import_module
from math import prod, sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]

#: Names the TTHRESH program.
TTHRESH_VARIABLE = "HMKCTA_TTHRESH"
#: How often a codec's knob is tried for a budget, and which share of the budget ends it.
TRIES, FULL = 16, 0.99
#: Axes of so few indices are channels: they come first, where codecs expect what is not smooth.
CHANNELS = 4
#: Bits of x265's samples, and its preset.
VIDEO_BITS, PRESET = 12, "medium"
#: Smaller pictures are padded to it: x265 builds have corrupted their memory on 32 x 40.
SMALLEST_PICTURE = 64

#: Encodes and decodes with a knob from 0, finest, to 1, coarsest: bytes, and the values that a decoder has.
Codec = Callable[[F32, float], tuple[int, F32]]


class Missing(Exception):
    """A codec's package or program is not there; the message says what to install."""


def best_within(codec: Codec, values: F32, budget: int) -> tuple[float, int] | None:
    """Squared error and bytes of the finest knob within a budget, by bisection; None: the coarsest is beyond it."""
    fine, coarse = 0.0, 1.0
    best: tuple[float, int] | None = None
    for _ in range(TRIES):
        knob = (fine + coarse) / 2
        nbytes, decoded = codec(values, knob)
        if nbytes > budget:
            fine = knob
            continue
        coarse = knob
        error = float(np.square(values - decoded, dtype=np.float64).sum())
        best = (error, nbytes) if best is None else min(best, (error, nbytes))
        if nbytes >= FULL * budget:
            break
    return best


def sperr(values: F32, knob: float) -> tuple[int, F32]:
    """SPERR of a stack of three axes, at bits per value."""
    codecs = _package("imagecodecs", "imagecodecs")
    stack = merged(values, 3)
    data = codecs.sperr_encode(stack, _between(24.0, 0.002, knob), "bpp")
    return len(data), _as(values, codecs.sperr_decode(data))


def sz3(values: F32, knob: float) -> tuple[int, F32]:
    """SZ3 of four axes at most, at an absolute error."""
    codecs = _package("imagecodecs", "imagecodecs")
    stack = merged(values, 4)
    data = codecs.sz3_encode(stack, "abs", abs=_tolerance(values, knob))
    return len(data), _as(values, codecs.sz3_decode(data, stack.shape, np.float32))


def zfp(values: F32, knob: float) -> tuple[int, F32]:
    """zfp of four axes at most, at an absolute error (its blocks are decoded alone only with an index of them)."""
    codecs = _package("imagecodecs", "imagecodecs")
    data = codecs.zfp_encode(merged(values, 4), _tolerance(values, knob), mode="a")
    return len(data), _as(values, codecs.zfp_decode(data))


def x265(values: F32, knob: float) -> tuple[int, F32]:
    """x265 of pictures along the last two axes that are no channels; three channels are decorrelated, and 4:4:4."""
    program = str(_package("imageio_ffmpeg", "imageio-ffmpeg").get_ffmpeg_exe())
    frames = merged(values, 4) if _channels(values) == 3 else merged(values, 3)[None]
    if len(frames) == 3:
        frames = np.tensordot(_DECORRELATED, frames, axes=1)
    height, width = frames.shape[2:]
    more = [(0, max(size + size % 2, SMALLEST_PICTURE) - size) for size in (height, width)]
    frames = np.pad(frames, [(0, 0), (0, 0), *more], mode="edge")
    low, high = float(frames.min()), float(frames.max())
    scale = (2**VIDEO_BITS - 1) / max(high - low, 1e-30)
    samples = np.round((frames - low) * scale).astype("<u2")
    layout = "yuv444p12le" if len(frames) == 3 else "gray12le"
    raw = ["-f", "rawvideo", "-pix_fmt", layout]
    size = ["-s", f"{frames.shape[3]}x{frames.shape[2]}", "-r", "25"]
    data = _piped([program, *raw, *size, "-i", "-", "-c:v", "libx265", "-preset", PRESET, "-x265-params",
                   f"crf={51 * knob:.2f}:info=0:log-level=none", "-f", "hevc", "-"],
                  np.ascontiguousarray(samples.swapaxes(0, 1)).tobytes())
    back = np.frombuffer(_piped([program, "-f", "hevc", "-i", "-", *raw, "-"], data), "<u2")
    planes = back.reshape(samples.swapaxes(0, 1).shape).swapaxes(0, 1).astype(np.float32) / scale + low
    planes = planes[:, :, :height, :width]
    if len(frames) == 3:
        return len(data), _as(values, np.tensordot(_DECORRELATED.T, planes, axes=1))
    return len(data), _as(values, planes[0])


def tthresh(values: F32, knob: float) -> tuple[int, F32]:
    """TTHRESH of all axes, at a relative error."""
    program = os.environ.get(TTHRESH_VARIABLE) or shutil.which("tthresh")
    if program is None or shutil.which(program) is None:
        raise Missing(f"TTHRESH: build it, and name the program by --tthresh or {TTHRESH_VARIABLE}")
    with tempfile.TemporaryDirectory() as folder:
        source, packed, back = (str(Path(folder) / name) for name in ("values.raw", "packed", "back.raw"))
        values.tofile(source)
        # Its first axis runs fastest.
        sizes = [str(size) for size in values.shape[::-1]]
        _piped([program, "-i", source, "-t", "float", "-s", *sizes, "-e", f"{_between(1e-6, 1.0, knob):.9g}",
                "-c", packed, "-o", back], b"")
        return Path(packed).stat().st_size, np.fromfile(back, np.float32).reshape(values.shape)


CODECS: dict[str, Codec] = {"TTHRESH": tthresh, "SPERR": sperr, "SZ3": sz3, "zfp": zfp, "x265": x265}

#: Orthonormal axes of grey and of two differences of colour.
_DECORRELATED: F32 = np.array(
    [[1 / sqrt(3)] * 3, [1 / sqrt(2), 0, -1 / sqrt(2)], [1 / sqrt(6), -2 / sqrt(6), 1 / sqrt(6)]], np.float32)


def _channels(values: NDArray[Any]) -> int:
    """Indices of the last axis where that has channels, else 0."""
    return values.shape[-1] if values.ndim > 2 and values.shape[-1] <= CHANNELS else 0


def merged(values: F32, most: int) -> F32:
    """The values with channels first and leading axes merged, so that there are `most` axes; fewer are padded by 1.

    >>> merged(np.zeros((5, 6, 7, 8, 3), np.float32), 4).shape
    (3, 30, 7, 8)
    >>> merged(np.zeros((5, 6, 7, 3), np.float32), 3).shape
    (15, 6, 7)
    """
    moved = np.moveaxis(values, -1, 0) if _channels(values) else values
    shape = (1,) * max(0, most - moved.ndim) + moved.shape
    kept = 1 if most == 4 else 0
    middle = prod(shape[kept : len(shape) - 2])
    return np.ascontiguousarray(moved.reshape(*shape[:kept], middle, *shape[-2:]))


def _as(values: F32, decoded: NDArray[Any]) -> F32:
    """What `merged` made of an array, as that array again."""
    if not _channels(values):
        return decoded.reshape(values.shape)
    return np.moveaxis(decoded.reshape(values.shape[-1], *values.shape[:-1]), 0, -1)


def _between(fine: float, coarse: float, knob: float) -> float:
    return fine * (coarse / fine) ** knob


def _tolerance(values: F32, knob: float) -> float:
    """An absolute error between a millionth of the range and many times all of it, which zfp takes for granted."""
    return _between(1e-6, 256.0, knob) * max(float(np.ptp(values)), 1e-30)


def _package(module: str, package: str) -> Any:
    try:
        return import_module(module)
    except ImportError as failed:
        raise Missing(f"pip install {package}") from failed


def _piped(command: Sequence[str], given: bytes) -> bytes:
    done = subprocess.run(command, input=given, capture_output=True, check=False)
    if done.returncode:
        raise Missing(f"{Path(command[0]).name} failed: {done.stderr.decode(errors='replace').strip()[-200:]}")
    return done.stdout
