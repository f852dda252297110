"""Goals compared with nodes for clusters along two axes at a time, and with two levels of bytes."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from hmkcta import compress
from hmkcta.comparing.alternatives import FEW_NODES, joined
from hmkcta.plan import parse_plan

VOLUME = (("time",), ("y",), ("x",))


@cache
def head() -> NDArray[np.float32]:
    """What an ellipsoid holds, moving a little, and nothing outside."""
    x, y, z, t = np.ogrid[-1:1:20j, -1:1:24j, -1:1:16j, 0:1:12j]
    still = 3 + np.sin(5 * x + 3 * y * z) + np.cos(7 * y - 4 * x * z)
    moving = np.sin(9 * x * y + z) * np.sin(6 * t) + np.cos(8 * y * z - x) * np.cos(11 * t)
    inside = (x / 0.85) ** 2 + (y / 0.9) ** 2 + (z / 0.8) ** 2 < 1
    return np.where(inside, still + 0.05 * moving, 0).astype(np.float32)


def test_a_size_holds_what_an_outline_parts() -> None:
    """It came to 35.9 dB, of a plan that merges no axes."""
    model = compress(head(), axes="x,y,z,t", size=6000)
    assert model.nbytes <= 6000
    assert model.snr > 42
    assert any(len(mode) == 2 for mode in model.plan.organisation)


def test_more_db_take_more_bytes() -> None:
    """36 dB took 6,036 bytes, and 40 dB 5,704."""
    fewer, more = (compress(head(), axes="x,y,z,t", snr=snr) for snr in (36, 40))
    assert (fewer.snr >= 36, more.snr >= 40) == (True, True)
    assert fewer.nbytes < more.nbytes < 5700


def test_an_organisation_that_is_given_stays() -> None:
    model = compress(head(), axes="x,y,z,t", size=6000, organisation="x, y, z, t")
    assert [len(mode) for mode in model.plan.organisation] == [1, 1, 1, 1]


def test_pairs_of_axes_are_joined_where_a_plan_has_few_parts() -> None:
    few = list(joined(parse_plan(f"R=1 grid=y:{FEW_NODES} / R<=8", VOLUME), VOLUME))
    assert [plan.organisation for plan in few] == [
        (("time", "y"), ("x",)), (("time", "x"), ("y",)), (("time",), ("y", "x"))
    ]
    assert [plan.levels[0].clusters for plan in few] == [(4, 1), (4, 1), (1, 4)]
    assert not list(joined(parse_plan(f"R=1 grid=y:{FEW_NODES + 1} / R<=8", VOLUME), VOLUME))
    assert not list(joined(parse_plan("R<=8", VOLUME[1:]), VOLUME[1:]))


def test_a_second_level_of_bytes_is_tried_wherever_one_of_them_falls_short() -> None:
    """In float16 numbers 56 dB took 6,424 bytes, and 54 in two levels of bytes 4,172."""
    a, b, c, d = np.ogrid[0:2:16j, 0:2:24j, 0:2:24j, 0:2:24j]
    bump = np.exp(-6 * ((b - 1) ** 2 + (c - 1) ** 2 + (d - 1 - 0.3 * np.sin(3 * a)) ** 2))
    model = compress(np.sin(a + 2 * b) * np.cos(3 * c + a) + bump, axes="a,b,c,d", snr=56)
    assert model.snr >= 56
    assert model.nbytes < 4600
    assert [level.bits for level in model.plan.levels] == [8, 8]
