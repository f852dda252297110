"""Memory that runs out: the project's own error, with advice that can be followed, and never a plain `MemoryError`."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest

import hmkcta
from cli_tools import run, saved, smooth
from hmkcta import HmkctaError, Model
from hmkcta.cli import main
from hmkcta.measure import measure

SOURCE = smooth(6, 8, 10)


def runs_out(*_: Any, **__: Any) -> Any:
    raise MemoryError("Unable to allocate 10 TiB")


@pytest.fixture(scope="module")
def model() -> Model:
    return hmkcta.compress(SOURCE, "R=2")


@pytest.fixture
def file(model: Model, tmp_path: Path) -> Path:
    model.save(tmp_path / "a.hmk")
    return tmp_path / "a.hmk"


CALLS: dict[str, Callable[[Model], object]] = {
    "an element": lambda m: m[1, 2, 3], "a slab": lambda m: m[1:3], "elements": lambda m: m[[1, 2], [3, 4], [5, 6]],
    "all": lambda m: m.reconstruct(), "into": lambda m: m.reconstruct(np.empty(m.shape, np.uint8)),
    "array": np.asarray, "array of integers": lambda m: np.asarray(m, np.uint8),
    "sample": lambda m: m.sample([1, 2, 3.5]), "measure": lambda m: measure(m, SOURCE),
}


@pytest.mark.parametrize("call", CALLS)
def test_in_python(call: str, model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    for place in ("hmkcta.model.decode_block", "hmkcta.model.decode_elements", "hmkcta.measure.add_level"):
        monkeypatch.setattr(place, runs_out)
    with pytest.raises(HmkctaError, match="there is none left") as caught:
        CALLS[call](model)
    assert (caught.value.kind.label, caught.value.reason) == ("ResourceLimit", "memory")
    assert caught.value.hint


def test_open(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for place in ("check_largest", "frame_of", "decode_stage"):
        with monkeypatch.context() as patched:
            patched.setattr(f"hmkcta.hmkfile.read.{place}", runs_out)
            with pytest.raises(HmkctaError, match="ResourceLimit/memory"):
                hmkcta.open(file)
    monkeypatch.setattr("hmkcta.readers.npy.np.memmap", runs_out)
    monkeypatch.setattr("hmkcta.readers.source.np.memmap", runs_out)
    with pytest.raises(HmkctaError, match="ResourceLimit/memory"):
        hmkcta.open_array(saved(file.with_name("a.npy"), SOURCE))


PLACES = {
    "info": "hmkcta.hmkfile.read.check_largest", "verify": "hmkcta.measure.add_level",
    "decompress": "hmkcta.model.decode_block", "render": "hmkcta.hmkfile.read.check_largest",
    "compress": "hmkcta.encode.fit_plan", "plan": "hmkcta.cli.plan.describe_source",
}


@pytest.mark.parametrize("command", PLACES)
def test_commands_advise_what_they_have(command: str, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, output = saved(file.with_name("a.npy"), SOURCE), file.with_name("out")
    words = {"info": (file,), "verify": (file, "--against", source), "decompress": (file, "-o", f"{output}.npy"),
             "render": (file, "-o", f"{output}.png"), "compress": (source, "-o", f"{output}.hmk", "--plan", "R=2"),
             "plan": (source, "--plan", "R=2")}[command]
    monkeypatch.setattr(PLACES[command], runs_out)
    sentence = run(command, *words, code=6).stderr.splitlines()[-1]
    assert "[ResourceLimit/memory]" in sentence
    found = main.get_command(click.Context(main), command)
    assert found is not None
    held = {option for param in found.params for option in param.opts}
    advice = sentence.partition("Next: ")[2].partition("[ResourceLimit")[0]
    assert advice
    assert set(re.findall(r"--[a-z-]+", advice)) <= held
    assert not re.search(r"numpy|\bindex\b|max_memory", advice)
