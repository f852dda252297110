"""What a file is to be: of an SNR at least, or of a size at most."""

from __future__ import annotations

import re
from math import inf
from numbers import Integral, Real

from .errors import expect, invalid

#: How far below a goal an SNR in dB may be and still be what was asked for: what is printed is rounded more.
_SLACK = 0.005
_UNITS = {"": 1, "B": 1, **{f"{p}B": 1000**n for n, p in enumerate("KMGT", 1)},
          **{f"{p}IB": 1024**n for n, p in enumerate("KMGT", 1)}}
#: How a time may be written.
TIME_ALLOWED = "seconds above 0, or a number with s, min or h"
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


def bytes_given(name: str, given: int | str | None) -> int | None:
    """What an argument says in bytes, which may be a text that has a unit.

    >>> bytes_given("size", "20 KiB"), bytes_given("size", 100)
    (20480, 100)

    Raises:
        HmkctaError: reason ``size``: the text is no number of bytes.
    """
    if not isinstance(given, str):
        return given
    number = read_bytes(given)
    if number is None:
        raise invalid("size", name, repr(given), BYTES_ALLOWED)
    return round(number) if number < inf else 0


def memory_given(given: int | str | None) -> int | None:
    """The bytes of the argument `max_memory`, as a whole number of Python's own.

    >>> memory_given("200MB"), memory_given(None)
    (200000000, None)

    Raises:
        HmkctaError: reason ``size`` of what is no positive number of bytes, ``argument-type`` of no number or text.
    """
    memory = bytes_given("max_memory", given)
    expect("max_memory", memory, Integral | None, "a whole number of bytes, or text such as 200MB")
    if memory is not None and memory < 1:
        raise invalid("size", "max_memory", memory, "a positive number of bytes")
    return None if memory is None else int(memory)


def read_seconds(text: str) -> float | None:
    """Seconds, written with or without a unit; None: it is no time.

    >>> read_seconds("90"), read_seconds("1.5 min"), read_seconds("soon")
    (90.0, 90.0, None)
    """
    found = re.fullmatch(r"([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*(|s|min|h)", text.strip())
    return None if found is None else float(found[1]) * {"": 1, "s": 1, "min": 60, "h": 3600}[found[2]]


def time_given(given: float | str | None) -> float | None:
    """The seconds of the argument `time`.

    >>> time_given("2 min"), time_given(None)
    (120.0, None)

    Raises:
        HmkctaError: reason ``time`` of what is no positive number of seconds, ``argument-type`` of no number or text.
    """
    expect("time", given, Real | str | None, "a number of seconds, or text such as 90s")
    seconds = read_seconds(given) if isinstance(given, str) else given
    if given is not None and (seconds is None or not 0 < seconds < inf):
        raise invalid("time", "time", repr(given), TIME_ALLOWED)
    return None if seconds is None else float(seconds)


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
