"""What a file is to be: of an SNR at least, or of a size at most."""

from __future__ import annotations

import re
from math import inf
from numbers import Real

from .errors import expect, invalid

#: How far below a goal an SNR in dB may be and still be what was asked for: what is printed is rounded more.
_SLACK = 0.005
_UNITS = {"": 1, "B": 1, **{f"{p}B": 1000**n for n, p in enumerate("KMGT", 1)},
          **{f"{p}IB": 1024**n for n, p in enumerate("KMGT", 1)}}
#: How a size may be written.
BYTES_ALLOWED = "bytes, or a number with KB, KiB, MB, MiB, GB or GiB"


def read_bytes(text: str) -> float | None:
    """Bytes, written with or without a unit; None: it is no size.

    >>> read_bytes("20MiB"), read_bytes("1.5 kB"), read_bytes("large")
    (20971520.0, 1500.0, None)
    """
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*([A-Za-z]*)", text.strip())
    unit = _UNITS.get(found[2].upper()) if found else None
    return None if found is None or unit is None else float(found[1]) * unit


def check_goal(snr: float | None, size: float | None, of: str = "") -> None:
    """Refuse what is no SNR in dB, or no number of bytes; None: it is no goal.

    >>> check_goal(0, None)
    Traceback (most recent call last):
        ...
    hmkcta.errors.HmkctaError: snr: found 0, allowed a finite number of dB above 0, which an empty file has. \
[InvalidArgument/snr]
    """
    expect(f"snr{of}", snr, Real | None, "a number of dB")
    expect(f"size{of}", size, Real | None, "a number of bytes")
    if snr is not None and not 0 < snr < inf:
        raise invalid("snr", f"snr{of}", snr, "a finite number of dB above 0, which an empty file has")
    if size is not None and not 1 <= size < inf:
        raise invalid("size", f"size{of}", size, "a positive number of bytes")


def misses(snr: float, goal: float | None) -> bool:
    """Whether an SNR in dB is below a goal, if there is one.

    >>> misses(29.0, 30.0), misses(29.999, 30.0), misses(29.0, None)
    (True, False, False)
    """
    return goal is not None and snr < goal - _SLACK
