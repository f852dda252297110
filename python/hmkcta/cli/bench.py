"""`hmkcta bench`: how fast this machine is, at the paper's parameters."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import click

from .options import CONTEXT, Command, ExamplesFirst, json_option, verbose_option
from .output import emit, table
from .param_type import ParamType

if TYPE_CHECKING:
    from ..render.device import Device
    from ..render.peak import Peak
    from ..render.speed import FrameRate, Speed

EXAMPLES = (
    "hmkcta bench render",
    "hmkcta bench render --configuration WH4 --resolution 1280x720",
    "hmkcta bench render --json",
)
#: Sizes of frames on a GPU, and where a processor stands in for one.
SIZES, SOFTWARE_SIZES = ((1280, 720), (1920, 1080)), ((256, 256),)


class Resolution(ParamType[tuple[int, int]]):
    """Width and height of a frame.

    >>> Resolution().convert("1280x720", None, None)
    (1280, 720)
    """

    name = "WxH"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Read it, or end with what is wrong."""
        if isinstance(value, tuple):
            return value  # pyright: ignore[reportUnknownVariableType]  # what an earlier call has made
        found = re.fullmatch(r"([1-9][0-9]{0,3})x([1-9][0-9]{0,3})", str(value).strip())
        if found is None or max(sides := (int(found[1]), int(found[2]))) > 8192:
            self.fail(f"{value!r} is no resolution: write width x height up to 8192, such as 1280x720.", param, ctx)
        return sides


class Bench(ExamplesFirst, click.Group):
    """The group of benchmarks, with the examples that documents show."""

    examples = EXAMPLES


@click.group("bench", cls=Bench, context_settings=CONTEXT)
def bench_command() -> None:
    """Measure how fast this machine is, at the paper's parameters."""


@bench_command.command("render", cls=Command, examples=EXAMPLES)
@click.option("-c", "--configuration", "names", multiple=True, metavar="NAME",
              help="Column of the paper's tables, such as WH4; may be repeated (default: all).")
@click.option("-r", "--resolution", "sizes", multiple=True, type=Resolution(), metavar="WxH",
              help="Size of frames; may be repeated (default: 1280x720 and 1920x1080, 256x256 without a GPU).")
@click.option("--seconds", type=click.FloatRange(0.01, 600), default=1.0, metavar="N",
              help="About how long each measurement takes (default 1).")
@json_option
@verbose_option
def bench_render_command(names: tuple[str, ...], sizes: tuple[tuple[int, int], ...], seconds: float, as_json: bool,
                         verbose: bool) -> None:
    """Decoded elements and frames a second at the paper's parameters, with random numbers for coefficients.

    Beside them stand the arithmetic and the bytes that a frame needs, counted, and their shares of the most that the
    adapter was measured to do. Reads that caches serve are counted too: their share can exceed 100 %.
    """
    from ..render.device import shared_device
    from ..render.peak import measure_peak
    from ..render.speed import measure_speed
    from ..render.workload import CONFIGURATIONS, configuration

    del verbose
    chosen = [configuration(name) for name in names] or CONFIGURATIONS
    device = shared_device()
    used = sizes or (SOFTWARE_SIZES if device.software else SIZES)
    peak = measure_peak(device, seconds)
    if not as_json:
        click.echo(_heading(device, peak))
    speeds: list[Speed] = []
    for config in chosen:
        speeds.append(measure_speed(device, config, used, peak, seconds, patient=bool(names)))
        if not as_json:
            click.echo("\n" + _as_text(speeds[-1]))
    if as_json:
        emit({"adapter": device.name, "backend": device.backend, "software": device.software, "peak_flops": peak.flops,
              "peak_bytes_per_second": peak.nbytes, "configurations": [_as_json(speed) for speed in speeds]})


def _heading(device: Device, peak: Peak) -> str:
    lines = [f"{device}: at most {peak.flops / 1e9:.4g} GFLOP/s, {peak.nbytes / 1e9:.4g} GB/s copying"]
    if device.software:
        lines.append("A processor stands in for a GPU: frames are smaller by default, and rates say nothing of GPUs.")
    return "\n".join(lines)


def _as_text(speed: Speed) -> str:
    config, cost = speed.configuration, speed.element_cost
    elements = "not decoded here" if speed.elements is None else f"{speed.elements:.3g} elements/s"
    paper = f"paper: {config.rate:g} frames/s on a TITAN RTX"
    lines = [f"{config.name} ({config.kind}, {config.mebibytes:.2f} MiB, {paper})",
             f"  {elements}, each {cost.multiply_adds:.0f} multiply-adds and {cost.nbytes / 1e3:.1f} kB of reads"]
    lines += [f"  {speed.note}"] if speed.note else []
    rows = [_row(frame) for frame in speed.frames]
    header = ["  size", "change", "frames/s", "GFLOP", "GB read", "of FLOP/s", "of copying"]
    notes = list(dict.fromkeys(f"  {frame.note}" for frame in speed.frames if frame.note))
    return "\n".join([*lines, table(header, rows, left=(0, 1)), *notes])


def _row(frame: FrameRate) -> list[str]:
    def shown(value: float | None, text: str) -> str:
        return "-" if value is None else text.format(value)

    cost = frame.cost
    return [f"  {frame.width}x{frame.height}", frame.change, shown(frame.rate, "{:.4g}"),
            shown(cost and cost.flops / 1e9, "{:.3g}"), shown(cost and cost.nbytes / 1e9, "{:.3g}"),
            shown(frame.arithmetic, "{:.1%}"), shown(frame.bandwidth, "{:.1%}")]


def _as_json(speed: Speed) -> dict[str, Any]:
    config, cost = speed.configuration, speed.element_cost
    return {
        "name": config.name, "kind": config.kind, "plan": config.plan, "mebibytes": config.mebibytes,
        "paper_frames_per_second": config.rate, "elements_per_second": speed.elements, "note": speed.note,
        "element": {"multiply_adds": cost.multiply_adds, "bytes": cost.nbytes},
        "frames": [{"width": frame.width, "height": frame.height, "change": frame.change,
                    "frames_per_second": frame.rate, "flops": frame.cost and frame.cost.flops,
                    "bytes": frame.cost and frame.cost.nbytes, "share_of_flops": frame.arithmetic,
                    "share_of_copying": frame.bandwidth, "note": frame.note} for frame in speed.frames],
    }
