"""What callers from Python say in words: sizes with units, and organisations, which may be lists of names instead."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hmkcta import HmkctaError, compress, estimate, open_array, parse_plan

WAVE: NDArray[np.float64] = np.add.outer(np.sin(np.arange(20) / 3), np.arange(18.0) / 9)


def refused(**options: Any) -> HmkctaError:
    with pytest.raises(HmkctaError) as caught:
        compress(WAVE, **options)
    return caught.value


def test_a_size_may_be_written_with_a_unit() -> None:
    assert compress(WAVE, size="2 KiB").nbytes <= 2048
    error = refused(size="twenty")
    assert (error.reason, error.found) == ("size", "'twenty'")
    assert "KiB" in str(error)


def test_so_may_memory(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "a.npz", WAVE)
    model = compress(WAVE, "R=2", max_memory="300 MB")
    assert model.nbytes == compress(WAVE, "R=2").nbytes
    assert np.array_equal(model.reconstruct(max_memory="100KB"), model.reconstruct())
    assert np.array_equal(open_array(tmp_path / "a.npz", max_memory="100KB"), WAVE)
    calls: tuple[Callable[..., object], ...] = (
        partial(compress, WAVE, "R=2"), partial(estimate, WAVE, snr=20), model.reconstruct)
    for call in calls:
        sentences: list[str] = []
        for memory in (1000, "1 KB", "lots"):
            with pytest.raises(HmkctaError) as caught:
                call(max_memory=memory)
            sentences.append(str(caught.value))
        assert sentences[0] == sentences[1]
        assert sentences[2].startswith("max_memory: found 'lots', allowed bytes, or a number with KB")


def test_an_organisation_may_be_lists_of_names() -> None:
    assert compress(WAVE, "R=1", organisation=[["axis1", "axis0"]]).metadata.organisation == (("axis1", "axis0"),)
    plan = parse_plan("R=1", (("axis1",), ("axis0",)))
    assert estimate(WAVE, snr=20, organisation=plan.organisation).organisation == plan.organisation
    assert compress(WAVE, plan, organisation=plan.organisation).metadata.organisation == plan.organisation


@pytest.mark.parametrize("names", [[["axis0, axis1"]], [["axis0+axis1"]], [["axis0"], []], [["y"], ["x"]], []], ids=str)
def test_names_that_are_not_those_of_the_axes_are_refused(names: list[list[str]]) -> None:
    assert refused(organisation=names).reason == "organisation"


@pytest.mark.parametrize(("given", "where"), [
    ({"axis0": 1}, "organisation"), (["axis0", "axis1"], "mode of the organisation"),
    ([["axis0"], [1]], "name of an axis"),
], ids=str)
def test_what_names_no_axes_of_modes_is_told_what_does(given: object, where: str) -> None:
    error = refused(organisation=given)
    assert (error.reason, error.where) == ("argument-type", where)
    assert '(("light", "rgb"), ("view",)' in str(error)
