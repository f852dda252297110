"""Pictures stay what they were when somebody last looked at them."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from hmkcta.synthetic import Dataset
from render_references import FOLDER, SCENES, originals, picture

#: Of 255: pictures come from float32 sums, whose order may differ between machines.
CLOSE, MOST_BEYOND = 2, 0.002


@pytest.fixture(scope="module")
def data() -> dict[str, Dataset]:
    return originals()


@pytest.mark.parametrize("name", SCENES)
def test_pictures_are_those_of_the_references(name: str, data: dict[str, Dataset]) -> None:
    with Image.open(FOLDER / f"{name}.png") as stored:
        reference = np.asarray(stored).astype(int)
    assert reference.std() > 10, "something is to be seen"
    difference = np.abs(picture(name, data) - reference).max(axis=2)
    assert (difference > CLOSE).mean() <= MOST_BEYOND, f"up to {difference.max()} of 255"


def test_every_reference_has_its_scene() -> None:
    assert {path.stem for path in FOLDER.glob("*.png")} == set(SCENES)
