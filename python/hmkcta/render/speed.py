"""The speed of decoding and rendering at the paper's parameters (`hmkcta bench render`), against the adapter's peak."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import prod

import numpy as np

from ..model import Model
from .device import Device
from .frame_contraction import contractable, set_numbers
from .frame_cost import Cost, mean_cost
from .gpu_decode import GpuDecoder
from .gpu_path import GpuPath
from .layout import Layout, lay_out
from .peak import Peak, rate
from .scene import Camera, Light, Look, Scene, Surface
from .tree import tree_of
from .workload import Configuration, random_model

#: Scattered elements that are decoded at once, and pixels whose cost is counted.
_ELEMENTS, _COUNTED = 1 << 16, 48
#: What a software adapter is not asked to decode for a frame unless the configuration is named.
_MOST_IN_SOFTWARE = 1 << 20


@dataclass(frozen=True)
class FrameRate:
    """Frames a second of one kind of change.

    Attributes:
        width, height: pixels.
        change: what changes from frame to frame: ``view`` or ``time``.
        rate: frames a second; None where it was not measured, for the reason in `note`.
        cost: of a frame, counted; of a light field's or a volume's view, where nothing is decoded, None.
        arithmetic, bandwidth: shares of the adapter's peaks; reads that caches serve count as well.
        note: why there is no rate.
    """

    width: int
    height: int
    change: str
    rate: float | None
    cost: Cost | None
    arithmetic: float | None = None
    bandwidth: float | None = None
    note: str = ""


@dataclass(frozen=True)
class Speed:
    """A configuration's results: scattered elements a second, their cost, and frame rates."""

    configuration: Configuration
    elements: float | None
    element_cost: Cost
    frames: tuple[FrameRate, ...]
    note: str = ""


def measure_speed(device: Device, config: Configuration, sizes: Sequence[tuple[int, int]], peak: Peak, seconds: float,
                  patient: bool = False) -> Speed:
    """Measure one configuration.

    Args:
        device: the adapter.
        config: parameters; the numbers are random.
        sizes: widths and heights of frames.
        peak: of the adapter, from `measure_peak`.
        seconds: about how long each measurement takes.
        patient: also measure what takes a software adapter long.
    """
    model = random_model(config)
    layout = lay_out(model.metadata.axes, config.kind)
    decoder = GpuDecoder(model, device)
    refusal = decoder.refusal()
    elements = None
    if refusal is None:
        rng = np.random.default_rng(1)
        indices = rng.integers(np.array(model.shape), size=(_ELEMENTS, model.ndim))
        elements = _ELEMENTS * rate(device, lambda: decoder.submit(indices), seconds)
    path = GpuPath(device, model, layout, config.kind)
    frames = [frame for width, height in sizes
              for frame in _frames(device, path, model, layout, config, (width, height), seconds, patient)]
    shared = tuple(_with_shares(frame, peak) for frame in frames)
    return Speed(config, elements, element_cost(model), shared, "" if refusal is None else str(refusal))


def element_cost(model: Model) -> Cost:
    """Mean cost of a scattered element."""
    rng = np.random.default_rng(2)
    picked = rng.integers(np.array(model.shape), size=(_COUNTED, model.ndim))
    return mean_cost(model, [{axis: [int(i)] for axis, i in enumerate(index)} for index in picked])


def surface_cost(model: Model, layout: Layout) -> Cost:
    """Mean cost of a pixel of a surface: three lights, three views and four texels around random ones, all colours."""
    rng = np.random.default_rng(3)
    samples: list[dict[int, list[int]]] = []
    for _ in range(_COUNTED):
        picks = {axis: [at, at + 1] for axis in layout.space for at in [int(rng.integers(layout.sizes[axis] - 1))]}
        for axis in (*layout.lights, *layout.views):
            coords = np.asarray(model.metadata.axes[axis].coords)
            nearest = np.argsort(-(coords @ coords[rng.integers(len(coords))]))[:3]
            picks[axis] = [int(i) for i in nearest]
        if layout.channel is not None:
            picks[layout.channel] = list(layout.channels)
        samples.append(picks)
    return mean_cost(model, samples, channels=len(layout.channels))


def box_cost(model: Model, layout: Layout, elements: int) -> Cost:
    """Cost of a time step: its contraction, and that many `elements` of the contracted model."""
    still = () if layout.time is None else (layout.time,)
    contracted = contractable(model, still)
    rng = np.random.default_rng(4)
    picked = [{axis: [int(rng.integers(size))] for axis, size in enumerate(model.shape)} for _ in range(_COUNTED)]
    whole = mean_cost(model, picked, contracted=contracted).times(elements)
    numbers = set_numbers(model.stages, contracted) if contracted else 0
    terms = prod(max(1, rank) for n, rank in enumerate(tree_of(model.metadata, model.stages).ranks) if n in contracted)
    return whole + Cost(multiply_adds=numbers * terms, coefficients=numbers * terms)


def _frames(device: Device, path: GpuPath, model: Model, layout: Layout, config: Configuration, size: tuple[int, int],
            seconds: float, patient: bool) -> list[FrameRate]:
    """Rates for one size of frames."""
    scene = benchmark_scene(config.kind, *size)
    if config.kind == "svbrdf":
        cost = surface_cost(model, layout).times(prod(size))
        refusal = path.refusal(scene, len(model.levels))
        if refusal is not None:
            return [FrameRate(*size, "view", None, cost, note=str(refusal))]
        return [FrameRate(*size, "view", rate(device, lambda: _draw(path, scene), seconds), cost)]
    slices = 4 if config.kind == "lightfield" else layout.sizes[layout.space[0]]
    elements = slices * prod(layout.sizes[axis] for axis in layout.space[-2:])
    if device.software and elements > _MOST_IN_SOFTWARE and not patient:
        note = f"{elements} elements a time step take a software adapter long: name the configuration to measure it"
        return [FrameRate(*size, "time", None, box_cost(model, layout, elements), note=note)]
    still = rate(device, lambda: _draw(path, scene), seconds)
    steps = iter(range(1 << 30))
    frames = 1 if layout.time is None else layout.sizes[layout.time]
    moving = rate(device, lambda: _draw(path, replace(scene, time=float(next(steps) % frames))), seconds)
    return [FrameRate(*size, "view", still, None),
            FrameRate(*size, "time", moving, box_cost(model, layout, elements))]


def benchmark_scene(kind: str, width: int, height: int) -> Scene:
    """A scene whose object fills the picture; a surface has a point light."""
    if kind == "svbrdf":
        return Scene(width, height, surface=Surface("plane"), lights=(Light(position=(1.5, 0.5, 1.0)),),
                     camera=Camera(azimuth=0.0, elevation=0.0, distance=1.5))
    return Scene(width, height, kind=kind, time=0.0, volume=Look(window=(0.0, 3.0)))


def _draw(path: GpuPath, scene: Scene) -> None:
    path.draw(scene, None)


def _with_shares(frame: FrameRate, peak: Peak) -> FrameRate:
    if frame.rate is None or frame.cost is None:
        return frame
    return replace(frame, arithmetic=frame.rate * frame.cost.flops / peak.flops,
                   bandwidth=frame.rate * frame.cost.nbytes / peak.nbytes)
