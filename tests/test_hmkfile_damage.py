"""Damage never goes unnoticed: every truncation, every flipped bit, windows of wrong bytes, and resource bombs."""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hmk_corpus import FIXTURES, Parts
from hmkcta.axes import name_axes, separate
from hmkcta.errors import HmkctaError, Kind
from hmkcta.hmkfile import encode, load, loads
from hmkcta.hmkfile.schema import NUMPY_TYPES
from hmkcta.packed import LevelBounds, LevelQuality, Metadata, PackedLevel
from literal_decode import element

SMALL = (FIXTURES / "v1.0-small.hmk").read_bytes()
MERGED = (FIXTURES / "v1.0-merged.hmk").read_bytes()
EIGHT = (FIXTURES / "v1.1-eight.hmk").read_bytes()
MIXED = (FIXTURES / "v1.1-mixed.hmk").read_bytes()
SHORT_EIGHT = (FIXTURES / "v1.2-eight.hmk").read_bytes()
SHORT_MIXED = (FIXTURES / "v1.2-mixed.hmk").read_bytes()
LONE = (FIXTURES / "v1.2-lone.hmk").read_bytes()
PACKED = (FIXTURES / "v1.4-packed.hmk").read_bytes()
PARTLY = (FIXTURES / "v1.4-partly.hmk").read_bytes()
BITS = (FIXTURES / "v1.4-bits.hmk").read_bytes()
PYTHON = Path(__file__).parent.parent / "python"


def verdict(data: bytes | bytearray) -> HmkctaError | None:
    """What the reader says of some bytes; None if it takes them."""
    try:
        loads(data)
    except HmkctaError as error:
        return error
    return None


@pytest.mark.parametrize(("data", "step"),
                         [(SMALL, 1), (EIGHT, 1), (MERGED, 7), (MIXED, 7), (LONE, 1), (SHORT_MIXED, 7), (PACKED, 1),
                          (PARTLY, 7), (BITS, 7)],
                         ids=["small", "eight", "merged", "mixed", "lone", "short mixed", "packed", "partly", "bits"])
def test_every_truncation_is_insufficient_data(data: bytes, step: int) -> None:
    for size in range(0, len(data), step):
        error = verdict(data[:size])
        assert error is not None, size
        assert (error.kind, error.reason) == (Kind.INSUFFICIENT_DATA, "truncated"), (size, error)


def test_truncated_and_empty_files(tmp_path: Path) -> None:
    for size in (0, 1, 8, 100, len(SMALL) - 1):
        path = tmp_path / f"{size}.hmk"
        path.write_bytes(SMALL[:size])
        with pytest.raises(HmkctaError) as caught:
            load(path)
        assert caught.value.kind is Kind.INSUFFICIENT_DATA


@pytest.mark.parametrize("small", [SMALL, EIGHT, SHORT_EIGHT, LONE, PACKED],
                         ids=["small", "eight", "short eight", "lone", "packed"])
def test_every_flipped_bit_is_reported(small: bytes) -> None:
    assert 2048 <= len(small) <= 8192
    data = bytearray(small)
    unnoticed: list[tuple[int, int]] = []
    for position in range(len(data)):
        for bit in range(8):
            data[position] ^= 1 << bit
            if verdict(data) is None:
                unnoticed.append((position, bit))
            data[position] ^= 1 << bit
    assert not unnoticed
    assert verdict(data) is None


@pytest.mark.parametrize("whole", [MERGED, MIXED, SHORT_MIXED, LONE, PARTLY, BITS],
                         ids=["merged", "mixed", "short mixed", "lone", "partly", "bits"])
@pytest.mark.parametrize("width", [1, 4, 16])
def test_sliding_damage_is_reported(width: int, whole: bytes) -> None:
    rng = np.random.default_rng(width)
    for begin in range(0, len(whole) - width + 1, 41):
        window = whole[begin:begin + width]
        for new in (bytes(width), b"\xff" * width, rng.bytes(width), window[::-1]):
            if new == window:
                continue
            damaged = whole[:begin] + new + whole[begin + width:]
            assert verdict(damaged) is not None, (begin, new)


def test_extra_byte_is_reported() -> None:
    for extra in (b"\0", b" ", SMALL):
        error = verdict(SMALL + extra)
        assert error is not None
        assert error.reason == "trailing-bytes"


@pytest.mark.parametrize(("base", "sizes"), [(MERGED, (72, 6, 2)), (MIXED, (24, 7, 2)), (SHORT_MIXED, (24, 7, 2)),
                                            (LONE, (9, 7, 2)), (PACKED, (5, 3)), (PARTLY, (24, 7, 2)),
                                            (BITS, (6, 5, 4))],
                         ids=["merged", "mixed", "short mixed", "lone", "packed", "partly", "bits"])
@pytest.mark.parametrize("seed", range(3))
def test_forged_files_are_refused_or_decode(seed: int, base: bytes, sizes: tuple[int, ...]) -> None:
    """With checksums made anew, whatever the reader takes must decode everywhere to finite numbers."""
    rng = np.random.default_rng(seed)
    parts = Parts.split(base)
    for _ in range(120):
        forged = Parts(parts.header, parts.text, dict(parts.arrays))
        for name in rng.choice([name for name in parts.arrays if name.startswith("level")], int(rng.integers(1, 3))):
            dtype, shape, data = forged.arrays[name]
            numbers = np.frombuffer(data, NUMPY_TYPES[dtype]).copy()
            at = int(rng.integers(numbers.size))
            other = int(rng.integers(numbers.size))
            numbers[at] = rng.choice([0, 1, 2, (numbers[at:at + 1] + numbers.dtype.type(1))[0], numbers[other]])
            forged.arrays[name] = (dtype, shape, numbers.tobytes())
            forged.record(name)
        try:
            _, levels = loads(forged.join())
        except HmkctaError:
            continue
        for _ in range(5):
            assert np.isfinite(element(levels, [int(rng.integers(size)) for size in sizes], len(levels)))


def test_payload_damage_needs_verification() -> None:
    damaged = MERGED[:-1] + bytes([MERGED[-1] ^ 1])
    error = verdict(damaged)
    assert error is not None
    assert error.reason == "array-crc"
    crc = "0x[0-9a-f]{8}"
    said = rf"found stored bytes whose checksum \(CRC-32\) is {crc}, allowed {crc}, as the metadata say\."
    assert re.search(said, str(error))
    loads(damaged, verify=False)


BOMB = """
import resource, sys, numpy
sys.path[:0] = sys.argv[1:2]
from hmkcta.errors import HmkctaError
from hmkcta.hmkfile import load
resource.setrlimit(resource.RLIMIT_AS, (900 << 20, 900 << 20))
for path in sys.argv[2:]:
    try:
        load(path)
    except HmkctaError as error:
        sys.stdout.write(error.reason + " ")
"""


def bombs() -> dict[str, bytes]:
    """Small files that declare huge things, with the reason for which each must be refused."""
    deep = b'{"__metadata__":' + b"[" * 5_000_000
    huge = (b'{"__metadata__":{"hmkcta":"","hmkcta_sha256":"' + hashlib.sha256(b"").hexdigest().encode() + b'"},'
            b'"a":{"dtype":"F64","shape":[1000000000,1000000],"data_offsets":[0,8000000000000000]}}')
    short = zero_root_with_rows(2**32 - 1, bits=8)
    # A level more, of no nodes: nothing in the file says how many rows go nowhere.
    deeper = Parts.split(short)
    metadata = json.loads(deeper.text)
    deeper.text = json.dumps(metadata | {"levels": metadata["levels"] * 2, "quality": metadata["quality"] * 2})
    for name, (dtype, shape, data) in list(deeper.arrays.items()):
        other = name.replace("level/1", "level/2")
        deeper.arrays[other] = (dtype, [0, *shape[1:]], b"") if "shape" in name else (dtype, shape, data)
        deeper.record(other)
    deeper.arrays = {"level/1/child": ("U8", [2], bytes(2)), **deeper.arrays}
    deeper.record("level/1/child")
    return {"json-depth": frame(deep), "truncated": frame(huge),
            "header-too-large": (2**40).to_bytes(8, "little") + b"{" + bytes(99),
            "array-missing": deeper.join(), "ok": zero_root_with_rows(2**32 - 1), "ok too": short}


def test_a_merged_mode_has_no_more_rows_than_offsets_tell() -> None:
    parts = Parts.split(zero_root_with_rows(2**16, bits=8))
    metadata = json.loads(parts.text)
    axes = [{**metadata["axes"][0], "name": name, "size": 2**16} for name in "uv"]
    parts.text = json.dumps(metadata | {"axes": axes, "organisation": [["u", "v"]]})
    with pytest.raises(HmkctaError) as told:
        loads(parts.join())
    assert (told.value.reason, told.value.where) == ("array-shape", "level/1/shape")


def frame(header: bytes) -> bytes:
    """A file with this header and no arrays."""
    header += b" " * (-len(header) % 8)
    return len(header).to_bytes(8, "little") + header


def zero_root_with_rows(size: int, bits: int = 16) -> bytes:
    """A valid file of an all-zero tensor: billions of elements in a few bytes, no array to back them."""
    axes = name_axes((size,))
    none, numbers = np.zeros(2, np.uint32), np.empty(0, np.float16)
    level = PackedLevel(np.zeros((1, 3, 1), np.uint32), None, (np.array([0, size], np.uint32),), numbers, none,
                        np.empty(0, np.float32), none, (np.empty(0, np.uint16),), (none,), (numbers,), (none,),
                        (None,), (None,), bits)
    metadata = Metadata("float32", axes, separate(axes), (LevelBounds((0,), (0,), (0,), "most"),),
                        quality=(LevelQuality(float("inf"), 0.0, 0.0),))
    return b"".join(encode(metadata, (level,)))


@pytest.mark.skipif(sys.platform != "linux", reason="needs a limit on the address space")
def test_bombs_are_refused_before_allocation(tmp_path: Path) -> None:
    paths: list[str] = []
    for reason, data in bombs().items():
        path = tmp_path / f"{reason}.hmk"
        path.write_bytes(data)
        paths.append(str(path))
    result = subprocess.run([sys.executable, "-c", BOMB, str(PYTHON), *paths], capture_output=True, text=True,
                            check=False, timeout=60)
    expected = ["json-depth", "truncated", "header-too-large", "array-missing"]
    assert (result.stderr, result.stdout.split()) == ("", expected)
