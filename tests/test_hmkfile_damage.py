"""Damage never goes unnoticed: every truncation, every flipped bit, windows of wrong bytes, and resource bombs."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

import hmkcta
from hmk_corpus import FIXTURES, MAGIC, Parts
from hmkcta.errors import HmkctaError, Kind
from hmkcta.hmkfile import Limits, loads
from make_fixture import MODELS

FILES = {name: (FIXTURES / f"v1-{name}.hmk").read_bytes() for name in MODELS}
PYTHON = Path(__file__).parent.parent / "python"


def verdict(data: bytes | bytearray, *, verify: bool = True) -> HmkctaError | None:
    """What the reader says of some bytes; None if it takes them."""
    try:
        loads(data, verify=verify)
    except HmkctaError as error:
        return error
    return None


@pytest.mark.parametrize("name", FILES)
def test_every_truncation_is_insufficient_data(name: str) -> None:
    for size in range(0, len(FILES[name]), 1 if name == "small" else 5):
        error = verdict(FILES[name][:size])
        assert error is not None, size
        assert (error.kind, error.reason) == (Kind.INSUFFICIENT_DATA, "truncated"), (size, error)


@pytest.mark.parametrize("name", FILES)
def test_every_flipped_bit_is_refused(name: str) -> None:
    """All bits of the small file; of each byte of the others one."""
    data, drawn = bytearray(FILES[name]), np.random.default_rng(0).integers(8, size=len(FILES[name])).tolist()
    for at in range(len(data)):
        for bit in range(8) if name == "small" else (drawn[at],):
            data[at] ^= 1 << bit
            assert verdict(data) is not None, (at, bit)
            data[at] ^= 1 << bit
    assert verdict(data) is None


@pytest.mark.parametrize("width", [1, 2, 5, 16])
def test_sliding_damage_is_refused(width: int) -> None:
    rng = np.random.default_rng(width)
    for whole in FILES.values():
        for at in range(0, len(whole), 7):
            window = rng.integers(256, size=width, dtype=np.uint8).tobytes()
            bad = whole[:at] + window + whole[at + width :]
            assert bad[: len(whole)] == whole or verdict(bad) is not None, at


def test_an_extra_byte_is_refused() -> None:
    error = verdict(FILES["small"] + b"\0")
    assert error is not None
    assert error.reason == "trailing-bytes"


@pytest.mark.parametrize("name", FILES)
def test_forged_sections_are_refused_or_decode(name: str) -> None:
    """Checksums that fit say nothing of the meaning: whatever is in a section, the reader comes to a verdict."""
    rng = np.random.default_rng(0)
    parts = Parts.split(FILES[name])
    for _ in range(300):
        forged = Parts(parts.text, list(parts.sections))
        number = int(rng.integers(len(forged.sections)))
        section = bytearray(forged.sections[number])
        for _ in range(int(rng.integers(1, 4))):
            section[rng.integers(len(section))] = int(rng.integers(256))
        forged.sections[number] = bytes(section)
        data = forged.join()
        if verdict(data) is None:
            for stage in loads(data)[1]:
                assert np.isfinite(stage.core).all()


@pytest.mark.parametrize("name", FILES)
def test_forged_headers_are_refused_or_decode(name: str) -> None:
    """Numbers of the header changed at random, its checksum made anew."""
    rng = np.random.default_rng(1)
    parts = Parts.split(FILES[name])
    digits = [at for at, byte in enumerate(parts.text) if 48 <= byte < 58]
    for _ in range(400):
        text = bytearray(parts.text)
        for at in rng.choice(digits, 2):
            text[at] = int(rng.integers(48, 58))
        verdict(Parts(bytes(text), parts.sections).join())


def test_without_verification_checksums_of_sections_alone_are_not_compared() -> None:
    name, last = "half", len(FILES["half"]) - 1
    bad = FILES[name][:last] + bytes([FILES[name][last] ^ 1])
    assert verdict(bad) is not None
    assert verdict(bad, verify=False) is None
    assert verdict(bad[:30] + b"?" + bad[31:], verify=False) is not None


def bomb(**stage: object) -> bytes:
    """A file of one small section whose header states a lot."""
    axes = [{"name": "x", "size": 2**32 - 1}]
    head = {
        "nodes": 1,
        "step": 1.0,
        "largest": [[1], [1], [1]],
        "rows": [2**32 - 1],
        "runs": [[1, 40, 1, 1, 2**32 - 1]],
    }
    header = {
        "axes": axes,
        "organisation": [[0]],
        "dtype": "float32",
        "stages": [{**head, **stage}],
        "quality": [{"snr_db": 1.0, "rmse": 1.0, "max_abs_error": 1.0}],
    }
    text = json.dumps(header, separators=(",", ":")).encode()
    payload = bytes(40)
    return (
        MAGIC
        + struct.pack("<III", 1, len(text), zlib.crc32(text))
        + text
        + payload
        + struct.pack("<I", zlib.crc32(payload))
    )


BOMBS = {
    "basis": bomb(),
    "core": bomb(runs=[[1, 40, 1, 2**32 - 1, 9]]),
    "cells": bomb(runs=[[1, 40, 2**32 - 1, 1, 9]]),
    "undecomposed": bomb(largest=[[1], [0], [2**32 - 1]], runs=[[1, 40, 1, 2**32 - 1, 0]]),
}


@pytest.mark.parametrize("name", BOMBS)
def test_bombs_are_refused_before_memory_is_taken(name: str, tmp_path: Path) -> None:
    error = verdict(BOMBS[name])
    assert error is not None
    assert (error.kind, error.reason) == (Kind.RESOURCE_LIMIT, "widened-limit")
    assert "hmkcta.Limits(widened=" in error.hint
    assert "MiB" in str(error)
    path = tmp_path / "bomb.hmk"
    path.write_bytes(BOMBS[name])
    program = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_AS, (2 << 30,) * 2)\n"
        f"sys.path.insert(0, {str(PYTHON)!r}); import hmkcta\n"
        f"try: hmkcta.open({str(path)!r})\nexcept hmkcta.HmkctaError as error: print(error.reason)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "widened-limit"


def test_whoever_trusts_a_file_raises_the_limit() -> None:
    """Then the run is read, which does not hold what the header states."""
    data = bomb(rows=[1000], runs=[[1, 40, 1, 1, 1000]]).replace(b'"size":4294967295', b'"size":1000')
    text = data[20 : data.index(bytes(40))]
    sound = Parts(text, [bytes(40)]).join()
    with pytest.raises(HmkctaError) as caught:
        loads(sound, limits=Limits(widened=2**30))
    assert caught.value.reason in ("code-end", "run-count")


CUT = """
import os, sys
import hmkcta
from hmkcta.hmkfile import read
frame_of = read.frame_of

def then_cut(view, *how):
    frame = frame_of(view, *how)
    os.truncate(sys.argv[1], int(sys.argv[2]))
    return frame

if sys.argv[3] == "opening":
    read.frame_of = then_cut
model = hmkcta.open(sys.argv[1])
os.truncate(sys.argv[1], int(sys.argv[2]))
print(model[...].tobytes().hex(), model.metadata.axes[0].coords.tolist())
"""


@pytest.mark.parametrize("left", [0, 100, 5000])
def test_a_file_that_is_cut_short_while_it_is_open(left: int, tmp_path: Path) -> None:
    """It is an error while it is read, and nobody's business afterwards; never a signal."""
    path = tmp_path / "cut.hmk"
    values = np.random.default_rng(0).random((3000, 8), np.float32)
    model = hmkcta.compress(values, "R=8,8", axes=(hmkcta.Axis("y", 3000, coords=np.sqrt(np.arange(3000.0))), "x"))
    said: dict[str, subprocess.CompletedProcess[str]] = {}
    for when in ("opening", "afterwards"):
        model.save(path, overwrite=True)
        said[when] = subprocess.run([sys.executable, "-c", CUT, str(path), str(left), when], capture_output=True,
                                    text=True, env={**os.environ, "PYTHONPATH": str(PYTHON)})
    assert (said["afterwards"].returncode, said["afterwards"].stderr) == (0, "")
    numbers, coords = said["afterwards"].stdout.split(maxsplit=1)
    assert numbers == model[...].tobytes().hex()
    assert json.loads(coords) == np.sqrt(np.arange(3000.0)).tolist()
    assert said["opening"].returncode == 1
    assert "InsufficientData/truncated" in said["opening"].stderr.splitlines()[-1]
