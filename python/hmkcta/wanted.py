"""What a file is to be: a goal with its bounds, for which a plan is chosen, or a plan that is given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from .axes import check_organisation, format_organisation, organisation_text
from .errors import invalid
from .goals import bytes_given, check_goal, memory_given
from .plan import AUTO, Plan, parse_plan
from .streaming.source import Source

#: Without a goal no bytes are spent beyond this SNR: neither eyes nor screens of 8 bits see more.
DEFAULT_SNR = 50.0


@dataclass(frozen=True)
class Wanted:
    """What a file has to be: the arguments of `compress` that say so.

    >>> Wanted(snr=None, size=None, decode_cost=4096, organisation=None, max_memory=None).ceiling
    50.0
    """

    snr: float | None
    size: int | None
    decode_cost: int
    organisation: str | None
    max_memory: int | None

    @property
    def ceiling(self) -> float | None:
        """The SNR in dB beyond which no bytes are spent, where there is no goal."""
        return DEFAULT_SNR if self.snr is None and self.size is None else None


def the_goal(snr: float | None, size: int | str | None) -> tuple[float | None, int | None]:
    """The goal in Python's own numbers, whose range NumPy's may not have.

    >>> the_goal(None, "20 KiB")
    (None, 20480)

    Raises:
        HmkctaError: both are given; the SNR is no finite number above 0; the size is no number of bytes from 1 on.
    """
    size = bytes_given("size", size)
    check_goal(snr, size)
    if snr is not None and size is not None:
        raise invalid("two-goals", "goal", "snr and size", "one of them", "leave one of them out")
    return None if snr is None else float(snr), None if size is None else int(size)


def read_plan(
    plan: Plan | str, source: Source, wanted: Wanted, scheme: str | None = None, search: str | None = None
) -> Plan:
    """A given plan with what the call says beside it: nothing of that is passed over.

    Without a `scheme` or a `search` those of a `Plan` count, and ``auto`` for a text.

    Raises:
        HmkctaError: the text is no plan, or the plan says another organisation than the call.

    >>> import numpy as np
    >>> from hmkcta.streaming.source import prepare
    >>> wanted = Wanted(snr=30.0, size=None, decode_cost=4096, organisation=None, max_memory=None)
    >>> plan = read_plan("R=2", prepare(np.ones((6, 4)), None, None, None, 1), wanted)
    >>> plan.organisation, plan.snr
    ((('axis0',), ('axis1',)), 30.0)
    """
    modes = None if wanted.organisation is None else source.organisation(wanted.organisation)
    if isinstance(plan, str):
        read = parse_plan(plan, modes or source.organisation(None), scheme or AUTO)
        levels = tuple(replace(level, asked=search or AUTO) for level in read.levels)
        return replace(read, levels=levels, snr=wanted.snr, size=wanted.size)
    own = check_organisation(tuple(map(tuple, plan.organisation)), source.axes)
    if modes not in (None, own):
        raise invalid("organisation", "organisation", repr(wanted.organisation),
                      f"{format_organisation(own)!r}, the plan's", "leave it out beside a Plan")
    levels = plan.levels if scheme is None else [
        level if level.grid else replace(level, scheme=scheme) for level in plan.levels]
    levels = levels if search is None else [replace(level, asked=search) for level in levels]
    goal = {} if wanted.snr is None and wanted.size is None else {"snr": wanted.snr, "size": wanted.size}
    return replace(plan, organisation=own, levels=tuple(levels), **goal)


def wanted_of(
    snr: float | None, size: int | None, decode_cost: int, organisation: str | Sequence[Sequence[str]] | None,
    max_memory: int | str | None,
) -> Wanted:
    """The arguments as numbers of Python's own, and the organisation as text, checked.

    Raises:
        HmkctaError: an organisation that is neither text nor lists of names, or a memory that is no number of bytes.
    """
    return Wanted(snr, size, int(decode_cost), organisation_text(organisation), memory_given(max_memory))
