"""One door for all formats."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from numpy.typing import DTypeLike, NDArray

from ..errors import invalid
from .npy import MAGIC, ZIP_MAGICS, open_npy, open_npz
from .raw import open_raw
from .source import io_error, opened


def open_array(
    uri: str | Path, *, member: str | None = None, shape: Sequence[int] | None = None, dtype: DTypeLike | None = None,
    order: str = "C", offset: int = 0,
) -> NDArray[Any]:
    """Open a file as an array, memory-mapped where possible.

    Args:
        uri: a `.npy` file, an `.npz` archive (``file.npz:member`` for one of several arrays), or raw binary.
        member: the array of an `.npz` archive, instead of in the uri.
        shape: of raw binary.
        dtype: of raw binary, as NumPy writes it; ``>f4`` is big-endian float32.
        order: of raw binary: "C" (last axis fastest) or "F".
        offset: bytes to skip at the start of raw binary.

    Raises:
        HmkctaError: the file cannot be read, is damaged or shorter than it says, or holds no real numbers.

    >>> import numpy as np, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.save(f"{folder}/a.npy", np.eye(2, dtype=">f4"))
    ...     open_array(f"{folder}/a.npy").tolist()
    [[1.0, 0.0], [0.0, 1.0]]
    """
    path, inner = _split(str(uri))
    member = member if member is not None else inner
    if shape is not None or dtype is not None:
        if shape is None or dtype is None:
            missing = "shape" if shape is None else "dtype"
            raise invalid("raw-description", missing, "none", "both shape and dtype, which raw binary needs",
                          f"give the {missing} too, or neither for .npy and .npz")
        return open_raw(path, shape, dtype, order, offset)
    with opened(path) as file:
        start = file.read(len(MAGIC))
    if start.startswith(ZIP_MAGICS):
        return open_npz(path, member)
    if start != MAGIC:
        raise _unknown(path, start)
    if member is not None:
        raise invalid("npz-member", f"member of {path}", repr(member), "none, as a .npy file holds one array")
    return open_npy(path)


def _split(uri: str) -> tuple[Path, str | None]:
    """Path and member of ``file.npz:member``; a file of that very name comes first."""
    left, colon, right = uri.rpartition(":")
    if colon and left.lower().endswith(".npz") and "\0" not in uri and not Path(uri).exists():
        return Path(left), right
    return Path(uri), None


def _unknown(path: Path, start: bytes) -> Exception:
    if path.suffix in (".npy", ".npz"):
        found = "an empty file" if not start else f"{len(start)} bytes that begin another format"
        return io_error("source-damaged", str(path), found, f"a complete {path.suffix} file", "fetch it again")
    return io_error("source-format", str(path), "neither .npy nor .npz", ".npy, .npz, or raw binary that is described",
                    "say shape and dtype of raw binary, e.g. --shape 64,64,3 --dtype float32")
