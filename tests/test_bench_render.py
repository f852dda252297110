"""`hmkcta bench render`: the paper's configurations, what decoding them costs by count, and rates on an adapter."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from cli_tools import refused, report, run
from gpu_tools import KINDS, Kind, adapter
from hmkcta import Model
from hmkcta._example import example_level, example_metadata
from hmkcta.errors import HmkctaError
from hmkcta.render.frame_cost import Cost, picked_cost
from hmkcta.render.gpu_decode import GpuDecoder
from hmkcta.render.layout import lay_out
from hmkcta.render.peak import Peak, measure_peak
from hmkcta.render.speed import element_cost, measure_speed, surface_cost
from hmkcta.render.workload import CONFIGURATIONS, Configuration, configuration, random_model

PEAK = Peak(1e12, 1e12)
SMALL = (
    Configuration("surface", "svbrdf", (12, 10, 24, 20), "R=2,2,3,3 C=2 K=1", 0.0, 1.0),
    Configuration("light field", "lightfield", (9, 24, 20, 6), "R=2,4,4,* C=2,2,2,1 K=1", 0.0, 1.0),
    Configuration("volume", "volume", (12, 10, 11, 5), "R=2,2,2,* / R=1,1,1,* C=2,2,2,1 K=2,2,2,1", 0.0, 1.0),
)


@pytest.mark.parametrize("config", CONFIGURATIONS, ids=lambda config: config.name)
def test_models_have_the_sizes_of_the_papers_tables(config: Configuration) -> None:
    numbers = sum(2 * level.numbers() for level in random_model(config).levels) / 2**20
    # The authors' jet is smaller than its cores alone: they must have dropped clusters.
    expected = 29.50 if config.name == "Turbulent Jet" else config.mebibytes
    assert abs(numbers - expected) <= 0.085


def test_an_element_costs_what_its_shape_says() -> None:
    # 16 cells of 2x2x3x3: 2 + 4 + 12 + 36 multiply-adds each, and 2 + 2 + 3 + 3 for the basis rows.
    cost = element_cost(random_model(configuration("WM1")))
    assert (cost.nodes, cost.cells, cost.multiply_adds) == (1, 16, 16 * (54 + 10))
    assert cost.coefficients == 16 * (36 + 10)


def test_rows_of_one_cluster_share_a_core() -> None:
    model = random_model(Configuration("one", "volume", (8, 8, 8, 4), "R=2,2,2,*", 0.0, 0.0))
    alone = picked_cost(model, {0: [3], 1: [3], 2: [3]})
    together = picked_cost(model, {0: [3, 4], 1: [3, 4], 2: [3, 4]})
    assert together.cells == alone.cells == 1
    assert together.multiply_adds == alone.multiply_adds + 6


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_weighted_sum_never_costs_more_than_its_elements(kind: Kind) -> None:
    model = kind.model()
    picks: dict[int, list[int]] = {axis: [0, size - 1] for axis, size in enumerate(model.shape) if size > 1}
    apart = Cost()
    for corner in product(*(picks.get(axis, [0]) for axis in range(model.ndim))):
        apart += picked_cost(model, {axis: [index] for axis, index in enumerate(corner)})
    assert picked_cost(model, picks).cells <= apart.cells


def test_colours_share_a_walk() -> None:
    model = random_model(SMALL[0])
    layout = lay_out(model.metadata.axes, "svbrdf")
    assert layout.channel is not None
    one, three = picked_cost(model, {}), picked_cost(model, {layout.channel: [0, 1, 2]}, channels=3)
    assert three.multiply_adds < 3 * one.multiply_adds
    assert surface_cost(model, layout).cells >= one.cells


@pytest.mark.parametrize("config", SMALL, ids=lambda config: config.name)
def test_rates_and_shares(config: Configuration) -> None:
    speed = measure_speed(adapter(), config, [(48, 32)], PEAK, seconds=0.02)
    assert speed.elements is not None
    assert speed.elements > 0
    changes = [frame.change for frame in speed.frames]
    assert changes == (["view"] if config.kind == "svbrdf" else ["view", "time"])
    for frame in speed.frames:
        assert frame.rate is not None
        assert frame.rate > 0
        if frame.cost is not None:
            assert frame.arithmetic == pytest.approx(frame.rate * frame.cost.flops / PEAK.flops)
            assert frame.bandwidth == pytest.approx(frame.rate * frame.cost.nbytes / PEAK.nbytes)


def test_peaks_are_measured() -> None:
    peak = measure_peak(adapter(), 0.01)
    assert peak.flops > 1e7
    assert peak.nbytes > 1e7


def test_what_software_would_not_finish_is_not_decoded() -> None:
    model = random_model(configuration("WM2"))
    decoder = GpuDecoder(model, adapter())
    assert decoder.refusal([3, 3, 3, 2, 2]) is None, "what a pixel of a material takes"
    picks = [5, 3, 5, 4, 4]
    refused = decoder.refusal(picks)
    assert (refused is not None) == adapter().software
    if refused is not None:
        with pytest.raises(HmkctaError) as caught:
            decoder.picked([(np.zeros((1, k), np.int64), np.ones((1, k), np.float32)) for k in picks])
        assert caught.value.reason == "software-loops"
    assert GpuDecoder(Model(example_metadata(), [example_level()]), adapter()).refusal() is None


def test_the_command_reports_rates() -> None:
    adapter()
    found = report("bench", "render", "-c", "WH1", "-r", "64x48", "--seconds", "0.01")
    assert [one["name"] for one in found["configurations"]] == ["WH1"]
    only = found["configurations"][0]
    assert only["elements_per_second"] > 0
    assert [(frame["width"], frame["height"]) for frame in only["frames"]] == [(64, 48)]
    assert only["frames"][0]["flops"] > 0


def test_unknown_configurations_and_resolutions_are_refused() -> None:
    assert "WH4" in refused("bench", "render", "-c", "WH9", code=2)
    assert "1280x720" in run("bench", "render", "-r", "64", code=2).stderr


def test_the_document_shows_the_counted_costs() -> None:
    text = (Path(__file__).parent.parent / "docs" / "rendering.md").read_text(encoding="utf-8")
    for name in ("WM1", "WH4"):
        model = random_model(configuration(name))
        element, pixel = element_cost(model), surface_cost(model, lay_out(model.metadata.axes, "svbrdf"))
        frame = pixel.times(1280 * 720)
        assert (f"| {name} | {element.multiply_adds:,.0f} | {element.nbytes:,.0f} | {pixel.multiply_adds:,.0f} | "
                f"{pixel.nbytes:,.0f} | {frame.flops / 1e9:.0f} | {frame.nbytes / 1e9:.0f} |") in text
